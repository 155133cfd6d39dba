"""Errors against a scene's own truth, on images whose dots and edge are moved by a known amount."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.response.sensor import gray_image
from radwrap.imaging.synthesis import RenderOptions
from radwrap.imaging.truth import geometry
from radwrap.measure.dots import METHODS
from radwrap.scene.file.load import load_scene
from radwrap.scene.scene import Scene
from radwrap.study.bias import BiasPoint, Study, dot_bias, edge_bias, scaled_gray, sweep, write_study

SCENES = Path(__file__).parents[2] / "rad_scenes"
SMALL = {
    "camera.sensor.rows": 40,
    "camera.sensor.columns": 48,
    "camera.sensor.pixel_width": "55 um",
    "camera.sensor.pixel_height": "64 um",
}


def board() -> Scene:
    return load_scene(SCENES / "bench_board" / "scene.toml")


def board_image(scene: Scene, shift: tuple[float, float]) -> GrayImage:
    """Soft discs where the dots project to, all moved alike."""
    sensor = scene.camera.sensor
    v, u = np.indices((sensor.rows, sensor.columns))
    light: NDArray[np.float64] = np.zeros(u.shape)
    name = next(iter(geometry(scene, ())["targets"]))
    for dot in geometry(scene, ())["targets"][name]["dots"]:
        radius = np.hypot(u - dot["u"] - shift[0], v - dot["v"] - shift[1])
        light += (1 - erf((radius - 5) / 0.8)) / 2
    return GrayImage(np.rint(20 + 200 * np.clip(light, 0, 1)))


@pytest.fixture(scope="module")
def edge() -> Scene:
    return load_scene(SCENES / "fig11_edge" / "scene.toml", SMALL)


def edge_image(scene: Scene, shift: float) -> GrayImage:
    """Eq. 9 of radius 2.5 px, averaged over pixels, moved along its normal."""
    sensor = scene.camera.sensor
    v, u = np.indices((sensor.rows, sensor.columns))
    line = next(iter(geometry(scene, ())["targets"].values()))["edge"]
    across = u * math.cos(line["angle"]) + v * math.sin(line["angle"]) - line["offset"] - shift
    fine = np.clip((across[..., None] + (np.arange(16) + 0.5) / 16 - 0.5) / 2.5, -1, 1)
    share = 1 - (np.arccos(fine) - fine * np.sqrt(1 - fine**2)) / math.pi
    return GrayImage(np.rint(20 + 160 * share.mean(axis=-1)))


@pytest.mark.long
@pytest.mark.parametrize("methods", [("gray", "conic"), pytest.param(METHODS, marks=pytest.mark.long)], ids=len)
def test_dots_that_are_moved_are_off_by_as_much(methods: tuple[str, ...]) -> None:
    """Round discs: the mean error is the shift for each method that does not take a dot's tilt into account."""
    scene = board()
    points = dot_bias(3.0, scene, board_image(scene, (0.4, -0.3)), methods)
    assert [point.method for point in points] == list(methods)
    for point in points:
        assert point.value == 3.0
        assert not point.failure
        if point.method != "conic":
            # Rows of dots run together here, which costs binary centres 0.02 px.
            assert (point.bias_u, point.bias_v) == pytest.approx((0.4, -0.3), abs=0.04)
            assert point.bias == pytest.approx(math.hypot(point.bias_u, point.bias_v), rel=1e-12)


def test_a_method_that_finds_nothing_says_why() -> None:
    scene = board()
    blank = GrayImage(np.full((scene.camera.sensor.rows, scene.camera.sensor.columns), 90.0))
    points = dot_bias(1.0, scene, blank, ("gray", "ellipse"))
    assert all(point.failure for point in points)
    assert [point.bias for point in points] == [0, 0]


def test_an_edge_that_is_moved_is_off_by_as_much(edge: Scene) -> None:
    (point,) = edge_bias(2.0, edge, edge_image(edge, 0.25), {"as it is": {"gamma": 1.0}})
    assert not point.failure
    # Rounding, the same in each row of an edge along the columns: 0.3 gray of 25 a pixel.
    assert point.bias_u == pytest.approx(0.25, abs=0.02)
    assert 0 < point.scatter < 0.02


def test_an_edge_that_is_not_there_says_why(edge: Scene) -> None:
    blank = GrayImage(np.full((40, 48), 90.0))
    (point,) = edge_bias(2.0, edge, blank, {"as it is": {}})
    assert point.failure


def test_exposure_scales_with_time() -> None:
    sensor = board().camera.sensor
    exposure = ExposureImage(np.full((sensor.rows, sensor.columns), 2e-4))
    double = ExposureImage(np.full((sensor.rows, sensor.columns), 4e-4))
    assert (scaled_gray(exposure, 2.0, sensor).values == gray_image(double, sensor).values).all()
    assert (scaled_gray(exposure, 2.0, sensor).values > gray_image(exposure, sensor).values).all()


@pytest.mark.long
def test_a_sweep_renders_each_value_in_order(edge: Scene) -> None:
    """Twice the exposure time, twice the exposure."""

    def measure(value: float, scene: Scene, exposure: ExposureImage) -> list[BiasPoint]:
        return [BiasPoint(value, f"{scene.camera.exposure_time:g}", bias_u=float(exposure.values.max()))]

    options = RenderOptions(viewpoints=1, workers=1)
    first, second = sweep(edge, "camera.exposure_time", [(1.0, "10 ms"), (2.0, "20 ms")], options, measure)
    assert (first.value, second.value, first.method, second.method) == (1.0, 2.0, "0.01", "0.02")
    assert second.bias_u == pytest.approx(2 * first.bias_u, rel=1e-6)
    assert first.bias_u > 0


def test_a_study_is_written_as_numbers_and_picture(tmp_path: Path) -> None:
    points = (BiasPoint(1.0, "a", 0.3, 0.4, 0.1), BiasPoint(2.0, "a", failure="none"), BiasPoint(1.0, "b", 1.0))
    numbers, picture = write_study(Study("try", "A try", "time [ms]", points), tmp_path)
    told = json.loads(numbers.read_text())
    assert (told["title"], told["axis"]) == ("A try", "time [ms]")
    assert [row["failure"] for row in told["points"]] == ["", "none", ""]
    assert told["points"][0]["bias_v"] == 0.4
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["try.json", "try.png"]


def test_an_edge_behind_the_camera_has_no_bias(edge: Scene) -> None:
    behind = load_scene(SCENES / "fig11_edge" / "scene.toml", {**SMALL, "camera.look_at": ["0 mm", "0 mm", "2000 mm"]})
    with pytest.raises(InputError, match="behind"):
        edge_bias(1.0, behind, edge_image(edge, 0.0), {"as it is": {}})
