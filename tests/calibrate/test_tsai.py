"""Tsai's calibration: closed forms, exact points, standard errors, the true minimum, OpenCV."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2, t

from radwrap.calibrate.camera_model import COLUMNS, FOLD, Camera, derivatives, distort, moved, project, turn
from radwrap.calibrate.tsai import CameraCalibration, as_json, calibrate_camera
from radwrap.calibrate.tsai_refine import refine
from radwrap.manifest import json_text

Array = NDArray[np.float64]

PIXEL = (13.75e-6, 16e-6)
CENTRE = (95.5, 82.0)
EVERYTHING = ("focal_length", "distortion", "centre", "sx")

EXACT = 1e-9  # what exact points must give; round-off of 1e-13 px leaves 1e-14 here
DIFFERENCES = 1e-6  # central differences lose half the digits
FALSE_ALARM = 1e-4  # probability that a statistical test fails although all is well (the seeds are fixed)


def about(axis: int, degrees: float) -> Array:
    """Rotation about one axis, written out."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    about_x = [[1, 0, 0], [0, c, -s], [0, s, c]]
    about_y = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    about_z = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    return np.array([about_x, about_y, about_z][axis])


def pinhole(points: Array, rotation: Array, translation: Any, f: float) -> Array:
    """u, v of an undistorted camera, by the definition."""
    inside = points @ rotation.T + translation
    return f * inside[:, :2] / inside[:, 2:] / PIXEL + CENTRE


def seen_at(
    image: Array, depth: Array | None, rotation: Array, translation: Array, *,
    f: float, kappa1: float = 0.0, sx: float = 1.0, centre: Any = CENTRE, pixel: Any = PIXEL,
) -> Array:  # fmt: skip
    """World points that appear exactly at given pixels: at given depths, or (depth None) in the world's z = 0.

    From the image to the world the model needs no root: Xu = Xd (1 + kappa1 r^2).
    """
    xd = (image - centre) * pixel / [sx, 1.0]
    xu = xd * (1.0 + kappa1 * np.sum(xd**2, axis=1, keepdims=True))
    ray = np.column_stack([xu / f, np.ones(len(xu))])
    turned, origin = ray @ rotation, -translation @ rotation  # in the world
    if depth is None:
        depth = -origin[2] / turned[:, 2]
    return origin + turned * depth[:, None]


def paper_board() -> Array:
    line = (np.arange(5) - 2) * 0.01905
    x, y = np.meshgrid(line, line)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(25)])


BOARD = paper_board()
# The board turns in a world with y up and z towards the camera, whose own y is down and z away: half a turn about x.
TURNED = about(0, 180.0) @ about(2, -2.0) @ about(1, 6.0) @ about(0, 46.0)
POSITION = np.array([0.0, 0.0, 0.79])
IMAGE = pinhole(BOARD, TURNED, POSITION, 0.0125)


def calibrated(points: Array, image: Array, **options: Any) -> CameraCalibration:
    given = {"pixel_width": PIXEL[0], "pixel_height": PIXEL[1], "centre": CENTRE, **options}
    return calibrate_camera(points, image, **given)


def pixels(count: int, seed: int, half: float = 70.0) -> Array:
    return np.array(CENTRE) + np.random.default_rng(seed).uniform(-half, half, (count, 2))


# Closed forms.


def test_camera_frame_is_x_right_y_down_z_forward() -> None:
    """In the camera's own frame u grows with x, v with y, by f/(Z dx) and f/(Z dy) for each metre."""
    points = np.array([[x, y, z] for x in (-0.05, 0.03) for y in (-0.04, 0.05) for z in (0.9, 1.2)])
    points[0] += (0.01, 0.02, 0.05)
    u = 95.5 + 0.0125 * points[:, 0] / (points[:, 2] * 13.75e-6)
    v = 82.0 + 0.0125 * points[:, 1] / (points[:, 2] * 16e-6)
    found = calibrated(points, np.column_stack([u, v]))
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT)
    assert found.rotation == pytest.approx(np.eye(3), abs=EXACT)
    assert found.translation == pytest.approx((0.0, 0.0, 0.0), abs=EXACT)
    assert found.rms < EXACT


