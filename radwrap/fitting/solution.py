"""The values that a fit finds: least squares, with weights that follow the prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.captured import Captured
from radwrap.fitting.covariance import GRAIN, RANK, inverse_of
from radwrap.fitting.free_keys import FreeKey
from radwrap.fitting.prediction import Predicted, Prediction
from radwrap.fitting.settled import Grain, Settled
from radwrap.fitting.steps import Weights, through_grain
from radwrap.fitting.weights import Weighed, weighed

Array = NDArray[np.float64]
_PRECISE: Final = 1e-13  # of the solver: below what the difference of two predictions tells
# Of the sum's gradient by a key's scale: the value is then off by this times its own variance.
_LEVEL: Final = 1e-8
_ROUNDS: Final = 40  # of weights
_STILL: Final = 1e-9  # expected deviations by which a round may still move the prediction, at most: the fit stands
_ENOUGH: Final = 1e-2  # the same after the last round: weights of a pixel go to and fro
_EVALUATIONS: Final = 100  # of one round
_INSIDE: Final = 1e-9  # of a key's scale: so far from its bounds the solver begins


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a fit came to.

    Attributes
    ----------
    values : ndarray, shape (keys,)
        In the keys' units.
    predicted : Predicted
        There.
    weighed : Weighed
        What each pixel counts there.
    residual : ndarray, shape (captures * rows, columns)
        (captured - predicted)/sigma; NaN where a pixel does not count.
    jacobian : ndarray, shape (pixels, keys)
        Change of the prediction with each key's scale, over sigma, of the used pixels.
    converged : bool
        Whether it stands.
    rounds : int
        How often weights were made.
    """

    values: Array
    predicted: Predicted
    weighed: Weighed
    residual: Array
    jacobian: Array
    converged: bool
    rounds: int


def solve(
    keys: Sequence[FreeKey],
    prediction: Prediction,
    captured: Sequence[Captured],
    noise: float | None,
    *,
    robust: bool,
    begin: Array | None = None,
    tolerance: float = 0.0,
) -> Solution:
    """Find the values by which prediction and captures agree best.

    Noise is that of the prediction: weights are made, a weighted problem is solved, and so on until neither moves.

    Parameters
    ----------
    keys : sequence of FreeKey
        What is sought.
    prediction : Prediction
        Of all captures.
    captured : sequence of Captured
        One for each state of the bench.
    noise : float or None
        Of one capture, where it is given [gray level].
    robust : bool
        Whether single pixels that are far off count less.
    begin : ndarray, shape (keys,), optional
        Where to begin; default the keys' own values.
    tolerance : float
        What the rays of the prediction may be off by [gray level]: a step is no better known.

    Raises
    ------
    InputError
        If all pixels are censored, or as `weighed`.
    """
    from scipy.optimize import least_squares

    scales = np.array([key.scale for key in keys])
    bounds = np.array([[key.low, key.high] for key in keys]).T / scales
    inside = np.where(np.isfinite(bounds), _INSIDE, 0.0)
    start = np.array([key.value for key in keys]) if begin is None else begin
    x = np.clip(start / scales, bounds[0] + inside[0], bounds[1] - inside[1])
    moved, rounds, ended = np.inf, 0, True
    against = _Against(prediction, tuple(captured), noise)
    if prediction.has_renders:
        within = np.clip(start, *(bounds * scales))
        grain = tolerance / float(np.median(against.weights(within).sigma))
        arrived = through_grain(against, within, scales, bounds * scales, robust=robust, grain=grain)
        return against.ended(arrived.values, arrived.rounds, converged=arrived.converged)
    while rounds < _ROUNDS and not moved < _STILL:
        rounds += 1
        counted = against.weighed(prediction.at(x * scales))
        used, sigma = counted.used, counted.sigma[counted.used]
        measured = against.mean[used]

        def misfit(
            at: Array, used: NDArray[np.bool_] = used, sigma: Array = sigma, measured: Array = measured
        ) -> Array:
            return np.asarray((prediction.at(at * scales).unclipped[used] - measured) / sigma)

        def slopes(at: Array, used: NDArray[np.bool_] = used, sigma: Array = sigma) -> Array:
            return np.asarray((prediction.slopes(at * scales)[:, used] / sigma).T)

        found = least_squares(
            misfit,
            x,
            jac=slopes,
            bounds=bounds,
            loss="soft_l1" if robust else "linear",
            xtol=_PRECISE,
            ftol=_PRECISE,
            gtol=_LEVEL,
            max_nfev=_EVALUATIONS,
            x_scale="jac",
        )
        ended = found.status > 0
        moved = float(np.linalg.norm(found.jac @ (found.x - x)))
        x = found.x
    return against.ended(x * scales, rounds, converged=ended and moved < _ENOUGH)


