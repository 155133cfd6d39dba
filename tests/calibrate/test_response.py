"""Response of a sensor: exact frames give exact constants, noisy ones honest errors, bad ones a clear message."""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.calibrate.response import energy_in_cone, exposure_at_distance, fit_response
from radwrap.calibrate.response_fits import rounding_variance
from radwrap.cli import calibrate_sensor
from radwrap.errors import InputError
from radwrap.units import parse_gain

SCENE = Path(__file__).parents[2] / "rad_scenes" / "fig04_sensor_calibration" / "scene.toml"

K, GAMMA, DARK, SATURATION = 3.38e4, 0.85, 22.0, 181.0  # Sec. 4.1
TIMES = np.linspace(0, 0.032, 33)
NEAR = exposure_at_distance(TIMES, 0.0471, 0.8)  # saturates at 25 ms

EXACT = 1e-9  # double precision leaves 1e-14
TRACED = 1e-3  # mean over the patch: 127 sub-viewpoints, 4 x 4 rays a pixel (measured: 5e-5)
SEEDS = 200
# Draws, and what share of them lies within one sigma (68.27 %). Of 200: 3.3 % standard deviation, so outside 54 to 80 %
# once in 1e4 good fits; above it, because rounding counts as noise. Of 60: 6 %; standard errors that are half or twice
# as large, of 38 and 95 %, are seen by them too.
ONE_SIGMA = {60: (0.46, 0.92), 200: (0.54, 0.86)}
# Within three sigma (99.73 % if the variances were known; from a few repeats a little less): 2 % may miss.
THREE_SIGMA = 0.98


def gray(exposure: np.ndarray) -> np.ndarray:
    return np.minimum(K * exposure**GAMMA + DARK, SATURATION)