@pytest.mark.parametrize("solver", ["tsai", "opencv"])
def test_rotation_is_rz_ry_rx_and_translation_is_the_worlds_origin_in_the_camera(solver: str) -> None:
    rotation = about(2, 50.0) @ about(1, -35.0) @ about(0, 20.0)
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (20, 3))
    found = calibrated(points, pinhole(points, rotation, (0.02, -0.01, 0.8), 0.0125), solver=solver)
    near = EXACT if solver == "tsai" else 1e-6  # OpenCV takes points in single precision
    assert np.degrees(found.angles) == pytest.approx((20.0, -35.0, 50.0), rel=near)
    assert found.rotation == pytest.approx(rotation, abs=near)
    assert found.translation == pytest.approx((0.02, -0.01, 0.8), abs=near)
    assert found.coplanar is False
    assert found.tilt is None


@pytest.mark.parametrize("kappa1", [-2000.0, 1500.0])
def test_kappa1_undistorts(kappa1: float) -> None:
    """A point imaged 1 mm from the centre was meant for 1 mm (1 + kappa1 1e-6): kappa1 > 0 shrinks the image."""
    r = 1e-3
    assert distort(np.array([[r * (1.0 + kappa1 * r**2), 0.0]]), kappa1) == pytest.approx(np.array([[r, 0.0]]))
    image = pixels(30, 1)
    points = seen_at(image, None, TURNED, POSITION, f=0.0125, kappa1=kappa1)
    found = calibrated(points, image, free=("focal_length", "distortion"))
    assert found.kappa1 == pytest.approx(kappa1, rel=1e-8)
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT)


def test_distortion_is_inverted_from_nothing_to_the_fold() -> None:
    a = np.concatenate([np.geomspace(1e-18, 1e3, 300), -np.geomspace(1e-18, -FOLD * (1 - 1e-9), 300), [0.0]])
    for value in a:
        (w, _), *_ = distort(np.array([[1.0, 0.0]]), float(value))
        # At the fold the root is double: round-off of 1e-16 moves it by 1e-8, its equation by 1e-16.
        assert value * w**3 + w == pytest.approx(1.0, abs=1e-14)
        assert 0.0 < w <= 1.5


def test_derivatives_are_those_of_the_projection() -> None:
    points = np.random.default_rng(2).uniform(-0.1, 0.1, (8, 3))
    centre = np.array([0.1, 0.2, 0.3])
    for kappa1 in (0.0, 3000.0, -3000.0):
        camera = Camera(TURNED, np.array([0.01, 0.02, 0.8]), centre, 0.0125, kappa1, 1.02, CENTRE, PIXEL)
        found = derivatives(camera, points + centre)
        for column, name in enumerate(COLUMNS):
            step = {"focal_length": 1e-7, "kappa1": 1.0}.get(name, 1e-5)
            ahead, behind = (project(changed(camera, column, h), points + centre) for h in (step, -step))
            expected = ((ahead - behind) / (2.0 * step)).ravel()
            assert found[:, column] == pytest.approx(expected, abs=DIFFERENCES * np.abs(expected).max()), name


def changed(camera: Camera, column: int, by: float) -> Camera:
    if column < 3:
        return moved(camera, rotation=turn(by * np.eye(3)[column])[0] @ camera.rotation)
    if column < 6:
        return moved(camera, position=camera.position + by * np.eye(3)[column - 3])
    if column < 9:
        return moved(camera, **{COLUMNS[column]: getattr(camera, COLUMNS[column]) + by})
    u, v = camera.centre
    return moved(camera, centre=(u + by, v) if column == 9 else (u, v + by))


# Exact points.


