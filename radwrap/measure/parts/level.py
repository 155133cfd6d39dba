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
from collections.abc import Mapping
from contextlib import suppress
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
HIGHEST: Final = 4
SMALLEST_FOR_DEGREE: Final = {HIGHEST: 180, 2: 48, 1: 12}
# Of the normal equations; up to it they give what singular values give to 1e-10, in a third of the time.
_WORST_CONDITION: Final = 1e5


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


def monomials(shape: tuple[int, ...]) -> Mapping[int, Array]:
    """Terms of a surface of each degree on a window, degree -> shape (terms, rows, columns)."""
    rows, columns = shape
    v, u = np.indices(shape)
    all_terms = powers(2 * u / max(columns - 1, 1) - 1, 2 * v / max(rows - 1, 1) - 1, HIGHEST)
    degrees = np.array([i + j for i in range(HIGHEST + 1) for j in range(HIGHEST + 1 - i)])
    return {degree: all_terms[degrees <= degree] for degree in (0, 1, 2)} | {HIGHEST: all_terms}


def fitted_level(
    light: Array,
    base: Array,
    where: Mask,
    response: LinearLight,
    terms_of: Mapping[int, Array],
    *,
    highest: int,
    rounded: bool,
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
    terms_of : Mapping
        The `monomials` of the window.
    highest : int
        Largest degree: 4 where the pixels lie around the place of interest, 2 where the surface runs on beyond them.
    rounded : bool
        Whether gray levels were rounded to whole numbers.
    """
    count = int(where.sum())
    degree = next((d for d, needed in SMALLEST_FOR_DEGREE.items() if d <= highest and count >= needed), 0)
    terms = terms_of[degree]
    inverse = _inverse(terms[:, where])
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


def _inverse(terms: Array) -> Array:
    """Least squares: what takes values at pixels to coefficients of terms, shape (terms, pixels) as the terms there."""
    gram = terms @ terms.T
    with suppress(np.linalg.LinAlgError):  # singular: pixels in a row, or none
        inverse = np.linalg.inv(gram)
        if np.linalg.norm(gram) * np.linalg.norm(inverse) < _WORST_CONDITION:
            return np.asarray(inverse @ terms, dtype=np.float64)
    return np.asarray(np.linalg.pinv(terms.T), dtype=np.float64) if terms.size else terms


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
    flat = own.reshape(len(own), -1)
    by_term = weights.reshape(flat.shape) @ level.terms.reshape(len(level.terms), -1).T
    by_pixel = by_term @ level.inverse
    total: Array = level.noise**2 * (by_pixel @ by_pixel.T)
    total += level.offset_variance * np.outer(by_term[:, 0], by_term[:, 0])
    if level.harmonics:
        # Products of the first one: an exponential of each harmonic took a fifth of the time for a part.
        first = np.exp(2j * math.pi * response.gray(level.surface)).ravel()
        waves = np.cumprod(np.tile(first, (len(level.harmonics), 1)), axis=0) * response.slope(level.surface).ravel()
        amplitudes = (by_pixel @ side[:, level.where.ravel()].T + flat @ side.T for side in (waves.real, waves.imag))
        total += sum((amplitude * level.harmonics) @ amplitude.T for amplitude in amplitudes)
    return total
