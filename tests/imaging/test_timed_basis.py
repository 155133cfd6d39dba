"""Any levels of the sources of a scene that changes in time, without a ray: closed forms, and renders by themselves."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.images import read_image
from radwrap.scene.instants import held, lit_by
from tests.cli.conftest import files_in, here
from tests.imaging.test_in_time import COLUMNS, EXPOSURE, ROWS, bright_share, document, edge_places, rendered, velocity

STORED: Final = 3e-6  # float32 of a few sums
NEAR: Final = 2e-3  # of an even light, by the few rays of a coarse tolerance
TOLERANCE: Final = 1.0
GAIN: Final = 3e10


def flashed() -> dict[str, Any]:
    """Nothing moves; rows begin 10 us apart, and the left one of two sources shines from 72 to 75 us."""
    tables = document(edge_position="0 mm")  # between two pixels
    tables["camera"]["exposure_time"] = "50 us"
    tables["camera"]["sensor"] |= {"shutter": "rolling", "line_time": "10 us", "gain": f"{GAIN:g} (J/m^2)^-1"}
    tables["sources"][0]["strobe"] = {"delay": "72 us", "width": "3 us"}
    return tables


def light_of(tables: dict[str, Any], name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Radiant exposure in the steady light of one source, all rows at once [J m^-2]."""
    scene = lit_by(held(radwrap.scene_from_document(tables)), {name: 1.0})
    return radwrap.render(scene, method="pinhole", tracer="compiled").radiant_exposure.values


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rows")
    rendered(flashed(), TOLERANCE, out=folder, basis=True)
    return folder


def test_all_levels_at_one_are_the_render(rows: Path) -> None:
    image = radwrap.relight(rows)
    assert image.radiant_exposure.values == pytest.approx(read_image(rows / "radiant_exposure.exr")[0], rel=STORED)
    run = json.loads((rows / "manifest.json").read_text())
    assert image.certificate.rms_gray_upper95 == pytest.approx(run["error"]["rms_gray_upper95"], rel=1e-6)
    assert run["in_time"]["instants"] == 1 and not (rows / ".instants").exists()


def open_rows(line: float, exposure: float, pulse: tuple[float, float] = (72.0, 75.0)) -> Any:
    """Share of each row's exposure in which a pulse shines; times in us."""
    start = np.arange(ROWS) * line
    inside = np.minimum(start + exposure, pulse[1]) - np.maximum(start, pulse[0])
    return np.clip(inside, 0.0, None)[:, np.newaxis] / exposure


@pytest.mark.parametrize(
    ("changes", "line", "exposure"),
    [
        ({}, 10.0, 50.0),
        ({"camera.exposure_time": "35 us"}, 10.0, 35.0),
        ({"camera.sensor.line_time": "14 us"}, 14.0, 50.0),
        ({"camera.exposure_time": "24.5 us", "camera.sensor.line_time": "8.5 us"}, 8.5, 24.5),
    ],
)
def test_levels_and_times_of_rows_are_a_closed_form(
    changes: dict[str, str], line: float, exposure: float, rows: Path
) -> None:
    """Two sources of their own levels, rows and exposures of their own times: no ray, and no more error than told."""
    tables = flashed()
    image = radwrap.relight(rows, {"left": 3.0, "right": 0.25}, changes)
    left, right = (light_of(tables, name) * exposure / 50.0 for name in ("left", "right"))
    expected = 3.0 * open_rows(line, exposure) * left + 0.25 * right
    off = (image.radiant_exposure.values - expected) * GAIN
    assert np.abs(image.radiant_exposure.values / expected - 1).max() < NEAR
    assert math.sqrt(float(np.mean(off**2))) <= image.certificate.rms_gray_upper95 < 2 * TOLERANCE
    assert open_rows(line, exposure).any() and not open_rows(line, exposure).all()


def test_a_pulse_in_every_row_is_no_steady_light(tmp_path: Path) -> None:
    """A global shutter: twice the exposure time gathers no more of the pulse, and twice as much of the other source."""
    tables = flashed()
    for key in ("shutter", "line_time"):
        del tables["camera"]["sensor"][key]
    tables["sources"][0]["strobe"] = {"delay": "2 us", "width": "20 us"}
    rendered(tables, TOLERANCE, out=tmp_path, basis=True)
    image = radwrap.relight(tmp_path, {}, {"camera.exposure_time": "100 us"})
    left, right = (light_of(tables, name) for name in ("left", "right"))
    assert image.radiant_exposure.values == pytest.approx(0.4 * left + 2 * right, rel=NEAR)


