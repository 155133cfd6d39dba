"""Levels of sources for the most even light, as convex programs in radiant exposure.

Light of a place is linear in the levels x. Unevenness is a ratio, which stays where all light is scaled: in y = x t,
where 1/t is the mean light, the mean is held at 1, and what is left to make small is the variance, a quadratic program,
or max - min, a linear one (A. Charnes and W. W. Cooper, 1962). Limits of levels and of light stay linear in (y, t).

Where the light may be off, the worst of several images counts. Each has a ratio f/g of its own, and only one mean can
be held. With r, the worst ratio of the levels so far, the largest of (f - r g)/g' is made small, where g' is g of these
levels: a program of cones, whose solution has a smaller worst ratio, until there is none (J.-P. Crouzeix, J. A. Ferland
and S. Schaible, 1985).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.extras import require

Array = NDArray[np.float64]
Measure = Literal["deviation", "extremes"]

_EXACT: Final = 1e-11  # of the solver's gaps; uniformity is asked for to 1e-6
_GAIN: Final = 1e-9  # of the worst ratio, below which a further program is in vain
_BROKEN: Final = 1e-9  # of a limit: by so little a place may lie beyond it
_WORST: Final = 200  # places that are added to a program at a time
_MOST_ROUNDS: Final = 100
_SOLVED: Final = ("Solved", "AlmostSolved")


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """Limits of light at some places: low <= light <= high.

    Attributes
    ----------
    light : ndarray, shape (places, sources + 1)
        Of each source at level 1 [J m^-2]; the last column is light that does not change.
    low, high : float
        [J m^-2]; infinite where there is none.
    """

    light: Array
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class EvenLight:
    """What is to be lit evenly.

    Attributes
    ----------
    cells : ndarray, shape (cells, sources + 1)
        Mean light of each cell by each source at level 1 [J m^-2]; the last column is light that does not change.
    weights : ndarray, shape (cells,)
        Share of the region that each cell has; their sum is 1.
    low, high : ndarray, shape (sources,)
        Bounds of the levels, from 0 on.
    limits : tuple of Limit
        Of light.
    is_timed : bool
        Whether the last source is the exposure time: its level multiplies the bounds of all others, whose levels are
        those that their light has then; no light is there that does not change.
    """

    cells: Array
    weights: Array
    low: Array
    high: Array
    limits: tuple[Limit, ...] = ()
    is_timed: bool = False


def unevenness(problem: EvenLight, levels: Array, measure: Measure) -> float:
    """Standard deviation over mean, or (max - min)/(max + min), of the cells' light for some levels."""
    return _ratio(problem, np.append(levels, 1.0), measure)


def _ratio(problem: EvenLight, point: Array, measure: Measure) -> float:
    """The same for (y, t): all light may be scaled."""
    light = problem.cells @ point
    if measure == "extremes":
        return float((light.max() - light.min()) / (light.max() + light.min()))
    mean = float(problem.weights @ light)
    return float(np.sqrt(problem.weights @ (light - mean) ** 2)) / mean


def most_even(problem: EvenLight, measure: Measure, around: Sequence[EvenLight] = ()) -> Array:
    """The levels of least unevenness; of those that differ by a factor only, the brightest.

    Parameters
    ----------
    problem : EvenLight
        With n sources.
    measure : str
        "deviation": standard deviation over mean; "extremes": (max - min)/(max + min).
    around : sequence of EvenLight
        The same in other light, as it may be too: the worst counts, and limits hold in each. Bounds are those of
        `problem`.

    Returns
    -------
    ndarray, shape (n,)
        Levels within their bounds; with a time those of the light: level times time, and the time.

    Raises
    ------
    InputError
        If no levels keep all limits.
    EnvironmentFailure
        If the solver is not installed, or does not come to an end.
    """
    scale = float(problem.cells.sum(axis=1).mean())  # so that the numbers of the program are near 1
    if not scale > 0:
        raise InputError("no light reaches the region", where="levels")
    images = [replace(one, cells=one.cells / scale) for one in (problem, *around)]
    limits = [
        Limit(limit.light / scale, limit.low / scale, limit.high / scale) for one in images for limit in one.limits
    ]
    cuts = _Cuts(_bounds(problem), limits)
    point = cuts.within(partial(_solved, images[0], measure))
    for _ in range(_MOST_ROUNDS if around else 0):
        before = point
        point = cuts.within(partial(_solved_for_worst, images, measure, before))
        gain = _worst(images, before, measure) - _worst(images, point, measure)
        if gain <= _GAIN:
            return _levels(problem, images, limits, before if gain < 0 else point)
    return _levels(problem, images, limits, point)


