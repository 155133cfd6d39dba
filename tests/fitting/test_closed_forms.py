"""Fits whose answer is known by algebra: the same light is fitted that the captures were made of."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import pytest

from radwrap.fitting.covariance import PredictionErrors, Spread, spread
from radwrap.fitting.directions import in_words
from radwrap.fitting.solution import Solution, solve
from radwrap.fitting.verdict import verdict
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.response.noise import noise_variance
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, LEVELS, begun, changed, taken

EXACT: Final = 1e-9  # the solver's own precision, and rounding
SEEDS: Final = 20
FEW: Final = 8
SOME: Final = 20  # pixels of 480
# 20 normal errors scatter by a factor in this range but for 1 of 1000 times (chi-square of 19).
SCATTER: Final = (0.48, 1.53)
SIGMAS: Final = 4.0  # of a single number: 1 of 16000 is missed


def _spread(solved: Solution) -> Spread:
    quiet = np.zeros((2, len(solved.jacobian)))
    return spread(solved.jacobian, PredictionErrors(quiet))


def _noisy(bench: Scene, basis: Basis, free: list[str], values: list[float], seeds: int) -> Iterator[Solution]:
    """Fits to captures that differ by their noise; what saturates is cut."""
    keys, prediction = begun(bench, basis, free)
    truth = prediction.at(values)
    sigma, top = np.sqrt(noise_variance(truth.exposure, truth.parts[0].sensor)), truth.parts[0].sensor.saturation_gray
    for seed in range(seeds):
        noisy = np.minimum(truth.unclipped + sigma * generator(seed, 1).standard_normal(sigma.shape), top)
        yield solve(keys.keys, prediction, [taken(noisy, bench)], None, robust=False)


def test_a_level_is_weighted_linear_least_squares(bench: Scene, basis: Basis) -> None:
    keys, prediction = begun(bench, basis, ["sources[0].radiance"])
    truth = prediction.at([3000.0])
    noise = generator(3, 1).standard_normal(truth.exposure.shape)
    capture = taken(truth.unclipped + noise, bench)
    solved = solve(keys.keys, prediction, [capture], None, robust=False)
    assert solved.converged
    # By hand: G = G0 + x g, with g of 1 W/m^2/sr from the scene's own.
    dark = bench.camera.sensor.dark_gray
    slope = (prediction.at([2500.0]).unclipped - dark) / 2500
    weight = 1 / noise_variance(solved.predicted.exposure, bench.camera.sensor)
    expected = float((weight * slope * (capture.mean - dark)).sum() / (weight * slope**2).sum())
    assert solved.values[0] == pytest.approx(expected, rel=EXACT)
    variance = _spread(solved).noise[0, 0] * keys.keys[0].scale ** 2
    assert variance == pytest.approx(1 / float((weight * slope**2).sum()), rel=EXACT)


@pytest.mark.long
def test_deviations_are_those_of_the_scatter(bench: Scene, basis: Basis) -> None:
    free, truth = ["sources[0].leds[0].radiance_factor", "camera.sensor.offset"], [1.3, 6.0]
    found = list(_noisy(bench, basis, free, truth, SEEDS))
    values = np.array([one.values for one in found])
    told = np.sqrt(np.diag(_spread(found[0]).noise)) * np.array([1.0, 5.0])
    assert (np.abs(values.mean(axis=0) - truth) < SIGMAS * told / math.sqrt(SEEDS)).all()
    ratio = values.std(axis=0, ddof=1) / told
    assert ((SCATTER[0] < ratio) & (ratio < SCATTER[1])).all(), ratio


@pytest.mark.parametrize(
    ("free", "words"),
    [
        (["sources[0].radiance", EXPOSURE], "only as a product, sources[0].radiance x camera.exposure_time"),
        ([EXPOSURE, "camera.sensor.quantum_efficiency"], "only as a product"),
    ],
)
def test_what_only_acts_as_a_product_is_named(bench: Scene, basis: Basis, free: list[str], words: str) -> None:
    keys, prediction = begun(bench, basis, free)
    start = np.array([key.value for key in keys.keys])
    solved = solve(keys.keys, prediction, [taken(prediction.at(start).unclipped, bench)], None, robust=False)
    found = _spread(solved)
    assert found.rank == 1 and np.isnan(found.half_width).all()
    (told,) = in_words(found.null, free, solved.values, np.array([key.scale for key in keys.keys]))
    assert words in told


def test_levels_and_exposure_share_one_factor(bench: Scene, basis: Basis) -> None:
    keys, prediction = begun(bench, basis, [LEVELS, EXPOSURE, "camera.sensor.offset"])
    start = np.array([key.value for key in keys.keys])
    solved = solve(keys.keys, prediction, [taken(prediction.at(start).unclipped, bench)], None, robust=False)
    found = _spread(solved)
    names = [key.key for key in keys.keys]
    (told,) = in_words(found.null, names, solved.values, np.array([key.scale for key in keys.keys]))
    assert "only as a product" in told and EXPOSURE in told and "offset" not in told
    assert np.isnan(found.half_width).tolist() == [True, True, True, True, False]


def test_a_key_without_effect_is_named() -> None:
    jacobian = np.stack([np.linspace(1, 2, 30), np.zeros(30)], axis=1)
    found = spread(jacobian, PredictionErrors(np.zeros((2, 30))))
    assert np.isnan(found.half_width).tolist() == [False, True]
    (told,) = in_words(found.null, ["a", "b"], np.ones(2), np.ones(2))
    assert told == "b changes nothing that the captures show"


def test_the_predictions_error_goes_through_the_fit_as_one_image() -> None:
    """A common offset of all pixels moves the offset by itself, however many pixels there are."""
    offsets = np.array([0.1, -0.1, 0.3, -0.3])
    replicates = np.repeat(offsets[:, np.newaxis], 500, axis=1)
    found = spread(np.ones((500, 1)), PredictionErrors(replicates))
    assert found.prediction[0, 0] == pytest.approx(offsets.var(ddof=1) / 4, rel=EXACT)
    assert found.noise[0, 0] == pytest.approx(1 / 500, rel=EXACT)


def test_a_missing_source_is_not_explained(bench: Scene, basis: Basis) -> None:
    keys, prediction = begun(bench, basis, [EXPOSURE])
    free = ["sources[0].leds[*].radiance_factor"]
    truth = begun(bench, basis, free)[1].at([1.0, 1.0, 0.0])
    sigma = np.sqrt(noise_variance(truth.exposure, truth.parts[0].sensor))
    capture = taken(truth.unclipped + sigma * generator(5, 1).standard_normal(sigma.shape), bench)
    solved = solve(keys.keys, prediction, [capture], None, robust=False)
    errors = PredictionErrors(np.zeros((2, len(solved.jacobian))))
    assert not verdict(solved.residual, solved.weighed.sigma, spread(solved.jacobian, errors), errors).explained


def test_right_scenes_are_explained(bench: Scene, basis: Basis) -> None:
    """At the 1 % level: one of 8 is refused with a chance of 8 %, two with one of 0.3 %."""
    passed = []
    for solved in _noisy(bench, basis, [EXPOSURE], [110.0], FEW):
        errors = PredictionErrors(np.zeros((2, len(solved.jacobian))))
        judged = verdict(solved.residual, solved.weighed.sigma, spread(solved.jacobian, errors), errors)
        passed.append(judged.explained)
    assert sum(passed) >= FEW - 1


def test_saturated_pixels_do_not_pull(bench: Scene, basis: Basis) -> None:
    """Half of the image saturates: what is left tells the exposure without a bias."""
    found = list(_noisy(bench, basis, [EXPOSURE], [200.0], FEW))
    assert all(np.count_nonzero(one.weighed.censored) > SOME for one in found)
    told = math.sqrt(_spread(found[0]).noise[0, 0]) * 100.0
    assert abs(np.mean([one.values[0] for one in found]) - 200.0) < SIGMAS * told / math.sqrt(FEW)


def test_a_changed_scene_is_the_same_prediction(bench: Scene, basis: Basis) -> None:
    """Keys go through the scene file: what is predicted is what a render of that scene would be lit by."""
    keys, prediction = begun(bench, basis, ["sources[0].radiance", "camera.sensor.offset"])
    told = prediction.at([5000.0, 9.0]).parts[0]
    assert told.scene.camera.sensor == changed(bench, keys.written([5000.0, 9.0])).camera.sensor
    assert told.factors == pytest.approx([2.0] * 3, rel=EXACT)
