"""Warnings of what stands in the camera's sight."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.scene.look.checks import warnings_of

START = Path(__file__).parents[2] / "radwrap" / "data" / "init" / "scene.toml"


def metres(*values: float) -> list[str]:
    return [f"{float(value)!r} m" for value in values]


def scene(sources: list[dict[str, Any]], targets: list[dict[str, Any]], **camera: Any) -> radwrap.Scene:
    """A camera at z = 1 m that sees 0.21 x 0.21 m at z = 0."""
    document = tomllib.loads(START.read_text())
    document["camera"] |= {"position": metres(0, 0, 1), "look_at": metres(0, 0, 0), **camera}
    document["sources"] = sources
    document["targets"] = [{"material": "black", **target} for target in targets]
    return radwrap.scene_from_document(document)


def led(x: float, z: float, towards: float, **more: Any) -> dict[str, Any]:
    place = {"position": metres(x, 0, z), "look_at": metres(x, 0, towards)}
    beam = {"profile": "cone", "width": "60 deg", "width_definition": "half_angle"}
    return {"type": "led", "name": "led", "diameter": "4 mm", "radiance": "1 W/m^2/sr", "beam": beam, **place, **more}


SHEET = {"type": "sheet", "name": "sheet", "size": metres(0.3, 0.3)}
FACING = 'the disc of "led" is in view from the front: there the image shows the light itself'
HIDING = 'the disc of "led" is between the camera and "sheet", part of which is hidden'


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (led(0.0, 0.5, 0), (HIDING,)),
        (led(0.03, 0.5, 0), (HIDING,)),
        (led(0.0, 0.5, 1), (FACING,)),
        (led(0.2, 0.5, 0), ()),  # beside the view
        (led(0.2, 0.5, 1), ()),
        (led(0.0, -0.5, 1), ()),  # behind the sheet
        (led(0.0, 1.5, 0), ()),  # behind the camera
        (led(0.003, 1.0, 0), ()),  # in the pinhole's own plane
        # A disc as large as the view, of which no middle and no rim is in it.
        (led(0.1, 0.5, 0, diameter="0.8 m", beam={"profile": "cone", "width": "2 deg"}), (HIDING,)),
    ],
)
def test_discs_in_sight(source: dict[str, Any], expected: tuple[str, ...]) -> None:
    far = led(0.4, 2.0, 0, name="far", diameter="1 mm")
    # What a wide disc shines on is refused as too close: it shines past a smaller sheet.
    sheet = SHEET | ({"size": metres(0.12, 0.12)} if source["diameter"] == "0.8 m" else {})
    assert warnings_of(scene([source, far], [sheet])) == expected


def test_a_dark_disc_is_not_there() -> None:
    far = led(0.4, 2.0, 0, name="far", diameter="1 mm")
    dark = led(0.0, 0.5, 1, radiance="0 W/m^2/sr")
    assert warnings_of(scene([dark, far], [SHEET])) == ()


def test_only_blur_brings_a_disc_into_view() -> None:
    """At 10 mm from a pinhole of 1 mm: it is projected 0.2 mm beside the sensor, with a blur of 1.1 mm."""
    beside = led(1.3e-3, 0.99, 0, diameter="0.1 mm")
    assert warnings_of(scene([beside], [SHEET], aperture={"diameter": "0.1 mm"})) == ()
    assert warnings_of(scene([beside], [SHEET], aperture={"diameter": "1 mm"})) == (HIDING,)


def test_discs_of_a_ring_are_told_together() -> None:
    ring = {"type": "ring", "name": "ring", "count": 8, "diameter": "60 mm", "led_diameter": "2 mm"}
    ring |= {"position": metres(0, 0, 0.5), "look_at": metres(0, 0, 0), "radiance": "1 W/m^2/sr"}
    ring["beam"] = {"profile": "cone", "width": "30 deg"}
    (told,) = warnings_of(scene([ring], [SHEET]))
    assert told == '8 discs of "ring" are between the camera and "sheet", part of which is hidden'


def test_what_is_said_is_what_is_traced() -> None:
    """The disc's pixels are dark where its back hides the sheet, bright where it faces the camera."""
    sensor = {"preset": "fivs", "rows": 33, "columns": 33, "pixel_width": "80 um", "pixel_height": "80 um"}
    far = led(0.4, 2.0, 0, name="far", diameter="1 mm", radiance="1 kW/m^2/sr")
    values = {}
    for name, towards in (("hiding", 0), ("facing", 1), ("none", None)):
        near = [] if towards is None else [led(0.0, 0.5, towards, diameter="20 mm", radiance="1e-4 W/m^2/sr")]
        made = scene([*near, far], [SHEET], sensor=sensor)
        values[name] = radwrap.render(made, method="pinhole").radiant_exposure.values[16, 16]
        assert len(warnings_of(made)) == len(near)
    assert values["hiding"] == 0 < values["none"]
    assert values["facing"] > 0
