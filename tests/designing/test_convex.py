"""The most even light: against closed forms, and against another solver on the ratio itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize

from radwrap.designing.convex import EvenLight, Limit, Measure, most_even, unevenness
from radwrap.errors import InputError

Array = NDArray[np.float64]

UNIFORMITY = 1e-6  # asked for
CELLS = 40


def random_problem(seed: int, sources: int, *, limits: bool) -> EvenLight:
    """Spots of light on a line, their levels within random bounds, and perhaps limits of peak and mean."""
    random = np.random.default_rng(seed)
    x = np.linspace(-1, 1, CELLS)
    middles, widths = random.uniform(-1.2, 1.2, sources), random.uniform(0.3, 1.0, sources)
    spots = np.exp(-(((x[:, np.newaxis] - middles) / widths) ** 2)) * random.uniform(0.5, 2.0, sources) * 1e-3
    cells = np.hstack([spots, np.full((CELLS, 1), random.choice([0.0, 1e-4]))])
    weights = random.uniform(0.5, 1.5, CELLS)
    low, high = random.uniform(0, 0.2, sources), random.uniform(0.6, 1.5, sources)
    bright = cells @ np.append(high, 1.0)
    mean = weights / weights.sum() @ cells
    found = (
        (
            Limit(cells, -math.inf, 0.7 * float(bright.max())),
            Limit(mean[np.newaxis], 0.3 * float(bright.mean()), math.inf),
        )
        if limits
        else ()
    )
    return EvenLight(cells, weights / weights.sum(), low, high, found)


def otherwise(problem: EvenLight) -> float:
    """The least deviation by SLSQP on the ratio itself, from several beginnings."""

    def ratio(levels: Array) -> float:
        return 1e2 * unevenness(problem, levels, "deviation") ** 2

    def slack(levels: Array) -> Array:
        every = [np.array([1.0])]
        for limit in problem.limits:
            light = limit.light @ np.append(levels, 1.0)
            every += [(limit.high - light) * 1e3] if math.isfinite(limit.high) else []
            every += [(light - limit.low) * 1e3] if math.isfinite(limit.low) else []
        return np.concatenate(every)

    best = math.inf
    for start in (0.3, 0.6, 0.9):
        found = minimize(
            ratio,
            problem.low + start * (problem.high - problem.low),
            method="SLSQP",
            bounds=list(zip(problem.low, problem.high, strict=True)),
            constraints={"type": "ineq", "fun": slack},
            options={"ftol": 1e-15, "maxiter": 500},
        )
        if (slack(found.x) > -1e-9).all():
            best = min(best, unevenness(problem, found.x, "deviation"))
    return best


@pytest.mark.parametrize("limits", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_the_deviation_is_the_quadratic_programs_optimum(seed: int, limits: bool) -> None:
    problem = random_problem(seed, 4 + 2 * (seed % 3), limits=limits)
    levels = most_even(problem, "deviation")
    assert (levels >= problem.low).all() and (levels <= problem.high).all()
    for limit in problem.limits:
        light = limit.light @ np.append(levels, 1.0)
        assert (light <= limit.high * (1 + 1e-7)).all() and (light >= limit.low * (1 - 1e-7)).all()
    assert unevenness(problem, levels, "deviation") == pytest.approx(otherwise(problem), abs=UNIFORMITY)


@pytest.mark.parametrize("seed", range(3))
def test_the_extremes_are_the_least_by_bisection(seed: int) -> None:
    """For a ratio r, (1 - r) max <= (1 + r) min is linear in the levels: r is bisected by HiGHS."""
    problem = random_problem(seed, 5, limits=False)
    found = unevenness(problem, most_even(problem, "extremes"), "extremes")

    def can(ratio: float) -> bool:
        cells, fixed = problem.cells[:, :-1] * 1e3, problem.cells[:, -1] * 1e3
        ones = np.ones((CELLS, 1))
        above = np.hstack([cells, -(1 + ratio) * ones])  # light <= (1 + r) m
        below = np.hstack([-cells, (1 - ratio) * ones])  # light >= (1 - r) m
        bounds = [*zip(problem.low, problem.high, strict=True), (0, None)]
        return bool(
            linprog(
                np.zeros(len(problem.low) + 1),
                np.vstack([above, below]),
                np.concatenate([-fixed, fixed]),
                bounds=bounds,
            ).success
        )

    low, high = 0.0, 1.0
    while high - low > 1e-7:
        middle = (low + high) / 2
        low, high = (low, middle) if can(middle) else (middle, high)
    assert found == pytest.approx(high, abs=UNIFORMITY)


@pytest.mark.parametrize("measure", ["deviation", "extremes"])
def test_two_slopes_make_even_light_and_of_all_such_levels_the_brightest(measure: Measure) -> None:
    x = np.linspace(-1, 1, 21)
    cells = np.stack([1 + 0.5 * x, 2 - x, np.zeros(21)], axis=-1)
    problem = EvenLight(cells, np.full(21, 1 / 21), np.zeros(2), np.array([1.0, 0.4]))
    levels = most_even(problem, measure)
    assert levels == pytest.approx([0.8, 0.4], abs=1e-6)  # 0.8 (1 + x/2) + 0.4 (2 - x) = 1.6
    held = EvenLight(cells, problem.weights, problem.low, problem.high, (Limit(cells, -math.inf, 1.2),))
    assert most_even(held, measure) == pytest.approx([0.6, 0.3], abs=1e-6)


def test_light_that_does_not_change_is_evened_out() -> None:
    x = np.linspace(-1, 1, 21)
    cells = np.stack([1 + x, 1 - 0.3 * x], axis=-1)
    problem = EvenLight(cells, np.full(21, 1 / 21), np.zeros(1), np.array([5.0]))
    assert most_even(problem, "deviation") == pytest.approx([0.3], abs=1e-6)


def timed(problem: EvenLight, low: float, high: float) -> EvenLight:
    """The same with an exposure time, on which all light hangs."""
    none = np.zeros((len(problem.cells), 1))
    limits = tuple(
        Limit(np.hstack([one.light, np.zeros((len(one.light), 1))]), one.low, one.high) for one in problem.limits
    )
    return EvenLight(
        np.hstack([problem.cells, none]),
        problem.weights,
        np.append(problem.low, low),
        np.append(problem.high, high),
        limits,
        is_timed=True,
    )


@pytest.mark.parametrize(
    ("most", "low", "expected"),
    [
        (math.inf, 0.5, [2.4, 1.2, 3.0]),  # as bright as the longest time lets it be
        (1.2, 0.5, [0.6, 0.3, 0.75]),  # the shortest time in which the sources give it, of which one is at its bound
        (1.2, 1.0, [0.6, 0.3, 1.0]),
    ],
)
def test_the_time_is_the_shortest_in_which_sources_give_their_light(
    most: float, low: float, expected: list[float]
) -> None:
    x = np.linspace(-1, 1, 21)
    cells = np.stack([1 + 0.5 * x, 2 - x, np.zeros(21)], axis=-1)
    limits = (Limit(cells, -math.inf, most),) if math.isfinite(most) else ()
    problem = EvenLight(cells, np.full(21, 1 / 21), np.zeros(2), np.array([1.0, 0.4]), limits)
    assert most_even(timed(problem, low, 3.0), "deviation") == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_levels_and_time_together_are_the_optimum(seed: int) -> None:
    """Light that does not change grows with the time too; SLSQP looks for levels and the time themselves."""
    problem = random_problem(seed, 4, limits=True)
    low, high = 0.6, 1.8
    found = most_even(timed(problem, low, high), "deviation")
    time = found[-1]
    levels = found[:-1] / time
    assert low <= time <= high
    assert (levels >= problem.low - 1e-9).all() and (levels <= problem.high + 1e-9).all()

    def light(x: Array, table: Array) -> Array:
        return np.asarray((table[:, :-1] @ x[:-1] + table[:, -1]) * x[-1])

    def ratio(x: Array) -> float:
        cells = light(x, problem.cells)
        mean = problem.weights @ cells
        return float(1e2 * (problem.weights @ (cells - mean) ** 2) / mean**2)

    def slack(x: Array) -> Array:
        (peak, mean) = problem.limits
        return np.concatenate([(peak.high - light(x, peak.light)) * 1e3, (light(x, mean.light) - mean.low) * 1e3])

    here = np.append(levels, time)
    assert (slack(here) > -1e-6).all()
    best = math.inf
    for start in (0.3, 0.6, 0.9):
        bounds = [*zip(problem.low, problem.high, strict=True), (low, high)]
        begin = [one + start * (other - one) for one, other in bounds]
        ended = minimize(
            ratio,
            begin,
            method="SLSQP",
            bounds=bounds,
            constraints={"type": "ineq", "fun": slack},
            options={"ftol": 1e-15, "maxiter": 500},
        )
        if (slack(ended.x) > -1e-9).all():
            best = min(best, math.sqrt(ratio(ended.x) / 1e2))
    assert math.sqrt(ratio(here) / 1e2) == pytest.approx(best, abs=UNIFORMITY)


def test_limits_that_no_levels_keep_are_refused() -> None:
    problem = random_problem(1, 4, limits=False)
    bright = float((problem.cells @ np.append(problem.high, 1.0)).max())
    dark = EvenLight(
        problem.cells, problem.weights, problem.low, problem.high, (Limit(problem.cells[:1], 2 * bright, math.inf),)
    )
    with pytest.raises(InputError, match="no levels keep all limits"):
        most_even(dark, "deviation")


# ------------------------------------------------------------------------------------------------------ the worst case


def worst(images: Sequence[EvenLight], levels: Array, measure: Measure) -> float:
    return max(unevenness(one, levels, measure) for one in images)


@pytest.mark.parametrize("measure", ["deviation", "extremes"])
def test_the_worst_of_two_corners_is_least_at_the_geometric_mean(measure: Measure) -> None:
    """Two places, two sources; the light a of the first is off by a fifth, b of the second is not.

    (1.2 a - b)/(1.2 a + b) = (b - .8 a)/(b + .8 a) where b/a = sqrt(1.2 * .8).
    """
    weights, low, high = np.array([0.5, 0.5]), np.zeros(2), np.ones(2)
    images = [EvenLight(np.array([[by, 0.0, 0.0], [0.0, 1.0, 0.0]]), weights, low, high) for by in (1.0, 0.8, 1.2)]
    levels = most_even(images[0], measure, images[1:])
    assert levels == pytest.approx([1.0, math.sqrt(0.96)], abs=1e-6)
    least = (math.sqrt(1.2) - math.sqrt(0.8)) / (math.sqrt(1.2) + math.sqrt(0.8))
    assert worst(images, levels, measure) == pytest.approx(least, abs=1e-8)
    # As it stands equal levels are even, and a ninth off in the corner.
    assert worst(images, most_even(images[0], measure), measure) == pytest.approx(0.2 / 1.8, abs=1e-6)
    # The brightest levels that no corner takes beyond a limit: 1.2 a = .9.
    held = [replace(one, limits=(Limit(one.cells, -math.inf, 0.9),)) for one in images]
    assert most_even(held[0], measure, held[1:]) == pytest.approx([0.75, 0.75 * math.sqrt(0.96)], abs=1e-6)


def corners_of(problem: EvenLight, seed: int) -> list[EvenLight]:
    """The same in other light: each source is up to a fifth brighter or darker, and shines a little elsewhere."""
    random, found = np.random.default_rng((seed, 5)), []
    for _ in range(4):
        by = np.append(random.uniform(0.8, 1.2, len(problem.low)), 1.0)
        slope = 1 + random.uniform(-0.1, 0.1) * np.linspace(-1, 1, CELLS)[:, np.newaxis]
        peak, mean = problem.limits
        cells = problem.cells * by * slope
        limits = (Limit(cells, -math.inf, peak.high), Limit((problem.weights @ cells)[np.newaxis], mean.low, math.inf))
        found.append(EvenLight(cells, problem.weights, problem.low, problem.high, limits))
    return found


@pytest.mark.parametrize("seed", [3, *(pytest.param(one, marks=pytest.mark.long) for one in (0, 1, 2))])
def test_the_worst_deviation_is_the_optimum_of_all_corners(seed: int) -> None:
    """SLSQP makes a number small that no image may exceed, from several beginnings."""
    problem = random_problem(seed, 4, limits=True)
    images = [problem, *corners_of(problem, seed)]
    levels = most_even(problem, "deviation", images[1:])

    def slack(point: Array) -> Array:
        every = [1e1 * (point[-1] - unevenness(one, point[:-1], "deviation")) for one in images]
        for limit in (limit for one in images for limit in one.limits):
            light = limit.light @ np.append(point[:-1], 1.0)
            every += list((limit.high - light) * 1e3) if math.isfinite(limit.high) else []
            every += list((light - limit.low) * 1e3) if math.isfinite(limit.low) else []
        return np.array(every)

    here = worst(images, levels, "deviation")
    assert (slack(np.append(levels, here)) > -1e-6).all()
    best = math.inf
    for start in (0.3, 0.6, 0.9):
        begin = problem.low + start * (problem.high - problem.low)
        ended = minimize(
            lambda point: 1e1 * point[-1],
            np.append(begin, worst(images, begin, "deviation")),
            method="SLSQP",
            bounds=[*zip(problem.low, problem.high, strict=True), (0, 1)],
            constraints={"type": "ineq", "fun": slack},
            options={"ftol": 1e-13, "maxiter": 500},
        )
        if (slack(ended.x) > -1e-8).all():
            best = min(best, worst(images, ended.x[:-1], "deviation"))
    assert here == pytest.approx(best, abs=UNIFORMITY)


@pytest.mark.parametrize("seed", range(4))
def test_the_worst_extremes_are_the_least_by_bisection(seed: int) -> None:
    """For a ratio r, each image has a level m of its own with (1 - r) m <= light <= (1 + r) m."""
    problem = random_problem(seed, 4, limits=True)
    images = [problem, *corners_of(problem, seed)]
    found = worst(images, most_even(problem, "extremes", images[1:]), "extremes")

    def can(ratio: float) -> bool:
        rows, right = [], []
        for number, one in enumerate(images):
            level = np.zeros((CELLS, len(images)))
            level[:, number] = 1.0
            cells, fixed = one.cells[:, :-1] * 1e3, one.cells[:, -1] * 1e3
            rows += [np.hstack([cells, -(1 + ratio) * level]), np.hstack([-cells, (1 - ratio) * level])]
            right += [-fixed, fixed]
            for limit in one.limits:
                light, fixed = limit.light[:, :-1] * 1e3, limit.light[:, -1] * 1e3
                none = np.zeros((len(light), len(images)))
                if math.isfinite(limit.high):
                    rows, right = [*rows, np.hstack([light, none])], [*right, limit.high * 1e3 - fixed]
                if math.isfinite(limit.low):
                    rows, right = [*rows, np.hstack([-light, none])], [*right, fixed - limit.low * 1e3]
        bounds = [*zip(problem.low, problem.high, strict=True), *[(0, None)] * len(images)]
        return bool(linprog(np.zeros(len(bounds)), np.vstack(rows), np.concatenate(right), bounds=bounds).success)

    low, high = 0.0, 1.0
    while high - low > 1e-7:
        middle = (low + high) / 2
        low, high = (low, middle) if can(middle) else (middle, high)
    assert found == pytest.approx(high, abs=UNIFORMITY)


def test_limits_that_only_a_corner_breaks_are_refused() -> None:
    """The mean is 1 where the peak is 1 as it stands; a corner that is a fifth darker cannot have both."""
    cells = np.array([[1.0, 0.0]])
    weights, low, high = np.ones(1), np.zeros(1), np.ones(1)
    images = [EvenLight(cells * by, weights, low, high, (Limit(cells * by, 0.9, 1.0),)) for by in (1.0, 0.8, 1.2)]
    assert most_even(images[0], "deviation") == pytest.approx([1.0], abs=1e-6)
    with pytest.raises(InputError, match="no levels keep all limits"):
        most_even(images[0], "deviation", images[1:])
