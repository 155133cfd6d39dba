"""The central image, what the opening's centre sees, with more rays where it changes.

A grid of base cells, a power of two of pixels each, gets a ray a cell. Where
neighbours differ a cell is cut in four, again and again, down to the grid's
cells; where those still differ, a cell is to get n x n rays. Then each cell is
traced anew, by rays anywhere in it (drawn), so that errors of different cells
are independent and their means unbiased.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.random_streams import generator
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
_T = TypeVar("_T", bound=np.generic)
SUB_SAMPLES: Final = (1, 2, 4, 8)
# A difference between neighbours is passed over where it moves no pixel by more than this share of the aim.
_PASSED_OVER: Final = 0.25
# What is left of differences may take this share of the square of the aim, an equal part at each size of cells.
_LEFT_SHARE: Final = 0.5
_LOOKED_AT: Final = 1 << 16  # cells that tell how many differ how much
# Halvings of points of wide lights that tell where light changes: the same for all rays, so that none of it is noise.
_ALIKE: Final = 1
_LARGEST_HEIGHT: Final = 1e100  # gray level; its square does not overflow, whatever the sensor's gain
# Variance of the mean over n x n strata of a cell that an edge of height d crosses is about d^2/(4 n^3): about 1.5 n
# strata are crossed, each with the variance d^2/6. Of the cells beside an edge about every third is crossed.
_EDGE_VARIANCE: Final = 12.0
# Where all that a pixel gathers from lies by so much of the range above saturation, the pixel stays saturated whatever
# a finer look would find there.
_SURELY_SATURATED: Final = 0.1


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


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Into which cells a part of the central image is cut.

    Attributes
    ----------
    first : tuple of int
        Row and column of the first grid cell.
    levels : ndarray of int, shape (rows, columns)
        For each grid cell how often the base cell was cut to come to the cell that it belongs to; one more where an
        edge crosses it, which asks for more rays.
    samples : int
        n; n x n rays in each of those. 0 where all is smooth, and no cell is needed.
    predicted_rms : float
        Error of an image that is gathered from these cells, as predicted from the differences [gray level].
    rays : int
        How many were traced to find out.
    """

    first: tuple[int, int]
    levels: NDArray[np.int8]
    samples: int
    predicted_rms: float
    rays: int


@dataclass(frozen=True, slots=True, eq=False)
class CentralImage:
    """Part of the central image on the grid.

    Attributes
    ----------
    first : tuple of int
        Row and column of the first grid cell.
    values : ndarray, shape (rows, columns) or (sources, rows, columns)
        Mean of L cos^4(theta) over each cell [W m^-2 sr^-1].
    magnification : ndarray, shape (rows, columns), optional
        m of each cell, see `Camera.magnification`.
    rays : int
        How many were traced.
    """

    first: tuple[int, int]
    values: NDArray[np.float64]
    magnification: NDArray[np.float64] | None
    rays: int


