"""Masks, depth and edges against what a block shows by the pinhole's formula."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radwrap.dataset.document import read_dataset
from radwrap.dataset.drawn import DrawnImage, drawn_image
from radwrap.dataset.edges import CREASE, OUTLINE, creases, edge_image, outline_of
from radwrap.dataset.first_hits import Box, FirstHits, box_of
from radwrap.dataset.one_image import depth_codes, depth_scale
from radwrap.dataset.run_lengths import packed, run_lengths, segmentation
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.scene.targets import MeshPart
from tests.dataset.conftest import Write

ROUNDING = 1e-9  # of doubles over a distance of 0.3 m, with much to spare
FRONT = 0.297  # m, of the block's upper side from the camera
SCALE = 12.5 / 0.06 / 297  # px a mm there
ROWS, COLUMNS = 40, 48


def centres() -> tuple[np.ndarray, np.ndarray]:
    """What each pixel's centre sees in the plane of the block's upper side: x, y [mm]; the image's y goes down."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    return (columns - (COLUMNS - 1) / 2) / SCALE, -(rows - (ROWS - 1) / 2) / SCALE


def two_blocks(dataset_file: Write, second: dict[str, object]) -> tuple[Scene, DrawnImage]:
    """The scene's block, and another one."""
    dataset = read_dataset(dataset_file('images = 1\n[[parts]]\ntarget = "block"\ncount = 2'))
    image = drawn_image(dataset, 0)
    first, other = image.document["targets"][1:]
    first |= {"position": ["0 mm"] * 3, "rotation": ["0 deg"] * 3}
    other |= {"rotation": ["0 deg"] * 3, **second}
    return scene_from_document(image.document, folder=dataset.folder), image


def test_silhouette_and_depth_are_those_of_the_formula(dataset_file: Write) -> None:
    scene, image = two_blocks(dataset_file, {"position": ["0 mm", "0 mm", "600 mm"]})  # behind the camera
    truth = FirstHits(scene).truth(image.categories)
    block, behind = truth.objects
    x, y = centres()
    expected = (abs(x) <= 6) & (abs(y) <= 4)
    assert (block.whole == expected).all() and (block.visible == expected).all()
    assert block.whole_pixels == block.visible_pixels == expected.sum() and block.visible_share == 1.0
    assert block.whole_box == block.visible_box == box_of(expected)
    assert np.abs(truth.depth[expected] - FRONT).max() < ROUNDING
    assert np.abs(truth.depth[~expected] - 0.34).max() < ROUNDING  # the table, along the axis
    assert not behind.whole.any() and behind.visible_share == 0 and behind.whole_box == Box(0, 0, 0, 0)


def test_what_stands_before_another_hides_it(dataset_file: Write) -> None:
    """A block 6 mm to the right and 10 mm higher: its upper side is at 287 mm, and wider by 297/287."""
    scene, image = two_blocks(dataset_file, {"position": ["6 mm", "0 mm", "10 mm"]})
    lower, upper = FirstHits(scene).truth(image.categories).objects
    x, y = centres()
    nearer = 297 / 287
    low, high = (abs(x) <= 6) & (abs(y) <= 4), (abs(x - 6 * nearer) <= 6 * nearer) & (abs(y) <= 4 * nearer)
    # The upper block's side towards the axis, x = 0 from 287 to 293 mm, is seen edge on, and adds nothing.
    assert (upper.whole == high).all() and (upper.visible == high).all()
    assert (lower.whole == low).all() and (lower.visible == (low & ~high)).all()
    assert lower.visible_share == pytest.approx((low & ~high).sum() / low.sum(), abs=0)
    assert 0.4 < lower.visible_share < 0.6


