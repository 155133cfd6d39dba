"""What an edge looks like: gray levels of light that ends at a line, blurred and seen by pixels."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.edges.profile import pixel_edge
from radwrap.measure.edges.search import Line

Array = NDArray[np.float64]

KNOT_SPACING: Final = 40.0  # px along the edge; follows light whose width (sigma) is 20 px or more
FAINTEST_LIGHT: Final = 0.1  # of the bright side; its curve divides by it, and a step of the fit may go to 0
LIT_FLOOR: Final = 1e-5  # of the bright side; below it H^gamma is a chord through 0, so that its slope stays finite


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """Pixels as lists: column, row, gray; and which are not saturated."""

    u: Array
    v: Array
    gray: Array
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, values: Array, usable: NDArray[np.bool_], top: int = 0) -> Pixels:
        """All pixels of some rows of an image, the first of which is `top`."""
        v, u = np.indices(values.shape, dtype=np.float64)
        return cls(u.ravel(), v.ravel() + top, values.ravel(), usable.ravel())

    @classmethod
    def joined(cls, parts: Sequence[Pixels]) -> Pixels:
        """One list of several."""
        names = ("u", "v", "gray", "usable")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def only(self, some: NDArray[np.bool_] | NDArray[np.intp]) -> Pixels:
        """Those that are flagged, or named by their numbers."""
        return Pixels(self.u[some], self.v[some], self.gray[some], self.usable[some])


@dataclass(frozen=True, slots=True, eq=False)
class Splines:
    """B-splines along the edge at some places; of many only neighbours differ from 0 at any one.

    Attributes
    ----------
    values : ndarray, shape (places, neighbours)
        Of those that differ from 0.
    first : ndarray of int, shape (places,)
        Number of the first of them.
    count : int
        How many splines there are.
    """

    values: Array
    first: NDArray[np.intp]
    count: int

    def sum(self, levels: Array) -> Array:
        """Sum of the splines times one level each, at all places."""
        near = levels[self.first[:, None] + np.arange(self.values.shape[1])]
        return np.asarray((self.values * near).sum(axis=1), dtype=np.float64)

    def only(self, some: NDArray[np.intp]) -> Splines:
        """The same at some of the places, by their numbers."""
        return Splines(self.values[some], self.first[some], self.count)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """G = P + C h^gamma, with P and h linear in the levels; d and s are scaled by the strip's size.

    Shape parameters are: shift across [px], turn [rad], radius [px], gamma, and the share of each of the other discs
    in the blur. Behind them come the levels of the dark side, then of the bright one. Without a dark gray the dark
    levels are P itself; with it P is the dark gray and the dark levels belong to h.
    """

    strip: Pixels
    line: Line
    aspect: float
    dark: float | None
    contrast: float
    along: Splines  # at the pixels
    base: Array  # (pixels, dark levels)
    discs: tuple[float, ...] = ()  # radii of other discs in the blur, over that of the first

    @property
    def shapes(self) -> int:
        """How many parameters come before the levels."""
        return 4 + len(self.discs)

    def means(self, shape: Array) -> list[Array]:
        """Of x^n/n! beyond the edge, blurred, over each pixel; n is 0 to 4."""
        first, *others = self.means_by_disc(shape)
        shares = shape[4:]
        # All the light is in the discs together.
        return [
            mean + sum(share * (other[n] - mean) for share, other in zip(shares, others, strict=True))
            for n, mean in enumerate(first)
        ]

    def means_by_disc(self, shape: Array) -> list[list[Array]]:
        """The same where all the blur were one of the discs."""
        angle = self.line.angle + shape[1]
        cos, sin = math.cos(angle), math.sin(angle)
        # Across the edge in pixel widths: the normal in the image, where rows are `aspect` apart.
        scale = 1 / math.hypot(cos, sin / self.aspect)
        d = (self.strip.u - self.line.centre[0]) * cos + (self.strip.v - self.line.centre[1]) * sin - shape[0]
        found = []
        for ratio in (1.0, *self.discs):
            means = pixel_edge(d * scale, ratio * shape[2], abs(cos) * scale, abs(sin) * scale, 5)
            found.append([mean * math.factorial(n) / self.line.half_width**n for n, mean in enumerate(means)])
        return found

    def bright(self, parameters: Array) -> list[Array]:
        """Light of the bright side: value, slope and curvature across the edge, and what these imply beyond."""
        levels = parameters[self.shapes + self.base.shape[1] :]
        parts = [self.along.sum(part) for part in levels.reshape(3, -1)]
        return [*parts, *_higher(*parts)]

    def bright_columns(self, bright: list[Array], means: list[Array]) -> Array:
        """Derivatives of the bright side's light by its levels, of each third those that differ from 0."""
        slopes = _higher_slopes(*bright[:3])
        weights = [mean + c * means[3] + d * means[4] for mean, (c, d) in zip(means[:3], slopes, strict=True)]
        return np.concatenate([self.along.values * weight[:, None] for weight in weights], axis=1)

    def gray(self, parameters: Array, means: list[Array], bright: list[Array]) -> tuple[Array, Array, Array]:
        """Gray levels, light h, and dG/dh."""
        pedestal = self.base @ parameters[self.shapes : self.shapes + self.base.shape[1]]
        light = np.asarray(sum(part * mean for part, mean in zip(bright, means, strict=True)), dtype=np.float64)
        if self.dark is not None:
            pedestal, light = np.full_like(light, self.dark), light + pedestal
        gamma = parameters[3]
        lit = np.maximum(light, LIT_FLOOR)
        chord = self.contrast * lit ** (gamma - 1)
        return pedestal + chord * light, light, chord * np.where(light > LIT_FLOOR, gamma, 1.0)

    def residual(self, parameters: Array) -> Array:
        """Model less image, of pixels that are not saturated [gray level]."""
        left = np.empty(self.strip.gray.shape)
        for group in self.groups:
            part = self._only(group)
            means = part.means(parameters[: self.shapes])
            left[group] = part.gray(parameters, means, part.bright(parameters))[0] - part.strip.gray
        return left[self.strip.usable]

    def reduced(self, parameters: Array) -> tuple[Array, Array]:
        """Jacobian J and residual f of fewer rows, with the same J^T J, J^T f and f^T f.

        Least squares know no more of them. Along the edge J is banded: pixels between two knots share all columns that
        differ from 0, so each such group goes through a QR decomposition of its own, and what is left through one more.
        """
        splines = self.along.count
        fixed, near = self.shapes + int(self.base.shape[1]), int(self.along.values.shape[1])
        parts = []
        for group in self.groups:
            rows = self._only(group[self.strip.usable[group]])
            if rows.strip.u.size == 0:
                continue
            triangle = np.linalg.qr(rows._slopes_and_residual(parameters), mode="r")
            knot = int(rows.along.first[0])
            part = np.zeros((len(triangle), fixed + 3 * splines + 1))
            columns = [fixed + third * splines + knot + np.arange(near) for third in range(3)]
            part[:, np.concatenate([np.arange(fixed), *columns, [-1]])] = triangle
            parts.append(part)
        whole: Array = np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"))
        return whole[:, :-1], whole[:, -1]

    @property
    def groups(self) -> list[NDArray[np.intp]]:
        """Numbers of the pixels between two knots each: few enough for the processor's cache, and for memory."""
        order = np.argsort(self.along.first, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(self.along.first[order])) + 1)

    def _only(self, some: NDArray[np.intp]) -> Model:
        return replace(self, strip=self.strip.only(some), along=self.along.only(some), base=self.base[some])

    def _slopes_and_residual(self, parameters: Array) -> Array:
        """Slopes by all but shift, turn and radius in closed form, by these by differences; of splines not 0."""
        shape, bright = parameters[: self.shapes], self.bright(parameters)
        means = self.means(shape)
        here, light, slope = self.gray(parameters, means, bright)
        gamma = parameters[3]
        parts = []
        for i, step in enumerate((1e-5, 1e-7, 1e-5 * parameters[2])):
            moved = parameters.copy()
            moved[i] += step
            parts.append((self.gray(moved, self.means(moved[: self.shapes]), bright)[0] - here) / step)
        lit = np.maximum(light, LIT_FLOOR)
        by_gamma = self.contrast * lit ** (gamma - 1) * light * np.log(lit)
        dark = self.base if self.dark is None else self.base * slope[:, None]
        by_bright = self.bright_columns(bright, means) * slope[:, None]
        first, *others = self.means_by_disc(shape) if self.discs else [means]
        by_share = [
            slope * sum(part * (mean - one) for part, mean, one in zip(bright, other, first, strict=True))
            for other in others
        ]
        return np.column_stack([*parts, by_gamma, *by_share, dark, by_bright, here - self.strip.gray])

    def levels(self, parameters: Array) -> tuple[Array, Callable[[Array], Array]]:
        """Low and high gray at the centre, and how they hang on the parameters."""
        middle = splines_along(np.zeros(1), *self._span)
        split = self.shapes + self.base.shape[1]

        def both(p: Array) -> Array:
            floor, gamma = float(p[self.shapes]), p[3]
            top = float(middle.sum(p[split : split + middle.count])[0])
            if self.dark is None:
                return np.array([floor, floor + self.contrast * max(top, 0.0) ** gamma])
            lights = np.maximum([floor, floor + top], 0.0)
            grays: Array = self.dark + self.contrast * lights**gamma
            return grays

        return both(parameters), both

    @property
    def _span(self) -> tuple[float, float]:
        s = self.line.along(self.strip.u, self.strip.v)
        return float(s.min()), float(s.max())


