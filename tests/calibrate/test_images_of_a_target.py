"""`radwrap calibrate camera IMAGES... --target FILE`: from images to a camera, and errors that name the image."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.cli.main import main
from radwrap.images import write_png
from tests.measure.target_pictures import TARGETS, picture, scene_with

TILTS = [(25.0, 0.0, 0.0), (-25.0, 5.0, 10.0), (5.0, 25.0, 0.0), (0.0, -28.0, 20.0), (20.0, 20.0, -10.0)]
PLACES = [(0.0, 0.0, 0.0), (0.004, 0.003, 0.01), (-0.004, 0.0, -0.02), (0.0, -0.003, 0.02), (0.003, 0.0, 0.0)]
TRUE = 12.5e-3 / 13.8e-6, 159.5, 127.5  # focal length and principal point [px]
SIGMAS = 4.0  # detectors are off by more than what scatters


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("views")
    for name in ("chessboard", "circles"):
        for number, (tilt, place) in enumerate(zip(TILTS, PLACES, strict=True)):
            image = picture(scene_with(name, tilt, place), noise=1.0, seed=number)
            write_png(folder / f"{name}{number}.png", image.codes)
    return folder


def calibrated(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["calibrate", "camera", *words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize(
    ("name", "detector"), [("chessboard", "corners"), pytest.param("circles", "dots", marks=pytest.mark.long)]
)
def test_the_camera_is_found(name: str, detector: str, views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [str(path) for path in sorted(views.glob(f"{name}*.png"))]
    table = views / "points.csv"
    target = str(TARGETS / f"{name}.toml")
    found = calibrated(capsys, *images, "--target", target, "--detector", detector, "--csv", str(table))
    assert (found["detector"], found["target"]) == (detector, target)
    assert [view["view"] for view in found["views"]] == images
    matrix = np.array(found["camera_matrix"])
    sigma = np.sqrt(np.diag(np.array(found["covariance"])))
    for value, true, error in zip((matrix[0, 0], matrix[0, 2], matrix[1, 2]), TRUE, sigma[[0, 2, 3]], strict=True):
        assert abs(value - true) < SIGMAS * error
        assert error < 10
    # The same points as a table give the same camera.
    again = calibrated(capsys, str(table), "--image-size", "320", "256")
    assert again["camera_matrix"] == found["camera_matrix"]
    assert again["covariance"] == found["covariance"]


def test_a_target_of_its_own_file_and_an_image_size_that_fits(
    views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "board.toml"
    target.write_text('type = "circles"\nrows = 7\ncolumns = 9\npitch = "8 mm"\ndot_diameter = "5 mm"\n')
    images = [str(path) for path in sorted(views.glob("circles*.png"))]
    words = [*images, "--target", str(target), "--detector", "circles", "--image-size", "320", "256"]
    assert main(["calibrate", "camera", *words]) == 0
    assert "residuals:" in capsys.readouterr().out


def test_what_does_not_serve_is_one_clear_error(
    views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blank, small = tmp_path / "blank.png", tmp_path / "small.png"
    write_png(blank, np.full((256, 320), 90, dtype=np.uint8))
    write_png(small, np.full((100, 120), 90, dtype=np.uint8))
    one, board = str(views / "circles0.png"), str(TARGETS / "circles.toml")
    star = str(TARGETS / "siemens_star.toml")

    def said(*words: str) -> str:
        assert main(["calibrate", "camera", *words]) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        return told

    assert "blank.png: " in (told := said(one, str(blank), "--target", board)) and "1 of 2 images" in told
    assert "small.png: has 120 x 100 pixels, not 320 x 256" in said(one, str(small), "--target", board)
    assert "circles0.png: has 320 x 256 pixels, not 64 x 48 as --image-size says" in said(
        one, "--target", board, "--image-size", "64", "48"
    )
    assert "is given twice" in said(one, one, "--target", board)
    assert "SiemensStar has no points" in said(one, "--target", star)
    assert '--detector: "sb" does not look for a CircleGrid; use dots or circles' in said(
        one, "--target", board, "--detector", "sb"
    )
    assert "--detector: belongs to images" in said("points.csv", "--detector", "sb")
    assert "--length-unit: belongs to a table" in said(one, "--target", board, "--length-unit", "mm")
    assert "--pixel-width: belongs to a table of one view" in said(one, "--target", board, "--pixel-width", "1 um")
    assert "b.csv: is one table too many" in said("a.csv", "b.csv")
    assert "nothing.toml" in said(one, "--target", str(tmp_path / "nothing.toml"))
    assert "has no target with a pattern" in said(one, "--target", str(TARGETS.parent / "fig11_edge" / "scene.toml"))
