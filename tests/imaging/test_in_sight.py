"""What explain says first: millimetres, sharpness, levels and noise of what is in sight, against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.images import ExposureImage
from radwrap.imaging.forecast.in_sight import exposure_for_advice, level_of
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.noise import fixed_pattern, linear_of, noisy_frame
from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.file.load import load_scene
from radwrap.scene.scene import Scene
from tests.cli.conftest import here


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The template of a washer under a ring."""
    made = tmp_path_factory.mktemp("cell")
    radwrap_init = ["init", made / "it", "--template", "ring"]
    from radwrap.cli.main import main

    assert main([str(word) for word in radwrap_init]) == 0
    return made / "it"


Explained = tuple[Scene, dict[str, Any], dict[str, Any]]


def explained(folder: Path, **changes: Any) -> Explained:
    scene = load_scene(folder / "scene.toml", changes)
    found = radwrap.explain(scene)
    return scene, found, {one["target"]: one for one in found["in_sight"]}


@pytest.fixture(scope="module")
def plain(folder: Path) -> Explained:
    """The template as it is."""
    return explained(folder)


def test_sizes_are_those_of_the_visible_face(plain: Explained) -> None:
    scene, _, seen = plain
    camera = scene.camera
    washer, belt = seen["washer"], seen["belt"]
    # 2.5 mm high on .05 mm: its face is 297.45 mm away, not its origin at 299.95 mm.
    assert washer["nearest"] == pytest.approx(0.29745, abs=1e-7)
    assert washer["pixel"] == pytest.approx([0.29745 * 6.9e-6 / camera.image_distance] * 2, rel=1e-6)
    assert belt["field_of_view"] == pytest.approx([0.3 * n * 6.9e-6 / camera.image_distance for n in (1224, 1024)])
    # (d/2) v |1/z - 1/s|, in pixels.
    blur = camera.aperture.diameter / 2 * camera.image_distance * abs(1 / 0.3 - 1 / 0.2975) / 6.9e-6
    assert belt["blur_radius_px"] == pytest.approx([blur, blur])
    assert washer["blur_radius_px"][0] < 0.01


def test_levels_are_those_of_the_image(folder: Path) -> None:
    scene, _, seen = explained(folder, **{"camera.sensor.scale": "1/16", "camera.diffraction": "off"})
    image = radwrap.render(scene, tolerance=30, workers=1, truth=True, tracer="compiled")
    assert image.truth is not None
    mask = image.truth["mask"] == next(n for name, n in image.truth["parts"].items() if "washer" in name)
    assert seen["washer"]["middle"]["gray"] == pytest.approx(np.median(image.gray.values[mask]), rel=0.01)
    assert seen["washer"]["middle"]["electrons"] == pytest.approx(np.median(image.electrons[mask]), rel=0.01)
    assert image.gray.values.max() <= seen["washer"]["peak"]["gray"] * 1.01


def test_snr_is_that_of_frames(folder: Path) -> None:
    scene, _, _ = explained(folder, **{"camera.sensor.roi": [0, 0, 75, 63]})
    sensor = scene.camera.sensor
    for share in (0.02, 0.3):
        light = share * (sensor.saturation_gray - sensor.dark_gray) / sensor.gain
        level = level_of(light, sensor)
        exposure = ExposureImage(np.full((sensor.rows, sensor.columns), light))
        pattern = fixed_pattern(sensor)
        frames = np.array([noisy_frame(exposure, sensor, pattern, 1, k).values for k in range(40)])
        noise = math.sqrt(float(frames.var(axis=0, ddof=1).mean()))
        # 4864 pixels, each known to sqrt(1/78): their mean to .2 %.
        assert level.snr == pytest.approx((level.gray - sensor.dark_gray) / noise, rel=0.01)
        assert level.electrons == pytest.approx(share * linear_of(sensor).full_well, rel=0.02)


def test_exposure_for_80_percent_brings_the_peak_there(folder: Path, plain: Explained) -> None:
    _, found, _ = plain
    wanted = found["exposure_for_80_percent"]
    scene, again, _ = explained(folder, **{"camera.exposure_time": f"{wanted!r} s"})
    sensor = scene.camera.sensor
    share = (again["expected_peak"]["gray"] - sensor.dark_gray) / (sensor.saturation_gray - sensor.dark_gray)
    assert share == pytest.approx(0.8, abs=1e-3)


