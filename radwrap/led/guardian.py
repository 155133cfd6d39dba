"""A second process that turns the ring off when the first one no longer can.

It learns of SIGKILL and crashes by the end of its stdin, of hangs by missing
heartbeats. Run as ``python -m radwrap.led.guardian PATH KIND COUNT SERIAL``.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Final, Literal

from radwrap.errors import EnvironmentFailure, RadwrapError
from radwrap.led.backend import Kind
from radwrap.led.connect import choose, open_backend, start_module
from radwrap.led.ports import Found, found

BEAT: Final = 0.2  # s between heartbeats
MISSED: Final = 1.5  # s without one: the process hangs
_START: Final = 20.0  # s, on a busy machine ten times what it takes
_GIVE_UP: Final = 60.0  # s of trying to reach the device
_AGAIN: Final = 0.1  # s between two attempts
_BLOCKED: Final = 1.0  # s of trying, before a process that hangs and holds the device is killed
_FAREWELL: Final = 5.0  # s

_WATCH, _REST, _BEAT, _BYE = "watch", "rest", "beat", "bye"


class Guardian:
    """The driving process' side.

    Parameters
    ----------
    device : Found
        The device to turn off.
    kind : str
        Its electronics.
    count : int
        Number of LEDs.
    claim : int
        File descriptor of the claim, which falls only when the guardian is gone too.

    Raises
    ------
    EnvironmentFailure
        If it cannot turn the ring off even now.
    """

    def __init__(self, device: Found, kind: Kind, count: int, claim: int) -> None:
        keep_open = (claim,) if sys.platform != "win32" else ()
        arguments = (device.path, kind, str(count), device.serial)
        self._child = start_module("radwrap.led.guardian", *arguments, keep_open=keep_open)
        word = self._child.hear(_START)
        if word != "ready":
            self._child.close(0.0)
            raise EnvironmentFailure(word or "the guardian did not start", where="guardian")

    def watch(self) -> None:
        """There will be light: from now on heartbeats are due."""
        self._tell(_WATCH)

    def rest(self) -> None:
        """It is dark."""
        self._tell(_REST)

    def beat(self) -> None:
        """A heartbeat."""
        self._tell(_BEAT)

    def close(self) -> None:
        """It is dark, and no longer our device."""
        self._child.tell(_BYE)
        self._child.close(_FAREWELL)

    def _tell(self, word: str) -> None:
        if self._child.ended or not self._child.tell(word):
            raise EnvironmentFailure("has ended, so there must be no light", where="guardian")


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch until the driver says farewell, or is gone and the ring is dark."""
    path, kind, count, serial = sys.argv[1:] if arguments is None else arguments
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    driver = os.getppid()
    ring = _Ring(path, "lamparray" if kind == "lamparray" else "mcp2221a_pca9685", int(count), serial)
    try:
        # Proof that it can, and all that it needs is loaded.
        ring.turn_off()
    except RadwrapError as error:
        print(error, flush=True)
        return error.exit_code
    print("ready", flush=True)
    trouble = _await_trouble(watching=False)
    if trouble == "hangs":
        print("radwrap: the guardian hears no heartbeat and turns the LEDs off", file=sys.stderr, flush=True)
    while trouble == "hangs":
        # Again and again: one that wakes up may carry out what it was about to do.
        code = ring.turn_off_at_last(driver)
        if code:
            return code
        trouble = _await_trouble(watching=True)
    return ring.turn_off_at_last(None) if trouble == "gone" else 0


def _await_trouble(*, watching: bool) -> Literal["farewell", "gone", "hangs"]:
    """Listen to the driver."""
    buffer = b""
    while True:
        if not select.select([0], [], [], MISSED if watching else None)[0]:
            return "hangs"
        block = os.read(0, 4096)
        if not block:
            return "gone" if watching else "farewell"
        *lines, buffer = (buffer + block).split(b"\n")
        for line in lines:
            word = line.decode(errors="replace")
            if word == _BYE:
                return "farewell"
            watching = word != _REST if word in (_WATCH, _REST) else watching


class _Ring:
    """The device, found again where it was plugged in anew."""

    def __init__(self, path: str, kind: Kind, count: int, serial: str) -> None:
        self._path, self._kind, self._count, self._serial = path, kind, count, serial
        self._device = Found(path, 0, 0, serial, "", 0, 0)

    def turn_off(self) -> None:
        """Open the device, turn every LED off, and let it go."""
        backend = open_backend(self._device, self._kind, self._count)
        try:
            backend.off()
        finally:
            backend.close()

    def turn_off_at_last(self, hanging: int | None) -> int:
        """Try until it is dark; a process that hangs and blocks the device is killed."""
        begin = time.monotonic()
        while True:
            try:
                self.turn_off()
            except RadwrapError as error:
                last = error
            else:
                return 0
            tried = time.monotonic() - begin
            if hanging is not None and tried > _BLOCKED and os.getppid() == hanging:
                os.kill(hanging, signal.SIGKILL)
            if tried > _GIVE_UP:
                print(f"radwrap: the guardian could not turn the LEDs off: {last}", file=sys.stderr, flush=True)
                return EnvironmentFailure.exit_code
            time.sleep(_AGAIN)
            self._find_again()

    def _find_again(self) -> None:
        if self._path.startswith("emulator:") or not self._serial:
            return
        with suppress(RadwrapError):  # not plugged in again yet
            self._device, _ = choose(found(), self._serial)


if __name__ == "__main__":
    sys.exit(main())
