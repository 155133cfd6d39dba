"""A lens that distorts: OpenCV as the oracle of places, flux conserved, calibrations of real cameras."""

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import radwrap
from radwrap.cli.main import main
from radwrap.imaging.optics.view import stretched_rays
from radwrap.measure.dots import find_dots
from radwrap.scene.camera import Camera
from radwrap.scene.distortion import Distortion, bounded, opencv_distortion
from radwrap.scene.look.geometry import directions, project
from tests.physics.conftest import Bench

ROUND_TRIP = 1e-9  # px, asked for; on a sensor of 5000 px focal length
FOCAL_PX = 5000.0
SETS: dict[str, tuple[float, ...]] = {
    "barrel": (-0.25, 0.08, 1e-3, -8e-4, 0.01),
    "pincushion": (0.3, -0.1, 0.0, 0.0),
    "prism": (-0.2, 0.05, 1e-3, -5e-4, 0.0, 0.0, 0.0, 0.0, 0.02, -0.01, -0.015, 0.02),
    "rational": (-0.3, 0.1, 1e-3, 1e-3, 0.0, 0.05, -0.02, 0.01),
}
PITCH, COLUMNS, ROWS = 5e-5, 160, 120


def places(radius: float) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    r, a = radius * np.sqrt(random.random(20_000)), 2 * math.pi * random.random(20_000)
    return r * np.cos(a), r * np.sin(a)


def by_opencv(x: np.ndarray, y: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    points = np.column_stack([x, y, np.ones_like(x)])
    image, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(coefficients))
    return np.asarray(image).reshape(-1, 2)


@pytest.mark.parametrize("name", SETS)
def test_places_are_opencvs_and_the_round_trip_is_exact(name: str) -> None:
    distortion = bounded(opencv_distortion(SETS[name]), 0.5, "distortion")
    x, y = places(0.5)
    u, v, _ = distortion.undistorted(x, y)
    assert np.abs(by_opencv(u, v, SETS[name]) - np.column_stack([x, y])).max() * FOCAL_PX < ROUND_TRIP
    back = np.column_stack(distortion.distorted(u, v))
    assert np.abs(back - np.column_stack([x, y])).max() * FOCAL_PX < ROUND_TRIP


@pytest.mark.parametrize(
    ("values", "corner"),
    [
        ((0.3945, 0.0858, 0.0024, -0.0015, -0.3118), 1.079),
        ((0.3457, 0.0818, 0.0, 0.0, -0.3239), 1.044),
        ((0.5808, -0.4003, 0.003, -0.0027, -0.0452), 1.087),
    ],
)
def test_where_newton_goes_astray_the_round_trip_is_exact_too(values: tuple[float, ...], corner: float) -> None:
    """Near a fold Newton's method from the distorted place diverges, or ends on another branch."""
    distortion = bounded(opencv_distortion(values), corner, "distortion")
    x, y = places(corner)
    u, v, ratio = distortion.undistorted(x, y)
    assert np.hypot(u, v).max() <= distortion.limit * (1 + 1e-9)
    assert (ratio > 0).all()
    assert np.abs(by_opencv(u, v, values) - np.column_stack([x, y])).max() * FOCAL_PX < ROUND_TRIP


@pytest.mark.parametrize("name", SETS)
def test_areas_change_as_the_places_do(name: str) -> None:
    """Derivatives of the places, by central differences that are off by the square of their step."""
    distortion, step = opencv_distortion(SETS[name]), 1e-6
    x, y = places(0.4)
    found = distortion.opencv(x, y)[2]
    for column, (right, down) in enumerate(((step, 0.0), (0.0, step))):
        ahead, behind = (distortion.opencv(x + sign * right, y + sign * down) for sign in (1, -1))
        for row in (0, 1):
            assert np.abs((ahead[row] - behind[row]) / (2 * step) - found[row, column]).max() < 1e-8


def test_a_place_that_no_direction_has_is_refused_by_name() -> None:
    with pytest.raises(radwrap.InputError, match=r"camera\.distortion: .*cannot be inverted"):
        opencv_distortion((0.0, 0.0, 0.0, 0.0, 0.0, 1.0)).undistorted(np.array([5.0]), np.array([0.0]))


