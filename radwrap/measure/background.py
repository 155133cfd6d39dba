"""Levels of an image without its objects: noise, smooth surfaces, and which side objects lie on."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

QUANTISATION: Final = 1 / 12  # gray^2, of rounding to whole numbers
UPPER_WEIGHT: Final = 0.97  # of the asymmetric fit; the surface lies on the background, parts pull with 0.03
SAMPLES: Final = 6000  # pixels to which the surface is fitted
SERVES: Final = 0.45  # of the score below; parts and rims may fill half of the image


def noise_level(values: Array) -> float:
    """Standard deviation of what differs from pixel to pixel."""
    second = values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2]
    second = second[2:] - 2 * second[1:-1] + second[:-2]
    return float(np.median(np.abs(second))) / (0.6745 * 6.0)


def background_surface(light: Array) -> tuple[Literal["dark", "bright"], Array]:
    """Which side objects lie on, and the surface of the background behind them.

    A surface is laid on the bright and on the dark pixels, then cleared of what is off it: a quadratic one, and one
    of degree 4 where the former does not serve. It serves as far as pixels lie on it, less those half-way between
    it and the objects: such are few, the objects' rims, where the surface is the background.

    Returns
    -------
    kind : str
        "dark" or "bright" objects.
    surface : ndarray, shape (rows, columns)
        Of the background, in the image's unit.
    """
    rows, columns = light.shape
    v, u = np.indices(light.shape)
    step = max(1, int(math.sqrt(light.size / SAMPLES)))
    tolerance = max(4 * noise_level(light), 0.08 * float(np.ptp(light)))
    tried: list[tuple[float, Array]] = []
    for degree in (2, 4):
        terms = powers(2 * u / columns - 1, 2 * v / rows - 1, degree)
        some, values = terms[:, ::step, ::step].reshape(len(terms), -1).T, light[::step, ::step].ravel()
        for sign in (1.0, -1.0):
            coefficients = _clear_of_objects(some, values, _asymmetric(some, values, sign), tolerance)
            depth = sign * (some @ coefficients - values)
            half = float(np.quantile(depth, 0.99)) / 2
            between = (np.abs(depth - half) < half / 2) & (np.abs(depth) >= tolerance)
            score = float((np.abs(depth) < tolerance).mean() - between.mean())
            tried.append((score, np.tensordot(coefficients, terms, 1)))
        best = max(tried, key=lambda entry: entry[0])
        if best[0] > SERVES:
            break
    # Objects are what is far from the surface; small ones tell by the cube alone.
    return "dark" if float(((light - best[1]) ** 3).sum()) < 0 else "bright", best[1]


def _asymmetric(terms: Array, values: Array, sign: float) -> Array:
    """Coefficients of the surface that lies on the values' upper side, or lower one where sign is -1."""
    surface: Array = np.full(values.shape, float(np.median(values)))
    weights: Array = np.ones_like(values)
    coefficients = np.zeros(terms.shape[1])
    for _ in range(30):
        new: Array = np.where(sign * (values - surface) > 0, UPPER_WEIGHT, 1 - UPPER_WEIGHT)
        if np.array_equal(new, weights):
            break
        weights = new
        root = np.sqrt(weights)
        coefficients = np.asarray(
            np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0], dtype=np.float64
        )
        surface = terms @ coefficients
    return coefficients


def _clear_of_objects(terms: Array, values: Array, coefficients: Array, tolerance: float) -> Array:
    """The same surface from those pixels alone that lie on it; objects no longer pull."""
    for _ in range(4):
        on = np.abs(values - terms @ coefficients) < tolerance
        if on.sum() < 4 * terms.shape[1]:
            break
        coefficients = np.asarray(np.linalg.lstsq(terms[on], values[on], rcond=None)[0], dtype=np.float64)
    return coefficients


def surface_terms(shape: tuple[int, ...]) -> Array:
    """Terms 1, y, y^2, x, xy, x^2 of a quadratic surface, shape (6, rows, columns), on coordinates from -1 to 1."""
    v, u = np.indices(shape)
    return powers(2 * u / max(shape[1] - 1, 1) - 1, 2 * v / max(shape[0] - 1, 1) - 1, 2)


def rounding_variance(variance: float) -> float:
    """Variance of the mean of an even level that was rounded to whole numbers [gray^2].

    Rounding of even light is the same all over, unless noise s dithers it: over places within a step its rms is
    exp(-2 pi^2 s^2)/(pi sqrt 2).

    Parameters
    ----------
    variance : float
        Of the level's pixels, rounding included [gray^2].
    """
    return math.exp(-4 * math.pi**2 * max(variance - QUANTISATION, 0.0)) / (2 * math.pi**2)


def powers(x: Array, y: Array, degree: int) -> Array:
    """Monomials x^i y^j up to a degree, first axis."""
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])


def fitted_surface(gray: Array, terms: Array, where: Mask, used: int) -> tuple[Array, float, Array]:
    """Least-squares surface, standard deviation about it, covariance of its coefficients."""
    design = terms[:used, where].T
    values = gray[where]
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ values
    left = values - design @ coefficients
    # A lone pixel has no spread of its own.
    spread = math.sqrt(float(left @ left) / (values.size - used)) if values.size > used + 3 else noise_level(gray)
    errors = np.zeros((len(terms), len(terms)))
    errors[:used, :used] = spread**2 * (inverse @ inverse.T)
    return np.tensordot(coefficients, terms[:used], 1), spread, errors


def otsu_level(values: Array) -> float:
    """Level that leaves the least variance within the two sides."""
    counts, edges = np.histogram(values, bins=256)
    middle = (edges[1:] + edges[:-1]) / 2
    below, total = np.cumsum(counts), counts.sum()
    moment = np.cumsum(counts * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * below / total - moment) ** 2 / (below * (total - below))
    return float(middle[int(np.nanargmax(np.where(np.isfinite(between), between, -1)))])