def least(problem: EvenLight, row: Array) -> Array:
    """The levels at which a row times the levels is least, within bounds and limits; errors as of `most_even`.

    Parameters
    ----------
    problem : EvenLight
        Whose bounds and limits hold.
    row : ndarray, shape (n + 1,)
        What is to be small; its last number does not count.
    """
    scale = float(problem.cells.sum(axis=1).mean())
    if not scale > 0:
        raise InputError("no light reaches the region", where="levels")
    limits = [Limit(one.light / scale, one.low / scale, one.high / scale) for one in problem.limits]
    count = len(row)
    cost = row / max(float(np.abs(row[:-1]).max()), 1e-300)
    held = np.eye(count)[-1]  # t = 1: the levels themselves
    solved = partial(_program, np.zeros((count, count)), cost, held)
    point = _Cuts(_bounds(problem), limits).within(solved)
    return _levels(problem, [problem], limits, point, is_held=True)


class _Cuts:
    """Rows of bounds, and of those places at which a limit has been broken so far; the others need none."""

    def __init__(self, bounds: Array, limits: Sequence[Limit]) -> None:
        self._bounds, self._limits = bounds, limits
        self._used = [np.zeros(len(limit.light), dtype=bool) for limit in limits]

    def within(self, solved: Callable[[Array], Array]) -> Array:
        """(y, t) of a program of rows, within all limits."""
        for _ in range(_MOST_ROUNDS):
            cut = (_rows(limit, here) for limit, here in zip(self._limits, self._used, strict=True))
            point = solved(np.vstack([self._bounds, *cut]))
            broken = [_broken(limit, point) for limit in self._limits]
            new = [~here & beyond for here, beyond in zip(self._used, broken, strict=True)]
            if not any(one.any() for one in new):
                return point
            self._used = [here | more for here, more in zip(self._used, new, strict=True)]
        raise EnvironmentFailure("the convex program of the levels did not finish", where="levels")


def _bounds(problem: EvenLight) -> Array:
    """Rows r with r (y, t) <= 0 of the levels' bounds, and of t > 0."""
    count = len(problem.low)
    one = np.eye(count)
    below = np.hstack([-one, problem.low[:, np.newaxis]])
    above = np.hstack([one, -problem.high[:, np.newaxis]])
    if problem.is_timed:
        for rows in (below, above):
            rows[:-1, -2] += rows[:-1, -1]
            rows[:-1, -1] = 0.0
    return np.vstack([below, above, np.append(np.zeros(count), -1.0)])


def _rows(limit: Limit, used: NDArray[np.bool_]) -> Array:
    """The same of places whose light is limited: the last column is times t, as the limit is."""
    light = limit.light[used]
    rows = []
    if np.isfinite(limit.high):
        rows.append(light - np.append(np.zeros(light.shape[1] - 1), limit.high))
    if np.isfinite(limit.low):
        rows.append(np.append(np.zeros(light.shape[1] - 1), limit.low) - light)
    return np.vstack(rows) if rows else np.zeros((0, light.shape[1]))


def _broken(limit: Limit, point: Array) -> NDArray[np.bool_]:
    """The places where a limit is broken most, if anywhere."""
    light = limit.light @ point
    t = point[-1]
    excess = np.zeros(len(light))
    for bound, sign in ((limit.high, 1.0), (limit.low, -1.0)):
        if np.isfinite(bound):
            excess = np.maximum(excess, sign * (light - bound * t) - _BROKEN * max(abs(bound) * t, 1e-12))
    found = np.zeros(len(light), dtype=bool)
    found[np.argsort(-excess, kind="stable")[:_WORST]] = True
    return found & (excess > 0)


def _solved(image: EvenLight, measure: Measure, rows: Array) -> Array:
    """(y, t) of the program: mean 1, rows (y, t) <= 0."""
    cells, weights = image.cells, image.weights
    mean = weights @ cells
    count = cells.shape[1]
    if measure == "deviation":
        spread = _spread(image)
        return _program(2 * spread.T @ spread, np.zeros(count), mean, rows)[:count]
    # Two more variables: the brightest and the darkest cell, with sum 2.
    wide = np.hstack([rows, np.zeros((len(rows), 2))])
    cost = np.append(np.zeros(count), [1.0, -1.0])
    held = np.append(np.zeros(count), [0.5, 0.5])
    return _program(np.zeros((count + 2, count + 2)), cost, held, np.vstack([wide, _ends(cells)]))[:count]


def _ends(cells: Array) -> Array:
    """Rows of two more variables, above the brightest cell and below the darkest one."""
    ones, none = np.ones((len(cells), 1)), np.zeros((len(cells), 1))
    return np.vstack([np.hstack([cells, -ones, none]), np.hstack([-cells, none, ones])])