@pytest.mark.parametrize("kappa", [-0.3, -0.01, 0.4])
def test_tsai_undistorts_and_the_round_trip_is_exact(kappa: float) -> None:
    distortion = bounded(Distortion("tsai", (kappa,)), 0.5, "distortion")
    x, y = places(0.5)
    u, v, _ = distortion.undistorted(x, y)
    assert np.hypot(u, v) == pytest.approx(np.hypot(x, y) * (1 + kappa * (x**2 + y**2)), rel=1e-14)
    back = np.column_stack(distortion.distorted(u, v))
    assert np.abs(back - np.column_stack([x, y])).max() * FOCAL_PX < ROUND_TRIP


@pytest.mark.parametrize("name", SETS)
def test_beyond_its_limit_it_goes_on_and_stays_outside(name: str) -> None:
    """What lies far beside the image must not come back into it, as the bare polynomial would have it."""
    distortion = bounded(opencv_distortion(SETS[name]), 0.5, "distortion")
    x = np.linspace(0, 50, 2000)
    radius = np.hypot(*distortion.distorted(x, 0.3 * x))
    assert np.isfinite(radius).all()
    assert radius[x > distortion.limit].min() > 0.5
    assert np.isfinite(np.stack(distortion.undistorted(x, -0.3 * x))).all()


def test_at_its_limit_each_direction_is_inverted() -> None:
    """Tangential terms reach least far in a direction between those in which the limit is looked for."""
    random = np.random.default_rng(3)
    angle = np.linspace(0, 2 * math.pi, 5000)
    for _ in range(20):
        k1, k2, p1, p2 = random.uniform(-1, 1, 4) * (0.3, 0.3, 0.02, 0.02)
        distortion = bounded(opencv_distortion((k1, k2, p1, p2)), 0.5, "distortion")
        x, y = (distortion.distorted_limit * wave for wave in (np.cos(angle), np.sin(angle)))
        u, v, _ = distortion.undistorted(x, y)
        assert np.hypot(u, v).max() <= distortion.limit * (1 + 1e-9)
        back = np.column_stack(distortion.distorted(u, v))
        assert np.abs(back - np.column_stack([x, y])).max() * FOCAL_PX < ROUND_TRIP


def camera_with(bend: dict[str, Any] | None, **more: Any) -> Camera:
    return board(bend, **more).camera


def board(bend: dict[str, Any] | None, tilt: str = "0 deg", **more: Any) -> radwrap.Scene:
    """A board of small bright dots that fills the picture."""
    view = Bench.camera(**{"rows": ROWS, "columns": COLUMNS, "pitch": (PITCH, PITCH)} | more)
    view |= {"exposure_time": "1 s"} | ({} if bend is None else {"distortion": bend})
    # Peak near 6000 of 65535.
    view["sensor"] |= {"gain": "5e5 (J/m^2)^-1"}
    target = {
        **{"type": "board", "name": "board", "material": "black", "dot_material": "white", "rotation": [tilt] * 3},
        **{"rows": 5, "columns": 7, "pitch": "90 mm", "dot_diameter": "44 mm"},
    }
    materials = {name: {"type": "lambertian", "reflectance": r} for name, r in (("black", 0.02), ("white", 0.9))}
    return Bench.scene(view, [Bench.lamp((0.0, 0.0, 1.5), half_angle=50.0)], materials, [target])


BARREL = {"model": "opencv", "k1": -0.25, "k2": 0.08, "p1": 1e-3, "p2": -8e-4, "k3": 0.01}


def test_dots_are_seen_where_opencv_projects_them() -> None:
    """Contours, which light that falls off to the sides does not draw inwards as it does centroids (0.08 px)."""
    scene = board(BARREL, aperture={"diameter": "0 mm"})
    image = radwrap.render(scene, method="pinhole", pixel_samples=3).gray
    found = find_dots(image, 5, 7, dark=0.0, method="ellipse")
    matrix = np.array([[200.0, 0, (COLUMNS - 1) / 2], [0, 200.0, (ROWS - 1) / 2], [0, 0, 1]])
    errors, moved = [], []
    for dot in found.dots:
        x, y = (dot.column - 3) * 0.09, (2 - dot.row) * 0.09
        point = np.array([[x, -y, 1.0]])  # camera frame: y down, 1 m away
        for coefficients, store in ((SETS["barrel"], errors), (np.zeros(5), moved)):
            place, _ = cv2.projectPoints(point, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))
            store.append(np.asarray(place).ravel() - (dot.u, dot.v))
    assert float(np.abs(moved).max()) > 1.0
    assert float(np.abs(errors).max()) < 0.06
    assert float(np.sqrt(np.mean(np.square(errors)))) < 0.02


