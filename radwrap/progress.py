"""How far a long piece of work is, on stderr."""

from __future__ import annotations

import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TextIO

_BAR_WIDTH: Final = 30
_TERMINAL_PERIOD: Final = 0.2  # s between updates of a bar that is seen
_BEYOND: Final = 1.02  # of the whole; by so little more it may be said to be done
_LOG_PERIOD: Final = 10.0  # s between lines where stderr goes to a file


def note(what: str) -> None:
    """Say a word on stderr of what takes long beside the work that is counted."""
    with suppress(OSError):  # nobody can be told
        print(f"radwrap: {what}", file=sys.stderr)


@dataclass(frozen=True, slots=True)
class Progressed:
    """How far a render is.

    Attributes
    ----------
    done, of : int
        Rays that are done, of so many; a forecast, which is corrected on the way.
    seconds_left : float or None
        At the speed so far [s]; None before the first ray, and where it takes more rays than were forecast.
    """

    done: int
    of: int
    seconds_left: float | None


class Progress:
    """A bar with the time left; a line now and then where nobody watches.

    Parameters
    ----------
    what : str
        What is done.
    total : int
        How many units of work there are.
    shown : bool
        Whether to write at all.
    stream : TextIO, optional
        Where to write; default stderr.
    """

    def __init__(self, what: str, total: int, *, shown: bool = True, stream: TextIO | None = None) -> None:
        self._what = what
        self._total = max(total, 1)
        self._done = 0
        self._skipped = 0
        self._before = 0  # done by parts that are finished, so many of which are
        self._finished = 0
        self._parts_left = 0
        self._stream = stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._shown = shown
        self._start = time.monotonic()
        self._last = self._start if not self._terminal else 0.0
        self._guard = threading.Lock()

    def expect(self, total: int) -> None:
        """Say how many units of work there are, where that is learnt late."""
        with self._guard:
            self._total = max(total, 1)

    @property
    def what(self) -> str:
        """What is done."""
        return self._what

    def restart(self, what: str | None = None) -> None:
        """Begin to count again, at another piece of the same work, which may be called otherwise."""
        with self._guard:
            self._what = self._what if what is None else what
            self._total, self._done, self._skipped = 1, 0, 0
            self._before, self._finished, self._parts_left = 0, 0, 0
            self._start = time.monotonic()

    def begin_part(self, left: int) -> None:
        """Begin another part of the work, after which so many are left, each taken to be as large as the others."""
        with self._guard:
            if self._done:
                self._before, self._finished = self._before + self._done, self._finished + 1
            self._total, self._done, self._parts_left = 1, 0, left

    def left(self, amount: int) -> None:
        """Say how many units of work are left, where that is learnt on the way."""
        with self._guard:
            self._total = max(self._done + amount, 1)

    def add(self, amount: int) -> None:
        """Count work that was done now; any thread may call."""
        with self._guard:
            self._done += amount
            self._show()

    def skip(self, amount: int) -> None:
        """Count work that was found done, which says nothing about speed."""
        with self._guard:
            self._done += amount
            self._skipped += amount
            self._show()

    @property
    def state(self) -> Progressed:
        """How far it is now; any thread may ask."""
        with self._guard:
            done, whole = self._before + self._done, round(self._whole())
            return Progressed(done, max(whole, done), self._seconds_left(time.monotonic()))

    def close(self) -> None:
        """End the line."""
        if self._shown and self._terminal:
            self._stream.write("\r\x1b[K")
            self._stream.flush()

    def _show(self) -> None:
        now = time.monotonic()
        if not self._shown or now - self._last < (_TERMINAL_PERIOD if self._terminal else _LOG_PERIOD):
            return
        self._last = now
        share = (self._before + self._done) / self._whole()
        # Nobody knows how much more than it was expected to be it is.
        told = (
            f"{100 * min(share, 1.0):3.0f} %{self._time_left(now)}"
            if share <= _BEYOND
            else f"takes longer than was forecast, {share:.2f} times so far"
        )
        text = f"{self._what} {told}"
        share = min(share, 1.0)
        if self._terminal:
            filled = round(_BAR_WIDTH * share)
            self._stream.write(f"\r[{'#' * filled}{'.' * (_BAR_WIDTH - filled)}] {text}\x1b[K")
        else:
            self._stream.write(text + "\n")
        self._stream.flush()

    def _whole(self) -> float:
        """Units of work of all parts."""
        known = self._before + max(self._total, self._done if self._parts_left else 0)
        return known * (1 + self._parts_left / (self._finished + 1))

    def _seconds_left(self, now: float) -> float | None:
        done, whole = self._before + self._done, self._whole()
        fresh = done - self._skipped
        if fresh <= 0 or done > _BEYOND * whole:
            return None
        return max((now - self._start) * (whole - done) / fresh, 0.0)

    def _time_left(self, now: float) -> str:
        left = self._seconds_left(now)
        if left is None:
            return ""
        minutes, seconds = divmod(round(left), 60)
        return f", {minutes} min {seconds:02d} s left" if minutes else f", {seconds} s left"
