"""What the truth is at some pixels, by rays of its own, and how far an image is off there.

Two independent means a, b of scrambled Sobol rays over pixel and opening stand
for the truth t. Their noise is no error of the image k: the mean of
(a - k)(b - k) is the mean of (t - k)^2, for a's noise and b's have nothing to
do with each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.methods.rays import PILOT, gray_deviation, plan_rays, sampled_radiance
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import PixelErrors, PixelSample, places_of, root
from radwrap.random_streams import Trading, generator

# Shares of the pixels, by how much their rays differ, and of the sample: nearly all error lies where rays differ.
_STRATA: Final = ((0.1, 0.5), (0.2, 0.25), (0.7, 0.25))
# Pixels among which the sample is drawn, for each of the sample.
_LOOKED_AT: Final = 16
_RAYS_AT_ONCE: Final = 1 << 18  # 30 MiB
_FEWEST_PIXELS, _MOST_PIXELS = 16, 1_000_000
_FEWEST_RAYS, _MOST_RAYS = 16, 1 << 20
_QUANTILE: Final = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Two independent values of the gray level at some pixels.

    Attributes
    ----------
    sample : PixelSample
        Where.
    first, second : ndarray, shape (n,)
        Gray level before rounding, clipped at saturation.
    rays : int
        What it took.
    seed : int
        Of all that was drawn.
    """

    sample: PixelSample
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    rays: int
    seed: int

    @property
    def rms_gray(self) -> float:
        """Rms error of the mean of both over the image [gray level]."""
        return math.sqrt(float((self.sample.weights * (self.first - self.second) ** 2).sum()) / 4)


@dataclass(frozen=True, slots=True)
class Distance:
    """How far an image is from the truth [gray level].

    Attributes
    ----------
    rms_gray : float
        Rms error over the image, without the reference's own noise.
    rms_gray_upper : float
        Its one-sided 97.5 % bound, for what the sample of pixels did not see.
    p99_gray : float
        99 % of the pixels are off by less, as seen at the sample.
    max_gray : float
        Largest error seen at the sample; among all pixels it may be larger.

    Notes
    -----
    The noise is taken from the square of each pixel's error, which leaves
    quantile and maximum too large rather than too small: they pick out the
    pixels where noise happened to be large.
    """

    rms_gray: float
    rms_gray_upper: float
    p99_gray: float
    max_gray: float


def check_reference(pixels: int, rays: int) -> None:
    """Refuse numbers of pixels and rays that make no reference.

    Raises
    ------
    InputError
        If one is out of range.
    """
    for name, value, low, high in (
        ("reference_pixels", pixels, _FEWEST_PIXELS, _MOST_PIXELS),
        ("reference_rays", rays, _FEWEST_RAYS, _MOST_RAYS),
    ):
        if not low <= value <= high:
            raise InputError(f"must lie between {low} and {high}, not {value}", where=name)


def take_reference(
    view: View, *, pixels: int, rays: int, seed: int, progress: Callable[[int], None] | None = None
) -> Reference:
    """Trace the reference at pixels drawn in strata, more where rays of a pixel differ.

    Parameters
    ----------
    view : View
        The camera, and who traces.
    pixels : int
        How many are drawn; all where the sensor has not more.
    rays : int
        Rays of each of the two values.
    seed : int
        Of all that is drawn.
    progress : callable, optional
        Is told how many rays were traced.

    Raises
    ------
    InputError
        If the numbers are out of range.
    """
    check_reference(pixels, rays)
    tell = progress or (lambda _: None)
    sample, spent = drawn_sample(view, pixels, seed)
    tell(spent)
    u, v = places_of(sample.pixels, view.camera.sensor.columns)
    random = generator(seed, Trading.RAYS)
    values = np.empty((2, len(u)))
    step = max(1, _RAYS_AT_ONCE // rays)
    for which in range(2):
        for start in range(0, len(u), step):
            part = slice(start, start + step)
            values[which, part] = sampled_radiance(view, u[part], v[part], rays, random).mean(axis=1)
            tell(rays * len(u[part]))
    first, second = gray_levels(values * view.exposure_of_radiance, view.camera.sensor)
    return Reference(sample, first, second, spent + 2 * rays * len(u), seed)


def drawn_sample(view: View, count: int, seed: int) -> tuple[PixelSample, int]:
    """Pixels in strata of how much a few rays of each differ in gray level, and the rays that took."""
    sensor = view.camera.sensor
    if sensor.pixels <= count:
        return PixelSample(np.arange(sensor.pixels), np.zeros(sensor.pixels, dtype=np.intp), np.ones(1)), 0
    random = generator(seed, Trading.PIXELS)
    looked = random.choice(sensor.pixels, min(sensor.pixels, _LOOKED_AT * count), replace=False, shuffle=False)
    v, u = np.divmod(looked.astype(np.float64), sensor.columns)
    pilot = sampled_radiance(view, u, v, PILOT, generator(seed, Trading.PILOT))
    order = looked[np.argsort(-gray_deviation(pilot, plan_rays(view, 1.0)), kind="stable")]
    bounds = np.rint(np.cumsum([0.0, *(share for share, _ in _STRATA)]) * len(order)).astype(int)
    chosen = [
        random.choice(order[low:high], min(round(part * count), high - low), replace=False)
        for low, high, (_, part) in zip(bounds[:-1], bounds[1:], _STRATA, strict=True)
    ]
    stratum = np.repeat(np.arange(len(_STRATA)), [len(part) for part in chosen])
    return PixelSample(np.concatenate(chosen), stratum, np.diff(bounds) / len(order)), pilot.size


def distance(reference: Reference, gray: NDArray[np.float64]) -> Distance:
    """How far gray levels are off.

    Parameters
    ----------
    reference : Reference
        The truth.
    gray : ndarray, shape (n,)
        Gray levels of the image at the reference's pixels, before rounding and clipped at saturation.
    """
    errors = PixelErrors(reference.first - gray, reference.second - gray, 0)
    square = errors.mean_square(reference.sample, (reference.seed, Trading.RESAMPLES))
    sizes = np.sqrt(np.maximum(errors.first * errors.second, 0.0))
    order = np.argsort(sizes)
    below = np.cumsum(reference.sample.weights[order])
    place = min(int(np.searchsorted(below, _QUANTILE)), len(order) - 1)
    return Distance(root(square.mean), root(square.upper), float(sizes[order[place]]), float(sizes.max()))


def reference_as_json(reference: Reference) -> dict[str, Any]:
    """All of a reference as plain lists and numbers; floats come back to the last bit."""
    sample = reference.sample
    arrays = {"pixels": sample.pixels, "stratum": sample.stratum, "shares": sample.shares}
    values = {"first": reference.first, "second": reference.second}
    lists = {name: array.tolist() for name, array in {**arrays, **values}.items()}
    return {**lists, "rays": reference.rays, "seed": reference.seed}


def reference_from_json(found: dict[str, Any]) -> Reference:
    """The reference that `reference_as_json` wrote."""
    sample = PixelSample(
        np.array(found["pixels"], dtype=np.intp), np.array(found["stratum"], dtype=np.intp), np.array(found["shares"])
    )
    return Reference(sample, np.array(found["first"]), np.array(found["second"]), found["rays"], found["seed"])
