"""What the scene knows of a rim: its true size, and where the side of a thick part is taken for it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import radwrap
from radwrap.scene.file.load import load_scene
from radwrap.study.placed_calipers import RimPlace, aspect_of, named_face, rim_places, side_warnings

TEMPLATES = Path(radwrap.__file__).parent / "data" / "templates"
HIGH, DISTANCE = 2.5, 300.0 - 2.55  # mm: the washer, and its face from the camera


def washer_places(folder: Path, x: float, y: float) -> dict[str, RimPlace]:
    shutil.copy(TEMPLATES / "washer.obj", folder)
    shutil.copy(TEMPLATES / "backlight.toml", folder)
    scene = load_scene(folder / "backlight.toml", {"targets[0].position": [f"{x} mm", f"{y} mm", "0.05 mm"]})
    return dict(rim_places(scene.camera, named_face(scene, "washer"), aspect_of(scene.camera)))


def test_the_far_rim_of_a_hole_seems_smaller_in_the_plane_of_the_face(tmp_path: Path) -> None:
    """By similar triangles; the outer wall is hidden behind the face."""
    for x, y in ((0.0, 0.0), (4.0, -3.0)):
        places = washer_places(tmp_path, x, y)
        true = places["inner"].true_diameter
        assert true is not None
        assert places["inner"].with_side == pytest.approx(true * DISTANCE / (DISTANCE + HIGH), rel=1e-6)
        assert places["outer"].with_side is None


def test_seen_from_aside_both_rims_bound_the_hole(tmp_path: Path) -> None:
    """The far rim moves by more than it shrinks: two circles of radii r and s, d apart, of which the hole is common."""
    places = washer_places(tmp_path, 30.0, 0.0)
    true, seen = places["inner"].true_diameter, places["inner"].with_side
    assert true is not None and seen is not None
    shrunk = true * DISTANCE / (DISTANCE + HIGH)
    shift = 30e-3 * (1 - DISTANCE / (DISTANCE + HIGH))
    assert shift > (true - shrunk) / 2
    assert shrunk - shift < seen < shrunk, "cut on one side by the near rim"
    outer = places["outer"]
    assert outer.true_diameter is not None and outer.with_side is not None
    assert outer.with_side > outer.true_diameter, "its wall is seen"


@pytest.mark.parametrize(
    ("measured", "error", "warned"),
    [(13.0, 1e-4, False), (12.99, 1e-4, False), (12.96, 1e-4, True), (12.89, 1e-4, True), (12.89, 0.05, False)],
)
def test_a_warning_where_the_far_rim_was_measured(measured: float, error: float, warned: bool) -> None:
    place = RimPlace((0.0, 0.0), 40.0, 13e-3, 12.89e-3)
    assert bool(side_warnings(place, measured * 1e-3, error * 1e-3)) == warned


def test_a_rim_beyond_the_near_one_is_not_the_sides() -> None:
    assert not side_warnings(RimPlace((0.0, 0.0), 40.0, 13e-3, 12.89e-3), 13.1e-3, 1e-7)
    assert not side_warnings(RimPlace((0.0, 0.0), 40.0, 13e-3), 12.9e-3, 1e-7)
