"""What one view cannot tell, and files that are not points: each a clear error. And the verb itself."""

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.calibrate.tsai import CameraCalibration, calibrate_camera
from radwrap.cli.calibrate_camera import add_to, read_points
from radwrap.errors import InputError
from radwrap.frames import rotation_about_fixed_axes

Array = NDArray[np.float64]

PIXEL = (13.75e-6, 16e-6)
CENTRE = (95.5, 82.0)
SIDE = (np.arange(5) - 2) * 0.01905
BOARD = np.array([[x, y, 0.0] for y in SIDE for x in SIDE])
CLOUD = np.random.default_rng(0).uniform(-0.04, 0.04, (30, 3))


def seen(points: Array, angles: tuple[float, float, float] = (46.0, 6.0, -2.0), depth: float = 0.79) -> Array:
    rotation = np.array(rotation_about_fixed_axes([math.radians(angle) for angle in angles]))
    inside = points @ rotation.T * [1.0, -1.0, -1.0] + [0.0, 0.0, depth]
    return 0.0125 * inside[:, :2] / inside[:, 2:] / PIXEL + CENTRE


IMAGE = seen(BOARD)


def calibrated(points: Any, image: Any, **options: Any) -> CameraCalibration:
    given = {"pixel_width": PIXEL[0], "pixel_height": PIXEL[1], "centre": CENTRE, **options}
    return calibrate_camera(points, image, **given)


def refused(points: Any, image: Any, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        calibrated(points, image, **options)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    return str(caught.value)


def noise(points: Array, px: float) -> Array:
    return px * np.random.default_rng(1).standard_normal((len(points), 2))


# What no view can tell.


def test_four_points_in_a_plane() -> None:
    assert "4 are too few" in refused(BOARD[:4], IMAGE[:4])


def test_six_points_in_space() -> None:
    assert "6 are too few" in refused(CLOUD[:6], seen(CLOUD[:6]))


def test_more_unknowns_than_equations() -> None:
    five = BOARD[[0, 3, 13, 16, 22]]
    message = refused(five, seen(five), free=("focal_length", "distortion", "centre"))
    assert "10 equations for 10 unknowns" in message


def test_collinear_points() -> None:
    assert "on one line" in refused(BOARD[:5], IMAGE[:5])


def test_board_seen_edge_on() -> None:
    flat = IMAGE * [1.0, 0.0]
    assert "edge on" in refused(BOARD, flat)


def test_four_of_five_on_a_line() -> None:
    some = BOARD[[0, 1, 2, 3, 12]]
    assert "undetermined" in refused(some, seen(some))


def test_duplicate_points_and_images() -> None:
    twice = BOARD.copy()
    twice[7] = twice[3]
    assert "points 4 and 8 are the same" in refused(twice, IMAGE)
    twice = IMAGE.copy()
    twice[7] = twice[3]
    assert "image: points 4 and 8" in refused(BOARD, twice)


def test_nearly_equal_points_are_found_among_many_without_holding_each_against_all() -> None:
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (100_000, 3))
    points[99_000] = points[3] + 1e-7
    began = time.process_time()
    assert "points 4 and 99001 are the same" in refused(points, points[:, :2])
    assert "points 1 and 2 are the same" in refused(points[[*[5] * 50_000, *range(50_000)]], points[:, :2])
    assert time.process_time() - began < 10.0  # each against all: two minutes


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_none(bad: float) -> None:
    image, points = IMAGE.copy(), BOARD.copy()
    image[2, 1] = points[4, 0] = bad
    assert "image: point 3" in refused(BOARD, image)
    assert "points: point 5" in refused(points, IMAGE)


def test_shapes() -> None:
    assert "(n, 3)" in refused(BOARD[:, :2], IMAGE)
    assert "(n, 2)" in refused(BOARD, BOARD)
    assert "25 points but 24 images" in refused(BOARD, IMAGE[:24])


@pytest.mark.parametrize("width", [0.0, -1e-6, math.nan, math.inf])
def test_pixels_without_size(width: float) -> None:
    assert "above 0" in refused(BOARD, IMAGE, pixel_width=width)


def test_centre_that_is_none() -> None:
    assert "centre" in refused(BOARD, IMAGE, centre=(math.nan, 0.0))


def test_names() -> None:
    assert "cannot be free" in refused(BOARD, IMAGE, free=("focus",))
    assert "twice" in refused(BOARD, IMAGE, free=("focal_length", "focal_length"))
    assert "not a solver" in refused(BOARD, IMAGE, solver="best")


def test_held_values() -> None:
    assert "has no value" in refused(BOARD, IMAGE, free=())
    assert "no effect" in refused(BOARD, IMAGE, focal_length=0.0125)
    assert "no effect" in refused(BOARD, IMAGE, free=("focal_length", "distortion"), kappa1=0.0)
    assert "above 0" in refused(BOARD, IMAGE, sx=0.0)
    assert "finite" in refused(BOARD, IMAGE, kappa1=math.inf)


def test_sx_of_coplanar_points() -> None:
    assert "coplanar" in refused(BOARD, IMAGE, free=("focal_length", "sx"))


def test_centre_of_one_undistorted_plane() -> None:
    assert "9 unknowns" in refused(BOARD, IMAGE, free=("focal_length", "centre"))


@pytest.mark.parametrize("px", [0.0, 0.02])
def test_centre_of_one_plane_whose_distortion_is_not_there(px: float) -> None:
    message = refused(BOARD, IMAGE + noise(BOARD, px), free=("focal_length", "distortion", "centre"))
    assert "does not differ from 0" in message


