"""An emulator behind its socket: whatever comes in, it goes on and says nothing on stderr."""

from __future__ import annotations

import random
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from radwrap.led import emulated_port as wire
from radwrap.led.connect import EmulatorProcess

PATIENCE = 20.0
QUICK = 5.0  # s; an exchange that waits in vain takes ten


def test_garbage_is_refused_without_a_word(tmp_path: Path) -> None:
    dice = random.Random(3)  # noqa: S311  (no secret)
    requests = [
        (letter, dice.randbytes(dice.choice((0, 1, 2, 3, 64, 70)))) for letter in b"wsgdmhxz\xff" for _ in "1234"
    ]
    requests += [(ord("m"), b"stall x"), (ord("m"), b"\xff"), (ord("m"), b"unplug after -x")]
    place = tmp_path / "socket"
    words = [sys.executable, "-m", "radwrap.led.emulator", str(place)]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe) as emulator:
        assert emulator.stdout is not None and emulator.stdout.readline() == b"ready\n"
        for kind, content in requests:
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(PATIENCE)
                connection.connect(str(place))
                wire.send(connection, bytes([kind]), content)
                assert wire.receive(connection) is not None
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(PATIENCE)
            connection.connect(str(place))
            connection.sendall(b"w\xff\xff\xff\xff")
            assert connection.recv(1) == b"", "a request of 4 GB is not waited for"
        _, said = emulator.communicate(timeout=PATIENCE)
    assert (emulator.returncode, said) == (0, b"")


@pytest.mark.parametrize("place", ["send", "receive", "_exactly"])
def test_an_interrupt_within_an_exchange_costs_that_exchange_only(monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    """Whether the request was not yet sent, or its answer half read: the next exchange does not wait for it."""
    original = getattr(wire, place)

    def interrupted(*arguments: Any) -> Any:
        if place == "_exactly":
            original(*arguments)  # the header is read, and lost
        raise KeyboardInterrupt

    with EmulatorProcess() as emulator:
        port = wire.EmulatedPort(emulator.socket)
        known = port.told()
        with monkeypatch.context() as here:
            here.setattr(wire, place, interrupted)
            with pytest.raises(KeyboardInterrupt):
                port.told()
        begin = time.monotonic()
        assert port.told() == known and time.monotonic() - begin < QUICK
        port.close()
