"""An image that is the sum of images at instants: what each counts in each row, and how far the sum is off.

An instant's gray levels are proportional to light: its error is then one of radiant exposure, and errors of light add
up as light does. Of the errors of all instants it is not known how much they have in common, so that only the noise of
their rays is taken to be independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.response.linear_light import gray_bound
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.time_steps import Steps
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
# Rows that are rendered together at least: a narrower strip costs as much.
_FEWEST_ROWS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class AtInstant:
    """The image of some rows at one instant.

    Attributes
    ----------
    exposure : ndarray, shape (some rows, columns)
        Radiant exposure if the instant lasted for the exposure time [J m^-2].
    error : Certificate
        How far gray levels may be off that are proportional to it.
    gain : float
        Gray levels over radiant exposure [m^2 J^-1].
    first : int
        First of the rows.
    """

    exposure: Array
    error: Certificate
    gain: float
    first: int


Instants = Callable[[Steps, int], AtInstant]


@dataclass(frozen=True, slots=True, eq=False)
class Summed:
    """An image of instants.

    Attributes
    ----------
    steps : sequence of Steps
        The instants.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    motion : float
        What the time between the instants may add, rms [gray level].
    """

    steps: Sequence[Steps]
    exposure: Array
    motion: float


def summed(steps: Sequence[Steps], instants: Instants, sensor: Sensor, check: Callable[[], None]) -> Summed:
    """The image of all instants, and what leaving out every second one of them would change.

    Parameters
    ----------
    steps : sequence of Steps
        Of each light.
    instants : callable
        The image at an instant.
    sensor : Sensor
        Whose gray levels count.
    check : callable
        Asked now and then; it raises to end the work.
    """
    fine, coarse = _composed(steps, instants, sensor, check)
    square = float(np.mean((gray_levels(fine, sensor) - gray_levels(coarse, sensor)) ** 2))
    if sensor.gamma == 1:  # else it is not known what the noise makes of gray levels; it is counted elsewhere
        square -= (sensor.gain * _noise_of_difference(steps, instants)) ** 2
    return Summed(steps, fine, math.sqrt(max(square, 0.0)))


def _composed(
    steps: Sequence[Steps], instants: Instants, sensor: Sensor, check: Callable[[], None]
) -> tuple[Array, Array]:
    """Radiant exposure of all instants, and of every second one [J m^-2]."""
    fine, coarse = np.zeros((2, sensor.rows, sensor.columns))
    for number, one in counted(steps):
        check()
        image = instants(one, number)
        light = image.exposure
        rows = slice(image.first, image.first + len(light))
        fine[rows] += one.weights[rows, number, np.newaxis] * light
        coarse[rows] += one.without_every_second[rows, number, np.newaxis] * light
    return fine, coarse


def _noise_of_difference(steps: Sequence[Steps], instants: Instants) -> float:
    """What noise of rays makes of the difference between all instants and every second one, rms [J m^-2]."""
    squares = []
    for number, one in counted(steps):
        image = instants(one, number)
        weights = one.weights[:, number] - one.without_every_second[:, number]
        noise = image.error.discretisation_rms_gray / image.gain
        squares.append(float(np.mean(weights**2)) * noise**2)
    return math.sqrt(math.fsum(squares))


def strip_of(first: int, last: int, rows: int) -> tuple[int, int]:
    """Some more rows where there are few."""
    spare = max(_FEWEST_ROWS - (last - first), 0)
    first = max(0, first - spare // 2)
    return first, min(rows, max(last, first + _FEWEST_ROWS))


def counted(steps: Sequence[Steps]) -> Iterator[tuple[int, Steps]]:
    """Instants that count in any row."""
    for one in steps:
        yield from ((number, one) for number in range(len(one.times)) if one.rows_of(number) is not None)


def slack(steps: Steps) -> float:
    """By how much the error of a light is larger than that of its instants, if they have all of it in common."""
    squares = math.fsum(math.prod(_share(steps, number)) for number, _ in counted([steps]))
    return math.sqrt(_total(steps) * squares)


def _total(steps: Steps) -> float:
    """Largest sum of weights of any row."""
    return float(steps.weights.sum(axis=1).max())


def _share(steps: Steps, number: int) -> tuple[float, float]:
    """Largest weight of an instant, and the share of the image's rows in which it is rendered."""
    rows = len(steps.weights)
    first, last = strip_of(*(steps.rows_of(number) or (0, 0)), rows)
    return float(steps.weights[:, number].max()), (last - first) / rows


@dataclass(frozen=True, slots=True)
class _LightError:
    """Errors of radiant exposure that the instants of one light leave, rms over the image [J m^-2].

    Attributes
    ----------
    common, upper : float
        Estimate and bound of what they may have in common.
    noise : float
        Of their own rays.
    pixels, rays : int
        What their certificates took.
    """

    common: float
    upper: float
    noise: float
    pixels: int
    rays: int


def _error_of(steps: Steps, instants: Instants) -> _LightError:
    """Errors of one light.

    Of weights w_k and errors e_k of the instants: (sum w_k e_k)^2 <= (sum w_k) sum w_k e_k^2 for what they have in
    common, and sum w_k^2 n_k^2 for the noise n_k of rays of their own. What is not known of each e_k^2, as it was
    looked for at some pixels by some rays, is independent, as each instant has draws of its own: squares add up. Not so
    what bands and waves may add, which is no matter of chance.
    """
    common, unknown, noise = [], [], []
    chance = True
    pixels = rays = 0
    for number, image in ((number, instants(steps, number)) for number, _ in counted([steps])):
        weight = float(steps.weights[:, number].max())
        found, gain = image.error, image.gain
        pixels, rays = pixels + found.certificate_pixels, rays + found.certificate_rays
        # Of a strip that was rendered with more rows than count, all of its error may lie in those that do.
        share = len(image.exposure) / len(steps.weights)
        square = (found.discretisation_rms_gray / gain) ** 2
        noise.append(weight**2 * share * square)
        common.append(weight * share * max((found.rms_gray / gain) ** 2 - square, 0.0))
        unknown.append(weight * share * (found.rms_gray_upper95**2 - found.rms_gray**2) / gain**2)
        chance = chance and found.bands_gray is None and found.diffraction_gray is None
    total, known = _total(steps), math.fsum(common)
    more = math.hypot(*unknown) if chance else math.fsum(unknown)
    middle, bound = (math.sqrt(total * square) for square in (known, known + more))
    return _LightError(middle, bound, math.sqrt(math.fsum(noise)), pixels, rays)


def certificate_of_sum(made: Summed, instants: Instants, sensor: Sensor) -> Certificate:
    """How far gray levels may be off: what lights have in common adds up, their noise is independent."""
    exposure, error = made.exposure, made.motion
    lights = [_error_of(one, instants) for one in made.steps]
    noise = math.hypot(*(light.noise for light in lights))
    common, upper = (math.fsum(getattr(light, name) for light in lights) for name in ("common", "upper"))
    middle, bound = (gray_bound(math.hypot(part, noise), exposure, sensor) for part in (common, upper))
    return Certificate(
        rms_gray=math.hypot(middle, error),
        rms_gray_upper95=math.hypot(bound, error),
        p99_gray_upper95=None,
        model_rms_gray=gray_bound(common, exposure, sensor),
        discretisation_rms_gray=gray_bound(noise, exposure, sensor),
        certificate_pixels=sum(light.pixels for light in lights),
        certificate_rays=sum(light.rays for light in lights),
        method="instants",
        motion_gray=error if any(len(one.times) > 1 for one in made.steps) else None,
    )
