"""Radiant exposures at which codes begin: a page ranks pixels among them, and need not know Eq. 5.

A code is a rank: the number of thresholds that a pixel's radiant exposure has reached. Exposure files hold float32, so
a threshold is the least float32 that Eq. 5, computed as for gray.png, turns into that code. Found by bisection over
the numbers' bit patterns, whose order is that of the numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.camera import Sensor

_LARGEST: Final = int(np.array(np.finfo(np.float32).max).view(np.uint32))
_STEPS: Final = 32  # halvings of all bit patterns, to the last one


@dataclass(frozen=True, slots=True, eq=False)
class Thresholds:
    """Where codes begin.

    Attributes
    ----------
    first : int
        Code of no light.
    values : ndarray of float32, shape (n,)
        Least radiant exposures of the codes first + 1, first + 2, ...; they never fall [J m^-2].
    saturated : float
        Least one at saturation; infinite where no float32 is.
    lit : float
        Least one that is half a gray level above the dark level; infinite likewise.
    """

    first: int
    values: NDArray[np.float32]
    saturated: float
    lit: float

    def codes(self, exposure: NDArray[np.float32]) -> NDArray[np.intp]:
        """Codes of radiant exposures."""
        found: NDArray[np.intp] = self.first + np.searchsorted(self.values, exposure, side="right")
        return found


def thresholds(sensor: Sensor) -> Thresholds:
    """Thresholds of a sensor's codes, exact for every float32."""
    ends = np.array([0.0, np.finfo(np.float32).max], dtype=np.float64)
    first, last = np.rint(gray_levels(ends, sensor)).astype(int).tolist()
    codes = np.arange(first + 1, last + 1, dtype=np.float64)
    values = _least(lambda exposure: np.rint(gray_levels(exposure, sensor)) >= codes, len(codes))
    saturation, dark = sensor.saturation_gray, sensor.dark_gray + 0.5
    saturated = _least(lambda exposure: gray_levels(exposure, sensor) >= saturation, 1)
    lit = _least(lambda exposure: gray_levels(exposure, sensor) >= dark, 1)
    return Thresholds(first, values, float(saturated[0]), float(lit[0]))


def _least(reached: Callable[[NDArray[np.float64]], NDArray[np.bool_]], count: int) -> NDArray[np.float32]:
    """Least float32 from 0 on for which each of some rising conditions holds; infinity where none does."""
    low, high = np.zeros(count, dtype=np.int64), np.full(count, _LARGEST + 1, dtype=np.int64)
    for _ in range(_STEPS):
        middle = (low + high) // 2
        inside = np.minimum(middle, _LARGEST).astype(np.uint32).view(np.float32)
        there = reached(inside.astype(np.float64)) & (middle <= _LARGEST)
        high = np.where(there, middle, high)
        low = np.where(there, low, np.minimum(middle + 1, high))
    return high.astype(np.uint32).view(np.float32)  # the pattern beyond the largest number is infinity's
