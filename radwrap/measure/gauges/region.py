"""Mean, spread, contrast and contrast-to-noise of regions of an image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.background import QUANTISATION

Array = NDArray[np.float64]
Noise = Literal["spatial", "temporal"]

_FEWEST_PIXELS: Final = 4
_SIDE_FOR_NOISE: Final = 5  # px; differences of neighbours show noise from here on
_GROWTH: Final = 6.0  # of the standard deviation in second differences along both axes
_TOGETHER: Final = (1 + 2 * ((4 / 6) ** 2 + (1 / 6) ** 2)) ** 2  # sum of their squared correlations
_EDGE: Final = 5.0  # standard deviations
_ROUNDING: Final = 0.5  # gray level; by so much a rounded level may lie below the saturation that its pixel has reached


@dataclass(frozen=True, slots=True)
class Box:
    """Pixels of a rectangle: first column and row, last column and row, all included."""

    u0: int
    v0: int
    u1: int
    v1: int

    def of(self, values: Array) -> Array:
        """The pixels in an image.

        Raises
        ------
        InputError
            If it does not lie in it, or has too few.
        """
        rows, columns = values.shape
        if not (0 <= self.u0 <= self.u1 < columns and 0 <= self.v0 <= self.v1 < rows):
            raise InputError(
                f"{self.u0} {self.v0} {self.u1} {self.v1} does not lie in an image of {columns} x {rows} pixels",
                where="region",
                remedy="give first column, first row, last column, last row, counted from 0",
            )
        part = values[self.v0 : self.v1 + 1, self.u0 : self.u1 + 1]
        if part.size < _FEWEST_PIXELS:
            raise InputError(f"holds {part.size} pixels, {_FEWEST_PIXELS} are needed", where="region")
        return part


@dataclass(frozen=True, slots=True)
class Region:
    """Gray levels of a rectangle.

    Attributes
    ----------
    mean, mean_sigma : float
        [gray]; the error is that of noise, which structure of the surface is no part of.
    sd, sd_sigma : float
        Standard deviation over the pixels, structure included [gray].
    noise : float
        Temporal standard deviation of a pixel: between frames where there are several, else from differences of
        neighbours, which takes fine structure for noise; NaN where the region is too small for that [gray].
    noise_sigma : float
        Its standard error.
    low, high : float
        Least and largest gray level.
    pixels, frames : int
        How many.
    saturated : int
        Pixels at full scale or at the camera's saturation, in any frame.
    """

    mean: float
    mean_sigma: float
    sd: float
    sd_sigma: float
    noise: float
    noise_sigma: float
    low: float
    high: float
    pixels: int
    frames: int
    saturated: int


@dataclass(frozen=True, slots=True)
class Contrast:
    """What sets two regions apart.

    Attributes
    ----------
    michelson, michelson_sigma : float
        (a - b)/(a + b) of their means above dark.
    contrast_to_noise, contrast_to_noise_sigma : float
        |a - b|/sqrt(sd_a^2 + sd_b^2).
    noise : str
        Which standard deviation that is: "spatial", over a region's pixels, or "temporal", of a pixel.
    difference, difference_sigma : float
        a - b [gray].
    michelson_by_rendering, contrast_to_noise_by_rendering : float
        What errors of one gray level in each pixel, with the worst signs, do to them; the spreads stay.
    """

    michelson: float
    michelson_sigma: float
    contrast_to_noise: float
    contrast_to_noise_sigma: float
    noise: Noise
    difference: float
    difference_sigma: float
    michelson_by_rendering: float
    contrast_to_noise_by_rendering: float


def measure_region(frames: GrayImage | Sequence[GrayImage], box: Box, *, saturation: float | None = None) -> Region:
    """Measure the gray levels of a rectangle, in one frame or several of the same scene.

    Parameters
    ----------
    frames : GrayImage or sequence of GrayImage
        Of equal size.
    box : Box
        Which pixels.
    saturation : float, optional
        Gray level at which the camera saturates, where its full well ends below full scale [gray].

    Returns
    -------
    Region
        With standard errors of noise.

    Raises
    ------
    InputError
        If frames differ in size, or the box does not lie in them.

    Examples
    --------
    >>> import numpy as np
    >>> found = measure_region(GrayImage(np.full((20, 20), 80.0)), Box(2, 2, 11, 11))
    >>> found.mean, found.sd, found.pixels
    (80.0, 0.0, 100)
    """
    images = [frames] if isinstance(frames, GrayImage) else list(frames)
    if not images:
        raise InputError("there is no frame", where="the image")
    if len({(image.values.shape, image.bit_depth) for image in images}) > 1:
        raise InputError("frames differ in size or bit depth", where="the image")
    stack = np.stack([box.of(image.values) for image in images])
    full = float(2 ** images[0].bit_depth - 1)
    if saturation is not None:
        full = min(full, saturation - _ROUNDING)
    mean = stack.mean(axis=0)
    count = mean.size
    noise, noise_sigma = _noise(stack)
    total = float(stack.var(axis=(1, 2), ddof=1).mean())
    # Of what pixels have in common in all frames each counts once; of what changes each frame counts anew.
    steady = max(total - (0.0 if math.isnan(noise) else noise**2), 0.0)
    spread = 2 * (steady**2 + (total**2 - steady**2) / len(images)) / (count - 1)
    known = math.sqrt(total) if math.isnan(noise) else noise
    return Region(
        mean=float(mean.mean()),
        mean_sigma=max(known, math.sqrt(QUANTISATION) if _rounded(stack) else 0.0) / math.sqrt(count * len(images)),
        sd=math.sqrt(total),
        sd_sigma=math.sqrt(spread) / (2 * math.sqrt(total)) if total > 0 else 0.0,
        noise=noise,
        noise_sigma=noise_sigma,
        low=float(stack.min()),
        high=float(stack.max()),
        pixels=count,
        frames=len(images),
        saturated=int((stack >= full).any(axis=0).sum()),
    )


def _noise(stack: Array) -> tuple[float, float]:
    """Temporal standard deviation of a pixel and its standard error."""
    frames, rows, columns = stack.shape
    if frames > 1:
        free = (frames - 1) * rows * columns
        noise = math.sqrt(float(stack.var(axis=0, ddof=1).mean()))
        return noise, noise / math.sqrt(2 * free)
    if min(rows, columns) < _SIDE_FOR_NOISE:
        return math.nan, math.nan
    return pixel_noise(stack[0])


def pixel_noise(values: Array) -> tuple[float, float]:
    """Standard deviation of what differs from pixel to pixel, and its standard error.

    By second differences along rows and columns, (1, -2, 1) each, whose variance is 36 times that of a pixel. Those far
    off are edges, and left out.
    """
    second = values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2]
    rough = np.abs(second[2:] - 2 * second[1:-1] + second[:-2]).ravel()
    usual = 1.4826 * float(np.median(rough))
    some = rough[rough <= _EDGE * usual] if usual > 0 else rough
    noise = math.sqrt(float(np.mean(some**2))) / _GROWTH
    return noise, noise * math.sqrt(_TOGETHER / (2 * rough.size))


def _rounded(stack: Array) -> bool:
    return bool(np.array_equal(stack, np.rint(stack)))


def contrast_of(a: Region, b: Region, *, dark: float = 0.0, noise: Noise = "spatial") -> Contrast:
    """Contrast and contrast-to-noise of two regions.

    Parameters
    ----------
    a, b : Region
        The first and the second.
    dark : float
        Gray level without light.
    noise : str
        "spatial" for the standard deviations over the regions' pixels, "temporal" for those of a pixel.

    Returns
    -------
    Contrast
        With standard errors of noise; infinite contrast-to-noise is NaN.

    Raises
    ------
    InputError
        If dark lies above both means, or a region is too small to show its noise.

    Examples
    --------
    >>> import numpy as np
    >>> image = GrayImage(np.repeat([[60.0, 20.0]], 100, axis=0).repeat(50, axis=1))
    >>> bright, low = (measure_region(image, Box(u, 0, u + 49, 99)) for u in (0, 50))
    >>> contrast_of(bright, low).michelson
    0.5
    """
    first, second = a.mean - dark, b.mean - dark
    if first + second <= 0:
        raise InputError(f"{dark:g} lies above the regions' means", where="dark")
    total = first + second
    michelson = (first - second) / total
    sigma = 2 * math.hypot(second * a.mean_sigma, first * b.mean_sigma) / total**2
    spreads = [(one.sd, one.sd_sigma) if noise == "spatial" else (one.noise, one.noise_sigma) for one in (a, b)]
    if any(math.isnan(value) for value, _ in spreads):
        raise InputError(
            "is too small to show its noise", where="region", remedy=f"take {_SIDE_FOR_NOISE} px a side, or more frames"
        )
    difference, by_noise = a.mean - b.mean, math.hypot(a.mean_sigma, b.mean_sigma)
    spread = math.hypot(*(value for value, _ in spreads))
    ratio = abs(difference) / spread if spread > 0 else math.nan
    by_spread = math.hypot(*(value * error for value, error in spreads)) / spread if spread > 0 else 0.0
    ratio_sigma = math.hypot(by_noise, ratio * by_spread) / spread if spread > 0 else math.nan
    # The larger mean one gray higher and the smaller one lower: 2 (|a| + |b|)/(a + b)^2 and 2/spread, to first order.
    michelson_by = 2 * (abs(first) + abs(second)) / total**2
    ratio_by = 2 / spread if spread > 0 else math.nan
    return Contrast(michelson, sigma, ratio, ratio_sigma, noise, difference, by_noise, michelson_by, ratio_by)
