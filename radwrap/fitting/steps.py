"""Damped steps of Gauss and Newton where renders are compared, whose rays have a grain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.covariance import GRAIN, lengths

Array = NDArray[np.float64]
# What a step must move the prediction by, in expected deviations; its square, what it must take from the sum.
STILL: Final = 0.3
_ENOUGH: Final = 3.0  # the same of a step that lowers nothing: the grain hides it
_ROUNDS: Final = 30
_TRIES: Final = 7  # of dampings in one round
_FEW_TRIES: Final = 2  # where the grain hides what a step brings
_LEAST_DAMPING: Final = 1e-3  # share of the largest singular value: a tenth of what stands out of the grain
_RAISED: Final = 5.0  # times, where a step does not lower the sum
_EASED: Final = 5.0  # times, where it does


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What pixels count in one round.

    Attributes
    ----------
    used : ndarray of bool, shape (captures * rows, columns)
        Pixels with a residual.
    sigma : ndarray, shape (pixels,)
        Expected deviations of the used ones [gray level].
    rounded : ndarray, shape (pixels,), or float
        What rounding is expected to add to the prediction of each [gray level].
    """

    used: NDArray[np.bool_]
    sigma: Array
    rounded: Array | float = 0.0


class Compared(Protocol):
    """Captures beside their prediction."""

    def weights(self, values: Array) -> Weights:
        """What pixels count at some values of the keys."""

    def left(self, values: Array, weights: Weights) -> Array:
        """(captured - predicted)/sigma, shape (pixels,)."""

    def slopes(self, values: Array, weights: Weights) -> Array:
        """Change of the prediction with each key's scale, over sigma, shape (pixels, keys)."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """Where the steps came to.

    Attributes
    ----------
    values : ndarray, shape (keys,)
        In the keys' units.
    rounds : int
        Steps.
    converged : bool
        Whether the last one moved the prediction by nothing that counts.
    """

    values: Array
    rounds: int
    converged: bool


def through_grain(
    compared: Compared,
    values: Array,
    scales: Array,
    bounds: Array,
    *,
    robust: bool = False,
    grain: float = 0.0,
    held_by: Array | None = None,
) -> Arrived:
    """Step in the directions that stand out of the grain of the rays.

    A solver that looks for the last digit of a sum that has steps asks for many renders, and wanders along what the
    captures do not determine: here such directions are not gone, and a step that does not lower the sum ends the fit.

    Parameters
    ----------
    compared : Compared
        What is fitted to what.
    values : ndarray, shape (keys,)
        Where to begin.
    scales : ndarray, shape (keys,)
        What a change of each value is measured by.
    bounds : ndarray, shape (2, keys)
        Lower and upper ones.
    robust : bool
        Whether single pixels that are far off count less.
    grain : float
        What the rays of the prediction are off by, in expected deviations: a step of less than that is the last one.
    held_by : ndarray, shape (keys,), optional
        What it counts that a key has gone by its scale from where it begins, in expected deviations; default nothing.
    """
    damping, rounds, still = 0.0, 0, max(STILL, grain)
    begun, held_by = values, np.zeros(len(values)) if held_by is None else held_by
    while rounds < _ROUNDS:
        rounds += 1
        weights = compared.weights(values)
        left = compared.left(values, weights)
        weight = (1 + left**2) ** -0.25 if robust else np.ones(left.size)
        jacobian = compared.slopes(values, weights) * weight[:, np.newaxis]
        jacobian = np.vstack([jacobian, np.diag(held_by)])
        left = np.concatenate([left * weight, held_by * (begun - values) / scales])
        sum_here = float((left**2).sum())
        led = _Directions.of(jacobian, left)
        # A key at its bound, which would be led beyond, is held.
        step = led.step()
        held = ((values <= bounds[0]) & (step < 0)) | ((values >= bounds[1]) & (step > 0))
        if held.any():
            jacobian = np.where(held, 0.0, jacobian)
            led = _Directions.of(jacobian, left)
        moved = float(np.linalg.norm(jacobian @ led.step()))
        hidden = moved < _ENOUGH * max(grain, 1.0)
        for _ in range(_FEW_TRIES if hidden else _TRIES):
            tried = np.clip(values + led.step(damping) * scales, bounds[0], bounds[1])
            away = float(((held_by * (begun - tried) / scales) ** 2).sum())
            gain = sum_here - away - _sum(compared, tried, weights, weight)
            if gain > 0:
                values, damping = tried, damping / _EASED if damping > _LEAST_DAMPING else 0.0
                break
            damping = max(damping * _RAISED, _LEAST_DAMPING)
        else:
            return Arrived(values, rounds, converged=hidden)
        if moved < still or gain < still**2:
            return Arrived(values, rounds, converged=True)
    return Arrived(values, rounds, converged=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Directions:
    """What is to be taken away, in the directions of a Jacobian that stand out of the grain.

    Attributes
    ----------
    parts : ndarray, shape (directions,)
        Of what is left, in each.
    singular : ndarray, shape (directions,)
        How much the prediction changes along each.
    largest : float
        Largest of these.
    keys : ndarray, shape (keys, directions)
        What moves in each.
    scale : ndarray, shape (keys,)
        Lengths of the Jacobian's columns.
    """

    parts: Array
    singular: Array
    largest: float
    keys: Array
    scale: Array

    @classmethod
    def of(cls, jacobian: Array, left: Array) -> _Directions:
        """Of a Jacobian over sigma, shape (pixels, keys), and what is left, shape (pixels,)."""
        scale = lengths(jacobian)
        vectors, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
        largest = float(singular.max(initial=0.0))
        good = singular > GRAIN * largest
        return cls(vectors[:, good].T @ left, singular[good], largest, right[good].T, scale)

    def step(self, damping: float = 0.0) -> Array:
        """What the keys move by, in their scales.

        Parameters
        ----------
        damping : float
            Share of the largest singular value, below which directions are gone along the less, the weaker they are.
        """
        shares = self.singular / (self.singular**2 + (damping * self.largest) ** 2)
        return np.asarray((self.keys * shares) @ self.parts / self.scale)


def _sum(compared: Compared, values: Array, weights: Weights, weight: Array) -> float:
    """Of squares; infinite where the scene does not take the values, as a step may lead into a wall."""
    try:
        left = compared.left(values, weights)
    except InputError:
        return np.inf
    return float(((left * weight) ** 2).sum())
