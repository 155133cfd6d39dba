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
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.grid import GridPlan, Sampler
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.optics.view import View
from radwrap.random_streams import generator

_T = TypeVar("_T", bound=np.generic)
SUB_SAMPLES: Final = (1, 2, 4, 8)
# What is left of differences may take this share of the square of the aim, an equal part at each size of cells.
_LEFT_SHARE: Final = 0.5
_LOOKED_AT: Final = 1 << 16  # cells that tell how many differ how much
_LARGEST_HEIGHT: Final = 1e100  # gray level; its square does not overflow, whatever the sensor's gain
_LARGEST_KEPT: Final = 1e38  # gray level, of a number of 4 byte
# Variance of the mean over n x n strata of a cell that an edge of height d crosses is about d^2/(4 n^3): about 1.5 n
# strata are crossed, each with the variance d^2/6. Of the cells beside an edge about every third is crossed.
_CROSSED_VARIANCE: Final = 4.0
_EDGE_VARIANCE: Final = 3 * _CROSSED_VARIANCE
# The same of a cell with one ray, wherever in it the edge lies: d^2/6. Heights up to some limit that are all alike
# frequent have a third of the limit's square on the average.
_UNCUT_VARIANCE: Final = 18.0
# Where all that a pixel gathers from lies by so much of the range above saturation, the pixel stays saturated whatever
# a finer look would find there.
_SURELY_SATURATED: Final = 0.1


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
    heights : ndarray, shape (n,), optional
        How much what is seen differs at each cell that an edge crosses, by rows [gray level].
    """

    first: tuple[int, int]
    levels: NDArray[np.int8]
    samples: int
    predicted_rms: float
    rays: int
    heights: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, dtype=np.float32))

    def with_rays(self, finest: int, sampling: EdgeSampling) -> Cells:
        """The same, with so many rays in those cells that an edge crosses; `finest` is the level of the others."""
        levels = self.levels.copy()
        row, column = np.nonzero(levels > finest)
        few = self.heights <= sampling.passed_over
        levels[row[few], column[few]] = finest
        samples = sampling.samples if self.samples else 0
        return replace(self, levels=levels, samples=samples, heights=self.heights[~few])


@dataclass(frozen=True, slots=True)
class EdgeSampling:
    """How many rays cells get that an edge crosses, the same for several tiles.

    Attributes
    ----------
    samples : int
        n; n x n rays in each of them,
    passed_over : float
        but one where what is seen differs by no more than that [gray level].
    """

    samples: int
    passed_over: float


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
    smooth: SmoothField | None = None,
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
    smooth : SmoothField, optional
        Where nothing changes but smoothly; default what the plan has of the view.
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
    sampler = Sampler(view, plan, (first[0] - step, first[1] - step), progress, alike=True, smooth=smooth)
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
    heights = np.minimum(_within(spread, step)[cut[-1]], _LARGEST_KEPT).astype(np.float32)
    samples, predicted = _samples_needed(plan, heights.astype(np.float64), cut[-1].size)
    found = Cells((first[0], first[1]), _levels(cut), samples, predicted, sampler.rays, heights)
    return found.with_rays(plan.levels, _edges_alone(plan, heights, samples)) if plan.edges else found


def _within(values: NDArray[_T], rim: int) -> NDArray[_T]:
    """All but a rim so wide."""
    return values[rim:-rim, rim:-rim].copy()


def _least_cut(plan: GridPlan, spread: NDArray[np.float64], size: float) -> float:
    """Difference to neighbours from which on cells of a size are cut [gray level]."""
    each = plan.threshold(size)
    if plan.smooth is None:
        return each
    most = math.inf
    if plan.edges:
        most = max(each, math.sqrt(_UNCUT_VARIANCE) * plan.aim * max(1.0, math.sqrt(plan.area) / size) ** 1.5)
    # Where few cells differ much, they may be left although each is off by more than the aim: the rms is what counts.
    some = np.sort(spread.ravel()[:: -(-spread.size // _LOOKED_AT)])
    may_be = (_LEFT_SHARE / (plan.levels + 1)) * plan.aim**2 * 12 * max(1.0, plan.area / size**2) * len(some)
    place = int(np.searchsorted(np.cumsum(np.minimum(some, _LARGEST_HEIGHT) ** 2), may_be, side="right"))
    return min(max(each, float(some[place - 1]) if place else 0.0), most)


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
    smooth: SmoothField | None = None,
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
    smooth : SmoothField, optional
        Where no rays go, in the light of the view; default what the plan has of it.
    """
    with_depth = plan.with_depth and like is None
    traced = traced_cells(view, plan, cells, seed=seed, progress=progress, with_depth=with_depth, smooth=smooth)
    depth = like.magnification if like else traced.laid_out(traced.magnification) if plan.with_depth else None
    return CentralImage(cells.first, traced.laid_out(traced.values), depth, traced.rays)


