"""Fits whose answer is known by algebra: the same light is fitted that the captures were made of."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.errors import InputError, ToleranceNotMet
from radwrap.fitting.covariance import RANK, PredictionErrors, Spread, spread
from radwrap.fitting.directions import in_words
from radwrap.fitting.fit import Ended
from radwrap.fitting.free_keys import FreeScene
from radwrap.fitting.prediction import Predicted, Prediction
from radwrap.fitting.settled import Grained
from radwrap.fitting.solution import Solution, solve
from radwrap.fitting.verdict import verdict
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.response.noise import noise_variance
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, LEVELS, begun, changed, taken

Array = NDArray[np.float64]
EXACT: Final = 1e-9  # the solver's own precision, and rounding
SEEDS: Final = 20
FEW: Final = 8
SOME: Final = 20  # pixels of 480
# 20 normal errors scatter by a factor in this range but for 1 of 1000 times (chi-square of 19).
SCATTER: Final = (0.48, 1.53)
SAME_PART: Final = 1e-2  # ten times what is seen: the solver's steps are shorter towards a bound
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
    bench = changed(bench, {"camera.sensor.rounding": False})  # what it adds to levels is not linear
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


@pytest.mark.parametrize("seed", range(FEW))
def test_no_value_wanders_along_what_does_not_show(bench: Scene, basis: Basis, seed: int) -> None:
    """Dark current and offset are one number: both take the same part of what it is off by, however the noise falls."""
    dark = changed(bench, {"camera.sensor.dark_current": "100 e/s"})
    keys, prediction = begun(dark, basis, ["camera.sensor.dark_current", "camera.sensor.offset"])
    begin = prediction.at([key.value for key in keys.keys])
    noise = np.sqrt(noise_variance(begin.exposure, dark.camera.sensor))
    seen = np.rint(begin.unclipped + 0.5 + noise * generator(seed, 4).standard_normal(noise.shape))
    solved = solve(keys.keys, prediction, [taken(seen, dark)], None, robust=False)
    current, offset = solved.values - [key.value for key in keys.keys]
    per_current = 0.02 * dark.camera.exposure_time  # gray levels of an electron each second
    assert solved.converged and offset > 0.1
    assert current * per_current == pytest.approx(offset, rel=SAME_PART)


def test_a_value_that_came_to_nothing_still_has_a_part() -> None:
    """Dark current of 100 e/s to begin with, and none where the fit ends: a change of it is not beyond all others."""
    null = np.array([[-25.0, 1.0]]) / np.sqrt(626)
    for value in (0.0, 1e-9, 0.02, 100.0):
        (told,) = in_words(null, ["a", "b"], np.array([value, 5.0]), np.array([100.0, 5.0]))
        assert "a and b only together" in told, value


def test_the_predictions_error_goes_through_the_fit_as_one_image() -> None:
    """A common offset of all pixels moves the offset by itself, however many pixels there are."""
    offsets = np.array([0.1, -0.1, 0.3, -0.3])
    replicates = np.repeat(offsets[:, np.newaxis], 500, axis=1)
    found = spread(np.ones((500, 1)), PredictionErrors(replicates))
    assert found.prediction[0, 0] == pytest.approx(offsets.var(ddof=1) / 4, rel=EXACT)
    assert found.noise[0, 0] == pytest.approx(1 / 500, rel=EXACT)


def test_a_fit_that_leaves_what_the_scene_takes_says_so(bench: Scene, basis: Basis) -> None:
    """As where captures are met best by a level without end."""
    level, truth = "sources[0].leds[0].radiance_factor", [1.5]
    keys, prediction = begun(bench, basis, [level])
    capture, at = taken(prediction.at(truth).unclipped, bench), prediction.at

    def within(values: Sequence[float]) -> Predicted:
        if values[0] > 1.2:
            raise InputError("must be at most 1.2", where=level)
        return at(values)

    with (
        patch.object(prediction, "at", within),
        pytest.raises(ToleranceNotMet, match="takes no value: must be") as told,
    ):
        solve(keys.keys, prediction, [capture], None, robust=False)
    assert told.value.where == level and "give the key bounds" in told.value.remedy


@pytest.mark.parametrize("brightest", [2.4, 1.9])
def test_a_fit_whose_best_lies_at_infinity_ends_soon(bench: Scene, basis: Basis, brightest: float) -> None:
    """By a level x the light is that of 2 x/(1 + x): more than 2 is met best at infinity, and 1.9 at 19."""
    level = "sources[0].leds[0].radiance_factor"
    keys, prediction = begun(bench, basis, [level])
    capture, at, asked = taken(prediction.at([brightest]).unclipped, bench), prediction.at, []

    def bounded(values: Sequence[float]) -> Predicted:
        asked.append(float(values[0]))
        return at([2 * asked[-1] / (1 + asked[-1])])

    with patch.object(prediction, "at", bounded):
        if brightest > 2:
            with pytest.raises(ToleranceNotMet, match="on and on away from") as told:
                solve(keys.keys, prediction, [capture], None, robust=False)
            assert told.value.where == level and "give the key bounds" in told.value.remedy
        else:
            solved = solve(keys.keys, prediction, [capture], None, robust=False)
            assert solved.converged and solved.values[0] == pytest.approx(19, rel=1e-6)
    assert len(asked) < 200


def test_a_missing_source_is_not_explained(bench: Scene, basis: Basis) -> None:
    keys, prediction = begun(bench, basis, [EXPOSURE])
    free = ["sources[0].leds[*].radiance_factor"]
    truth = begun(bench, basis, free)[1].at([1.0, 1.0, 0.0])
    sigma = np.sqrt(noise_variance(truth.exposure, truth.parts[0].sensor))
    capture = taken(truth.unclipped + sigma * generator(5, 1).standard_normal(sigma.shape), bench)
    solved = solve(keys.keys, prediction, [capture], None, robust=False)
    errors = PredictionErrors(np.zeros((2, len(solved.jacobian))))
    assert not verdict(solved.residual, solved.weighed.sigma, spread(solved.jacobian, errors).basis, errors).explained


@pytest.mark.parametrize(("pixels", "judged"), [(2, False), (3, True)])
def test_as_many_values_as_pixels_judge_nothing(bench: Scene, basis: Basis, pixels: int, judged: bool) -> None:
    """Two values meet two pixels whatever these are, a third pixel of another capture they do not."""
    keys, prediction = begun(bench, basis, [EXPOSURE, "camera.sensor.offset"])
    truth = np.array([key.value for key in keys.keys])
    gray = prediction.at(truth).unclipped
    seen = taken(np.clip(gray + 40 * generator(5, 1).standard_normal(gray.shape), 0, 250), bench)
    order = np.argsort(gray, axis=None)
    mask = np.zeros(gray.shape, dtype=bool)
    mask.flat[order[[0, -1, gray.size // 2][:pixels]]] = True
    solved = solve(keys.keys, prediction, [replace(seen, mask=mask)], 0.5, robust=False)
    errors = PredictionErrors(np.zeros((2, pixels)))
    found = verdict(solved.residual, solved.weighed.sigma, spread(solved.jacobian, errors).basis, errors)
    assert found.pixels.freedom == pixels - 2 and found.is_judged == judged
    assert not found.explained and not found.pixels.passed and not found.pixels.by_noise
    assert (found.pixels.chi_square > 4 * 7.88) == judged  # the largest of one degree, at 1 of 200


def _robust(prediction: Prediction, keys: FreeScene, gray: Array, bench: Scene) -> Solution:
    """A robust fit to a capture of noise 1 gray level."""
    return solve(keys.keys, prediction, [taken(gray, bench)], 1.0, robust=True)


def _ended(solved: Solution, errors: PredictionErrors) -> Ended:
    """Of light without any grain."""
    keys, own = solved.jacobian.shape[1], np.zeros((2, *solved.residual.shape))
    moved = np.zeros((keys, *own.shape))
    grained = Grained(np.arange(0), np.arange(keys), moved[:0], own[0], moved, own, np.zeros(0))
    return Ended(solved, errors, grained)


def test_a_robust_fit_is_as_sure_as_huber_says(bench: Scene, basis: Basis) -> None:
    """Of normal noise: 1/J^TJ times E[psi^2]/E[psi']^2, 1.08, for psi = r/sqrt(1 + r^2)."""
    r = np.linspace(-9, 9, 20001)
    density = np.exp(-(r**2) / 2) / np.sqrt(2 * np.pi) * (r[1] - r[0])
    ratio = float((density * r**2 / (1 + r**2)).sum() / (density * (1 + r**2) ** -1.5).sum() ** 2)
    assert ratio == pytest.approx(1.08, abs=0.01)
    keys, prediction = begun(bench, basis, [EXPOSURE])
    gray, sigma = prediction.at([100.0]).unclipped, math.sqrt(1 + 1 / 12)  # with that of rounding
    found, values = [], []
    for seed in range(SEEDS):
        solved = _robust(prediction, keys, gray + sigma * generator(seed, 7).standard_normal(gray.shape), bench)
        quiet = PredictionErrors(np.zeros((2, len(solved.jacobian))))
        sure = _ended(solved, quiet).spread(RANK, None).noise[0, 0]
        found.append(sure * float((solved.jacobian**2).sum()))
        values.append((solved.values[0] - 100.0) / keys.keys[0].scale / math.sqrt(sure))
    # 480 pixels tell the ratio to some 3 %, 20 captures of them to .7 %.
    assert np.mean(found) == pytest.approx(ratio, rel=0.025)
    assert SCATTER[0] < np.std(values) < SCATTER[1]


def test_a_robust_fit_that_goes_through_all_pixels_is_no_surer_than_by_squares(bench: Scene, basis: Basis) -> None:
    """Two pixels and two keys: nothing is left, and still the noise is known."""
    keys, prediction = begun(bench, basis, [EXPOSURE, "camera.sensor.offset"])
    gray = prediction.at([100.0, 5.0]).unclipped
    mask = np.zeros(gray.shape, dtype=bool)
    mask.flat[[np.argmin(gray), np.argmax(gray)]] = True
    solved = solve(keys.keys, prediction, [replace(taken(gray, bench), mask=mask)], 1.0, robust=True)
    quiet = PredictionErrors(np.zeros((2, len(solved.jacobian))))
    assert len(solved.jacobian) == 2
    by_squares = np.linalg.inv(solved.jacobian.T @ solved.jacobian)
    assert _ended(solved, quiet).spread(RANK, None).noise == pytest.approx(by_squares, rel=1e-6)


def test_a_robust_fit_hands_on_errors_of_the_prediction_by_pixels_that_count(bench: Scene, basis: Basis) -> None:
    """An error where captures show a scratch moves little, one elsewhere more: as a second fit to that image says."""
    keys, prediction = begun(bench, basis, [EXPOSURE, "camera.sensor.offset"])
    gray = prediction.at([100.0, 5.0]).unclipped + generator(1, 7).standard_normal((20, 24))
    gray[4:9, 3:9] += 12.0
    first = _robust(prediction, keys, gray, bench)
    shape = np.zeros((20, 24))
    for where in (np.s_[4:9, 3:9], np.s_[10:15, 3:9]):
        error = shape.copy()
        error[where] = 0.05
        moved = (_robust(prediction, keys, gray + error, bench).values - first.values) / [100.0, 5.0]
        pixels = (error / first.weighed.sigma)[first.weighed.used]
        ended = _ended(first, PredictionErrors(np.stack([pixels, -pixels])))
        told = ended.spread(RANK, None)
        # Two predictions, e and -e, are off their mean by e: the variance of that mean is e^2.
        assert np.sqrt(np.diag(told.prediction)) == pytest.approx(np.abs(moved), rel=0.02, abs=1e-9)
        assert np.sqrt(np.diag(told.prediction)).max() > 1e-6


def test_right_scenes_are_explained(bench: Scene, basis: Basis) -> None:
    """At the 1 % level: one of 8 is refused with a chance of 8 %, two with one of 0.3 %."""
    passed = []
    for solved in _noisy(bench, basis, [EXPOSURE], [110.0], FEW):
        errors = PredictionErrors(np.zeros((2, len(solved.jacobian))))
        judged = verdict(solved.residual, solved.weighed.sigma, spread(solved.jacobian, errors).basis, errors)
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
