"""What the rays of an image by a kernel saw, kept until it is known what waves add to that image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.central import CentralImage
from radwrap.imaging.methods.kernel import KernelPlan

Rect = tuple[int, int, int, int]

# So many cells are kept as small as they are; of more, such as are as wide as waves usually ask for [px]. Of each cell
# there are two numbers of 4 byte.
_FEW_CELLS: Final = 1 << 24
_COARSEST: Final = 0.5
# What is larger than so many cells is not kept.
_MOST_CELLS: Final = 1 << 26


@dataclass(frozen=True, slots=True, eq=False)
class SeenTile:
    """A tile of a central image.

    Attributes
    ----------
    place : tuple of int
        First row, last row + 1, first column, last column + 1 [cell].
    values : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) over each cell [W m^-2 sr^-1].
    magnification : ndarray, shape (rows, columns), optional
        m of each cell, where depths are told apart.
    """

    place: Rect
    values: NDArray[np.float32]
    magnification: NDArray[np.float32] | None


class SeenTiles:
    """Tiles of the image that was begun last, by the numbers of their replicate and of their own."""

    def __init__(self) -> None:
        self._image, self._cell = "", 0.0
        self._tiles: dict[tuple[int, int], SeenTile] = {}

    def begin(self, image: str, plan: KernelPlan, replicates: int) -> None:
        """Keep tiles of the image of a name, so many replicates by a plan, if it is not too large; other ones go."""
        cell = kept_cell(plan, replicates)
        if not may_be_kept(plan, replicates):
            self.clear()
        elif (image, cell) != (self._image, self._cell):
            self._image, self._cell, self._tiles = image, cell, {}

    def clear(self) -> None:
        """Keep nothing any more."""
        self._image, self._tiles = "", {}

    def put(
        self, image: str, which: tuple[int, int], plan: KernelPlan, central: CentralImage, coarser: CentralImage
    ) -> None:
        """Keep a tile, unless another image was begun; parameters as of `seen_in`."""
        if image == self._image:
            self._tiles[which] = seen_in(plan, which[1], self._cell, central, coarser)

    def get(self, image: str, which: tuple[int, int]) -> SeenTile | None:
        """A tile, or None where it is not kept."""
        return self._tiles.get(which) if image == self._image else None


def kept_cell(plan: KernelPlan, replicates: int) -> float:
    """Size of the cells that are kept [px]: those of the grid, or of twice the size."""
    cell = plan.grid.cell
    are_few = replicates * plan.camera.sensor.pixels <= _FEW_CELLS * cell**2
    return cell if are_few or 2 * cell > _COARSEST else 2 * cell


def may_be_kept(plan: KernelPlan, replicates: int) -> bool:
    """Whether all cells of so many replicates are few enough."""
    return replicates * plan.camera.sensor.pixels <= _MOST_CELLS * kept_cell(plan, replicates) ** 2


def cells_of(plan: KernelPlan, tile: int, cell: float) -> Rect:
    """Which cells of a size [px] a tile has, first and last + 1 of rows and columns; each cell has one owner."""
    r0, r1, c0, c1 = plan.tiles[tile]
    sensor = plan.camera.sensor

    def from_to(begin: int, end: int, size: int) -> tuple[int, int]:
        return math.floor(begin / cell), (math.ceil if end == size else math.floor)(end / cell)

    return *from_to(r0, r1, sensor.rows), *from_to(c0, c1, sensor.columns)


def seen_in(plan: KernelPlan, tile: int, cell: float, central: CentralImage, coarser: CentralImage) -> SeenTile:
    """A tile in cells of a size [px], by a central image in cells of the grid and one in cells of twice the size."""
    return part_of(coarser if cell > plan.grid.cell else central, cells_of(plan, tile, cell))


def part_of(image: CentralImage, place: Rect) -> SeenTile:
    """Part of a central image, which has it all."""
    part = tuple(
        slice(begin - first, end - first)
        for begin, end, first in zip(place[::2], place[1::2], image.first, strict=True)
    )
    depth = image.magnification
    return SeenTile(
        place, image.values[part].astype(np.float32), None if depth is None else depth[part].astype(np.float32)
    )
