"""A dataset of 640 x 512 pixels under a ring, judged by other programs: time, masks, COCO, BOP.

    python scripts/dataset_check.py OUT [--images 1000] [--masks 20] [--workers 1] [--kills 10] [--uninterrupted 100]
    python scripts/dataset_check.py OUT --as-it-is [--against OTHER]

Makes `rad_scenes/dataset_parts` with that many images into OUT/data, or goes on with it, and prints JSON:

- seconds of wall clock and of processors for each image that was made now; before, the command is killed by SIGKILL at
  random moments (`--kills`);
- whether the first images are, byte for byte, those of a run that nobody killed (OUT/uninterrupted, or OTHER);
- masks against first hits of trimesh's own rays at pixel centres: shares of pixels that differ, and how many of these
  do not lie at an outline;
- whole masks against trimesh's rays on each part by itself;
- COCO and YOLO: masks, boxes, areas by pycocotools, labels from its boxes;
- BOP: its keys, rotations, sizes of the models, vertices of models/*.ply by cv2.projectPoints against bbox_obj, and
  boxes and shares counted from the masks again.

Returns 1 where something is wrong, or a limit below is not met. pycocotools and rtree are in the extra `dev`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

from radwrap.dataset.document import read_dataset
from radwrap.dataset.run import RunOptions, run_dataset
from radwrap.random_streams import generator

SOURCE = Path(__file__).parents[1] / "rad_scenes" / "dataset_parts"
ROWS, COLUMNS = 512, 640
SECONDS = 5.0  # of wall clock for an image, on two cores
SHARE = 0.002  # of the pixels of an image, that may differ from trimesh's first hits, at outlines
KILLED_AFTER = (15.0, 70.0)  # s
# Keys of BOP's format (bop_toolkit, docs/bop_datasets_format.md), and how many numbers each has; 0: no list.
KEYS = {
    "camera": {"cam_K": 9, "cam_R_w2c": 9, "cam_t_w2c": 3, "depth_scale": 0},
    "gt": {"cam_R_m2c": 9, "cam_t_m2c": 3, "obj_id": 0},
    "gt_info": {
        **{"bbox_obj": 4, "bbox_visib": 4, "px_count_all": 0, "px_count_valid": 0, "px_count_visib": 0},
        "visib_fract": 0,
    },
}


def main() -> int:
    """Make the dataset and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--images", type=int, default=1000)  # one shard at most
    parser.add_argument("--masks", type=int, default=20)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--kills", type=int, default=0, help="SIGKILLs before the run that ends")
    parser.add_argument("--uninterrupted", type=int, default=0, metavar="N", help="make N images again without kills")
    parser.add_argument("--as-it-is", action="store_true", help="make nothing; OUT is the folder of a dataset")
    parser.add_argument("--against", type=Path, metavar="DIR", help="dataset whose images are to be the same")
    given = parser.parse_args()
    out, against, told = given.out, given.against, {}
    if not given.as_it_is:
        out = given.out / "data"
        told["making"] = made(given.out, out, given.images, given.workers, given.kills)
        if given.uninterrupted:
            against = given.out / "uninterrupted" / "data"
            told["making_uninterrupted"] = made(against.parent, against, given.uninterrupted, given.workers, 0)
    shard = out / "train" / "000000"
    if against is not None:
        told["same"] = same(shard, against / "train" / "000000")
    told["images"] = len(_records(shard))
    told["largest_bound_rms_gray"] = max(one["error"]["rms_gray_upper95"] for one in _records(shard))
    told["first_hits"] = first_hits(out, shard, min(given.masks, told["images"]))
    told["coco"] = coco(shard)
    told["bop"] = bop(out, shard)
    told["wrong"] = list(_wrong(told))
    print(json.dumps(told, indent=2, default=float))
    return bool(told["wrong"])


