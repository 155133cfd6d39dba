"""A second process that turns the ring off when the first one no longer can.

It learns of SIGKILL and crashes by the end of its stdin, of hangs by missing
heartbeats, and is told how long light may last. It answers each heartbeat, so
that the first process learns where the guardian itself hangs.
Run as ``python -m radwrap.led.guardian PATH KIND COUNT SERIAL``.
"""

from __future__ import annotations

import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Final, Literal

from radwrap.errors import EnvironmentFailure, RadwrapError
from radwrap.led.backend import Kind
from radwrap.led.connect import choose, open_backend
from radwrap.led.ports import Found, found
from radwrap.own_modules import start_module

BEAT: Final = 0.2  # s between heartbeats
MISSED: Final = 1.5  # s without one: the process hangs
_START: Final = 20.0  # s, on a busy machine ten times what it takes
_GIVE_UP: Final = 60.0  # s of trying to reach the device
_AGAIN: Final = 0.1  # s between two attempts
_BLOCKED: Final = 1.0  # s of trying, before a process that hangs and holds the device is killed
_FAREWELL: Final = 5.0  # s
_ATTENTION: Final = 5.0  # s until it watches: nothing shines yet, and a busy machine may take its time

# The first and the third are answered with the same word; the first has the longest time of light behind it.
_WATCH, _REST, _BEAT, _BYE = "watch", "rest", "beat", "bye"
_TROUBLES: Final = {"hangs": "hears no heartbeat", "too long": "sees light that lasts too long"}


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
        self._guard = threading.Lock()  # heartbeats come from a thread of their own
        self._watching = False
        self._asked: float | None = None
        self._closed = False

    def watch(self, longest: float) -> None:
        """There is light to come, for this long at most [s]: from now on heartbeats are due.

        Raises
        ------
        EnvironmentFailure
            If the guardian is gone, or does not say that it watches.
        """
        with self._guard:
            self._tell(f"{_WATCH} {longest!r}")
            if self._watching:
                return
            end = time.monotonic() + _ATTENTION
            while (word := self._child.hear(max(end - time.monotonic(), 0.0))) != _WATCH:
                if word is None:
                    raise _silent()
            self._watching, self._asked = True, None

    def rest(self) -> None:
        """It is dark."""
        with self._guard:
            self._watching = False
            self._tell(_REST)

    def beat(self) -> None:
        """A heartbeat, once the one before was answered.

        Raises
        ------
        EnvironmentFailure
            If the guardian is gone, or was not heard for a while though there is light.
        """
        with self._guard:
            if self._closed:
                return  # the last heartbeat came while we said farewell
            while self._child.hear(0.0):
                self._asked = None
            if self._asked is None or self._child.ended:
                self._tell(_BEAT)
                self._asked = time.monotonic()
            elif self._watching and time.monotonic() - self._asked > MISSED:
                raise _silent()

    def close(self) -> None:
        """It is dark, and no longer our device."""
        with self._guard:
            self._closed = True
            self._child.tell(_BYE)
            self._child.close(_FAREWELL)

    def _tell(self, word: str) -> None:
        if self._child.ended or not self._child.tell(word):
            raise EnvironmentFailure("has ended, so there must be no light", where="guardian")


def _silent() -> EnvironmentFailure:
    return EnvironmentFailure("does not answer, so there must be no light", where="guardian")


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
    _wake_with_every_word()
    watch = _Watch()
    trouble = watch.await_trouble()
    if trouble in _TROUBLES:
        told = f"radwrap: the guardian {_TROUBLES[trouble]} and turns the LEDs off"
        print(told, file=sys.stderr, flush=True)
    while trouble in _TROUBLES:
        # Again and again: one that wakes up may carry out what it was about to do.
        code = ring.turn_off_at_last(driver)
        if code:
            return code
        trouble = watch.await_trouble()
    return ring.turn_off_at_last(None) if trouble == "gone" else 0


def _wake_with_every_word() -> None:
    """Whoever stops this process: each word of the driver, and the end of the driver, lets it go on."""
    if sys.platform != "linux":
        return
    import fcntl

    fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(0, fcntl.F_SETSIG, signal.SIGCONT)
    fcntl.fcntl(0, fcntl.F_SETFL, fcntl.fcntl(0, fcntl.F_GETFL) | os.O_ASYNC)


class _Watch:
    """What the driver says, and how long it has said nothing."""

    def __init__(self) -> None:
        self._buffer = b""
        self._watching = False
        self._dark_by = math.inf

    def await_trouble(self) -> Literal["farewell", "gone", "hangs", "too long"]:
        """Listen until something is wrong, or nothing more is to be done."""
        while True:
            left = min(MISSED, max(self._dark_by - time.monotonic(), 0.0)) if self._watching else None
            if not select.select([0], [], [], left)[0]:
                if time.monotonic() < self._dark_by:
                    return "hangs"
                self._dark_by = math.inf  # told once: it is turned off now
                return "too long"
            block = os.read(0, 4096)
            if not block:
                return "gone" if self._watching else "farewell"
            *lines, self._buffer = (self._buffer + block).split(b"\n")
            for line in lines:
                if line.decode(errors="replace") == _BYE:
                    return "farewell"
                self._hear(line.decode(errors="replace"))

    def _hear(self, line: str) -> None:
        word, _, longest = line.partition(" ")
        if word == _REST:
            self._watching, self._dark_by = False, math.inf
        elif word == _WATCH:
            # The driver ends it at that moment; only where it does not, we do.
            self._watching, self._dark_by = True, time.monotonic() + float(longest) + MISSED
        if word in (_WATCH, _BEAT):
            with suppress(OSError):  # the driver is gone: the end of stdin tells
                os.write(1, f"{word}\n".encode())


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
