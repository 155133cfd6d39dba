"""The light that a part, or the background around it, would have all over; and how far it may be off.

Two errors of the fitted surface. Noise differs from pixel to pixel: the usual covariance of least squares. Rounding
to whole gray levels does not: on light that varies slowly it is a sawtooth of the light itself,
e(g) = sum_k (-1)^k sin(2 pi k g)/(pi k), the same at neighbours, and it lies in the pixels of the rim's band too,
where it cancels against the level's. What is not known is where the light lies between two gray levels, the
sawtooth's common phase: each harmonic adds |sum of e^(2 pi i k g)|^2/(2 pi^2 k^2), less what noise s takes away,
exp(-4 pi^2 k^2 s^2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.background import QUANTISATION, noise_level, powers
from radwrap.measure.parts.light import LinearLight

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HARMONICS: Final = 6  # they hold 90 % of a sawtooth's variance; the rest is counted as noise
# Pixels that a surface of each degree needs; fewer do not hold its terms against noise.
SMALLEST_FOR_DEGREE: Final = {4: 180, 2: 48, 1: 12}


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A surface of light, fitted to some pixels.

    Attributes
    ----------
    surface : ndarray, shape (rows, columns)
        Light.
    terms : ndarray, shape (terms, rows, columns)
        Its terms.
    inverse : ndarray, shape (terms, pixels)
        Coefficients from the pixels' light.
    where : ndarray of bool, shape (rows, columns)
        The pixels.
    noise : float
        What differs from pixel to pixel, without the part of rounding that the harmonics hold [light].
    spread : float
        All that differs from the surface [light].
    harmonics : tuple of float
        Variance of each harmonic of rounding [gray^2]; none where nothing was rounded.
    offset_variance : float
        Of a level that no pixel shows [light^2].
    """

    surface: Array
    terms: Array
    inverse: Array
    where: Mask
    noise: float
    spread: float
    harmonics: tuple[float, ...]
    offset_variance: float = 0.0


def fitted_level(
    light: Array, base: Array, where: Mask, response: LinearLight, *, highest: int, rounded: bool
) -> Level:
    """Least-squares surface of the highest degree that the pixels hold, on top of a base.

    Parameters
    ----------
    light, base : ndarray, shape (rows, columns)
        Light, and a rough surface of it (or 0).
    where : ndarray of bool, shape (rows, columns)
        Pixels of that level alone.
    response : LinearLight
        How gray levels became light.
    highest : int
        Largest degree: 4 where the pixels lie around the place of interest, 2 where the surface runs on beyond them.
    rounded : bool
        Whether gray levels were rounded to whole numbers.
    """
    rows, columns = light.shape
    v, u = np.indices(light.shape)
    count = int(where.sum())
    degree = next((d for d, needed in SMALLEST_FOR_DEGREE.items() if d <= highest and count >= needed), 0)
    terms = powers(2 * u / max(columns - 1, 1) - 1, 2 * v / max(rows - 1, 1) - 1, degree)
    pinv = np.linalg.pinv(terms[:, where].T) if count else np.zeros((len(terms), 0))
    inverse = np.asarray(pinv, dtype=np.float64)
    difference = (light - base)[where]
    coefficients = inverse @ difference
    surface = base + np.tensordot(coefficients, terms, 1)
    left = (light - surface)[where]
    free = count - len(terms)
    # A lone pixel has no spread of its own.
    spread = math.sqrt(float(left @ left) / free) if free > 3 else noise_level(light)
    harmonics, noise = _rounding(spread, response.slope(surface[where])) if rounded and count else ((), spread)
    unknown = 0.0 if count else spread**2
    return Level(surface, terms, inverse, where, noise, spread, harmonics, unknown)


def _rounding(spread: float, slope: Array) -> tuple[tuple[float, ...], float]:
    """Variance of each harmonic [gray^2], and what is left of the spread [light]."""
    steepness = float((slope**2).mean())
    dither = max(spread**2 / steepness - QUANTISATION, 0.0)
    orders = range(1, HARMONICS + 1)
    harmonics = tuple(math.exp(-4 * math.pi**2 * k**2 * dither) / (2 * math.pi**2 * k**2) for k in orders)
    return harmonics, math.sqrt(max(spread**2 - steepness * sum(harmonics), 0.0))


def level_covariance(level: Level, weights: Array, own: Array, response: LinearLight) -> Array:
    """Of sums over pixels: what the level's error does to them.

    Parameters
    ----------
    level : Level
        The level.
    weights : ndarray, shape (sums, rows, columns)
        Change of each sum with the level's light at a pixel.
    own : ndarray, shape (sums, rows, columns)
        Change of each sum with the light of pixels that lie on the level themselves, 0 elsewhere; their rounding
        is the level's own.
    response : LinearLight
        How gray levels became light.
    """
    by_term = np.einsum("sij,tij->st", weights, level.terms)
    by_pixel = by_term @ level.inverse
    total: Array = level.noise**2 * (by_pixel @ by_pixel.T)
    total += level.offset_variance * np.outer(by_term[:, 0], by_term[:, 0])
    if level.harmonics:
        gray, slope = response.gray(level.surface), response.slope(level.surface)
        for order, variance in enumerate(level.harmonics, start=1):
            wave = slope * np.exp(2j * math.pi * order * gray)
            amplitude = by_pixel @ wave[level.where] + np.einsum("sij,ij->s", own, wave)
            total += variance * np.outer(amplitude, amplitude.conj()).real
    return total
