"""OpenCV's detectors on pictures whose points are known."""

from typing import get_args

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.pattern_truth import ellipse_centres, true_points
from radwrap.measure.targets import (
    CharucoBoard,
    ChessboardMethod,
    PointsNotFound,
    charuco_corners,
    chessboard_corners,
    circle_centres,
)
from radwrap.scene.patterns.layouts import Charuco, Chessboard, CircleGrid
from radwrap.scene.scene import Scene
from radwrap.scene.targets import PatternTarget
from tests.measure.target_pictures import picture, scene_with

# What detectors of OpenCV are off by on sharp pictures with squares of 20 px: rms and largest distance. It is not ours
# to improve; other points than those asked for would be pixels away.
SECTORS = 0.15, 0.6  # px
CORNERS = 0.08, 0.3
CIRCLES = 0.03, 0.1
TILTS = [(20.0, -15.0, 5.0), (-30.0, 10.0, 160.0)]


def target_of(scene: Scene) -> PatternTarget:
    (target,) = scene.targets
    assert isinstance(target, PatternTarget)
    return target


def close(found: np.ndarray, true: np.ndarray, most: tuple[float, float]) -> bool:
    away = found - true
    return bool(np.sqrt((away**2).mean()) < most[0] and np.hypot(*away.T).max() < most[1])


@pytest.mark.parametrize("tilt", TILTS, ids=["upright", "turned"])
@pytest.mark.parametrize("method", get_args(ChessboardMethod))
def test_corners_of_a_chessboard(tilt: tuple[float, float, float], method: ChessboardMethod) -> None:
    """Of 7 x 10 squares a half turn is told by the colour of the first."""
    scene = scene_with("chessboard", tilt)
    target = target_of(scene)
    assert isinstance(target.layout, Chessboard)
    true = true_points(scene.camera, target, [place for *_, place in target.layout.corners()])
    found = chessboard_corners(picture(scene), 7, 10, method)
    assert close(found, true.image, SECTORS if method == "sb" else CORNERS)


def test_corners_of_a_charuco_board_of_which_a_part_is_seen() -> None:
    scene = scene_with("charuco", (20.0, -15.0, 170.0), (0.03, 0.02, 0.0))
    target = target_of(scene)
    layout = target.layout
    assert isinstance(layout, Charuco)
    true = true_points(scene.camera, target, [place for *_, place in layout.corners()])
    board = CharucoBoard(5, 7, layout.marker_size / layout.square_size, layout.dictionary, 0)
    ids, found = charuco_corners(picture(scene), board)
    assert 4 <= len(ids) < len(true.image)
    assert close(found, true.image[ids], CORNERS)


@pytest.mark.parametrize("name", ["circles", "circles_asymmetric"])
def test_circles_are_found_at_the_centres_of_their_ellipses(name: str) -> None:
    scene = scene_with(name, TILTS[0])
    target = target_of(scene)
    layout = target.layout
    assert isinstance(layout, CircleGrid)
    centres = [place for *_, place in layout.centres()]
    true = ellipse_centres(scene.camera, target, centres, layout.dot_diameter)
    found = circle_centres(picture(scene), layout.rows, layout.columns, asymmetric=layout.asymmetric)
    assert close(found, true.image, CIRCLES)


def test_more_bits_are_brought_to_eight() -> None:
    image = picture(scene_with("chessboard", TILTS[0]))
    dim = GrayImage(image.values * 3 + 100, 12)
    found = [chessboard_corners(one, 7, 10) for one in (image, dim)]
    assert np.abs(found[0] - found[1]).max() < 0.05  # px: other rounding


def test_what_is_not_there_is_an_error() -> None:
    blank = GrayImage(np.full((60, 80), 100.0))
    with pytest.raises(PointsNotFound, match="does not find the 6 x 9 inner corners"):
        chessboard_corners(blank, 7, 10)
    with pytest.raises(PointsNotFound, match=r"0 of its 17 markers"):
        charuco_corners(blank, CharucoBoard(5, 7, 0.7, "DICT_4X4_50", 0))
    with pytest.raises(PointsNotFound, match="7 x 9 dark circles"):
        circle_centres(blank, 7, 9, asymmetric=False)
    with pytest.raises(InputError, match="3 rows and columns at least"):
        chessboard_corners(blank, 2, 10)
