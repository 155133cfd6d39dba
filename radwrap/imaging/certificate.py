"""How far the gray levels of an image are off, measured with rays of its own.

Two ways. A kernel's model error is the mean of differences of PAIRED rays:
one through a point of the opening, and those through its centre that the
kernel takes in its place; equal where the model holds, so that few rays tell
much. Any image can be held against independent rays over pixel and opening:
two means a, b of them give (a - k)(b - k), whose mean is the squared error of
k. All on gray levels before rounding, clipped at saturation.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.bounds import Bounded, stratified_mean
from radwrap.imaging.kernel import layer_shares
from radwrap.imaging.rays import rays_over, sampled_radiance
from radwrap.imaging.sensor import gray_levels
from radwrap.imaging.view import View, trace_rays
from radwrap.scene.camera import Sensor

# Shares of the pixels, by how much gray changes around them, and of the sample: nearly all error lies at edges.
_STRATA: Final = ((0.1, 0.5), (0.2, 0.25), (0.7, 0.25))
_FEWEST_IN_STRATUM: Final = 8
_LOOKED_AT: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Certificate:
    """How far gray levels may be off.

    Attributes
    ----------
    rms_gray : float
        Estimate of the rms error over the image [gray level].
    rms_gray_upper95 : float
        Bound that holds in 95 of 100 images.
    p99_gray_upper95 : float or None
        Bound of the error that 99 % of the pixels stay below.
    model_rms_gray : float
        Part of the estimate that comes from the method's model.
    discretisation_rms_gray : float
        Part that comes from the finite number of rays.
    certificate_pixels, certificate_rays : int
        What the certificate took.
    method : str
        "pairs and replicates", "replicates" or "independent rays".
    """

    rms_gray: float
    rms_gray_upper95: float
    p99_gray_upper95: float | None
    model_rms_gray: float
    discretisation_rms_gray: float
    certificate_pixels: int
    certificate_rays: int
    method: str

    def as_manifest(self) -> dict[str, Any]:
        """The manifest's ``error``."""
        return asdict(self)