def test_exact_coplanar_points_on_the_axis_give_f() -> None:
    """The paper's board is centred on the axis: Tx = Ty = 0, which breaks Tsai's own linear stage."""
    found = calibrated(BOARD, IMAGE)
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT)
    assert found.translation == pytest.approx((0.0, 0.0, 0.79), abs=EXACT)
    assert found.coplanar is True
    assert found.tilt == pytest.approx(math.acos(abs(TURNED[2, 2])), abs=EXACT)
    assert found.linear_stage is not None
    assert found.linear_stage.focal_length == pytest.approx(0.0125, rel=EXACT)


@pytest.mark.parametrize("free", [EVERYTHING[:2], EVERYTHING[:3]])
def test_exact_distorted_coplanar_points(free: tuple[str, ...]) -> None:
    image = pixels(40, 3)
    points = seen_at(image, None, TURNED, np.array([0.01, 0.02, 0.79]), f=0.0125, kappa1=-2000.0)
    off = (4.0, 8.0) if "centre" in free else (0.0, 0.0)
    found = calibrated(points, image, free=free, centre=(CENTRE[0] - off[0], CENTRE[1] - off[1]))
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT)
    assert found.centre == pytest.approx(CENTRE, rel=EXACT)


@pytest.mark.parametrize("sx", [1.0, 0.95, 1.04])
def test_exact_points_in_space_give_everything(sx: float) -> None:
    image = pixels(40, 4)
    depth = np.random.default_rng(4).uniform(0.7, 0.9, 40)
    points = seen_at(image, depth, TURNED, POSITION, f=0.0125, kappa1=-2000.0, sx=sx)
    found = calibrated(points, image, free=EVERYTHING, centre=(99.5, 74.0))
    assert (found.focal_length, found.kappa1, found.sx) == pytest.approx((0.0125, -2000.0, sx), rel=EXACT)
    assert found.centre == pytest.approx(CENTRE, rel=EXACT)
    assert found.rotation == pytest.approx(TURNED, abs=EXACT)
    held = calibrated(points, image, free=("focal_length",), kappa1=-2000.0, sx=sx)
    assert held.focal_length == pytest.approx(0.0125, rel=EXACT)
    assert (held.kappa1, held.sx, held.centre) == (-2000.0, sx, CENTRE)


@pytest.mark.parametrize("centre_at", [(0.0, 0.0, 0.0), (0.0, 0.0, -0.2), (0.02, 0.0, 0.0), (5.0, -300.0, 40.0)])
def test_world_may_lie_anyhow(centre_at: tuple[float, float, float]) -> None:
    """Any plane, any origin: the camera stays where it is with respect to the points."""
    world = about(0, 70.0) @ about(1, 20.0)
    found = calibrated(BOARD @ world.T + centre_at, IMAGE)
    digits = 1.0 + max(map(abs, centre_at)) / 0.1  # a far origin costs digits of the points themselves
    assert found.coplanar is True
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT * digits)
    assert found.rotation == pytest.approx(TURNED @ world.T, abs=EXACT * digits)
    assert np.array(found.translation) == pytest.approx(POSITION - TURNED @ world.T @ centre_at, abs=EXACT * digits**2)


def test_units_of_the_world_scale_the_translation_alone() -> None:
    found = calibrated(BOARD * 7.0, IMAGE)
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT)
    assert found.translation == pytest.approx(tuple(7.0 * POSITION), abs=1e-8)


def test_cube_on_the_axis_which_the_radial_constraint_cannot_tell() -> None:
    """Its corners lie on quadrics that hold the optical axis; the direct linear start takes over."""
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.03
    found = calibrated(cube, pinhole(cube, TURNED, (0.0, 0.0, 0.6), 0.0125))
    assert found.focal_length == pytest.approx(0.0125, rel=EXACT)


def test_fewest_points() -> None:
    five = BOARD[[0, 3, 12, 19, 22]] + [[0, 0, 0], [0, 0, 0], [0.003, 0.001, 0], [0, 0, 0], [0, 0, 0]]
    assert calibrated(five, pinhole(five, TURNED, POSITION, 0.0125)).focal_length == pytest.approx(0.0125, rel=EXACT)
    seven = np.random.default_rng(5).uniform(-0.04, 0.04, (7, 3))
    assert calibrated(seven, pinhole(seven, TURNED, POSITION, 0.0125)).focal_length == pytest.approx(0.0125, rel=EXACT)


