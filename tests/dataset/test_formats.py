"""BOP and YOLO: frames against OpenCV's projection, sizes and shares against the block."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from radwrap.dataset import run
from radwrap.dataset.bop import model_size, ply_text, scene_files
from radwrap.dataset.document import read_dataset
from radwrap.dataset.symmetries import Symmetry, told_symmetries
from radwrap.dataset.yolo import data_text, label_text
from radwrap.errors import InputError
from radwrap.frames import to_world
from radwrap.imaging import tracer_choice
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.look.geometry import project
from radwrap.scene.targets import MeshPart
from tests.dataset.conftest import Write
from tests.study.conftest import OneThread

TURNED = """
images = 1
seed = 3
tolerance = 20
formats = ["bop", "yolo", "coco"]

[set]
"camera.position" = ["30 mm", "-20 mm", "290 mm"]
"camera.up" = [0.3, 1.0, 0.1]
"camera.principal_point" = ["22 px", "21.5 px"]

[[parts]]
target = "block"
count = 2
x = ["-12 mm", "12 mm"]
y = ["-12 mm", "12 mm"]
z = ["-10 mm", "10 mm"]
"""
EQUAL = 1e-9  # px; both are one line of doubles


def read(path: Path) -> Any:
    return json.loads(path.read_text())


def test_poses_are_opencv_s_and_masks_are_where_they_project(
    dataset_file: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "LocalPool", OneThread)
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    out = tmp_path / "out"
    dataset = read_dataset(dataset_file(TURNED))
    run.run_dataset(dataset, out, run.RunOptions())
    shard = out / "train" / "000000"
    camera, poses = read(shard / "scene_camera.json")["0"], read(shard / "scene_gt.json")["0"]
    shares = read(shard / "scene_gt_info.json")["0"]
    matrix = np.reshape(camera["cam_K"], (3, 3))
    whole = read(out / "camera.json")
    assert [[whole["fx"], 0, whole["cx"]], [0, whole["fy"], whole["cy"]], [0, 0, 1]] == matrix.tolist()
    assert (whole["width"], whole["height"], whole["depth_scale"]) == (48, 40, camera["depth_scale"])
    model = trimesh.load(out / "models" / "obj_000001.ply", process=False)
    depth = cv2.imread(str(shard / "depth" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert depth is not None and depth.dtype == np.uint16
    assert len(poses) == len(shares) == 2
    for number, (pose, share) in enumerate(zip(poses, shares, strict=True)):
        rotation, translation = np.reshape(pose["cam_R_m2c"], (3, 3)), np.array(pose["cam_t_m2c"])
        assert np.linalg.det(rotation) == pytest.approx(1) and translation[2] > 250
        turn, _ = cv2.Rodrigues(rotation)
        uv = cv2.projectPoints(np.asarray(model.vertices), turn, translation, matrix, None)[0][:, 0]
        mask = cv2.imread(str(shard / "mask" / f"000000_{number:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert mask is not None
        hull = cv2.convexHull(uv.astype(np.float32))
        inside = [
            [cv2.pointPolygonTest(hull, (float(column), float(row)), measureDist=True) for column in range(48)]
            for row in range(40)
        ]
        near = np.abs(inside) < 1e-3  # px; the hull is of single precision
        assert ((np.array(inside) > 0) == (mask > 0))[~near].all() and near.sum() <= 2
        assert share["bbox_obj"] == list(cv2.boundingRect(mask)) and share["px_count_all"] == (mask > 0).sum()
        seen = cv2.imread(str(shard / "mask_visib" / f"000000_{number:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert share["visib_fract"] == (seen > 0).sum() / share["px_count_all"]
        # What the depth image holds, taken back into the model's frame, lies on the block's surface.
        rows, columns = np.nonzero(seen)
        z = depth[rows, columns] * camera["depth_scale"]
        rays = np.linalg.solve(matrix, np.stack([columns, rows, np.ones(len(rows))]))
        local = ((rays * z).T - translation) @ rotation
        off = (np.abs(local) - [6, 4, 3]).max(axis=1)
        assert np.abs(off).max() < camera["depth_scale"]  # half a step along the axis, and the ray's slope
    # The world, too: w2c takes the scene's places into the same frame.
    turn, _ = cv2.Rodrigues(np.reshape(camera["cam_R_w2c"], (3, 3)))
    record = read(shard / "records" / "000000.json")
    scene = scene_from_document(dataset.document, folder=dataset.folder)
    part = next(target for target in scene.targets if isinstance(target, MeshPart))
    points = np.array([to_world(part.pose, (0.001 * x, 0.002, 0.003)) for x in range(3)])
    uv = cv2.projectPoints(points * 1e3, turn, np.array(camera["cam_t_w2c"]), matrix, None)[0][:, 0]
    assert np.abs(uv - project(scene.camera, points)[0]).max() < EQUAL
    assert record["objects"][0]["name"] == "block_1"
    # The labels are the boxes.
    lines = (shard / "labels" / "000000.txt").read_text().splitlines()
    for line, share in zip(lines, shares, strict=True):
        category, x, y, width, height = map(float, line.split())
        box = [(x - width / 2) * 48, (y - height / 2) * 40, width * 48, height * 40]
        assert category == 0 and box == pytest.approx(share["bbox_visib"])
    assert "train/000000/gray" in (out / "data.yaml").read_text()


def test_models_are_in_millimetres() -> None:
    vertices = np.array([[x, y, z] for x in (-6.0, 6) for y in (-4.0, 4) for z in (-3.0, 3)])
    told = model_size(vertices)
    assert told["diameter"] == pytest.approx(np.sqrt(12**2 + 8**2 + 6**2))
    assert [told[f"min_{axis}"] for axis in "xyz"] == [-6, -4, -3]
    assert [told[f"size_{axis}"] for axis in "xyz"] == [12, 8, 6]
    assert model_size(vertices * [1, 1, 0])["diameter"] == pytest.approx(np.hypot(12, 8))  # flat: no hull
    text = ply_text(vertices[:3], np.array([[0, 1, 2]]))
    back = trimesh.load(io.BytesIO(text.encode()), file_type="ply", process=False)
    assert (np.asarray(back.vertices) == vertices[:3]).all() and np.asarray(back.faces).tolist() == [[0, 1, 2]]


def test_what_is_not_seen_has_no_label_and_no_box() -> None:
    one = {"obj_id": 2, "cam_R_m2c": [], "cam_t_m2c": [], "px_count_all": 0, "px_count_valid": 0, "visib_fract": 0.0}
    hidden = {**one, "px_count_visib": 0, "bbox_obj": [0, 0, 0, 0], "bbox_visib": [0, 0, 0, 0]}
    shown = {**one, "px_count_visib": 8, "bbox_obj": [0, 0, 4, 2], "bbox_visib": [2, 0, 4, 2]}
    record = {"width": 8, "height": 4, "objects": [hidden, shown], "camera": {}}
    assert label_text(record) == "1 0.5 0.25 0.5 0.5\n"
    boxes = [told["bbox_visib"] for told in scene_files([record])["scene_gt_info.json"]["0"]]
    assert boxes == [[-1, -1, -1, -1], [2, 0, 4, 2]]
    assert data_text(["train/000000/images"], ["nut"]).splitlines()[-1] == '  0: "nut"'


BLOCK_TURNS = """
images = 1
tolerance = 20
formats = ["bop"]