def frames(seed: int, repeats: int = 4, noise: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    exposure = np.repeat(NEAR[::2], repeats)
    return exposure, np.rint(gray(exposure) + noise * random.standard_normal(len(exposure)))


def test_eq_6_in_both_readings() -> None:
    """The numbers of the ERRATA."""
    assert exposure_at_distance(np.array([0.032]), 0.0471, 0.91)[0] == pytest.approx(1.820e-3, rel=1e-3)
    assert energy_in_cone(np.array([0.032]), 0.0471, math.radians(7))[0] == pytest.approx(1.771e-5, rel=1e-3)
    per_paper, exact = (energy_in_cone(np.array([1.0]), 1.0, math.radians(7), which)[0] for which in ("paper", "exact"))
    assert per_paper == pytest.approx(0.0117523, abs=5e-8)
    assert exact == pytest.approx(0.0117194, abs=5e-8)


def test_rounding_leaves_a_twelfth_and_noise_dithers_it_away() -> None:
    leftover = rounding_variance(np.array([0.0, 0.25]), 1.0)
    assert leftover[0] == pytest.approx(1 / 12)
    assert leftover[1] < 1e-5


def test_exact_frames_give_the_constants() -> None:
    found = fit_response(NEAR, gray(NEAR), quantisation=0)
    for fit in (found.direct, found.eq7):
        assert fit.gain == pytest.approx(K, rel=EXACT)
        assert fit.gamma == pytest.approx(GAMMA, rel=EXACT)
    assert found.dark_gray == pytest.approx(DARK, rel=EXACT)
    assert found.saturation_gray == SATURATION


@pytest.mark.parametrize("distance", [0.91, 1.0])
def test_the_printed_numbers_come_back_with_saturation_given(distance: float) -> None:
    exposure = exposure_at_distance(TIMES, 0.0471, distance)
    exact = fit_response(exposure, gray(exposure), saturation=SATURATION, quantisation=0)
    assert (exact.gain, exact.gamma) == pytest.approx((K, GAMMA), rel=EXACT)
    whole = fit_response(exposure, np.rint(gray(exposure)), saturation=SATURATION)
    assert abs(whole.gain - K) < 3 * whole.sigma["K"]
    assert abs(whole.gamma - GAMMA) < 3 * whole.sigma["gamma"]


def test_eq_6_as_printed_scales_the_gain_and_leaves_gamma() -> None:
    energy = energy_in_cone(TIMES, 0.0471, math.radians(7))
    found = fit_response(energy, gray(NEAR), quantisation=0, exposure_unit="J")
    ratio = 1 / 0.64 / (math.pi * math.tan(math.radians(3.5)) ** 2)
    assert found.gain == pytest.approx(K * ratio**GAMMA, rel=EXACT)
    assert found.gamma == pytest.approx(GAMMA, rel=EXACT)
    assert found.gain_unit == "gray J^-0.85"
    assert found.scene_gain is None


@pytest.mark.parametrize("start", [0.01, 0.3, 2.0, 10.0])
def test_wrong_start_values_do_not_matter(start: float) -> None:
    exposure, levels = frames(1)
    right, wrong = fit_response(exposure, levels), fit_response(exposure, levels, start_gamma=start)
    assert wrong.gain == pytest.approx(right.gain, rel=1e-6)
    assert wrong.gamma == pytest.approx(right.gamma, rel=1e-7)


@pytest.mark.long
def test_noisy_frames_lie_within_their_standard_errors() -> None:
    pulls = []
    for seed in range(SEEDS):
        found = fit_response(*frames(seed))
        for fit in (found.direct, found.eq7):
            ln_gain = math.log(fit.gain / K) / math.sqrt(fit.covariance[0, 0])
            pulls.append((ln_gain, (fit.gamma - GAMMA) / fit.sigma["gamma"]))
    for which in (np.abs(pulls[::2]), np.abs(pulls[1::2])):
        inside = np.mean(which < 1, axis=0)
        assert (inside > ONE_SIGMA[SEEDS][0]).all()
        assert (inside < ONE_SIGMA[SEEDS][1]).all()
        assert (np.mean(which < 3, axis=0) >= THREE_SIGMA).all()


def test_every_frame_left_out_has_its_reason() -> None:
    found = fit_response(NEAR, gray(NEAR), quantisation=0)
    reasons = {item.frame: (item.fits, item.reason.split(":")[0]) for item in found.left_out}
    assert reasons[0] == (("eq7",), "no exposure")
    assert reasons[25] == (("eq7", "direct"), "near saturation")
    assert all(reasons[frame] == (("eq7", "direct"), "saturated") for frame in range(26, 33))
    assert set(reasons) == {0, *range(25, 33)}


def test_a_dim_frame_is_left_out_of_the_logarithms_alone() -> None:
    exposure = np.concatenate([NEAR, [1e-7]])
    found = fit_response(exposure, np.rint(gray(exposure)))
    (dim,) = [item for item in found.left_out if item.frame == 33]
    assert dim.fits == ("eq7",)
    assert dim.reason.startswith("dark")


def test_an_uncertain_source_widens_the_gain_alone() -> None:
    found = fit_response(*frames(1))
    assert found.gain_sigma_with_source(0.0) == pytest.approx(found.sigma["K"])
    relative = found.gain_sigma_with_source(0.1) / found.gain
    assert relative == pytest.approx(math.hypot(found.sigma["K"] / found.gain, 0.1 * found.gamma))


def test_the_tracer_gives_the_closed_form_and_the_fit_the_sensor_back() -> None:
    """The LED through the window: H = tau P_s/D^2; then K and gamma from traced frames of whole gray levels."""
    scene = radwrap.load_scene(str(SCENE))
    times, levels = [0.0], [DARK]
    traced = radwrap.render(scene, viewpoints=127, layout="sunflower", pixel_samples=4)
    for milliseconds in (2, 9, 18, 28, 32):
        rendered = traced.with_exposure(f"{milliseconds} ms")  # the same radiance: traced once
        expected = milliseconds * 1e-3 * 0.0471 / 0.8**2
        assert rendered.radiant_exposure.values.mean() == pytest.approx(expected, rel=TRACED)
        times.append(milliseconds * 1e-3)
        levels.append(float(rendered.gray.values.mean()))
    found = fit_response(exposure_at_distance(np.array(times), 0.0471, 0.8), np.array(levels))
    for fit in (found.direct, found.eq7):
        assert abs(fit.gain - K) < 3 * fit.sigma["K"]
        assert abs(fit.gamma - GAMMA) < 3 * fit.sigma["gamma"]


@pytest.mark.parametrize(
    ("exposure", "levels", "options", "message"),
    [
        (NEAR[1:], gray(NEAR[1:]), {}, "dark gray level is unknown"),
        (NEAR[:20], gray(NEAR[:20]), {}, "no plateau"),
        (NEAR[[0, 3, 6, 30, 32]], gray(NEAR[[0, 3, 6, 30, 32]]), {}, "at least 3 are needed"),
        (NEAR, np.full(33, 22.0), {}, "not above dark"),
        (NEAR, np.full(33, 255.0), {}, "not above dark"),
        (NEAR, gray(NEAR), {"saturation": 150.0}, "above the saturation"),
        (NEAR, gray(NEAR), {"saturation": 20.0, "dark": 22.0}, "above the saturation"),
        (-NEAR, gray(NEAR), {}, "negative exposure"),
        (NEAR, np.full(33, math.nan), {}, "not a finite number"),
        (NEAR[:2], gray(NEAR), {}, "as many exposures"),
        (NEAR[:0], NEAR[:0], {}, "as many exposures"),
        (NEAR, gray(NEAR), {"noise": -1.0}, "must not be negative"),
        (NEAR, gray(NEAR)[::-1], {}, "dark|plateau|saturation"),
    ],
)
def test_frames_that_tell_nothing(
    exposure: np.ndarray, levels: np.ndarray, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        fit_response(exposure, levels, **options)


def command(*words: str) -> int:
    parser = argparse.ArgumentParser()
    calibrate_sensor.add_to(parser.add_subparsers())
    arguments = parser.parse_args(["sensor", *words])
    code: int = arguments.run(arguments)
    return code


def table(path: Path, kind: str, values: np.ndarray, levels: np.ndarray) -> str:
    rows = [f"{value!r},{level!r}" for value, level in zip(values.tolist(), levels.tolist(), strict=True)]
    path.write_text("\n".join([f"{kind},gray", *rows]) + "\n")
    return str(path)


SOURCE = ("--radiant-intensity", "47.1 mW/sr", "--distance", "0.8 m")


def test_the_command_prints_what_a_scene_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path / "frames.csv", "exposure_time", TIMES, gray(NEAR))
    assert command(file, *SOURCE, "--quantisation", "0", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert parse_gain(found["gain"]) == (found["K"], found["gamma"])
    assert found["K"] == pytest.approx(K, rel=EXACT)
    assert (found["K_unit"], found["schema_version"]) == ("gray (J/m^2)^-0.85", 1)
    assert found["left_out"][0]["line"] == 2
    assert set(found["sigma"]) == {"K", "gamma", "dark_gray", "saturation_gray"}
    assert command(file, *SOURCE) == 0
    assert "direct fit: K " in capsys.readouterr().out


def test_radiant_exposure_needs_no_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path / "frames.csv", "radiant_exposure", NEAR, gray(NEAR))
    assert command(file, "--json", "--quantisation", "0") == 0
    assert json.loads(capsys.readouterr().out)["gamma"] == pytest.approx(GAMMA, rel=EXACT)


def test_equal_frames_give_an_equal_plot(tmp_path: Path) -> None:
    file = table(tmp_path / "frames.csv", "radiant_exposure", *frames(1))
    plots = [tmp_path / "1.png", tmp_path / "2.png"]
    for plot in plots:
        assert command(file, "--plot", str(plot)) == 0
    assert plots[0].read_bytes() == plots[1].read_bytes()


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        (None, (), "no such file"),
        ("", (), "has the columns"),
        ("time,gray\n1,2\n", (), "has the columns"),
        ("radiant_exposure,gray\n", (), "holds no frames"),
        ("radiant_exposure,gray\n0,1\n1;2\n", (), "line 3: has 1 cells"),
        ("radiant_exposure,gray\n0,1\nx,2\n", (), 'line 3: "x" is not a number'),
        ("radiant_exposure,gray\nnan,2\n", (), "not a finite number"),
        ("radiant_exposure,gray\n-1,2\n", (), "line 2: the radiant_exposure is negative"),
        ("radiant_exposure,gray\n0,2\n", SOURCE, "goes with the column exposure_time"),
        ("exposure_time,gray\n0,2\n", (), "needs --radiant-intensity and --distance or --cone-angle"),
        ("exposure_time,gray\n0,2\n", SOURCE[:2], "needs --distance or --cone-angle"),
        ("exposure_time,gray\n0,2\n", (*SOURCE, "--cone-angle", "7 deg"), "needs only one of"),
        ("exposure_time,gray\n0,2\n", (*SOURCE, "--solid-angle", "exact"), "goes with --cone-angle"),
        ("exposure_time,gray\n0,2\n", (*SOURCE[:3], "0.8"), "--distance"),
        ("exposure_time,gray\n0,2\n", (*SOURCE[:3], "-1 m"), "must be above zero"),
        ("exposure_time,gray\n0,2\n", (*SOURCE[:2], "--cone-angle", "180 deg"), "less than 180 deg"),
        ("radiant_exposure,gray\n0,2\n", ("--source-uncertainty", "-1"), "must be a share"),
        ("radiant_exposure,gray\n0,22\n1,30\n", (), "frames.csv: the frames show no plateau"),
    ],
)
def test_tables_and_options_that_cannot_be_used(
    tmp_path: Path, text: str | None, words: tuple[str, ...], message: str
) -> None:
    file = tmp_path / "frames.csv"
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError) as error:
        command(str(file), *words)
    assert message in str(error.value)


