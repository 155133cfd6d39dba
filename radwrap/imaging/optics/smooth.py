"""What lies between rays of the central image, where it can only change smoothly."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
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
    doublings : ndarray of int, shape (rows + 1, columns + 1)
        How often the points of wide lights were doubled that the ray through each corner asks.
    block : int
        Size of a block [px].
    finer : SmoothField, optional
        Smaller blocks, of which none lies in a smooth one of these.
    """

    first: tuple[int, int]
    smooth: NDArray[np.bool_]
    values: Array
    magnification: Array
    likely: NDArray[np.bool_]
    square: float
    upper: float
    rays: int
    doublings: NDArray[np.int8]
    block: int = BLOCK
    finer: SmoothField | None = None

    @property
    def corners(self) -> tuple[Array, Array]:
        """Places of the corners of blocks [px], columns and rows."""
        return corners_of(self.first, self.smooth.shape, self.block)

    @property
    def share(self) -> float:
        """Of all blocks, those that are smooth."""
        return float(self.smooth.mean()) + (self.finer.share if self.finer else 0.0)

    @property
    def sha256(self) -> str:
        """Hash of which blocks are smooth."""
        told = repr((self.first, self.smooth.shape)).encode() + self.smooth.tobytes()
        if self.doublings.any():
            told += self.doublings.tobytes()
        if self.finer:
            told += self.finer.sha256.encode()
        return hashlib.sha256(told).hexdigest()

    @property
    def in_doubled_pixels(self) -> SmoothField:
        """The same blocks of the same view, in pixels of twice the width and height."""
        finer = None if self.finer is None else self.finer.in_doubled_pixels
        return replace(self, block=self.block // 2, finer=finer)

    def holds(self, u: Array, v: Array) -> NDArray[np.bool_]:
        """Whether places (u, v) on the sensor [px] lie in smooth blocks."""
        rows, columns = self.smooth.shape
        row, column = self._block(v, 0), self._block(u, 1)
        inside: NDArray[np.bool_] = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        inside[inside] = self.smooth[row[inside], column[inside]]
        if self.finer:
            inside |= self.finer.holds(u, v)
        return inside

    def holds_all(self, rows: tuple[float, float], columns: tuple[float, float]) -> bool:
        """Whether all places between these rows and columns [px] lie in smooth blocks."""
        (top, bottom), (left, right) = (
            tuple(math.floor((end + 0.5) / self.block) - self.first[axis] for end in (low, high))
            for axis, (low, high) in enumerate((rows, columns))
        )
        inside = top >= 0 and left >= 0 and bottom < self.smooth.shape[0] and right < self.smooth.shape[1]
        return inside and bool(self.smooth[top : bottom + 1, left : right + 1].all())

    def share_of(self, rows: tuple[float, float], columns: tuple[float, float]) -> float:
        """Share of the blocks between these rows and columns [px] that are smooth."""
        (top, bottom), (left, right) = (
            tuple(max(math.floor((end + 0.5) / self.block) - first, 0) for end in (low, high))
            for first, (low, high) in zip(self.first, (rows, columns), strict=True)
        )
        some = self.smooth[top : bottom + 1, left : right + 1]
        share = float(some.mean()) if some.size else 0.0
        return share + (self.finer.share_of(rows, columns) if self.finer else 0.0)

    def at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """L cos^4(theta) and m between the corners of the blocks in which places lie: what is there if it `holds`."""
        if self.finer is None:
            return self._at(u, v)
        small = self.finer.holds(u, v)
        large = ~small
        parts = [(small, self.finer.at(u[small], v[small])), (large, self._at(u[large], v[large]))]
        values, magnification = np.empty((*self.values.shape[:-2], *u.shape)), np.empty(u.shape)
        for part, (value, m) in parts:
            values[..., part], magnification[part] = value, m
        return values, magnification

    def in_pixels(self, place: tuple[int, int, int, int]) -> tuple[Array, Array]:
        """As `at`, in the middles of pixels from a first row to a last row + 1, and of columns likewise."""
        rows, columns = np.indices((place[1] - place[0], place[3] - place[2]), dtype=np.float64)
        values, magnification = self.at((columns + place[2]).ravel(), (rows + place[0]).ravel())
        return values.reshape(*values.shape[:-1], *rows.shape), magnification.reshape(rows.shape)

    def _at(self, u: Array, v: Array) -> tuple[Array, Array]:
        row, column = self._block(v, 0), self._block(u, 1)
        down = (v + 0.5) / self.block - self.first[0] - row
        right = (u + 0.5) / self.block - self.first[1] - column

        width = self.smooth.shape[1] + 1
        first = row * width + column  # numbers of the corners: one index is looked up faster than two

        def between(corner: Array) -> Array:
            numbered = corner.reshape(*corner.shape[:-2], -1)
            upper = numbered.take(first, -1) * (1 - right) + numbered.take(first + 1, -1) * right
            below = first + width
            lower = numbered.take(below, -1) * (1 - right) + numbered.take(below + 1, -1) * right
            found: Array = upper * (1 - down) + lower * down
            return found

        return between(self.values), between(self.magnification)

    def _block(self, place: Array, axis: int) -> NDArray[np.intp]:
        block: NDArray[np.intp] = np.floor((place + 0.5) / self.block).astype(np.intp) - self.first[axis]
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


def corners_around(blocks: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Which corners some blocks have, and the numbers of each block's four among these, shape (n, 4), going around."""
    needed = most_about(blocks)
    number = np.cumsum(needed).reshape(needed.shape) - 1
    row, column = np.nonzero(blocks)
    around = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)]
    return needed, np.stack([number[corner] for corner in around], axis=1)


def mean_of_corners(corners: Array) -> Array:
    """Mean of each block's four corners."""
    mean: Array = (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4
    return mean


def corners_of(first: tuple[int, int], shape: tuple[int, ...], block: int = BLOCK) -> tuple[Array, Array]:
    """Places of the corners of blocks from a first one on [px], columns and rows, shape (rows + 1, columns + 1)."""
    rows, columns = (block * (begin + np.arange(count + 1)) - 0.5 for begin, count in zip(first, shape, strict=True))
    u, v = np.meshgrid(columns, rows)
    return u, v
