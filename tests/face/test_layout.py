"""Where the page draws things: by angles, distances and places that are known."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.face import layout as module
from radwrap.face.layout import corners_of, half_angle, layout, seen_at
from radwrap.scene.look.geometry import project
from radwrap.scene.sources import Beam, Emitter
from tests.cli.conftest import scene_with
from tests.face.conftest import TWO, Served

# The camera looks down from 500 mm: its z is the world's -z.
FLAT: Final = {**TWO, "targets.0.rotation": ["0 deg", "0 deg", "0 deg"]}


def scene(changes: Any = FLAT) -> radwrap.Scene:
    return radwrap.scene_from_document(scene_with(changes))


def test_places_are_those_of_the_camera_and_of_the_scene_file() -> None:
    found = layout(scene())
    (board,) = found["targets"]
    assert board["name"] == "board" and not board["boxed"]
    assert board["world"] == [0, 0, 0] and board["place"] == pytest.approx([0, 0, 0.5])
    lamp, second = found["sources"]
    assert (lamp["name"], lamp["world"]) == ("lamp", pytest.approx([0.03, 0.1, 0.45]))
    # 50 mm in front of the camera; sideways as far as the world has it, whichever way the axes lie.
    assert lamp["place"][2] == pytest.approx(0.05) and math.hypot(*lamp["place"][:2]) == pytest.approx(
        math.hypot(0.03, 0.1)
    )
    assert second["world"] == pytest.approx([-0.06, -0.09, 0.45])
    # It shines at the origin, 0.5 m in front of the camera.
    off = np.array([0, 0, 0.5]) - lamp["place"]
    assert lamp["axis"] == pytest.approx((off / np.linalg.norm(off)).tolist(), abs=1e-5)
    assert (
        found["camera"]["depth"] == pytest.approx(0.5) and found["camera"]["focus"] is None and found["unknown"] == []
    )


def test_the_field_of_view_is_the_sensor_over_the_focal_length() -> None:
    camera = scene().camera
    width, height = 24 * 100e-6 / camera.image_distance, 20 * 110e-6 / camera.image_distance
    corners = corners_of(camera)
    assert np.ptp(corners[:, 0]) == pytest.approx(width) and np.ptp(corners[:, 1]) == pytest.approx(height)
    assert corners[0, 0] < 0 < corners[1, 0] and corners[0, 1] < 0 < corners[3, 1]  # column 0, row 0 is left and up
    assert np.allclose(corners[:, 2], 1)


@pytest.mark.parametrize(
    ("beam", "angle"),
    [
        (Beam("gaussian", math.radians(8)), math.radians(8) * math.sqrt(2 * math.log(2))),
        (Beam("cone", 0.3), 0.3),
        (Beam("lambertian"), math.pi / 3),
        (Beam("cosine_power", 0.5), math.acos(0.5**0.25)),
    ],
)
def test_a_beam_is_as_wide_as_its_half_says(beam: Beam, angle: float) -> None:
    emitter = Emitter("lamp", (0, 0, 0), (0, 0, 1), 1e-3, 1.0, beam)
    assert half_angle(emitter) == pytest.approx(angle, abs=math.pi / 2 / 9000)


@pytest.mark.parametrize("rotation", [["0 deg", "0 deg", "0 deg"], ["20 deg", "6 deg", "-2 deg"]])
def test_a_pixel_sees_what_projects_onto_it(rotation: list[str]) -> None:
    """The place that it is told to see lies on the target's plane, and the camera's projection brings it back."""
    one = scene({**TWO, "targets.0.rotation": rotation})
    normal = np.asarray(one.targets[0].pose.rotation)[:, 2]
    axes = np.asarray(one.camera.pose.rotation)
    for column, row in ((6, 5), (11, 9), (17, 14), (7, 13)):
        seen = seen_at(one, column, row)
        assert seen is not None and seen["target"] == "board"
        world = axes @ np.array(seen["place"]) + np.asarray(one.camera.pose.position)
        assert abs(float(normal @ (world - np.asarray(one.targets[0].pose.position)))) < 3e-6
        uv, _ = project(one.camera, world[np.newaxis])
        assert uv[0] == pytest.approx([column, row], abs=0.02)
        assert seen["distance"] == pytest.approx(float(np.linalg.norm(seen["place"])), abs=2e-6)


def test_the_nearest_target_hides_the_others() -> None:
    sheet = {
        "type": "disc",
        "name": "plate",
        "material": "white",
        "diameter": "9 mm",
        "position": ["0 mm", "0 mm", "50 mm"],
    }
    one = scene({**FLAT, "targets.1": sheet})
    middle = seen_at(one, 11, 9)
    assert middle is not None and (middle["target"], round(middle["distance"], 3)) == ("plate", 0.45)
    corner = seen_at(one, 6, 5)
    assert corner is not None and corner["target"] == "board"
    away = scene({**FLAT, "camera.look_at": ["0 mm", "500 mm", "500 mm"]})
    assert seen_at(away, 11, 9) is None


def test_too_many_triangles_become_boxes_of_the_same_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    (whole,) = layout(scene())["targets"]
    every = np.concatenate([piece["vertices"] for piece in whole["surfaces"]])
    monkeypatch.setattr(module, "MOST_TRIANGLES", 10)
    (boxed,) = layout(scene())["targets"]
    assert boxed["boxed"] and len(boxed["surfaces"]) == 1
    corners = np.array(boxed["surfaces"][0]["vertices"])
    assert len(corners) == 8 and len(boxed["surfaces"][0]["faces"]) == 12
    assert np.allclose([corners.min(axis=0), corners.max(axis=0)], [every.min(axis=0), every.max(axis=0)])
    # A closed surface: each edge is of two triangles.
    edges = [frozenset((face[k], face[k - 1])) for face in boxed["surfaces"][0]["faces"] for k in range(3)]
    assert all(edges.count(edge) == 2 for edge in edges)


@pytest.mark.long
def test_the_server_tells_places_and_what_a_pixel_sees(served: Served) -> None:
    basis = served.ready()["basis"]
    told = served.post("/api/layout", {"basis": basis}).json
    assert {one["name"] for one in told["sources"]} == {"lamp", "second"} and told["targets"][0]["surfaces"]
    pixel = served.post("/api/pixel", {"basis": basis, "column": 11, "row": 9}).json
    assert pixel["sees"]["target"] == "board" and 0.4 < pixel["sees"]["distance"] < 0.6
    assert served.post("/api/layout", {"basis": basis + 1}).status == 422
