"""Polygons of masks against the pixels whose centres they hold."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from radwrap.cli.main import main
from radwrap.dataset import run
from radwrap.dataset.outlines import polygons
from radwrap.imaging import tracer_choice
from tests.dataset.conftest import TEXT, Write
from tests.study.conftest import OneThread


def filled(outlines: list[list[int]], shape: tuple[int, int]) -> NDArray[np.intp]:
    """How many polygons hold the centre of each pixel: those whose border a ray to the left crosses an odd number of
    times."""
    found = np.zeros(shape, int)
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    for outline in outlines:
        corners = np.reshape(outline, (-1, 2)).astype(float)
        crossed = np.zeros(shape, int)
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            assert (x0 == x1) != (y0 == y1), "each side runs along a row or a column of pixels"
            crossed += (x0 == x1) & (min(y0, y1) < rows) & (rows < max(y0, y1)) & (x0 < columns)
        found += crossed % 2
    return found


def area(outline: list[int]) -> float:
    x, y = np.reshape(outline, (-1, 2)).T
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def random_masks() -> list[NDArray[np.bool_]]:
    random = np.random.default_rng(7)
    found = []
    for number in range(60):
        levels = ndimage.gaussian_filter(random.random(random.integers(1, 30, 2)), number % 3)
        found.append(levels > np.quantile(levels, random.uniform(0.05, 0.6)))
    return found


def test_polygons_hold_the_pixels_of_their_mask_and_no_others() -> None:
    """Also of noise, whose pieces touch at corners and have holes in holes."""
    holes = 0
    for mask in random_masks():
        outlines = polygons(mask)
        assert np.array_equal(filled(outlines, mask.shape), mask.astype(int))
        assert sum(map(area, outlines)) == mask.sum(), "all run the same way round, and none overlap"
        holes += len(outlines) > ndimage.label(mask)[1]
    assert holes > 15


def test_a_ring_is_cut_through_its_hole() -> None:
    mask = np.ones((5, 6), bool)
    mask[2, 2:4] = False
    assert len(polygons(mask)) == 2
    assert polygons(np.zeros((3, 3), bool)) == []


def test_a_dataset_with_polygons(
    dataset_file: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, "LocalPool", OneThread)
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    path = dataset_file('segmentation = "polygons"\n' + TEXT.format(images=1))
    assert main(["dataset", "run", str(path), "--out", str(tmp_path / "out")]) == 0
    shard = tmp_path / "out" / "train" / "000000"
    for one in json.loads((shard / "coco.json").read_text())["annotations"]:
        seen = cv2.imread(str(shard / "mask_visib" / f"000000_{one['id'] - 1:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert seen is not None and np.array_equal(filled(one["segmentation"], seen.shape[:2]), seen > 0)
    path.write_text(path.read_text().replace('["coco", "bop", "yolo"]', '["bop"]'))
    assert main(["dataset", "run", str(path), "--out", str(tmp_path / "none")]) == 2
    assert 'segmentation: is of the format "coco"; name it in formats' in capsys.readouterr().err