def test_flux_is_conserved() -> None:
    """An even field: what falls on a disc of the sensor is what passes its undistorted image."""
    kappa, f = -3000.0, 0.01  # -0.3 in units of f
    camera = camera_with({"model": "tsai", "kappa1": f"{kappa} 1/m^2"}, focal_length=f)
    cells = 1000
    radius = 0.003
    side = 2 * radius / cells
    grid = (np.arange(cells) + 0.5) * side - radius
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    inside = np.hypot(x, y) <= radius
    u, v = x[inside] / PITCH + camera.principal_point[0], y[inside] / PITCH + camera.principal_point[1]
    _, cos4, stretch = stretched_rays(camera, (0.0, 0.0), u, v)
    assert stretch is not None
    undistorted = radius * (1 + kappa * radius**2)
    expected = math.pi * undistorted**2 * f**2 / (undistorted**2 + f**2)
    # The disc's rim goes through cells of 1/500 of the radius: some 1e-5 of its area.
    assert float((cos4 * stretch).sum()) * side**2 == pytest.approx(expected, rel=1e-4)


@pytest.mark.long
def test_kernel_rays_and_viewpoints_agree_through_a_lens_that_distorts() -> None:
    """The kernel gathers on the bent image, where the opening's shape is bent too: its certificate tells."""
    scene = board(BARREL, aperture={"diameter": "0.6 mm"}, rows=36, columns=48, pitch=(PITCH * 10 / 3,) * 2)
    scene = radwrap.with_value(scene, "camera.sensor.gain", "5e6 (J/m^2)^-1")
    asked: dict[str, dict[str, Any]] = {
        "rays": {"method": "rays", "tolerance": 20.0},
        "kernel": {"method": "kernel", "tolerance": 20.0},
        "viewpoints": {"viewpoints": 19, "pixel_samples": 2},
    }
    made = {method: radwrap.render(scene, **options) for method, options in asked.items()}
    assert made["rays"].gray.values.max() > 600
    bounds = {method: result.manifest["error"]["rms_gray_upper95"] for method, result in made.items()}
    assert max(bounds["rays"], bounds["kernel"]) < 40
    for method in ("kernel", "viewpoints"):
        difference = made[method].gray.values - made["rays"].gray.values
        assert float(np.sqrt(np.mean(difference**2))) < bounds[method] + bounds["rays"]


def test_directions_and_project_are_inverse() -> None:
    camera = camera_with(BARREL)
    uv = np.array([[0.0, 0.0], [159.0, 119.0], [80.0, 3.0], [-0.5, 119.5]])
    points = np.asarray(camera.pose.position) + 3.0 * directions(camera, uv)
    back, depth = project(camera, points)
    assert (depth > 0).all()
    assert back == pytest.approx(uv, abs=ROUND_TRIP)


# -------------------------------------------------------------------------------------------------- Calibration files


def opencv_file(path: Path, **changes: Any) -> None:
    values: dict[str, Any] = {
        "image_width": COLUMNS,
        "image_height": ROWS,
        "camera_matrix": np.array([[201.0, 0, 77.3], [0, 200.0, 61.9], [0, 0, 1]]),
        "distortion_coefficients": np.array([SETS["barrel"]]),
    } | changes
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        if value is not None:
            storage.write(key, value)
    storage.release()


def document(**camera: Any) -> dict[str, Any]:
    made = json.loads(board(None).document)
    for key in ("focal_length", "principal_point"):
        made["camera"].pop(key, None)
    made["camera"] |= {"calibration": "camera.yml"} | camera
    return {key: value for key, value in made.items() if value is not None}