def _higher(a: Array, b: Array, q: Array) -> tuple[Array, Array]:
    """Cubic and quartic coefficient behind a + b x + q x^2 where all are of a exp(p x + r x^2), as of a beam."""
    a = np.maximum(a, FAINTEST_LIGHT)
    p = b / a
    r = q / a - p**2 / 2
    return a * (p * r + p**3 / 6), a * (r**2 / 2 + p**2 * r / 2 + p**4 / 24)


def _higher_slopes(a: Array, b: Array, q: Array) -> list[tuple[Array, Array]]:
    """Derivatives of both by a, by b and by q."""
    is_lit, a = a > FAINTEST_LIGHT, np.maximum(a, FAINTEST_LIGHT)
    p = b / a
    r = q / a - p**2 / 2
    cubic, quartic = p * r + p**3 / 6, r**2 / 2 + p**2 * r / 2 + p**4 / 24
    by_r = p, r + p**2 / 2
    by_b = r - p**2 / 2, -(p**3) / 3
    by_a = cubic - p * by_b[0] - (r + p**2 / 2) * by_r[0], quartic - p * by_b[1] - (r + p**2 / 2) * by_r[1]
    return [(is_lit * by_a[0], is_lit * by_a[1]), by_b, by_r]


def splines_along(s: Array, first: float, last: float) -> Splines:
    """Cubic B-splines along the edge; few enough to be held by few rows, many enough for a blob of light."""
    from scipy.interpolate import BSpline

    pieces = max(1, round((last - first) / KNOT_SPACING))
    degree = 3 if last - first > KNOT_SPACING / 2 else 2
    inner = np.linspace(first, last, pieces + 1)
    knots = np.concatenate([np.full(degree, first), inner, np.full(degree, last)])
    matrix = BSpline.design_matrix(np.clip(s, first, last), knots, degree)
    numbers = np.asarray(matrix.indices, dtype=np.intp).reshape(-1, degree + 1)[:, 0]
    return Splines(matrix.data.reshape(-1, degree + 1), numbers, len(knots) - degree - 1)
