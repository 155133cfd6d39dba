"""Calibrations: inverted exactly, never beyond their table, and a scene's ring."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.led.calibration import levels_for, read_table, scaled, write_calibration
from radwrap.led.drive import Drive
from radwrap.led.from_scene import check_positions, leds_of, the_ring
from radwrap.led.ring import LedRing
from radwrap.scene.file.ring_calibration import LedTable, RingCalibration, read_calibration
from tests.cli.conftest import SMALL, scene_with
from tests.led.benches import FakeBench
from tests.led.conformance import COUNT, FIRST, light, there

RING: Final[dict[str, Any]] = {
    "type": "ring",
    "name": "ring",
    "position": ["0 mm", "0 mm", "500 mm"],
    "look_at": ["0 mm", "0 mm", "0 mm"],
    "count": 12,
    "diameter": "25 mm",
    "radiant_intensity": "50 mW/sr",
    "beam": {"profile": "gaussian", "width": "20 deg"},
}
DRIVE: Final = Drive(12, 850e-9, 0.1, 0.05, 1.0, 12.0, 60.0)


def table(factor: float = 1.0) -> LedTable:
    """An LED whose light bends: level, level^2 and half each."""
    levels = np.linspace(0, 0.8, 9)
    light = factor * 0.05 * (levels + levels**2) / 2
    return LedTable(tuple(levels.tolist()), tuple(light.tolist()), (1e-5,) * 9)


def calibration(serial: str = FIRST) -> RingCalibration:
    return RingCalibration(
        leds=tuple(table(1 + 0.02 * n) for n in range(COUNT)),
        serial=serial,
        date="2026-01-01",
        temperature=296.15,
        current=0.05,
        emulated=True,
        source="a test",
    )


def test_levels_and_radiant_intensities_invert_each_other() -> None:
    made = calibration()
    for level in np.linspace(0, 0.8, 97):
        intensities = made.intensities([level] * COUNT)
        np.testing.assert_allclose(levels_for(made, intensities), level, rtol=0, atol=1e-12)


def test_beyond_the_table_is_an_error() -> None:
    made = calibration()
    with pytest.raises(InputError, match="LED 3: the radiant intensity"):
        levels_for(made, [0.0] * 3 + [0.06] + [0.0] * 8)
    with pytest.raises(InputError, match=r"LED 0: the level 0\.9"):
        made.intensities([0.9] * COUNT)
    begins_late = LedTable((0.2, 0.8), (0.01, 0.04), (0.0, 0.0))
    assert begins_late.level(0.0) == 0.0, "off is off"
    with pytest.raises(InputError):
        begins_late.level(0.005)


def test_tables_that_do_not_rise_are_refused() -> None:
    for levels, values in (((0, 0.5, 0.5), (0, 1, 2)), ((0, 0.5, 1), (0, 2, 2)), ((0.0,), (0.0,)), ((0, 1.1), (0, 1))):
        with pytest.raises(InputError):
            LedTable(tuple(map(float, levels)), tuple(map(float, values)), (0.0,) * len(levels))


def test_light_at_level_zero_is_refused(tmp_path: Path) -> None:
    """Else the level for 5 mW/sr would be 0, which is dark."""
    with pytest.raises(InputError, match=r"is 0\.005 W/sr at level 0, where it is dark; subtract"):
        LedTable((0.0, 0.5), (0.005, 0.03), (0.0, 0.0))
    path = tmp_path / "z.csv"
    path.write_text("led,level,radiant_intensity\n0,0,5 mW/sr\n0,0.5,30 mW/sr\n")
    with pytest.raises(InputError, match=r"z\.csv: LED 0: .* subtract"):
        read_table(path)


def test_a_calibration_reads_back_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a ring.json"
    write_calibration(path, calibration())
    assert read_calibration(path) == calibration()
    told = json.loads(path.read_text())
    for key in ("leds", "serial", "current", "is", "schema_version"):
        path.write_text(json.dumps({name: told[name] for name in told if name != key}))
        with pytest.raises(InputError, match=r"a ring\.json"):
            read_calibration(path)
    for temperature in (float("nan"), -500.0):
        path.write_text(json.dumps({**told, "temperature": temperature}))
        with pytest.raises(InputError, match=r"a ring\.json: temperature: (is not a finite number|must be above zero)"):
            read_calibration(path)
    for wrong in ("[1]", "{", '{"is": "ring_calibration", "schema_version": 1}'):
        path.write_text(wrong)
        with pytest.raises(InputError):
            read_calibration(path)


def test_a_measured_table_is_read_with_its_units(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(
        "led,level,radiant_intensity,standard_error\n1,0,0 W/sr,\n0,1,40 mW/sr,0.1 mW/sr\n"
        "0,0,0 mW/sr,\n1,0.5,0.03 W/sr,"
    )
    first, second = read_table(path)
    assert first == LedTable((0.0, 1.0), (0.0, 0.04), (0.0, 1e-4))
    assert second == LedTable((0.0, 0.5), (0.0, 0.03), (0.0, 0.0))
    for text, told in (
        ("led,level\n0,1\n", "line 1: has the columns"),
        ("led,level,radiant_intensity\n0,1,40\n", "line 2"),
        ("led,level,radiant_intensity\n0,x,40 mW/sr\n", 'line 2, column "level"'),
        ("led,level,radiant_intensity\n0,0,1 mW/sr\n0,1,0.5 mW/sr\n", "LED 0: its radiant intensities"),
        ("led,level,radiant_intensity\n1,0,0 mW/sr\n1,1,1 mW/sr\n", "LED 0: needs two"),
        ("led,level,radiant_intensity\n", "holds no row"),
    ):
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            read_table(path)
        assert told in str(caught.value)


def test_light_is_set_by_radiant_intensity() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    wanted = [0.003 * n for n in range(COUNT)]
    with LedRing(bench.open(there(bench)), DRIVE, calibration()) as ring:
        shown = ring.set_levels(radiant_intensity=wanted)
        reached = calibration().intensities(light(bench))
        steepest = 0.05 * 1.22 * (1 + 2 * 0.8) / 2
        np.testing.assert_allclose(reached, wanted, rtol=0, atol=steepest * 0.5 / 4096)
        assert shown.verified and shown.held == light(bench)


def test_a_calibration_of_another_ring_or_current_is_refused() -> None:
    bench = FakeBench("mcp2221a_pca9685")
    for wrong, told in (
        (calibration("other"), 'serial "other"'),
        (replace(calibration(), current=0.06), "measured at 0.06 A"),
        (replace(calibration(), leds=calibration().leds[:3]), "is of 3 LEDs"),
    ):
        with pytest.raises(InputError, match=told):
            LedRing(bench.open(there(bench)), DRIVE, wrong)


def calibrated_scene(folder: Path, **changes: Any) -> radwrap.Scene:
    write_calibration(folder / "ring.json", calibration())
    ring = {key: value for key, value in RING.items() if key != "radiant_intensity"}
    source = {**ring, "calibration": "ring.json", "drive_levels": 0.4, **changes}
    return radwrap.scene_from_document(scene_with({"sources": [source]}), folder=folder)


def test_a_scene_takes_a_calibration_for_its_ring(tmp_path: Path) -> None:
    expected = calibration().intensities([0.4] * COUNT)
    leds = leds_of(calibrated_scene(tmp_path))
    np.testing.assert_allclose([led.radiant_intensity for led in leds], expected, rtol=1e-14)
    levels = [0.06 * n for n in range(COUNT)]
    changed = calibrated_scene(tmp_path, drive_levels=levels, leds=[{"index": 2, "radiance_factor": 0.5}])
    expected = list(calibration().intensities(levels))
    expected[2] *= 0.5
    np.testing.assert_allclose([led.radiant_intensity for led in leds_of(changed)], expected, rtol=1e-14)
    assert leds_of(changed)[0].radiance == 0.0
    with pytest.raises(InputError, match="there is no light"):
        calibrated_scene(tmp_path, drive_levels=0.0)


def test_a_scene_with_a_wrong_calibration_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    for changes, told in (
        ({"calibration": "none.json"}, 'no file "none.json" beside the scene'),
        ({"calibration": "../ring.json"}, "outside the scene's folder"),
        ({"drive_levels": 0.9}, "the level 0.9 lies outside"),
        ({"drive_levels": [0.1]}, "1 levels for 12 LEDs"),
        ({"drive_levels": None}, "go together"),
        ({"radiance": "1 W/m^2/sr"}, "exactly one of radiance, radiant_intensity and calibration"),
    ):
        given = {key: value for key, value in changes.items() if value is not None}
        write_calibration(tmp_path / "ring.json", calibration())
        with pytest.raises(InputError) as caught:
            if changes.get("drive_levels", 0) is None:
                ring = {key: value for key, value in RING.items() if key != "radiant_intensity"}
                document = scene_with({"sources": [{**ring, "calibration": "ring.json"}]})
                radwrap.scene_from_document(document, folder=tmp_path)
            calibrated_scene(tmp_path / "scene", **given)
        assert told in str(caught.value)


def test_positions_of_lamps_are_held_against_the_scene() -> None:
    bench = FakeBench("lamparray")
    ring = the_ring(radwrap.scene_from_document(scene_with({"sources": [RING]})))
    positions = bench.open(there(bench)).capabilities.positions
    assert positions is not None
    check_positions(positions, ring)
    with pytest.raises(InputError, match=r"are 25\.00 mm apart by the device and 27\.00 mm"):
        check_positions(positions, replace(ring, diameter=27e-3))
    with pytest.raises(InputError, match="apart"):
        check_positions((positions[1], positions[0], *positions[2:]), ring)
    with pytest.raises(InputError, match="12 lamps, the scene's ring 8"):
        check_positions(positions, replace(ring, count=8))
    bench.misbehave(FIRST, "shift")
    shifted = bench.open(there(bench)).capabilities.positions
    with pytest.raises(InputError, match="LEDs 3 and"):
        check_positions(shifted or (), ring)


def test_a_scene_in_which_other_things_shine_is_not_driven() -> None:
    lamp = SMALL["sources"][0]
    with pytest.raises(InputError, match='"lamp" shines too'):
        the_ring(radwrap.scene_from_document(scene_with({"sources": [RING, lamp]})))
    the_ring(radwrap.scene_from_document(scene_with({"sources": [RING, {**lamp, "radiance": "0 W/m^2/sr"}]})))
    with pytest.raises(InputError, match="has 0 rings"):
        the_ring(radwrap.scene_from_document(scene_with({})))


def test_one_level_alone_gives_a_line_through_zero() -> None:
    (led,) = scaled([0.04], [1e-4], [0.8])
    assert led.intensity(0.4) == pytest.approx(0.02)
    with pytest.raises(InputError):
        led.intensity(0.9)
