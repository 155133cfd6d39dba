"""A dataset of 640 x 512 pixels under a ring, judged by other programs: time, masks, COCO, BOP.

    python scripts/dataset_check.py OUT [--images 1000] [--masks 20] [--workers 1]

Makes `rad_scenes/dataset_parts` with that many images into OUT/data, or goes on with it, and prints JSON:

- seconds of wall clock and of processors for each image that was made now;
- masks against first hits of trimesh's own rays at pixel centres (`pip install rtree`): shares of pixels that differ,
  and how many of these do not lie at an outline;
- whole masks against trimesh's rays on each part alone;
- COCO by pycocotools, if it is installed: `pip install pycocotools`, a program of development that nothing else needs;
- BOP: vertices of models/*.ply by cv2.projectPoints against bbox_obj, boxes and shares counted from the masks again.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

from radwrap.dataset.document import read_dataset
from radwrap.dataset.run import RunOptions, run_dataset

SOURCE = Path(__file__).parents[1] / "rad_scenes" / "dataset_parts"
ROWS, COLUMNS = 512, 640


def main() -> None:
    """Make the dataset and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--images", type=int, default=1000)  # one shard at most
    parser.add_argument("--masks", type=int, default=20)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    out = given.out / "data"
    told = {"making": made(given.out, out, given.images, given.workers)}
    shard = out / "train" / "000000"
    told["first_hits"] = first_hits(out, shard, min(given.masks, given.images))
    told["coco"] = coco(shard)
    told["bop"] = bop(out, shard)
    print(json.dumps(told, indent=2, default=float))


def made(folder: Path, out: Path, images: int, workers: int) -> dict[str, Any]:
    """Make the dataset, and say what an image took."""
    text = (SOURCE / "dataset.toml").read_text()
    lines = [f"images = {images}" if line.startswith("images") else line for line in text.splitlines()]
    sensor = f'"camera.sensor.rows" = {ROWS}\n"camera.sensor.columns" = {COLUMNS}'
    pixel = '"camera.sensor.pixel_width" = "7.5 um"\n"camera.sensor.pixel_height" = "7.5 um"'
    for name in ("scene.toml", "bracket.stl", "washer.stl", "shaft.stl"):
        (folder / name).write_bytes((SOURCE / name).read_bytes())
    path = folder / "dataset.toml"
    path.write_text("\n".join(lines) + f"\n[set]\n{sensor}\n{pixel}\n")
    start = time.monotonic()
    told = run_dataset(read_dataset(path), out, RunOptions(workers=workers, progress=True))
    wall = time.monotonic() - start
    used = [resource.getrusage(who) for who in (resource.RUSAGE_CHILDREN, resource.RUSAGE_SELF)]
    cpu = sum(one.ru_utime + one.ru_stime for one in used)
    number = max(told["made"], 1)
    return {
        "images": told["images"],
        "made_now": told["made"],
        "workers": workers,
        "wall_s_an_image": wall / number,
        "cpu_s_an_image": cpu / number,
        "objects": told["objects"],
        "missed": told["missed"],
        "largest_bound_rms_gray": max(one["error"]["rms_gray_upper95"] for one in _records(out / "train" / "000000")),
    }


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
    """What pycocotools reads, against the masks."""
    if importlib.util.find_spec("pycocotools") is None:
        return {"left_out": "pycocotools is not installed"}
    from pycocotools import mask as tools
    from pycocotools.coco import COCO

    loaded = COCO(str(shard / "coco.json"))
    wrong = 0
    for record in _records(shard):
        number = {one["name"]: place for place, one in enumerate(record["objects"])}
        for one in loaded.loadAnns(loaded.getAnnIds(imgIds=[record["image"]])):
            mask = _mask(shard, "mask_visib", record["image"], number[one["name"]])
            packed = tools.encode(np.asfortranarray(mask.astype(np.uint8)))
            same = (loaded.annToMask(one) > 0) == mask
            wrong += not (
                same.all()
                and packed["counts"].decode() == one["segmentation"]["counts"]
                and tools.toBbox(packed).tolist() == one["bbox"]
                and int(tools.area(packed)) == one["area"]
            )
    return {"images": len(loaded.imgs), "annotations": len(loaded.anns), "wrong": wrong}


def bop(out: Path, shard: Path) -> dict[str, Any]:
    """Poses by cv2.projectPoints, boxes and shares by counting."""
    models = _models(out)
    read = {name: json.loads((shard / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")}
    farthest, wrong, depth_off = 0.0, 0, 0.0
    for key, poses in read["gt"].items():
        camera = read["camera"][key]
        matrix = np.reshape(camera["cam_K"], (3, 3))
        depth = _read(shard / "depth" / f"{int(key):06d}.png")
        for number, (pose, info) in enumerate(zip(poses, read["gt_info"][key], strict=True)):
            rotation, translation = np.reshape(pose["cam_R_m2c"], (3, 3)), np.array(pose["cam_t_m2c"])
            vertices = np.asarray(models[pose["obj_id"]].vertices)
            uv = cv2.projectPoints(vertices, cv2.Rodrigues(rotation)[0], translation, matrix, None)[0][:, 0]
            box = info["bbox_obj"]
            if box[2] > 0:
                # Pixel centres inside the outline of the corners: each side of the box lies within a pixel of it.
                ends = np.array([box[0], box[1], box[0] + box[2] - 1, box[1] + box[3] - 1])
                off = np.abs(ends - np.concatenate([np.ceil(uv.min(axis=0)), np.floor(uv.max(axis=0))]))
                farthest = max(farthest, float(off.max()))
            seen, whole = (_mask(shard, kind, int(key), number) for kind in ("mask_visib", "mask"))
            wrong += bool(int(seen.sum()) != info["px_count_visib"] or int(whole.sum()) != info["px_count_valid"])
            wrong += bool(info["px_count_all"] and info["visib_fract"] != seen.sum() / info["px_count_all"])
            if seen.any():
                z = depth[seen] * camera["depth_scale"]
                span = (vertices @ rotation.T + translation)[:, 2]
                depth_off = max(depth_off, float(span.min() - z.min()), float(z.max() - span.max()))
    return {
        "poses": sum(map(len, read["gt"].values())),
        "box_against_projected_corners_px": farthest,
        "wrong_counts": wrong,
        "depth_beyond_model_mm": depth_off,
    }


if __name__ == "__main__":
    main()
