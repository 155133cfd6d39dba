"""What follows of a rendered image without a ray: other exposures and sensors, electrons, noise, scales."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.images import read_image
from radwrap.imaging.rendered import Rendered
from radwrap.scene.file.load import load_scene
from tests.cli.conftest import SMALL, write_scene
from tests.study.test_gauge_responses import LINEAR, SCENE

SHORT, LONG = "100 ms", "900 ms"
POWER: dict[str, Any] = {"camera.exposure_time": "600 ms", "camera.sensor.saturation_gray": 255}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A linear camera's scene, rendered."""
    made = tmp_path_factory.mktemp("rendered")
    write_scene(made, {**SCENE, "camera.exposure_time": SHORT})
    return made


@pytest.fixture(scope="module")
def linear(folder: Path) -> Rendered:
    """Its image, some of whose files stay."""
    scene = load_scene(folder / "scene.toml")
    return radwrap.render(scene, folder / "out", tolerance=2, workers=1, frames=2)


def rendered(folder: Path, tolerance: float = 0.5, **changes: Any) -> Rendered:
    scene = load_scene(write_scene(folder, {**SMALL, **POWER}), changes)
    return radwrap.render(scene, tolerance=tolerance, workers=1)


@pytest.mark.parametrize(("gamma", "unit"), [pytest.param(0.85, "-0.85", marks=pytest.mark.long), (1.0, "-1")])
def test_another_exposure_is_a_fresh_render_within_both_certificates(tmp_path: Path, gamma: float, unit: str) -> None:
    sensor = {"camera.sensor.gamma": gamma, "camera.sensor.gain": f"3.38e4 (J/m^2)^{unit}"}
    first = rendered(tmp_path, **sensor)
    fresh = rendered(tmp_path, **sensor, **{"camera.exposure_time": LONG})
    start = time.thread_time()
    made = first.with_exposure(LONG)
    taken = time.thread_time() - start
    # Eq. 5 is homogeneous: all above dark, and all errors of it, grow by 1.5^gamma.
    growth = 1.5**gamma
    assert made.error.rms_gray_upper95 == pytest.approx(growth * first.error.rms_gray_upper95)
    assert made.radiant_exposure.values == pytest.approx(1.5 * first.radiant_exposure.values)
    off = made.gray.values - fresh.gray.values
    rounding = math.sqrt(2 / 12)
    assert np.sqrt(np.mean(off**2)) < made.error.rms_gray_upper95 + fresh.error.rms_gray_upper95 + rounding
    assert made.met == (made.error.rms_gray_upper95 <= 0.5)
    assert taken < 0.05  # s of processor time, as other tests run beside; the render takes half a second
    assert made.manifest["made_from"] == first.run.run_sha256 and made.scene.camera.exposure_time == 0.9
    # The way back is the image that was there.
    assert made.with_exposure(0.6).gray.values == pytest.approx(first.gray.values, abs=1)


@pytest.mark.long
def test_pixels_that_were_saturated_have_no_bound_below_saturation(tmp_path: Path) -> None:
    bright = rendered(tmp_path, **{"camera.exposure_time": "3000 ms"})
    assert 0 < bright.run.saturated_fraction < 1
    darker = bright.with_exposure(SHORT)
    assert darker.error.rms_gray_upper95 == math.inf and not darker.met
    assert darker.manifest["error"]["rms_gray_upper95"] is None and "no bound" in repr(darker)
    with pytest.raises(InputError, match="no bound"):
        _ = darker.sigma
    # What saturates sooner is bound: of an error above saturation nothing is left.
    brighter = bright.with_exposure("6000 ms")
    assert brighter.error.rms_gray_upper95 == pytest.approx(2**0.85 * bright.error.rms_gray_upper95)
    assert bright.with_sensor(saturation_gray=200).error.rms_gray_upper95 == pytest.approx(
        bright.error.rms_gray_upper95
    )
    assert bright.with_sensor(saturation_gray=254, bit_depth=8, dark_gray=30).error.rms_gray_upper95 < math.inf
    assert rendered(tmp_path).with_sensor(gamma=1.0, gain="3e4 (J/m^2)^-1").error.rms_gray_upper95 == math.inf


def test_other_electronics_give_the_levels_of_their_numbers(linear: Rendered) -> None:
    made = linear.with_sensor(system_gain="0.05 DN/e", offset=100, full_well="30 ke")
    electrons = made.electrons
    assert made.gray.values == pytest.approx(np.rint(100 + 0.05 * electrons), abs=0.501)
    assert electrons == pytest.approx(np.minimum(linear.electrons, 30e3), rel=1e-12)
    assert made.error.rms_gray_upper95 == pytest.approx(linear.error.rms_gray_upper95 / 2)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rows": 30}, "camera.sensor.rows: changes which light"),
        ({"pixel_width": "5 um"}, "camera.sensor.pixel_width: changes which light"),
        ({"fill_width": 0.5}, "camera.sensor.window: changes which light"),
        ({"scale": "1/2"}, "camera.sensor.rows: changes which light"),
        ({"ful_well": "1 ke"}, 'did you mean "full_well"?'),
        ({"offset": -1}, "offset"),
    ],
)
def test_what_needs_rays_is_refused(linear: Rendered, values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as told:
        linear.with_sensor(**values)
    assert message in str(told.value)


def test_numbers_of_the_image_are_those_of_closed_forms_and_files(linear: Rendered, folder: Path) -> None:
    sensor = linear.scene.camera.sensor
    gray = linear.electrons * 0.1 + LINEAR["offset"]
    assert linear.gray.values == pytest.approx(np.rint(gray), abs=0.501)
    assert linear.sigma == pytest.approx(read_image(folder / "out" / "gray_sigma.exr")[0], rel=1e-6)
    for number, frame in enumerate(linear.frames(2)):
        assert (frame.values == read_image(folder / "out" / f"frame_000{number}.png")[0]).all()
    assert not (linear.frames(1, seed=5)[0].values == linear.frames(1)[0].values).all()
    # The coin's plane is tilted about its middle: a pixel there is z p/v.
    camera = linear.scene.camera
    across, down = linear.mm_per_px("coin")
    depth = next(one["depth"] for one in radwrap.explain(linear.scene)["targets"] if one["name"] == "coin")
    assert across == pytest.approx(depth * sensor.pixel_width / camera.image_distance * 1e3, rel=0.01)
    assert down / across == pytest.approx(sensor.pixel_height / sensor.pixel_width)
    with pytest.raises(InputError, match="there are"):
        linear.mm_per_px("nobody")
    assert repr(linear).startswith("<Rendered: 72 x 60 pixels, gray") and "\n" not in repr(linear)


def test_options_are_spelled_out_and_checked(linear: Rendered) -> None:
    with pytest.raises(TypeError, match="metod"):
        radwrap.render(linear.scene, metod="rays")  # type: ignore[call-arg]
    for name, value in (("method", "viewpoint"), ("viewpoints", 7.5), ("seed", True), ("tolerance", "much")):
        with pytest.raises(InputError, match=name):
            radwrap.render(linear.scene, **{name: value})  # type: ignore[arg-type]
