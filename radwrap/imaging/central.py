"""The central image, what the opening's centre sees, with more rays where it changes.

A grid of base cells, a power of two of pixels each, gets a ray a cell. Where
neighbours differ a cell is cut in four, again and again, down to the grid's
cells; where those still differ, a cell gets n x n rays. Each ray below the
base level lies anywhere in its cell (drawn), so that errors of different
cells are independent, and cells' means are unbiased.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.sensor import unclipped_gray
from radwrap.imaging.view import View, trace_rays
from radwrap.scene.camera import Sensor

SUB_SAMPLES: Final = (1, 2, 4, 8)
# A difference between neighbours is passed over where it moves no pixel by more than this share of the aim.
_PASSED_OVER: Final = 0.25
# Variance of the mean over n x n strata of a cell that an edge of height d crosses is about d^2/(4 n^3): about 1.5 n
# strata are crossed, each with the variance d^2/6. Of the cells beside an edge about every third is crossed.
_EDGE_VARIANCE: Final = 12.0


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
    """

    base: int
    levels: int
    area: float
    aim: float
    exposure_of_radiance: float
    sensor: Sensor
    with_depth: bool

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


@dataclass(frozen=True, slots=True, eq=False)
class CentralImage:
    """Part of the central image on the grid.

    Attributes
    ----------
    first : tuple of int
        Row and column of the first grid cell.
    values : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) over each cell [W m^-2 sr^-1].
    magnification : ndarray, shape (rows, columns), optional
        m = 1 + f/z of each cell.
    rays : int
        How many were traced.
    samples : int
        n; n x n rays in each cell that an edge crosses.
    predicted_rms : float
        Error of the image that is gathered from this one, as it was predicted from the differences [gray level].
    cuts : tuple
        Rows and columns of the cells that were cut at each level, and of those that got n x n rays.
    """

    first: tuple[int, int]
    values: NDArray[np.float64]
    magnification: NDArray[np.float64] | None
    rays: int
    samples: int
    predicted_rms: float
    cuts: tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]