@pytest.mark.parametrize("solver", ["tsai", "opencv"])
def test_held_focal_length_gives_the_pose_even_of_a_fronto_parallel_board(solver: str) -> None:
    straight = about(0, 180.0) @ about(2, 10.0)
    image = pinhole(BOARD, straight, (0.01, 0.0, 0.79), 0.0125)
    found = calibrated(BOARD, image, free=(), focal_length=0.0125, solver=solver)
    assert found.translation == pytest.approx((0.01, 0.0, 0.79), abs=EXACT if solver == "tsai" else 1e-5)
    assert found.sigma.focal_length is None
    assert found.tilt == pytest.approx(0.0, abs=EXACT if solver == "tsai" else 1e-3)


# Standard errors.


@pytest.mark.parametrize(("tilt", "mm_per_px"), [(10, 10.2), (20, 5.7), (30, 4.0), (46, 2.97), (70, 2.48)])
def test_standard_error_of_f_by_tilt(tilt: float, mm_per_px: float) -> None:
    """The table of calibration.md for the paper's board, printed to two or three digits."""
    turned = about(0, 180.0) @ about(2, -2.0) @ about(1, 6.0) @ about(0, tilt)
    exact = pinhole(BOARD, turned, POSITION, 0.0125)
    found = calibrated(BOARD, exact + 1e-6 * np.random.default_rng(6).standard_normal(exact.shape))
    assert found.sigma.focal_length is not None
    assert 1e3 * found.sigma.focal_length / math.sqrt(found.sse / 43) == pytest.approx(mm_per_px, rel=0.01)


def test_pixel_off_by_a_thousandth_moves_f_by_0_19_percent() -> None:
    found = calibrated(BOARD, IMAGE, pixel_width=PIXEL[0] * 1.001)
    assert found.focal_length / 0.0125 - 1.0 == pytest.approx(0.0019, abs=0.00005)


@pytest.mark.parametrize("trials", [60, pytest.param(150, marks=pytest.mark.long)])
def test_standard_error_of_f_covers_the_truth(trials: int) -> None:
    """1, 2, 3 sigma by Student's t; false alarm below 1e-4 in all. Errors half or twice as large 60 trials see too."""
    rng = np.random.default_rng(7)
    off = []
    for _ in range(trials):
        found = calibrated(BOARD, IMAGE + 0.05 * rng.standard_normal(IMAGE.shape))
        assert found.sigma.focal_length is not None
        off.append(abs(found.focal_length - 0.0125) / found.sigma.focal_length)
    for k in (1, 2, 3):
        low, high = binom.interval(1.0 - FALSE_ALARM / 3.0, trials, 1.0 - 2.0 * t.sf(k, 43))
        assert low <= np.sum(np.array(off) <= k) <= high


def test_every_standard_error_is_the_scatter_of_its_value() -> None:
    """Everything free, the world's origin far from the points: sum of squared deviations is chi-square."""
    trials, noise = 40, 0.02
    image = pixels(60, 8)
    shift = np.array([0.3, -0.2, 0.1])
    depth = np.random.default_rng(8).uniform(0.6, 1.0, 60)
    rotation, translation = TURNED, POSITION - TURNED @ shift
    points = seen_at(image, depth, rotation, translation, f=0.0125, kappa1=-3000.0, sx=1.02)
    exact = calibrated(points, image, free=EVERYTHING)
    rng = np.random.default_rng(9)
    squares = []
    for _ in range(trials):
        found = calibrated(points, image + noise * rng.standard_normal(image.shape), free=EVERYTHING)
        squares.append(((flat(found) - flat(exact)) / flat_errors(found)) ** 2)
    low, high = chi2.interval(1.0 - FALSE_ALARM / len(squares[0]), trials)
    # Each is divided by its own estimated variance, 109 degrees of freedom: wider by a hundredth.
    assert np.all(np.sum(squares, axis=0) > 0.98 * low)
    assert np.all(np.sum(squares, axis=0) < 1.05 * high)


