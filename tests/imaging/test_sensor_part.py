"""A region of the sensor, and its pixels joined: what is in sight of both stays where it was, as bright as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage, preview_codes, read_image
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.response.noise import fixed_pattern, linear_of, noisy_frame
from radwrap.imaging.synthesis import render
from radwrap.scene.camera import Camera
from radwrap.scene.file.load import load_scene
from radwrap.scene.look.geometry import project
from radwrap.scene.scene import Scene
from tests.cli.conftest import here, write_scene
from tests.study.test_gauge_responses import LINEAR, SCENE

Array = NDArray[np.float64]
# An odd number of rows and columns over: 2 rows and 1 column of 62 x 73 pixels.
SENSOR: dict[str, Any] = {
    **LINEAR,
    "rows": 62,
    "columns": 73,
    "dark_current": "40 e/s",
    "dsnu": "3 e",
    "prnu": 0.01,
    "defects": {"hot": 0.01},
}
CAMERA: dict[str, Any] = {
    **SCENE,
    "camera.exposure_time": "100 ms",
    "camera.principal_point": ["36.3 px", "31.2 px"],
    "camera.distortion": {"model": "opencv", "k1": -0.2, "p1": 0.01},
    "camera.sensor": SENSOR,
}
ROI = [10, 8, 49, 43]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A scene whose camera shows all that a part of its sensor must keep."""
    return write_scene(tmp_path, CAMERA)


def places(camera: Camera) -> Array:
    """Where the camera sees points all over its view."""
    x, y = np.meshgrid(np.linspace(-0.03, 0.03, 5), np.linspace(-0.02, 0.02, 4))
    return project(camera, np.column_stack([x.ravel(), y.ravel(), 0.002 * np.ones(x.size)]))[0]


def test_points_of_the_world_stay_where_they_were(path: Path) -> None:
    whole = load_scene(path).camera
    part = load_scene(path, {"camera.sensor.roi": ROI}).camera
    assert (part.sensor.rows, part.sensor.columns) == (36, 40)
    assert places(part) == pytest.approx(places(whole) - [10, 8], abs=1e-9)
    coarse = load_scene(path, {"camera.sensor.scale": "1/4"}).camera
    assert (coarse.sensor.rows, coarse.sensor.columns) == (15, 18)
    # Cropped by a row on each side, and by no column on the left; a larger pixel's middle is that of four.
    assert places(coarse) == pytest.approx((places(whole) - [0, 1] - 1.5) / 4, abs=1e-9)
    both = load_scene(path, {"camera.sensor.roi": ROI, "camera.sensor.scale": "1/3"}).camera
    assert (both.sensor.rows, both.sensor.columns) == (12, 13)
    assert places(both) == pytest.approx((places(whole) - [10, 8] - 1) / 3, abs=1e-9)


def test_the_sensor_is_that_of_joined_pixels(path: Path) -> None:
    whole, coarse = (load_scene(path, changes).camera.sensor for changes in ({}, {"camera.sensor.scale": "1/4"}))
    one, many = linear_of(whole), linear_of(coarse)
    assert coarse.pixel_area == pytest.approx(16 * whole.pixel_area)
    assert many.full_well == pytest.approx(16 * one.full_well)
    assert many.dark_signal == pytest.approx(16 * one.dark_signal) and one.dark_signal == pytest.approx(4)
    assert (many.read_noise, many.dsnu) == pytest.approx((4 * one.read_noise, 4 * one.dsnu))
    assert (many.prnu, many.system_gain) == pytest.approx((one.prnu / 4, one.system_gain / 16))
    for name in ("dark_gray", "saturation_gray", "gain", "bit_depth"):
        assert getattr(coarse, name) == pytest.approx(getattr(whole, name)), name


