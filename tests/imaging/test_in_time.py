"""Motion, strobes and shutters against closed forms, and against renders of single instants."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.response.linear_light import allowed_exposure_error, gray_bound
from radwrap.imaging.time_steps import lights_of, places
from radwrap.scene.instants import at_time, lit_by, pose_time
from radwrap.scene.look.checks import checked_at_time
from radwrap.scene.look.image_speed import image_speeds

Array = NDArray[np.float64]
ROWS, COLUMNS = 10, 40
EXPOSURE = 10e-3  # s
PITCH = 10e-6 / 25e-3 * 0.5  # m on the target for a pixel
EDGE = 0.07e-3  # m
# Of an edge's contrast, as issue L asks.
RAMP = 1e-3


def document(**target: Any) -> dict[str, Any]:
    """An edge in even light, seen through an infinitesimal pinhole; 197 gray levels of contrast."""
    return {
        "camera": {
            "position": ["0 mm", "0 mm", "500 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "up": [0, 1, 0],
            "focal_length": "25 mm",
            "exposure_time": f"{EXPOSURE!r} s",
            "diffraction": "off",
            "aperture": {"diameter": "0 mm", "exposure_diameter": "1 mm"},
            "sensor": {
                "rows": ROWS,
                "columns": COLUMNS,
                "pixel_width": "10 um",
                "pixel_height": "10 um",
                "gain": "8e7 (J/m^2)^-1",
                "gamma": 1.0,
                "dark_gray": 0.0,
                "saturation_gray": 255.0,
                "rounding": False,
            },
        },
        "sources": [
            {
                "type": "lamp",
                "name": name,
                "position": [f"{x} m", "0 m", "100 m"],
                "look_at": ["0 mm", "0 mm", "0 mm"],
                "diameter": "10 mm",
                "radiant_intensity": "5e3 W/sr",
                "beam": {"profile": "lambertian"},
            }
            for name, x in (("left", -30), ("right", 30))
        ],
        "materials": {
            "white": {"type": "lambertian", "reflectance": 0.8},
            "black": {"type": "lambertian", "reflectance": 0.1},
        },
        "targets": [
            {
                "type": "edge",
                "name": "edge",
                "material": "black",
                "edge_material": "white",
                "size": ["100 mm", "60 mm"],
                "edge_position": f"{EDGE!r} m",
                **target,
            }
        ],
    }


def velocity(pixels: float, time: float = EXPOSURE) -> list[str]:
    """To the right by some pixels in a time."""
    return [f"{pixels * PITCH / time!r} m/s", "0 m/s", "0 m/s"]


def still(tables: dict[str, Any], **target: Any) -> Array:
    """Radiant exposure without any motion, shutter and strobe [J m^-2]."""
    plain = copy.deepcopy(tables)
    for table in (*plain["targets"], *plain["sources"]):
        for key in ("velocity", "angular_velocity", "strobe"):
            table.pop(key, None)
    for key in ("shutter", "line_time", "readout"):
        plain["camera"]["sensor"].pop(key, None)
    plain["targets"][0].update(target)
    return radwrap.render(
        radwrap.scene_from_document(plain), method="pinhole", tracer="compiled"
    ).radiant_exposure.values


def bright_share(tables: dict[str, Any], exposure: Array) -> Array:
    """Share of the exposure that each pixel sees the bright side, shape (rows, columns)."""
    white, black = still(tables, material="white"), still(tables, edge_material="black")
    share: Array = (exposure - black) / (white - black)
    return share


def rendered(tables: dict[str, Any], tolerance: float, **how: Any) -> radwrap.Rendered:
    scene = radwrap.scene_from_document(tables)
    return radwrap.render(scene, tolerance=tolerance, seed=1, tracer="compiled", **how)


def ramp(u: Array, edge: float, smear: float) -> Array:
    """Share of bright in pixels of an edge that moves evenly over `smear` about `edge`: a box on a box."""

    def twice(z: Array) -> Array:
        return np.maximum(z, 0.0) ** 2 / 2

    a, b = (1 + smear) / 2, (1 - smear) / 2
    z = u - edge
    share: Array = (twice(z + a) - twice(z + b) - twice(z - b) + twice(z - a)) / smear
    return share


def edge_places(share: Array) -> Array:
    """Where the edge is in each row [px]."""
    places: Array = COLUMNS - 0.5 - share.sum(axis=1)
    return places


MIDDLE = (COLUMNS - 1) / 2 + EDGE / PITCH


@pytest.mark.long
def test_an_edge_that_moves_is_a_ramp() -> None:
    smear = 2.3
    tables = document(velocity=velocity(smear))
    made = rendered(tables, 0.2)
    share = bright_share(tables, made.radiant_exposure.values).mean(axis=0)
    assert np.abs(share - ramp(np.arange(COLUMNS), MIDDLE, smear)).max() < RAMP
    assert made.met and made.run.in_time is not None and made.run.in_time.instants > 8
    assert made.error.motion_gray is not None and 0 < made.error.motion_gray < made.error.rms_gray_upper95
    assert "scene_sha256" in made.manifest and made.manifest["camera"]["exposure_time"] == EXPOSURE


@pytest.mark.long
def test_below_a_pixel_few_instants_are_exact() -> None:
    tables = document(velocity=velocity(0.6))
    made = rendered(tables, 0.3)
    share = bright_share(tables, made.radiant_exposure.values).mean(axis=0)
    assert made.run.in_time is not None and made.run.in_time.instants == 9
    assert np.abs(share - ramp(np.arange(COLUMNS), MIDDLE, 0.6)).max() < RAMP


@pytest.mark.long
def test_a_flash_freezes_what_moves_where_it_is_then() -> None:
    tables = document(velocity=velocity(8.0))
    for source in tables["sources"]:
        source["strobe"] = {"delay": "2 ms", "width": "1 ms"}
    made = rendered(tables, 0.1)
    share = bright_share(tables, made.radiant_exposure.values * EXPOSURE / 1e-3).mean(axis=0)
    then = MIDDLE + 8.0 * (2.5e-3 - EXPOSURE / 2) / EXPOSURE
    # A tenth of the light: so is the tolerance, and its share of the contrast is ten times as large.
    assert np.abs(share - ramp(np.arange(COLUMNS), then, 0.8)).max() < 10 * RAMP


@pytest.mark.long
@pytest.mark.parametrize(("readout", "smear"), [("down", 0.4), ("down", 1.2), ("up", 1.2)])
def test_a_rolling_shutter_slants_an_edge_by_speed_times_line_time(readout: str, smear: float) -> None:
    tables = document(velocity=velocity(smear))
    tables["camera"]["sensor"] |= {"shutter": "rolling", "line_time": "4 ms", "readout": readout}
    made = rendered(tables, 0.8)
    edges = edge_places(bright_share(tables, made.radiant_exposure.values))
    order = np.arange(ROWS) if readout == "down" else np.arange(ROWS)[::-1]
    slant = smear * 4e-3 / EXPOSURE
    assert np.abs(edges - (MIDDLE + slant * order)).max() < 0.01
    slope = np.polyfit(order, edges, 1)[0]
    assert slope == pytest.approx(slant, rel=1e-2)


@pytest.mark.long
def test_a_wheel_is_the_mean_of_64_renders_in_time() -> None:
    tables = document(angular_velocity=["0 rpm", "0 rpm", "300 rpm"], rotation=["0 deg", "0 deg", "20 deg"])
    made = rendered(tables, 0.5)
    scene = radwrap.scene_from_document(tables)
    total = np.zeros((ROWS, COLUMNS))
    for k in range(64):
        then = at_time(scene, (k + 0.5) / 64 * EXPOSURE)
        total += radwrap.render(then, method="pinhole", pixel_samples=8, tracer="compiled").radiant_exposure.values / 64
    off = (made.radiant_exposure.values - total) * 8e7
    assert math.sqrt(float(np.mean(off**2))) < made.error.rms_gray_upper95
    # It turns by 18 degrees: at the rim of the picture an edge goes by 6 pixels.
    assert made.run.in_time is not None and made.run.in_time.about_rms_gray > 5 * made.error.rms_gray_upper95


def test_rows_count_their_own_share_of_each_source() -> None:
    """Lines of 10 us, exposures of 50 us, a pulse of 3 us of one source and steady light of another: no ray more."""
    tables = document(edge_position="0 mm")  # between two pixels
    tables["camera"]["exposure_time"] = "50 us"
    tables["camera"]["sensor"] |= {"shutter": "rolling", "line_time": "10 us", "gain": "3e10 (J/m^2)^-1"}
    tables["sources"][0]["strobe"] = {"delay": "72 us", "width": "3 us"}
    made = rendered(tables, 0.3)
    scene = radwrap.scene_from_document(tables)
    left, right = (
        radwrap.render(lit_by(at_time(scene, 0.0), {name: 1.0}), method="pinhole", tracer="compiled")
        for name in ("left", "right")
    )
    pulse = np.zeros(ROWS)
    pulse[3:8] = 3 / 50  # open from 10 r to 10 r + 50 us, the pulse from 72 to 75 us
    expected = pulse[:, np.newaxis] * left.radiant_exposure.values + right.radiant_exposure.values
    off = (made.radiant_exposure.values - expected) * 3e10
    assert math.sqrt(float(np.mean(off**2))) < made.error.rms_gray_upper95
    assert made.met and made.run.in_time is not None and made.run.in_time.instants == 1
    assert made.error.motion_gray is None


def test_a_global_reset_brightens_row_by_row() -> None:
    tables = document()
    tables["camera"]["sensor"] |= {"shutter": "global_reset", "line_time": "0.2 ms", "gain": "6e7 (J/m^2)^-1"}
    made = rendered(tables, 0.3)
    ratio = made.radiant_exposure.values[:, -6:] / still(tables)[:, -6:]
    assert ratio.mean(axis=1) == pytest.approx(1 + 0.02 * np.arange(ROWS), rel=2e-3)


def test_a_flash_on_what_stands_still_is_light_of_a_lower_level() -> None:
    tables, dimmed = document(), document()
    for source in tables["sources"]:
        source["strobe"] = {"delay": "-1 ms", "width": "6 ms"}
    for source in dimmed["sources"]:
        source["radiant_intensity"] = "2.5e3 W/sr"
    made, known = rendered(tables, 0.5), rendered(dimmed, 0.5)
    assert made.radiant_exposure.values == pytest.approx(known.radiant_exposure.values, rel=1e-6)
    assert made.error.rms_gray_upper95 == pytest.approx(known.error.rms_gray_upper95)


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes_with_any_number_of_workers(tmp_path: Path) -> None:
    tables = document(velocity=velocity(0.6))
    for workers in (1, 2):
        rendered(tables, 2.0, out=tmp_path / str(workers), workers=workers, truth=True)
    first, second = ((tmp_path / name) for name in "12")
    for name in ("gray.png", "radiant_exposure.exr", "truth.json", "depth.exr"):
        assert (first / name).read_bytes() == (second / name).read_bytes()
    assert {path.name for path in first.iterdir()} >= {"manifest.json", "mask.png"}
    assert not (first / ".instants").exists()


@pytest.mark.parametrize("moves", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_finished_folder_is_not_rendered_again(moves: bool, tmp_path: Path) -> None:
    """Until an option, a file, or the scene's time is another."""
    tables = document(velocity=velocity(0.6)) if moves else document()
    tables["camera"]["sensor"] |= {"shutter": "rolling", "line_time": "30 us"}
    tables["sources"][0]["strobe"] = {"delay": "0.1 ms", "width": "1 ms"}

    def stamp(tolerance: float = 6.0) -> tuple[int, ...]:
        made = rendered(tables, tolerance, out=tmp_path)
        assert made.met and made.run.in_time is not None
        return tuple((tmp_path / name).stat().st_mtime_ns for name in ("manifest.json", "gray.png"))

    first = stamp()
    assert stamp() == first and not (tmp_path / ".instants").exists()
    tables["sources"][0]["strobe"]["delay"] = "0.12 ms"
    second = stamp()
    assert second[0] > first[0] and stamp() == second
    third = stamp(5.0)
    assert third[0] > second[0]
    (tmp_path / "gray.png").write_bytes(b"broken")
    assert stamp(5.0)[0] > third[0]


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"method": "viewpoints"}, "method"),
        ({"max_error": 3.0}, "max_error"),
        ({"budget_rays": 1e6}, "budget_rays"),
    ],
)
def test_options_of_one_instant_are_refused_by_name(how: dict[str, Any], told: str, tmp_path: Path) -> None:
    scene = radwrap.scene_from_document(document(velocity=velocity(0.6)))
    with pytest.raises(InputError, match=rf"^{told}: knows one instant only, and targets\[0\].velocity"):
        radwrap.render(scene, tmp_path, **how)


