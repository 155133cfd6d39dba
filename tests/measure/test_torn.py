"""A circle of which a part lies elsewhere is warned of; one of which a part is covered is measured as it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from radwrap.images import GrayImage
from radwrap.measure.gauges import Caliper, Circle, measure_circle
from tests.measure.pictures import noisy, ring_picture

Array = NDArray[np.float64]

SHAPE = (72, 74)
CENTRE = (36.3, 35.8)
LEVELS = (40.0, 180.0)
RADIUS = 18.0


def measured(light: Array, seed: int) -> Circle:
    image = GrayImage(noisy(light, np.random.default_rng(seed)))
    return measure_circle(image, Caliper((36.0, 36.0), RADIUS + 0.4, 7.0))


@pytest.mark.parametrize("radius", [RADIUS, pytest.param(14.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("blur", [0.8, pytest.param(2.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("away", [1.5, -3.0, 5.0])
@pytest.mark.parametrize("share", [-0.4, 0.45])
def test_a_torn_circle_is_warned_of(radius: float, blur: float, away: float, share: float) -> None:
    """As if lines of a frame were lost: what is below a row lies to one side."""
    row = math.ceil(CENTRE[1] + share * radius)
    light = ring_picture(SHAPE, CENTRE, (radius,), blur, LEVELS)
    light[row:] = ring_picture(SHAPE, (CENTRE[0] + away, CENTRE[1]), (radius,), blur, LEVELS)[row:]
    for seed in range(2):
        image = GrayImage(noisy(light, np.random.default_rng(seed)))
        found = measure_circle(image, Caliper((CENTRE[0] + away / 2, CENTRE[1]), radius + 0.3, 7.0))
        assert found.warnings
        for text in found.warnings:
            if "lies elsewhere" in text:
                assert float(text.split(" by ")[1].split(" px")[0]) == pytest.approx(abs(away), abs=0.4)


@pytest.mark.parametrize("turn", [0.3, 2.2])
@pytest.mark.parametrize("seen", [0.5, 0.75])
@pytest.mark.parametrize("level", [40.0, 180.0, 95.0])
def test_a_circle_that_is_covered_in_part_is_measured_as_it_is(turn: float, seen: float, level: float) -> None:
    """By a half plane of the light outside, inside or between, whose edge is blurred by a Gaussian."""
    v, u = np.indices(SHAPE)
    beyond = (u - CENTRE[0]) * math.cos(turn) + (v - CENTRE[1]) * math.sin(turn) - seen * RADIUS
    cover = ndtr(beyond / 0.7)
    light = ring_picture(SHAPE, CENTRE, (RADIUS,), 1.3, LEVELS) * (1 - cover) + level * cover
    for seed in range(3):
        found = measured(light, seed)
        assert found.warnings == () and found.left_out > 0.1
        assert found.diameter == pytest.approx(2 * RADIUS, abs=4 * found.diameter_sigma)
