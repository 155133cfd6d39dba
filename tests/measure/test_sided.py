"""Coma beside a neighbour: what is left of the contour has to show it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from radwrap.images import GrayImage
from radwrap.measure.gauges import StraightCaliper, measure_line
from tests.measure.pictures import noisy

Array = NDArray[np.float64]


def coma_share(distance: Array, core: float, tail: float) -> Array:
    """Share of the light beyond a straight edge, of a Gaussian with an exponential tail towards the bright side."""
    return np.asarray(
        ndtr(distance / core) - np.exp(core**2 / (2 * tail**2) - distance / tail) * ndtr(distance / core - core / tail)
    )


@pytest.mark.long
@pytest.mark.parametrize("tail", [0.0, 0.7])
def test_coma_is_seen_beside_a_neighbour(tail: float) -> None:
    """Of 36 px of an edge two thirds are left: levels that change across the few pixels near it hid the coma."""
    inner = (np.arange(4) + 0.5) / 4 - 0.5
    v, u = np.indices((72, 72), dtype=np.float64)
    warned = 0
    for seed in range(12):
        dice = np.random.default_rng((seed, 61))
        turn, size, at = dice.uniform(-math.pi, math.pi), dice.uniform(4, 7), dice.uniform(10, 14)
        light = np.zeros(u.shape)
        for du in inner:
            for dv in inner:
                x = (u + du - 36) * math.cos(turn) + (v + dv - 36) * math.sin(turn)
                y = (v + dv - 36) * math.cos(turn) - (u + du - 36) * math.sin(turn)
                edge = coma_share(x, 0.6, tail) if tail else ndtr(x / 0.8)
                beside = ndtr((size - np.hypot(x + size - 0.5, y - at)) / 0.8)
                light += 40 + 120 * (1 - (1 - edge) * (1 - beside))
        image = GrayImage(noisy(light / 16, dice, 0.06, 1.0))
        found = measure_line(image, StraightCaliper((36.3, 35.8), turn, 36, 10))
        assert found.left_out > 0.1
        warned += bool(found.warnings)
    # Of 12 eight were found by the pixels of the fit, and eleven are by those farther away.
    assert warned >= 10 if tail else warned == 0
