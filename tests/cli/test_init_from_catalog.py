"""`radwrap init` from components and a mesh: the part fills the field, light comes from where it should."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.cli import init_from_catalog
from radwrap.cli.main import main
from radwrap.errors import InputError
from radwrap.scene.catalog.places import find
from radwrap.scene.file.first_scene import FILLED, ChosenLight, Part, first_scene
from radwrap.scene.file.load import load_scene, scene_from_document
from tests.cli.conftest import here

ROOT = Path(__file__).parents[2]
WASHER = ROOT / "radwrap" / "data" / "templates" / "washer.obj"  # 24 x 24 x 2.5 mm
ROUNDING = 1e-4  # lengths are written to a tenth of a micrometre


def scene_of(size: tuple[float, float, float], lens: str, *lights: str) -> dict[str, Any]:
    part = Part("washer.obj", "1 mm", (0.0, 0.0, 0.0), size)
    chosen = [ChosenLight(find("lights", f"generic_{name}", None, "x")) for name in lights]
    sensor = find("sensors", "sony_imx250.lucid_atlas", None, "x")
    return first_scene(part, sensor, find("lenses", f"generic_{lens}", None, "x"), chosen, 1e-3)


@pytest.mark.parametrize(("size", "turned"), [((0.024, 0.010, 0.003), False), ((0.010, 0.024, 0.003), True)])
def test_the_part_fills_the_field(size: tuple[float, float, float], turned: bool, tmp_path: Path) -> None:
    """By the thin lens: the longer side of the part's top is 80 % of the columns, or the other one of the rows."""
    (tmp_path / "washer.obj").write_bytes(WASHER.read_bytes())
    camera = scene_from_document(scene_of(size, "25mm", "ring_90mm_24led"), folder=tmp_path).camera
    assert camera.lens is not None
    f, s = camera.focal_length, camera.lens.focus_distance
    magnification = f / (s - f)
    sensor = camera.sensor
    shares = [
        max(size[:2]) * magnification / (sensor.columns * sensor.pixel_width),
        min(size[:2]) * magnification / (sensor.rows * sensor.pixel_height),
    ]
    assert max(shares) == pytest.approx(FILLED, rel=ROUNDING)
    assert (abs(camera.pose.y_axis[0]) > 0.5) == turned


@pytest.mark.parametrize(
    ("lens", "lights", "message"),
    [
        ("8mm", ["dome_100mm"], "before the camera"),
        ("50mm", ["ring_60mm_16led", "area_ring_100mm"], None),
    ],
)
def test_no_light_stands_before_the_camera(lens: str, lights: list[str], message: str | None) -> None:
    if message is None:
        tables = scene_of((0.02, 0.02, 0.002), lens, *lights)
        assert len(tables["sources"]) == 2
        return
    with pytest.raises(InputError, match=message):
        scene_of((0.05, 0.05, 0.002), lens, *lights)


WORDS = ["--camera", "sony_imx287.flir_bfs_u3_04s2m", "--lens", "generic_35mm", "--part", WASHER]


LIGHT = ["--light", "generic_backlight_100x100mm", "--length-unit", "mm"]


def test_what_was_assumed_is_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(init_from_catalog, "_exposure", lambda *_: 2e-3)  # no rays: the whole way has its own test
    told = here(["init", tmp_path / "new", *WORDS, *LIGHT], capsys).success().stdout
    assert "assumed: sources[0].radiance = 20 W/m^2/sr" in told
    scene = load_scene(tmp_path / "new" / "scene.toml")
    assert scene.assumed["sources[0].radiance"].startswith("20 W/m^2/sr")
    assert scene.camera.exposure_time == 2e-3
    assert (tmp_path / "new" / "washer.obj").read_bytes() == WASHER.read_bytes()
    assert main(["init", str(tmp_path / "new"), *map(str, [*WORDS, *LIGHT])]) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.long
