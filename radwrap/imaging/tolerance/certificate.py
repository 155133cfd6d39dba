"""How far the gray levels of an image are off, measured with rays of its own.

Two ways. A kernel's model error is the mean of differences of PAIRED rays:
one through a point of the opening, and those through its centre that the
kernel takes in its place; equal where the model holds, so that few rays tell
much. Any image can be held against independent rays over pixel and opening:
two means a, b of them give (a - k)(b - k), whose mean is the squared error of
k. All on gray levels before rounding, clipped at saturation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.pairs import paired
from radwrap.imaging.methods.rays import rays_over, sampled_radiance
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.sensor import GrayWhereAsked, gray_levels
from radwrap.imaging.tolerance.bounds import Bounded, mean_squares, resampling
from radwrap.kept import Kept, of_kept
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Sensor
from radwrap.written import NotNegative, Rays

# Shares of the pixels, by how much gray changes around them, and of the sample: nearly all error lies at edges.
_STRATA: Final[tuple[tuple[float, float], ...]] = ((0.1, 0.5), (0.2, 0.25), (0.7, 0.25))
# Where something may hide something, up to half of the sample is drawn, in two strata of its own: so many times more
# than their share of the image.
_RISKY_STRATA: Final[tuple[tuple[float, float], ...]] = ((0.3, 0.6), (0.7, 0.4))
_RISKY_SHARE: Final = 0.5
_RISKY_TIMES: Final = 5.0
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
    bands_gray : float or None
        What the bands of the light may add, in the bounds already; None where the scene tells no spectra.
    diffraction_gray : float or None
        What the footprint of waves may add, in the bounds already: noise of its rays, cells, tails, wavelengths; None
        where light is rays.
    motion_gray : float or None
        What the light between the instants of a moving scene may add, in the bounds already; None where nothing moves.
    """

    rms_gray: NotNegative
    rms_gray_upper95: NotNegative
    p99_gray_upper95: NotNegative | None
    model_rms_gray: NotNegative
    discretisation_rms_gray: NotNegative
    certificate_pixels: Rays
    certificate_rays: Rays
    method: str
    bands_gray: NotNegative | None = field(default=None, metadata=ONLY_WHERE_USED)
    diffraction_gray: NotNegative | None = field(default=None, metadata=ONLY_WHERE_USED)
    motion_gray: NotNegative | None = field(default=None, metadata=ONLY_WHERE_USED)

    def with_bands(self, gray: float) -> Certificate:
        """The certificate that holds where bands change each pixel by so much at most [gray level]."""
        quantile = None if self.p99_gray_upper95 is None else self.p99_gray_upper95 + gray
        bound = self.rms_gray_upper95 + gray
        return replace(self, rms_gray_upper95=bound, p99_gray_upper95=quantile, bands_gray=gray)

    def with_waves(
        self,
        noise: Bounded,
        cells: float,
        tails: float,
        quantile: float,
        *,
        bands: float = 0.0,
        parts: Sequence[Bounded] = (),
    ) -> Certificate:
        """The certificate of an image with what waves add.

        Parameters
        ----------
        noise : Bounded
            Mean square of what the number of their rays adds; below 0 where waves blur what noise the image has
            [gray level^2].
        cells : float
            Mean square of what their cells add [gray level^2].
        tails : float
            Rms of what light may add that comes from farther than was looked at [gray level].
        quantile : float
            Of all, that 99.5 % of the pixels stay below [gray level].
        bands : float
            Rms of what one wavelength in place of all may add [gray level].
        parts : sequence of Bounded
            Mean squares of which the image's own is the sum, where they are told.

        Notes
        -----
        Squares add: noise has no part in common with anything; far light changes slowly over an image and has one sign,
        and the cells' size changes either side of an edge the other way. Only what wavelengths change may look as the
        rest does. What is not known of each mean square, its bound less itself, is a matter of chance of rays of its
        own: of independent ones the deviations add as squares too (key graybill_wang), as all of them are as far off
        at a time less often than each.
        """
        known = max(self.rms_gray**2 + noise.mean, 0.0) + cells
        each = (*(parts or (Bounded(self.rms_gray**2, self.rms_gray_upper95**2),)), noise)
        deviation = math.hypot(*(max(part.upper, 0.0) - max(part.mean, 0.0) for part in each))
        return replace(
            self,
            rms_gray=math.sqrt(known),
            rms_gray_upper95=math.sqrt(known + tails**2 + deviation) + bands,
            p99_gray_upper95=None if self.p99_gray_upper95 is None else self.p99_gray_upper95 + quantile,
            diffraction_gray=math.sqrt(max(noise.upper, 0.0) + cells + tails**2) + bands,
        )


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
        Share of each stratum in the image; where their sum is below 1, the rest has no such error.
    pairs : ndarray of int
        Pairs of rays that each gets where a kernel's model is held against rays; empty where that is not done.
    """

    pixels: NDArray[np.intp]
    stratum: NDArray[np.intp]
    shares: NDArray[np.float64]
    pairs: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def weights(self) -> NDArray[np.float64]:
        """Share of the image that each pixel stands for."""
        each: NDArray[np.float64] = self.shares / np.bincount(self.stratum, minlength=len(self.shares))
        return each[self.stratum]


def places_of(pixels: NDArray[np.intp], columns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows of pixels [px]."""
    v, u = np.divmod(pixels, columns)
    return u.astype(np.float64), v.astype(np.float64)