def test_what_is_left_out_is_said(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coarse = load_scene(path, {"camera.sensor.scale": "1/4"})
    assert coarse.assumed["camera.sensor.roi"] == "[0, 1, 71, 60]"
    assert coarse.assumed["camera.sensor.defects"] == "none, as pixels are scaled"
    done = here(["explain", path, "--scale", "1/4"], capsys)
    assert "read out is [0, 1, 71, 60] [px]" in done.stderr
    fits = load_scene(path, {"camera.sensor.scale": "1/2", "camera.sensor.roi": [0, 0, 71, 61]})
    assert "camera.sensor.roi" not in fits.assumed


def test_a_scale_that_is_none_is_the_options_fault(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = here(["explain", path, "--scale", "0.4"], capsys).refusal(2)
    assert '--scale: must be 1/N with a whole number N, such as 1/4, not "0.4"' in told


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"roi": [0, 0, 73, 10]}, "within 73 x 62 pixels"),
        ({"roi": [5, 0, 4, 10]}, "within 73 x 62 pixels"),
        ({"roi": [0, 0, 4]}, "roi"),
        ({"roi": [0, 0, -1, 4]}, "roi"),
        ({"scale": "1/63"}, "no whole pixel is left of 73 x 62"),
        ({"scale": "1/0"}, 'must be "1/N"'),
        ({"scale": "0.5"}, 'must be "1/N"'),
        ({"scale": 0.5}, 'must be "1/N"'),
    ],
)
def test_parts_that_there_are_not_are_refused(path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as told:
        load_scene(path, {f"camera.sensor.{key}": value for key, value in changes.items()})
    assert "camera.sensor" in str(told.value)


def rendered(path: Path, **changes: Any) -> tuple[Scene, Rendered]:
    scene = load_scene(path, {"camera.sensor.defects": {}, **changes})
    return scene, render(scene, None, RenderOptions(tolerance=1, seed=3, workers=1))


def means(values: Array, pixels: int) -> Array:
    rows, columns = (size // pixels for size in values.shape)
    found: Array = values[: rows * pixels, : columns * pixels].reshape(rows, pixels, columns, pixels).mean((1, 3))
    return found


@pytest.mark.long
def test_images_are_those_of_the_whole_sensor(path: Path) -> None:
    scene, whole = rendered(path)
    linear, sensor = linear_of(scene.camera.sensor), scene.camera.sensor
    # Within 1e-3 of the full well, which is 3.6 gray levels; both certify 1 rms.
    most = 1e-3 * linear.full_well / linear.electrons_of_exposure(sensor.pixel_area)
    exposure = whole.radiant_exposure.values
    _, part = rendered(path, **{"camera.sensor.roi": ROI})
    # Both certify a gray level rms.
    off = part.radiant_exposure.values - exposure[8:44, 10:50]
    assert np.sqrt(np.mean(off**2)) * sensor.gain < np.hypot(1, 1)
    coarse_scene, coarse = rendered(path, **{"camera.sensor.scale": "1/4"})
    binned = means(exposure[1:61], 4)
    assert np.abs(coarse.radiant_exposure.values - binned).max() < most
    # Noise of frames: of joined pixels, in gray levels, a quarter of one pixel's; rounding takes the same step.
    frames = {}
    for name, one, image in (("whole", scene, whole), ("coarse", coarse_scene, coarse)):
        sharp = replace(one.camera.sensor, rounding=False)
        pattern, light = fixed_pattern(sharp), ExposureImage(image.radiant_exposure.values)
        frames[name] = np.array([noisy_frame(light, sharp, pattern, 7, number).values for number in range(300)])
    joined = np.array([means(frame[1:61], 4) for frame in frames["whole"]])
    ratio = frames["coarse"].std(axis=0, ddof=1) / joined.std(axis=0, ddof=1)
    # Each of 270 ratios is known to sqrt(1/299): their mean to a quarter of a percent.
    assert float(np.mean(ratio)) == pytest.approx(1, abs=0.01)
    assert frames["coarse"].mean() == pytest.approx(joined.mean(), abs=0.2)


def test_a_part_is_made_again_from_its_manifest(path: Path, tmp_path: Path) -> None:
    options = RenderOptions(tolerance=8, workers=1)
    scene = load_scene(path, {"camera.sensor.scale": "1/4", "camera.sensor.roi": ROI})
    made = render(scene, tmp_path / "out", options)
    again = json.loads(made.manifest["scene"])
    assert again["camera"]["sensor"]["scale"] == "1/4" and again["camera"]["sensor"]["roi"] == ROI
    assert made.gray.values.shape == (9, 10)


def test_deep_pictures_have_a_preview_for_the_eye(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = RenderOptions(tolerance=8, workers=1)
    made = render(load_scene(path, {"camera.sensor.scale": "1/4"}), out, options)
    gray, shown = (read_image(out / name)[0] for name in ("gray.png", "preview.png"))
    assert gray.max() > 255 and shown.dtype == np.uint8 and "preview.png" in made.manifest["files"]
    assert shown == pytest.approx(gray * (255 / 4095), abs=0.501)
    assert made._repr_png_() == (out / "preview.png").read_bytes()
    # A run into the same folder that needs none takes it away.
    eight = load_scene(path, {"camera.sensor.scale": "1/4", "camera.sensor.bit_depth": 8})
    render(eight, out, options)
    assert not (out / "preview.png").exists()


def test_a_preview_has_a_fixed_scale() -> None:
    deep = GrayImage(np.array([[0.0, 2047.5, 4095.0]]), 12)
    assert preview_codes(deep).tolist() == [[0, 128, 255]]
    assert preview_codes(GrayImage(np.array([[0.0, 3.0]]), 2)).tolist() == [[0, 3]]