[[symmetries]]
target = "block"
axis = [0, 0, 2]
fold = 2

[[symmetries]]
target = "block"
axis = [1, 0, 0]
fold = 2
"""


def matrices(told: dict[str, Any]) -> list[np.ndarray]:
    return [np.reshape(one, (4, 4)) for one in told["symmetries_discrete"]]


def test_two_half_turns_of_a_block_make_its_three(dataset_file: Write) -> None:
    found = read_dataset(dataset_file(BLOCK_TURNS)).symmetries
    turns = matrices(told_symmetries(found))
    expected = [np.diag([x, y, z, 1.0]) for x, y, z in ((-1, -1, 1), (1, -1, -1), (-1, 1, -1))]
    assert len(turns) == 3
    assert all(any(np.allclose(turn, one, atol=1e-12) for turn in turns) for one in expected)


def test_cubes_have_24_turns_and_axes_beside_the_origin_move() -> None:
    quarter = [Symmetry("cube", axis, (0.0, 0.0, 0.0), 4, "x") for axis in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))]
    assert len(matrices(told_symmetries(quarter))) == 23
    (turn,) = matrices(told_symmetries([Symmetry("bar", (0.0, 0.0, 1.0), (0.01, 0.02, 0.0), 2, "x")]))
    assert turn @ [10, 20, 5, 1] == pytest.approx([10, 20, 5, 1]), "the axis stays [mm]"
    assert turn @ [11, 20, 5, 1] == pytest.approx([9, 20, 5, 1])
    told = told_symmetries([Symmetry("ring", (0.0, 1.0, 0.0), (0.01, 0.0, 0.0), None, "x")])
    assert told == {"symmetries_continuous": [{"axis": [0.0, 1.0, 0.0], "offset": [10.0, 0.0, 0.0]}]}
    apart = [Symmetry("two", (0.0, 0.0, 1.0), (x, 0.0, 0.0), 2, "x") for x in (0.0, 0.01)]
    with pytest.raises(InputError, match="which no part has"):
        told_symmetries(apart)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("axis = [1, 0, 0]\nfold = 2", "axis = [1, 0, 0]\nfold = 4", "another after a turn by 90 degrees"),
        ("axis = [1, 0, 0]\nfold = 2", 'axis = [1, 0, 0]\nfold = "continuous"', "another after a turn by 15 degrees"),
        ("axis = [1, 0, 0]", 'axis = [1, 0, 0]\nthrough = ["0 mm", "1 mm", "0 mm"]', "mm beside the mesh"),
        ("axis = [1, 0, 0]", "axis = [0, 0, 0]", r"symmetries\[1\].axis: needs a length above zero"),
        ('formats = ["bop"]', 'formats = ["coco"]', 'symmetries\\[0\\]: is of the format "bop"'),
        ('target = "block"\naxis = [1', 'target = "table"\naxis = [1', 'no mesh part "table"'),
        ("fold = 2", "fold = 1", 'fold: must be a whole number from 2 to 360, or "continuous", not 1'),
        ("fold = 2", "fold = 2.5", 'fold: must be a whole number from 2 to 360, or "continuous", not 2.5'),
        ("fold = 2", "fold = true", 'fold: must be a whole number from 2 to 360, or "continuous", not True'),
    ],
)
def test_what_is_no_symmetry_is_refused(old: str, new: str, message: str, dataset_file: Write) -> None:
    assert old in BLOCK_TURNS
    with pytest.raises(InputError, match=message):
        read_dataset(dataset_file(BLOCK_TURNS.replace(old, new)))
