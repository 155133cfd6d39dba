"""A camera from several views: exact points, spreads of repeated calibrations, and what the command says."""

from __future__ import annotations

import csv
import json
import math
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.calibrate.camera_model import turn
from radwrap.calibrate.opencv_views import project_points
from radwrap.calibrate.projection_uncertainty import projection_uncertainty
from radwrap.calibrate.several_views import ViewsCalibration, calibrate_views
from radwrap.calibrate.views import MODELS, CalibrationView, DistortionModel
from radwrap.errors import InputError
from radwrap.scene.file.calibration_file import read_intrinsics
from tests.cli.conftest import here

Array = NDArray[np.float64]
SIZE = (1300, 1000)
# fx, fy, cx, cy, and coefficients that a wide lens has; those of rational are far from one that a shorter model gives.
TRUE: dict[DistortionModel, tuple[float, ...]] = {
    "brown": (-0.2, 0.1, 0.001, -0.0005, 0.02),
    "rational": (0.9, 0.3, 0.001, -0.0005, 0.1, 1.4, 0.2, -0.3),
    "thin_prism": (-0.2, 0.1, 0.001, -0.0005, 0.02, 0, 0, 0, 0.004, -0.002, 0.003, 0.001),
}
NOISE = 0.1  # px
MATRIX = (1100.0, 1090.0, 655.0, 495.0)


def camera_of(model: DistortionModel) -> Array:
    camera = np.zeros(16)
    camera[:4] = MATRIX
    camera[4 : 4 + len(TRUE[model])] = TRUE[model]
    return camera


def board() -> Array:
    """10 x 8 points, 20 mm apart, beside the frame's origin and tilted in it."""
    x, y = np.meshgrid(np.arange(10) * 0.02, np.arange(8) * 0.02)
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return np.asarray(flat @ turn(np.array([0.2, -0.3, 0.5]))[0].T + [0.1, -0.2, 0.05])


@cache
def scenes(model: DistortionModel, count: int) -> tuple[tuple[Array, Array], ...]:
    """Poses of boards that fill the image and are tilted, and where their points are seen."""
    rng = np.random.default_rng(7)
    found: list[tuple[Array, Array]] = []
    upright = turn(np.array([0.2, -0.3, 0.5]))[0].T
    while len(found) < count:
        rotation = turn(np.array([*rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.4, 0.4)]))[0]
        vector = rotation_vector(rotation @ upright)
        middle = np.array([rng.uniform(-0.12, 0.12), rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.4)])
        pose = np.array([*vector, *(middle - rotation @ upright @ board().mean(axis=0))])
        seen, _ = project_points(board(), camera_of(model), pose)
        if (seen > 0).all() and (seen < SIZE).all():
            found.append((pose, seen))
    return tuple(found)


def rotation_vector(rotation: Array) -> Array:
    angle = math.acos((np.trace(rotation) - 1) / 2)
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return np.asarray(skew * angle / (2 * math.sin(angle)))


def calibrated(model: DistortionModel, count: int, noise: float = 0.0, seed: int = 0) -> ViewsCalibration:
    rng = np.random.default_rng(seed)
    views = [
        CalibrationView(board(), seen + noise * rng.standard_normal(seen.shape), str(k))
        for k, (_, seen) in enumerate(scenes(model, count))
    ]
    return calibrate_views(views, SIZE, model=model)


@pytest.mark.parametrize("model", MODELS)
def test_exact_points_give_the_camera_back(model: DistortionModel) -> None:
    found = calibrated(model, 12)
    camera = camera_of(model)
    m = found.camera_matrix
    # Round-off of points, 1e-13 px, times the condition of the model: rational's coefficients lean on each other.
    close = 1e-5 if model == "rational" else 1e-8
    assert [m[0, 0], m[1, 1], m[0, 2], m[1, 2]] == pytest.approx(MATRIX, rel=close)
    assert found.distortion_coefficients == pytest.approx(camera[4 : 4 + len(TRUE[model])], abs=close)
    for view, (pose, _) in zip(found.views, scenes(model, 12), strict=True):
        assert view.rotation == pytest.approx(turn(pose[:3])[0], abs=close)
        assert view.translation == pytest.approx(pose[3:], abs=close)
        middle = turn(pose[:3])[0] @ board().mean(axis=0) + pose[3:]
        assert view.distance == pytest.approx(np.linalg.norm(middle), abs=close)
    assert found.rms < 1e-9


