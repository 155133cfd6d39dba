"""What lies between rays of the central image, where it can only change smoothly."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_T = TypeVar("_T", bound=np.generic)

BLOCK: Final = 8  # px; a ray in 64 of what is smooth, and blocks still fit between the parts of a few megapixels


@dataclass(frozen=True, slots=True, eq=False)
class SmoothField:
    """Blocks of the central image, and what is seen at their corners.

    Attributes
    ----------
    first : tuple of int
        Row and column of the first block, in blocks from the sensor's corner.
    smooth : ndarray of bool, shape (rows, columns)
        Which blocks are smooth.
    values : ndarray, shape (rows + 1, columns + 1) or (sources, rows + 1, columns + 1)
        L cos^4(theta) at the corners [W m^-2 sr^-1].
    magnification : ndarray, shape (rows + 1, columns + 1)
        m at the corners.
    likely : ndarray of bool, shape (rows, columns)
        Blocks that may be smooth, see `BlockLight`.
    square, upper : float
        Mean square over the image of what lies between corners less what is there, and its bound [gray level^2].
    rays : int
        How many were traced.
    beside : ndarray of int, shape (rows + 1, columns + 1)
        Each corner is the mean of n x n rays in a square of a pixel about it.
    """

    first: tuple[int, int]
    smooth: NDArray[np.bool_]
    values: Array
    magnification: Array
    likely: NDArray[np.bool_]
    square: float
    upper: float
    rays: int
    beside: NDArray[np.int8]

    @property
    def corners(self) -> tuple[Array, Array]:
        """Places of the corners of blocks [px], columns and rows."""
        return corners_of(self.first, self.smooth.shape)

    @property
    def share(self) -> float:
        """Of all blocks, those that are smooth."""
        return float(self.smooth.mean())

    @property
    def sha256(self) -> str:
        """Hash of which blocks are smooth."""
        told = repr((self.first, self.smooth.shape)).encode() + self.smooth.tobytes()
        if self.beside.max() > 1:
            told += self.beside.tobytes()
        return hashlib.sha256(told).hexdigest()

    def holds(self, u: Array, v: Array) -> NDArray[np.bool_]:
        """Whether places (u, v) on the sensor [px] lie in smooth blocks."""
        rows, columns = self.smooth.shape
        row, column = self._block(v, 0), self._block(u, 1)
        inside: NDArray[np.bool_] = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        inside[inside] = self.smooth[row[inside], column[inside]]
        return inside

    def holds_all(self, rows: tuple[float, float], columns: tuple[float, float]) -> bool:
        """Whether all places between these rows and columns [px] lie in smooth blocks."""
        (top, bottom), (left, right) = (
            (math.floor((low + 0.5) / BLOCK) - self.first[axis], math.floor((high + 0.5) / BLOCK) - self.first[axis])
            for axis, (low, high) in enumerate((rows, columns))
        )
        inside = top >= 0 and left >= 0 and bottom < self.smooth.shape[0] and right < self.smooth.shape[1]
        return inside and bool(self.smooth[top : bottom + 1, left : right + 1].all())

    def share_of(self, rows: tuple[float, float], columns: tuple[float, float]) -> float:
        """Share of the blocks between these rows and columns [px] that are smooth."""
        (top, bottom), (left, right) = (
            (max(math.floor((low + 0.5) / BLOCK) - first, 0), max(math.floor((high + 0.5) / BLOCK) - first, 0))
            for first, (low, high) in zip(self.first, (rows, columns), strict=True)
        )
        some = self.smooth[top : bottom + 1, left : right + 1]
        return float(some.mean()) if some.size else 0.0

    def at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """L cos^4(theta) and m between the corners of the blocks in which places lie: what is there if it `holds`."""
        row, column = self._block(v, 0), self._block(u, 1)
        down = (v + 0.5) / BLOCK - self.first[0] - row
        right = (u + 0.5) / BLOCK - self.first[1] - column

        def between(corner: Array) -> Array:
            upper = corner[..., row, column] * (1 - right) + corner[..., row, column + 1] * right
            lower = corner[..., row + 1, column] * (1 - right) + corner[..., row + 1, column + 1] * right
            found: Array = upper * (1 - down) + lower * down
            return found

        return between(self.values), between(self.magnification)

    def _block(self, place: Array, axis: int) -> NDArray[np.intp]:
        block: NDArray[np.intp] = np.floor((place + 0.5) / BLOCK).astype(np.intp) - self.first[axis]
        return block


def most_about(values: NDArray[_T]) -> NDArray[_T]:
    """The largest of each corner's blocks' values, which are no less than 0; shape (rows + 1, columns + 1)."""
    rows, columns = values.shape
    most = np.zeros((rows + 1, columns + 1), dtype=values.dtype)
    for down in (0, 1):
        for right in (0, 1):
            some = most[down : down + rows, right : right + columns]
            np.maximum(some, values, out=some)
    return most


def mean_of_corners(corners: Array) -> Array:
    """Mean of each block's four corners."""
    mean: Array = (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4
    return mean


def corners_of(first: tuple[int, int], shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Places of the corners of blocks from a first one on [px], columns and rows, shape (rows + 1, columns + 1)."""
    rows, columns = (BLOCK * (begin + np.arange(count + 1)) - 0.5 for begin, count in zip(first, shape, strict=True))
    u, v = np.meshgrid(columns, rows)
    return u, v
