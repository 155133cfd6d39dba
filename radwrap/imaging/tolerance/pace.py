"""How the time of a search goes against its budget."""

from __future__ import annotations

import math
import time
from typing import Final

# Of a budget of time so much goes into rays of the first image, the rest into its certificate and what comes next.
FIRST_SHARE: Final = 0.5
_NEXT_SHARE: Final = 0.3  # of what is left then, for the next attempt: it may take several times what is expected
_SHORTEST: Final = 1e-3  # s; a clock may stand still


class Pace:
    """Time since a search began, and what its attempts took.

    Parameters
    ----------
    budget : float, optional
        Wall time [s]; infinite where there is none.
    """

    def __init__(self, budget: float | None) -> None:
        self._budget = math.inf if budget is None else budget
        self._start = self._begin = time.monotonic()
        self._took = 0.0  # s, by the last attempt
        self._late: tuple[float, float] | None = None  # aim of one that was given up [gray level], after how long [s]

    @property
    def is_free(self) -> bool:
        """Whether time does not matter."""
        return math.isinf(self._budget)

    @property
    def left(self) -> float:
        """Time that is left [s]."""
        return max(self._budget - (time.monotonic() - self._start), 0.0)

    def deadline(self, share: float) -> float:
        """When a share of the budget is spent, by the clock of `time.monotonic`."""
        return self._start + share * self._budget

    def begin(self) -> None:
        """Begin an attempt."""
        self._begin = time.monotonic()

    def end(self) -> None:
        """Note that an attempt is whole."""
        self._took = max(time.monotonic() - self._begin, _SHORTEST)

    def give_up(self, aim: float) -> None:
        """Note that an attempt at an aim [gray level] was out of time."""
        self._late = aim, time.monotonic() - self._begin

    def rays(self, known: int) -> float:
        """How many rays the time left suffices for, as so many took what was spent; few, as programs start too."""
        if self.is_free:
            return math.inf
        spent = max(time.monotonic() - self._start, _SHORTEST)
        return FIRST_SHARE * self.left * known / spent

    def is_spent(self) -> bool:
        """Whether another attempt, which takes as long as the last one at least, would pass the budget."""
        return self._took > self.left

    def next_aim(self, last: float) -> float:
        """The aim that takes a part of the time left, between the last one and one that was given up [gray level].

        The time of an attempt goes by a power of its aim: by that of both, or a higher one. Infinite where none was
        given up.
        """
        if self._late is None:
            return math.inf
        (aim, seconds), part = self._late, _NEXT_SHARE * self.left
        if not self._took < part < seconds:
            return math.inf
        power = math.log(part / self._took) / math.log(seconds / self._took)
        return float(last * (aim / last) ** power)
