"""Levels of an image without its objects: noise, smooth surfaces, and which side objects lie on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUANTISATION: Final = 1 / 12  # gray^2, of rounding to whole numbers
UPPER_WEIGHT: Final = 0.97  # of the asymmetric fit; the surface lies on the background, parts pull with 0.03
SAMPLES: Final = 6000  # pixels to which the surface is fitted
ALIKE: Final = 0.02  # of the score below; surfaces that differ by less serve alike
BORDER_DEGREE: Final = 2  # of a surface through the border's pixels only; degree 4 runs wild between them
CLOSER: Final = 0.9  # of the rms of what lies on a surface; a less simple one must lie closer than that
_BAND: Final = 64  # rows


def noise_level(values: Array) -> float:
    """Standard deviation of what differs from pixel to pixel."""
    size = values.shape[0] - 2, values.shape[1] - 2
    rough = np.empty(size)
    for first in range(0, size[0], _BAND):  # of a large picture one array is enough
        band = values[first : first + _BAND + 2]
        second = band[:, 2:] - 2 * band[:, 1:-1] + band[:, :-2]
        np.abs(second[2:] - 2 * second[1:-1] + second[:-2], out=rough[first : first + _BAND])
    return float(np.median(rough, overwrite_input=True)) / (0.6745 * 6.0)


def ground_tolerance(light: Array) -> float:
    """How far from its surface the background may lie, by noise and by what a surface cannot follow."""
    return max(4 * noise_level(light), 0.08 * float(np.ptp(light)))


def background_surface(light: Array, zero: float | None = None) -> tuple[Literal["dark", "bright"], Array]:
    """Which side objects lie on, and the surface of the background behind them.

    A surface is laid on the bright, on the dark and on the border's pixels, then cleared of what is off it: a
    quadratic one, one of degree 4, and for the beam of a lamp, which falls to nothing at the border, the exponential of
    such ones. The simplest that serves about as well as the best, and lies about as close, is taken. It serves as far
    as pixels lie on it, and pixels of the border once more, as objects of many levels may cover most of an image but
    seldom of its border; less those half-way between it and the objects: such are few, the objects' rims, where the
    surface is the background.

    Parameters
    ----------
    light : ndarray, shape (rows, columns)
        Light, or gray levels.
    zero : float, optional
        Where there is no light; default the darkest pixel.

    Returns
    -------
    kind : str
        "dark" or "bright" objects.
    surface : ndarray, shape (rows, columns)
        Of the background, in the image's unit.
    """
    rows, columns = light.shape
    x, y = 2 * np.arange(columns) / columns - 1, 2 * np.arange(rows) / rows - 1
    step = max(1, int(math.sqrt(light.size / SAMPLES)))
    tolerance = ground_tolerance(light)
    dark = float(light.min()) if zero is None else zero
    tried: list[tuple[float, float, tuple[_Plain | _Beam, int, Array]]] = []
    sampled = light[::step, ::step]
    values, border = sampled.ravel(), _border(sampled.shape)
    for beam in (False, True):
        for degree in (2, 4):
            some = _terms(x[::step], y[::step], degree)
            fit = _Beam(dark) if beam else _Plain()
            around = fit.fitted(some, values, border.astype(np.float64)) if degree == BORDER_DEGREE else None
            for sign in (1.0, -1.0):
                for start in (_asymmetric(fit, some, values, sign), around):
                    if start is None:
                        continue
                    coefficients = _clear_of_objects(fit, some, values, start, tolerance)
                    depth = sign * (fit.surface(some, coefficients) - values)
                    left = float(np.sqrt(np.mean(np.minimum(np.abs(depth), tolerance) ** 2)))
                    score = _score(depth, tolerance) + float((np.abs(depth[border]) < tolerance).mean())
                    tried.append((score, left, (fit, degree, coefficients)))
    best = max(score for score, _, _ in tried)
    alike = [(left, found) for score, left, found in tried if score >= best - ALIKE]
    closest = min(left for left, _ in alike)
    fit, degree, coefficients = next(found for left, found in alike if CLOSER * left <= closest)
    surface = np.empty(light.shape)
    for first in range(0, rows, _BAND):  # all terms of a large picture at once take gigabytes
        band = y[first : first + _BAND]
        surface[first : first + _BAND] = fit.surface(_terms(x, band, degree), coefficients).reshape(len(band), columns)
    # Objects are what is far from the surface; small ones tell by the cube alone.
    return "dark" if float(((light - surface) ** 3).sum()) < 0 else "bright", surface


def _border(size: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels at the border, as a list of all."""
    inner = np.zeros(size, dtype=np.bool_)
    inner[1:-1, 1:-1] = True
    return ~inner.ravel()