def draw_pixels(
    gray: NDArray[np.float64] | GrayWhereAsked,
    count: int,
    seed: tuple[int, ...],
    *,
    risky: NDArray[np.bool_] | None = None,
    pairs: tuple[int, int] = (0, 0),
    exact: NDArray[np.bool_] | None = None,
) -> PixelSample:
    """Draw pixels, more where gray changes, and more where they are risky; all where there are not more than `count`.

    Parameters
    ----------
    gray : ndarray, shape (rows, columns)
        The image [gray level].
    count : int
        About how many pixels.
    seed : tuple of int
        Of what is drawn.
    risky : ndarray of bool, shape (rows, columns), optional
        Pixels that form strata of their own.
    pairs : tuple of int
        Pairs of rays for each pixel, and for each risky one.
    exact : ndarray of bool, shape (rows, columns), optional
        Pixels without the error that is looked for: none is drawn.
    """
    number = math.prod(gray.shape)
    random = generator(*seed)
    if isinstance(gray, GrayWhereAsked) and number <= _LOOKED_AT:
        gray = gray.whole  # each is asked for five times
    # Of a large image some pixels, drawn evenly, stand for all.
    drawn = random.choice(number, min(number, _LOOKED_AT), replace=False, shuffle=False)
    looked_at = len(drawn)
    if exact is not None:
        drawn = drawn[~exact.ravel()[drawn]]
    apart = np.zeros(len(drawn), dtype=bool) if risky is None else risky.ravel()[drawn]
    part_apart = 1.0 if apart.all() else min(_RISKY_SHARE, _RISKY_TIMES * float(apart.mean()))
    groups = [(drawn[~apart], _STRATA, 1 - part_apart), (drawn[apart], _RISKY_STRATA, part_apart)]
    chosen: list[NDArray[np.intp]] = []
    sizes: list[int] = []
    for group, strata, part in groups:
        order = group[np.argsort(-_change(gray, group), kind="stable")]
        bounds = np.rint(np.cumsum([0.0, *(share for share, _ in strata)]) * len(order)).astype(int)
        for (first, last), (_, wanted) in zip(itertools.pairwise(bounds.tolist()), strata, strict=True):
            if last > first:
                size = min(max(round(part * wanted * count), _FEWEST_IN_STRATUM), last - first)
                chosen.append(random.choice(order[first:last], size, replace=False))
                sizes.append(last - first)
    stratum = np.repeat(np.arange(len(chosen)), [len(pixels) for pixels in chosen])
    pixels = np.concatenate([np.zeros(0, dtype=np.intp), *chosen])
    numbers = np.full(len(pixels), pairs[0]) if risky is None else np.where(risky.ravel()[pixels], pairs[1], pairs[0])
    return PixelSample(pixels, stratum, np.array(sizes) / looked_at, numbers)


def _change(gray: NDArray[np.float64] | GrayWhereAsked, pixels: NDArray[np.intp]) -> NDArray[np.float64]:
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

    def mean_square(self, sample: PixelSample, seed: tuple[int, ...], kept: Kept | None = None) -> Bounded:
        """Mean square over the image; resamples of strata of these sizes may be kept."""
        again = of_kept(
            kept,
            lambda: ("resampling", sample.stratum.tobytes(), sample.shares.tobytes(), seed),
            lambda: resampling(sample.stratum, sample.shares, seed),
            lambda made: sum(drawn.nbytes for drawn in made.drawn),
        )
        return mean_squares(self.first[np.newaxis], self.second[np.newaxis], again)[0]


def model_errors(
    view: View,
    layers: tuple[float, ...],
    sample: PixelSample,
    radiance: NDArray[np.float64],
    *,
    seed: tuple[int, ...],
) -> PixelErrors:
    """What the kernel's model lacks at some pixels, in gray levels.

    Parameters
    ----------
    view, layers, sample, seed
        As in `model_lacks`.
    radiance : ndarray, shape (n,)
        The image's mean radiance at the sample, through which Eq. 5 is taken.
    """
    lacks, rays = model_lacks(view, layers, sample, seed=seed)
    return lacks_in_gray(radiance, lacks, rays, view.exposure_of_radiance, view.camera.sensor)