def settle(
    keys: Sequence[FreeKey],
    near: Settled,
    captured: Sequence[Captured],
    noise: float | None,
    *,
    robust: bool,
    begin: Array,
) -> tuple[Solution, Grain]:
    """Find the values near a place, by what is smooth there.

    Steps of Gauss and Newton, in which slopes are no steeper than their grain lets them be, and what the rays of the
    prediction have to do with those of its slopes does not pull.

    Parameters
    ----------
    keys, captured, noise, robust
        As of `solve`.
    near : Settled
        The prediction there.
    begin : ndarray, shape (keys,)
        Where to begin.

    Returns
    -------
    Solution, Grain
        The grain over the deviations where it begins.

    Raises
    ------
    InputError
        As `solve`.
    """
    scales = np.array([key.scale for key in keys])
    low, high = np.array([[key.low, key.high] for key in keys]).T
    against = _Against(near, tuple(captured), noise)
    share = GRAIN if near.has_renders else RANK
    start = np.clip(begin, low, high)
    values, grain, rounds, moved = start, None, 0, np.inf
    while rounds < _ROUNDS and not moved < _STILL:
        rounds += 1
        weights = against.weights(values)
        left = against.left(values, weights)
        weight = (1 + left**2) ** -0.25 if robust else np.ones(left.size)
        if grain is None:
            grain = near.grain(values, weights.used, weights.sigma / weight)
        jacobian = against.slopes(values, weights) * weight[:, np.newaxis]
        pull = grain.pull_at(values - start, scales)
        step = _step(jacobian, left * weight, grain, pull, share)
        # A key at its bound, which would be led beyond, is held.
        held = ((values <= low) & (step < 0)) | ((values >= high) & (step > 0))
        if held.any():
            step = _step(np.where(held, 0.0, jacobian), left * weight, grain, pull, share)
        tried = np.clip(values + step * scales, low, high)
        moved = float(np.linalg.norm(jacobian @ ((tried - values) / scales)))
        values = tried
    assert grain is not None  # noqa: S101  (there is a first round)
    return against.ended(values, rounds, converged=moved < _ENOUGH), grain


def _step(jacobian: Array, left: Array, grain: Grain, pull: Array, share: float) -> Array:
    """What the keys move by, in their scales."""
    inverse = inverse_of(jacobian, share, grain.slopes)
    return np.asarray(inverse.matrix @ left + inverse.square @ pull)


@dataclass(frozen=True, slots=True, eq=False)
class _Against:
    """What is fitted to what."""

    prediction: Prediction | Settled
    captured: tuple[Captured, ...]
    noise: float | None

    @property
    def mean(self) -> Array:
        """All captures, one below the other [gray level]."""
        return np.concatenate([one.mean for one in self.captured])

    def weighed(self, predicted: Predicted) -> Weighed:
        """What each pixel counts."""
        found = [
            weighed(part.exposure, part.unclipped, one, part.sensor, self.noise)
            for part, one in zip(predicted.parts, self.captured, strict=True)
        ]
        if not any(one.used.any() for one in found):
            raise InputError(
                "no pixel is left: all are saturated or dark in capture and prediction",
                where="CAPTURE",
                remedy="capture with another exposure time, or begin with other values",
            )
        return Weighed(
            *(np.concatenate([getattr(one, name) for one in found]) for name in ("sigma", "used", "censored"))
        )

    def weights(self, values: Array) -> Weights:
        """Of the used pixels, for `through_grain`."""
        counted = self.weighed(self.prediction.at(values))
        return Weights(counted.used, counted.sigma[counted.used])

    def left(self, values: Array, weights: Weights) -> Array:
        """(captured - predicted)/sigma of the used pixels."""
        return np.asarray((self.mean - self.prediction.at(values).unclipped)[weights.used] / weights.sigma)

    def slopes(self, values: Array, weights: Weights) -> Array:
        """Change of the prediction with each key's scale, over sigma, shape (pixels, keys)."""
        return np.asarray((self.prediction.slopes(values)[:, weights.used] / weights.sigma).T)

    def ended(self, values: Array, rounds: int, *, converged: bool) -> Solution:
        """Where a fit came to."""
        predicted = self.prediction.at(values)
        counted = self.weighed(predicted)
        residual = np.where(counted.used, (self.mean - predicted.unclipped) / counted.sigma, np.nan)
        jacobian = (self.prediction.slopes(values)[:, counted.used] / counted.sigma[counted.used]).T
        return Solution(values, predicted, counted, residual, jacobian, converged, rounds)
