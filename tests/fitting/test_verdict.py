"""The level of the verdict, where the prediction's error counts."""

from __future__ import annotations

import numpy as np
import pytest

from radwrap.fitting.covariance import PredictionErrors
from radwrap.fitting.verdict import LEVEL, _Error, verdict
from radwrap.random_streams import generator

DRAWS = 1000
SIDE = 20
CHANCE = 4 * (LEVEL / DRAWS) ** 0.5  # of a share of right scenes
# The same where a dozen pixels have nearly all of the error: twelve replicates do not know it well.
OF_FEW_PIXELS = 0.01
REPLICATES = 12


@pytest.mark.long
@pytest.mark.parametrize(
    ("size", "pixels", "more"), [(0.0, 0, 0.0), (0.4, 400, 0.0), (3.0, 80, 0.0), (6.0, 12, OF_FEW_PIXELS)]
)
def test_right_scenes_are_refused_at_the_level_wherever_the_error_lies(size: float, pixels: int, more: float) -> None:
    """The prediction is the mean of twelve, each of which is off by its own error, by so much in so many pixels."""
    random = generator(7, pixels)
    deviation = np.zeros((SIDE, SIDE))
    deviation.ravel()[:pixels] = size
    basis = np.linalg.qr(random.standard_normal((SIDE**2, 3)))[0]
    one = np.ones((SIDE, SIDE))
    refused = 0
    for _ in range(DRAWS):
        each = np.sqrt(REPLICATES) * deviation * random.standard_normal((REPLICATES, SIDE, SIDE))
        left = (random.standard_normal((SIDE, SIDE)) - each.mean(axis=0)).ravel()
        left -= basis @ (basis.T @ left)
        errors = PredictionErrors(each.reshape(REPLICATES, -1))
        refused += not verdict(left.reshape(SIDE, SIDE), one, basis, errors).explained
    assert refused / DRAWS < LEVEL + CHANCE + more


@pytest.mark.parametrize("freedom", [3, 11, 200])
def test_the_scatter_of_the_error_is_that_of_its_covariance(freedom: int) -> None:
    """Of deviations 3, 1, .5, .5 the traces of C and C^2 are 10.5 and 82.125, by however many replicates."""
    random, deviations = generator(3, freedom), np.array([3.0, 1.0, 0.5, 0.5])
    found = []
    for _ in range(DRAWS):
        each = deviations * random.standard_normal((freedom + 1, 4))
        found.append(_Error.of(each - each.mean(axis=0), 0.0))
    mean = [np.mean([getattr(one, name) for one in found]) for name in ("square", "scatter")]
    # Estimates below 0, of which few replicates have some, are taken for 0.
    assert mean == pytest.approx([10.5, 82.125], rel=0.15)
