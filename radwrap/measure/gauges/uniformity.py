"""How evenly an area is lit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.gauges.region import Box, pixel_noise
from radwrap.measure.gauges.response import Response, light_of

Array = NDArray[np.float64]

CELLS: Final = 16  # a side, at most: extremes of single pixels are those of noise


@dataclass(frozen=True, slots=True)
class Uniformity:
    """Evenness of light over an area, by the means of its cells.

    Attributes
    ----------
    by_deviation, by_deviation_sigma : float
        1 - sd/mean; of the standard deviation noise is no part.
    by_extremes, by_extremes_sigma : float
        (max - min)/(max + min): 0 is even.
    mean, mean_sigma : float
        Light above dark, in gray levels of a camera with gamma 1.
    brightest, darkest : tuple of float
        Middles of these cells, (u, v) [px].
    cells : tuple of int
        Columns and rows of cells.
    noise : float
        Of a cell's mean, in the same unit.
    """

    by_deviation: float
    by_deviation_sigma: float
    by_extremes: float
    by_extremes_sigma: float
    mean: float
    mean_sigma: float
    brightest: tuple[float, float]
    darkest: tuple[float, float]
    cells: tuple[int, int]
    noise: float


def measure_uniformity(
    image: GrayImage, *, response: Response | None = None, box: Box | None = None, cells: int = CELLS
) -> Uniformity:
    """Measure how evenly an area is lit.

    Parameters
    ----------
    image : GrayImage
        Gray levels.
    response : Response, optional
        Of the camera: light is what is compared. Without a dark level gray level 0 is without light.
    box : Box, optional
        Which pixels; default all.
    cells : int
        Cells a side, at most; as many as pixels for each pixel by itself.

    Returns
    -------
    Uniformity
        With standard errors of noise.

    Raises
    ------
    InputError
        If pixels are saturated, or nothing is lit.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.tile(np.linspace(90, 110, 64), (64, 1))
    >>> round(measure_uniformity(GrayImage(ramp), cells=64).by_extremes, 6)
    0.1
    """
    if cells < 1:
        raise InputError("must be 1 or more", where="cells")
    light = light_of(image, response or Response())
    whole = box or Box(0, 0, image.values.shape[1] - 1, image.values.shape[0] - 1)
    values = whole.of(light.values)
    saturated = values.size - int(whole.of(light.usable.astype(np.float64)).sum())
    if saturated:
        raise InputError(
            f"is saturated in {saturated} pixels, whose light is not known",
            where="the image" if box is None else "region",
            remedy="shorten the exposure",
        )
    means, counts, places = cells_of(values, cells)
    mean = float(values.mean())
    if mean <= 0 or means.min() + means.max() <= 0:
        raise InputError("is not lit: its mean is not above dark", where="the image", remedy="see dark")
    enough = min(values.shape) >= 5
    noise = pixel_noise(values)[0] if enough else 0.0
    each = noise / np.sqrt(counts)
    variance = float(np.average((means - mean) ** 2, weights=counts)) - float(np.mean(each**2))
    sd = math.sqrt(max(variance, 0.0))
    # Of cells' noise n: sd^2 is known to sqrt(4 sd^2 n^2 + 2 n^4)/sqrt(cells).
    typical = float(np.sqrt(np.mean(each**2)))
    by_square = math.sqrt((4 * sd**2 * typical**2 + 2 * typical**4) / means.size)
    sd_sigma = by_square / (2 * sd) if sd > typical else math.sqrt(by_square)
    high, low = int(means.argmax()), int(means.argmin())
    top, bottom = float(means.flat[high]), float(means.flat[low])
    total = top + bottom
    by_noise = 2 * math.hypot(bottom * each.flat[high], top * each.flat[low]) / total**2
    offset = np.array([whole.u0, whole.v0])
    brightest, darkest = (places.reshape(-1, 2)[number] + offset for number in (high, low))
    return Uniformity(
        by_deviation=1 - sd / mean,
        by_deviation_sigma=sd_sigma / mean,
        by_extremes=(top - bottom) / total,
        by_extremes_sigma=by_noise,
        mean=mean,
        mean_sigma=noise / math.sqrt(values.size),
        brightest=(float(brightest[0]), float(brightest[1])),
        darkest=(float(darkest[0]), float(darkest[1])),
        cells=(means.shape[1], means.shape[0]),
        noise=typical,
    )


def cells_of(values: Array, most: int = CELLS) -> tuple[Array, Array, Array]:
    """Means of cells of about equal size, their pixels, and their middles (u, v)."""
    ends = [np.linspace(0, size, min(most, size) + 1).round().astype(np.intp) for size in values.shape]
    sums = np.add.reduceat(np.add.reduceat(values, ends[0][:-1], axis=0), ends[1][:-1], axis=1)
    counts = np.outer(np.diff(ends[0]), np.diff(ends[1])).astype(np.float64)
    v, u = ((end[:-1] + end[1:] - 1) / 2 for end in ends)
    return sums / counts, counts, np.stack(np.meshgrid(u, v), axis=-1)
