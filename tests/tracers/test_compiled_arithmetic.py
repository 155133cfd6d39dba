"""The compiled tracer's functions of angles against Python's, over their whole range."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.tracers.compiled.arithmetic import (
    angle_of,
    azimuth,
    cosine_and_sine_of_turn,
    exponential,
    log_cosine,
    logarithm_of_ratio,
    squared_angle_of,
)

# Two sums of at most 16 terms, each rounded, and the reduction: some last digits.
DIGITS = 8 * 2.0**-52
TINY = [1e-300, 1e-150, 1e-30, 1e-12, 1e-9, 1e-6, 1e-3]


def relative(found: float, expected: float) -> float:
    return abs(found - expected) / abs(expected) if expected else abs(found)


def test_exponential() -> None:
    random = np.random.default_rng(1)
    values = [*random.uniform(-700, 700, 3000), *random.uniform(-2, 2, 3000), *TINY, *(-x for x in TINY)]
    # Half way between powers of two the reduced argument is largest.
    values += [(k + 0.5) * math.log(2) * (1 + e) for k in range(-1000, 1000, 37) for e in (-1e-15, 0, 1e-15)]
    assert max(relative(exponential(x), math.exp(x)) for x in values) < DIGITS
    assert exponential(0.0) == 1.0


def test_exponential_beyond_its_range() -> None:
    assert exponential(-700.0) == pytest.approx(math.exp(-700), rel=DIGITS)
    assert exponential(-700.0000001) == exponential(-1e300) == exponential(-math.inf) == 0.0
    assert exponential(701.0) == exponential(math.inf) == exponential(700.0) < math.inf


def test_angle_of_a_chord() -> None:
    random = np.random.default_rng(2)
    angles = [*random.uniform(0, math.pi, 5000), *TINY[1:], *(math.pi * k / 24 for k in range(1, 24))]
    for angle in angles:
        half_sine2 = math.sin(angle / 2) ** 2
        if half_sine2 < 0.99:  # beyond, its rounding is worth more than the last digits of the angle
            assert relative(angle_of(half_sine2), angle) < DIGITS
        if angle <= math.pi / 2:
            assert relative(squared_angle_of(half_sine2), angle**2) < DIGITS
    assert angle_of(0.0) == squared_angle_of(0.0) == 0.0
    assert relative(angle_of(1.0), math.pi) < DIGITS
    assert angle_of(1.0 + 1e-12) == angle_of(1.0)  # a chord that rounding made longer than a diameter


def test_angle_of_nearly_opposite_vectors() -> None:
    for left in (1e-3, 1e-6, 1e-9, 1e-12, 2.0**-52):
        exact = math.pi - 2 * math.asin(math.sqrt(left))
        rounding = 2.0**-53 / math.sqrt(left)  # what the rounding of 1 - left is worth
        assert relative(angle_of(1.0 - left), exact) < DIGITS + rounding


def test_log_cosine() -> None:
    random = np.random.default_rng(3)
    angles = [*random.uniform(0, math.pi / 2, 4000), *TINY[1:], *(math.acos(c) for c in (0.5, 0.7, 0.71, 0.35, 1e-3))]
    for angle in angles:
        half_sine2 = math.sin(angle / 2) ** 2
        # From the half angle: 1 - 2 sin^2 loses digits near 90 deg, which both then lose alike.
        assert relative(log_cosine(half_sine2), math.log1p(-2 * half_sine2)) < DIGITS
    assert log_cosine(0.0) == 0.0


def test_azimuth() -> None:
    random = np.random.default_rng(4)
    points = [*random.normal(size=(4000, 2)).tolist()]
    points += [(s * a, t * b) for a in (*TINY[2:], 1.0) for b in (1.0, 1e-9) for s in (-1, 1) for t in (-1, 1)]
    for y, x in points:
        expected = math.atan2(y, x) % (2 * math.pi)
        assert relative(azimuth(y, x), expected) < DIGITS
    right = [azimuth(0.0, 1.0), azimuth(1.0, 0.0), azimuth(0.0, -1.0), azimuth(-1.0, 0.0)]
    assert right == [0.0, math.pi / 2, math.pi, 2 * math.pi - math.pi / 2]
    assert azimuth(0.0, 0.0) == azimuth(-0.0, 1.0) == 0.0
    assert azimuth(-1e-30, 1.0) <= 2 * math.pi


def test_logarithm_of_a_ratio() -> None:
    random = np.random.default_rng(8)
    values = [*random.uniform(-0.999, 0.999, 2000), *TINY[3:], 1 - 1e-9, -1 + 1e-9]
    # Next to 1 the ratio itself has lost digits of 1 - x, which the logarithm makes few.
    assert max(relative(logarithm_of_ratio(x), math.atanh(x) / x) for x in values) < 4 * DIGITS
    assert logarithm_of_ratio(0.0) == 1.0


def test_cosine_and_sine_of_a_turn() -> None:
    for share in np.linspace(0, 1, 1001).tolist():
        cosine, sine = cosine_and_sine_of_turn(share)
        assert cosine == pytest.approx(math.cos(2 * math.pi * share), abs=DIGITS)
        assert sine == pytest.approx(math.sin(2 * math.pi * share), abs=DIGITS)
