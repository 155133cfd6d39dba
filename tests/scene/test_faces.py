"""The face that a target turns to the camera, and the circles on it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.scene.file.load import load_scene, scene_from_document
from radwrap.scene.look.faces import Face, face_towards, rings
from radwrap.scene.look.geometry import project
from tests.cli.conftest import scene_with

CELLS = Path(__file__).parents[2] / "rad_scenes" / "cells"


def face_of(target: dict[str, Any], **more: Any) -> tuple[Face, Any]:
    document = scene_with({"targets": [{"name": "one", "material": "white", **target}], **more})
    scene = scene_from_document(document, origin="scene.toml", folder=Path())
    return face_towards(scene.camera, scene.targets[0]), scene.camera


def test_a_disc_has_its_rim() -> None:
    face, camera = face_of({"type": "disc", "diameter": "30 mm", "position": ["5 mm", "2 mm", "10 mm"]})
    assert face.rims[0].radius == pytest.approx(0.015) and face.rims[0].centre == (0, 0)
    assert face.origin == pytest.approx((0.005, 0.002, 0.01))
    assert face.depth(camera) == pytest.approx(0.49)


@pytest.mark.parametrize("turns", [(0, 0, 0), (180, 0, 20), (30, 0, 0)])
def test_there_and_back(turns: tuple[int, int, int]) -> None:
    """Places of the plane by their image are themselves, and those of a body lie on its nearer end."""
    rotation = [f"{turn} deg" for turn in turns]
    face, camera = face_of({"type": "cylinder", "diameter": "30 mm", "length": "20 mm", "rotation": rotation})
    places = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, -0.012], [0.007, 0.003]])
    assert face.from_image(camera, face.to_image(camera, places)) == pytest.approx(places, abs=1e-12)
    assert np.dot(face.normal, np.asarray(camera.pose.position) - face.origin) > 0, "towards the camera"
    assert np.linalg.norm(face.origin) == pytest.approx(0.01), "at half of its length"


@pytest.mark.parametrize(
    ("rotation", "size"),
    [
        (["0 deg", "0 deg", "0 deg"], (0.01, 0.02)),
        (["90 deg", "0 deg", "0 deg"], (0.03, 0.01)),
        (["0 deg", "90 deg", "0 deg"], (0.02, 0.03)),
    ],
)
def test_a_box_shows_the_face_that_is_seen_most(rotation: list[str], size: tuple[float, float]) -> None:
    face, _ = face_of({"type": "box", "size": ["10 mm", "20 mm", "30 mm"], "rotation": rotation})
    assert face.size == pytest.approx(size)
    assert face.normal == pytest.approx((0, 0, 1), abs=1e-12)


def test_parts_have_the_circles_of_their_top() -> None:
    """The washer's two; of the plate the largest of three holes; the nut's hole."""
    scene = load_scene(CELLS / "ring.toml")
    targets = {target.name: target for target in scene.targets}
    washer = face_towards(scene.camera, targets["washer"])
    # The outlines are polygons of 96 sides, whose corners lie on 24 and 13 mm; what is seen is their area.
    turn = 2 * math.pi / 96
    as_seen = math.sqrt(math.sin(turn) / turn)
    assert [2 * rim.radius for rim in rings(washer)] == pytest.approx([0.024 * as_seen, 0.013 * as_seen], rel=1e-6)
    assert 0.024 * (1 - as_seen) == pytest.approx(8.6e-6, abs=5e-8)
    assert [(rim.radius, rim.below) for rim in washer.far_rims] == [
        (pytest.approx(rim.radius), pytest.approx(0.0025)) for rim in washer.rims
    ]
    assert washer.origin[2] == pytest.approx(0.00255)
    middle = washer.to_image(scene.camera, np.array([washer.rims[0].centre]))[0]
    expected = project(scene.camera, np.array([[0.022, -0.018, 0.00255]]))[0][0]
    assert middle == pytest.approx(expected, abs=1e-3)
    plate = face_towards(scene.camera, targets["plate"])
    assert len(plate.rims) == 3 and len(rings(plate)) == 1
    assert plate.rims[0].radius == pytest.approx(0.007 * as_seen, rel=1e-6)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({"type": "sphere", "diameter": "20 mm"}, "no flat face"),
        (
            {"type": "cylinder", "diameter": "20 mm", "length": "40 mm", "rotation": ["90 deg", "0 deg", "0 deg"]},
            "side",
        ),
    ],
)
def test_what_shows_no_face_is_refused(target: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        face_of(target)


def test_what_is_behind_the_camera_has_no_image() -> None:
    face, camera = face_of({"type": "disc", "diameter": "30 mm"})
    far = np.array([[0.0, 0.0]])
    turned = Face(np.array([0, 0, 1.0]), face.axes)
    assert np.isnan(turned.to_image(camera, far)).all()
    assert np.isnan(turned.from_image(camera, np.array([[12.0, 10.0]]))).all()
    assert math.isfinite(face.to_image(camera, far)[0, 0])