def test_standard_errors_follow_from_the_covariance() -> None:
    """Angles and the far world origin, by central differences of what a small turn and shift do to them."""
    world = about(0, 25.0) @ about(1, -40.0) @ about(2, 15.0)
    points = np.random.default_rng(20).uniform(-0.04, 0.04, (30, 3)) @ world.T + [0.5, -0.4, 0.3]
    image = pinhole(points, TURNED @ world.T, POSITION - TURNED @ world.T @ [0.5, -0.4, 0.3], 0.0125)
    image += 0.1 * np.random.default_rng(21).standard_normal(image.shape)
    found = calibrated(points, image)
    rotation, middle = np.array(found.rotation), points.mean(axis=0)
    camera = Camera(
        rotation, rotation @ middle + found.translation, middle, found.focal_length, 0.0, 1.0, CENTRE, PIXEL
    )
    rates = np.column_stack(
        [
            (reported(changed(camera, column, 1e-6)) - reported(changed(camera, column, -1e-6))) / 2e-6
            for column in range(6)
        ]
    )
    expected = np.sqrt(np.diag(rates @ found.covariance[:6, :6] @ rates.T))
    assert found.sigma.rotation is not None
    assert [*found.sigma.rotation, *found.sigma.translation] == pytest.approx(expected, rel=DIFFERENCES)


def reported(camera: Camera) -> Array:
    """Angles of R = Rz Ry Rx and the world's origin in the camera."""
    r = camera.rotation
    angles = [math.atan2(r[2, 1], r[2, 2]), math.asin(-r[2, 0]), math.atan2(r[1, 0], r[0, 0])]
    return np.array([*angles, *camera.translation])


def flat(found: CameraCalibration) -> Array:
    return np.array([found.focal_length, *found.translation, *found.angles, found.kappa1, found.sx, *found.centre])


def flat_errors(found: CameraCalibration) -> Array:
    s = found.sigma
    assert s.rotation is not None
    assert s.centre is not None
    return np.array([s.focal_length, *s.translation, *s.rotation, s.kappa1, s.sx, *s.centre])


# The true minimum.


def long_lens(depth: Array | None, count: int, f: float, distance: float) -> tuple[Array, Array, dict[str, Any]]:
    """Points, noisy image and options of the long lens of issue 4: centre off by (4, 8) px and freed."""
    turned = about(0, 180.0) @ about(2, 5.0) @ about(1, 25.0) @ about(0, 35.0)
    camera = {"f": f, "kappa1": -600.0, "centre": (260.0, 264.0), "pixel": (23e-6, 23e-6)}
    line = np.linspace(10.0, 510.0, 10)
    image = np.column_stack([part.ravel() for part in np.meshgrid(line, line)])
    if depth is not None:
        image = np.random.default_rng(10).uniform(10.0, 510.0, (count, 2))
    points = seen_at(image, depth, turned, np.array([0.01, 0.01, distance]), **camera)  # type: ignore[arg-type]
    noisy = image + 0.02 * np.random.default_rng(11).standard_normal(image.shape)
    return points, noisy, {"pixel_width": 23e-6, "pixel_height": 23e-6, "centre": (256.0, 256.0)}


@pytest.mark.parametrize("free", [("focal_length",), ("focal_length", "distortion"), EVERYTHING])
@pytest.mark.parametrize("solver", ["tsai", "opencv"])
def test_search_from_a_near_calibration_ends_where_one_from_nothing_does(solver: str, free: tuple[str, ...]) -> None:
    random = np.random.default_rng(7)
    points = BOARD if len(free) < 3 else random.uniform(-0.06, 0.06, (40, 3))
    image = pinhole(points, TURNED, POSITION, 0.0125)
    first = calibrated(points, image + random.normal(0.0, 0.05, image.shape), solver=solver, free=free)
    for _ in range(5):
        moved_image = image + random.normal(0.0, 0.05, image.shape)
        alone = calibrated(points, moved_image, solver=solver, free=free)
        near = calibrated(points, moved_image, solver=solver, free=free, near=first)
        # Both are the minimum to 1e-4 of a standard error, those of OpenCV's single precision to 1e-2.
        share = 1e-4 if solver == "tsai" else 1e-2
        assert alone.sigma.focal_length is not None
        assert near.focal_length == pytest.approx(alone.focal_length, abs=share * alone.sigma.focal_length)
        assert near.sse == pytest.approx(alone.sse, rel=1e-6)
        assert near.linear_stage is None
        assert abs(near.focal_length - first.focal_length) > 10 * share * alone.sigma.focal_length