def _wrong(told: dict[str, Any]) -> Iterator[str]:
    hits, box = told["first_hits"], told["bop"]["box_against_projected_corners_px"]
    checks = {
        "seconds": told.get("making", {}).get("wall_s_an_image", 0.0) <= SECONDS,
        "bytes": not told.get("same", {}).get("differ"),
        "first hits": hits["largest_share_of_pixels"] <= SHARE and not hits["pixels_away_from_outlines"],
        "whole masks": hits["pixels_of_whole_masks"] <= SHARE * ROWS * COLUMNS * hits["images"],
        "coco": not told["coco"]["wrong"] and not told["coco"]["wrong_labels"],
        "bop": not told["bop"]["wrong"] and not told["bop"]["wrong_counts"] and box <= 1.0,
    }
    return (name for name, right in checks.items() if not right)


def prepared(folder: Path, images: int) -> Path:
    """Files of the dataset; returns DATASET.toml."""
    folder.mkdir(parents=True, exist_ok=True)
    text = (SOURCE / "dataset.toml").read_text()
    lines = [f"images = {images}" if line.startswith("images") else line for line in text.splitlines()]
    sensor = f'"camera.sensor.rows" = {ROWS}\n"camera.sensor.columns" = {COLUMNS}'
    pixel = '"camera.sensor.pixel_width" = "7.5 um"\n"camera.sensor.pixel_height" = "7.5 um"'
    for name in ("scene.toml", "bracket.stl", "washer.stl", "shaft.stl"):
        (folder / name).write_bytes((SOURCE / name).read_bytes())
    path = folder / "dataset.toml"
    path.write_text("\n".join(lines) + f"\n[set]\n{sensor}\n{pixel}\n")
    return path


def killed(path: Path, out: Path, workers: int, after: float) -> bool:
    """Whether the command was killed, with its workers, before it had ended."""
    words = [sys.executable, "-m", "radwrap", "dataset", "run", str(path), "--out", str(out), "--workers", str(workers)]
    child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(after)
        return False
    os.killpg(child.pid, signal.SIGKILL)
    child.wait()
    return True


def made(folder: Path, out: Path, images: int, workers: int, kills: int) -> dict[str, Any]:
    """Make the dataset, and say what an image took."""
    path = prepared(folder, images)
    moments = generator(images).uniform(*KILLED_AFTER, size=kills)
    done = sum(killed(path, out, workers, after) for after in moments)
    start = time.monotonic()
    told = run_dataset(read_dataset(path), out, RunOptions(workers=workers, progress=True))
    wall = time.monotonic() - start
    used = [resource.getrusage(who) for who in (resource.RUSAGE_CHILDREN, resource.RUSAGE_SELF)]
    cpu = sum(one.ru_utime + one.ru_stime for one in used)
    number = max(told["made"], 1)
    return {
        "images": told["images"],
        "kills": done,
        "made_now": told["made"],
        "workers": workers,
        "wall_s_an_image": wall / number,
        "cpu_s_an_image": cpu / number,
        "objects": told["objects"],
        "missed": told["missed"],
    }


def same(shard: Path, other: Path) -> dict[str, Any]:
    """Files of the images that both have, byte for byte."""
    images, files, differ = 0, 0, []
    for record in sorted(other.glob("records/*.json")):
        if not (shard / "records" / record.name).exists():
            continue
        images += 1
        names = [f"records/{record.name}", *json.loads(record.read_text())["files"]]
        label = f"labels/{record.stem}.txt"  # written once a shard is whole
        names += [label] if (shard / label).exists() and (other / label).exists() else []
        files += len(names)
        differ += [name for name in names if (shard / name).read_bytes() != (other / name).read_bytes()]
    return {"images": images, "files": files, "differ": differ}


def _records(shard: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(shard.glob("records/*.json"))]


def _mask(shard: Path, kind: str, image: int, number: int) -> Any:
    return _read(shard / kind / f"{image:06d}_{number:06d}.png") > 0


def _read(path: Path) -> Any:
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if found is None:
        raise SystemExit(f"{path} cannot be read")
    return found


def _models(out: Path) -> dict[int, Any]:
    paths = sorted((out / "models").glob("obj_*.ply"))
    return {number: trimesh.load(path, process=False) for number, path in enumerate(paths, 1)}


def _placed(model: Any, one: dict[str, Any]) -> Any:
    mesh, matrix = model.copy(), np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.reshape(one["cam_R_m2c"], (3, 3)), one["cam_t_m2c"]
    return mesh.apply_transform(matrix)


