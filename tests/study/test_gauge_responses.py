"""Gauges as responses of a study: placed by each run's own scene, and right there."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap import load_scene, with_value
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.study.design import read_design
from radwrap.study.gauge_responses import GAUGES
from radwrap.study.image_error import error_fields, image_error
from radwrap.study.placed_calipers import named_face, width_caliper
from radwrap.study.runs import check_design
from radwrap.study.seen import Seen
from radwrap.study.study import StudyOptions, run_study
from tests.cli.conftest import here, write_scene
from tests.measure.pictures import noisy, stripe_picture
from tests.measure.test_gauges_cli import FACING, TILTED

LINEAR: dict[str, Any] = {
    "model": "linear",
    "rows": 60,
    "columns": 72,
    "pixel_width": "32 um",
    "pixel_height": "36 um",
    "bit_depth": 12,
    "wavelength": "650 nm",
    "quantum_efficiency": 0.5,
    "system_gain": "0.1 DN/e",
    "offset": 64,
    "full_well": "36 ke",
    "read_noise": "5 e",
}
DESIGN = """
scene = "scene.toml"
analysis = "none"
[render]
tolerance = 4.0
[design]
kind = "list"
runs = [["6 mm"]]
[factors.place]
key = "targets[1].position[0]"
levels = ["0 mm", "6 mm"]
[responses.diameter]
measure = "diameter"
target = "coin"
[responses.off]
measure = "diameter_error"
target = "coin"
edge = "gradient"
[responses.width]
measure = "width"
target = "ground"
[responses.mean]
measure = "region_mean"
region = [34, 26, 40, 32]
[responses.contrast]
measure = "region_contrast"
region = [34, 26, 40, 32]
against = [2, 2, 8, 8]
[responses.ratio]
measure = "contrast_to_noise"
region = [34, 26, 40, 32]
against = [2, 2, 8, 8]
[responses.named]
measure = "region_contrast"
region = "coin"
against = "ground"
[responses.even]
measure = "uniformity"
region = [34, 26, 40, 32]
[responses.uneven]
measure = "unevenness"
region = [34, 26, 40, 32]
"""
# Its ground reaches beyond the image: no width can be measured, which costs the width alone.
SCENE: dict[str, Any] = {**{k: v for k, v in TILTED.items() if "sensor" not in k}, "camera.sensor": LINEAR}


def written(folder: Path, text: str = DESIGN, **more: Any) -> Path:
    write_scene(folder, {**SCENE, "camera.exposure_time": "100 ms", **more})
    path = folder / "design.toml"
    path.write_text(text)
    return path


@pytest.mark.long
@pytest.mark.usefixtures("one_process")
def test_each_run_is_measured_where_its_scene_has_the_part(tmp_path: Path) -> None:
    done = run_study(read_design(written(tmp_path)), tmp_path / "out", StudyOptions(workers=1))
    rows = list(csv.DictReader((tmp_path / "out" / "results.csv").read_text().splitlines()))
    assert len(rows) == len(done.rows) == 1  # where the scene of the design has it is measured by other tests
    for row in rows:
        assert float(row["diameter [mm]"]) == pytest.approx(30, abs=0.12)
        assert 0 < float(row["diameter_error [mm]"]) < 0.12
        assert float(row["off [mm]"]) == pytest.approx(0, abs=0.4)
        assert row["width [mm]"] == "" and "width: " in row["error"], "costs itself and not its run"
        mean, contrast, ratio = (float(row[name]) for name in ("mean", "contrast", "ratio"))
        # Means a and b above an offset of 64: their difference, and the noise of light and read-out at 0.1 DN/e.
        total = 2 * (mean - 64) / (1 + contrast)
        a, b = mean - 64, total - (mean - 64)
        variance = 0.1 * (a + b) + 2 * (0.5**2 + 1 / 12)
        assert ratio == pytest.approx((a - b) / variance**0.5, rel=1e-3)
        assert float(row["named"]) == pytest.approx(contrast, abs=0.1)
        assert 0.8 < float(row["even"]) < 1 and 0 < float(row["uneven"]) < 0.2


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ('target = "coin"\nedge', 'target = "nobody"\nedge', 'no target "nobody"'),
        ('measure = "width"\ntarget = "ground"', 'measure = "width"\ntarget = "coin"', "no rectangle"),
        ('measure = "width"\ntarget = "ground"', 'measure = "width"', "needs the option target"),
        ('measure = "width"\ntarget = "ground"', 'measure = "diameter"\ntarget = "ground"', "no round rim"),
        ('edge = "gradient"', 'rim = "inner"', "no inner rim"),
        ('region = "coin"', 'region = "coim"', 'did you mean "coin"?'),
        ('region = "coin"', "region = 3", "or a target's name"),
        ('edge = "gradient"', 'edge = "steepest"', "not one of"),
        ("against = [2, 2, 8, 8]\n[responses.ratio]", "[responses.ratio]", "needs the option against"),
        (
            'measure = "region_mean"\nregion = [34, 26, 40, 32]',
            'measure = "region_mean"\nregion = [34, 26]',
            "four whole",
        ),
    ],
)
def test_what_cannot_be_measured_is_refused_before_the_first_ray(
    tmp_path: Path, was: str, becomes: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert DESIGN.count(was) == 1
    path = written(tmp_path, DESIGN.replace(was, becomes))
    done = here(["study", "run", path, "--out", tmp_path / "out"], capsys)
    assert done.code == 2 and message in done.stderr and "design.toml: responses" in done.stderr


def test_contrast_to_noise_needs_a_linear_camera(tmp_path: Path) -> None:
    path = written(tmp_path, **{"camera.sensor": {**SMALL_POWER_LAW}})
    with pytest.raises(Exception, match="linear camera"):
        check_design(read_design(path), {})


SMALL_POWER_LAW = {
    "rows": 60,
    "columns": 72,
    "pixel_width": "32 um",
    "pixel_height": "36 um",
    "gain": "3.38e4 (J/m^2)^-0.85",
    "gamma": 0.85,
    "dark_gray": 22,
    "saturation_gray": 255,
}


@pytest.mark.parametrize(("size", "fits"), [("6 mm", 10.0), ("8 mm", 8.8), ("12 mm", 3.4)])
def test_a_width_caliper_stays_within_the_image(size: str, fits: float) -> None:
    """A coarse scale leaves less room beside a part than the usual margin; the part is in sight nevertheless."""
    scene = load_scene(Path(__file__).parents[2] / "rad_scenes" / "moving_belt" / "scene.toml")
    number = next(k for k, target in enumerate(scene.targets) if target.name == "key")
    scene = with_value(scene, f"targets[{number}].size", ["8 mm", size, "2 mm"])
    caliper, true = width_caliper(scene.camera, named_face(scene, "key"), "y", 1.0)
    assert true == pytest.approx(float(size.split(maxsplit=1)[0]) / 1e3)
    # Its upper face is 298 mm away, and a pixel there 20.7 um of 16 mm wide, at a focus of 300 mm.
    pixel = 20.7e-6 * 298 / (16 * 300 / (300 - 16))
    assert caliper.band - true / pixel / 2 == pytest.approx(fits, abs=0.3)
    across, along = np.array([np.cos(caliper.angle), np.sin(caliper.angle)]), caliper.length / 2
    for sign in (-1, 1):
        for end in (-along, along):
            u, v = np.array(caliper.centre) + sign * caliper.band * across + end * np.array([-across[1], across[0]])
            assert 0 <= u <= 63 and 0 <= v <= 47


@pytest.mark.long
@pytest.mark.parametrize(("bright", "known"), [(220.0, True), (80.0, False)])
def test_a_width_in_doubt_costs_its_response(tmp_path: Path, bright: float, known: bool) -> None:
    """Of 7.4 px under a blur of 3.3 px, a millimetre each: of little light it has no value, and the answer says why."""
    square = {"rows": 60, "columns": 80, "pixel_width": "25 um", "pixel_height": "25 um"}
    sheets = {"targets": FACING["targets"], "camera.sensor": LINEAR | square}
    scene = load_scene(write_scene(tmp_path, sheets))
    light = stripe_picture((60, 80), 0.0, 39.4, 7.4, blur=3.3, levels=(30.0, bright))
    gray = noisy(light, np.random.default_rng(8))
    error, fields = image_error(gray, 0.1, (1.0, 1.0)), error_fields(gray.shape, (1.0, 1.0))
    seen = Seen(scene, GrayImage(gray, 12), gray, error, fields)
    if known:
        found = GAUGES["width"].answer(seen, {"target": "bar"})
        assert found.value == pytest.approx(7.4e-3, abs=3e-4) and 0 < found.error < 1e-4
    else:
        with pytest.raises(InputError, match="the width is not known: "):
            GAUGES["width"].answer(seen, {"target": "bar"})


def two_levels(folder: Path, first: float, second: float) -> Seen:
    """Left and right halves of an image whose camera is full at 64 + 0.1 * 20 000 = 2064 of 4095 levels."""
    sensor = LINEAR | {"full_well": "20 ke"}
    scene = load_scene(write_scene(folder, {"targets": FACING["targets"], "camera.sensor": sensor}))
    gray = np.repeat([[first, second]], 60, axis=0).repeat(36, axis=1)
    error = image_error(gray, 0.0, (1.0, 1.0))
    return Seen(scene, GrayImage(np.rint(gray), 12), gray, error, error_fields(gray.shape, (1.0, 1.0)))


HALVES: dict[str, Any] = {"region": [2, 2, 33, 57], "against": [38, 2, 69, 57]}


def test_a_region_that_is_full_below_full_scale_is_named(tmp_path: Path) -> None:
    seen = two_levels(tmp_path, 2064.0, 1000.0)
    for measure in ("region_mean", "region_contrast"):
        (warning,) = GAUGES[measure].answer(seen, HALVES).warnings
        assert "1792 of 1792 pixels of `region` are saturated" in warning
    with pytest.raises(InputError, match="is saturated in part"):
        GAUGES["contrast_to_noise"].answer(seen, HALVES)
    assert not GAUGES["region_contrast"].answer(two_levels(tmp_path, 2063.0, 1000.0), HALVES).warnings


def test_a_region_that_noise_takes_below_dark_has_the_noise_of_no_light(tmp_path: Path) -> None:
    """Of the levels 63.9 and 164: 1000 electrons at 0.1 DN/e, and read noise of 0.5 DN and rounding twice."""
    answer = GAUGES["contrast_to_noise"].answer(two_levels(tmp_path, 63.9, 164.0), HALVES)
    assert answer.value == pytest.approx(100.1 / (0.1 * 100 + 2 * (0.25 + 1 / 12)) ** 0.5, rel=1e-6)


def test_contrast_to_noise_does_not_step_with_whole_levels(tmp_path: Path) -> None:
    """Levels 164.4 and 164.1 are both shown as 164; frames whose noise is 3 levels have the means of the light."""
    answer = GAUGES["contrast_to_noise"].answer(two_levels(tmp_path, 164.4, 164.1), HALVES)
    assert answer.value == pytest.approx(0.3 / (0.1 * (100.4 + 100.1) + 2 * (0.25 + 1 / 12)) ** 0.5, rel=1e-6)
