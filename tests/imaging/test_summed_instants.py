"""The error of a sum of images at instants: closed forms, and certificates that are drawn."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.imaging.summed_instants import AtInstant, Summed, certificate_of_sum
from radwrap.imaging.time_steps import Steps, lights_of, steps_of
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.scene.camera import Sensor
from tests.imaging.test_in_time import COLUMNS, ROWS, document, velocity

SURE: Final = 1.645  # of a bound of 95 %
LEVEL: Final = 4  # 17 instants


def certificate(square: float, upper: float, noise: float = 0.0, **more: Any) -> Certificate:
    """Of mean squares [gray level^2]."""
    rms, bound, own = (math.sqrt(value) for value in (square, upper, noise))
    return Certificate(rms, bound, None, 0.0, own, 1, 1, "pairs and replicates", **more)


def steps_and_sensor() -> tuple[Steps, Sensor]:
    scene = radwrap.scene_from_document(document(velocity=velocity(2.0)))
    return steps_of(scene, lights_of(scene)[0], LEVEL, 1), scene.camera.sensor


def summed_error(errors: list[Certificate]) -> Certificate:
    """Of a sum of gray images with such errors."""
    steps, sensor = steps_and_sensor()
    even = np.full((ROWS, COLUMNS), 100 / sensor.gain)
    made = Summed([steps], even, 0.0)
    return certificate_of_sum(made, lambda _, k: AtInstant(even, errors[k], sensor.gain, 0), sensor)


def test_what_is_not_known_of_each_instant_adds_up_by_squares() -> None:
    steps, _ = steps_and_sensor()
    weights = steps.weights[0]
    assert weights.sum() == pytest.approx(1) and len(weights) == 2**LEVEL + 1
    one = certificate(0.25, 1.0)
    found = summed_error([one] * len(weights))
    assert found.rms_gray == pytest.approx(0.5)
    assert found.rms_gray_upper95 == pytest.approx(math.sqrt(0.25 + 0.75 * math.hypot(*weights)))


@pytest.mark.parametrize("systematic", [{"bands_gray": 0.1}, {"diffraction_gray": 0.1}])
def test_what_bands_and_waves_may_add_is_in_all_alike(systematic: dict[str, float]) -> None:
    one = replace(certificate(0.25, 1.0), **systematic)
    steps, _ = steps_and_sensor()
    found = summed_error([one] * len(steps.times))
    assert found.rms_gray_upper95 == pytest.approx(1.0)


def test_noise_averages() -> None:
    steps, _ = steps_and_sensor()
    one = certificate(0.25, 0.25, noise=0.25)
    found = summed_error([one] * len(steps.times))
    assert found.rms_gray == found.rms_gray_upper95 == pytest.approx(0.5 * math.hypot(*steps.weights[0]))


@pytest.mark.parametrize("square", [0.04, *(pytest.param(value, marks=pytest.mark.long) for value in (0.0, 1.0))])
def test_the_bound_of_a_common_error_holds_in_95_of_100_draws(square: float) -> None:
    """All instants have the same error, of which each certificate knows the square to a normal deviate."""
    steps, _ = steps_and_sensor()
    random, spread = np.random.default_rng(3), 0.2
    held, draws = 0, 400
    for _ in range(draws):
        seen = np.maximum(square + spread * random.standard_normal(len(steps.times)), 0.0)
        found = summed_error([certificate(value, value + SURE * spread) for value in seen.tolist()])
        held += found.rms_gray_upper95**2 >= square
    # Five standard errors below 95 %.
    assert held / draws >= 0.95 - 5 * math.sqrt(0.95 * 0.05 / draws)