def test_each_target_has_the_exposure_of_its_own_brightest(folder: Path, plain: Explained) -> None:
    """And the target that the expected peak lies on has that peak as its "at most": one exposure for both."""
    _, found, seen = plain
    peak = found["expected_peak"]
    assert seen[peak["target"]]["peak"]["gray"] == pytest.approx(peak["gray"], abs=0.51)
    assert seen[peak["target"]]["exposure_for_80_percent"] == found["exposure_for_80_percent"]
    wanted = seen["belt"]["exposure_for_80_percent"]
    assert wanted > 3 * found["exposure_for_80_percent"]
    scene, _, again = explained(folder, **{"camera.exposure_time": f"{wanted!r} s"})
    sensor = scene.camera.sensor
    share = (again["belt"]["peak"]["gray"] - sensor.dark_gray) / (sensor.saturation_gray - sensor.dark_gray)
    assert share == pytest.approx(0.8, abs=1e-3)


@pytest.mark.parametrize("gamma", [1.0, 0.5])
def test_the_advised_exposure_counts_what_the_dark_current_adds_meanwhile(folder: Path, gamma: float) -> None:
    """20 e/s over some minutes raise black by a good part of the range: as a scene with that time has it."""
    changes = {"camera.sensor.dark_current": "20 e/s", "camera.sensor.gamma": gamma}
    radiance = 2e-6
    advised = exposure_for_advice(load_scene(folder / "scene.toml", changes).camera, radiance)
    assert advised is not None and advised > 100
    camera = load_scene(folder / "scene.toml", {**changes, "camera.exposure_time": f"{advised!r} s"}).camera
    sensor = camera.sensor
    unrounded = replace(sensor, rounding=False)
    gray = float(gray_levels(np.array([radiance * exposure_of_radiance(camera)]), unrounded)[0])
    assert sensor.dark_gray > 0.1 * sensor.saturation_gray
    assert (gray - sensor.dark_gray) / (sensor.saturation_gray - sensor.dark_gray) == pytest.approx(0.8, rel=1e-9)


def test_the_advice_is_for_the_camera_at_hand(folder: Path) -> None:
    _, found, _ = explained(folder, **{"camera.exposure_time": "100 us"})
    assert found["advice"].startswith("dim; ") and found["advice"].endswith("or a lower f-number does")
    assert "pinhole" not in found["advice"]


@pytest.mark.long
def test_no_steps_of_light_that_shines_as_a_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The compiled tracer has none; what is not known of the tracer keeps the warning."""
    here(["init", tmp_path / "it", "--template", "coaxial"], capsys).success()
    changes = {"sources[0].irradiance_error": 0.05, "camera.sensor.scale": "1/64"}
    scene = load_scene(tmp_path / "it" / "scene.toml", changes)
    told = [[w for w in radwrap.explain(scene, whole)["warnings"] if "steps" in w] for whole in ((), ("coaxial",))]
    assert len(told[0]) == 1 and told[1] == []
    small = ["--tracer", "compiled", "--set", "camera.sensor.scale=1/64", "--set", "sources[0].irradiance_error=0.05"]
    lines = here(["explain", tmp_path / "it" / "scene.toml", *small], capsys)
    assert "steps" not in lines.success().stdout


def test_eight_bits_are_enough_where_noise_covers_their_step(folder: Path, plain: Explained) -> None:
    _, found, _ = plain
    assert found["eight_bits"]["enough"] and found["eight_bits"]["target"] == "belt"
    assert found["eight_bits"]["step"] == 16
    _, found, _ = explained(folder, **{"materials.belt.reflectance": 0.01})
    assert not found["eight_bits"]["enough"]
    _, found, _ = explained(folder, **{"camera.sensor.bit_depth": 8, "camera.sensor.system_gain": "0.008 DN/e"})
    assert found["eight_bits"] is None


def test_effects_are_measured_where_nothing_saturates(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml", {"camera.exposure_time": "1 s", "camera.sensor.scale": "1/64"})
    found = radwrap.effects(scene)
    assert 0.005 < found["effects_exposure_time"] < 0.008
    assert next(one for one in found["effects"] if one["name"] == "leds")["rms_gray"] > 50


def test_the_command_says_first_what_is_asked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = here(["explain", folder / "scene.toml", "--no-rays"], capsys).success().stdout.splitlines()
    assert lines[0].startswith("belt: 63.87 x 53.44 mm in view, 0.0522 mm/px, 300 mm away")
    assert any(
        line.startswith("exposure for 80 % at the brightest point in view, on washer: 6.6") for line in lines[:8]
    )
    quiet = [line for line in lines if line.startswith("assumed: ")]
    assert len(quiet) < 8 and "--assumed lists them" in quiet[-1]
    whole = here(["explain", folder / "scene.toml", "--no-rays", "--assumed"], capsys).success().stdout
    assert whole.count("assumed: ") > 15 and "rotation_order" in whole
