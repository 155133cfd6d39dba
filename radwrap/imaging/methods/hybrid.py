"""A kernel everywhere, and rays of their own for the pixels where it errs.

Where pilot pairs differ, a pixel gets the mean difference of more such pairs
beside what the kernel gives it, or rays in its place, whichever takes fewer:
both are unbiased, whatever hides what. How many is decided by rays that are not
used for the value.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.demand import FEWEST, MOST
from radwrap.imaging.methods.depth_steps import cost_of_patches, cost_of_steps
from radwrap.imaging.methods.kernel import KernelPlan
from radwrap.imaging.methods.pairs import paired
from radwrap.imaging.methods.rays import (
    MEAN_GAIN,
    ORDER,
    RAYS_HELD,
    deviation_in_gray,
    level_of,
    numbers_that_saturate,
    rays_over,
    spare_rays,
)
from radwrap.imaging.optics.footprint import reach_px
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import gray_levels, unclipped_gray
from radwrap.random_streams import generator
from radwrap.scene.camera import Camera, Sensor

Array = NDArray[np.float64]

# Pairs of a pixel that decide what it gets: a few of each, and more where so few differ around it that the rms of all
# may be off by more than an eighth: what is seldom seen may be bright.
FIRST_PAIRS: Final = 8
PAIRS: Final = 32
_ENOUGH: Final = 16
# Deviations by which a mean of pairs, beside what the kernel gives, stays above zero.
_SAFE: Final = 4.0
_AROUND: Final = 2  # px to each side, whose pilot pairs are a pixel's too
_STEP: Final = 0.01  # of a radiance, over which Eq. 5 is straight
# Whether rays or pairs serve a pixel better hangs on how small its error is to be, and that on what serves the others.
_ROUNDS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What an even grid of central rays sees of a scene.

    Attributes
    ----------
    farthest : float
        Largest m that they met, of either sign; see `Camera.magnification`.
    cost : ndarray, shape (rows, columns)
        About what a kernel is off by at each, see `cost_on_grid` [gray level].
    """

    farthest: float
    cost: Array


@dataclass(frozen=True, slots=True)
class HybridPlan:
    """All that decides an image by kernel and corrections, the scene and the seed aside.

    Attributes
    ----------
    kernel : KernelPlan
        Of the image that is corrected.
    aim : float
        Rms error of the corrections of one replicate to aim at [gray level].
    least : float
        What a step in depth has to cost for pilot pairs to be traced; below 0 all pixels get them [gray level].
    left_out : float
        Rms of a pixel's pilot pairs up to which it is left to the kernel [gray level].
    seen : Seen
        Where there are steps; the survey's, which scene, camera and seed decide.
    fewest : int
        Rays or pairs of a corrected pixel at least, a power of 2.
    """

    kernel: KernelPlan
    aim: float
    least: float
    left_out: float
    seen: Seen = field(compare=False)
    fewest: int = FEWEST

    @property
    def camera(self) -> Camera:
        """The view."""
        return self.kernel.camera

    @property
    def tiles(self) -> tuple[tuple[int, int, int, int], ...]:
        """As the kernel's."""
        return self.kernel.tiles

    @property
    def reach_px(self) -> tuple[float, float]:
        """As the kernel's."""
        return self.kernel.reach_px

    @property
    def piloted(self) -> tuple[object, ...]:
        """What decides the pilot pairs, whatever the aim."""
        return self.camera, self.tiles, self.kernel.layers, self.least, self.left_out

    @property
    def pair_rays(self) -> int:
        """Rays of a pair."""
        return 1 + len(self.kernel.layers)