def test_light_that_the_basis_lacks_is_an_error(tmp_path: Path) -> None:
    tables = flashed()
    tables["sources"][0]["strobe"] = {"delay": "200 us", "width": "3 us"}
    rendered(tables, TOLERANCE, out=tmp_path, basis=True)
    assert radwrap.relight(tmp_path, {"right": 0.5}).certificate.rms_gray > 0
    with pytest.raises(InputError, match=r'camera.exposure_time: lets "left" shine .* render that camera'):
        radwrap.relight(tmp_path, {}, {"camera.exposure_time": "150 us"})
    with pytest.raises(InputError, match='"left" is dark in the scene'):
        radwrap.relight(tmp_path, {"left": 2.0})


def test_the_command_and_an_older_basis(rows: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = here(["relight", rows, "--level", "left=2", "--out", tmp_path / "lit", "--json"], capsys).success().json
    assert told["images"]["gray"]["levels"] == {"left": 2.0, "right": 1.0}
    assert told["images"]["gray"]["error"]["rms_gray_upper95"] > 0 and (tmp_path / "lit" / "gray.png").is_file()
    rendered(flashed(), TOLERANCE, out=tmp_path / "twice", basis=True)
    rendered(flashed(), TOLERANCE, out=tmp_path / "twice")
    assert not [name for name in files_in(tmp_path / "twice") if "basis" in name or "instants" in name]
    with pytest.raises(InputError, match="holds no light basis"):
        radwrap.relight(tmp_path / "twice")


def test_what_was_edited_is_refused(tmp_path: Path) -> None:
    rendered(flashed(), TOLERANCE, out=tmp_path, basis=True)
    path = tmp_path / "basis_in_time.json"
    told = json.loads(path.read_text())
    told["rows"]["largest"]["left"] *= 2
    path.write_text(json.dumps(told))
    with pytest.raises(InputError, match="is not as it was made"):
        radwrap.relight(tmp_path)


COLOURS: Final = {"red": 0.1, "green": 0.5, "blue": 0.05}


def test_rows_of_a_colour_camera(tmp_path: Path) -> None:
    """Each colour is its share of the light, whatever the levels."""
    tables = flashed()
    sensor = tables["camera"]["sensor"]
    tables["camera"]["sensor"] = {
        **{key: sensor[key] for key in ("rows", "columns", "pixel_width", "pixel_height", "shutter", "line_time")},
        "model": "linear",
        "wavelength": "550 nm",
        "system_gain": "0.1 DN/e",
        "offset": 4,
        "full_well": "12 ke",
        "read_noise": "8 e",
        "mosaic": "RGGB",
        "filters": {name: {"quantum_efficiency": x} for name, x in COLOURS.items()},
    }
    for source in tables["sources"]:
        source["radiant_intensity"] = "5e5 W/sr"
    rendered(tables, 0.3, out=tmp_path, basis=True)
    image = radwrap.relight(tmp_path, {"left": 2.0, "right": 0.5}, {"camera.exposure_time": "45 us"})
    plane = json.loads(json.dumps(tables))
    plane["camera"]["sensor"]["mosaic"] = "green"
    left, right = (light_of(plane, name) * 45 / 50 for name in ("left", "right"))
    green = 2.0 * open_rows(10.0, 45.0) * left + 0.5 * right
    found = image.radiant_exposure.values
    assert found[::2, 1::2] == pytest.approx(green[::2, 1::2], rel=NEAR)
    assert found[::2, ::2] == pytest.approx(0.2 * green[::2, ::2], rel=NEAR)
    assert found[1::2, 1::2] == pytest.approx(0.1 * green[1::2, 1::2], rel=NEAR)


def test_a_basis_of_what_moves_needs_one_colour(tmp_path: Path) -> None:
    tables = document(velocity=velocity(0.6))
    tables["camera"]["sensor"] = {
        **{key: tables["camera"]["sensor"][key] for key in ("rows", "columns", "pixel_width", "pixel_height")},
        **{"model": "linear", "wavelength": "550 nm", "system_gain": "0.1 DN/e", "full_well": "12 ke"},
        **{"offset": 4, "read_noise": "8 e"},
        "mosaic": "RGGB",
        "filters": {name: {"quantum_efficiency": x} for name, x in COLOURS.items()},
    }
    with pytest.raises(InputError, match="basis: is of one colour where something moves"):
        radwrap.render(radwrap.scene_from_document(tables), tmp_path, basis=True)


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("moving")
    rendered(moving_tables(), 2.0, out=folder, basis=True)
    return folder


def moving_tables() -> dict[str, Any]:
    """An edge, frozen by a flash from one side, smeared by light from the other one."""
    tables = document(velocity=velocity(0.6))
    tables["sources"][0]["strobe"] = {"delay": "8 ms", "width": "1 ms"}
    return tables


@pytest.mark.long
def test_what_moves_is_relit_at_every_instant(moving: Path) -> None:
    stored = read_image(moving / "radiant_exposure.exr")[0]
    image = radwrap.relight(moving)
    assert image.radiant_exposure.values == pytest.approx(stored, rel=STORED)
    run = json.loads((moving / "manifest.json").read_text())
    assert image.certificate.motion_gray == pytest.approx(run["error"]["motion_gray"], rel=1e-3, abs=1e-4)
    # A basis keeps other numbers for its certificate than a render.
    assert image.certificate.rms_gray_upper95 == pytest.approx(run["error"]["rms_gray_upper95"], rel=0.3)
    parts = [radwrap.relight(moving, {dark: 0.0}).radiant_exposure.values for dark in ("left", "right")]
    assert sum(parts) == pytest.approx(stored, rel=STORED)


@pytest.mark.long
def test_other_levels_of_what_moves_are_closed_forms(moving: Path) -> None:
    """By the flash alone, twenty times as bright, the edge stands where it is in the middle of the pulse."""
    image = radwrap.relight(moving, {"left": 20.0, "right": 0.0})
    tables = moving_tables()
    del tables["sources"][1]
    share = bright_share(tables, image.radiant_exposure.values / 20.0 * EXPOSURE / 1e-3)
    middle = (COLUMNS - 1) / 2 + 0.07e-3 / (10e-6 / 25e-3 * 0.5) + 0.6 * (8.5e-3 - EXPOSURE / 2) / EXPOSURE
    # Rows scatter by the flash's part of the tolerance, which grew twenty times.
    assert abs(edge_places(share).mean() - middle) < 0.02
    fresh = moving_tables()
    fresh["sources"][0]["radiant_intensity"], fresh["sources"][1]["radiant_intensity"] = "1e5 W/sr", "0 W/sr"
    made = rendered(fresh, 4.0)
    off = (image.radiant_exposure.values - made.radiant_exposure.values) * 8e7
    bound = math.hypot(image.certificate.rms_gray_upper95, made.error.rms_gray_upper95)
    assert math.sqrt(float(np.mean(off**2))) < bound


@pytest.mark.long
def test_another_sensor_sees_what_moves_and_another_time_needs_rays(moving: Path) -> None:
    image = radwrap.relight(moving, {}, {"camera.sensor.gain": "4e7 (J/m^2)^-1"})
    whole = radwrap.relight(moving)
    assert image.gray.values == pytest.approx(whole.gray.values / 2, rel=1e-6)
    assert image.certificate.rms_gray_upper95 == pytest.approx(whole.certificate.rms_gray_upper95 / 2, rel=1e-6)
    with pytest.raises(InputError, match=r"camera.exposure_time: changes which instants count.*render that camera"):
        radwrap.relight(moving, {}, {"camera.exposure_time": "9 ms"})
    shutter = {"camera.sensor.shutter": "rolling", "camera.sensor.line_time": "1 ms"}
    with pytest.raises(InputError, match=r"camera.sensor.shutter: changes which instants count"):
        radwrap.relight(moving, {}, shutter)


@pytest.mark.long
def test_rows_of_other_light_than_the_basis_was_held_against_keep_the_tolerance() -> None:
    """In the light of the whole flash most pixels are saturated, and nothing is known of those that it misses."""
    changes = {"rows": 16, "columns": 20, "line_time": "60 us"}
    belt = Path(__file__).parents[2] / "rad_scenes" / "moving_belt" / "scene.toml"
    tables = json.loads(radwrap.load_scene(belt).document)
    for target in tables["targets"]:
        target.pop("velocity", None)
        target.pop("angular_velocity", None)
    tables["camera"] |= {"exposure_time": "1.2 ms", "sensor": tables["camera"]["sensor"] | changes}
    tables["sources"][0]["radiant_intensity"] = "0.3 W/sr"
    made = radwrap.render(radwrap.scene_from_document(tables, folder=belt.parent), tolerance=2.0)
    assert made.met and made.run.tolerance == 2.0
    assert made.error.rms_gray_upper95 is not None and made.error.rms_gray_upper95 < 2.0
