"""A trade of what is rendered in parts: the reference against closed forms, and the rows against it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import PixelSample
from radwrap.process import Programs
from radwrap.scene.instants import held, lit_by
from radwrap.scene.mosaic import COLOURS
from radwrap.study.composed_reference import take_composed_reference
from radwrap.study.reference import Reference
from radwrap.study.trade import measure_trade
from radwrap.study.trade_rows import TradeOptions
from tests.imaging.test_in_time import COLUMNS, MIDDLE, ROWS, bright_share, document, ramp, velocity
from tests.imaging.test_mosaicked import QUICK, at_550, colour_camera, scene_with

RENDER: Final = RenderOptions(seed=3, tracer="compiled")
# Of the edge's contrast: what its ramp is off by between instants a quarter of a pixel apart, and noise of the rays.
OFF: Final = 4e-3


def reference_of(scene: radwrap.Scene, folder: Path, rays: int) -> Reference:
    """At all pixels."""
    number = scene.camera.sensor.pixels
    every = PixelSample(np.arange(number), np.zeros(number, dtype=np.intp), np.ones(1))
    told: list[int] = []
    with Programs() as programs:
        found = take_composed_reference(
            scene, every, 0, folder / "work", rays=rays, options=RENDER, programs=programs, progress=told.append
        )
    assert found.rays == sum(told) and not (folder / "work").exists()
    return found


def flashed() -> dict[str, Any]:
    """Nothing moves; rows begin 10 us apart, and one of two sources shines for 3 of the 50 us of five of them."""
    tables = document(edge_position="0 mm")  # between two pixels
    tables["camera"]["exposure_time"] = "50 us"
    tables["camera"]["sensor"] |= {"shutter": "rolling", "line_time": "10 us", "gain": "3e10 (J/m^2)^-1"}
    tables["sources"][0]["strobe"] = {"delay": "72 us", "width": "3 us"}
    return tables


def test_the_reference_of_a_flash_counts_in_the_rows_that_are_open(tmp_path: Path) -> None:
    scene = radwrap.scene_from_document(flashed())
    found = reference_of(scene, tmp_path, 64)
    pulse = np.zeros((ROWS, 1))
    pulse[3:8] = 3 / 50
    left, right = (
        radwrap.render(lit_by(held(scene), {name: 1.0}), **QUICK).radiant_exposure.values for name in ("left", "right")
    )
    for gray in (found.first, found.second):
        assert gray.reshape(ROWS, COLUMNS) == pytest.approx((pulse * left + right) * 3e10, rel=1e-3)


@pytest.mark.long
def test_the_reference_of_a_moving_edge_is_its_ramp(tmp_path: Path) -> None:
    """Two values, with instants and rays of their own, of a box on a box."""
    tables = document(velocity=velocity(1.3))
    scene = radwrap.scene_from_document(tables)
    found = reference_of(scene, tmp_path, 2048)
    expected = ramp(np.arange(float(COLUMNS)), MIDDLE, 1.3)
    for gray in (found.first, found.second):
        share = bright_share(tables, gray.reshape(ROWS, COLUMNS) / 8e7)
        assert np.abs(share.mean(axis=0) - expected).max() < OFF
    assert 0 < found.rms_gray < 0.2 and (found.first != found.second).any()


def test_the_reference_of_a_mosaic_has_each_pixels_own_colour(tmp_path: Path) -> None:
    scene = scene_with(colour_camera("GRBG"), tmp_path)
    found = reference_of(scene, tmp_path, 64)
    mosaic = scene.camera.sensor.mosaic
    assert mosaic is not None
    for colour in COLOURS:
        alone = scene_with({"quantum_efficiency": at_550(colour)}, tmp_path)
        gray = gray_levels(radwrap.render(alone, **QUICK).radiant_exposure.values, alone.camera.sensor)
        for gray_found in (found.first, found.second):
            for place in mosaic.places(colour):
                # Light falls off over a pixel by less than this.
                assert gray_found.reshape(gray.shape)[place] == pytest.approx(gray[place], rel=1e-3)


def options() -> TradeOptions:
    return TradeOptions(longest=1e6, reference_pixels=400, reference_rays=64, render=RENDER)


@pytest.fixture
def _few_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radwrap.study.trade._NUMBERS", (7,))
    monkeypatch.setattr("radwrap.study.trade._SMALL_NUMBERS", (7,))
    monkeypatch.setattr("radwrap.study.trade._SHARES", (4.0,))


@pytest.mark.usefixtures("_few_settings")
@pytest.mark.parametrize(
    "tables", [flashed(), pytest.param(document(velocity=velocity(0.6)), marks=pytest.mark.long)], ids=["rows", "moves"]
)
def test_a_trade_of_what_changes_in_time_is_of_renders_to_tolerance(tables: dict[str, Any], tmp_path: Path) -> None:
    """Each setting keeps the bound that its render certified, goes on, and no method of fixed rays is tried."""
    scene = radwrap.scene_from_document(tables)
    asked = replace(options(), render=replace(RENDER, tolerance=1.0))
    found = measure_trade(scene, tmp_path, asked)
    assert [row.setting.name for row in found.rows] == ["kernel_tolerance-4", "rays_tolerance-4"]
    assert found.tolerance == 1.0 and found.left_out == ()
    for row in found.rows:
        assert row.met and row.certified_rms_gray_upper95 is not None
        assert row.error.rms_gray <= row.certified_rms_gray_upper95 <= 4.0
    again = measure_trade(scene, tmp_path, asked)
    assert again.rows == found.rows and again.run_sha256 == found.run_sha256
    later = radwrap.with_value(scene, "camera.exposure_time", "51 us")
    assert measure_trade(later, tmp_path, asked).run_sha256 != found.run_sha256


def test_what_took_too_long_is_not_tried_finer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radwrap.study.trade._SHARES", (4.0, 2.0))
    scene = radwrap.scene_from_document(flashed())
    asked = replace(options(), longest=1e-3, render=replace(RENDER, tolerance=1.0))
    found = measure_trade(scene, tmp_path, asked)
    assert [row.setting.tolerance for row in found.rows] == [4.0, 4.0]
    assert [left.setting.tolerance for left in found.left_out] == [2.0, 2.0]
    assert all("a tolerance of 4 took" in left.why for left in found.left_out)


@pytest.mark.long
@pytest.mark.usefixtures("_few_settings")
def test_a_trade_of_a_colour_camera_has_all_methods(tmp_path: Path) -> None:
    scene = scene_with(colour_camera(rows=9, columns=10), tmp_path)
    found = measure_trade(scene, tmp_path / "out", replace(options(), render=replace(RENDER, tolerance=10.0)))
    assert {row.setting.method for row in found.rows} >= {"pinhole", "viewpoints", "kernel", "rays"}
    for row in found.rows:
        assert row.error.rms_gray < 10.0  # an even field: no method is far off
        assert (row.met is None) == (row.setting.tolerance is None)


def test_a_trade_of_a_scene_that_no_pulse_lights_is_refused(tmp_path: Path) -> None:
    tables = document()
    for source in tables["sources"]:
        source["strobe"] = {"delay": "1 s", "width": "1 ms"}
    with pytest.raises(InputError, match="no pulse meets the exposure"):
        measure_trade(radwrap.scene_from_document(tables), tmp_path / "out", options())
    assert not (tmp_path / "out").exists()
