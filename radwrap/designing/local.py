"""Levels near those of the scene: what is no convex program is searched on the light basis, step by step.

COBYQA (T. M. Ragonneau and Z. Zhang, 2022) models objective and limits by quadratic functions, and minds no noise.
SLSQP (D. Kraft, 1988) goes on by slopes from where it ended, and ends exactly where limits meet. Kinks are hard for
both, so that they get none where that can be. The brightest pixel is below a limit where each pixel is, and light of a
pixel is linear in the levels. The worst of several images is a number that none of them exceeds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from radwrap.designing.convex import Limit
from radwrap.designing.quantities import SCENES_OWN, Constraint, Objective

Array = NDArray[np.float64]

_LOOKS: Final = 60  # of a search, for each level
_TRIES: Final = 20  # times that it goes on where it ended
_STEP: Final = 1e-4  # of slopes, as a factor on a level
_LITTLE: Final = 1e-5  # of the objective, and of limits: what it ends with
_BELOW_FULL: Final = 0.9  # of the light of a full pixel, with which it begins at most
_NEAR: Final = 0.02  # of a limit: so near it a pixel may be the next one to break it
_BANDS: Final = 8  # parts of an image, of each of which the brightest pixel is looked at
_UNKNOWN: Final = 1e3  # times the objective at the start: what cannot be measured is as bad


class Image(Protocol):
    """What is known of an image in any levels."""

    low: Array
    high: Array

    def measured(self, name: str, factors: Array) -> float:
        """A quantity; NaN where it cannot be measured."""

    def share_of_full(self, factors: Array) -> float:
        """Light of the brightest pixel over that of a full one."""

    def peak(self, constraint: Constraint) -> Limit | None:
        """Light of pixels below a limit, which is linear in the levels; None where a limit is no such one."""


def best_nearby(images: Sequence[Image], objective: Objective, constraints: Sequence[Constraint]) -> Array:
    """Levels that are best in the worst of some images, as far as a local search finds them.

    Parameters
    ----------
    images : sequence of Image
        The scene as it stands, and in the corners of its tolerances.
    objective : Objective
        What is made small, or large.
    constraints : sequence of Constraint
        Limits, in each image.

    Returns
    -------
    ndarray, shape (levels,)
        As factors on those of the scene, within their bounds. Where nothing keeps all limits, what breaks them least.
    """
    low, high = images[0].low, images[0].high
    start = _unsaturated(images, np.clip(np.ones(len(low)), low, high))
    name, sign = objective.quantity.name, objective.sign
    base = worst(images, objective, start)
    scale = abs(base) if base and math.isfinite(base) else 1.0

    def small(image: Image, x: Array) -> float:
        value = sign * image.measured(name, x) / scale
        return value if math.isfinite(value) else _UNKNOWN

    asked = [one for one in constraints if one.quantity.name not in SCENES_OWN]
    cuts, limits = list[_Cut](), list[Any]()
    for image, one in itertools.product(images, asked):
        if (peak := image.peak(one)) is None:
            limits.append(_limit(image, one, len(low)))
        else:
            cuts.append(_Cut(peak, start))
    bounds = list(zip(low, high, strict=True))
    if len(images) == 1:
        found = _searched(partial(small, images[0]), start, bounds, limits, cuts)
    else:
        limits += [_none_above(image, small) for image in images]
        begin = np.append(start, max(small(image, start) for image in images))
        found = _searched(_last, begin, [*bounds, (-np.inf, np.inf)], limits, cuts)
    return np.clip(found[: len(low)], low, high)


def _last(x: Array) -> float:
    """The worst of several images, which is one variable more."""
    return float(x[-1])


def worst(images: Sequence[Image], objective: Objective, factors: Array) -> float:
    """The objective in the image where it is worst; NaN where one cannot be measured."""
    values = [objective.sign * image.measured(objective.quantity.name, factors) for image in images]
    return objective.sign * float(np.max(values))


def _unsaturated(images: Sequence[Image], factors: Array) -> Array:
    """Levels that are so much lower, as far as they may be, that no image is saturated: nothing is learnt there."""
    share = max(image.share_of_full(factors) for image in images)
    return np.clip(factors * min(1.0, _BELOW_FULL / share if share else 1.0), images[0].low, images[0].high)


def _limit(image: Image, one: Constraint, count: int) -> Any:
    from scipy.optimize import NonlinearConstraint

    size = max([abs(end) for end in (one.low, one.high) if math.isfinite(end)]) or 1.0
    name = one.quantity.name
    return NonlinearConstraint(lambda x: image.measured(name, x[:count]) / size, one.low / size, one.high / size)


def _none_above(image: Image, small: Callable[[Image, Array], float]) -> Any:
    from scipy.optimize import NonlinearConstraint

    return NonlinearConstraint(lambda x: small(image, x[:-1]) - x[-1], -np.inf, 0.0)


class _Cut:
    """Pixels that have come near a limit of the brightest one; levels are the first variables of a search."""

    def __init__(self, limit: Limit, start: Array) -> None:
        self._light, self._most = limit.light / limit.high, 1 - limit.light[:, -1] / limit.high
        self._used: set[int] = set()
        self._used |= self._brightest(start)

    def _lit(self, x: Array) -> Array:
        return np.asarray(self._light[:, :-1] @ x[: self._light.shape[1] - 1])

    def _brightest(self, x: Array) -> set[int]:
        light = self._lit(x)
        return {int(part[light[part].argmax()]) for part in np.array_split(np.arange(len(light)), _BANDS)}

    def taken(self, x: Array) -> float:
        """Take in what is near the limit now; the share of it by which it is broken by what was not known."""
        excess = self._lit(x) - self._most
        new = {pixel for pixel in self._brightest(x) if excess[pixel] > -_NEAR} - self._used
        self._used |= new
        return max([0.0, *(float(excess[pixel]) for pixel in new)])

    def as_constraint(self, count: int) -> Any:
        """Of the first variables of so many."""
        from scipy.optimize import LinearConstraint

        rows = sorted(self._used)
        light = self._light[rows, :-1]
        return LinearConstraint(np.pad(light, ((0, 0), (0, count - light.shape[1]))), -np.inf, self._most[rows])


def _searched(
    aim: Callable[[Array], float],
    begin: Array,
    bounds: Sequence[tuple[float, float]],
    limits: Sequence[Any],
    cuts: Sequence[_Cut],
) -> Array:
    """Where the search ends: it begins anew where it ended, until that brings nothing."""
    from scipy.optimize import minimize

    reached = (math.inf, math.inf)
    wide = {"maxfev": _LOOKS * len(begin)}
    steep = {"eps": _STEP, "maxiter": _LOOKS, "ftol": _LITTLE / 10}
    for number in range(_TRIES):
        method, options = ("SLSQP", steep) if number % 2 else ("COBYQA", wide)
        every = [*limits, *(cut.as_constraint(len(begin)) for cut in cuts)]
        result = minimize(aim, begin, method=method, bounds=bounds, constraints=every, options=options)
        broken = max([0.0, *(cut.taken(result.x) for cut in cuts)])
        here = (max(_excess(every, result.x) - _LITTLE, 0.0), float(aim(result.x)))
        if broken > _LITTLE:  # by pixels that were not asked: it is no end
            begin, reached = result.x, (math.inf, math.inf)
        elif here < reached:
            gain, begin, reached = reached[1] - here[1], result.x, here
            if number % 2 and not here[0] and gain < _LITTLE * abs(here[1]):
                break
        elif number % 2:
            break
    return np.asarray(begin, dtype=np.float64)


def _excess(constraints: Sequence[Any], x: Array) -> float:
    """By how much the limit that is broken most is broken."""
    from scipy.optimize import LinearConstraint

    found = [0.0]
    for one in constraints:
        value = np.atleast_1d(one.A @ x if isinstance(one, LinearConstraint) else one.fun(x))
        if not np.isfinite(value).all():  # even one without a limit is broken by what cannot be measured
            return math.inf
        found += [float(np.max(value - one.ub)), float(np.max(one.lb - value))]
    return max(found)
