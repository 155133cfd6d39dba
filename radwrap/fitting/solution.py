"""The values that a fit finds: least squares, with weights that follow the prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError, ToleranceNotMet
from radwrap.fitting.captured import Captured
from radwrap.fitting.covariance import GRAIN, PULLED, RANK, inverse_of, shown
from radwrap.fitting.free_keys import FreeKey
from radwrap.fitting.prediction import Predicted, Prediction
from radwrap.fitting.settled import Grained, Settled
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
_TOO_FAR: Final = 1e6  # of a key's scale, from where it begins: no value is sought there
_CREEPS: Final = 2  # rounds one after the other that end nowhere
# Singular values, over the largest, by which the first place is left: its slopes are those of the search, and only lead
# to where finer ones are seen. Down to 1e-2 they led exposures to and fro by a third.
_ROUGH: Final = 5e-2
_BY_NOISE: Final = 3.0  # expected deviations that captures pull by along what is weak, and nothing need be wrong
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
    robust : bool
        Whether single pixels that are far off count less.
    """

    values: Array
    predicted: Predicted
    weighed: Weighed
    residual: Array
    jacobian: Array
    converged: bool
    rounds: int
    robust: bool = False

    @property
    def weight(self) -> Array:
        """By how much less each used pixel moves the values, shape (pixels,); its square is the slope of its pull."""
        left = self.residual[self.weighed.used]
        return _pulls(left) if self.robust else np.ones(left.size)

    @property
    def variance(self) -> Array | None:
        """Of what each used pixel pulls by noise, over its weight; None where it is 1.

        That of all pixels together (P. J. Huber, Robust Statistics, 1981, section 7.6). The noise is known: no fit is
        surer than by squares, as a perfect fit to few pixels would seem to be.
        """
        if not self.robust:
            return None
        left = self.residual[self.weighed.used]
        weight = self.weight
        pulls = float((left**2 / (1 + left**2)).sum()) / max(left.size - self.jacobian.shape[1], 1)
        return np.asarray(max(pulls, float((weight**2).mean()) ** 2) / weight**2)


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
    ToleranceNotMet
        If the best lies at infinity.
    """
    from scipy.optimize import least_squares

    scales = np.array([key.scale for key in keys])
    bounds = np.array([[key.low, key.high] for key in keys]).T / scales
    inside = np.where(np.isfinite(bounds), _INSIDE, 0.0)
    start = np.array([key.value for key in keys]) if begin is None else begin
    x = np.clip(start / scales, bounds[0] + inside[0], bounds[1] - inside[1])
    moved, rounds, creeps = np.inf, 0, 0
    first = x
    against = _Against(prediction, tuple(captured), noise)
    if prediction.has_renders:
        within = np.clip(start, *(bounds * scales))
        grain = tolerance / float(np.median(against.weights(within).sigma))
        arrived = through_grain(against, within, scales, bounds * scales, robust=robust, grain=grain)
        return against.ended(arrived.values, arrived.rounds, converged=arrived.converged, robust=robust)
    while rounds < _ROUNDS and not moved < _STILL and creeps < _CREEPS:
        rounds += 1
        counted = against.weighed(prediction.at(x * scales))
        used, sigma = counted.used, counted.sigma[counted.used]
        measured = (against.mean - counted.rounded)[used]

        def misfit(
            at: Array, used: NDArray[np.bool_] = used, sigma: Array = sigma, measured: Array = measured
        ) -> Array:
            _check_near(keys, at - first)
            try:
                predicted = prediction.at(at * scales)
            except InputError as error:
                raise _runs_off(f"to where the scene takes no value: {error.what}", error.where) from error
            return np.asarray((predicted.unclipped[used] - measured) / sigma)

        def slopes(at: Array, used: NDArray[np.bool_] = used, sigma: Array = sigma) -> Array:
            return shown((prediction.slopes(at * scales)[:, used] / sigma).T)

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
        creeps = 0 if found.status > 0 else creeps + 1
        moved = float(np.linalg.norm(found.jac @ (found.x - x)))
        x = found.x
    return against.ended(x * scales, rounds, converged=not creeps and moved < _ENOUGH, robust=robust)


def settle(
    keys: Sequence[FreeKey],
    near: Settled,
    captured: Sequence[Captured],
    noise: float | None,
    *,
    robust: bool,
    begin: Array,
) -> tuple[Solution, Grained]:
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
    Solution, Grained
        What rays have to do with slopes where it begins.

    Raises
    ------
    InputError, ToleranceNotMet
        As `solve`.
    """
    scales = np.array([key.scale for key in keys])
    low, high = np.array([[key.low, key.high] for key in keys]).T
    against = _Against(near, tuple(captured), noise)
    shares = _shares(near)
    start = np.clip(begin, low, high)
    values, rounds, moved = start, 0, np.inf
    while rounds < _ROUNDS and not moved < _STILL:
        rounds += 1
        weights = against.weights(values)
        left = against.left(values, weights)
        weight = (1 + left**2) ** -0.25 if robust else np.ones(left.size)
        # Here, and not along slopes from where it begins: levels and the exposure multiply, and so does their error.
        grained = near.grained(values)
        grain = grained.over(weights.used, weights.sigma / weight)
        # Where a pixel that is far off counts less, a little more of it pulls by the slope of its pull.
        pulling = grained.over(weights.used, weights.sigma / _pulls(left)) if robust else grain
        jacobian = against.slopes(values, weights) * weight[:, np.newaxis]
        step = _step(jacobian, left * weight, grain.slopes, pulling.pull, shares)
        # A key at its bound, which would be led beyond, is held.
        held = ((values <= low) & (step < 0)) | ((values >= high) & (step > 0))
        if held.any():
            step = _step(np.where(held, 0.0, jacobian), left * weight, grain.slopes, pulling.pull, shares)
        tried = np.clip(values + step * scales, low, high)
        moved = float(np.linalg.norm(jacobian @ ((tried - values) / scales)))
        values = tried
        _check_near(keys, (values - start) / scales)
    return against.ended(values, rounds, converged=moved < _ENOUGH, robust=robust), grained