def _spread(image: EvenLight) -> Array:
    """The matrix whose product with (y, t) has the standard deviation as its length."""
    return np.asarray(np.sqrt(image.weights)[:, np.newaxis] * (image.cells - image.weights @ image.cells))


def _size(image: EvenLight, point: Array, measure: Measure) -> float:
    """What unevenness is a share of: mean, or max + min, of the light."""
    light = image.cells @ point
    return float(light.max() + light.min()) if measure == "extremes" else float(image.weights @ light)


def _worst(images: Sequence[EvenLight], point: Array, measure: Measure) -> float:
    return max(_ratio(one, point, measure) for one in images)


def _solved_for_worst(images: Sequence[EvenLight], measure: Measure, here: Array, rows: Array) -> Array:
    """(y, t) for which the largest (f - r g)/g' of all images is least, with r and g' of `here`, see the module."""
    count, ratio = len(here), _worst(images, here, measure)
    sizes = [_size(one, here, measure) for one in images]
    ends = 2 * len(images) if measure == "extremes" else 0  # of each image its brightest and its darkest cell
    wide = [np.hstack([rows, np.zeros((len(rows), 1 + ends))])]
    cones: list[Array] = []
    for number, (image, size) in enumerate(zip(images, sizes, strict=True)):
        if measure == "extremes":
            place = count + 1 + 2 * number
            beyond = np.zeros((2 * len(image.cells) + 1, count + 1 + ends))
            beyond[:-1, [*range(count), place, place + 1]] = _ends(image.cells)
            beyond[-1, [count, place, place + 1]] = [-size, 1 - ratio, -1 - ratio]
            wide.append(beyond)
        else:
            length = np.linalg.qr(_spread(image), mode="r")
            first = np.append(ratio * (image.weights @ image.cells), size)
            cones.append(np.vstack([first, np.hstack([length, np.zeros((len(length), 1))])]))
    every = np.vstack(wide)
    held = np.append(images[0].weights @ images[0].cells, np.zeros(1 + ends))
    cost = np.eye(count + 1 + ends)[count]
    return _program(np.zeros((len(cost), len(cost))), cost, held, every, cones)[:count]


def _program(square: Array, cost: Array, held: Array, rows: Array, lengths: Sequence[Array] = ()) -> Array:
    """Minimise z square z/2 + cost z with held z = 1, rows z <= 0, and |(L z) behind its first| <= its first number."""
    require("design", "levels")
    import clarabel
    from scipy.sparse import csc_matrix

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _EXACT
    # Rows of one size: a limit of bright light counts as much as one of a level.
    sizes = np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-300)
    left = csc_matrix(np.vstack([held, rows / sizes, *(-one for one in lengths)]))
    right = np.append(1.0, np.zeros(left.shape[0] - 1))
    cones = [clarabel.ZeroConeT(1), clarabel.NonnegativeConeT(len(rows))]
    cones += [clarabel.SecondOrderConeT(len(one)) for one in lengths]
    found = clarabel.DefaultSolver(csc_matrix(np.triu(square)), cost, left, right, cones, settings).solve()
    status = str(found.status)
    if "Infeasible" in status:
        raise InputError("no levels keep all limits", where="levels")
    if status not in _SOLVED:
        raise EnvironmentFailure(f"the convex program of the levels was not solved: {status}", where="levels")
    return np.asarray(found.x, dtype=np.float64)


def _levels(
    problem: EvenLight, images: Sequence[EvenLight], limits: Sequence[Limit], point: Array, *, is_held: bool = False
) -> Array:
    """Levels of (y, t); without light that does not change, t may fall until a limit holds it, unless it `is_held`."""
    y, t = point[:-1].copy(), float(point[-1])
    every = [*(one.cells for one in images), *(one.light for one in limits)]
    if not is_held and problem.is_timed and not any(parts[:, -2].any() for parts in every):
        # No light hangs on the time by itself: the shortest one in which the sources give theirs.
        y[-1] = float((y[:-1] / problem.high[:-1]).max())
    rows = [_bounds(problem), *(_rows(limit, np.ones(len(limit.light), dtype=bool)) for limit in limits)]
    is_free = not any(parts[:, -1].any() for parts in every)
    if not is_held and (is_free or t <= 0):
        together = np.vstack(rows)
        held = together[:, -1] < 0
        t = float((together[held, :-1] @ y / -together[held, -1]).max())
    levels: Array = y / t
    if problem.is_timed:
        time = min(max(float(levels[-1]), float(problem.low[-1])), float(problem.high[-1]))
        return np.append(np.clip(levels[:-1], problem.low[:-1] * time, problem.high[:-1] * time), time)
    return np.clip(levels, problem.low, problem.high)