def test_a_near_calibration_says_nothing_of_what_is_held() -> None:
    random = np.random.default_rng(8)
    points = random.uniform(-0.06, 0.06, (40, 3))
    noisy = pinhole(points, TURNED, POSITION, 0.0125) + random.normal(0.0, 0.05, (40, 2))
    near = calibrated(points, noisy, free=EVERYTHING)
    for solver in ("tsai", "opencv"):
        found = calibrated(points, noisy, near=near, solver=solver)
        assert (found.kappa1, found.sx, found.centre) == (0.0, 1.0, CENTRE)
        assert found.focal_length == pytest.approx(calibrated(points, noisy, solver=solver).focal_length, rel=1e-6)
    assert calibrated(points, noisy, near=near, free=(), focal_length=0.0126).focal_length == 0.0126


@pytest.mark.parametrize("flat_board", [True, False])
def test_long_lens_reaches_the_true_minimum(flat_board: bool) -> None:
    depth = None if flat_board else np.random.default_rng(12).uniform(1.8, 2.2, 300)
    points, image, options = long_lens(depth, 300, 0.270 if flat_board else 0.070, 6.6 if flat_board else 2.0)
    found = calibrated(points, image, free=EVERYTHING[:3], **options)
    assert found.sigma.focal_length is not None
    assert abs(found.focal_length - (0.270 if flat_board else 0.070)) < 4.0 * found.sigma.focal_length
    assert found.gradient_norm < 1e-9
    assert found.predicted_decrease < 1e-18
    rng = np.random.default_rng(13)
    centroid = points.mean(axis=0)
    for _ in range(4):
        scale = math.exp(0.3 * rng.standard_normal())
        start = Camera(
            turn(0.1 * rng.standard_normal(3))[0] @ np.array(found.rotation),
            (np.array(found.rotation) @ centroid + found.translation) * [1.0, 1.0, scale],
            centroid,
            found.focal_length * scale,
            0.0,
            1.0,
            (256.0, 256.0),
            (23e-6, 23e-6),
        )
        other = refine(start, points, image, frozenset(EVERYTHING[:3]))
        assert other.sse > found.sse * (1.0 - 1e-11)  # round-off of residuals over a position of 500 px


def test_sum_of_squares_is_stationary_by_a_model_of_its_own() -> None:
    """Central differences of the sum of squares, with the pinhole of this test, along every turn and shift and f."""
    image = IMAGE + 0.1 * np.random.default_rng(14).standard_normal(IMAGE.shape)
    found = calibrated(BOARD, image)

    def sse(step: Array) -> float:
        small = about(2, step[2]) @ about(1, step[1]) @ about(0, step[0])
        translation = np.array(found.translation) + 1e-3 * step[3:6]
        f = found.focal_length + 1e-3 * step[6]
        return float(np.sum((pinhole(BOARD, small @ np.array(found.rotation), translation, f) - image) ** 2))

    assert sse(np.zeros(7)) == pytest.approx(found.sse, rel=1e-12)
    for axis in np.eye(7):
        slope = (sse(1e-4 * axis) - sse(-1e-4 * axis)) / 2e-4
        bend = (sse(1e-2 * axis) + sse(-1e-2 * axis) - 2.0 * found.sse) / 1e-4
        assert abs(slope / bend) < 1e-5  # the step to the minimum, in degrees and mm
        assert bend > 0.0


