"""What is where on targets with a pattern: OpenCV's own boards, the standard's sizes, areas, brute force."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import radwrap
from radwrap.scene.file.load import load_scene
from radwrap.scene.patterns.layouts import Charuco, Chessboard, CircleGrid, Layout, SiemensStar, Usaf1951
from radwrap.scene.patterns.marks import FlatDisc, Mark, narrowest_of
from radwrap.scene.patterns.partition import MARK, PLATE, Partition, partition
from radwrap.scene.targets import PatternTarget, surfaces

TARGETS = Path(__file__).parents[2] / "rad_scenes" / "targets"
SCENES = sorted(TARGETS.glob("*.toml"))
ROUNDING = 1e-12  # of an area, which is a sum of products
PRINTED = 0.005  # of a width, as tables of the standard have it to three digits


def target_of(path: Path, **overrides: Any) -> PatternTarget:
    scene = load_scene(path, {f"targets[0].{key}": value for key, value in overrides.items()})
    (target,) = scene.targets
    assert isinstance(target, PatternTarget)
    return target


def within(mark: Mark, xy: np.ndarray) -> np.ndarray:
    """Points that lie in a mark, by its own definition."""
    if isinstance(mark, FlatDisc):
        return np.hypot(xy[:, 0] - mark.x, xy[:, 1] - mark.y) < mark.radius
    start = np.array(mark.vertices)
    along = np.roll(start, -1, axis=0) - start
    inside = np.ones(len(xy), dtype=bool)
    for (x, y), (dx, dy) in zip(start, along, strict=True):
        inside &= dx * (xy[:, 1] - y) - dy * (xy[:, 0] - x) > 0
    return inside


def area(mark: Mark) -> float:
    if isinstance(mark, FlatDisc):
        return math.pi * mark.radius**2
    x, y = np.array(mark.vertices).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def total(layout: Layout) -> float:
    return math.fsum(map(area, layout.marks()))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_place_is_on_a_mark_where_one_of_them_holds_it(path: Path) -> None:
    target = target_of(path)
    xy = (np.random.default_rng(1).random((20_000, 2)) - 0.5) * target.layout.size
    held = sum(within(mark, xy).astype(int) for mark in target.layout.marks())
    assert held.max() == 1  # no two marks overlap
    assert (target.partition.covered(xy) == (held > 0)).all()
    assert len(surfaces(target)) == 1 + len(list(target.layout.marks()))


@pytest.mark.parametrize(
    "layout",
    [
        CircleGrid(5, 6, 0.01, 0.01 * math.sqrt(2), 0.0, True),  # discs that touch, and reach the plate's edge
        CircleGrid(1, 1, 0.01, 0.004, 0.0, False),
        Chessboard(2, 2, 0.01, 0.0),
        SiemensStar(100, 0.1, 0.0, 0.0),
    ],
    ids=["touching", "one", "four", "fine"],
)
def test_marks_that_touch_are_parted(layout: Layout) -> None:
    xy = (np.random.default_rng(2).random((20_000, 2)) - 0.5) * layout.size
    held = sum(within(mark, xy).astype(int) for mark in layout.marks())
    assert (partition(layout.marks(), layout.size).covered(xy) == (held > 0)).all()


def test_marks_that_no_line_parts_are_asked_one_by_one() -> None:
    """Five discs that are so near each other that each line beside one cuts others."""
    marks = [FlatDisc(0.0, 0.0, 1.0)]
    marks += [FlatDisc(2.05 * math.cos(turn), 2.05 * math.sin(turn), 1.0) for turn in np.arange(6) * math.pi / 3 + 0.2]
    xy = (np.random.default_rng(3).random((20_000, 2)) - 0.5) * 6.2
    held = sum(within(mark, xy).astype(int) for mark in marks)
    assert (partition(marks, (6.2, 6.2)).covered(xy) == (held > 0)).all()


@pytest.mark.parametrize(("marks", "shown"), [([], PLATE), ([FlatDisc(0.0, 0.0, 9.0)], MARK)], ids=["none", "all"])
def test_a_plate_of_one_material(marks: list[Mark], shown: int) -> None:
    parted = partition(marks, (1.0, 1.0))
    assert isinstance(parted, Partition)
    assert (parted.covered(np.zeros((3, 2))) == (shown == MARK)).all()


def test_dark_areas_are_those_of_the_closed_forms() -> None:
    assert total(Chessboard(7, 10, 0.007, 0.005)) == pytest.approx(35 * 0.007**2, rel=ROUNDING)
    assert total(CircleGrid(7, 4, 0.009, 0.007, 0.005, True)) == pytest.approx(28 * math.pi * 0.0035**2, rel=ROUNDING)
    # Isosceles triangles of an angle of pi/36.
    wedge = math.sin(math.pi / 36) / 2
    assert total(SiemensStar(36, 0.07, 0.0, 0.005)) == pytest.approx(36 * 0.035**2 * wedge, rel=ROUNDING)
    ring = 36 * (0.035**2 - 0.01**2) * wedge
    assert total(SiemensStar(36, 0.07, 0.02, 0.005)) == pytest.approx(ring, rel=ROUNDING)
    usaf = Usaf1951(-2, 0, 0.003)
    bars = 2 * 3 * 5 * sum(element.bar_width**2 for element in usaf.elements())
    assert total(usaf) == pytest.approx(bars, rel=ROUNDING)


def test_usaf_bars_have_the_standards_widths() -> None:
    """Micrometres, as tables of the target print them."""
    printed = {(0, 1): 500.0, (0, 6): 281.0, (2, 3): 99.2, (4, 5): 19.7, (7, 6): 2.19}
    widths = {(one.group, one.element): one.bar_width * 1e6 for one in Usaf1951(-2, 7, 0.0).elements()}
    for place, width in printed.items():
        assert widths[place] == pytest.approx(width, rel=PRINTED)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_everything_lies_on_the_plate(path: Path) -> None:
    target = target_of(path)
    half = np.array(target.layout.size) / 2
    for mark in target.layout.marks():
        if isinstance(mark, FlatDisc):
            low, high = np.array([mark.x, mark.y]) - mark.radius, np.array([mark.x, mark.y]) + mark.radius
        else:
            low, high = np.min(mark.vertices, axis=0), np.max(mark.vertices, axis=0)
        assert (low > -half).all() and (high < half).all()
        assert narrowest_of(mark) > 0


SIZES = [(5, 7), (6, 7), (6, 4)]
DICTIONARIES = [("DICT_4X4_50", 0), ("DICT_6X6_250", 17), ("DICT_APRILTAG_36h11", 3)]


# Each size and each dictionary once: the first says where markers lie, the second what they are. All pairs are long.
@pytest.mark.parametrize(
    ("rows", "columns", "dictionary", "first"),
    [
        pytest.param(*size, *bits, marks=[] if SIZES.index(size) == DICTIONARIES.index(bits) else [pytest.mark.long])
        for size in SIZES
        for bits in DICTIONARIES
    ],
)
def test_a_charuco_board_is_opencvs(rows: int, columns: int, dictionary: str, first: int) -> None:
    """Each pixel of OpenCV's own picture, with 8 pixels to a cell so that cells end between pixels."""
    bits = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = bits.markerSize + 2
    count = rows * columns // 2
    # Squares of cells + 2 cells: markers in whole pixels.
    target = target_of(
        TARGETS / "charuco.toml",
        rows=rows,
        columns=columns,
        dictionary=dictionary,
        first_marker=first,
        margin="0 mm",
        square_size=f"{cells + 2} mm",
        marker_size=f"{cells} mm",
    )
    board = cv2.aruco.CharucoBoard((columns, rows), cells + 2, cells, bits, np.arange(first, first + count))
    shape = (8 * (cells + 2) * columns, 8 * (cells + 2) * rows)
    picture = board.generateImage(shape)
    u, v = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]))
    xy = np.stack([(u + 0.5) / 8e3 - target.width / 2, target.height / 2 - (v + 0.5) / 8e3], axis=-1).reshape(-1, 2)
    dark = target.partition.covered(xy).reshape(u.shape)
    assert ((picture < 128) == dark).all()
    assert isinstance(target.layout, Charuco)
    corners = np.array([(x, y) for _, _, (x, y) in target.layout.corners()])
    theirs = np.array(board.getChessboardCorners())[:, :2] / 1e3
    ours = np.column_stack([corners[:, 0] + target.width / 2, target.height / 2 - corners[:, 1]])
    assert np.abs(ours - theirs).max() < 1e-8  # OpenCV has float32


@pytest.mark.parametrize(
    ("scene", "key", "value", "said"),
    [
        ("charuco", "dictionary", "DICT_4X4_51", r"no dictionary .*DICT_4X4_50"),
        ("charuco", "dictionary", "../x", r"dictionary"),
        ("charuco", "first_marker", 34, r"has 50 markers, the board needs 17 from number 34"),
        ("charuco", "marker_size", "11 mm", r"marker_size must be smaller"),
        ("circles", "dot_diameter", "8.1 mm", r"discs overlap"),
        ("circles_asymmetric", "dot_diameter", "12.8 mm", r"must not exceed 12\.7279 mm"),
        ("siemens_star", "inner_diameter", "70 mm", r"inner_diameter must be smaller"),
        ("usaf1951", "last_group", -3, r"last_group must not"),
        ("chessboard", "pattern_material", "tar", r'no material "tar"'),
        ("chessboard", "rows", 101, r"rows"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(scene: str, key: str, value: Any, said: str) -> None:
    with pytest.raises(radwrap.InputError, match=said) as error:
        target_of(TARGETS / f"{scene}.toml", **{key: value})
    assert "targets[0]" in str(error.value)
