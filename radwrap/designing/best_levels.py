"""The best levels that a light basis can tell: by one objective, or between two."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.designing.light import CONVEX, LOCAL, MEANS, LightAim, Lit, LitBy
from radwrap.designing.local import worst
from radwrap.designing.quantities import TIME_OF_EXPOSURE, Constraint, Objective
from radwrap.errors import InputError
from radwrap.imaging.relight.relit import Basis
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]

_AT_BOUND: Final = 1e-7  # of a level's range: what a solver leaves of a bound
# Of a level's upper bound, in place of 0: a scene leaves a source without light out with its body, which a basis has.
_DARK: Final = 1e-6
_NEARLY: Final = 1 - 1e-6  # of the way to the best of the other objective: beyond it solvers find nothing
_NOTHING: Final = 1e-6  # of an objective: what levels change by less, they do not change
_HALVINGS: Final = 20  # of the way to where an objective is known: to a millionth of it

_Seen = tuple[Basis, Scene]


@dataclass(frozen=True, slots=True, eq=False)
class FoundLevels:
    """Levels that were found.

    Attributes
    ----------
    factors : Mapping of str to float
        Source of the basis -> factor on its level in the scene.
    levels : Mapping
        Key path -> level, as the scene's file would hold it.
    way : str
        `CONVEX` or `LOCAL`.
    value : float
        Of the objective, of radiant exposure without rounding, in SI; of the worst case where there are tolerances.
    at_low, at_high : tuple of str
        Key paths of levels that lie at a bound.
    around : tuple of Mapping of str to float
        As `factors`, of the basis of each corner of the tolerances.
    """

    factors: Mapping[str, float]
    levels: Mapping[str, Any]
    way: str
    value: float
    at_low: tuple[str, ...] = ()
    at_high: tuple[str, ...] = ()
    around: tuple[Mapping[str, float], ...] = ()


def best_levels(aim: LightAim, basis: Basis, scene: Scene, around: Sequence[tuple[Basis, Scene]] = ()) -> FoundLevels:
    """The best levels that a basis can tell.

    Parameters
    ----------
    aim : LightAim
        What they are sought for.
    basis : Basis
        Of the scene.
    scene : Scene
        As it stands.
    around : sequence of (Basis, Scene)
        Of each corner of the tolerances: the worst case counts, and limits hold in each.

    Raises
    ------
    InputError
        If no levels keep all limits.
    """
    bases = [basis, *(other for other, _ in around)]
    for one in bases:
        missing = [name for level in aim.levels for name in level.names if name not in one.sources]
        if missing:
            raise InputError(f"{missing[0]} is dark", where="levels")
    times = [1.0, *(other.camera.exposure_time / scene.camera.exposure_time for _, other in around)]
    aim = replace(aim, time_off=(min(times), max(times)))
    seen = ((basis, scene), *around)
    if aim.second is None:
        way, factors, value = _solved(aim, seen)
    else:
        way, factors, value = _between(aim, aim.second, seen)
    levels: dict[str, Any] = {}
    at_low: list[str] = []
    at_high: list[str] = []
    exact: list[float] = []
    for level, found_factor in zip(aim.sought, factors.tolist(), strict=True):
        near, factor = _AT_BOUND * (level.high - level.low), found_factor
        if factor <= level.low + near:
            factor, at_low = level.low or _DARK * level.high, [*at_low, level.path]
        elif factor >= level.high - near:
            factor, at_high = level.high, [*at_high, level.path]
        exact.append(factor)
        levels[level.path] = level.written(factor)
    own, *others = (_by_source(aim, exact, one) for one in bases)
    return FoundLevels(own, levels, way, value, tuple(at_low), tuple(at_high), tuple(others))


def _solved(aim: LightAim, seen: Sequence[_Seen]) -> tuple[str, Array, float]:
    """The best levels for one objective: how they were found, factors, and the objective of the worst image."""
    way = aim.way([basis.sensor for basis, _ in seen])
    light = Lit([LitBy(aim, *one) for one in seen])
    return (way, *(light.convex() if way == CONVEX else light.local()))


def _between(aim: LightAim, second: Objective, seen: Sequence[_Seen]) -> tuple[str, Array, float]:
    """The same between two objectives: the best levels by one within a limit of the other.

    The limit goes from what the one leads to by itself to the best of the other. All points of the front are of that
    kind, wherever it bends. The value is that of the first objective.
    """
    sensors = [basis.sensor for basis, _ in seen]
    main, other, share = aim.objective, second, aim.share
    if (
        _limited(aim, main, other, 0.0).way(sensors) != CONVEX
        and _limited(aim, other, main, 0.0).way(sensors) == CONVEX
    ):
        main, other, share = other, main, 1.0 - share
    images = [LitBy(aim, *one) for one in seen]

    def of(objective: Objective, factors: Array) -> float:
        return worst(images, objective, factors)

    way, factors, value = _solved(aim.alone(main), seen)
    reached = of(other, factors)
    if share > 0 or math.isnan(reached):
        there, best, _ = _best_of(aim.alone(other), seen)
        most = of(other, best)
        if math.isnan(most):
            raise InputError(f"{other.quantity.name} cannot be measured in any levels that were tried", where="levels")
        is_lost = math.isnan(reached)
        if is_lost:  # the front ends where it can be measured
            reached = of(other, _known_end(partial(of, other), factors, best))
        limit = reached + min(share, _NEARLY) * (most - reached)
        # Else the one has led to the best of the other already.
        if is_lost or other.sign * (reached - most) > _NOTHING * abs(reached):
            way, factors, value = _solved(_limited(aim, main, other, limit), seen)
        way = way if there == CONVEX else LOCAL
    return way, factors, value if main == aim.objective else of(aim.objective, factors)


def _known_end(measured: Callable[[Array], float], lost: Array, known: Array) -> Array:
    """The levels nearest to some in which a measurement is lost, on the way from others in which it is known."""
    for _ in range(_HALVINGS):
        middle = (lost + known) / 2
        lost, known = (middle, known) if math.isnan(measured(middle)) else (lost, middle)
    return known


def _limited(aim: LightAim, main: Objective, other: Objective, limit: float) -> LightAim:
    """For one objective, with the other no worse than a limit."""
    least, most = (limit, math.inf) if other.is_maximised else (-math.inf, limit)
    return aim.alone(main, Constraint(other.quantity, least, most))


def _best_of(aim: LightAim, seen: Sequence[_Seen]) -> tuple[str, Array, float]:
    """The same as `_solved`, but of a mean or a time, which are linear, exactly."""
    response, name = aim.response(aim.objective.quantity.name), aim.objective.quantity.name
    is_mean = response is not None and response.kind in MEANS and not response.repeatability and not response.user
    is_time = response is None and name == TIME_OF_EXPOSURE and aim.time is not None
    sensors = [basis.sensor for basis, _ in seen]
    is_linear = all(aim.is_linear(one, sensors) for one in (*aim.constraints, Constraint(aim.objective.quantity)))
    if len(seen) > 1 or not (is_mean or is_time) or not is_linear:
        return _solved(aim, seen)
    light = LitBy(aim, *seen[0])
    factors = light.extreme()
    return CONVEX, factors, light.measured(name, factors)


def _by_source(aim: LightAim, factors: Sequence[float], basis: Basis) -> dict[str, float]:
    """Source of a basis -> factor on its light there."""
    time = factors[-1] if aim.time is not None else 1.0
    found = dict.fromkeys(basis.sources, time)
    for level, factor in zip(aim.levels, factors, strict=False):
        found |= dict.fromkeys(level.names, factor * time)
    return found