def test_a_target_in_space_needs_no_plane() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (40, 3))
    views = []
    for k in range(5):
        pose = np.array([0.4 * math.cos(k), 0.4 * math.sin(k), 0.3 * k, 0.01 * k, -0.01 * k, 0.5 + 0.05 * k])
        views.append(CalibrationView(points, project_points(points, camera_of("brown"), pose)[0], f"view {k}"))
    found = calibrate_views(views, SIZE)
    assert found.distortion_coefficients == pytest.approx(TRUE["brown"], abs=1e-7)


def check_spread(model: DistortionModel, count: int, repeats: int, views: int) -> None:
    """Standard errors of parameters, poses and projections are those of repeated calibrations."""
    camera, poses = camera_of(model), [pose for pose, _ in scenes(model, views)]
    free = [
        0,
        1,
        2,
        3,
        *(4 + k for k in range(12) if ("k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4".split()[k] in MODELS[model])),
    ]
    places = np.array([[650.0, 500.0], [100.0, 900.0]])
    near = 0.3
    truth = exact_places(camera, places)
    z, shifts, expected = [], {near: [], math.inf: []}, {near: [], math.inf: []}
    for seed in range(repeats):
        found = calibrated(model, views, NOISE, seed)
        values = np.zeros(16)
        m = found.camera_matrix
        values[:4] = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
        values[4 : 4 + len(found.distortion_coefficients)] = found.distortion_coefficients
        first = found.views[count]
        away = (first.translation - poses[count][3:]) / np.sqrt(np.diag(first.covariance)[3:])
        z.append(np.concatenate([(values - camera)[free] / list(found.sigma.values()), away]))
        for distance in (near, math.inf):
            moved = np.zeros((len(places), 3))
            for view, pose in zip(found.views, poses, strict=True):
                back, there = turn(pose[:3])[0], view.rotation
                if math.isinf(distance):
                    moved += truth @ back @ there.T
                else:
                    moved += (distance * truth - pose[3:]) @ back @ there.T + view.translation
            shown = project_points(moved / len(poses), values, np.zeros(6))[0]
            shifts[distance].append(shown - places)
            expected[distance].append(projection_uncertainty(found, places, distance))
    # A spread by n values is known to 1/sqrt(2 n), and what is pooled here leans on each other: 2.5 of that.
    close = 2.5 / math.sqrt(2 * repeats)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=close)
    for distance in (near, math.inf):
        true = np.mean(np.square(np.array(shifts[distance])), axis=0)
        told = np.mean([np.diagonal(one, axis1=1, axis2=2) for one in expected[distance]], axis=0)
        assert np.sqrt(true.mean() / told.mean()) == pytest.approx(1, abs=close)


def exact_places(camera: Array, image: Array) -> Array:
    """Directions that the true camera sees at pixels, by fixed steps that its small distortion lets arrive."""
    flat = (image - camera[2:4]) / camera[:2]
    for _ in range(200):
        shown = project_points(np.column_stack([flat, np.ones(len(flat))]), camera, np.zeros(6))[0]
        flat -= (shown - image) / camera[:2]
    rays = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def test_standard_errors_are_those_of_repeated_calibrations() -> None:
    check_spread("brown", 2, 40, 8)


@pytest.mark.long
@pytest.mark.parametrize("model", ["brown", "thin_prism"])
def test_standard_errors_of_two_hundred_calibrations(model: DistortionModel) -> None:
    check_spread(model, 2, 200, 20)


def test_the_noise_is_found_and_the_cost_is_never_above_opencvs() -> None:
    costs = []
    for seed in range(5):
        found = calibrated("brown", 8, NOISE, seed)
        # 1280 coordinates: known to 2 %.
        assert found.noise == pytest.approx(NOISE, rel=0.08)
        assert found.gradient_norm < 1e-6
        costs.append(found.cost / found.opencv_cost)
    assert max(costs) <= 1 + 1e-12  # of points in double precision; OpenCV's ends some 1e-9 above
    given = calibrate_views(
        [CalibrationView(board(), seen, str(k)) for k, (_, seen) in enumerate(scenes("brown", 8))], SIZE, noise=1
    )
    assert given.noise == 1 and given.noise_given


