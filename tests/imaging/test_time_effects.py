"""What motion and shutter are worth, and how fast a belt may run, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.imaging.forecast.time_effects import light_time
from radwrap.imaging.render_options import RenderOptions
from tests.imaging.test_in_time import (
    COLUMNS,
    EXPOSURE,
    MIDDLE,
    PITCH,
    ROWS,
    document,
    ramp,
    velocity,
)

CONTRAST = 197.0  # gray, of the document's edge
OPTIONS = RenderOptions(tolerance=1.0, tracer="compiled")


def effect(tables: dict[str, Any], name: str) -> dict[str, Any]:
    found = radwrap.effects(radwrap.scene_from_document(tables), OPTIONS)
    return next(one for one in found["effects"] if one["name"] == name)


def test_motion_is_worth_the_ramp_of_an_edge() -> None:
    smear = 5.0
    found = effect(document(velocity=velocity(smear)), "motion")
    u = np.arange(COLUMNS)
    change = CONTRAST * (ramp(u, MIDDLE, smear) - ramp(u, MIDDLE, 1e-6))
    expected = math.sqrt(float(np.mean(change**2)))
    assert found["rms_gray"] == pytest.approx(expected, rel=0.15)  # 256 of 400 pixels, nine instants
    assert expected < found["rms_gray_upper95"] and found["needed"]


def test_a_shutter_is_worth_what_its_rows_differ_by() -> None:
    tables = document(edge_position="-49 mm")
    tables["camera"]["sensor"] |= {"shutter": "global_reset", "line_time": "0.1 ms"}
    found = effect(tables, "shutter")
    bright = 225.0  # gray of the even field; row r is exposed r hundredths longer
    expected = bright * math.sqrt(float(np.mean((np.arange(ROWS) / 100) ** 2)))
    # What is brighter than 255 is clipped in the image itself: here none is.
    assert found["rms_gray"] == pytest.approx(expected, rel=0.1)


def test_a_scene_of_one_instant_has_neither() -> None:
    names = [one["name"] for one in radwrap.effects(radwrap.scene_from_document(document()), OPTIONS)["effects"]]
    assert "motion" not in names and "shutter" not in names


def test_how_fast_a_belt_may_run() -> None:
    (found,) = radwrap.explain(radwrap.scene_from_document(document()))["motion"]
    assert found["target"] == "edge" and found["smear"] is None and found["image_speed"] is None
    assert found["half_pixel_speed"] == pytest.approx(PITCH / 2 / EXPOSURE)
    tables = document(velocity=velocity(6.0))
    for source in tables["sources"]:
        source["strobe"] = {"delay": "2 ms", "width": "50 us"}
    (flash,) = radwrap.explain(radwrap.scene_from_document(tables))["motion"]
    assert flash["light_time"] == pytest.approx(50e-6)
    assert flash["half_pixel_speed"] == pytest.approx(PITCH / 2 / 50e-6)
    assert flash["image_speed"] == pytest.approx(6.0 / EXPOSURE)
    assert flash["smear"] == pytest.approx(6.0 * 50e-6 / EXPOSURE)


@pytest.mark.parametrize(
    ("strobes", "time"),
    [
        ((None, None), 10e-3),
        (({"delay": "1 ms", "width": "1 ms"}, {"delay": "5 ms", "width": "1 ms"}), 5e-3),
        (({"delay": "1 ms", "width": "1 ms"}, {"delay": "-5 ms", "width": "1 ms"}), 1e-3),
        (({"delay": "-1 ms", "width": "2 ms"}, {"delay": "-1 ms", "width": "3 ms"}), 2e-3),
    ],
)
def test_light_comes_in_from_the_first_pulse_to_the_last(strobes: tuple[Any, Any], time: float) -> None:
    tables = document()
    for source, strobe in zip(tables["sources"], strobes, strict=True):
        if strobe is not None:
            source["strobe"] = strobe
    assert light_time(radwrap.scene_from_document(tables)) == pytest.approx(time)


def test_pulses_are_not_advised_another_exposure_time() -> None:
    tables = document()
    tables["sources"][0]["strobe"] = {"delay": "2 ms", "width": "50 us"}
    found = radwrap.explain(radwrap.scene_from_document(tables))
    assert found["exposure_for_80_percent"] is None and "strobed" in found["advice"]