@pytest.mark.long
def test_each_colour_of_a_mosaic_is_rendered_in_time() -> None:
    tables = document(velocity=velocity(0.6))
    tables["camera"]["sensor"] = {
        **{key: tables["camera"]["sensor"][key] for key in ("rows", "columns", "pixel_width", "pixel_height")},
        "model": "linear",
        "wavelength": "550 nm",
        "system_gain": "0.1 DN/e",
        "offset": 4,
        "full_well": "12 ke",
        "read_noise": "8 e",
        "mosaic": "RGGB",
        "filters": {name: {"quantum_efficiency": x} for name, x in (("red", 0.1), ("green", 0.5), ("blue", 0.05))},
    }
    scene = radwrap.scene_from_document(tables)
    raw = radwrap.render(scene, tolerance=2, seed=1, tracer="compiled")
    green = radwrap.render(
        radwrap.with_value(scene, "camera.sensor.mosaic", "green"), tolerance=2, seed=1, tracer="compiled"
    )
    seen, whole = raw.radiant_exposure.values, green.radiant_exposure.values
    assert seen[0, 1::2] == pytest.approx(whole[0, 1::2], rel=1e-6)
    assert seen[0, ::2] == pytest.approx(0.2 * whole[0, ::2], rel=1e-6)
    assert raw.error.motion_gray is not None and raw.run.in_time is not None