@dataclass(frozen=True, slots=True, eq=False)
class TracedCells:
    """Cells of part of the central image, from the largest to the smallest, each with what was seen of it.

    Attributes
    ----------
    places : list of tuple of ndarray of int
        Of each size, rows and columns in cells of that size; the grid's own cells come twice, as those with more rays
        are apart.
    shape : tuple of int
        Rows and columns of grid cells.
    values : ndarray, shape (n,) or (sources, n)
        Mean of L cos^4(theta) over each cell [W m^-2 sr^-1].
    magnification : ndarray, shape (n,)
        m of each, see `Camera.magnification`; 1 where it was not asked for.
    rays : int
        How many were traced.
    """

    places: list[tuple[NDArray[np.intp], NDArray[np.intp]]]
    shape: tuple[int, int]
    values: NDArray[np.float64]
    magnification: NDArray[np.float64]
    rays: int

    @property
    def numbers(self) -> NDArray[np.intp]:
        """Which of them covers each grid cell, shape (rows, columns)."""
        return self.laid_out(np.arange(len(self.magnification)))

    def laid_out(self, each: NDArray[_T]) -> NDArray[_T]:
        """What is known of each, shape (..., n), as a field of grid cells, shape (..., rows, columns)."""
        levels = len(self.places) - 2
        field = np.zeros((*each.shape[:-1], *(-(-size >> levels) for size in self.shape)), dtype=each.dtype)
        end = 0
        for level, (row, column) in enumerate(self.places):
            if 0 < level <= levels:
                field = _doubled(field)
            start, end = end, end + len(row)
            field[..., row, column] = each[..., start:end]
        height, width = self.shape  # base cells of an even plan may reach beyond
        return field[..., :height, :width]


def traced_cells(
    view: View,
    plan: GridPlan,
    cells: Cells,
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
    with_depth: bool,
    smooth: SmoothField | None = None,
) -> TracedCells:
    """Trace cells of the central image, as `central_image` does; `with_depth` their magnifications too."""
    random = generator(*seed)
    sampler = Sampler(view, plan, cells.first, progress, smooth=smooth)
    parts = []
    for level in range(plan.levels + 1):
        size = 2 ** (plan.levels - level)
        row, column = np.nonzero(cells.levels[::size, ::size] == level)
        parts.append((row, column, size, 1))
    row, column = np.nonzero(cells.levels == plan.levels + 1)
    parts.append((row, column, 1, cells.samples))
    placed = [sampler.strata(row, column, size, n, random) for row, column, size, n in parts]
    sizes = [size / max(n, 1) for _, _, size, n in parts]
    traced = sampler.trace(placed, sizes, with_depth=with_depth)
    means, end = [], 0
    for row, _, _, n in parts:
        start, end = end, end + len(row) * n * n
        means.append(_means(*(answer[..., start:end].reshape(*answer.shape[:-1], -1, n * n) for answer in traced)))
    values, magnification = (np.concatenate(each, axis=-1) for each in zip(*means, strict=True))
    height, width = cells.levels.shape
    places = [(row, column) for row, column, _, _ in parts]
    return TracedCells(places, (height, width), values, magnification, sampler.rays)


