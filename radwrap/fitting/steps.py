"""Gauss and Newton's steps where renders are compared, whose rays have a grain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.covariance import GRAIN, determined_inverse

Array = NDArray[np.float64]
STILL: Final = 0.3  # what a step must move the prediction by, in expected deviations
_ENOUGH: Final = 1.0  # the same of a step that the grain hides
_ROUNDS: Final = 15
_HALVINGS: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What pixels count in one round.

    Attributes
    ----------
    used : ndarray of bool, shape (captures * rows, columns)
        Pixels with a residual.
    sigma : ndarray, shape (pixels,)
        Expected deviations of the used ones [gray level].
    """

    used: NDArray[np.bool_]
    sigma: Array


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


def through_grain(compared: Compared, values: Array, scales: Array, bounds: Array, *, robust: bool = False) -> Arrived:
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
    """
    moved, rounds = np.inf, 0
    while rounds < _ROUNDS and not moved < STILL:
        rounds += 1
        weights = compared.weights(values)
        left = compared.left(values, weights)
        weight = (1 + left**2) ** -0.25 if robust else np.ones(left.size)
        jacobian = compared.slopes(values, weights) * weight[:, np.newaxis]
        step = determined_inverse(jacobian, GRAIN) @ (left * weight)
        for _ in range(_HALVINGS):
            tried = np.clip(values + step * scales, bounds[0], bounds[1])
            if _sum(compared, tried, weights, weight) < float(((left * weight) ** 2).sum()):
                moved = float(np.linalg.norm(jacobian @ ((tried - values) / scales)))
                values = tried
                break
            step = step / 2
        else:
            moved = float(np.linalg.norm(jacobian @ step))
            return Arrived(values, rounds, converged=moved < _ENOUGH)
    return Arrived(values, rounds, converged=moved < STILL)


def _sum(compared: Compared, values: Array, weights: Weights, weight: Array) -> float:
    """Of squares; infinite where the scene does not take the values, as a step may lead into a wall."""
    try:
        left = compared.left(values, weights)
    except InputError:
        return np.inf
    return float(((left * weight) ** 2).sum())