@dataclass(frozen=True, slots=True, eq=False)
class Needs:
    """What pilot pairs say of some pixels.

    Attributes
    ----------
    mean : ndarray
        Of the pixel's rays [W m^-2 sr^-1].
    spread : ndarray, shape (2, pixels)
        Standard deviation of a ray, and of a pair, there [W m^-2 sr^-1].
    deviation : ndarray, shape (2, pixels)
        The same in gray levels.
    due : ndarray of bool
        Whether it is corrected at all.
    """

    mean: Array
    spread: Array
    deviation: Array
    due: NDArray[np.bool_]

    def as_rows(self) -> NDArray[np.float32]:
        """As a file holds it, a row for each kind of number."""
        return np.vstack([self.mean, self.spread, self.deviation, self.due]).astype(np.float32)


def needs_of_rows(rows: NDArray[np.float32]) -> Needs:
    """Read what `Needs.as_rows` gave."""
    mean, *both, due = rows.astype(np.float64)
    return Needs(mean, np.stack(both[:2]), np.stack(both[2:]), due > 0)


def pilot(
    view: View, plan: HybridPlan, tile: int, seed: tuple[int, ...], progress: Callable[[int], None]
) -> tuple[Needs, int]:
    """What pilot pairs say of all pixels of a tile, and how many rays they took; parameters as in `corrections`."""
    r0, r1, c0, c1 = plan.tiles[tile]
    near, rays = _near_steps(view, plan, tile)
    progress(rays)
    pixels = np.flatnonzero(near)
    every = np.zeros((6, (r1 - r0) * (c1 - c0)), dtype=np.float32)
    if not pixels.size:
        return needs_of_rows(every), rays
    random, around = generator(*seed), partial(_summed, near, pixels)
    count = around(np.ones(len(pixels)))

    def traced(some: NDArray[np.intp], number: int) -> tuple[Array, Array]:
        """Values and differences of so many pairs of each pixel, shape (pixels, number)."""
        values, differences = np.empty((2, len(some), number))
        for part in _parts(len(some), number * plan.pair_rays):
            places = _places(plan, tile, some[part])
            values[part], differences[part] = _paired(view, plan, places, number, random)
            progress((part.stop - part.start) * number * plan.pair_rays)
        return values, differences

    first = traced(pixels, FIRST_PAIRS)
    alone = of_pairs(plan, *first)
    quiet = np.flatnonzero(around(alone.differing) < _ENOUGH)
    if quiet.size:
        rest = traced(pixels[quiet], PAIRS - FIRST_PAIRS)
        both = (np.concatenate([one[quiet], more], axis=1) for one, more in zip(first, rest, strict=True))
        alone = alone.at(quiet, of_pairs(plan, *both))
    # Whether a file was read or just written, the numbers are those that it holds.
    every[:, pixels] = alone.needs(plan, lambda each: np.sqrt(around(each**2) / count)).as_rows()
    pairs = len(pixels) * FIRST_PAIRS + len(quiet) * (PAIRS - FIRST_PAIRS)
    return needs_of_rows(every), rays + pairs * plan.pair_rays


def rays_of(signed: NDArray[np.intp], pair_rays: int) -> int:
    """Rays that corrections take."""
    return int(signed[signed > 0].sum()) - pair_rays * int(signed[signed < 0].sum())


def corrections(
    view: View,
    plan: HybridPlan,
    tile: int,
    signed: NDArray[np.intp],
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
) -> Array:
    """What a tile's pixels get beside the kernel's values, or in their place.

    Parameters
    ----------
    view : View
        Who traces.
    plan : HybridPlan
        What to do.
    tile : int
        Number of the tile.
    signed : ndarray of int, shape (rows, columns)
        Above 0: so many rays stand in the kernel's place. Below 0: so many pairs are added to it. 0: the kernel's.
    seed : tuple of int
        Decides all that is drawn.
    progress : callable
        Is told how many rays were traced.

    Returns
    -------
    ndarray, shape (rows, columns) or (sources, rows, columns)
        [W m^-2 sr^-1]; 0 where the kernel's values stand.
    """
    random = generator(*seed)
    found = None
    for number in np.unique(signed[signed != 0]).tolist():
        chosen = np.flatnonzero(signed == number)
        size, each = abs(number), number if number > 0 else -number * plan.pair_rays
        for part in _parts(len(chosen), each):
            some = chosen[part]
            places = _places(plan, tile, some)
            if number > 0:
                means = trace_rays(view, *rays_over(plan.camera, *places, size, random))[0]
                means = means.reshape(*means.shape[:-1], len(some), size).mean(axis=-1)
            else:
                means = _paired(view, plan, places, size, random)[1].mean(axis=-1)
            found = np.zeros((*means.shape[:-1], signed.size)) if found is None else found
            found[..., some] = means
            progress(len(some) * each)
    return np.zeros(signed.shape) if found is None else found.reshape(*found.shape[:-1], *signed.shape)


