"""A rehearsal: some of an image is made as all of it will be, and timed.

No constant of another machine, and no guess at how rays hang together, enters
a forecast: the very functions that will make the image make some tiles of it,
by as many workers at a time, at places all over it. What they made is thrown
away. Clocks decide how much is rehearsed, and nothing of the image.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.depth_steps import nearest, steps
from radwrap.imaging.methods.hybrid import HybridPlan, near_share
from radwrap.imaging.methods.kernel import KernelPlan
from radwrap.imaging.methods.rays import RaysPlan
from radwrap.imaging.methods.viewpoints import ViewpointPlan
from radwrap.imaging.optics.view import View, pixel_means, ray_blocks, trace_rays, traced
from radwrap.imaging.response.sensor import GrayWhereAsked
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded
from radwrap.imaging.tolerance.certificate import draw_pixels, model_errors
from radwrap.imaging.tolerance.corrected_replicates import decide_plan, make_plan
from radwrap.imaging.tolerance.planner import EFFORTS, Search
from radwrap.imaging.tolerance.plans import RISK_SHARE, kernel_of
from radwrap.imaging.tolerance.replicates import Plan, Replicates, Work, block_of, discretisation
from radwrap.imaging.tolerance.survey import AIM_SHARE, surveyed_places
from radwrap.process import children_cpu_time
from radwrap.random_streams import Rendering, generator

_LONG_ENOUGH: Final = 0.05  # s, beside which the start of a program is small
_FEWEST_RAYS, _MOST_RAYS = 256, 1 << 15
_RUN: Final = 32  # rays that lie side by side
# A tile takes so long at most in one thread, or some of it stands for it: how many rays a tile gets hangs on all of it.
LONGEST_TILE: Final = 2.0  # s
# Tiles are made until so long has passed, and so many at least unless they are slow.
_ENOUGH: Final = 0.5  # s
_TOO_LONG: Final = 2.0  # s
_FEWEST_TILES: Final = 4
_CANDIDATES: Final = 16
# So much of what another pixel takes, one takes that gathers from smooth blocks only: 0.1 to 0.2 of the ring cell.
_SMOOTH_SHARE: Final = 0.15
# Threads of Python wait for each other: 1.04 to 1.18 of their processor time over their number, measured on the ring
# and on two bars.
_SHARED: Final = 1.15
# Of the square of the tolerance the model may take so much for sure: images are made with an aim of 0.75 of it. And
# above so much it fails: noise took a quarter of the certificates of the cells.
_HOLDS: Final = 1 - AIM_SHARE**2
_FAILS: Final = 0.75
_STRIP: Final = 1 << 16  # px
# A pixel that may be corrected takes so many times what one of the kernel's takes.
_CORRECTED_TIMES: Final = 10.0


@dataclass(frozen=True, slots=True)
class Rehearsed:
    """What all of an image is expected to take, by some of it.

    Attributes
    ----------
    seconds : float
        Time [s].
    rays : float
        How many.
    """

    seconds: float
    rays: float


class Stopwatch:
    """Time that work takes on a machine that does nothing else, also where this one does.

    Work for several threads takes its processor time shared among them, and a little more, where that is less than
    the time that passed: other programs then had the processor meanwhile.

    Parameters
    ----------
    workers : int
        Threads or programs at a time.
    """

    def __init__(self, workers: int = 1) -> None:
        self._share = (1.0 if workers == 1 else _SHARED) / workers
        self._wall, self._cpu = _clocks()

    def lap(self) -> float:
        """Time since the last lap [s]."""
        (wall, cpu), before = _clocks(), (self._wall, self._cpu)
        self._wall, self._cpu = wall, cpu
        return min(wall - before[0], (cpu - before[1]) * self._share)


def _clocks() -> tuple[float, float]:
    return time.monotonic(), time.process_time() + children_cpu_time()


def timed(work: Callable[[], object], workers: int = 1) -> float:
    """How long something takes [s]; see `Stopwatch`."""
    clock = Stopwatch(workers)
    work()
    return clock.lap()


def _time_per_ray(trace: Callable[[int], object]) -> float:
    """Time of one of many rays [s]: ever more are traced, until their start does not count."""
    number = _FEWEST_RAYS
    while True:
        seconds = timed(partial(trace, number))
        if seconds >= _LONG_ENOUGH or number >= _MOST_RAYS:
            return seconds / number
        number *= 4


def seconds_per_ray(view: View) -> float:
    """Time a central ray takes in one thread [s]; runs of them side by side, as those of an image."""
    alone = replace(view, workers=1)

    def trace(number: int) -> None:
        v, u = np.divmod(_runs(view.camera.sensor.pixels, number), view.camera.sensor.columns)
        trace_rays(alone, None, u.astype(np.float64), v.astype(np.float64))

    return _time_per_ray(trace)


def _runs(pixels: int, number: int) -> NDArray[np.intp]:
    """So many pixels, in runs all over the image; some of them twice where it is small."""
    starts = np.linspace(0, max(pixels - _RUN, 0), number // _RUN).astype(np.intp)
    return (starts[:, np.newaxis] + np.arange(_RUN)).ravel() % pixels


def rehearsed_viewpoints(view: View, plan: ViewpointPlan) -> Rehearsed:
    """What tracing all sub-viewpoints takes, by some rays of one of them."""
    at = (float(plan.viewpoints.positions[0, 0]), float(plan.viewpoints.positions[0, 1]))

    def trace(number: int) -> None:
        pixels = _runs(plan.camera.sensor.pixels, max(_RUN, number // plan.pixel_plan.rays // _RUN * _RUN))
        for block, radiance in traced(view.tracer.trace, ray_blocks(plan.camera, at, plan.pixel_plan, 0, pixels)):
            pixel_means(block, radiance)

    return Rehearsed(plan.rays * _time_per_ray(trace) / view.workers, plan.rays)


def rehearsed(work: Work, plan: Plan, number: int, expected: float, longest: float = LONGEST_TILE) -> Rehearsed:
    """What so many replicates of all tiles take, by some tiles.

    Parameters
    ----------
    work : Work
        Where and by whom; the folder is for the rehearsal only.
    plan : KernelPlan or RaysPlan
        Of the whole image.
    number : int
        How many replicates.
    expected : float
        Rays that all of them are expected to take: as near as that, tiles are cut to what can be made in short time.
    longest : float
        That short time, for a tile in one thread [s].
    """
    sensor = plan.camera.sensor
    per_pixel = max(expected / (number * sensor.pixels), 1 / sensor.pixels)
    tiles = _samples(work.view, plan, longest / (seconds_per_ray(work.view) * per_pixel))
    at_once = min(len(plan.tiles), 2 * work.view.workers)
    deciding = making = rays = weight = 0.0
    begun, done = time.monotonic(), 0
    clock = Stopwatch(work.view.workers)
    while done < len(tiles) and (done < _FEWEST_TILES or time.monotonic() - begun < _ENOUGH):
        some = _with_tiles(plan, tuple(tiles[done : done + at_once]))
        decide_plan(work, some)
        deciding += clock.lap()
        rays += make_plan(work, some, 1)
        making += clock.lap()
        weight += sum(_weight(work.view, plan, tile) for tile in some.tiles)
        done += at_once
    often = sum(_weight(work.view, plan, tile) for tile in plan.tiles) / weight
    seconds = often * (deciding + making * number)
    traced_rays = often * rays * number
    if _is_even(plan):
        return Rehearsed(seconds, expected)
    if isinstance(plan, RaysPlan) and not set(tiles[:done]) <= set(plan.tiles):
        # A pixel gets rays by what others of its tile need: those of cut tiles say how long a ray takes, not how many.
        return Rehearsed(seconds * expected / traced_rays, expected)
    return Rehearsed(seconds, traced_rays)


def _is_even(plan: Plan) -> bool:
    """Whether the number of rays is known beforehand."""
    kernel = kernel_of(plan)
    return bool(kernel.grid.even if kernel else isinstance(plan, RaysPlan) and plan.even)


def _with_tiles(plan: Plan, tiles: tuple[tuple[int, int, int, int], ...]) -> Plan:
    """The plan for some tiles only."""
    if isinstance(plan, HybridPlan):
        return replace(plan, kernel=replace(plan.kernel, tiles=tiles))
    return replace(plan, tiles=tiles)


def _samples(view: View, plan: Plan, most: float) -> list[tuple[int, int, int, int]]:
    """Tiles, or parts of them of so many pixels at most, in such an order that the first few stand for all."""
    tiles = sorted(plan.tiles, key=lambda tile: _weight(view, plan, tile) / _pixels(tile))
    largest = max(map(_pixels, tiles))
    if largest <= most:
        return [tiles[place] for place in spread(len(tiles))]
    random = generator(0, Rendering.REHEARSED_TILES)
    share = math.sqrt(most / largest)
    several = tiles * -(-_CANDIDATES // len(tiles))
    several.sort(key=lambda tile: _weight(view, plan, tile) / _pixels(tile))
    return [_part(several[place], share, random) for place in spread(len(several))]


def _part(tile: tuple[int, int, int, int], share: float, random: np.random.Generator) -> tuple[int, int, int, int]:
    """Some of a tile, anywhere in it, so much smaller each way."""
    cut = []
    for first, last in (tile[:2], tile[2:]):
        size = max(1, round((last - first) * share))
        begin = first + int(random.integers(last - first - size + 1))
        cut += [begin, begin + size]
    return cut[0], cut[1], cut[2], cut[3]


def spread(number: int) -> list[int]:
    """All numbers below one, the first few of them evenly spread (van der Corput)."""
    bits = max(1, (number - 1).bit_length())
    turned = (int(f"{place:0{bits}b}"[::-1], 2) for place in range(1 << bits))
    order = [place for place in turned if place < number]
    return order[1:] + order[:1]  # the least of all stands for few


def for_a_while(number: int) -> Iterator[int]:
    """Numbers below one, evenly spread, until what is done with them has told enough."""
    begun = time.monotonic()
    for done, place in enumerate(spread(number)):
        passed = time.monotonic() - begun
        if passed > _TOO_LONG or (done >= _FEWEST_TILES and passed > _ENOUGH):
            return
        yield place


def _pixels(tile: tuple[int, int, int, int]) -> int:
    return (tile[1] - tile[0]) * (tile[3] - tile[2])


def _weight(view: View, plan: Plan, tile: tuple[int, int, int, int]) -> float:
    """What making a tile takes, relative to others: the pixels that it gathers from, and of smooth ones a share."""
    kernel = kernel_of(plan)
    if kernel is None:
        return float(_pixels(tile))
    columns, rows = (far + 2 * kernel.grid.cell for far in kernel.reach_px)
    spans = (tile[0] - rows, tile[1] + rows), (tile[2] - columns, tile[3] + columns)
    area = (spans[0][1] - spans[0][0]) * (spans[1][1] - spans[1][0])
    if view.smooth is not None and kernel.grid.smooth:
        rough = 1 - view.smooth.share_of(*spans)
        area *= _SMOOTH_SHARE + (1 - _SMOOTH_SHARE) * rough
    if isinstance(plan, HybridPlan):
        area += _CORRECTED_TIMES * near_share(plan, tile) * _pixels(tile)
    return area


@dataclass(frozen=True, slots=True)
class Look:
    """What a look at the kernel's model found, made as its certificate is.

    Attributes
    ----------
    square : Bounded
        Mean square of what the model lacks [gray level^2].
    seconds : float
        What a certificate takes for that [s]: one effort where that is clear, else two.
    holds : bool
        Whether the model is expected to hold.
    """

    square: Bounded
    seconds: float
    holds: bool


def look_at_model(work: Work, search: Search, plan: KernelPlan) -> Look:
    """Hold the kernel's model against pairs of rays, at pixels drawn by what a grid of points sees, not the image.

    The survey draws pixels anywhere, and few of them lie at steps in depth; a
    certificate looks there first, and so does this.
    """
    view, found, camera = work.view, search.found, plan.camera
    if camera.aperture.is_infinitesimal:
        return Look(NOTHING, 0.0, holds=True)
    clock = Stopwatch(view.workers)
    sensor = camera.sensor
    shape = (sensor.rows, sensor.columns)
    numbers = found.magnification.shape
    seen = trace_rays(view, None, *surveyed_places(sensor))[0].reshape(numbers)
    radiance = seen[np.ix_(*nearest(shape, numbers))]
    gray = GrayWhereAsked(radiance, view.exposure_of_radiance, sensor)
    risky = steps(camera, found.magnification, gray, RISK_SHARE * search.demand.tolerance)
    pixels, even, near = EFFORTS[0]
    key = (search.work.seed, Rendering.REHEARSED_TILES)
    sample = draw_pixels(gray, pixels, key, risky=risky, pairs=(even, near))
    clock.lap()
    errors = model_errors(view, plan.layers, sample, radiance.ravel()[sample.pixels], seed=key)
    square, seconds = errors.mean_square(sample, key), clock.lap()
    wanted = search.demand.tolerance**2
    if square.mean > _FAILS * wanted:
        return Look(square, seconds, holds=False)
    if square.upper <= _HOLDS * wanted:
        return Look(square, seconds, holds=True)
    first, second = (count * each for count, each, _ in EFFORTS[:2])
    return Look(square, seconds * (1 + second / first), holds=True)


def comparison_seconds(work: Work, plan: Plan, number: int) -> float:
    """What comparing so many replicates takes [s]."""
    sensor, block = plan.camera.sensor, block_of(plan)
    rows = min(sensor.rows, max(-(-_STRIP // sensor.columns), 8 * block[0]))
    images = np.ones((number, rows, sensor.columns), dtype=np.float32)
    # Which radiance does not matter where no light is collected.
    strip = Replicates(images / (work.view.exposure_of_radiance or 1.0), np.zeros_like(images[0]), 0, 0, block)
    return timed(lambda: (strip.mean, discretisation(work.view, strip))) * sensor.rows / rows
