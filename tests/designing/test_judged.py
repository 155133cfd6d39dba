"""Ties, the best trial, the Pareto front and what limits: on trials that are made up, so that the truth is known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radwrap.designing.document import Problem, read_problem
from radwrap.designing.judged import limited_by, pareto_front, ranked, shortlist, ties_of
from radwrap.designing.quantities import TIE, is_tie
from radwrap.designing.trials import Trial
from radwrap.study.seen import Answer
from tests.designing.conftest import Write

TEXT = """
budget = 20
[keys.time]
key = "camera.exposure_time"
low = "10 ms"
high = "110 ms"
[responses.mean]
measure = "mean_gray"
[responses.dark]
measure = "contrast"
[[objectives]]
of = "mean"
aim = "{aim}"
{more}
[[constraints]]
of = "peak_gray"
at_most = 200
"""
SECOND = '[[objectives]]\nof = "dark"\naim = "minimise"'
DRAWS = 4000


@pytest.fixture
def problem(design_file: Write) -> Problem:
    return read_problem(design_file(TEXT.format(aim="maximise", more="")))


@pytest.fixture
def two(design_file: Write) -> Problem:
    return read_problem(design_file(TEXT.format(aim="maximise", more=SECOND)))


def trial(number: int, mean: float, error: float = 1.0, peak: float = 100.0, **more: Any) -> Trial:
    answers = {"mean": Answer(mean, error), "peak_gray": Answer(peak, 0.5), "dark": Answer(more.pop("dark", 0.0), 0.0)}
    return Trial(number, "decide", 0, (more.pop("time", 50.0),), {}, answers, 0.1, True, True, "", "", {}, {})


def test_ties_and_differences_are_told_apart_as_often_as_the_normal_distribution_says() -> None:
    """Equal values are a tie in 95.4 %; values that differ by four combined errors are called one in 2.3 %."""
    random = np.random.default_rng(7)
    called = {0: 0, 4: 0}
    for apart in called:
        for _ in range(DRAWS):
            first, second = random.uniform(0.1, 2.0, 2)
            truth = apart * math.hypot(first, second)
            pair = Answer(random.normal(0, first), first), Answer(random.normal(truth, second), second)
            called[apart] += is_tie(*pair)
    expected = {0: math.erf(TIE / math.sqrt(2)), 4: 0.5 * math.erfc((4 - TIE) / math.sqrt(2))}
    for apart, share in expected.items():
        assert called[apart] / DRAWS == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / DRAWS))


def test_planted_ties_are_called_so_and_nothing_else(problem: Problem) -> None:
    best = trial(1, 100.0)
    near = [trial(number, 100 - 0.1 * number) for number in range(2, 22)]  # at most 1.5 combined errors off
    far = [trial(number, 100 - 4 * math.sqrt(2) - 0.1 * number) for number in range(30, 50)]
    broken = trial(60, 100.0, peak=210.0)
    assert ties_of(problem, best, [best, *near, *far, broken]) == near


def test_the_best_one_keeps_all_limits(problem: Problem) -> None:
    trials = [
        trial(1, 90.0),
        trial(2, 120.0, peak=230.0),
        trial(3, 95.0, peak=200.0),
        replace(trial(4, 99.0), answers={}),
    ]
    assert [one.number for one in ranked(problem, trials)] == [3, 1]


def test_levels_on_a_limit_keep_it_within_its_error(problem: Problem) -> None:
    """They were solved for: whether another image of them lies above or below the limit only chance decides."""
    found, far = (replace(trial(1, 90.0, peak=peak), light={"way": "convex"}) for peak in (200.9, 201.1))
    assert found.is_feasible(problem) and not any(found.violations(problem))
    assert not far.is_feasible(problem) and not trial(1, 90.0, peak=200.9).is_feasible(problem)


def test_the_shortlist_has_what_errors_leave_open(problem: Problem) -> None:
    trials = [trial(1, 95.0), trial(2, 94.0), trial(3, 80.0), trial(4, 100.0, peak=200.9), trial(5, 100.0, peak=202.0)]
    assert [one.number for one in shortlist(problem, trials, 8)] == [1, 2, 4]
    assert [one.number for one in shortlist(problem, trials, 1)] == [1]


def test_the_front_is_that_of_a_quarter_circle(two: Problem) -> None:
    """On x^2 + y^2 = 1 nothing beats anything; whatever lies within the circle is beaten."""
    angles = np.linspace(0.1, 1.4, 9)
    front = [trial(k, math.cos(a), dark=-math.sin(a)) for k, a in enumerate(angles, 1)]
    within = [trial(20 + k, 0.9 * math.cos(a), dark=-0.9 * math.sin(a)) for k, a in enumerate(angles[2:6])]
    assert pareto_front(two, [*within, *front]) == front
    # The best one of two objectives is nearest to the best of both: the middle of the arc.
    assert ranked(two, [*within, *front])[0].number == 5


def test_what_limits_is_named(problem: Problem) -> None:
    assert limited_by(problem, trial(1, 90.0)) == []
    assert limited_by(problem, trial(1, 90.0, peak=199.0)) == ["peak_gray at most 200: it is 199"]
    assert limited_by(problem, trial(1, 90.0, time=110.0)) == ["time is at its high bound, 110.0 ms"]
    assert limited_by(problem, trial(1, 90.0, time=10.5)) == ["time is at its low bound, 10.5 ms"]