def central_rays(plan: GridPlan, cells: Cells) -> int:
    """How many rays `central_image` will take."""
    if not cells.samples:
        return 0
    counts: list[int] = np.bincount(cells.levels.ravel(), minlength=plan.levels + 2).tolist()
    whole = sum(count // 4 ** (plan.levels - level) for level, count in enumerate(counts[:-1]))
    return int(whole + counts[-1] * cells.samples**2)


def edge_sampling(plan: GridPlan, tiles: Sequence[tuple[Cells, float]]) -> EdgeSampling:
    """Fewest rays in cells that edges cross, by which tiles of so many pixels meet the aim together.

    A tile without edges leaves its share to the others, and cells where little
    differs leave theirs to those where much does: so these need fewer rays than
    each for itself.
    """
    heights = np.concatenate([cells.heights.astype(np.float64) for cells, _ in tiles])
    pixels = sum(number for _, number in tiles)
    weights = [np.full(len(cells.heights), number / pixels / cells.levels.size) for cells, number in tiles]
    order = np.argsort(heights, kind="stable")
    heights = heights[order]
    energy = _energies(plan, heights) * np.concatenate(weights)[order]
    of_lowest = np.concatenate([[0.0], np.cumsum(energy)])
    found, least = EdgeSampling(SUB_SAMPLES[-1], 0.0), math.inf
    for n in range(1, SUB_SAMPLES[-1] + 1):
        with_all = of_lowest[-1] / n**3
        if with_all > plan.aim**2:
            continue
        # How many of the lowest may have one ray each.
        gained = (of_lowest - of_lowest / n**3) + with_all
        few = int(np.searchsorted(gained, plan.aim**2, side="right")) - 1 if n > 1 else len(heights)
        if few < len(heights):
            few = int(np.searchsorted(heights, heights[few]))  # all that are as high have as many
        if (rays := (len(heights) - few) * (n**2 - 1)) < least:
            found, least = EdgeSampling(n, float(heights[few - 1]) if few else 0.0), rays
    return found


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
    energy = float(_energies(plan, heights).sum()) / cells
    rms = [math.sqrt(energy / n**3) for n in SUB_SAMPLES]
    for n, error in zip(SUB_SAMPLES, rms, strict=True):
        if error <= plan.aim:
            return n, error
    return SUB_SAMPLES[-1], rms[-1]


def _edges_alone(plan: GridPlan, heights: NDArray[np.float32], samples: int) -> EdgeSampling:
    """Rays by which pixels that edges go through meet the aim by themselves: `samples` or more, or one.

    A place or a length averages a frame's noise over the pixels of an edge, and what these are off likewise. So errors
    that are small beside the noise on the average of an image, but gather at its edges, move it by more than a frame
    shows. High edges are what is measured: they count by their squares.
    """
    # Of the cells that an edge crosses in a pixel each is 1/across^2 of it.
    across = math.sqrt(plan.area) / plan.cell
    squares = _squares(plan, heights.astype(np.float64)) / (_CROSSED_VARIANCE * plan.aim**2 * across**3)
    high = squares > 1
    if not high.any():
        return EdgeSampling(samples, 0.0)
    typical = float(squares[high] @ (squares[high] / squares[high].sum()))
    n = min(max(samples, math.ceil(typical ** (1 / 3))), SUB_SAMPLES[-1])
    return EdgeSampling(n, float(heights[~high].max(initial=0.0)) if samples == 1 else 0.0)


def _energies(plan: GridPlan, heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums, over all pixels that gather from it, of the squared errors that a ray in each cell of a height makes.

    Over the number of pixels in an area of as many cells as there are, that is the mean square [gray level^2].
    """
    # Sum over pixels of their squared weights of a cell, over the number of pixels: cell^2 is pixels a cell.
    share = (plan.cell**2 / plan.area) ** 2 * plan.area / plan.cell**2
    return _squares(plan, heights) * (share / _EDGE_VARIANCE)


def _squares(plan: GridPlan, heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squares of heights of edges, as far as pixels show them [gray level^2]."""
    # Beside an edge higher than the range a pixel is saturated but for that share of the edge's places.
    heights = np.minimum(heights, _LARGEST_HEIGHT)
    squares: NDArray[np.float64] = heights * np.minimum(heights, plan.sensor.saturation_gray - plan.sensor.dark_gray)
    return squares