def test_head_on_views_do_not_tell_the_focal_length() -> None:
    """It and the distance change alike: without noise there is no minimum, with it a note says so."""
    flat = board() @ turn(np.array([0.2, -0.3, 0.5]))[0]
    flat -= flat.mean(axis=0)
    camera, rng = np.array([*MATRIX, *[0.0] * 12]), np.random.default_rng(1)
    seen = [project_points(flat, camera, np.array([0.0, 0.0, 0.3 * k, 0.0, 0.0, 0.4]))[0] for k in range(4)]
    with pytest.raises(InputError, match=r"no minimum|do not separate"):
        calibrate_views([CalibrationView(flat, image, str(k)) for k, image in enumerate(seen)], SIZE)
    noisy = [
        CalibrationView(flat, image + NOISE * rng.standard_normal(image.shape), str(k)) for k, image in enumerate(seen)
    ]
    assert "the focal length is known to" in calibrate_views(noisy, SIZE).notes[0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda p, q: (p[:3], q[:3]), "3 points, 4 are needed"),
        (lambda p, q: (p, np.where(np.arange(len(q))[:, None] == 5, np.nan, q)), "NaN or infinity"),
        (lambda p, q: (p, q[:-1]), "as many rows"),
    ],
)
def test_a_wrong_view_is_named(change: object, told: str) -> None:
    points, image = change(board(), scenes("brown", 1)[0][1])  # type: ignore[operator]
    with pytest.raises(InputError, match=told) as failure:
        CalibrationView(points, image, "left")
    assert failure.value.where == "view left"


def test_too_few_views_a_line_and_names_twice_are_refused() -> None:
    _, seen = scenes("brown", 1)[0]
    with pytest.raises(InputError, match="more than 15 are needed"):
        calibrate_views([CalibrationView(board()[:7], seen[:7], "a")], SIZE)
    with pytest.raises(InputError, match="on one line"):
        line = np.outer(np.arange(20.0), [1, 2, 3])
        calibrate_views([CalibrationView(line, rng_places(), "a")], SIZE)
    with pytest.raises(InputError, match="names that differ"):
        calibrate_views([CalibrationView(board(), seen, "a")] * 2, SIZE)


def test_what_cannot_be_so_is_named() -> None:
    views = [CalibrationView(board(), seen, f"v{k}") for k, (_, seen) in enumerate(scenes("brown", 4))]
    good = views[1].image
    for wrong, told in (
        (CalibrationView(board(), good, "w"), "is view v1 again"),
        (CalibrationView(board(), good + np.array([900, 0]), "w"), "outside of 1300 x 1000 pixels"),
        (CalibrationView(board()[[0, 0, 1, 10, 11]], good[[0, 0, 1, 10, 11]], "w"), "a point twice"),
        (CalibrationView(board()[:10], good[:10], "w"), "lie on one line"),
        (CalibrationView(board() + 1e9 * (np.arange(80) == 3)[:, None], good, "w"), "m from the others"),
    ):
        with pytest.raises(InputError, match=told) as failure:
            calibrate_views([*views, wrong], SIZE)
        assert failure.value.where == "view w"


def test_a_mirrored_target_in_space_is_behind_the_camera() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (40, 3))
    views = []
    for k in range(5):
        pose = np.array([0.4 * math.cos(k), 0.4 * math.sin(k), 0.3 * k, 0.01 * k, -0.01 * k, 0.5 + 0.05 * k])
        seen = project_points(points, np.array([*MATRIX, *[0.0] * 12]), pose)[0]
        views.append(CalibrationView(points, (SIZE[0] - 1 - seen[:, 0])[:, None] * [1, 0] + seen * [0, 1], str(k)))
    with pytest.raises(InputError, match=r"behind the camera|no minimum"):
        calibrate_views(views, SIZE)


def rng_places() -> Array:
    return np.asarray(np.random.default_rng(2).uniform(0, 900, (20, 2)))