def corrected(values: Array, more: Array, signed: NDArray[np.intp]) -> Array:
    """The kernel's values with their corrections."""
    result: Array = np.where(signed > 0, more, values + more)
    return result


def _parts(count: int, each: int) -> list[slice]:
    """Of so many pixels with so many rays each, those that are traced at a time."""
    step = max(1, RAYS_HELD // each)
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def _places(plan: HybridPlan, tile: int, pixels: NDArray[np.intp]) -> tuple[Array, Array]:
    """Columns and rows on the sensor of a tile's pixels."""
    r0, _, c0, c1 = plan.tiles[tile]
    row, column = np.divmod(pixels, c1 - c0)
    return (column + c0).astype(np.float64), (row + r0).astype(np.float64)


def _paired(
    view: View, plan: HybridPlan, places: tuple[Array, Array], number: int, random: np.random.Generator
) -> tuple[Array, Array]:
    """Values and differences of so many pairs of pixels at some places, shape (..., pixels, number)."""
    u, v = places
    values, differences = (
        found.reshape(*found.shape[:-1], len(u), number)
        for found in paired(view, plan.kernel.layers, *rays_over(plan.camera, u, v, number, random))
    )
    return values, differences


def pilot_rays(plan: HybridPlan) -> int:
    """Rays that pilot pairs take at most, with those that tell where pairs are needed."""
    near = sum(near_share(plan, tile) * (tile[1] - tile[0]) * (tile[3] - tile[2]) for tile in plan.tiles)
    return math.ceil(near * (1 + PAIRS * plan.pair_rays))


def near_share(plan: HybridPlan, tile: tuple[int, int, int, int]) -> float:
    """Share of the pixels of a tile that may get pilot pairs, as far as the survey tells."""
    return float(_may_be_near(plan, np.arange(*tile[:2]), np.arange(*tile[2:])).mean())


def _may_be_near(plan: HybridPlan, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which pixels lie near steps in depth that matter, as far as the survey tells; also beside the sensor."""
    sensor, cost = plan.camera.sensor, plan.seen.cost
    places = (
        np.clip(at, 0, size - 1) * number // size
        for at, size, number in zip((rows, columns), (sensor.rows, sensor.columns), cost.shape, strict=True)
    )
    return (cost > plan.least)[np.ix_(*places)]


def _near_steps(view: View, plan: HybridPlan, tile: int) -> tuple[NDArray[np.bool_], int]:
    """Pixels of a tile, shape (rows, columns), that gather across a step in depth that matters; and rays for that.

    The survey's grid tells where that may be, and a ray of each pixel around tells it nearer.
    """
    r0, r1, c0, c1 = plan.tiles[tile]
    sensor = plan.camera.sensor
    if plan.least < 0:
        return np.ones((r1 - r0, c1 - c0), dtype=bool), 0
    near = _may_be_near(plan, np.arange(r0, r1), np.arange(c0, c1))
    if not near.any() or not is_looked_at_nearer(plan):
        return near, 0
    reach = _reach(plan)
    rows, columns = np.arange(r0 - reach[1], r1 + reach[1]), np.arange(c0 - reach[0], c1 + reach[0])
    asked = np.flatnonzero(_may_be_near(plan, rows, columns))
    v, u = (grid.ravel()[asked].astype(np.float64) for grid in np.meshgrid(rows, columns, indexing="ij"))
    values, found = trace_rays(view, None, u, v, with_depth=True)
    magnification, gray = np.full((2, len(rows), len(columns)), np.nan)
    magnification.flat[asked] = found
    gray.flat[asked] = gray_levels(values * view.exposure_of_radiance, sensor)
    far = [min(reach[1], len(rows) - 1), min(reach[0], len(columns) - 1)]
    nearer = cost_of_steps(plan.camera, magnification, gray, far)
    cut = nearer[reach[1] : len(rows) - reach[1], reach[0] : len(columns) - reach[0]]
    return near & (cut > plan.least), len(asked)


def is_looked_at_nearer(plan: HybridPlan) -> bool:
    """Whether rays of single pixels tell which of them lie near steps: the survey's grid is coarser."""
    return plan.least >= 0 and plan.seen.cost.shape != (plan.camera.sensor.rows, plan.camera.sensor.columns)


def are_near(view: View, plan: HybridPlan, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which of some pixels anywhere are found near steps where each is looked at, by a ray of each pixel around it."""
    across, down = _reach(plan)
    right, below = np.meshgrid(np.arange(-across, across + 1), np.arange(-down, down + 1))
    u, v = ((at[:, np.newaxis] + around.ravel()).astype(np.float64) for at, around in ((columns, right), (rows, below)))
    values, magnification = (
        found.reshape(u.shape) for found in trace_rays(view, None, u.ravel(), v.ravel(), with_depth=True)
    )
    gray = gray_levels(values * view.exposure_of_radiance, plan.camera.sensor)
    near: NDArray[np.bool_] = cost_of_patches(plan.camera, magnification, gray) > plan.least
    return near


def look_rays(plan: HybridPlan) -> int:
    """Rays of `are_near` for each pixel."""
    return math.prod(2 * far + 1 for far in _reach(plan))


def _reach(plan: HybridPlan) -> list[int]:
    """Columns and rows over which a pixel gathers, at most."""
    return [math.ceil(far) for far in reach_px(plan.camera, plan.seen.farthest)]


@dataclass(frozen=True, slots=True, eq=False)
class OfPairs:
    """What each pixel's own pilot pairs say.

    Attributes
    ----------
    mean : ndarray
        Of its rays [W m^-2 sr^-1].
    spread, deviation : ndarray, shape (2, pixels)
        As of `Needs`.
    off : ndarray
        Root mean square of its pairs [gray level].
    differing : ndarray
        How many of them differ by more than what is left to the kernel.
    """

    mean: Array
    spread: Array
    deviation: Array
    off: Array
    differing: Array

    def at(self, some: NDArray[np.intp], other: OfPairs) -> OfPairs:
        """The same with what others say at some pixels."""
        both = ((getattr(self, each.name).copy(), getattr(other, each.name)) for each in fields(self))
        changed = []
        for own, others in both:
            own[..., some] = others
            changed.append(own)
        return OfPairs(*changed)

    def needs(self, plan: HybridPlan, pooled: Callable[[Array], Array]) -> Needs:
        """Judge pixels.

        Parameters
        ----------
        plan : HybridPlan
            What is planned.
        pooled : callable
            Root mean square of each pixel and those around it: few pairs may miss what a pixel sees.
        """
        spread, deviation = (np.stack([pooled(each) for each in both]) for both in (self.spread, self.deviation))
        return Needs(self.mean, spread, deviation, pooled(self.off) > plan.left_out)


def of_pairs(plan: HybridPlan, values: Array, differences: Array) -> OfPairs:
    """What pilot pairs of some pixels say, each by itself.

    Parameters
    ----------
    plan : HybridPlan
        What is planned.
    values, differences : ndarray, shape (pixels, pairs)
        As `paired` gives them.
    """
    scale, sensor = plan.kernel.grid.exposure_of_radiance, plan.camera.sensor
    count, mean = values.shape[1], values.mean(axis=1)
    of_rays, of_differences = spread = [found.std(axis=1, ddof=1) for found in (values, differences)]
    slope = slope_in_gray(mean, of_differences / count**0.5, scale, sensor)
    deviation = deviation_in_gray(mean, of_rays, count, scale, sensor), slope * of_differences
    off = slope * np.sqrt((differences**2).mean(axis=1))
    differing = (slope[:, np.newaxis] * np.abs(differences) > plan.left_out).sum(axis=1).astype(np.float64)
    return OfPairs(mean, np.stack(spread), np.stack(deviation), off, differing)


def slope_in_gray(mean: Array, error: Array, scale: float, sensor: Sensor) -> Array:
    """Of Eq. 5 at means that may be off by so much [gray level per W m^-2 sr^-1]; 0 where a pixel saturates.

    A few pairs may differ by many times what the sensor can show, to either side: their own gray levels tell nothing.
    """
    at = np.maximum(mean, np.maximum(error, np.finfo(float).tiny))
    up, down = (unclipped_gray(at * (1 + side) * scale, sensor) for side in (_STEP, -_STEP))
    saturates = gray_levels(mean * scale, sensor) >= sensor.saturation_gray
    slope: Array = np.where(saturates, 0.0, (up - down) / (2 * _STEP * at))
    return slope


def signed_numbers(plan: HybridPlan, found: Needs, count: float) -> NDArray[np.intp]:
    """Rays or pairs of each pixel, see `corrections`, so that the rms over `count` pixels meets the aim."""
    signed = np.zeros(len(found.due), dtype=np.intp)
    if not found.due.any():
        return signed
    of_rays, of_pairs = found.deviation[:, found.due]
    errors = np.zeros(max(round(count), len(signed)))
    by_rays = of_rays < of_pairs
    for _ in range(_ROUNDS):
        errors[: len(by_rays)] = np.where(by_rays, _error_of_rays(of_rays, plan.fewest), of_pairs / plan.fewest**0.5)
        level = level_of(errors, plan.aim)
        rays = np.clip((MEAN_GAIN * of_rays / level) ** (1 / ORDER), plan.fewest, MOST)
        pairs = np.clip((of_pairs / level) ** 2, plan.fewest, MOST)
        # A mean of rays is never below zero.
        dark = found.mean[found.due] < _SAFE * found.spread[1, found.due] / pairs**0.5
        by_rays = dark | (rays <= plan.pair_rays * pairs)
    numbers = (2 ** np.rint(np.log2(np.where(by_rays, rays, pairs)))).astype(np.intp)
    numbers = np.maximum(numbers, spare_rays(numbers, plan.fewest))
    scale, sensor = plan.kernel.grid.exposure_of_radiance, plan.camera.sensor
    ray_spread, pair_spread = found.spread[:, found.due]
    scatter = np.where(by_rays, ray_spread, pair_spread)
    numbers = np.maximum(numbers, numbers_that_saturate(found.mean[found.due], scatter, plan.fewest, scale, sensor))
    signed[found.due] = np.where(by_rays, numbers, -numbers)
    return signed


def _error_of_rays(deviation: Array, number: int) -> Array:
    error: Array = MEAN_GAIN * deviation * number**-ORDER
    return error


def _summed(near: NDArray[np.bool_], pixels: NDArray[np.intp], each: Array) -> Array:
    """Sum over each pixel and those around it that have a value."""
    framed = np.zeros(tuple(size + 2 * _AROUND for size in near.shape))
    inside = np.zeros(near.size)
    inside[pixels] = each
    framed[_AROUND:-_AROUND, _AROUND:-_AROUND] = inside.reshape(near.shape)
    return np.asarray(_around(framed).ravel()[pixels])


def _around(framed: Array) -> Array:
    """Sum over each value and those around it; the frame's values have none.

    Each by itself, and not as `around.sum_around` does: beside a glint cumulated sums would lose small squares.
    """
    width = 2 * _AROUND + 1
    for axis in (0, 1):
        framed = np.lib.stride_tricks.sliding_window_view(framed, width, axis=axis).sum(axis=-1)
    return framed