def _first(mesh: Any, directions: Any, box: list[int]) -> Any:
    """Depth [mm] that rays through the pixels of a box meet first; infinite elsewhere."""
    depth = np.full((ROWS, COLUMNS), np.inf)
    left, top = max(box[0] - 2, 0), max(box[1] - 2, 0)
    right, bottom = min(box[0] + box[2] + 2, COLUMNS), min(box[1] + box[3] + 2, ROWS)
    if left >= right or top >= bottom:
        return depth
    rays = directions[top:bottom, left:right].reshape(-1, 3)
    places, index, _ = mesh.ray.intersects_location(np.zeros_like(rays), rays, multiple_hits=True)
    part = np.full(len(rays), np.inf)
    np.minimum.at(part, index, places[:, 2])
    depth[top:bottom, left:right] = part.reshape(bottom - top, right - left)
    return depth


def first_hits(out: Path, shard: Path, images: int) -> dict[str, Any]:
    """Masks against trimesh's rays; parts alone, and the nearest of all."""
    models = _models(out)
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    shares, inside, whole_differs, parts = [], 0, 0, 0
    for record in _records(shard)[:images]:
        matrix = np.reshape(record["camera"]["cam_K"], (3, 3))
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
        directions = np.linalg.solve(matrix, pixels.T).T.reshape(ROWS, COLUMNS, 3)
        nearest = np.full((ROWS, COLUMNS), np.inf)
        ours, theirs = np.zeros((ROWS, COLUMNS), int), np.zeros((ROWS, COLUMNS), int)
        for number, one in enumerate(record["objects"]):
            depth = _first(_placed(models[one["obj_id"]], one), directions, one["bbox_obj"])
            theirs[depth < nearest] = number + 1
            nearest = np.minimum(depth, nearest)
            ours[_mask(shard, "mask_visib", record["image"], number)] = number + 1
            whole_differs += int((np.isfinite(depth) != _mask(shard, "mask", record["image"], number)).sum())
            parts += 1
        differs = ours != theirs
        shares.append(float(differs.mean()))
        border = np.zeros_like(differs)
        for axis in (0, 1):
            step = np.diff(ours, axis=axis) != 0
            first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
            last = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
            border[first] |= step
            border[last] |= step
        inside += int((differs & ~border).sum())
    return {
        "images": images,
        "parts": parts,
        "largest_share_of_pixels": max(shares),
        "mean_share_of_pixels": float(np.mean(shares)),
        "pixels_away_from_outlines": inside,
        "pixels_of_whole_masks": whole_differs,
    }


def coco(shard: Path) -> dict[str, Any]:
    """What pycocotools reads, against the masks, and YOLO's labels against its boxes."""
    from pycocotools import mask as tools
    from pycocotools.coco import COCO

    with contextlib.redirect_stdout(sys.stderr):  # it says what it reads
        loaded = COCO(str(shard / "coco.json"))
    wrong, wrong_labels = 0, 0
    for record in _records(shard):
        size = np.array([COLUMNS, ROWS, COLUMNS, ROWS])
        lines = (shard / "labels" / f"{record['image']:06d}.txt").read_text().split("\n")
        told = [[float(word) for word in line.split()] for line in lines if line]
        asked = []
        number = {one["name"]: place for place, one in enumerate(record["objects"])}
        for one in loaded.loadAnns(loaded.getAnnIds(imgIds=[record["image"]])):
            mask = _mask(shard, "mask_visib", record["image"], number[one["name"]])
            left, top, width, height = one["bbox"]
            asked.append(
                [one["category_id"] - 1, *(np.array([left + width / 2, top + height / 2, width, height]) / size)]
            )
            packed = tools.encode(np.asfortranarray(mask.astype(np.uint8)))
            same = (loaded.annToMask(one) > 0) == mask
            wrong += not (
                same.all()
                and packed["counts"].decode() == one["segmentation"]["counts"]
                and tools.toBbox(packed).tolist() == one["bbox"]
                and int(tools.area(packed)) == one["area"]
            )
        wrong_labels += len(told) != len(asked) or not np.allclose(told, asked, atol=1e-8)
    return {
        "images": len(loaded.imgs),
        "annotations": len(loaded.anns),
        "wrong": wrong,
        "wrong_labels": wrong_labels,
    }