def test_light_that_misses_the_exposure_is_an_error() -> None:
    tables = document(velocity=velocity(0.6))
    for source in tables["sources"]:
        source["strobe"] = {"delay": "20 ms", "width": "1 ms"}
    with pytest.raises(InputError, match=r"sources\[0\].strobe: no pulse meets the exposure.*0 to 10 ms"):
        rendered(tables, 1.0)
    del tables["targets"][0]["velocity"]
    with pytest.raises(InputError, match="no pulse meets the exposure"):
        rendered(tables, 1.0)


def test_a_dark_source_beside_a_pulsed_one_is_nothing() -> None:
    """It has times of its own, at which there is no light at all."""
    tables = document(velocity=velocity(0.6))
    tables["sources"][0]["strobe"] = {"delay": "2 ms", "width": "1 ms"}
    tables["sources"][1]["radiant_intensity"] = "0 W/sr"
    lights = lights_of(radwrap.scene_from_document(tables))
    assert [light.sources for light in lights] == [("left",)]
    tables["sources"][0]["radiant_intensity"] = "0 W/sr"
    with pytest.raises(InputError, match="there is no light"):
        rendered(tables, 1.0)


def wide_sources(*shares: float) -> list[dict[str, Any]]:
    """Two lights in front, each with a share of its radiance."""
    rectangle = {"type": "rectangle", "look_at": ["0 mm", "0 mm", "0 mm"], "size": ["200 mm", "100 mm"]}
    places = (("left", -300.0, 20.0), ("right", 300.0, 30.0))
    return [
        {**rectangle, "name": name, "position": [f"{x} mm", "0 mm", "300 mm"], "radiance": f"{share * level} W/m^2/sr"}
        for (name, x, level), share in zip(places, shares, strict=True)
    ]


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_pulses_of_wide_lights_shine_one_by_one(speed: float) -> None:
    """A dark wide light shone from its outline's patches with all of its radiance."""
    tables = document(edge_material="black", velocity=velocity(speed))
    tables["sources"] = wide_sources(0.2, 0.3)
    due = still(tables).mean()
    tables["sources"] = wide_sources(1.0, 1.0)
    for source, delay, width in zip(tables["sources"], (1.0, 4.0), (2.0, 3.0), strict=True):
        source["strobe"] = {"delay": f"{delay} ms", "width": f"{width} ms"}
    assert rendered(tables, 0.5).radiant_exposure.values.mean() == pytest.approx(due, rel=5e-3)