@pytest.mark.parametrize("name", ["camera.yml", "camera.xml", "camera.json"])
def test_an_opencv_calibration_gives_opencvs_places(name: str, tmp_path: Path) -> None:
    opencv_file(tmp_path / name)
    camera = radwrap.scene_from_document(document(calibration=name), folder=tmp_path).camera
    random = np.random.default_rng(2)
    local = np.column_stack([random.uniform(-0.3, 0.3, (50, 2)), np.ones(50)]) * random.uniform(0.5, 2, (50, 1))
    matrix = np.array([[201.0, 0, 77.3], [0, 200.0, 61.9], [0, 0, 1]])
    expected, _ = cv2.projectPoints(local, np.zeros(3), np.zeros(3), matrix, np.array(SETS["barrel"]))
    world = np.asarray(camera.pose.position) + local @ np.asarray(camera.pose.rotation).T
    assert project(camera, world)[0] == pytest.approx(np.asarray(expected).reshape(-1, 2), abs=ROUND_TRIP)
    assert camera.focal_length == pytest.approx(200 * PITCH)
    assert camera.sensor.pixel_height == PITCH


def test_a_calibrated_lens_has_the_files_image_distance_and_is_sharp_where_it_is_focused(tmp_path: Path) -> None:
    opencv_file(tmp_path / "camera.yml")
    lens = {"focus_distance": "500 mm"}
    made = document(lens=lens, aperture={"diameter": "4 mm"})
    camera = radwrap.scene_from_document(made, folder=tmp_path).camera
    assert camera.image_distance == pytest.approx(200 * PITCH, rel=1e-14)
    # At the focused distance all points of the opening see one point, where OpenCV puts it.
    random = np.random.default_rng(2)
    local = np.column_stack([random.uniform(-0.15, 0.15, (50, 2)), np.full(50, 0.5)])
    matrix = np.array([[201.0, 0, 77.3], [0, 200.0, 61.9], [0, 0, 1]])
    expected, _ = cv2.projectPoints(local, np.zeros(3), np.zeros(3), matrix, np.array(SETS["barrel"]))
    rotation, position = np.asarray(camera.pose.rotation), np.asarray(camera.pose.position)
    uv, _ = project(camera, position + local @ rotation.T)
    assert uv == pytest.approx(np.asarray(expected).reshape(-1, 2), abs=ROUND_TRIP)
    for opening in ((0.0, 0.0), (0.002, 0.0), (-0.001, 0.0015)):
        rays, _, stretch = stretched_rays(camera, opening, uv[:, 0], uv[:, 1])
        assert stretch is not None
        seen = (rays[:, :3] - position) @ rotation
        direction = rays[:, 3:] @ rotation
        met = seen + direction * (0.5 / direction[:, 2])[:, np.newaxis]
        assert met == pytest.approx(local, abs=1e-12)


def test_other_names_and_plain_lists_are_read(tmp_path: Path) -> None:
    text = """%YAML:1.0
---
image_width: 160
image_height: 120
camera_matrix: { rows: 3, cols: 3, data: [201., 0., 77.3, 0., 200., 61.9, 0., 0., 1.] }
distortion_model: plumb_bob
distortion_coefficients: { rows: 1, cols: 5, data: [-0.25, 0.08, 0.001, -0.0008, 0.01] }
"""
    (tmp_path / "camera.yml").write_text(text)
    opencv_file(tmp_path / "other.yml")
    cameras = [
        radwrap.scene_from_document(document(calibration=name), folder=tmp_path).camera
        for name in ("camera.yml", "other.yml")
    ]
    assert cameras[0] == cameras[1]


def test_our_own_calibration_of_a_thin_prism_is_read(tmp_path: Path) -> None:
    """As `radwrap calibrate camera --model thin_prism --json` writes it."""
    told = {
        "model": "thin_prism",
        "image_width": 160,
        "image_height": 120,
        "camera_matrix": [[201.0, 0.0, 77.3], [0.0, 200.0, 61.9], [0.0, 0.0, 1.0]],
        "distortion_coefficients": list(SETS["prism"]),
    }
    (tmp_path / "camera.json").write_text(json.dumps(told))
    camera = radwrap.scene_from_document(document(calibration="camera.json"), folder=tmp_path).camera
    assert camera.distortion is not None and camera.distortion.coefficients == SETS["prism"]
    random = np.random.default_rng(3)
    local = np.column_stack([random.uniform(-0.3, 0.3, (50, 2)), np.ones(50)])
    expected, _ = cv2.projectPoints(
        local, np.zeros(3), np.zeros(3), np.array(told["camera_matrix"]), np.array(SETS["prism"])
    )
    world = np.asarray(camera.pose.position) + local @ np.asarray(camera.pose.rotation).T
    assert project(camera, world)[0] == pytest.approx(np.asarray(expected).reshape(-1, 2), abs=ROUND_TRIP)