def _terms(x: Array, y: Array, degree: int) -> Array:
    """Monomials on a grid, shape (pixels, terms)."""
    terms = powers(*np.meshgrid(x, y), degree)
    return terms.reshape(len(terms), -1).T


def _score(depth: Array, tolerance: float) -> float:
    half = float(np.quantile(depth, 0.99)) / 2
    between = (np.abs(depth - half) < half / 2) & (np.abs(depth) >= tolerance)
    return float((np.abs(depth) < tolerance).mean() - between.mean())


@dataclass(frozen=True, slots=True)
class _Plain:
    """Surface = sum of terms."""

    def fitted(self, terms: Array, values: Array, weights: Array) -> Array:
        # Normal equations: terms on -1 to 1 keep them within 1e9 of singular, and they cost a tenth of the time.
        weighted = terms * weights[:, None]
        return np.asarray(np.linalg.lstsq(weighted.T @ terms, weighted.T @ values, rcond=None)[0], dtype=np.float64)

    def surface(self, terms: Array, coefficients: Array) -> Array:
        return np.asarray(terms @ coefficients, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Beam:
    """Surface = dark + exp(sum of terms); least squares of the logarithm, weighted to be those of the light."""

    dark: float

    def fitted(self, terms: Array, values: Array, weights: Array) -> Array:
        above = np.maximum(values - self.dark, 1e-3 * max(float(values.max()) - self.dark, 1e-12))
        return _Plain().fitted(terms, np.log(above), weights * above**2)

    def surface(self, terms: Array, coefficients: Array) -> Array:
        return np.asarray(self.dark + np.exp(np.clip(terms @ coefficients, -50, 50)), dtype=np.float64)


def _asymmetric(fit: _Plain | _Beam, terms: Array, values: Array, sign: float) -> Array:
    """Coefficients of the surface that lies on the values' upper side, or lower one where sign is -1."""
    surface: Array = np.full(values.shape, float(np.median(values)))
    weights: Array = np.ones_like(values)
    coefficients = np.zeros(terms.shape[1])
    for _ in range(30):
        new: Array = np.where(sign * (values - surface) > 0, UPPER_WEIGHT, 1 - UPPER_WEIGHT)
        if np.array_equal(new, weights):
            break
        weights = new
        coefficients = fit.fitted(terms, values, weights)
        surface = fit.surface(terms, coefficients)
    return coefficients


def _clear_of_objects(fit: _Plain | _Beam, terms: Array, values: Array, coefficients: Array, tolerance: float) -> Array:
    """The same surface from those pixels alone that lie on it; objects no longer pull."""
    for _ in range(4):
        on = np.abs(values - fit.surface(terms, coefficients)) < tolerance
        if on.sum() < 4 * terms.shape[1]:
            break
        coefficients = fit.fitted(terms[on], values[on], np.ones(int(on.sum())))
    return coefficients


def powers(x: Array, y: Array, degree: int) -> Array:
    """Monomials x^i y^j up to a degree, first axis."""
    ups = [[np.ones_like(axis)] for axis in (x, y)]
    for axis, up in zip((x, y), ups, strict=True):
        for _ in range(degree):
            up.append(up[-1] * axis)  # ten times as fast as powers
    return np.stack([ups[0][i] * ups[1][j] for i in range(degree + 1) for j in range(degree + 1 - i)])


def otsu_level(values: Array) -> float:
    """Level that leaves the least variance within the two sides."""
    counts, edges = np.histogram(values, bins=256)
    middle = (edges[1:] + edges[:-1]) / 2
    below, total = np.cumsum(counts), counts.sum()
    moment = np.cumsum(counts * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * below / total - moment) ** 2 / (below * (total - below))
    return float(middle[int(np.nanargmax(np.where(np.isfinite(between), between, -1)))])