# What this view did not tell.


@pytest.mark.parametrize(("tilt", "px"), [(0.0, 0.0), (0.0, 0.05), (5.0, 0.0), (5.0, 0.05), (8.5, 0.0)])
def test_fronto_parallel_board(tilt: float, px: float) -> None:
    message = refused(BOARD, seen(BOARD, (tilt, 0.0, 3.0)) + noise(BOARD, px))
    assert f"tilted by {tilt:.1f} degrees only" in message or (px and "degrees only" in message)
    assert "hold the focal length" in message


def test_tilt_of_ten_degrees_is_enough() -> None:
    assert calibrated(BOARD, seen(BOARD, (10.0, 0.0, 0.0))).focal_length == pytest.approx(0.0125, rel=1e-9)


def test_points_behind_the_camera() -> None:
    assert "behind the camera" in refused(CLOUD, seen(CLOUD, depth=0.02))


def test_mirrored_image_of_points_in_space() -> None:
    assert "not mirrored" in refused(CLOUD, seen(CLOUD) * [1.0, -1.0] + [0.0, 164.0])


def test_images_of_other_points() -> None:
    order = np.random.default_rng(2).permutation(25)
    assert "which image belongs to which point" in refused(BOARD, IMAGE[order])


def test_singular_centre_of_a_fronto_parallel_board() -> None:
    message = refused(BOARD, seen(BOARD, (0.0, 0.0, 0.0)), free=("centre",), focal_length=0.0125)
    assert "condition number" in message


def test_opencv_cannot_hold_tsais_distortion() -> None:
    assert "undistorts" in refused(BOARD, IMAGE, kappa1=-100.0, solver="opencv")


# Files and the verb.

GOOD = "x,y,z,u,v\n" + "".join(
    f"{1e3 * x!r},{1e3 * y!r},{1e3 * z!r},{u!r},{v!r}\n"
    for (x, y, z), (u, v) in zip(BOARD.tolist(), IMAGE.tolist(), strict=True)
)
OPTIONS = ["--pixel-width", "13.75 um", "--pixel-height", "16 um", "--centre", "95.5", "82 px", "--length-unit", "mm"]


def command(path: Path, *options: str) -> int:
    parser = argparse.ArgumentParser()
    add_to(parser.add_subparsers())
    arguments = parser.parse_args(["camera", str(path), *OPTIONS, *options])
    code: int = arguments.run(arguments)
    return code


def test_verb_prints_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "points.csv"
    path.write_text(GOOD)
    assert command(path, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["focal_length"] == pytest.approx(0.0125, rel=1e-9)
    assert found["translation"] == pytest.approx([0.0, 0.0, 0.79], abs=1e-9)
    # The board's world has y up and z towards the camera: half a turn about x lies between.
    assert found["rotation_deg"] == pytest.approx([-134.0, -6.0, 2.0], abs=1e-9)


@pytest.mark.parametrize("solver", ["tsai", "opencv"])
def test_verb_prints_text(tmp_path: Path, capsys: pytest.CaptureFixture[str], solver: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(GOOD)
    assert command(path, "--solver", solver, "--free", "distortion", "--focal-length", "12.5 mm") == 0
    text = capsys.readouterr().out
    assert "focal length: 12.5 mm (held)" in text
    assert "translation z: 790 mm +-" in text


def test_columns_may_stand_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("\ufeffv, u,z,y,x\r\n5,4,3,2,1\r\n", encoding="utf-8")
    views, points, image = read_points(path, 0.5)
    assert views is None
    assert points == pytest.approx(np.array([[0.5, 1.0, 1.5]]))
    assert image == pytest.approx(np.array([[4.0, 5.0]]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("1,2,3,4,5\n", ":1: the header"),
        ("x,y,z,u\n", ":1: the header"),
        ("x,y,z,u,v,w\n", ":1: the header"),
        ("x,y,z,u,u\n", ":1: the header"),
        ("x,y,z,u,v\n1,2,3,4\n", ":2: holds 4 values"),
        ("x,y,z,u,v\n1,2,3,4,5,6\n", ":2: holds 6 values"),
        ("x,y,z,u,v\n1,2,3,4,5\n1,2,3,4,five\n", ':3: v "five"'),
        ("x,y,z,u,v\n1,2,3,nan,5\n", ":2: u nan is not a finite number"),
        ("x,y,z,u,v\n1,2,-inf,4,5\n", ":2: z -inf is not a finite number"),
        ("x,y,z,u,v\n1,2,,4,5\n", ':2: z "" is not a number'),
        ("x,y,z,u,v\n1,2,3,4,5\n\n1,2,3,4,5\n", ":3: holds 0 values"),
        ("x,y,z,u,v\n", "points: 0 are too few"),
        ("x;y;z;u;v\n1;2;3;4;5\n", ":1: the header"),
    ],
)
def test_files_that_are_no_points(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        command(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        command(tmp_path / "none.csv")
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        command(tmp_path / "image.csv")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--pixel-width", "13.75"], "--pixel-width"),
        (["--pixel-height", "16 px"], "--pixel-height"),
        (["--centre", "left", "0"], "--centre"),
        (["--focal-length", "12.5", "--free", ""], "--focal-length"),
        (["--free", "focal_length,,centre"], "cannot be free"),
        (["--free", ""], "has no value"),
    ],
)
def test_options(tmp_path: Path, options: list[str], message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(GOOD)
    with pytest.raises(InputError, match=message):
        command(path, *options)