def test_a_dark_wide_light_is_dark_in_its_patches_too() -> None:
    tables = document()
    tables["sources"] = wide_sources(1.0, 1.0)
    scene = radwrap.scene_from_document(tables)
    assert sum(one.radiance > 0 for one in lit_by(scene, {"left": 1.0}).emitters) == len(scene.emitters) / 2
    sky = {"type": "surround", "name": "sky", "radiance": "8 W/m^2/sr"}
    dimmed = lit_by(radwrap.scene_from_document(tables | {"sources": [sky]}), {"sky": 0.25})
    assert {one.radiance for one in dimmed.emitters} == {2.0}


def test_what_moves_too_far_is_an_error() -> None:
    with pytest.raises(InputError, match=r"targets\[0\].velocity.*moves it over .* pixels"):
        rendered(document(velocity=velocity(2000.0)), 1.0)


def test_what_meets_the_camera_on_its_way_is_an_error() -> None:
    """A box behind the camera that comes down on it by 4 mm until the light comes, from 3 mm."""
    tables = document()
    box = {"type": "box", "name": "arm", "material": "black", "size": ["100 mm", "100 mm", "100 mm"]}
    box |= {"position": ["0 mm", "0 mm", "553 mm"], "velocity": ["0 m/s", "0 m/s", "-1 m/s"]}
    tables["targets"].append(box)
    for source in tables["sources"]:
        source["strobe"] = {"delay": "9 ms", "width": "1 ms"}
    told = r'camera.position: 4(\.\d+)? ms after the poses of the file hold, .* inside the target "arm"; move'
    with pytest.raises(InputError, match=told):
        rendered(tables, 20.0)