def test_a_lens_with_aberrations_renders_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its exposure is that of the same lens without them, by its own falloff: the part lies about the axis."""
    times = []
    for lens in ("double_gauss_12.5mm.f4", "generic_12mm"):
        words = ["--lens", lens, "--part", WASHER, "--length-unit", "mm", "--light", "generic_ring_90mm_24led=50 mW/sr"]
        here(["init", tmp_path / lens, "--camera", "sony_imx265.allied_alvium_1800_c", *words], capsys).success()
        times.append(load_scene(tmp_path / lens / "scene.toml").camera.exposure_time)
    # The ideal one passes .9 of the light, and focal lengths of 12 and 12.6 mm stand differently far away.
    assert 0.8 < times[0] / times[1] < 1.1


@pytest.mark.long
def test_a_scene_that_renders_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The brightest thousandth comes to 80 % of the range."""
    here(["init", tmp_path / "new", *WORDS, *LIGHT], capsys).success()
    scene = load_scene(tmp_path / "new" / "scene.toml")
    sensor, time = scene.camera.sensor, scene.camera.exposure_time
    # A backlight is seen itself: H = pi L T/(4 (N (1 + m))^2) t on the axis.
    assert scene.camera.lens is not None
    f, s = scene.camera.focal_length, scene.camera.lens.focus_distance
    exposure = math.pi * 20 * 0.9 / 4 / (4 * (1 + f / (s - f))) ** 2 * time
    share = sensor.gain * exposure / (sensor.saturation_gray - sensor.dark_gray)
    assert share == pytest.approx(0.8, rel=0.02)  # light towards the corners, and the disc for a point, take 1 %


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (WORDS, "--light: is missing"),
        ([*WORDS, "--light", "generic_ring_90mm"], 'no light "generic_ring_90mm"'),
        ([*WORDS, "--light", "generic_ring_90mm_24led=50 lux", "--length-unit", "mm"], "is not a level of a light"),
        ([*WORDS, "--light", "generic_ring_90mm_24led", "--length-unit", "miles"], "--length-unit"),
        ([*WORDS, "--light", "generic_ring_90mm_24led"], "--length-unit"),
        ([*WORDS, "--light", "generic_ring_90mm_24led", "--template", "ring"], "goes without --template"),
        (["--length-unit", "mm"], "goes with --part"),
    ],
)
def test_what_is_wrong_leaves_no_folder(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", str(tmp_path / "new"), *map(str, words)]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def words_of_a_filter(out: Path, light: str, *glass: str) -> list[str]:
    words = [
        "init",
        str(out),
        "--camera",
        "sony_imx287.allied_alvium_1800_c",
        "--lens",
        "generic_25mm",
        "--light",
        light,
    ]
    return [*words, "--part", str(WASHER), "--length-unit", "mm", *glass]


@pytest.mark.long
def test_the_exposure_makes_up_for_what_a_filter_stops(tmp_path: Path) -> None:
    times, counts = [], []
    for glass in ((), ("--filter", "midopt_bp635")):
        out = tmp_path / f"red{len(glass)}"
        assert main(words_of_a_filter(out, "osram_latb_t686_617nm", *glass)) == 0
        scene = load_scene(out / "scene.toml")
        assert scene.spectral is not None
        times.append(scene.camera.exposure_time)
        counts.append(scene.spectral.counts[0])
    assert 1.1 < counts[0] / counts[1] < 1.6
    assert times[1] / times[0] == pytest.approx(counts[0] / counts[1], rel=2e-3)


@pytest.mark.long
def test_light_that_a_filter_stops_is_not_taken_without_a_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words_of_a_filter(tmp_path / "green", "osram_latb_t686_528nm", "--filter", "midopt_bp635")) == 0
    assert "hardly any light arrives" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("generic_ring_90mm_24led", "--filter", "midopt_bp635"), "generic_ring_90mm_24led has no spectrum; take LEDs"),
        (("osram_latb_t686_617nm", "--filter", "midopt_bp636"), 'no filter "midopt_bp636"; did you mean'),
    ],
)
def test_a_filter_that_cannot_be_is_refused(
    words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words_of_a_filter(tmp_path / "new", *words)) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "new").exists()


def test_a_filter_given_twice_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twice = ("--filter", "midopt_bp635", "--filter", "midopt_bp525")
    assert main(words_of_a_filter(tmp_path / "new", "osram_latb_t686_617nm", *twice)) == 2
    assert "--filter: is given twice" in capsys.readouterr().err


def test_a_filter_goes_with_a_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tmp_path / "new"), "--filter", "midopt_bp635"]) == 2
    assert "--filter: goes with --camera" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize(("led", "colour"), [("osram_w5sg_528nm", "green"), ("osram_latb_t686_617nm", "red")])
def test_the_brightest_colour_of_a_mosaic_decides(
    led: str, colour: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its 99.9 % quantile is at 80 % of the range: by the pinhole's picture of that colour."""
    words = ["--camera", "ams_cmv12000.colour", "--lens", "generic_35mm", "--light", led]
    assert main(["init", str(tmp_path / "new"), *words, "--part", str(WASHER), "--length-unit", "mm"]) == 0
    assert "--set camera.sensor.mosaic=green --scale 1/4" in capsys.readouterr().out
    peaks = {}
    for one in ("red", "green", "blue"):
        changes = {"camera.sensor.mosaic": one, "camera.sensor.scale": "1/32", "camera.diffraction": "off"}
        scene = load_scene(tmp_path / "new" / "scene.toml", changes)
        gray = radwrap.render(scene, method="pinhole", pixel_samples=2, bounces=0).gray.values
        peaks[one] = float(np.percentile(gray, 99.9)) / scene.camera.sensor.saturation_gray
    assert max(peaks, key=lambda one: peaks[one]) == colour
    assert peaks[colour] == pytest.approx(0.8, abs=0.02)
