"""First stage: places that may be dots, at each scale and for both contrasts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]

# A disc of radius r answers a difference of Gaussians most at about r/sqrt(2): from dots of 5 px to some 230 px.
SMALLEST_SCALE: Final = 1.6
LARGEST_SCALE: Final = 82.0
SCALE_STEP: Final = math.sqrt(2.0)
# Ratio of the two Gaussians (Marr's approximation of the Laplacian).
RATIO: Final = 1.6
# Above this the picture is halved first: the answer is the same, the work a quarter.
COARSE_SCALE: Final = 3.3
# Dim dots of a vignetted board may have a fiftieth of the brightest one's contrast.
WEAKEST: Final = 0.02
# One false maximum in some 10^6 pixels of white noise.
NOISE_FACTOR: Final = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Local maxima of one scale, strongest first.

    Attributes
    ----------
    sign : int
        +1 for bright dots, -1 for dark ones.
    scale : float
        Standard deviation of the finer Gaussian [px].
    points : ndarray, shape (n, 2)
        (u, v) [px], to about a third of a pixel of this scale's picture.
    response : ndarray, shape (n,)
        Answer of the filter [gray].
    """

    sign: int
    scale: float
    points: Field
    response: Field

    def answer(self, dots: int) -> float:
        """Answer that a quarter of so many dots reach: on a vignetted board the others may be much dimmer."""
        return float(self.response[dots // 4]) if len(self.response) > dots // 4 else 0.0


def noise_of(values: Field) -> float:
    """Standard deviation of a picture's noise, rounding included [gray].

    From the median absolute second difference along rows and along columns,
    taken in both directions at once so that even light and straight edges
    drop out; half of all pixels may be structured. A picture of whole numbers
    has at least the noise of rounding, 1/sqrt(12).
    """
    rounding = 1 / math.sqrt(12) if np.array_equal(values, np.rint(values)) else 0.0
    if min(values.shape) < 3:
        return rounding
    rows = values[:-2] - 2 * values[1:-1] + values[2:]
    mixed = rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]
    # The mask (1, -2, 1) x (1, -2, 1) has the sum of squares 36; 0.6745 is the normal distribution's quartile.
    noise = float(np.median(np.abs(mixed))) / 0.6745 / 6
    return max(noise, rounding)


def blobs(values: Field, dots: int) -> list[Blobs]:
    """Candidates of all scales and both contrasts, the most likely scale first.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Gray levels.
    dots : int
        How many are sought; three times as many and 60 are kept for each
        scale and contrast.

    Returns
    -------
    list of Blobs
        Ordered by how strongly candidates answer: the right scale of the
        right contrast comes first on most pictures.
    """
    noise = noise_of(values)
    found: list[Blobs] = []
    picture, shrink, scale = values.astype(np.float32), 1, SMALLEST_SCALE
    while scale <= LARGEST_SCALE and min(picture.shape) >= 4:
        if scale / shrink > COARSE_SCALE:
            picture, shrink = _halved(picture), 2 * shrink
            continue
        found += _one_scale(picture, scale, shrink, noise, 3 * dots + 60)
        scale *= SCALE_STEP
    return sorted(found, key=lambda one: -one.answer(dots))


def _halved(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, columns = (length // 2 * 2 for length in picture.shape)
    even = picture[:rows, :columns]
    return np.asarray((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4)


def _one_scale(picture: NDArray[np.float32], scale: float, shrink: int, noise: float, most: int) -> list[Blobs]:
    from scipy import ndimage

    fine, coarse = scale / shrink, RATIO * scale / shrink
    answer = ndimage.gaussian_filter(picture, fine, mode="nearest", truncate=3.5)
    answer -= ndimage.gaussian_filter(picture, coarse, mode="nearest", truncate=3.5)
    # Noise of the answer: sum of squares of the filter, in the halved picture's pixels of noise/shrink.
    squares = 1 / (4 * math.pi * fine**2) + 1 / (4 * math.pi * coarse**2) - 1 / (math.pi * (fine**2 + coarse**2))
    floor = NOISE_FACTOR * noise / shrink * math.sqrt(squares)
    found = []
    for sign in (1, -1):
        signed = answer if sign > 0 else -answer
        width = 2 * max(1, round(fine * 0.8)) + 1
        least = max(floor, WEAKEST * float(signed.max()))
        rows, columns = np.nonzero((signed == ndimage.maximum_filter(signed, size=width)) & (signed > least))
        if len(rows) == 0:
            continue
        strongest = np.argsort(-signed[rows, columns], kind="stable")[:most]
        rows, columns = rows[strongest], columns[strongest]
        points = _vertices(signed, rows, columns)
        # The first pixel of a halved picture is centred between two of the finer one.
        points = (points + 0.5) * shrink - 0.5
        found.append(Blobs(sign, scale, points, signed[rows, columns].astype(np.float64)))
    return found


def _vertices(signed: NDArray[np.float32], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Field:
    """Maxima to sub-pixels, by a parabola in each direction."""
    padded = np.pad(signed.astype(np.float64), 1, mode="edge")
    r, c = rows + 1, columns + 1
    centre = padded[r, c]
    places = []
    for before, after, index in (
        (padded[r, c - 1], padded[r, c + 1], columns),
        (padded[r - 1, c], padded[r + 1, c], rows),
    ):
        curvature = 2 * centre - before - after
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = np.where(curvature > 0, (after - before) / (2 * curvature), 0.0)
        places.append(index + np.clip(offset, -0.5, 0.5))
    return np.column_stack(places)
