"""Distributions against their closed forms. Each check allows five standard errors: it fails by chance once in 2e6."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from radwrap.dataset.draws import Choice, LogUniform, RandomRotation, read_distribution
from radwrap.frames import rotation_about_fixed_axes
from radwrap.study.factors import Draw
from radwrap.units import ANGLE, parse_quantity

N = 2500
SIGMAS = 5.0


def holds(samples: np.ndarray, mean: float) -> None:
    """The mean of samples is the closed form's, within its own standard error."""
    error = samples.std(ddof=1) / math.sqrt(len(samples))
    assert abs(samples.mean() - mean) <= SIGMAS * error


def numbers(distribution: Draw | LogUniform) -> np.ndarray:
    random = np.random.default_rng(1)
    drawn = [distribution.value(random) for _ in range(N)]
    assert all(one.endswith(" mm") for one in drawn)
    return np.array([float(one.split()[0]) for one in drawn])


def test_moments_of_uniform_normal_and_log_uniform() -> None:
    def read(kind: str, low: str, high: str) -> np.ndarray:
        found = read_distribution(kind, [low, high], None, "x")
        assert isinstance(found, Draw | LogUniform)
        return numbers(found)

    uniform = read("uniform", "2 mm", "5 mm")
    holds(uniform, 3.5)
    holds((uniform - 3.5) ** 2, 9 / 12)
    assert uniform.min() >= 2 and uniform.max() <= 5
    normal = read("normal", "2 mm", "5 mm")
    holds(normal, 2.0)
    holds((normal - 2) ** 2, 25.0)
    holds((normal - 2) ** 4, 3 * 625.0)
    log = read("log_uniform", "1 mm", "100 mm")
    holds(log, 99 / math.log(100))
    holds(np.log(log), math.log(10))
    holds((np.log(log) - math.log(10)) ** 2, math.log(100) ** 2 / 12)
    assert log.min() >= 1 and log.max() <= 100


def test_choices_come_by_their_weights() -> None:
    found = read_distribution("choice", ["a", "b", 3], [1, 2, 5], "x")
    assert isinstance(found, Choice)
    random = np.random.default_rng(2)
    drawn = [found.value(random) for _ in range(N)]
    for value, share in (("a", 1 / 8), ("b", 2 / 8), (3, 5 / 8)):
        holds(np.array([one == value for one in drawn], dtype=float), share)


def matrices(rotation: RandomRotation) -> np.ndarray:
    """Rotations as the scene reads them: three angles with units, in its default order."""
    random = np.random.default_rng(3)
    angles = [[parse_quantity(one, ANGLE) for one in rotation.value(random)] for _ in range(N)]
    return np.array([rotation_about_fixed_axes(one) for one in angles])


def test_any_rotation_is_haar_s() -> None:
    """The trace is the character of the vector representation: mean 0, mean square 1; each entry has 0 and 1/3."""
    turned = matrices(RandomRotation())
    trace = np.trace(turned, axis1=1, axis2=2)
    holds(trace, 0.0)
    holds(trace**2, 1.0)
    holds(np.arccos(np.clip((trace - 1) / 2, -1, 1)), math.pi / 2 + 2 / math.pi)  # density (1 - cos a) / pi
    for row in range(3):
        for column in range(3):
            holds(turned[:, row, column], 0.0)
            holds(turned[:, row, column] ** 2, 1 / 3)


def test_a_rotation_about_an_axis_leaves_it_and_has_every_angle() -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3
    found = read_distribution("rotation", {"axis": [1, 2, -2]}, None, "x")
    assert isinstance(found, RandomRotation)
    turned = matrices(found)
    written = 1e-7  # nine digits of some hundred degrees
    assert np.abs(turned @ axis - axis).max() < written
    trace = np.trace(turned, axis1=1, axis2=2)  # 1 + 2 cos a
    holds(trace, 1.0)
    holds(trace**2, 3.0)
    sine = (turned[:, 2, 1] - turned[:, 1, 2]) / (2 * axis[0])
    holds(sine, 0.0)


REFUSED: list[Callable[[], object]] = [
    lambda: read_distribution("uniform", ["2 mm", "1 mm"], None, "x"),
    lambda: read_distribution("log_uniform", ["0 mm", "1 mm"], None, "x"),
    lambda: read_distribution("log_uniform", [-1, 1], None, "x"),
    lambda: read_distribution("normal", [1, 0], None, "x"),
    lambda: read_distribution("choice", [], None, "x"),
    lambda: read_distribution("choice", [1, 2], [1], "x"),
    lambda: read_distribution("choice", [1, 2], [0, 0], "x"),
    lambda: read_distribution("choice", [1, 2], [-1, 2], "x"),
    lambda: read_distribution("rotation", "all", None, "x"),
    lambda: read_distribution("rotation", {"axis": [0, 0, 0]}, None, "x"),
    lambda: read_distribution("rotation", {"axis": "xyz"}, None, "x"),
]


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_what_is_no_distribution_is_refused(number: int) -> None:
    from radwrap.errors import InputError

    with pytest.raises(InputError) as told:
        REFUSED[number]()
    assert told.value.where == "x"