def test_mirror_pose_that_fits_as_well_is_named() -> None:
    """A small far board, f held: only a trace of perspective tells the pose from its mirror."""
    image = pinhole(BOARD * 0.2, TURNED, (0.0, 0.0, 2.0), 0.0125) + 0.05 * np.random.default_rng(15).standard_normal(
        IMAGE.shape
    )
    found = calibrated(BOARD * 0.2, image, free=(), focal_length=0.0125)
    assert any("as well" in note for note in found.notes)
    assert calibrated(BOARD, IMAGE).notes == ()


# The second solver.


@pytest.mark.parametrize("coplanar", [True, False])
def test_opencv_agrees_on_exact_undistorted_points(coplanar: bool) -> None:
    points = BOARD if coplanar else np.random.default_rng(16).uniform(-0.04, 0.04, (40, 3))
    image = pinhole(points, TURNED, POSITION, 0.0125)
    ours, theirs = calibrated(points, image), calibrated(points, image, solver="opencv")
    assert theirs.focal_length == pytest.approx(ours.focal_length, rel=1e-6)
    assert theirs.angles == pytest.approx(ours.angles, abs=1e-6)
    assert theirs.solver == "opencv"


def test_opencv_agrees_on_noisy_points_and_their_standard_errors() -> None:
    image = IMAGE + 0.1 * np.random.default_rng(17).standard_normal(IMAGE.shape)
    ours, theirs = calibrated(BOARD, image), calibrated(BOARD, image, solver="opencv")
    near = 1e-5  # single precision of the points, 1e-6 px, against sigma_f of 3 mm per px
    assert flat(theirs) == pytest.approx(flat(ours), rel=near, abs=near)
    assert theirs.sse == pytest.approx(ours.sse, rel=near)
    assert theirs.condition == pytest.approx(ours.condition, rel=near)
    assert theirs.sigma.focal_length == pytest.approx(ours.sigma.focal_length, rel=near)
    assert theirs.sigma.translation == pytest.approx(ours.sigma.translation, rel=near)
    assert theirs.sigma.rotation == pytest.approx(ours.sigma.rotation, rel=near)


def test_opencv_k1_becomes_kappa1_to_first_order() -> None:
    image = pixels(40, 18)
    points = seen_at(image, None, TURNED, POSITION, f=0.0125, kappa1=-200.0)
    found = calibrated(points, image, free=("focal_length", "distortion"), solver="opencv")
    assert found.kappa1 == pytest.approx(-200.0, rel=2e-3)  # 3 kappa1 r^2 is 9e-4 at the rim
    assert any("first order" in note for note in found.notes)


# What is reported.


def test_json_holds_what_was_promised() -> None:
    found = as_json(calibrated(BOARD, IMAGE + 0.01 * np.random.default_rng(19).standard_normal(IMAGE.shape)))
    assert set(found) >= {
        "schema_version", "focal_length", "translation", "rotation_deg", "kappa1", "sx", "centre", "rms_px", "sse_px2",
        "sigma", "condition", "gradient_norm", "linear_stage", "solver", "points", "coplanar",
    }  # fmt: skip
    assert found["schema_version"] == 1
    assert found["rotation_deg"] == pytest.approx((-134.0, -6.0, 2.0), abs=0.1)
    assert found["rms_px"] ** 2 * 25 == pytest.approx(found["sse_px2"])
    assert found["sigma"]["kappa1"] is None
    assert found["sigma"]["focal_length"] == pytest.approx(0.0297e-3, rel=0.3)
    json_text(found)


def test_one_wild_point_is_noticed() -> None:
    image = IMAGE.copy()
    image[7, 0] += 5.0
    assert any("not in the model" in note for note in calibrated(BOARD, image).notes)


def test_result_is_frozen() -> None:
    found = calibrated(BOARD, IMAGE)
    with pytest.raises(AttributeError):
        found.focal_length = 1.0  # type: ignore[misc]
    assert replace(found, solver="x").focal_length == found.focal_length