def test_a_silhouette_goes_on_beyond_the_image(dataset_file: Write) -> None:
    scene, image = two_blocks(dataset_file, {"position": ["34 mm", "0 mm", "0 mm"]})  # the image ends at 33.5 mm
    _, cut = FirstHits(scene).truth(image.categories).objects
    columns = np.arange(-2 * COLUMNS, 3 * COLUMNS)
    rows = np.arange(ROWS)
    left, right = (34 - 6) * SCALE + 23.5, (34 + 6) * SCALE + 23.5
    # Of the left side, x = 28 mm, the camera sees the lower edge, which is 303 mm away, nearer to the axis.
    left_low = 28 * 12.5 / 0.06 / 303 + 23.5
    inside = (columns >= min(left, left_low)) & (columns <= right)
    along = (abs(rows - 19.5) <= 4 * SCALE).sum()
    assert cut.whole_box.width == inside.sum()
    assert cut.whole_box.height == along
    assert cut.whole.sum() < cut.whole_pixels <= inside.sum() * along
    assert 0 < cut.visible_share < 1


def test_a_block_has_twelve_creases(dataset_file: Write) -> None:
    scene, image = two_blocks(dataset_file, {"position": ["0 mm", "0 mm", "600 mm"]})
    part = next(target for target in scene.targets if isinstance(target, MeshPart))
    ends = part.mesh.vertices[creases(part.mesh)]
    assert len(ends) == 12
    assert ((np.diff(ends, axis=1) != 0).sum(axis=2) == 1).all()  # along an axis each: no diagonal
    hits = FirstHits(scene)
    truth = hits.truth(image.categories)
    found = edge_image(hits, truth)
    expected = outline_of(truth.objects[0].whole)
    assert (found[expected] == OUTLINE).all()
    assert not found[~expected].any()  # all twelve lie at the rim, or behind it


def test_a_turned_block_shows_the_crease_between_its_sides(dataset_file: Write) -> None:
    """Turned by 45 degrees about y, the edge nearest to the camera runs down the middle of the image."""
    scene, image = two_blocks(
        dataset_file, {"position": ["0 mm", "0 mm", "100 mm"], "rotation": ["0 deg", "45 deg", "0 deg"]}
    )
    hits = FirstHits(scene)
    truth = hits.truth(image.categories)
    found = edge_image(hits, truth)
    seen = truth.objects[1].visible
    inner = seen & ~outline_of(seen)
    columns = np.flatnonzero((found == CREASE).any(axis=0) & inner.any(axis=0))
    # Corners (+-6, y, 3) turn to z = (3 -+ 6)/sqrt 2: the nearer one is (-6, y, 3), at x = (-6 + 3)/sqrt 2.
    x, z = (-6 + 3) / np.sqrt(2), 100 + (6 + 3) / np.sqrt(2)
    expected = x * 12.5 / 0.06 / (300 - z) + 23.5
    assert abs(columns - expected).min() <= 0.5
    assert ((found == CREASE) & inner)[:, round(expected)].sum() == inner[:, round(expected)].sum()


def test_depth_is_in_steps_that_fit() -> None:
    for far, scale in ((0.05, 1e-3), (0.3, 1e-2), (6.5535, 0.1), (6.5537, 1.0)):
        depth = np.array([[0.0, far]])
        assert depth_scale(depth) == pytest.approx(scale)
        codes = depth_codes(depth, scale)
        assert codes[0, 0] == 0 and abs(codes[0, 1] * scale - far * 1e3) <= scale / 2 * (1 + ROUNDING)


def test_run_lengths_are_those_of_pycocotools() -> None:
    """Strings that pycocotools 2.0.11 made of these masks; scripts/dataset_check.py compares many."""
    mask = np.zeros((9, 7), dtype=bool)
    mask[2:6, 1:5] = True
    mask[4, 2] = False
    assert run_lengths(mask) == [11, 4, 5, 2, 1, 1, 5, 4, 5, 4, 21]
    assert segmentation(mask) == {"size": [9, 7], "counts": ";45NLO4300`0"}
    mask = np.ones((40, 100), dtype=bool)
    mask[:, :2] = False
    mask[39, 50] = False
    assert run_lengths(mask) == [80, 1959, 1, 1960]
    assert packed(run_lengths(mask)) == "`2Wm111"
    assert run_lengths(np.ones((2, 2), dtype=bool)) == [0, 4]
    assert run_lengths(np.zeros((2, 2), dtype=bool)) == [4]


def test_the_scene_of_the_example_is_one() -> None:
    found = read_dataset(Path(__file__).parents[2] / "rad_scenes" / "dataset_parts" / "dataset.toml")
    assert found.categories == ("bracket", "washer", "shaft") and found.most_objects == 10
