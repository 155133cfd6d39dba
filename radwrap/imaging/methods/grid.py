"""The grid of the central image: how fine it is, and rays through its cells at any level."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.optics.view import View, known_or_traced
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
# A difference between neighbours is passed over where it moves no pixel by more than this share of the aim.
_PASSED_OVER: Final = 0.25
# Halvings of points of wide lights that tell where light changes: the same for all rays, so that none of it is noise.
_ALIKE: Final = 1


@dataclass(frozen=True, slots=True)
class GridPlan:
    """How fine the central image is.

    Attributes
    ----------
    base : int
        Base cell [px].
    levels : int
        How often a base cell may be cut in two each way; the grid's cell is base / 2^levels.
    area : float
        How many square pixels a pixel gathers from.
    aim : float
        Rms error to aim at [gray level].
    exposure_of_radiance : float
        tau A/f^2: radiant exposure of an even field of radiance 1.
    sensor : Sensor
        Response, to tell which differences matter.
    with_depth : bool
        Whether each cell's magnification is needed.
    even : bool, optional
        True where each grid cell gets one ray whatever is seen there: no light decides where rays go.
    smooth : str, optional
        Hash of the view's smooth blocks, where no rays go; see `smooth.SmoothField`.
    edges : bool, optional
        True where pixels that edges go through meet the aim by themselves, as what is measured in a frame needs.
    halvings : int, optional
        How often the points of wide lights are halved of a ray that a pixel has for itself; see `noise.NoisyTracer`.
    """

    base: int
    levels: int
    area: float
    aim: float
    exposure_of_radiance: float
    sensor: Sensor
    with_depth: bool
    even: bool | None = field(default=None, metadata=ONLY_WHERE_USED)
    smooth: str | None = field(default=None, metadata=ONLY_WHERE_USED)
    edges: bool | None = field(default=None, metadata=ONLY_WHERE_USED)
    halvings: int | None = field(default=None, metadata=ONLY_WHERE_USED)

    @property
    def cell(self) -> float:
        """Grid cell h [px]."""
        return math.ldexp(self.base, -self.levels)

    def gray(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gray level of even fields of the given radiances; without saturation, which blur may undo."""
        return unclipped_gray(values * self.exposure_of_radiance, self.sensor)

    def threshold(self, size: float) -> float:
        """Difference between neighbouring cells of a size [px] from which on they are cut [gray level].

        An edge of height d in all the cells of a footprint gives its mean the
        variance d^2/12 over their number; few have one.
        """
        return _PASSED_OVER * self.aim * math.sqrt(12 * max(1.0, self.area / size**2))


class Sampler:
    """Rays through cells of a grid, at any level."""

    def __init__(
        self,
        view: View,
        plan: GridPlan,
        first: tuple[int, int],
        progress: Callable[[int], None],
        *,
        alike: bool = False,
        smooth: SmoothField | None = None,
    ) -> None:
        self._view, self._plan, self._progress, self._alike = view, plan, progress, alike
        self._first = first
        self._smooth = smooth or (view.smooth if plan.smooth else None)
        self.rays = 0

    def places(
        self, row: NDArray[np.intp], column: NDArray[np.intp], size: int, random: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A place anywhere in each cell of `size` x `size` grid cells."""
        return self.strata(row, column, size, 1, random)

    def strata(
        self, row: NDArray[np.intp], column: NDArray[np.intp], size: int, n: int, random: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rows and columns [grid cell] of n x n places in each cell, one anywhere in each of its strata."""
        i, j = (a.ravel() for a in np.indices((n, n)))
        inside = random.random((2, len(row), n * n))
        rows = (row[:, np.newaxis] + (i + inside[0]) / n) * size
        columns = (column[:, np.newaxis] + (j + inside[1]) / n) * size
        return rows.ravel(), columns.ravel()

    def trace(
        self, placed: Sequence[tuple[Array, Array]], sizes: Sequence[float], *, with_depth: bool
    ) -> tuple[Array, Array]:
        """L cos^4(theta) and m at rows and columns [grid cell], of which there is one in each piece of a size."""
        views = [self._together(size) for size in sizes]
        together = all(view is self._view for view in views)  # one call, which may start programs
        if together or not any(len(rows) for rows, _ in placed):
            rows, columns = (np.concatenate([part[axis] for part in placed]) for axis in (0, 1))
            return self._known_or_traced(self._view, rows, columns, with_depth=with_depth)
        parts = [
            self._known_or_traced(view, *part, with_depth=with_depth)
            for view, part in zip(views, placed, strict=True)
            if len(part[0])
        ]
        return np.concatenate([part[0] for part in parts], axis=-1), np.concatenate([part[1] for part in parts])

    def _together(self, size: float) -> View:
        """The view, with noise that suits rays in pieces of a size [grid cell]."""
        rays = self._plan.area / (size * self._plan.cell) ** 2
        if self._alike:
            return self._view.together(rays, _ALIKE, alike=True)
        return self._view.together(rays, self._plan.halvings or 0)

    def _known_or_traced(self, view: View, rows: Array, columns: Array, *, with_depth: bool) -> tuple[Array, Array]:
        cell = self._plan.cell
        u, v = (self._first[1] + columns) * cell - 0.5, (self._first[0] + rows) * cell - 0.5
        return known_or_traced(view, self._smooth, u, v, traced=self._count, with_depth=with_depth)

    def _count(self, rays: int) -> None:
        self.rays += rays
        self._progress(rays)
