"""Whether a second edge lies beside the contour, so near that it moves the fit.

A second, weaker step some pixels beside the first looks much like light that changes across the contour, as long as no
more is seen than the strip that is fitted. Farther away light that changes goes on, and a step has ended. So pixels of
a wider strip are asked. Of a step at a distance d on one side, half is a step at d on both sides, as a wider blur has
it, which moves no contour. The other half is the difference E(x - d) - E(x + d) of two steps: a bump about the contour.
How much of it is in what the fit leaves there, beside all that its own parameters take up, is a linear question for
each d (a score test). The largest of these answers, each with a standard deviation of 1, is above u by chance with a
probability of at most 2 Q(u) + L/pi exp(-u^2/2), L the length of the way that the direction of the bump takes with d
[davies1987]. Where there is a bump, steps on one side are fitted too, and the best one says how far it moves the
contour.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.edges.profile import disc_edge
from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.sided import SMALLEST
from radwrap.measure.gauges.strip import State, Strip, jacobian_of

Array = NDArray[np.float64]

FALSE_ALARM: Final = 0.002  # of this question, as of those for sides
_APART: Final = 0.5  # px from one place to the next
_DEPENDENT: Final = 1e-3  # of a column; where no more is left beside the fit's own it is rounding
_SAME: Final = 1e-9  # of the largest, of the fit's own columns: what is left there is rounding
_FEWEST: Final = 3  # pixels for each parameter of the fit, of fewer nothing is asked
_WAVES: Final = 3  # around a closed contour: to its inside, and to two sides of the image


def chance_of_largest(largest: float, length: float, ways: int = 1) -> float:
    """Probability, at most, that noise makes one of many answers as large as this.

    Parameters
    ----------
    largest : float
        In standard deviations of each answer; its sign does not matter.
    length : float
        Of the ways of the questions' directions together [rad]; 0 of single questions.
    ways : int
        How many ways there are.

    Examples
    --------
    >>> round(chance_of_largest(1.96, 0.0), 3)
    0.05
    """
    single = ways * math.erfc(abs(largest) / math.sqrt(2))
    return min(1.0, single + length / math.pi * math.exp(-(largest**2) / 2))


def moved_by_second_edge(shape: Shape, wide: Strip, state: State, *, reach: float, noise: float) -> float:
    """How far a second edge beside the contour, seen by more than chance, moves it [px]; 0 where none is seen.

    Parameters
    ----------
    shape
        Of one rim.
    wide, state
        Pixels that are asked, also farther away, and the fit with a sum of discs, with levels that suit them.
    reach : float
        Of the strip that was fitted, on either side [px]; a step whose blur does not touch it moves nothing.
    noise : float
        Variance of a weighted pixel.
    """
    if not wide.light.size:
        return 0.0
    fit = _Fit.of(shape, wide, state)
    if wide.light.size < _FEWEST * fit.own.shape[1]:
        return 0.0
    away = np.arange(_APART, float(np.abs(state.rims[0].distance).max()), _APART)
    # What lies there may be neither a slope nor an edge: then it counts as noise.
    sigma = math.sqrt(max(noise, fit.variance))
    waves = range(_WAVES if shape.closed else 1)
    found = [fit.beside(_steps(wide, state, away, wave) - _steps(wide, state, -away, wave)) for wave in waves]
    length = sum(one.length for one in found)
    largest = max(float(np.abs(one.gains).max(initial=0.0)) for one in found) / sigma
    contrast = float(np.median(np.abs(state.terms.at_rims(state.levels)[0][0]) * wide.weight))
    if largest * sigma < SMALLEST * contrast * math.sqrt(wide.light.size):
        return 0.0
    if chance_of_largest(largest, length, len(found)) >= FALSE_ALARM:
        return 0.0
    both = np.concatenate([-away[::-1], away])
    tried = [(fit.beside(_steps(wide, state, both, wave)), wave) for wave in waves]
    best, wave = max(tried, key=lambda one: float(np.abs(one[0].gains).max(initial=0.0)))
    place = both[best.which[np.abs(best.gains).argmax()]]
    if abs(place) - state.blur.radius > reach:
        return 0.0
    return float(np.abs(fit.change(_steps(wide, state, np.array([place]), wave)) / shape.units).max())


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """Columns beside those of a fit: which are not of the fit's own kind, and how much of each it leaves.

    `gains` are in the residual's units along directions of length 1, and `length` is that of their way [rad].
    """

    which: NDArray[np.intp]
    gains: Array
    length: float


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Derivatives of a fit, each as long as 1, their span, and what it leaves of the pixels and of what it holds."""

    jacobian: Array
    norms: Array
    own: Array
    residual: Array
    pixels: int
    parameters: int

    @classmethod
    def of(cls, shape: Shape, strip: Strip, state: State) -> _Fit:
        jacobian = jacobian_of(shape, strip, state)
        norms = np.linalg.norm(jacobian, axis=0)
        norms[norms == 0] = 1.0
        own, sizes, _ = np.linalg.svd(jacobian / norms, full_matrices=False)
        residual = np.concatenate([state.residual, -state.blur.held * state.blur.shares])
        return cls(
            jacobian / norms, norms, own[:, sizes > _SAME * sizes[0]], residual, strip.light.size, len(shape.units)
        )

    @property
    def variance(self) -> float:
        """Of a weighted pixel, by what a fit to the same pixels would leave."""
        left = self.residual - self.own @ (self.own.T @ self.residual)
        return float(np.sum(left**2) / max(len(left) - self.own.shape[1], 1))

    def beside(self, columns: Array) -> _Beside:
        """Columns of the pixels beside the fit's own."""
        whole = self._whole(columns)
        before = np.linalg.norm(whole, axis=0)
        whole -= self.own @ (self.own.T @ whole)
        after = np.linalg.norm(whole, axis=0)
        which = np.flatnonzero(after > _DEPENDENT * before)
        directions = whole[:, which] / after[which]
        turns = np.abs(np.sum(directions[:, 1:] * directions[:, :-1], axis=0))
        return _Beside(which, directions.T @ self.residual, float(np.arccos(np.clip(turns, 0.0, 1.0)).sum()))

    def change(self, column: Array) -> Array:
        """Of the shape's parameters, where a column is part of the model."""
        model = np.concatenate([self.jacobian, self._whole(column / np.linalg.norm(column))], axis=1)
        found = np.linalg.lstsq(model, self.residual, rcond=_SAME)[0]
        return np.asarray((found[:-1] / self.norms)[: self.parameters])

    def _whole(self, columns: Array) -> Array:
        whole = np.zeros((len(self.residual), columns.shape[1]))
        whole[: self.pixels] = columns
        return whole


def _steps(strip: Strip, state: State, away: Array, wave: int) -> Array:
    """Weighted light of second edges, of the contrast of the first, at these distances from it, shape (n, k)."""
    radius = state.blur.radius
    x = state.rims[0].distance[:, None] - away
    step = disc_edge(x + 0.5, radius, 1) - disc_edge(x - 0.5, radius, 1)
    scale = strip.weight * state.terms.at_rims(state.levels)[0][0] * state.terms.wide[:, wave]
    return np.asarray(scale[:, None] * step)