def test_our_own_calibration_overlays_its_points_pose_included(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = board({"model": "tsai", "kappa1": "-900 1/m^2"}, position=[0.35, -0.3, 0.9], tilt="0 deg").camera
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 6), np.linspace(-0.15, 0.15, 5))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    seen, _ = project(truth, points)
    rows = "\n".join(",".join(map(repr, map(float, row))) for row in np.column_stack([points, seen]))
    (tmp_path / "points.csv").write_text(f"x,y,z,u,v\n{rows}\n")
    sizes = ["--pixel-width", "50 um", "--pixel-height", "50 um", "--centre", "79.5", "59.5"]
    words = [str(tmp_path / "points.csv"), *sizes, "--free", "focal_length,distortion", "--json"]
    assert main(["calibrate", "camera", *words]) == 0
    (tmp_path / "camera.json").write_text(capsys.readouterr().out)
    made = document(calibration="camera.json")
    for key in ("position", "look_at"):
        made["camera"].pop(key)
    camera = radwrap.scene_from_document(made, folder=tmp_path).camera
    assert project(camera, points)[0] == pytest.approx(seen, abs=1e-6)  # as well as the solver found it
    assert camera.focal_length == pytest.approx(truth.focal_length, rel=1e-6)
    # With pixels of another size it is another camera.
    made["camera"]["sensor"]["pixel_width"] = "49 um"
    with pytest.raises(radwrap.InputError, match="was made with pixels of 50 x 50 um, the sensor has 49 x 50 um"):
        radwrap.scene_from_document(made, folder=tmp_path)


