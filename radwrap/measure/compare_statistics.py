"""Statistics of the difference of two images on common pixels: overall, by region, gain and offset."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Region:
    """A part of the predicted image: its name and its pixels, shape (rows, columns)."""

    name: str
    pixels: Flags


@dataclass(frozen=True, slots=True)
class Statistics:
    """Differences over some pixels [gray].

    Attributes
    ----------
    pixels : int
        Number of pixels that were compared.
    mean, median, rms, maximum : float
        Of captured - predicted; `maximum` is the largest absolute one.
    quantile_95, quantile_99 : float
        Of the absolute difference.
    captured_mean, predicted_mean : float
        Mean gray levels.
    beyond : float or None
        Share of pixels with an absolute difference above the tolerance.
    """

    pixels: int
    mean: float
    median: float
    rms: float
    quantile_95: float
    quantile_99: float
    maximum: float
    captured_mean: float
    predicted_mean: float
    beyond: float | None


@dataclass(frozen=True, slots=True)
class LevelFit:
    """captured = gain x predicted + offset by least squares over unsaturated pixels.

    Attributes
    ----------
    gain, offset : float
        Slope, and gray level at predicted = 0; None where the prediction is even.
    gain_sigma, offset_sigma : float
        Standard errors if the residuals were independent from pixel to pixel.
    correlation : float
        Of the two images.
    """

    gain: float | None
    offset: float | None
    gain_sigma: float | None
    offset_sigma: float | None
    correlation: float | None


def statistics(captured: Array, predicted: Array, pixels: Flags, tolerance: float | None) -> Statistics:
    """Differences over the flagged pixels, at least one."""
    difference = captured[pixels] - predicted[pixels]
    size = np.abs(difference)
    return Statistics(
        pixels=len(difference),
        mean=float(difference.mean()),
        median=float(np.median(difference)),
        rms=rms(difference),
        quantile_95=float(np.quantile(size, 0.95)),
        quantile_99=float(np.quantile(size, 0.99)),
        maximum=float(size.max()),
        captured_mean=float(captured[pixels].mean()),
        predicted_mean=float(predicted[pixels].mean()),
        beyond=None if tolerance is None else float(np.mean(size > tolerance)),
    )


def by_region(
    captured: Array, predicted: Array, valid: Flags, regions: Sequence[Region], tolerance: float | None
) -> Iterator[tuple[str, Statistics]]:
    """Name and statistics of each region.

    Raises
    ------
    InputError
        If a region has another size or no pixel to compare.
    """
    for region in regions:
        if region.pixels.shape != predicted.shape:
            rows, columns = region.pixels.shape
            raise InputError(
                f"is made for {columns} x {rows} pixels, the predicted image has "
                f"{predicted.shape[1]} x {predicted.shape[0]}",
                where=f'region "{region.name}"',
            )
        pixels = region.pixels & valid
        if not pixels.any():
            raise InputError("has no pixel to compare", where=f'region "{region.name}"')
        yield region.name, statistics(captured, predicted, pixels, tolerance)


def rectangle(name: str, corners: tuple[int, int, int, int], shape: tuple[int, int]) -> Region:
    """Pixels u0 <= u < u1, v0 <= v < v1 as a region.

    Raises
    ------
    InputError
        If the rectangle is empty or leaves the image.
    """
    u0, v0, u1, v1 = corners
    if not (0 <= u0 < u1 <= shape[1] and 0 <= v0 < v1 <= shape[0]):
        raise InputError(
            f"{u0},{v0},{u1},{v1} is not a part of {shape[1]} x {shape[0]} pixels",
            where=f'region "{name}"',
            remedy="give U0,V0,U1,V1 with U0 < U1, V0 < V1; the last column and row are not in it",
        )
    pixels = np.zeros(shape, dtype=np.bool_)
    pixels[v0:v1, u0:u1] = True
    return Region(name, pixels)


def regions_of_mask(mask: NDArray[Any], names: Mapping[int, str]) -> list[Region]:
    """A region for each number in a mask, by its name where it has one; 0 is where nothing is seen."""
    known = {0: "nothing", **names}
    return [Region(known.get(int(n), f"part {int(n)}"), mask == n) for n in np.unique(mask)]


def level_fit(captured: Array, predicted: Array) -> LevelFit:
    """Line of captured over predicted gray levels, shape (n,) each."""
    if len(predicted) < 3 or np.ptp(predicted) == 0:
        return LevelFit(None, None, None, None, None)
    middle = predicted.mean()
    spread = float(np.sum((predicted - middle) ** 2))
    gain = float((predicted - middle) @ captured) / spread
    at_middle = float(captured.mean())
    variance = float(np.sum((captured - at_middle - gain * (predicted - middle)) ** 2)) / (len(predicted) - 2)
    scatter = float(np.sum((captured - at_middle) ** 2))
    return LevelFit(
        gain=gain,
        offset=float(at_middle - gain * middle),
        gain_sigma=math.sqrt(variance / spread),
        offset_sigma=math.sqrt(variance * (1 / len(predicted) + middle**2 / spread)),
        correlation=gain * math.sqrt(spread / scatter) if scatter > 0 else None,
    )


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def rms_after_levels(captured: Array, predicted: Array) -> float:
    """Rms that the best gain and offset leave."""
    fit = level_fit(captured, predicted)
    if fit.gain is None or fit.offset is None:
        return float(np.std(captured - predicted))
    return rms(captured - fit.gain * predicted - fit.offset)
