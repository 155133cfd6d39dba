"""SIGINT and SIGTERM end a command with exit code 130, whenever they come."""

import os
import signal
import sys
import time
from contextlib import suppress

from radwrap.errors import INTERRUPTED

_MESSAGE = "radwrap: interrupted; the same command goes on from what was finished"
_PATIENCE = 5.0  # s for a command's end, in which further signals would only disturb


class Interrupts:
    """What the signals do: before there is work they end the process at once, and then by KeyboardInterrupt."""

    def __init__(self) -> None:
        self._heard: float | None = None
        self._working = False

    @property
    def heard(self) -> bool:
        """Whether a signal came while there was work."""
        return self._heard is not None

    def install(self) -> None:
        """Take over both signals."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self)

    def begin_work(self) -> None:
        """From now on there may be files and programs to be looked after."""
        self._working = True

    def __call__(self, *_: object) -> None:
        """Heed a signal."""
        if not self._working:
            tell_interrupted()
            os._exit(INTERRUPTED)
        now = time.monotonic()
        if self._heard is not None and now - self._heard < _PATIENCE:
            return
        self._heard = now
        raise KeyboardInterrupt

    def unraisable(self, lost: "sys.UnraisableHookArgs") -> None:
        """An error where Python cannot raise one, as in a finaliser; an interrupt must not be lost there."""
        if lost.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(lost)
            return
        from radwrap.lost_interrupts import interrupt_again

        self._heard = None
        interrupt_again()


def tell_interrupted() -> int:
    """Say that the command was interrupted; returns its exit code."""
    with suppress(OSError, ValueError):  # nobody can be told, but the exit code is right
        print(_MESSAGE, file=sys.stderr, flush=True)
    return INTERRUPTED