def root(mean_square: float) -> float:
    """Root of an unbiased mean square, which may be below zero."""
    return math.sqrt(max(mean_square, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class PixelSample:
    """Pixels drawn in strata.

    Attributes
    ----------
    pixels : ndarray of int
        Numbers, row by row.
    stratum : ndarray of int
        Of each.
    shares : ndarray of float
        Share of each stratum in the image.
    """

    pixels: NDArray[np.intp]
    stratum: NDArray[np.intp]
    shares: NDArray[np.float64]

    def places(self, columns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns and rows of the pixels [px]."""
        v, u = np.divmod(self.pixels, columns)
        return u.astype(np.float64), v.astype(np.float64)


def draw_pixels(gray: NDArray[np.float64], count: int, seed: tuple[int, ...]) -> PixelSample:
    """Draw pixels, more where gray changes; all of them where there are not more than `count`."""
    number = gray.size
    if number <= count:
        return PixelSample(np.arange(number), np.zeros(number, dtype=np.intp), np.ones(1))
    random = np.random.default_rng(seed)
    # Of a large image some pixels, drawn evenly, stand for all.
    drawn = random.choice(number, min(number, _LOOKED_AT), replace=False, shuffle=False)
    order = drawn[np.argsort(-_change(gray, drawn), kind="stable")]
    bounds = np.rint(np.cumsum([0.0, *(share for share, _ in _STRATA)]) * len(order)).astype(int)
    chosen = [
        random.choice(order[first:last], min(max(round(part * count), _FEWEST_IN_STRATUM), last - first), replace=False)
        for first, last, (_, part) in zip(bounds[:-1], bounds[1:], _STRATA, strict=True)
    ]
    stratum = np.repeat(np.arange(len(_STRATA)), [len(pixels) for pixels in chosen])
    return PixelSample(np.concatenate(chosen), stratum, np.diff(bounds) / len(order))


def _change(gray: NDArray[np.float64], pixels: NDArray[np.intp]) -> NDArray[np.float64]:
    """How much gray changes from each pixel to the next ones."""
    row, column = np.divmod(pixels, gray.shape[1])
    here = gray[row, column]
    change = np.zeros(len(pixels))
    for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        there = gray[np.clip(row + down, 0, gray.shape[0] - 1), np.clip(column + right, 0, gray.shape[1] - 1)]
        np.maximum(change, np.abs(there - here), out=change)
    return change


@dataclass(frozen=True, slots=True, eq=False)
class PixelErrors:
    """Two independent, unbiased values of the error at each pixel of a sample, in gray levels.

    Attributes
    ----------
    first, second : ndarray, shape (n,)
        Of what the image lacks; first-order in their noise.
    rays : int
        How many were traced.
    """

    first: NDArray[np.float64]
    second: NDArray[np.float64]
    rays: int

    def mean_square(self, sample: PixelSample, seed: tuple[int, ...]) -> Bounded:
        """Mean square over the image."""
        return stratified_mean(self.first * self.second, sample.stratum, sample.shares, seed)


def model_errors(
    view: View,
    layers: tuple[float, ...],
    sample: PixelSample,
    radiance: NDArray[np.float64],
    *,
    pairs: int,
    seed: tuple[int, ...],
) -> PixelErrors:
    """What the kernel's model lacks at some pixels, in gray levels.

    Parameters
    ----------
    view, layers, sample, pairs, seed
        As in `model_lacks`.
    radiance : ndarray, shape (n,)
        The image's mean radiance at the sample, through which Eq. 5 is taken.
    """
    lacks, rays = model_lacks(view, layers, sample, pairs=pairs, seed=seed)
    return lacks_in_gray(radiance, lacks, rays, view.exposure_of_radiance, view.camera.sensor)


def lacks_in_gray(
    radiance: NDArray[np.float64], lacks: NDArray[np.float64], rays: int, exposure_of_radiance: float, sensor: Sensor
) -> PixelErrors:
    """Two values of what is lacking, shape (2, n) [W m^-2 sr^-1], through Eq. 5 at the image's radiance."""
    first, second = (_in_gray(radiance, radiance + lack, exposure_of_radiance, sensor) for lack in lacks)
    return PixelErrors(first, second, rays)


def model_lacks(
    view: View, layers: tuple[float, ...], sample: PixelSample, *, pairs: int, seed: tuple[int, ...]
) -> tuple[NDArray[np.float64], int]:
    """What the kernel's model lacks at some pixels, by paired rays; linear in the sources.

    Parameters
    ----------
    view : View
        The camera, and who traces.
    layers : tuple of float
        The kernel's magnifications.
    sample : PixelSample
        Where.
    pairs : int
        Pairs for each of the two values.
    seed : tuple of int
        Of all that is drawn.

    Returns
    -------
    lacks : ndarray, shape (2, n)
        Two independent values of what is lacking [W m^-2 sr^-1].
    rays : int
        How many were traced.
    """
    u, v = sample.places(view.camera.sensor.columns)
    lacks = []
    random = np.random.default_rng(seed)
    rays = 0
    for _ in range(2):
        opening, places_u, places_v = rays_over(view.camera, u, v, pairs, random)
        difference, _ = trace_rays(view, opening, places_u, places_v)
        for number, layer in enumerate(layers):
            central, magnification = trace_rays(
                view,
                np.zeros((1, 2)),
                places_u + layer * opening[:, 0] / view.camera.sensor.pixel_width,
                places_v + layer * opening[:, 1] / view.camera.sensor.pixel_height,
                with_depth=len(layers) > 1,
            )
            difference -= central * layer_shares(layers, magnification)[number]
        rays += (1 + len(layers)) * difference.size
        lacks.append(difference.reshape(len(u), pairs).mean(axis=1))
    return np.stack(lacks), rays


def independent_errors(
    view: View, sample: PixelSample, radiance: NDArray[np.float64], *, rays: int, seed: tuple[int, ...]
) -> PixelErrors:
    """What an image lacks at some pixels, by independent rays over pixel and opening; parameters as `model_errors`."""
    u, v = sample.places(view.camera.sensor.columns)
    random = np.random.default_rng(seed)
    values = [sampled_radiance(view, u, v, rays, random).mean(axis=1) for _ in range(2)]
    scale, sensor = view.exposure_of_radiance, view.camera.sensor
    first, second = (_in_gray(radiance, value, scale, sensor) for value in values)
    return PixelErrors(first, second, 2 * rays * len(u))


def _in_gray(
    image: NDArray[np.float64], truth: NDArray[np.float64], scale: float, sensor: Sensor
) -> NDArray[np.float64]:
    """Difference of gray levels; a mean that noise took below zero counts as dark."""
    return gray_levels(np.maximum(truth, 0.0) * scale, sensor) - gray_levels(image * scale, sensor)


def certify_by_independent_rays(
    view: View, radiance: NDArray[np.float64], seed: int, pixels: int = 512, rays: int = 64
) -> Certificate:
    """Certificate of any image.

    Parameters
    ----------
    view : View
        The camera, and who traces.
    radiance : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) of each pixel [W m^-2 sr^-1].
    seed : int
        Of all that is drawn.
    pixels, rays : int
        Pixels that are held against two means of so many rays each.
    """
    gray = gray_levels(radiance * view.exposure_of_radiance, view.camera.sensor)
    sample = draw_pixels(gray, pixels, (seed, 3))
    errors = independent_errors(view, sample, radiance.ravel()[sample.pixels], rays=rays, seed=(seed, 4))
    square = errors.mean_square(sample, (seed, 5))
    return Certificate(
        rms_gray=root(square.mean),
        rms_gray_upper95=root(square.upper),
        p99_gray_upper95=None,
        model_rms_gray=root(square.mean),
        discretisation_rms_gray=0.0,
        certificate_pixels=len(sample.pixels),
        certificate_rays=errors.rays,
        method="independent rays",
    )
