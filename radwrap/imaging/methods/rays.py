"""Pixel and opening integrated together: scrambled Sobol points over four dimensions, as many as each pixel needs.

Unbiased in the radiant exposure whatever the scene: how many rays a pixel gets
is decided by rays that are not used for its value.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.demand import FEWEST, MOST
from radwrap.imaging.methods.sobol import DIMENSIONS, scrambled_points
from radwrap.imaging.optics.aperture import place, turn
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.random_streams import generator
from radwrap.scene.camera import Camera, Sensor

PILOT: Final = 8  # rays of a pixel that decide how many it gets
LOOKS: Final = 16  # the same, where they decide for several images: what they miss is missed in all
# The error of a mean over n scrambled points falls like n^-0.6 at edges (between n^-0.5 of chance and n^-0.75 of two
# dimensions); 64 to 256 rays on rad_scenes/bench_board gave 0.57.
ORDER: Final = 0.6
MEAN_GAIN: Final = 0.8  # that error over the deviation of a ray, extrapolated to n = 1: 0.6 to 1 on random scenes
# The same of walks, which are chance. Pixels whose pilots missed what is bright get too few: on rad_scenes/white_tent
# the error is 1.2 times what the deviations say; with 1.1 a tenth of the tolerance is left to spare.
ORDER_OF_WALKS: Final = 0.5
GAIN_OF_WALKS: Final = 1.1
_SPARE: Final = 1 / 16  # of the mean pixel's rays, which every pixel gets
# Standard deviations by which a pixel's mean stays above saturation, and the most rays for it: those with which one
# whose pilot saw it a deviation above saturation is safe.
_SAFE: Final = 4.0
_MOST_SATURATED: Final = 256
RAYS_HELD: Final = 1 << 18  # 30 MiB
_TILE_PIXELS: Final = 1 << 14


@dataclass(frozen=True, slots=True)
class RaysPlan:
    """All that decides an image by rays, the scene and the seed aside.

    Attributes
    ----------
    camera : Camera
        The view.
    exposure_of_radiance : float
        tau A/f^2.
    aim : float
        Rms error of one replicate to aim at [gray level].
    tiles : tuple
        First row, last row + 1, first column, last column + 1 of each tile [px].
    fewest : int
        Rays of a pixel at least, a power of 2.
    even : int, optional
        Rays of every pixel, whatever is seen there; a power of 2.
    walks : bool, optional
        True where the view's rays go on as walks, see `View`.
    """

    camera: Camera
    exposure_of_radiance: float
    aim: float
    tiles: tuple[tuple[int, int, int, int], ...]
    fewest: int = FEWEST
    even: int | None = field(default=None, metadata=ONLY_WHERE_USED)
    walks: bool | None = field(default=None, metadata=ONLY_WHERE_USED)

    @property
    def pilot(self) -> int:
        """Rays of a pixel that decide how many it gets."""
        return max(PILOT, self.fewest // 2)


@dataclass(frozen=True, slots=True, eq=False)
class TracedTile:
    """A tile of an image by rays.

    Attributes
    ----------
    values : ndarray, shape (rows, columns) or (sources, rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
    numbers : ndarray of int, shape (rows * columns,)
        Rays of each pixel.
    rays : int
        How many were traced in all.
    """

    values: NDArray[np.float64]
    numbers: NDArray[np.intp]
    rays: int


def plan_rays(view: View, aim: float, fewest: int = FEWEST, *, even: int | None = None) -> RaysPlan:
    """Cut the sensor into bands of rows; `even` is the number of rays of every pixel, where no light decides it."""
    sensor = view.camera.sensor
    step = max(1, _TILE_PIXELS // sensor.columns)
    tiles = tuple((first, min(first + step, sensor.rows), 0, sensor.columns) for first in range(0, sensor.rows, step))
    return RaysPlan(view.camera, view.exposure_of_radiance, aim, tiles, fewest, even, view.walks or None)


def traced_tile(
    view: View,
    plan: RaysPlan,
    tile: int,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
    *,
    numbers: NDArray[np.intp] | None = None,
) -> TracedTile:
    """Mean of L cos^4(theta) over pixel and opening for each pixel of a tile.

    Parameters
    ----------
    view : View
        Who traces.
    plan : RaysPlan
        What to do.
    tile : int
        Number of the tile.
    seed : tuple of int
        Decides all that is drawn.
    progress : callable
        Is told how many rays were traced.
    numbers : ndarray of int, optional
        Rays of each pixel, as they were found for the same tile and seed, perhaps in other light: the very same rays
        are traced.
    """
    r0, r1, c0, c1 = plan.tiles[tile]
    shape = (r1 - r0, c1 - c0)
    rows, columns = np.indices(shape)
    u, v = (columns + c0).ravel().astype(np.float64), (rows + r0).ravel().astype(np.float64)
    random = generator(*seed)
    rays = 0
    if plan.even is not None:
        numbers = np.full(len(u), plan.even, dtype=np.intp)
    elif numbers is None:
        pilot = sampled_radiance(view, u, v, plan.pilot, random)
        rays = len(u) * plan.pilot
        progress(rays)
        numbers = _numbers(plan, pilot if pilot.ndim == 2 else pilot.sum(axis=0), shape)
    else:
        _keys(len(u), random)
    values: NDArray[np.float64] | None = None
    for number in np.unique(numbers).tolist():
        chosen = np.flatnonzero(numbers == number)
        step = max(1, RAYS_HELD // number)
        for start in range(0, len(chosen), step):
            part = chosen[start : start + step]
            means = sampled_radiance(view, u[part], v[part], number, random).mean(axis=-1)
            values = np.empty((*means.shape[:-1], len(u))) if values is None else values
            values[..., part] = means
            progress(len(part) * number)
    assert values is not None  # noqa: S101  (a tile has pixels)
    return TracedTile(values.reshape(*values.shape[:-1], *shape), numbers, int(numbers.sum()) + rays)


def rays_of_pixels(
    view: View, plan: RaysPlan, tile: int, seed: tuple[int, ...], progress: Callable[[int], None]
) -> NDArray[np.intp]:
    """Rays of each pixel of a tile, for several images, which have none of the rays that decide it."""
    r0, r1, c0, c1 = plan.tiles[tile]
    rows, columns = np.indices((r1 - r0, c1 - c0))
    u, v = (columns + c0).ravel().astype(np.float64), (rows + r0).ravel().astype(np.float64)
    seen = sampled_radiance(view, u, v, LOOKS, generator(*seed))
    progress(len(u) * LOOKS)
    return _numbers(plan, seen if seen.ndim == 2 else seen.sum(axis=0), (r1 - r0, c1 - c0))


def sampled_radiance(
    view: View, u: NDArray[np.float64], v: NDArray[np.float64], number: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """L cos^4(theta) along `number` rays over each pixel (u, v) and the opening, shape (pixels, number).

    Where the view's tracer tells sources apart, shape (sources, pixels, number).
    """
    opening, places_u, places_v = rays_over(view.camera, u, v, number, random)
    values, _ = trace_rays(view.together(number), opening, places_u, places_v)
    return values.reshape(*values.shape[:-1], len(u), number)


def rays_over(
    camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64], number: int, random: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Points of the opening, shape (pixels * number, 2) [m], and places (u, v) on the sensor [px], for each ray."""
    points = scrambled_points(_keys(len(u), random), number)
    if camera.aperture.is_infinitesimal:
        opening = np.zeros((points.shape[0] * number, 2))
    else:
        opening = place(camera.aperture, points[..., 2].ravel(), points[..., 3].ravel())
        opening = opening @ turn(camera.aperture.rotation).T
    window = camera.sensor.window
    inside = points if window is None else window.places(points[..., :2]) + 0.5
    return (
        opening,
        (u[:, np.newaxis] + inside[..., 0] - 0.5).ravel(),
        (v[:, np.newaxis] + inside[..., 1] - 0.5).ravel(),
    )


def _keys(pixels: int, random: np.random.Generator) -> NDArray[np.uint32]:
    """Keys of each pixel's stream of points."""
    return random.integers(0, 2**32, (pixels, DIMENSIONS), dtype=np.uint32)


def gray_deviation(radiance: NDArray[np.float64], plan: RaysPlan) -> NDArray[np.float64]:
    """Standard deviation of one ray of each pixel, in gray levels through Eq. 5."""
    mean, deviation = radiance.mean(axis=1), radiance.std(axis=1, ddof=1)
    return deviation_in_gray(mean, deviation, radiance.shape[1], plan.exposure_of_radiance, plan.camera.sensor)


def deviation_in_gray(
    mean: NDArray[np.float64], deviation: NDArray[np.float64], number: int, scale: float, sensor: Sensor
) -> NDArray[np.float64]:
    """Standard deviations of radiance [W m^-2 sr^-1] in gray levels, where so many values told the mean.

    `scale` is the view's `exposure_of_radiance`.
    """
    # Of a mean, not of a ray, which would leave the range in which Eq. 5 is nearly straight.
    step = deviation / number**ORDER
    up, down = (gray_levels(np.maximum(mean + sign * step, 0.0) * scale, sensor) for sign in (1, -1))
    deviations: NDArray[np.float64] = (up - down) / 2 * number**ORDER
    return deviations


def _numbers(plan: RaysPlan, pilot: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Rays of each pixel, so that the rms over the tile meets the aim; all pixels' errors are brought to one level."""
    deviation = pooled(gray_deviation(pilot, plan).reshape(shape)).ravel()
    gain, order = (GAIN_OF_WALKS, ORDER_OF_WALKS) if plan.walks else (MEAN_GAIN, ORDER)
    level = level_of(gain * deviation * plan.fewest**-order, plan.aim)
    wanted = (gain * deviation / level) ** (1 / order)
    powers = 2 ** np.rint(np.log2(np.clip(wanted, plan.fewest, MOST)))
    numbers: NDArray[np.intp] = powers.astype(np.intp)
    mean, scatter = pilot.mean(axis=1), pooled(pilot.std(axis=1, ddof=1).reshape(shape)).ravel()
    saturated = numbers_that_saturate(mean, scatter, plan.fewest, plan.exposure_of_radiance, plan.camera.sensor)
    enough: NDArray[np.intp] = np.maximum(np.maximum(numbers, spare_rays(numbers, plan.fewest)), saturated)
    return enough


def spare_rays(numbers: NDArray[np.intp], fewest: int) -> int:
    """Rays that each pixel gets: where a pilot saw nothing change, some more, which cost little, find an edge."""
    return max(fewest, int(2 ** math.floor(math.log2(max(1.0, _SPARE * float(numbers.mean()))))))


def numbers_that_saturate(
    mean: NDArray[np.float64], deviation: NDArray[np.float64], fewest: int, scale: float, sensor: Sensor
) -> NDArray[np.intp]:
    """Rays with which a pixel that saturates does not fall below saturation by chance; else the fewest.

    Eq. 5 hides the scatter of such pixels' rays, and a mean of too few of them
    is far off now and then. What lies within the pilot's own deviation of
    saturation is seen by `gray_deviation`.
    """
    saturates = gray_levels(mean * scale, sensor) >= sensor.saturation_gray
    numbers = np.full(len(mean), fewest, dtype=np.intp)
    number = fewest
    while number < _MOST_SATURATED and saturates.any():
        lowest = np.maximum(mean - _SAFE * deviation / number**ORDER, 0.0)
        saturates &= gray_levels(lowest * scale, sensor) < sensor.saturation_gray
        number *= 2
        numbers[saturates] = number
    return numbers


def level_of(largest: NDArray[np.float64], aim: float) -> float:
    """The error at which a pixel is left, so that the rms of min(largest, level) is the aim."""
    ordered = np.sort(largest)
    below = np.concatenate([[0.0], np.cumsum(ordered**2)])[:-1]
    count = len(ordered)
    # With the level at each pixel's own error in turn; the rms grows from one to the next.
    squares = below + ordered**2 * np.arange(count, 0, -1)
    place = int(np.searchsorted(squares, aim**2 * count))
    if place == count:
        return float(max(ordered[-1], aim))
    return float(np.sqrt(max((aim**2 * count - below[place]) / (count - place), 0.0)))


def pooled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Root mean square of each value and its eight neighbours: few rays may miss what a pixel sees."""
    squares = values**2
    for axis in (0, 1):
        squares = np.moveaxis(squares, axis, 0)
        framed = np.concatenate([squares[:1], squares, squares[-1:]])
        squares = np.moveaxis((framed[:-2] + framed[2:] + squares) / 3, 0, axis)
    return np.asarray(np.sqrt(squares))
