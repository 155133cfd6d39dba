"""Largest and smallest values, and sums, in squares around each place of an image.

In place of scipy.ndimage, which takes longer to import than a small image to make.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BESIDE: Final = 3


def most_around(values: Array, size: int) -> Array:
    """Largest value in squares of so many rows and columns around each, an odd number."""
    if size == _BESIDE:
        return _beside(values, np.maximum)
    for _ in range(2):  # rows, then columns
        values = np.pad(values, [(size // 2, size // 2), (0, 0)], mode="edge")
        seen = 1
        while seen < size:  # rows that each has seen
            more = min(seen, size - seen)
            values, seen = np.maximum(values[:-more], values[more:]), seen + more
        values = values.T
    return values


def least_around(values: Array, size: int) -> Array:
    """Smallest value in such squares."""
    return _beside(values, np.minimum) if size == _BESIDE else -most_around(-values, size)


def _beside(values: Array, better: np.ufunc) -> Array:
    """The best of each place and the eight beside it: three quarters of the time go without room for more."""
    down = values.copy()
    better(down[1:], values[:-1], out=down[1:])
    better(down[:-1], values[1:], out=down[:-1])
    found = down.copy()
    better(found[:, 1:], down[:, :-1], out=found[:, 1:])
    better(found[:, :-1], down[:, 1:], out=found[:, :-1])
    return found


def sum_around(values: Array, size: int) -> Array:
    """Sum over such squares; what lies beside all of them counts nothing."""
    for _ in range(2):
        ahead = np.cumsum(np.pad(values, [(size // 2 + 1, size // 2), (0, 0)]), axis=0)
        values = (ahead[size:] - ahead[:-size]).T
    return values