def _check_near(keys: Sequence[FreeKey], away: Array) -> None:
    """See that no key has gone so many scales away that it goes on without end."""
    bounded = np.array([math.isfinite(key.low) and math.isfinite(key.high) for key in keys])
    far = np.where(bounded, 0.0, np.abs(away))  # between two bounds none goes on
    farthest = int(far.argmax())
    if far[farthest] > _TOO_FAR:
        raise _runs_off("away from where it began", keys[farthest].key)


def _runs_off(whither: str, key: str) -> ToleranceNotMet:
    """What is to be said of a fit whose best lies at infinity."""
    return ToleranceNotMet(
        f"the fit goes on and on {whither}",
        where=key,
        remedy="nothing is best there: give the key bounds, KEY=low:high, or free fewer keys",
    )


def _pulls(left: Array) -> Array:
    """Root of the slope of a pixel's pull, by the soft L1 loss 2 sqrt(1 + r^2) - 2: the pull is r/sqrt(1 + r^2)."""
    return np.asarray((1 + left**2) ** -0.75)


def _shares(near: Settled) -> tuple[float, float]:
    """Of the largest singular value: what is gone along in any case, and what where captures pull."""
    if not near.has_renders:
        return RANK, RANK
    return (GRAIN, PULLED) if near.is_last else (_ROUGH, _ROUGH)


def _step(jacobian: Array, left: Array, grain: Array, pull: Array, shares: tuple[float, float]) -> Array:
    """What the keys move by, in their scales.

    Along what is weak beside the rest noise leads far, and slopes may be off by a third: there a step is the shorter,
    the nearer its pull is to what noise pulls by. So the captures are explained, and nothing wanders.
    """
    sure, every = (inverse_of(jacobian, share, grain) for share in shares)
    step = sure.matrix @ left + sure.square @ pull
    weak = every.matrix @ left + every.square @ pull - step
    pulled = float(np.linalg.norm(jacobian @ weak))
    return np.asarray(step + max(1 - (_BY_NOISE / pulled) ** 2, 0.0) * weak if pulled else step)


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
            *(
                np.concatenate([getattr(one, name) for one in found])
                for name in ("sigma", "used", "censored", "rounded")
            )
        )

    def weights(self, values: Array) -> Weights:
        """Of the used pixels, for `through_grain`."""
        counted = self.weighed(self.prediction.at(values))
        return Weights(counted.used, counted.sigma[counted.used], counted.rounded[counted.used])

    def left(self, values: Array, weights: Weights) -> Array:
        """(captured - predicted)/sigma of the used pixels."""
        left = (self.mean - self.prediction.at(values).unclipped)[weights.used]
        return np.asarray((left - weights.rounded) / weights.sigma)

    def slopes(self, values: Array, weights: Weights) -> Array:
        """Change of the prediction with each key's scale, over sigma, shape (pixels, keys)."""
        return np.asarray((self.prediction.slopes(values)[:, weights.used] / weights.sigma).T)

    def ended(self, values: Array, rounds: int, *, converged: bool, robust: bool) -> Solution:
        """Where a fit came to."""
        predicted = self.prediction.at(values)
        counted = self.weighed(predicted)
        left = self.mean - predicted.unclipped - counted.rounded
        residual = np.where(counted.used, left / counted.sigma, np.nan)
        jacobian = (self.prediction.slopes(values)[:, counted.used] / counted.sigma[counted.used]).T
        return Solution(values, predicted, counted, residual, jacobian, converged, rounds, robust)