def central_image(
    view: View,
    plan: GridPlan,
    region: tuple[tuple[int, int], tuple[int, int]],
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
    like: CentralImage | None = None,
) -> CentralImage:
    """Trace part of the central image.

    Parameters
    ----------
    view : View
        Whose.
    plan : GridPlan
        How fine.
    region : tuple
        First row and column of grid cells that are needed, and how many; the image returned holds at least these.
    seed : tuple of int
        Where the base grid lies, and where the rays in cells that are cut.
    progress : callable
        Is told how many rays were traced.
    like : CentralImage, optional
        Traced with the same plan, region and seed, perhaps in other light: the very same rays are traced as for it,
        and its magnifications are kept, so that the values are linear in the light.
    """
    random = np.random.default_rng(seed)
    if like is not None:
        plan = replace(plan, with_depth=False)
    step = 2**plan.levels
    # The base grid lies anywhere on the grid of cells.
    first = tuple(start - int(random.integers(step)) for start in region[0])
    shape = tuple(
        -(-(start + size - begin) // step) for start, size, begin in zip(region[0], region[1], first, strict=True)
    )
    sampler = _Sampler(view, plan, (first[0], first[1]), progress)
    rows, columns = np.indices(shape)
    values, magnification = sampler.sample(rows.ravel(), columns.ravel(), step, None)
    values, magnification = values.reshape(shape), magnification.reshape(shape)
    cuts = []
    for level in range(plan.levels):
        cut = (
            like.cuts[level] if like else np.nonzero(_spread(plan.gray(values)) > plan.threshold(plan.base / 2**level))
        )
        cuts.append((cut[0], cut[1]))
        values, magnification = (np.repeat(np.repeat(a, 2, axis=0), 2, axis=1) for a in (values, magnification))
        row, column = _children(*cuts[-1])
        values[row, column], magnification[row, column] = sampler.sample(
            row, column, 2 ** (plan.levels - level - 1), random
        )
    if like:
        row, column = like.cuts[-1]
        samples, predicted = like.samples, like.predicted_rms
    else:
        spread = _spread(plan.gray(values))
        row, column = np.nonzero(spread > plan.threshold(plan.cell))
        samples, predicted = _samples_needed(plan, spread[row, column], values.size)
    cuts.append((row, column))
    if samples > 1 and len(row):
        values[row, column], magnification[row, column] = sampler.means(row, column, samples, random)
    depth = like.magnification if like else magnification if plan.with_depth else None
    return CentralImage((first[0], first[1]), values, depth, sampler.rays, samples, predicted, tuple(cuts))


def _children(row: NDArray[np.intp], column: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The four cells into which each cell is cut."""
    return (
        (2 * row[:, np.newaxis] + np.array([0, 0, 1, 1])).ravel(),
        (2 * column[:, np.newaxis] + np.array([0, 1, 0, 1])).ravel(),
    )


def _spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest less smallest value of each cell and its four neighbours."""
    framed = np.pad(values, 1, mode="edge")
    shifted = (framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:])
    high, low = values, values
    for other in shifted:
        high, low = np.maximum(high, other), np.minimum(low, other)
    return high - low


def _samples_needed(plan: GridPlan, heights: NDArray[np.float64], cells: int) -> tuple[int, float]:
    """Fewest n of `SUB_SAMPLES` whose predicted rms error [gray level] meets the aim, and that error.

    A cell's error spreads over the pixels that gather from it, each of which
    takes cell^2/area of it.
    """
    # Sum over pixels of their squared weights of a cell, over the number of pixels: cell^2 is pixels a cell.
    share = (plan.cell**2 / plan.area) ** 2 * plan.area / (cells * plan.cell**2)
    energy = float((heights**2).sum()) * share / _EDGE_VARIANCE
    rms = [math.sqrt(energy / n**3) for n in SUB_SAMPLES]
    for n, error in zip(SUB_SAMPLES, rms, strict=True):
        if error <= plan.aim:
            return n, error
    return SUB_SAMPLES[-1], rms[-1]


class _Sampler:
    """Rays through cells of a grid, at any level."""

    def __init__(self, view: View, plan: GridPlan, first: tuple[int, int], progress: Callable[[int], None]) -> None:
        self._view, self._plan, self._progress = view, plan, progress
        self._first = first
        self.rays = 0

    def sample(
        self, row: NDArray[np.intp], column: NDArray[np.intp], size: int, random: np.random.Generator | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """One ray a cell of `size` x `size` grid cells: at its centre, or anywhere in it."""
        inside = np.full((2, 1), 0.5) if random is None else random.random((2, len(row)))
        return self._trace((row + inside[0]) * size, (column + inside[1]) * size)

    def means(
        self, row: NDArray[np.intp], column: NDArray[np.intp], n: int, random: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean of n x n rays a grid cell, one anywhere in each of its strata; of m, weighted by the light."""
        i, j = (a.ravel() for a in np.indices((n, n)))
        inside = random.random((2, len(row), n * n))
        rows = row[:, np.newaxis] + (i + inside[0]) / n
        columns = column[:, np.newaxis] + (j + inside[1]) / n
        values, magnification = (a.reshape(-1, n * n) for a in self._trace(rows.ravel(), columns.ravel()))
        means = values.mean(axis=1)
        weighted = (values * magnification).sum(axis=1) / np.where(means > 0, values.sum(axis=1), 1.0)
        return means, np.where(means > 0, weighted, magnification[:, 0])

    def _trace(
        self, rows: NDArray[np.float64], columns: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        cell = self._plan.cell
        u, v = (self._first[1] + columns) * cell - 0.5, (self._first[0] + rows) * cell - 0.5
        answer = trace_rays(self._view, np.zeros((1, 2)), u, v, with_depth=self._plan.with_depth)
        self.rays += len(u)
        self._progress(len(u))
        return answer