def _wrong_keys(told: dict[str, Any], keys: dict[str, int]) -> bool:
    """Whether keys are missing or too many, or have another number of numbers."""
    return set(told) != set(keys) or any(
        np.shape(told[key]) != ((count,) if count else ()) or not np.isfinite(told[key]).all()
        for key, count in keys.items()
    )


def _box(mask: Any) -> list[int]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return [-1, -1, -1, -1]
    return [int(columns[0]), int(rows[0]), int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1)]


def _wrong_models(out: Path, models: dict[int, Any]) -> int:
    """How many of models_info.json do not follow from the vertices; the diameter is the largest distance of two."""
    told = json.loads((out / "models" / "models_info.json").read_text())
    wrong = set(told) != {str(number) for number in models}
    for number, model in models.items():
        low, high = model.bounds
        corners = np.asarray(model.vertices)
        found = {
            **dict(zip(("min_x", "min_y", "min_z"), low, strict=True)),
            **dict(zip(("size_x", "size_y", "size_z"), high - low, strict=True)),
            "diameter": float(np.linalg.norm(corners[:, None] - corners[None], axis=2).max()),
        }
        wrong += any(not np.isclose(told[str(number)][key], value, atol=1e-4) for key, value in found.items())
    return int(wrong)


def bop(out: Path, shard: Path) -> dict[str, Any]:
    """Poses by cv2.projectPoints, boxes and shares by counting."""
    models = _models(out)
    read = {name: json.loads((shard / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")}
    farthest, wrong, depth_off = 0.0, 0, 0.0
    others = _wrong_models(out, models) + any(set(told) != set(read["gt"]) for told in read.values())
    for key, poses in read["gt"].items():
        camera = read["camera"][key]
        others += _wrong_keys(camera, KEYS["camera"]) + (len(poses) != len(read["gt_info"][key]))
        matrix = np.reshape(camera["cam_K"], (3, 3))
        depth = _read(shard / "depth" / f"{int(key):06d}.png")
        for number, (pose, info) in enumerate(zip(poses, read["gt_info"][key], strict=True)):
            rotation, translation = np.reshape(pose["cam_R_m2c"], (3, 3)), np.array(pose["cam_t_m2c"])
            others += _wrong_keys(pose, KEYS["gt"]) + _wrong_keys(info, KEYS["gt_info"])
            others += not (np.allclose(rotation @ rotation.T, np.eye(3)) and np.isclose(np.linalg.det(rotation), 1))
            vertices = np.asarray(models[pose["obj_id"]].vertices)
            uv = cv2.projectPoints(vertices, cv2.Rodrigues(rotation)[0], translation, matrix, None)[0][:, 0]
            box = info["bbox_obj"]
            if box[2] > 0:
                # Pixel centres inside the outline of the corners: each side of the box lies within a pixel of it.
                ends = np.array([box[0], box[1], box[0] + box[2] - 1, box[1] + box[3] - 1])
                off = np.abs(ends - np.concatenate([np.ceil(uv.min(axis=0)), np.floor(uv.max(axis=0))]))
                farthest = max(farthest, float(off.max()))
            seen, whole = (_mask(shard, kind, int(key), number) for kind in ("mask_visib", "mask"))
            wrong += seen.any() and _box(seen) != info["bbox_visib"]
            wrong += bool(int(seen.sum()) != info["px_count_visib"] or int(whole.sum()) != info["px_count_valid"])
            wrong += bool(info["px_count_all"] and info["visib_fract"] != seen.sum() / info["px_count_all"])
            if seen.any():
                z = depth[seen] * camera["depth_scale"]
                span = (vertices @ rotation.T + translation)[:, 2]
                depth_off = max(depth_off, float(span.min() - z.min()), float(z.max() - span.max()))
    return {
        "poses": sum(map(len, read["gt"].values())),
        "box_against_projected_corners_px": farthest,
        "wrong": others,
        "wrong_counts": wrong,
        "depth_beyond_model_mm": depth_off,
    }


if __name__ == "__main__":
    sys.exit(main())
