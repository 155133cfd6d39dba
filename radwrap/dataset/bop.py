"""The layout of BOP, the benchmark for 6D poses: cameras, poses and shares of each scene, and models in millimetres.

Frames are OpenCV's: x right, y down, z forward; ``cam_R_m2c`` and
``cam_t_m2c`` take a point of the model into the camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.dataset.symmetries import Symmetry, told_symmetries
from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import json_text
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.targets import MeshPart

MODELS: Final = "models"
CAMERA: Final = "camera.json"
_MM: Final = 1e3
_POSE: Final = ("cam_R_m2c", "cam_t_m2c", "obj_id")
_SEEN: Final = ("bbox_obj", "bbox_visib", "px_count_all", "px_count_valid", "px_count_visib", "visib_fract")
_NO_BOX: Final = [-1, -1, -1, -1]
_ROWS_AT_ONCE: Final = 2048


def check_camera(camera: Camera, where: str) -> None:
    """Refuse a camera that BOP has no words for.

    Raises
    ------
    InputError
        If the lens distorts.
    """
    if camera.distortion is not None:
        raise InputError(
            "BOP has no distortion, and the camera has", where=where, remedy='leave "bop" or `camera.distortion` out'
        )


def scene_files(records: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """scene_camera.json, scene_gt.json and scene_gt_info.json of a shard, from the records of its images in order."""
    cameras: dict[str, Any] = {}
    poses: dict[str, Any] = {}
    shares: dict[str, Any] = {}
    for number, record in enumerate(records):
        cameras[str(number)] = record["camera"]
        poses[str(number)] = [{key: one[key] for key in _POSE} for one in record["objects"]]
        shares[str(number)] = [_seen(one) for one in record["objects"]]
    return {"scene_camera.json": cameras, "scene_gt.json": poses, "scene_gt_info.json": shares}


def camera_file(record: Mapping[str, Any], sensor: Sensor) -> dict[str, float]:
    """camera.json of a dataset, for simulations of its camera: that of an image, by its record."""
    camera = record["camera"]
    fx, _, cx, _, fy, cy, *_ = camera["cam_K"]
    size = {"width": sensor.columns, "height": sensor.rows}
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, **size, "depth_scale": camera["depth_scale"]}


def _seen(one: Mapping[str, Any]) -> dict[str, Any]:
    told = {key: one[key] for key in _SEEN}
    for key in ("bbox_obj", "bbox_visib"):
        if told[key][2:] == [0, 0]:
            told[key] = _NO_BOX  # as BOP's tools write it
    return told


def write_models(folder: Path, parts: Iterable[MeshPart], symmetries: Sequence[Symmetry] = ()) -> None:
    """Write the mesh of each category as PLY [mm], and their sizes and symmetries; the first has the number 1."""
    make_folder(folder / MODELS)
    sizes: dict[str, Any] = {}
    for number, part in enumerate(parts, 1):
        vertices = part.mesh.vertices * _MM
        write_bytes(folder / MODELS / f"obj_{number:06d}.ply", ply_text(vertices, part.mesh.faces).encode())
        mine = [one for one in symmetries if one.target == part.name]
        sizes[str(number)] = model_size(vertices) | told_symmetries(mine)
    write_bytes(folder / MODELS / "models_info.json", json_text(sizes).encode())


def ply_text(vertices: NDArray[np.float64], faces: NDArray[np.intp]) -> str:
    """A mesh as a PLY file of text."""
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    rows = [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    return "\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in faces.tolist())]) + "\n"


def model_size(vertices: NDArray[np.float64]) -> dict[str, float]:
    """Largest distance of two vertices, and the box around them, in the unit of the vertices."""
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    told = {"diameter": _diameter(vertices)}
    told |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return told | {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}


def _diameter(vertices: NDArray[np.float64]) -> float:
    """Largest distance of two points: both are corners of the convex hull."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import cdist

    try:
        corners = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # they lie in a plane
        corners = vertices
    return max(
        float(cdist(corners[first : first + _ROWS_AT_ONCE], corners).max())
        for first in range(0, len(corners), _ROWS_AT_ONCE)
    )
