"""Surfaces that share a place are refused by name; sources that fill the same place add up."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import radwrap
from radwrap.errors import InputError
from radwrap.frames import rotation_about_fixed_axes
from radwrap.scene.look import planes
from radwrap.scene.look.planes import check_planes
from tests.scene.test_sight import SHEET, led, metres, scene

LAMP = led(0.4, 2.0, 0, name="far", diameter="1 mm")
TILT = {"rotation": ["30 deg", "-20 deg", "10 deg"]}
BOX = {"type": "box", "name": "box", "size": metres(0.1, 0.1, 0.1)}
RING = {
    "type": "ring",
    "name": "ring",
    "diameter": "25 mm",
    "led_diameter": "5 mm",
    "radiance": "1 W/m^2/sr",
    "beam": {"profile": "cone", "width": "30 deg"},
    "position": metres(0, 0, 1),
    "look_at": metres(0, 0, 0),
}


def along_normal(distance: float) -> dict[str, Any]:
    turn = rotation_about_fixed_axes([math.radians(angle) for angle in (30, -20, 10)])
    return {"position": [f"{row[2] * distance!r} m" for row in turn], **TILT}


@pytest.mark.parametrize(
    ("first", "second", "shared"),
    [
        (SHEET, {"type": "disc", "name": "disc", "diameter": "20 mm"}, True),
        (SHEET | TILT, {"type": "disc", "name": "disc", "diameter": "20 mm", **TILT}, True),
        (SHEET | TILT, {"type": "disc", "name": "disc", "diameter": "20 mm", **along_normal(1e-5)}, False),
        (SHEET | TILT, {"type": "disc", "name": "disc", "diameter": "20 mm", **along_normal(1e-9)}, True),
        (SHEET, SHEET | {"name": "disc"}, True),
        (SHEET, SHEET | {"name": "disc", "position": metres(0.3, 0, 0)}, False),  # they touch
        (SHEET, SHEET | {"name": "disc", "position": metres(0.29, 0.1, 0)}, True),
        (SHEET, SHEET | {"name": "disc", "rotation": ["0 deg", "1 deg", "0 deg"]}, False),  # they cross
        (SHEET, {"type": "box", "name": "disc", "size": metres(0.1, 0.1, 0.1), "position": metres(0, 0, 0.05)}, False),
        (SHEET, {"type": "box", "name": "disc", "size": metres(0.1, 0.1, 0.1), "position": metres(0, 0, -0.05)}, True),
        (
            SHEET,
            {
                "type": "cylinder",
                "name": "disc",
                "diameter": "0.1 m",
                "length": "0.1 m",
                "position": metres(0, 0, -0.05),
            },
            True,
        ),
        # A thin cross: no corner of either lies in the other.
        (SHEET | {"size": metres(0.3, 0.001)}, SHEET | {"name": "disc", "size": metres(0.001, 0.3)}, True),
        # A disc in the notch of an L.
        (
            {"type": "polygon", "name": "sheet", "vertices": [metres(x, y) for x, y in
             ((-0.1, -0.1), (0.1, -0.1), (0.1, -0.05), (-0.05, -0.05), (-0.05, 0.1), (-0.1, 0.1))]},
            {"type": "disc", "name": "disc", "diameter": "60 mm", "position": metres(0.02, 0.02, 0)},
            False,
        ),
    ],
)  # fmt: skip
def test_targets_in_one_plane(first: dict[str, Any], second: dict[str, Any], shared: bool) -> None:
    if shared:
        with pytest.raises(InputError, match='"sheet" and "disc" overlap in one plane') as refused:
            scene([LAMP], [first, second])
        assert refused.value.where.endswith("targets[1]")
    else:
        scene([LAMP], [first, second])


@pytest.mark.parametrize("count", [15, 16, 32, 100])
def test_leds_of_a_ring_have_room(count: int) -> None:
    """On a circle of 25 mm, n chords of 5 mm need sin(pi/n) >= 1/5, so n <= 15.6."""
    ring = RING | {"count": count}
    if count <= 15:
        scene([ring], [SHEET])
    else:
        with pytest.raises(InputError, match=r'the LEDs of "ring" overlap: .* of 25 mm has room for 15 LEDs of 5 mm'):
            scene([ring], [SHEET])


def disc(name: str, x: float, z: float = 0.5, **more: Any) -> dict[str, Any]:
    place = {"position": metres(x, 0, z), "look_at": metres(x, 0, 0)}
    return {"type": "disc", "name": name, "diameter": "8 mm", "radiance": "1 W/m^2/sr", **place, **more}


def test_sources_that_overlap_are_refused() -> None:
    with pytest.raises(InputError, match='"a" and "b" overlap in one plane'):
        scene([disc("a", 0.3), disc("b", 0.305)], [SHEET])
    scene([disc("a", 0.3), disc("b", 0.308)], [SHEET])
    scene([disc("a", 0.3), disc("b", 0.305, z=0.49)], [SHEET])
    scene([disc("a", 0.3), disc("b", 0.305, radiance="0 W/m^2/sr")], [SHEET])  # a dark one is not there


def test_a_source_in_a_target_s_plane_is_refused() -> None:
    holder = {"type": "sheet", "name": "holder", "size": metres(0.1, 0.1), "position": metres(0.3, 0, 0.5)}
    with pytest.raises(InputError, match='"holder" and "a" overlap in one plane'):
        scene([disc("a", 0.3)], [SHEET, holder])
    # Flush in the face of a body that it shines away from; and a body that lies on the light.
    body = BOX | {"position": metres(0.3, 0, 0.55)}
    with pytest.raises(InputError, match='"box" and "a" overlap in one plane'):
        scene([disc("a", 0.3)], [SHEET, body])
    light = {"type": "rectangle", "name": "a", "size": metres(0.2, 0.2), "radiance": "1 W/m^2/sr"}
    light |= {"position": metres(0, 0, -0.05), "look_at": metres(0, 0, 1)}
    scene([light], [BOX])


def test_a_mesh_is_held_against_planes(tmp_path: Path) -> None:
    """Its file holds float32, so a plane is met to 1e-7 of its size."""
    trimesh.creation.box(extents=(60, 60, 60)).export(tmp_path / "cube.stl")
    start = json.loads(scene([LAMP], [SHEET]).document)

    def made(height: float, sheet: float = 0.0) -> None:
        cube = {"name": "cube", "part": "cube.stl", "length_unit": "1 mm", "material": "black"}
        targets = [start["targets"][0] | {"position": metres(0, 0, sheet)}, cube | {"position": metres(0, 0, height)}]
        radwrap.scene_from_document(start | {"targets": targets}, folder=tmp_path)

    made(0.03)  # stands on the sheet
    made(-0.03 + 1e-5)
    with pytest.raises(InputError, match='"cube" and "sheet" overlap in one plane'):
        made(-0.03)
    made(-0.03, 0.001)


def test_pairs_are_those_of_each_against_all(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(4)
    middles, reach = random.uniform(-1, 1, (80, 3)) * [0.3, 1.0, 0.5], random.uniform(0, 0.2, (80, 3))
    reach[7] = 3.0  # one that meets all
    monkeypatch.setattr(planes, "_MOST_PAIRS", 50)
    found = [
        tuple(pair) for pairs in planes._beside_each_other(middles - reach, middles + reach) for pair in pairs.tolist()
    ]
    gap = np.abs(middles - middles[:, np.newaxis])
    a, b = np.nonzero(np.triu((gap <= reach + reach[:, np.newaxis]).all(axis=2), 1))
    assert sorted(found) == list(zip(a.tolist(), b.tolist(), strict=True))


def test_thousands_of_sheets_in_one_plane_are_held_against_their_neighbours_only() -> None:
    few = scene([LAMP], [SHEET])
    (sheet,) = few.targets
    side = 65
    spread = [(0.5 * (number % side), 0.5 * (number // side), 0.0) for number in range(side**2)]
    sheets = [
        replace(sheet, name=f"s{number}", pose=replace(sheet.pose, position=place))
        for number, place in enumerate(spread)
    ]
    began = time.process_time()
    check_planes(replace(few, targets=tuple(sheets)))
    assert time.process_time() - began < 5.0  # each against all: minutes
    sheets[-1] = replace(sheets[-1], pose=replace(sheet.pose, position=(0.5, 0.51, 0.0)))
    with pytest.raises(InputError, match=f'"s{side + 1}" and "s{side**2 - 1}" overlap'):
        check_planes(replace(few, targets=tuple(sheets)))