def test_a_gamma_that_is_known_is_held() -> None:
    """A linear camera: K and G0 are a straight line's, and known better than with gamma free."""
    exposure = np.linspace(0, 1e-3, 21)
    exact = fit_response(exposure, 10 + 1e5 * exposure, saturation=255, quantisation=0, gamma=1)
    assert (exact.gain, exact.gamma, exact.dark_gray) == pytest.approx((1e5, 1, 10), rel=EXACT)
    assert exact.eq7.gain == pytest.approx(1e5, rel=EXACT)
    random = np.random.default_rng(5)
    pulls = []
    for _ in range(60):
        level = np.repeat(10 + 1e5 * exposure, 4)
        noisy = np.rint(level + random.standard_normal(len(level)))
        found = fit_response(np.repeat(exposure, 4), noisy, saturation=255, gamma=1)
        assert found.gamma == found.eq7.gamma == 1 and found.sigma["gamma"] == found.eq7.sigma["gamma"] == 0
        pulls.append([math.log(fit.gain / 1e5) / math.sqrt(fit.covariance[0, 0]) for fit in (found.direct, found.eq7)])
    inside = np.mean(np.abs(pulls) < 1, axis=0)
    assert (inside > ONE_SIGMA[60][0]).all() and (inside < ONE_SIGMA[60][1]).all()
    assert found.sigma["K"] < 0.5 * fit_response(np.repeat(exposure, 4), noisy, saturation=255).sigma["K"]
    with pytest.raises(InputError, match="gamma must lie between"):
        fit_response(exposure, 10 + 1e5 * exposure, saturation=255, gamma=0)
