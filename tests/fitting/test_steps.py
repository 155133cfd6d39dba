"""Damped steps on a curve whose values are known."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.fitting.steps import STILL, Weights, through_grain

Array = np.ndarray[Any, np.dtype[np.float64]]
TIME: Final = np.linspace(0.0, 4.0, 60)
SIGMA: Final = 0.01
TRUTH: Final = np.array([5.0, 0.5])
FREE: Final = np.array([[-np.inf] * 2, [np.inf] * 2])


class Decay:
    """a exp(-b t): where it begins with another b, an undamped step leads far away."""

    def __init__(self, *, longest: float = np.inf, extra: float = 0.0) -> None:
        self._longest, self._extra = longest, extra

    def _at(self, values: Array) -> Array:
        if abs(values[1]) > self._longest:
            raise InputError("is too fast", where="b")
        return np.asarray(values[0] * np.exp(-values[1] * TIME))

    def weights(self, values: Array) -> Weights:
        return Weights(np.ones(TIME.shape, dtype=np.bool_), np.full(TIME.shape, SIGMA))

    def left(self, values: Array, weights: Weights) -> Array:
        return np.asarray((self._at(TRUTH) - self._at(values)) / weights.sigma + self._extra * np.sign(values[0] - 5.0))

    def slopes(self, values: Array, weights: Weights) -> Array:
        fallen = np.exp(-values[1] * TIME)
        return np.stack([fallen, -values[0] * TIME * fallen], axis=1) / SIGMA


@pytest.mark.parametrize("begin", [(1.0, 4.0), (1.0, 6.0), (0.2, 0.0)])
def test_damped_steps_come_where_undamped_ones_lead_away(begin: tuple[float, float]) -> None:
    """Undamped the first step from (1, 4) or (1, 6) raises the sum."""
    arrived = through_grain(Decay(), np.array(begin), np.ones(2), FREE)
    assert arrived.converged
    # A step of less than STILL expected deviations in all is the last one.
    left = Decay().left(arrived.values, Decay().weights(arrived.values))
    assert np.linalg.norm(left) < STILL


def test_a_step_into_what_the_scene_does_not_take_is_a_shorter_one() -> None:
    arrived = through_grain(Decay(longest=4.5), np.array([1.0, 4.0]), np.ones(2), FREE)
    assert arrived.converged and np.allclose(arrived.values, TRUTH, atol=1e-2)


def test_bounds_are_kept() -> None:
    bounds = np.array([[0.0, 0.8], [10.0, 5.0]])
    arrived = through_grain(Decay(), np.array([1.0, 4.0]), np.ones(2), bounds)
    assert arrived.values[1] == 0.8
    # What is best there, by hand: a of least squares.
    fallen = np.exp(-0.8 * TIME)
    best = float((fallen * TRUTH[0] * np.exp(-TRUTH[1] * TIME)).sum() / (fallen**2).sum())
    assert arrived.converged and arrived.values[0] == pytest.approx(best, rel=1e-3)


@pytest.mark.parametrize(("grain", "ends"), [(1.0, False), (1e4, True)])
def test_a_step_that_lowers_nothing_ends_the_fit_where_the_grain_hides_it(grain: float, ends: bool) -> None:
    """The sum jumps up on either side of where it stands."""
    values = np.array([5.0, 0.5 + 1e-2])
    arrived = through_grain(Decay(extra=1e3), values, np.ones(2), FREE, grain=grain)
    assert arrived.converged is ends and np.allclose(arrived.values, values)


def test_a_step_of_less_than_rays_are_off_by_is_the_last_one() -> None:
    """Whether it lowers the sum or not: the next one would go no nearer to what is there."""
    begin, grain = np.array([1.0, 4.0]), 30.0
    whole = through_grain(Decay(), begin, np.ones(2), FREE)
    short = through_grain(Decay(), begin, np.ones(2), FREE, grain=grain)
    assert short.converged and short.rounds < whole.rounds
    left = Decay().left(short.values, Decay().weights(short.values))
    assert np.linalg.norm(left) < grain


@pytest.mark.parametrize(("held_by", "gone"), [(0.0, 100.0), (1.0, 0.25 / 1.0025)])
def test_a_key_that_hardly_shows_is_held_where_it_begins(held_by: float, gone: float) -> None:
    """Of a scale it changes .05 deviations, and 5 are off: by least squares it goes 100 scales."""

    class Weak:
        def weights(self, values: Array) -> Weights:
            return Weights(np.ones(2, dtype=np.bool_), np.ones(2))

        def left(self, values: Array, weights: Weights) -> Array:
            return np.array([7.0, 5.0]) - [values[0] - 1.0, 0.05 * (values[1] - 30.0) / 30.0]

        def slopes(self, values: Array, weights: Weights) -> Array:
            return np.diag([1.0, 0.05])

    scales = np.array([1.0, 30.0])
    arrived = through_grain(Weak(), np.array([1.0, 30.0]), scales, FREE, held_by=np.array([0.0, held_by]))
    assert arrived.converged
    assert arrived.values == pytest.approx([8.0, 30.0 * (1 + gone)], rel=1e-6)