BAD_FILES: dict[str, tuple[dict[str, Any], str]] = {
    "size": ({"image_width": 640}, "is of pictures of 640 x 120 pixels, the sensor has 160 x 120"),
    "size as text": ({"image_width": "640"}, '"camera.yml": its image_width is not a whole number of 1 or more; write'),
    "size with a point": ({"image_height": 120.0}, "its image_height is not a whole number of 1 or more"),
    "size of nothing": ({"image_height": 0}, "its image_height is not a whole number of 1 or more"),
    "shape": ({"camera_matrix": np.diag([300.0, 200.0, 1.0])}, "times as wide as high"),
    "skew": ({"camera_matrix": np.array([[200.0, 1, 80], [0, 200, 60], [0, 0, 1]])}, "has a skew"),
    "matrix": ({"camera_matrix": np.eye(2)}, r"camera matrix is not \[fx 0 cx"),
    "none": ({"camera_matrix": None}, "holds no camera_matrix"),
    "text": ({"camera_matrix": "wide"}, "is not a matrix of numbers"),
    "nan": ({"camera_matrix": np.array([[np.nan, 0, 80], [0, 200, 60], [0, 0, 1]])}, "not finite"),
    "negative": ({"camera_matrix": np.array([[-200.0, 0, 80], [0, -200, 60], [0, 0, 1]])}, "not above zero"),
    "tilt": ({"distortion_coefficients": np.full((1, 14), 0.01)}, "a tilted sensor"),
    "fisheye": ({"distortion_model": "equidistant"}, '"equidistant" is not expressed'),
    "sample's fisheye": ({"fisheye_model": 1}, '"fisheye" is not expressed'),
    "no fisheye": ({"fisheye_model": 0, "distortion_coefficients": np.array([[-3.0, 0, 0, 0, 0]])}, "folds the image"),
    "other name": (
        {"distortion_coefficients": None, "dist_coeffs": np.zeros((1, 5))},
        '"dist_coeffs" is not a known name',
    ),
    "fold": ({"distortion_coefficients": np.array([[-3.0, 0, 0, 0, 0]])}, "folds the image over"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_calibrations_are_one_clear_error(name: str, tmp_path: Path) -> None:
    changes, message = BAD_FILES[name]
    opencv_file(tmp_path / "camera.yml", **changes)
    with pytest.raises(radwrap.InputError, match=message) as error:
        radwrap.scene_from_document(document(), folder=tmp_path)
    assert "camera." in error.value.where


@pytest.mark.parametrize("text", ["", "garbage [", "%YAML:1.0\n---\na: [1,\n", "{", '{"kappa1": 1}', "\0\1"])
def test_what_is_no_calibration_is_one_clear_error(text: str, tmp_path: Path) -> None:
    (tmp_path / "camera.yml").write_text(text)
    with pytest.raises(radwrap.InputError, match=r'camera\.calibration: "camera\.yml"'):
        radwrap.scene_from_document(document(), folder=tmp_path)


BAD_SCENES: dict[str, tuple[dict[str, Any], str]] = {
    "both": ({"focal_length": "10 mm"}, r"camera\.focal_length: is in the calibration too"),
    "bend": ({"distortion": BARREL}, r"camera\.distortion: is in the calibration too"),
    "absent": ({"calibration": "none.yml"}, r'camera\.calibration: no file "none\.yml"'),
    "outside": ({"calibration": "/etc/passwd"}, r"camera\.calibration: .*outside the scene's folder"),
}


@pytest.mark.parametrize("name", BAD_SCENES)
def test_scenes_that_do_not_fit_their_calibration(name: str, tmp_path: Path) -> None:
    changes, message = BAD_SCENES[name]
    opencv_file(tmp_path / "camera.yml")
    with pytest.raises(radwrap.InputError, match=message):
        radwrap.scene_from_document(document(**changes), folder=tmp_path)


BAD_BENDS: dict[str, tuple[dict[str, Any], str]] = {
    "tsai": ({"model": "tsai"}, r"camera\.distortion: kappa1 goes with"),
    "unit": ({"model": "tsai", "kappa1": -900}, r"camera\.distortion\.kappa1: -900 has no unit"),
    "mixed": ({"model": "tsai", "kappa1": "1 1/m^2", "k1": 0.1}, r'camera\.distortion: k1 goes with model = "opencv"'),
    "unknown": ({"model": "opencv", "k7": 0.1}, r"camera\.distortion\.k7: unknown key"),
    "nan": ({"model": "opencv", "k1": math.nan}, r"camera\.distortion\.k1: is not a finite number"),
    "fold": ({"model": "opencv", "k1": -3.0}, r"camera\.distortion: the distortion folds the image over at \d+%"),
    "fold by tsai": ({"model": "tsai", "kappa1": "-3e4 1/m^2"}, r"camera\.distortion: the distortion folds"),
}


@pytest.mark.parametrize("name", BAD_BENDS)
def test_bad_distortions_are_one_clear_error(name: str) -> None:
    bend, message = BAD_BENDS[name]
    with pytest.raises(radwrap.InputError, match=message):
        board(bend)


def test_what_cannot_distort_refuses(tmp_path: Path) -> None:
    from radwrap.convert.radiance_files import write_view
    from radwrap.tracers.povray_text import povray_scene
    from radwrap.tracers.text_frame import users_frame

    scene = board(BARREL)
    with pytest.raises(radwrap.InputError, match="Radiance's views have no distortion"):
        write_view(scene, tmp_path / "a.vf")
    with pytest.raises(radwrap.InputError, match="POV-Ray's camera has no distortion"):
        povray_scene(scene, {}, users_frame(scene))


def test_a_bent_edge_is_told_with_its_bow() -> None:
    from radwrap.imaging.truth import geometry

    made = json.loads(board(BARREL).document)
    edge = {"type": "edge", "name": "e", "material": "black", "edge_material": "white", "size": ["600 mm", "400 mm"]}
    made["targets"] = [edge | {"edge_position": "200 mm"}]
    told = geometry(radwrap.scene_from_document(made), ("e",))["targets"]["e"]["edge"]
    assert 0.3 < told["bow"] < 3.0
    made["camera"].pop("distortion")
    assert "bow" not in geometry(radwrap.scene_from_document(made), ("e",))["targets"]["e"]["edge"]