def test_what_meets_another_surface_on_its_way_is_an_error() -> None:
    """A sheet that sinks into the plane of the edge at 1 m/s; at one instant they would be in one place."""
    tables = document()
    sheet = {"type": "sheet", "name": "label", "material": "white", "size": ["9 mm", "9 mm"]}
    tables["targets"].append(sheet | {"position": ["0 mm", "0 mm", "4 mm"], "velocity": ["0 m/s", "0 m/s", "1 m/s"]})
    scene = radwrap.scene_from_document(tables)
    with pytest.raises(InputError, match=r'targets\[1\]: 4 ms before .* "edge" and "label" overlap in one plane'):
        checked_at_time(scene, pose_time(scene) - 4e-3)


@pytest.mark.long
def test_another_exposure_time_needs_a_render() -> None:
    made = rendered(document(velocity=velocity(0.6)), 2.0)
    with pytest.raises(InputError, match="velocity"):
        made.with_exposure("5 ms")


def test_the_speed_over_the_sensor() -> None:
    scene = radwrap.scene_from_document(document(velocity=velocity(5.0)))
    assert image_speeds(scene) == pytest.approx({"edge": 5.0 / EXPOSURE})
    turns = radwrap.scene_from_document(document(angular_velocity=["0 rpm", "0 rpm", "60 rpm"]))
    corner = math.hypot(COLUMNS / 2, ROWS / 2)
    assert image_speeds(turns)["edge"] == pytest.approx(2 * math.pi * corner, rel=1e-6)


def test_places_of_instants_hold_those_of_the_level_below() -> None:
    for level in range(1, 7):
        found = places(level, 5)
        assert len(found) == 2**level + 1 and (np.diff(found) > 0).all()
        assert found[::2].tolist() == places(level - 1, 5).tolist()
        assert np.ptp(np.diff(found)) > 0  # nothing can keep step with them


@pytest.mark.parametrize("gamma", [0.5, 0.85, 1.0, 1.6])
def test_errors_of_light_are_bound_in_gray_levels(gamma: float) -> None:
    """Drawn errors in images that are half dark."""
    sensor = radwrap.scene_from_document(document()).camera.sensor
    sensor = replace(sensor, gamma=gamma, gain=255.0)
    random = np.random.default_rng(1)
    light = np.where(random.random(20_000) < 0.5, 1e-4 * random.random(20_000), random.random(20_000))
    for size in (1e-5, 1e-3, 1e-2):
        error = size * random.standard_normal(len(light))
        other = np.maximum(light + error, 0.0)
        rms = math.sqrt(float(np.mean((other - light) ** 2)))
        off = math.sqrt(float(np.mean((255 * other**gamma - 255 * light**gamma) ** 2)))
        bound = gray_bound(rms, light, sensor)
        assert off <= bound * (1 + 1e-9)
        assert gamma != 1 or off == pytest.approx(bound)
        assert allowed_exposure_error(bound, light, sensor) == pytest.approx(rms, rel=1e-6)
