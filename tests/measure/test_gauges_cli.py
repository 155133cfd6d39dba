"""Gauges as users call them: on pictures of their own, and on predictions with the scene beside."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from radwrap.cli.gauging import with_sigma
from radwrap.images import GrayImage, write_png
from tests.cli.conftest import here, write_scene
from tests.measure.pictures import edge_picture, noisy, ring_picture, stripe_picture

RING = ["--at", 30, 31, "--radius", 20, "--inner-radius", 9]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ring of 40 and 18 px, a bar of 21.3 px and an edge, with noise."""
    folder = tmp_path_factory.mktemp("pictures")
    dice = np.random.default_rng(1)
    ring = ring_picture((62, 60), (29.77, 31.31), (20.0, 9.0), 1.1, (30.0, 190.0, 40.0))
    bar = stripe_picture((60, 80), 0.3, 42.0, 21.3, blur=1.2, levels=(30.0, 190.0))
    edge = edge_picture((60, 80), 0.3, 42.0, 1.2, (30.0, 190.0))
    for name, light in (("ring", ring), ("bar", bar), ("edge", edge)):
        write_png(folder / f"{name}.png", GrayImage(noisy(light, dice)).codes)
    return folder


def test_a_ring_in_pixels_and_in_millimetres(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["measure", "circle", pictures / "ring.png", *RING]
    told = here([*argv, "--json"], capsys).success().json
    assert abs(told["outer"]["diameter"] - 40) < 4 * told["outer"]["diameter_sigma"] < 0.06
    assert abs(told["inner"]["diameter"] - 18) < 4 * told["inner"]["diameter_sigma"] < 0.08
    assert (told["outer"]["inside"], told["inner"]["inside"]) == ("bright", "dark")
    assert told["unit"] == "px" and told["certified_rms_gray"] is None and told["outer"]["diameter_rendering"] is None
    scaled = here([*argv, "--mm-per-px", "0.05 +- 0.0002", "--json"], capsys).success().json
    outer = scaled["outer"]
    assert scaled["unit"] == "mm" and outer["diameter"] == pytest.approx(0.05 * told["outer"]["diameter"])
    assert outer["diameter_sigma_scale"] == pytest.approx(0.004 * outer["diameter"])
    assert outer["diameter_px"] == told["outer"]["diameter"]
    by_length = [*argv[:3], "--at", 30, 31, "--radius", "1 mm", "--band", "0.2 mm", "--mm-per-px", "0.05", "--json"]
    assert here(by_length, capsys).success().json["outer"]["diameter"] == pytest.approx(outer["diameter"], abs=1e-3)
    text = here([*argv, "--mm-per-px", "0.05"], capsys).success().stdout
    assert "outer: diameter 1.99" in text and "given without an error" in text


def test_an_ellipse_is_called_so(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["measure", "circle", pictures / "ring.png", "--at", 30, 31, "--radius", 20, "--shape", "ellipse"]
    outer = here([*argv, "--json"], capsys).success().json["outer"]
    assert "diameter" not in outer
    assert (outer["major_axis"], outer["minor_axis"]) == pytest.approx((40, 40), abs=0.1)
    assert "an ellipse's major axis" in here(argv, capsys).success().stdout


@pytest.mark.parametrize("way", ["model", "gradient", "moment"])
def test_widths_and_lines(pictures: Path, way: str, capsys: pytest.CaptureFixture[str]) -> None:
    at = ["--at", 39, 17.5, "--angle", 17, "--length", 24, "--band", 20, "--edge", way]
    told = here(["measure", "width", pictures / "bar.png", *at, "--json"], capsys).success().json
    assert told["width"] == pytest.approx(21.3, abs=0.06) and told["inside"] == "bright"
    line = here(["measure", "line", pictures / "edge.png", *at, "--json"], capsys).success().json
    assert line["angle"] == pytest.approx(0.3, abs=3e-3) and line["bright_side"] == "positive"
    stripe = here(["measure", "line", pictures / "bar.png", *at, "--stripe", "--json"], capsys).success().json
    assert stripe["width"] == pytest.approx(21.3, abs=0.06)
    for verb, name in (("width", "bar"), ("line", "edge")):
        assert "px" in here(["measure", verb, pictures / f"{name}.png", *at], capsys).success().stdout


def test_a_width_that_is_not_known_is_null_and_its_place_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    light = stripe_picture((60, 80), 0.3, 42.0, 7.4, blur=3.3, levels=(30.0, 80.0))
    write_png(tmp_path / "faint.png", GrayImage(noisy(light, np.random.default_rng(7))).codes)
    argv = ["measure", "width", tmp_path / "faint.png", "--at", 40, 20, "--angle", "0.3 rad", "--length", 24]
    done = here([*argv, "--band", 14, "--json"], capsys)
    told = done.json
    assert (done.code, told["width"], "width_sigma" in told) == (3, None, False)
    assert [reading["width"] for reading in told["width_readings"]] == pytest.approx([7.4, 5.5], abs=0.3)
    assert "the width is not known" in told["warnings"][-1] and told["angle"] == pytest.approx(0.3, abs=8e-3)
    assert told["centre"][0] * math.cos(0.3) + told["centre"][1] * math.sin(0.3) == pytest.approx(42, abs=0.1)


def test_a_width_in_a_plane_that_is_not_known_is_null_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same light in the plane of a sheet that faces the camera: lengths in mm, the same exit code."""
    light = stripe_picture((60, 80), 0.0, 39.4, 7.4, blur=3.3, levels=(30.0, 80.0))
    write_png(tmp_path / "faint.png", GrayImage(noisy(light, np.random.default_rng(8))).codes)
    scene = write_scene(tmp_path, FACING)
    argv = ["measure", "width", tmp_path / "faint.png", "--scene", scene, "--truth", "bar", "--dark", 0, "--gamma", 1]
    done = here([*argv, "--json"], capsys)
    told = done.json
    assert (done.code, told["unit"], told["width"], "width_sigma" in told) == (3, "mm", None, False)
    true = told["true_width_mm"]
    in_pixels = here(["measure", "width", argv[2], "--at", 39.5, 29.5, "--length", 24, "--band", 14, "--json"], capsys)
    for mine, other in zip(told["width_readings"], in_pixels.json["width_readings"], strict=True):
        assert mine["width"] == pytest.approx(other["width"] * true / 7.4, rel=0.1)
    assert told["centre"][0] == pytest.approx(39.4, abs=0.2) and "not known" in here(argv, capsys).stdout


def test_regions_and_uniformity(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    boxes = ["--region", 15, 28, 18, 34, "--against", 26, 28, 33, 34]
    argv = ["measure", "region", pictures / "ring.png", *boxes, "--dark", 10]
    told = here([*argv, "--json"], capsys).success().json
    assert told["region"]["mean"] == pytest.approx(190, abs=3) and told["against"]["mean"] == pytest.approx(40, abs=2)
    a, b = told["region"]["mean"] - 10, told["against"]["mean"] - 10
    assert told["contrast"]["michelson"] == pytest.approx((a - b) / (a + b))
    noise = math.hypot(told["region"]["sd"], told["against"]["sd"])
    assert told["contrast"]["contrast_to_noise"] == pytest.approx((a - b) / noise)
    frames = [*argv[:3], pictures / "ring.png", *argv[3:], "--noise", "temporal", "--json"]
    twice = here(frames, capsys).success().json
    assert twice["region"]["noise"] == 0 and twice["contrast"]["contrast_to_noise"] is None
    assert "contrast-to-noise" in here(argv, capsys).success().stdout
    even = ["measure", "uniformity", pictures / "ring.png", "--region", 26, 28, 33, 34]
    assert here([*even, "--json"], capsys).success().json["by_extremes"] < 0.1
    assert "1 - sd/mean" in here(even, capsys).success().stdout


@pytest.mark.parametrize(
    ("value", "sigma", "least", "text"),
    [
        (23.99976, 0.0004, 4, "23.99976 +- 0.00040"),
        (1.5, 0.25, 4, "1.5000 +- 0.2500"),
        (12.0, 3.2e-7, 3, "12.00000000 +- 0.00000032"),
        (0.5, 0.0, 5, "0.50000 +- 0.00000"),
        (0.5, math.nan, 3, "0.500 +- nan"),
    ],
)
def test_two_digits_of_a_standard_error_are_printed(value: float, sigma: float, least: int, text: str) -> None:
    assert with_sigma(value, sigma, least) == text


def test_the_renderings_error_of_contrast_is_a_second_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of flat regions a and b: one mean higher and the other lower by the certified rms, computed anew."""
    scene = write_scene(tmp_path, TILTED)
    here(["render", scene, "--tolerance", 3, "--out", tmp_path / "out"], capsys).success()
    argv = ["measure", "region", tmp_path / "out" / "gray.png", "--scene", scene]
    argv += ["--region", 20, 20, 24, 24, "--against", 2, 2, 6, 6]
    told = here([*argv, "--json"], capsys).success().json
    error, contrast = told["certified_rms_gray"], told["contrast"]
    a, b = (told[name]["mean"] - told["dark"] for name in ("region", "against"))
    assert error > 0 and abs(a - b) > 5 * error
    moved = abs((a - b) / (a + b)) + 2 * error / (a + b)
    assert abs(contrast["michelson"]) + contrast["michelson_rendering"] == pytest.approx(moved, rel=1e-6)
    spread = math.hypot(told["region"]["sd"], told["against"]["sd"])
    assert contrast["contrast_to_noise_rendering"] == pytest.approx(2 * error / spread, rel=1e-6)
    text = here(argv, capsys).success().stdout
    assert text.count("rendering about") == 4
    light = here([*argv[:-10], "--truth", "coin", "--against-truth", "lamp"], capsys)
    assert light.code == 2 and '--against-truth: "lamp" is a source of light, not a target' in light.stderr


CIRCLE = ["circle", "ring.png", "--at", "30", "31", "--radius", "20"]
BAD = [
    (["circle", "ring.png"], "--at: is missing"),
    (["circle", "ring.png", "--at", "30", "31"], "--radius: is missing"),
    (["circle", "ring.png", "--at", "30", "31", "--radius", "2 mm"], "--radius: needs a scale"),
    (["circle", "ring.png", "--at", "30", "31", "--radius", "two"], '--radius: "two" is neither pixels nor a length'),
    ([*CIRCLE, "--inner-radius", "21"], "--inner-radius: must be smaller"),
    ([*CIRCLE, "--mm-per-px", "much"], '--mm-per-px: "much" is not a scale'),
    ([*CIRCLE, "--mm-per-px", "-1"], "--mm-per-px"),
    ([*CIRCLE, "--gamma", "0.8"], "--gamma: needs the gray level without light"),
    ([*CIRCLE, "--truth", "washer"], "--truth: needs a scene"),
    ([*CIRCLE, "--arc", "0", "5"], "--arc"),
    ([*CIRCLE, "--band", "30"], "--band"),
    ([*CIRCLE, "--pixel-aspect", "0"], "--pixel-aspect"),
    (["circle", "ring.png", "--at", "5", "5", "--radius", "4"], "ring.png: shows no rim"),
    (["width", "ring.png", "--at", "5", "5"], "--length: is missing"),
    (["line", "ring.png", "--at", "5", "5", "--length", "9", "--band", "4"], "ring.png"),
    (["region", "ring.png", "--region", "0", "0", "90", "9"], "--region: 0 0 90 9 does not lie"),
    (["region", "ring.png", "--against", "0", "0", "90", "9"], "--against: 0 0 90 9 does not lie"),
    (["region", "ring.png", "bar.png"], "ring.png"),
    (["uniformity", "ring.png", "--cells", "0"], "--cells"),
    (["uniformity", "nothing.png"], "nothing.png"),
]


@pytest.mark.parametrize(("words", "message"), BAD)
def test_bad_input_is_one_line(
    pictures: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(pictures)
    done = here(["measure", *words], capsys)
    assert done.code == 2 and done.stdout == ""
    assert message in done.stderr and done.stderr.count("\n") == 1


# One pixel is a millimetre on a sheet at the world's origin, which is 7.4 px wide.
FACING = {
    "camera.sensor.rows": 60,
    "camera.sensor.columns": 80,
    "camera.sensor.pixel_width": "25 um",
    "camera.sensor.pixel_height": "25 um",
    "targets": [
        {"type": "sheet", "name": "ground", "material": "black", "size": ["120 mm", "120 mm"]},
        {
            "type": "sheet",
            "name": "bar",
            "material": "white",
            "size": ["7.4 mm", "40 mm"],
            "position": ["0 mm", "0 mm", "0.1 mm"],
        },
    ],
}
# A disc of 30 mm on black, tilted, seen through a pinhole that blurs it over some pixels.
TILTED = {
    "camera.sensor.rows": 60,
    "camera.sensor.columns": 72,
    "camera.sensor.pixel_width": "32 um",
    "camera.sensor.pixel_height": "36 um",
    "camera.aperture.diameter": "0.1 mm",
    "camera.exposure_time": "3000 ms",
    "camera.sensor.saturation_gray": 255,
    "sources.0.position": ["3 mm", "0 mm", "505 mm"],  # shadows lie behind what casts them
    "targets": [
        {"type": "sheet", "name": "ground", "material": "black", "size": ["120 mm", "120 mm"]},
        {
            "type": "disc",
            "name": "coin",
            "material": "white",
            "diameter": "30 mm",
            "position": ["3 mm", "-2 mm", "15 mm"],
            "rotation": ["25 deg", "-10 deg", "0 deg"],
        },
    ],
}


@pytest.mark.long
def test_a_prediction_is_measured_in_the_plane_of_its_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The disc's 30 mm within what noise and the certified error allow; response and pixels come from the scene."""
    scene = write_scene(tmp_path, TILTED)
    here(["render", scene, "--tolerance", 0.3, "--out", tmp_path / "out"], capsys).success()
    argv = ["measure", "circle", tmp_path / "out" / "gray.png", "--scene", scene, "--truth", "coin"]
    told = here([*argv, "--pose-sigma", "1 mm", "--json"], capsys).success().json
    outer = told["outer"]
    assert told["unit"] == "mm" and outer["true_diameter_mm"] == pytest.approx(30)
    assert told["gamma"] == 0.85 and told["dark"] == 22 and told["pixel_aspect"] == pytest.approx(36 / 32)
    assert abs(outer["diameter"] - 30) < 4 * outer["diameter_sigma"] + outer["diameter_rendering"] < 0.4
    assert outer["centre_mm"] == pytest.approx((0, 0), abs=0.05)
    assert 0 < told["certified_rms_gray"] < 0.5
    assert outer["diameter"] / outer["diameter_sigma_scale"] == pytest.approx(485, rel=0.02), "1 mm of about 485 mm"
    untouched = here([*argv, "--json"], capsys).success().json
    assert untouched["scale_source"] == "the scene's pose, taken as exact"
    flat = here([*argv, "--shape", "ellipse", "--json"], capsys).success().json["outer"]
    assert flat["major_axis"] > 1.03 * flat["minor_axis"] and "diameter" not in flat
    wide = here([*argv[:2], *argv[2:], "--plane", "ground", "--json"], capsys).success().json["outer"]
    assert wide["diameter"] > 30.5, "in a plane farther away it is taken for larger"
    for name, message in (("ground", "no round rim"), ("nobody", "no target")):
        done = here([*argv[:-1], name], capsys)
        assert done.code == 2 and message in done.stderr


def test_a_rectangle_by_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sides of 30 x 20 mm in their plane, which is turned and tilted."""
    card = {"type": "sheet", "name": "card", "material": "white", "size": ["30 mm", "20 mm"]}
    place = {"position": ["0 mm", "0 mm", "10 mm"], "rotation": ["10 deg", "5 deg", "20 deg"]}
    scene = write_scene(tmp_path, {**TILTED, "targets": [TILTED["targets"][0], {**card, **place}]})  # type: ignore[index]
    here(["render", scene, "--tolerance", 0.5, "--out", tmp_path / "out"], capsys).success()
    for axis, true in (("x", 30), ("y", 20)):
        argv = ["measure", "width", tmp_path / "out" / "gray.png", "--scene", scene, "--truth", "card"]
        told = here([*argv, "--across", axis, "--json"], capsys).success().json
        assert told["true_width_mm"] == pytest.approx(true)
        assert abs(told["width"] - true) < 4 * told["width_sigma"] + told["width_rendering"] < 0.4
