"""A colour camera in a study: one colour of its raw image is measured, as software measures it."""

from __future__ import annotations

import json
import shutil
from copy import deepcopy
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.measure.edges import measure_edge
from radwrap.measure.mosaic import Colour, RawChannel, colour_image
from radwrap.study.design import read_design
from radwrap.study.image_error import blur_radii, error_fields
from radwrap.study.study import Study, StudyOptions, run_study
from radwrap.study.table import read_table
from radwrap.study.worker import seen_of
from tests.cli.conftest import scene_text
from tests.study.conftest import EDGE

SENSOR: Final[dict[str, Any]] = {
    "model": "linear",
    "rows": 30,
    "columns": 36,
    "pixel_width": "80 um",
    "pixel_height": "80 um",
    "bit_depth": 12,
    "wavelength": "550 nm",
    "mosaic": "GRBG",
    "filters": {name: {"quantum_efficiency": share} for name, share in (("red", 0.2), ("green", 0.5), ("blue", 0.1))},
    "system_gain": "0.001 DN/e",
    "offset": 100,
    "full_well": "4000 ke",
    "read_noise": "50 e",
}
DESIGN: Final = """
scene = "scene.toml"
analysis = "none"
[render]
{render}
[design]
kind = "list"
runs = [["10 ms"]]
[factors.t]
key = "camera.exposure_time"
levels = ["5 ms", "10 ms"]
[responses.u]
measure = "edge_position"
dark = 100
gamma = 1
[responses.mean]
measure = "mean_gray"
[responses.again]
measure = "mean_gray"
frames = 24
"""
PINHOLE: Final = 'method = "pinhole"'
pytestmark = pytest.mark.usefixtures("one_process")


def written(folder: Path, channel: Colour | None = None, render: str = PINHOLE, **sensor: Any) -> Path:
    document = deepcopy(EDGE)
    document["camera"] |= {"sensor": SENSOR | sensor, "exposure_time": "5 ms"}
    (folder / "scene.toml").write_text(scene_text(document))
    path = folder / "design.toml"
    named = "" if channel is None else f'channel = "{channel}"\n'
    path.write_text(named + DESIGN.format(render=render))
    return path


def carried_out(path: Path) -> Study:
    return run_study(read_design(path), path.parent / "out", StudyOptions(workers=1, tracer="radiance"))


@pytest.fixture(scope="module")
def red(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study of the red pixels."""
    return carried_out(written(tmp_path_factory.mktemp("red"), "red"))


def is_measured_in_the_raw_image(study: Study, colour: Colour) -> None:
    (row,) = study.rows
    scene = radwrap.load_scene(study.folder.parent / "scene.toml", {"camera.exposure_time": "10 ms"})
    raw = radwrap.render(scene, method="pinhole", seed=0, tracer="radiance").gray
    seen = colour_image(raw, "GRBG", colour)
    assert float(row["mean"]) == pytest.approx(seen.values.mean(), rel=1e-9)
    edge = measure_edge(seen, dark=100, gamma=1)
    assert float(row["u [px]"]) == pytest.approx(edge.offset, abs=1e-6)
    assert row["error"] == "" and float(row["mean_error"]) > 0 and float(row["again_repeatability"]) > 0
    told = json.loads((study.folder / "study.json").read_text())
    assert told["channel"] == {"pattern": "GRBG", "colour": colour}


def test_it_is_measured_as_in_the_raw_image_of_a_render(red: Study) -> None:
    """Without noise of rays the raw render has the same pixels, and so is what is measured."""
    is_measured_in_the_raw_image(red, "red")


@pytest.mark.long
def test_green_is_measured_where_no_colour_is_named(tmp_path: Path) -> None:
    is_measured_in_the_raw_image(carried_out(written(tmp_path)), "green")


def test_frames_are_raw_too(red: Study) -> None:
    """A quarter of the pixels is red, and the mean over all scatters as theirs does: twice as much as of all pixels."""
    changes = {"camera.sensor.mosaic": "red", "camera.exposure_time": "10 ms"}
    scene = radwrap.load_scene(red.folder.parent / "scene.toml", changes)
    image = radwrap.render(scene, method="pinhole", seed=0, tracer="radiance")
    pixels = scene.camera.sensor.pixels
    variances = image.electrons.mean() * 0.001**2 + (50 * 0.001) ** 2 + 1 / 12
    quarter = float(np.sqrt(variances / (pixels / 4)))
    found = float(red.rows[0]["again_repeatability"])
    # Of 24 frames: a chi-square with 23 degrees of freedom, from 1/1000 to 999/1000.
    assert 0.57 * quarter < found < 1.47 * quarter


@pytest.mark.long
def test_its_error_is_carried_through_the_interpolation(tmp_path: Path) -> None:
    path = written(tmp_path, "red", render="tolerance = 20.0")
    study = carried_out(path)
    for row in study.rows:
        assert row["error"] == "" and row["met"] == "1"
        assert 0 < float(row["u_error [px]"]) < 0.5 and 0 < float(row["mean_error"]) < 20


def test_copies_with_errors_are_raw_too(tmp_path: Path) -> None:
    written(tmp_path)
    scene = radwrap.load_scene(tmp_path / "scene.toml", {"camera.sensor.mosaic": "red"})
    out = tmp_path / "image"
    result = radwrap.render(scene, out, method="pinhole", seed=0, tracer="radiance")
    fields = error_fields((30, 36), blur_radii(scene))
    channel = RawChannel("GRBG", "red")
    raw = seen_of(scene, result, out, fields).as_raw(channel)
    own = np.zeros((30, 36), dtype=bool)
    own[0::2, 1::2] = True
    assert np.array_equal(raw.image.values[own], result.gray.values[own])
    for copy in raw.changed():
        assert np.array_equal(copy.image.values, colour_image(copy.image, "GRBG", "red").values)
        assert not np.array_equal(copy.image.values[own], raw.image.values[own])


def test_a_colour_of_a_monochrome_sensor_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "red", mosaic="green")
    with pytest.raises(InputError, match=r"design.toml: channel.*one filter"):
        read_design(path)


def test_a_mosaic_cannot_be_a_level(tmp_path: Path) -> None:
    path = written(tmp_path, "red")
    text = path.read_text().replace("camera.exposure_time", "camera.sensor.mosaic")
    path.write_text(text.replace('["5 ms", "10 ms"]', '["red", "green"]'))
    with pytest.raises(InputError, match=r"factors.t: varies the mosaic"):
        read_design(path)


def test_another_colour_is_another_study(red: Study, tmp_path: Path) -> None:
    assert len(read_table(red.folder / "results.csv").rows) == 1
    shutil.copytree(red.folder, tmp_path / "out")
    with pytest.raises(InputError, match="holds another study"):
        carried_out(written(tmp_path, "blue"))