def table(path: Path, *, noise: float = NOISE) -> Path:
    rng = np.random.default_rng(1)
    with path.open("w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(["u", "v", "view", "x", "y", "z"])
        for k, (_, seen) in enumerate(scenes("brown", 8)):
            for (x, y, z), (u, v) in zip(board() * 1e3, seen + noise * rng.standard_normal(seen.shape), strict=True):
                lines.writerow([u, v, f"image {k}.png", x, y, z])
    return path


def test_the_command_takes_a_table_of_views(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["calibrate", "camera", table(tmp_path / "all views.csv"), "--length-unit", "mm", "--image-size", *SIZE]
    lines = here(asked, capsys).success().stdout
    assert "640 points in 8 views, model brown" in lines and "at infinity: +-" in lines
    told = json.loads(here([*asked, "--json"], capsys).success().stdout)
    assert told["camera_matrix"][0][0] == pytest.approx(MATRIX[0], abs=5 * told["sigma"]["fx"])
    assert np.shape(told["covariance"]) == (9, 9) and told["parameters"][4] == "k1"
    assert [view["view"] for view in told["views"]] == [f"image {k}.png" for k in range(8)]
    near, far = told["projection_uncertainty"]
    assert far["distance"] is None and near["distance"] == pytest.approx(0.35, abs=0.15)
    assert np.shape(near["sigma_px"]) == (len(near["rows"]), len(near["columns"]))
    pictures = [tmp_path / f"{name} map.png" for name in "ab"]
    for picture in pictures:
        here([*asked, "--picture", picture], capsys).success()
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
    assert cv2.imread(str(pictures[0])).std() > 10
    # The middle is seen by many points: it is known better than the corners.
    assert near["sigma_px"][3][4] < min(near["sigma_px"][0][0], near["sigma_px"][-1][-1])


def test_a_scene_reads_what_the_command_has_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = [
        "calibrate",
        "camera",
        table(tmp_path / "views.csv"),
        "--length-unit",
        "mm",
        "--image-size",
        *SIZE,
        "--json",
    ]
    text = here(asked, capsys).success().stdout
    (tmp_path / "camera.json").write_text(text)
    read, told = read_intrinsics(tmp_path / "camera.json", "camera.calibration"), json.loads(text)
    assert list(read.coefficients[:5]) == told["distortion_coefficients"]
    assert read.focal_lengths == (told["camera_matrix"][0][0], told["camera_matrix"][1][1])
    assert read.size == SIZE


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ([], "--image-size: is needed"),
        (["--image-size", "1300", "1000", "--pixel-width", "5 um"], "--pixel-width: belongs to a table of one view"),
        (["--image-size", "0", "1000"], "--image-size: must be"),
        (["--image-size", "1300", "1000", "--solver", "opencv"], "--solver: belongs"),
    ],
)
def test_options_of_the_other_kind_are_refused(
    more: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = here(["calibrate", "camera", table(tmp_path / "views.csv"), *more], capsys)
    assert done.code == 2 and told in done.stderr


def test_a_wrong_table_names_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "views.csv"
    asked = ["calibrate", "camera", path, "--image-size", 640, 480]
    for text, told in (
        ("view,x,y,z,u,v\na,1,2,3,4\n", "views.csv:2: holds 5 values"),
        ("view,x,y,z,u,v\n ,1,2,3,4,5\n", "views.csv:2: the view has no name"),
        ("view,x,y,z,u,v\na,1,2,3,nan,5\n", "views.csv:2: u nan"),
        ("view,x,y,z,u,v\na,1,2,3,4,5\n", "views.csv: view a: holds 1 points"),
        ("view,x,y,z,u,v\n", "views.csv: views: 0 coordinates"),
        ("view,view,x,y,z,u,v\n", "views.csv:1: the header"),
    ):
        path.write_text(text)
        done = here(asked, capsys)
        assert done.code == 2 and told in done.stderr, done.stderr
    path.write_text("x,y,z,u,v\n1,2,3,4,5\n")
    assert "--image-size: belongs to a table of several views" in here(asked, capsys).stderr
    assert "--pixel-width: is needed" in here(asked[:3], capsys).stderr


def test_the_same_points_give_the_same_bytes() -> None:
    """OpenCV's threads would add up in any order."""
    found = [calibrated("brown", 6, NOISE, 3) for _ in range(4)]
    assert len({one.covariance.tobytes() + one.camera_matrix.tobytes() for one in found}) == 1