def decide_cells(
    view: View,
    plan: GridPlan,
    region: tuple[tuple[int, int], tuple[int, int]],
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
) -> Cells:
    """Find out where the central image changes, by rays that serve nothing else.

    A value that decided whether a cell is cut must not be the cell's own:
    what is cut where something was seen, and left where it was missed, would
    be too dark.

    Parameters
    ----------
    view : View
        Whose.
    plan : GridPlan
        How fine.
    region : tuple
        First row and column of grid cells that are needed, and how many; the cells hold at least these.
    seed : tuple of int
        Where the base grid lies, and where rays go in their cells.
    progress : callable
        Is told how many rays were traced.
    """
    if plan.even:
        return Cells(region[0], np.full(region[1], plan.levels, dtype=np.int8), 1, 0.0, 0)
    random = generator(*seed)
    step = 2**plan.levels
    # The base grid lies anywhere on the grid of cells; but where cells as large as pixels may be left although an edge
    # crosses them, they are the pixels: else all replicates would have in common what a pixel gets of its neighbours.
    first = tuple(start - (start % step if plan.smooth else int(random.integers(step))) for start in region[0])
    shape = tuple(
        -(-(start + size - begin) // step) for start, size, begin in zip(region[0], region[1], first, strict=True)
    )
    # One base cell more on each side: what is seen of a cell is told by its neighbours, which the outermost lack.
    shape = tuple(count + 2 for count in shape)
    sampler = _Sampler(view, plan, (first[0] - step, first[1] - step), progress, alike=True)
    rows, columns = np.indices(shape)
    places = sampler.places(rows.ravel(), columns.ravel(), step, random)
    values = sampler.trace([places], [step], with_depth=False)[0]
    values = values.reshape(shape)
    cut = []
    least = 0.0
    for level in range(plan.levels):
        spread = _spread_that_counts(plan, values, math.ldexp(plan.base, -level))
        least = max(least, _least_cut(plan, spread, math.ldexp(plan.base, -level)))
        cut.append(spread > least)
        row, column = _children(*np.nonzero(cut[-1]))
        values = _doubled(values)
        size = 2 ** (plan.levels - level - 1)
        places = sampler.places(row, column, size, random)
        values[row, column] = sampler.trace([places], [size], with_depth=False)[0]
    spread = _spread_that_counts(plan, values, plan.cell)
    cut.append(spread > max(least, _least_cut(plan, spread, plan.cell)))
    cut = [_within(mask, 2**level) for level, mask in enumerate(cut)]
    samples, predicted = _samples_needed(plan, _within(spread, step)[cut[-1]], cut[-1].size)
    return Cells((first[0], first[1]), _levels(cut), samples, predicted, sampler.rays)


def _within(values: NDArray[_T], rim: int) -> NDArray[_T]:
    """All but a rim so wide."""
    return values[rim:-rim, rim:-rim].copy()


def _least_cut(plan: GridPlan, spread: NDArray[np.float64], size: float) -> float:
    """Difference to neighbours from which on cells of a size are cut [gray level]."""
    each = plan.threshold(size)
    if plan.smooth is None:
        return each
    # Where few cells differ much, they may be left although each is off by more than the aim: the rms is what counts.
    some = np.sort(spread.ravel()[:: -(-spread.size // _LOOKED_AT)])
    may_be = (_LEFT_SHARE / (plan.levels + 1)) * plan.aim**2 * 12 * max(1.0, plan.area / size**2) * len(some)
    place = int(np.searchsorted(np.cumsum(np.minimum(some, _LARGEST_HEIGHT) ** 2), may_be, side="right"))
    return max(each, float(some[place - 1]) if place else 0.0)


def _levels(cut: list[NDArray[np.bool_]]) -> NDArray[np.int8]:
    """Level of each grid cell from what is cut at each level; what holds a cut cell is cut too."""
    for level in range(len(cut) - 1, 0, -1):
        rows, columns = cut[level - 1].shape
        cut[level - 1] |= cut[level].reshape(rows, 2, columns, 2).any(axis=(1, 3))
    levels = cut[0].astype(np.int8)
    for mask in cut[1:]:
        levels = _doubled(levels)
        levels[mask] += 1
    return levels


def central_image(
    view: View,
    plan: GridPlan,
    cells: Cells,
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
    like: CentralImage | None = None,
) -> CentralImage:
    """Trace part of the central image, each cell by rays anywhere in it.

    Parameters
    ----------
    view : View
        Whose.
    plan : GridPlan
        How fine.
    cells : Cells
        Where how many rays go.
    seed : tuple of int
        Decides the rays.
    progress : callable
        Is told how many rays were traced.
    like : CentralImage, optional
        Traced with the same plan, cells and seed, perhaps in other light: its magnifications are kept, so that the
        values are linear in the light.
    """
    random = generator(*seed)
    sampler = _Sampler(view, plan, cells.first, progress)
    parts = []
    for level in range(plan.levels + 1):
        size = 2 ** (plan.levels - level)
        row, column = np.nonzero(cells.levels[::size, ::size] == level)
        parts.append((row, column, size, 1))
    row, column = np.nonzero(cells.levels == plan.levels + 1)
    parts.append((row, column, 1, cells.samples))
    placed = [sampler.strata(row, column, size, n, random) for row, column, size, n in parts]
    sizes = [size / max(n, 1) for _, _, size, n in parts]
    traced = sampler.trace(placed, sizes, with_depth=plan.with_depth and like is None)
    shape = tuple(-(-size >> plan.levels) for size in cells.levels.shape)
    values, magnification = np.zeros((*traced[0].shape[:-1], *shape)), np.ones(shape)
    end = 0
    for level, (row, column, _, n) in enumerate(parts):
        if 0 < level <= plan.levels:
            values, magnification = _doubled(values), _doubled(magnification)
        start, end = end, end + len(row) * n * n
        means = _means(*(answer[..., start:end].reshape(*answer.shape[:-1], -1, n * n) for answer in traced))
        values[..., row, column], magnification[row, column] = means
    height, width = cells.levels.shape  # base cells of an even plan may reach beyond
    values, magnification = values[..., :height, :width], magnification[:height, :width]
    depth = like.magnification if like else magnification if plan.with_depth else None
    return CentralImage(cells.first, values, depth, sampler.rays)


def central_rays(plan: GridPlan, cells: Cells) -> int:
    """How many rays `central_image` will take."""
    if not cells.samples:
        return 0
    counts: list[int] = np.bincount(cells.levels.ravel(), minlength=plan.levels + 2).tolist()
    whole = sum(count // 4 ** (plan.levels - level) for level, count in enumerate(counts[:-1]))
    return int(whole + counts[-1] * cells.samples**2)


def _means(
    values: NDArray[np.float64], magnification: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean over each cell's rays, of each source; of m, weighted by the light of all."""
    if values.ndim == 2 and values.shape[1] == 1:  # most cells have one ray, and the mean of one is slow
        value, m = values[:, 0], magnification[:, 0]
        return value, np.where(value > 0, value * m / np.where(value > 0, value, 1.0), m)
    light = values if values.ndim == 2 else values.sum(axis=0)
    total = light.sum(axis=1)
    weighted = (light * magnification).sum(axis=1) / np.where(total > 0, total, 1.0)
    return values.mean(axis=-1), np.where(total > 0, weighted, magnification[:, 0])


def _doubled(values: NDArray[_T]) -> NDArray[_T]:
    return np.repeat(np.repeat(values, 2, axis=-2), 2, axis=-1)


def _children(row: NDArray[np.intp], column: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The four cells into which each cell is cut."""
    return (
        (2 * row[:, np.newaxis] + np.array([0, 0, 1, 1])).ravel(),
        (2 * column[:, np.newaxis] + np.array([0, 1, 0, 1])).ravel(),
    )


def _spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest less smallest value of each cell and its four neighbours."""
    high, low = values.copy(), values.copy()
    for most, extreme in ((high, np.maximum), (low, np.minimum)):
        # In place, from one neighbour after the other: most of the time would be that of new memory.
        for here, there in ((np.s_[1:], np.s_[:-1]), (np.s_[:-1], np.s_[1:])):
            extreme(most[here], values[there], out=most[here])
            extreme(most[:, here], values[:, there], out=most[:, here])
    high -= low
    return high


def _spread_that_counts(plan: GridPlan, values: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Spread of gray levels, 0 where each pixel that gathers from there is saturated.

    Parameters
    ----------
    plan : GridPlan
        How fine.
    values : ndarray, shape (rows, columns)
        Of cells [W m^-2 sr^-1].
    size : float
        Of a cell [px].
    """
    gray = plan.gray(values)
    spread = _spread(gray)
    sensor = plan.sensor
    enough = sensor.saturation_gray + _SURELY_SATURATED * (sensor.saturation_gray - sensor.dark_gray)
    if gray.max() > enough:
        from scipy.ndimage import minimum_filter

        # What a pixel gathers from here reaches as far again on its other side.
        reach = math.ceil(2 * math.sqrt(plan.area) / size)
        spread[minimum_filter(gray, 2 * reach + 1, mode="nearest") > enough] = 0.0
    return spread


def _samples_needed(plan: GridPlan, heights: NDArray[np.float64], cells: int) -> tuple[int, float]:
    """Fewest n of `SUB_SAMPLES` whose predicted rms error [gray level] meets the aim, and that error.

    A cell's error spreads over the pixels that gather from it, each of which
    takes cell^2/area of it.
    """
    # Sum over pixels of their squared weights of a cell, over the number of pixels: cell^2 is pixels a cell.
    share = (plan.cell**2 / plan.area) ** 2 * plan.area / (cells * plan.cell**2)
    # Beside an edge higher than the range a pixel is saturated but for that share of the edge's places.
    heights = np.minimum(heights, _LARGEST_HEIGHT)
    squares = heights * np.minimum(heights, plan.sensor.saturation_gray - plan.sensor.dark_gray)
    energy = float(squares.sum()) * share / _EDGE_VARIANCE
    rms = [math.sqrt(energy / n**3) for n in SUB_SAMPLES]
    for n, error in zip(SUB_SAMPLES, rms, strict=True):
        if error <= plan.aim:
            return n, error
    return SUB_SAMPLES[-1], rms[-1]


class _Sampler:
    """Rays through cells of a grid, at any level."""

    def __init__(
        self,
        view: View,
        plan: GridPlan,
        first: tuple[int, int],
        progress: Callable[[int], None],
        *,
        alike: bool = False,
    ) -> None:
        self._view, self._plan, self._progress, self._alike = view, plan, progress, alike
        self._first = first
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
        known = self._view.smooth if self._plan.smooth else None
        if known is None:
            return self._traced(view, u, v, with_depth=with_depth)
        smooth = known.holds(u, v)
        rest = ~smooth
        found, depth = known.at(u[smooth], v[smooth])
        values, magnification = np.empty((*found.shape[:-1], len(u))), np.empty(len(u))
        values[..., smooth], magnification[smooth] = found, depth
        if rest.any():
            values[..., rest], magnification[rest] = self._traced(view, u[rest], v[rest], with_depth=with_depth)
        return values, magnification

    def _traced(self, view: View, u: Array, v: Array, *, with_depth: bool) -> tuple[Array, Array]:
        answer = trace_rays(view, None, u, v, with_depth=with_depth)
        self.rays += len(u)
        self._progress(len(u))
        return answer
