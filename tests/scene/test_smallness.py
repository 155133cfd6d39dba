"""Parts and spots of light that rays may miss are told."""

from __future__ import annotations

import math
from typing import Any

import pytest

import radwrap
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.sources import TableBeam, half_width
from tests.imaging.test_effects import document, lamp

# 20 um pixels, f = 10 mm, 1 m away: a pixel sees 2 mm.
SMALL = [
    ({"type": "disc", "diameter": "0.9 mm"}, "0.45 pixels"),
    ({"type": "disc", "diameter": "1.1 mm"}, None),
    ({"type": "sphere", "diameter": "0.2 mm"}, "0.1 pixels"),
    ({"type": "box", "size": ["20 mm", "20 mm", "0.2 mm"]}, "0.1 pixels"),
    ({"type": "cylinder", "diameter": "20 mm", "length": "0.2 mm"}, "0.1 pixels"),
    ({"type": "sheet", "size": ["20 mm", "0.2 mm"]}, "0.1 pixels"),
    ({"type": "polygon", "vertices": [["0 mm", "0 mm"], ["9 mm", "0 mm"], ["0 mm", "0.2 mm"]]}, "0.1 pixels"),
    ({"type": "sheet", "size": ["20 mm", "20 mm"]}, None),
]


@pytest.mark.parametrize(("target", "told"), SMALL)
def test_what_is_narrower_than_half_a_pixel_is_told(target: dict[str, Any], told: str | None) -> None:
    part = {"name": "part", "material": "bright", **target}
    scene = radwrap.scene_from_document(document([part], sources=[lamp("0 m", "0 m", "2 m")]))
    lines = [line for line in warnings_of(scene) if "rays may miss" in line]
    assert len(lines) == (told is not None)
    assert told is None or told in lines[0]


def test_small_dots_are_told() -> None:
    board = {"type": "board", "name": "board", "material": "dim", "dot_material": "bright", "rows": 3, "columns": 3}
    board |= {"pitch": "4 mm", "dot_diameter": "0.06 mm"}
    scene = radwrap.scene_from_document(document([board], sources=[lamp("0 m", "0 m", "2 m")]))
    assert any("0.03 pixels" in line for line in warnings_of(scene))


@pytest.mark.parametrize("profile", ["gaussian", "cosine_power", "cone"])
@pytest.mark.parametrize(("spot_mm", "told"), [(0.9, "0.45 pixels"), (1.1, None)])
def test_a_spot_of_light_below_half_a_pixel_is_told(profile: str, spot_mm: float, told: str | None) -> None:
    """From 2 m the full width at half maximum is 2 m tan(FWHM / 2) on each side."""
    beam = {"profile": profile, "width": f"{2 * math.atan(spot_mm / 4000)!r} rad", "width_definition": "fwhm"}
    sheet = {"type": "sheet", "name": "sheet", "material": "dim", "size": ["20 mm", "20 mm"]}
    scene = radwrap.scene_from_document(document([sheet], sources=[{**lamp("0 m", "0 m", "2 m"), "beam": beam}]))
    lines = [line for line in warnings_of(scene) if "rays may miss" in line]
    assert len(lines) == (told is not None)
    assert told is None or told in lines[0]


def test_the_half_width_of_a_table_is_where_it_falls_to_half() -> None:
    """In steps of 15 deg: half of the peak is reached last at 30 deg, times the factor on all angles."""
    beam = TableBeam("table", 0.1, values=(0.8, 1.0, 0.5, 0.2, 0.0, 0.0, 0.0))
    assert half_width(beam) == pytest.approx(math.radians(3.0))