def lacks_in_gray(
    radiance: NDArray[np.float64], lacks: NDArray[np.float64], rays: int, exposure_of_radiance: float, sensor: Sensor
) -> PixelErrors:
    """Two values of what is lacking, shape (2, n) [W m^-2 sr^-1], through Eq. 5 at the image's radiance."""
    first, second = (_in_gray(radiance, radiance + lack, exposure_of_radiance, sensor) for lack in lacks)
    return PixelErrors(first, second, rays)


def model_lacks(
    view: View, layers: tuple[float, ...], sample: PixelSample, *, seed: tuple[int, ...]
) -> tuple[NDArray[np.float64], int]:
    """What the kernel's model lacks at some pixels, by paired rays; linear in the sources.

    Parameters
    ----------
    view : View
        The camera, and who traces.
    layers : tuple of float
        The kernel's magnifications.
    sample : PixelSample
        Where, and with how many pairs.
    seed : tuple of int
        Of all that is drawn.

    Returns
    -------
    lacks : ndarray, shape (2, n)
        Two independent values of what is lacking [W m^-2 sr^-1]; with an axis of the sources before, where the view's
        tracer tells them apart.
    rays : int
        How many were traced.
    """
    if not len(sample.pixels):
        return np.zeros((2, 0)), 0
    # Both halves of all parts in one call, which the workers share.
    numbers = np.unique(sample.pairs).tolist()
    parts = [np.flatnonzero(sample.pairs == pairs) for pairs in numbers]
    drawn = []
    for part, pairs in zip(parts, numbers, strict=True):
        u, v = places_of(np.tile(sample.pixels[part], 2), view.camera.sensor.columns)
        drawn.append(rays_over(view.camera, u, v, pairs, generator(*seed, pairs)))
    opening, places_u, places_v = (np.concatenate(arrays) for arrays in zip(*drawn, strict=True))
    differences = paired(view, layers, opening, places_u, places_v)[1]
    lead = differences.shape[:-1]
    lacks = np.empty((*lead, 2, len(sample.pixels)))
    ends = np.cumsum([len(u) for _, u, _ in drawn])[:-1]
    for part, some in zip(parts, np.split(differences, ends, axis=-1), strict=True):
        lacks[..., part] = some.reshape(*lead, 2, len(part), -1).mean(axis=-1)
    return lacks, rays_of_lacks(layers, int(sample.pairs.sum()))


def rays_of_lacks(layers: tuple[float, ...], pairs: int) -> int:
    """How many rays `model_lacks` takes, by the sum of all pixels' pairs."""
    return 2 * (1 + len(layers)) * pairs


def independent_errors(
    view: View, pixels: NDArray[np.intp], radiance: NDArray[np.float64], *, rays: int, seed: tuple[int, ...]
) -> PixelErrors:
    """What an image lacks at some pixels, by independent rays over pixel and opening; parameters as `model_errors`."""
    u, v = places_of(pixels, view.camera.sensor.columns)
    random = generator(*seed)
    # Both in one call, which the workers share evenly.
    values = sampled_radiance(view, np.tile(u, 2), np.tile(v, 2), rays, random).mean(axis=1).reshape(2, -1)
    scale, sensor = view.exposure_of_radiance, view.camera.sensor
    first, second = (_in_gray(radiance, value, scale, sensor) for value in values)
    return PixelErrors(first, second, 2 * rays * len(u))


def _in_gray(
    image: NDArray[np.float64], truth: NDArray[np.float64], scale: float, sensor: Sensor
) -> NDArray[np.float64]:
    """Difference of gray levels; a mean that noise took below zero counts as dark."""
    return gray_levels(np.maximum(truth, 0.0) * scale, sensor) - gray_levels(image * scale, sensor)


def certificate_of(model: Bounded, noise: Bounded, quantile: float | None, *, pixels: int, rays: int) -> Certificate:
    """Certificate from mean squares [gray level^2]: of the model's error, and of what the number of rays adds."""
    square = Bounded(max(model.mean, 0.0), max(model.upper, 0.0)) + noise
    return Certificate(
        rms_gray=root(square.mean),
        rms_gray_upper95=root(square.upper),
        p99_gray_upper95=quantile,
        model_rms_gray=root(model.mean),
        discretisation_rms_gray=root(noise.mean),
        certificate_pixels=pixels,
        certificate_rays=rays,
        method="pairs and replicates" if pixels else "replicates",
    )


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
    gray = GrayWhereAsked(radiance, view.exposure_of_radiance, view.camera.sensor)
    sample = draw_pixels(gray, pixels, (seed, Rendering.CERTIFIED_PIXELS))
    errors = independent_errors(
        view, sample.pixels, radiance.ravel()[sample.pixels], rays=rays, seed=(seed, Rendering.CERTIFIED_RAYS)
    )
    square = errors.mean_square(sample, (seed, Rendering.CERTIFIED_RESAMPLES))
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
