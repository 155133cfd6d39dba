"""Truth of targets with a pattern: OpenCV's projection, and conics."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radwrap.frames import points_to_local
from radwrap.imaging.truth import geometry
from radwrap.scene.file.load import load_scene
from radwrap.scene.look.geometry import project
from radwrap.scene.scene import Scene
from radwrap.scene.targets import PatternTarget

TARGETS = Path(__file__).parents[2] / "rad_scenes" / "targets"
SAME = 1e-9  # px, asked for
# The matrix of a conic of 1e-3 of its distance loses half the digits to its smallest entry.
CONIC = 1e-7  # px
BENT = {"model": "opencv", "k1": -0.25, "k2": 0.08, "p1": 1e-3, "p2": -8e-4, "k3": 0.01}
PRISM = BENT | {"s1": 0.02, "s2": -0.01, "s3": -0.015, "s4": 0.02}
POINTS = {
    "chessboard": ("corners", 6 * 9),
    "charuco": ("corners", 4 * 6),
    "circles": ("circles", 7 * 9),
    "circles_asymmetric": ("circles", 7 * 4),
}


def scene_of(name: str, **overrides: Any) -> Scene:
    return load_scene(TARGETS / f"{name}.toml", overrides)


def truth_of(scene: Scene) -> dict[str, Any]:
    told: dict[str, Any] = geometry(scene, ())["targets"]["target"]
    json.dumps(told, allow_nan=False)
    return told


def by_opencv(scene: Scene, told: dict[str, Any], places: np.ndarray) -> np.ndarray:
    """Pixels of points of the plate, from the pose that truth tells."""
    camera = scene.camera
    f = camera.image_distance
    u, v = camera.principal_point
    matrix = np.array([[f / camera.sensor.pixel_width, 0, u], [0, f / camera.sensor.pixel_height, v], [0, 0, 1]])
    bent = np.zeros(8) if camera.distortion is None else np.array(camera.distortion.coefficients)
    pose = np.array(told["camera_from_target"])
    points = np.column_stack([places, np.zeros(len(places))]) @ pose[:3, :3].T + pose[:3, 3]
    return np.asarray(cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, bent)[0]).reshape(-1, 2)


@pytest.mark.parametrize("distortion", [None, BENT, PRISM], ids=["straight", "bent", "prism"])
@pytest.mark.parametrize("name", POINTS)
def test_points_are_where_opencv_projects_them(name: str, distortion: dict[str, Any] | None) -> None:
    scene = scene_of(name, **({} if distortion is None else {"camera.distortion": distortion}))
    told = truth_of(scene)
    key, count = POINTS[name]
    points = told[key]
    assert len(points) == count
    assert all(point["in_view"] for point in points)
    image = by_opencv(scene, told, np.array([(point["x"], point["y"]) for point in points]))
    assert np.abs(image - [(point["u"], point["v"]) for point in points]).max() < SAME
    assert [point["row"] for point in points] == sorted(point["row"] for point in points)
    if name == "charuco":
        assert [point["id"] for point in points] == list(range(count))


def test_places_of_circles_are_those_of_opencvs_grid() -> None:
    """((2 column + row % 2) pitch, row pitch), rightwards and down from the first disc."""
    points = truth_of(scene_of("circles_asymmetric"))["circles"]
    first = points[0]
    for point in points:
        assert point["x"] - first["x"] == pytest.approx((2 * point["column"] + point["row"] % 2) * 0.009)
        assert first["y"] - point["y"] == pytest.approx(point["row"] * 0.009)


@pytest.mark.parametrize("name", ["circles", "circles_asymmetric"])
def test_centres_of_ellipses_are_those_of_the_discs_conics(name: str) -> None:
    """The outline of each disc as a conic of the image, by its matrix, and its centre."""
    scene = scene_of(name)
    told = truth_of(scene)
    diameter = 0.005 if name == "circles" else 0.007
    pose = np.array(told["camera_from_target"])
    f = scene.camera.image_distance / scene.camera.sensor.pixel_width
    camera = np.array([[f, 0, scene.camera.principal_point[0]], [0, f, scene.camera.principal_point[1]], [0, 0, 1]])
    plate = camera @ np.column_stack([pose[:3, 0], pose[:3, 1], pose[:3, 3]])
    apart = []
    for point in told["circles"]:
        x, y = point["x"], point["y"]
        circle = np.array([[1, 0, -x], [0, 1, -y], [-x, -y, x * x + y * y - diameter**2 / 4]])
        back = np.linalg.inv(plate)
        conic = back.T @ circle @ back
        centre = np.linalg.solve(conic[:2, :2], -conic[:2, 2])
        assert np.hypot(*(centre - [point["ellipse_u"], point["ellipse_v"]])) < CONIC
        apart.append(np.hypot(*(centre - [point["u"], point["v"]])))
    assert 0.01 < max(apart) < 0.1  # px: what a detector of ellipses is off by


def test_where_the_lens_bends_the_ellipses_centre_is_bent() -> None:
    straight, bent = scene_of("circles"), scene_of("circles", **{"camera.distortion": BENT})
    (point, *_), (other, *_) = truth_of(straight)["circles"], truth_of(bent)["circles"]
    camera = bent.camera
    assert camera.distortion is not None
    ideal = (np.array([point["ellipse_u"], point["ellipse_v"]]) - camera.principal_point) * camera.pitch
    x, y = camera.distortion.distorted(ideal[:1], ideal[1:])
    shown = np.array([x[0], y[0]]) / camera.pitch + camera.principal_point
    assert np.abs(shown - [other["ellipse_u"], other["ellipse_v"]]).max() < SAME


def test_star_and_elements() -> None:
    star = truth_of(scene_of("siemens_star"))["star"]
    assert (star["u"], star["v"]) == pytest.approx((159.5, 127.5), abs=SAME)
    assert (star["spokes"], star["diameter"]) == (36, 0.07)
    scene = scene_of("usaf1951")
    told = truth_of(scene)
    elements = told["elements"]
    assert [(one["group"], one["element"]) for one in elements] == [(g, e) for g in (-2, -1, 0) for e in range(1, 7)]
    assert elements[6]["line_pairs_per_mm"] == pytest.approx(0.5)
    for key in ("upright", "level"):
        image = by_opencv(scene, told, np.array([(one[key]["x"], one[key]["y"]) for one in elements]))
        assert np.abs(image - [(one[key]["u"], one[key]["v"]) for one in elements]).max() < SAME


def test_what_lies_behind_the_camera_is_not_in_view() -> None:
    scene = scene_of("circles")
    (target,) = scene.targets
    assert isinstance(target, PatternTarget)
    behind = replace(scene.camera, pose=replace(scene.camera.pose, position=(0.0, 0.0, -0.3)))
    told = truth_of(replace(scene, camera=behind))
    _, depth = project(behind, np.array([target.pose.position]))
    assert depth[0] < 0 and points_to_local(behind.pose, np.array([target.pose.position]))[0, 2] < 0
    assert not any(point["in_view"] for point in told["circles"])
