"""One image of a dataset with its truth, as files; its record is written last, so that what has one is whole."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.dataset.bop import check_camera
from radwrap.dataset.coco import annotations_of
from radwrap.dataset.collisions import Standing, body_of
from radwrap.dataset.document import Dataset
from radwrap.dataset.drawn import DrawnImage, drawn_image
from radwrap.dataset.edges import edge_image
from radwrap.dataset.first_hits import FirstHits, ImageTruth, ObjectTruth
from radwrap.dataset.tables import BOP
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import disk_failure, move_files, sha256_of
from radwrap.frames import points_to_local
from radwrap.images import write_png
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.synthesis import render
from radwrap.manifest import SCHEMA_VERSION, plain, read_manifest, write_manifest
from radwrap.scene.camera import Camera
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.instants import held, keys_of_time, pose_time
from radwrap.scene.scene import Scene
from radwrap.scene.targets import MeshPart

TRAIN: Final = "train"
WORK: Final = ".work"
RECORDS: Final = "records"
_MASK: Final = np.uint8(255)
_MOST: Final = 65535
_FINEST: Final = 1e-3  # mm


@dataclass(frozen=True, slots=True)
class ImageJob:
    """An image to be made.

    Attributes
    ----------
    dataset : Dataset
    number : int
    out : str
        The dataset's folder.
    options : RenderOptions
        How; with one worker.
    """

    dataset: Dataset
    number: int
    out: str
    options: RenderOptions


@dataclass(frozen=True, slots=True)
class Place:
    """Where the files of an image lie: in the folder of its shard, by its number in it."""

    shard: Path
    inside: int

    @classmethod
    def of(cls, out: Path, dataset: Dataset, number: int) -> Place:
        """Of an image."""
        shard, inside = divmod(number, dataset.shard)
        return cls(out / TRAIN / f"{shard:06d}", inside)

    def file(self, kind: str, suffix: str, number: int | None = None) -> str:
        """Name of a file below the shard's folder; of an object with its number."""
        return f"{kind}/{self.inside:06d}{'' if number is None else f'_{number:06d}'}{suffix}"

    @property
    def record(self) -> Path:
        """The image's record."""
        return self.shard / self.record_name

    @property
    def record_name(self) -> str:
        """Its name below the shard's folder."""
        return self.file(RECORDS, ".json")


def make_image(job: ImageJob) -> int:
    """Render an image, find its truth, and write both; returns its number.

    Raises
    ------
    InputError
        If what was drawn is no scene, or parts find no place; with the number of the image.
    EnvironmentFailure
        If tracer or disk fail.
    """
    from threadpoolctl import threadpool_limits

    from radwrap.study.worker import ended_by_signal

    with ended_by_signal(), threadpool_limits(1):
        try:
            _make(job)
        except InputError as error:
            raise InputError(error.what, where=_where(job.number, error.where), remedy=error.remedy) from error
        except MemoryError as error:
            raise EnvironmentFailure(
                "not enough memory", where=f"image {job.number}", remedy="use fewer `workers`"
            ) from error
    return job.number


def _where(number: int, where: str) -> str:
    return f"image {number}: {where}" if where else f"image {number}"


def draw_standing(dataset: Dataset, number: int) -> tuple[DrawnImage, tuple[str, ...]]:
    """An image in which no part stands inside another, and the categories whose boxes stand for them."""
    if dataset.most_objects < 2:
        return drawn_image(dataset, number), ()
    base = scene_from_document(dataset.document, origin=dataset.scene_origin, folder=dataset.folder)
    parts = [target for target in base.targets if isinstance(target, MeshPart)]
    bodies = {part.name: body_of(part) for part in parts}
    drawn = drawn_image(dataset, number, Standing(bodies).place)
    return drawn, tuple(name for name, body in bodies.items() if body.is_box)


def _make(job: ImageJob) -> None:
    dataset, out = job.dataset, Path(job.out)
    drawn, boxes = draw_standing(dataset, job.number)
    scene = scene_from_document(drawn.document, origin=dataset.scene_origin, folder=dataset.folder)
    if BOP in dataset.formats:
        check_camera(scene.camera, f"{dataset.origin}: formats")
    hits = FirstHits(held(scene))
    truth = hits.truth(drawn.categories)
    place = Place.of(out, dataset, job.number)
    # Below the dataset's folder, where whoever goes on after a kill removes it. From there files are moved: two workers
    # of a cluster who are at one image move the same bytes, and one whose folder is gone moves nothing.
    with tempfile.TemporaryDirectory(dir=out / WORK) as folder:
        result = render(scene, Path(folder) / "run", job.options, seed=drawn.seed)
        image = result.frames(1)[0] if dataset.noise else result.gray
        scale = depth_scale(truth.depth)
        pictures = _pictures(place, dataset.gray_folder, image.codes, depth_codes(truth.depth, scale), truth)
        pictures[place.file("edges", ".png")] = edge_image(hits, truth)
        made = Path(folder) / "made"
        _write(made, pictures)
        numbers = {name: dataset.categories.index(category) + 1 for name, category in drawn.categories.items()}
        sensor = scene.camera.sensor
        record = {
            "schema_version": SCHEMA_VERSION,
            "image": job.number,
            "seed": drawn.seed,
            "gray": place.file(dataset.gray_folder, ".png"),
            "width": sensor.columns,
            "height": sensor.rows,
            "values": drawn.values,
            **({"poses_at_s": pose_time(scene)} if keys_of_time(scene) else {}),
            "error": plain(result.run.error, named=False),
            "met": result.run.met,
            "tracer": None if result.run.tracer is None else result.run.tracer.name,
            "method": result.run.method,
            "camera": _camera(scene.camera, scale),
            "objects": [_object(scene, one, drawn.categories, numbers) for one in truth.objects],
            "by_box": list(boxes),
            "coco": annotations_of(truth, numbers, job.number, dataset.segmentation),
            "files": {name: sha256_of(made / name) for name in pictures},
        }
        write_manifest(made / place.record_name, record)
        _move(made, place.shard, [*pictures, place.record_name])


def _pictures(
    place: Place, gray: str, codes: NDArray[Any], depth: NDArray[np.uint16], truth: ImageTruth
) -> dict[str, NDArray[Any]]:
    """Name below the shard's folder -> codes: the image, depth, and both masks of each object."""
    pictures: dict[str, NDArray[Any]] = {place.file(gray, ".png"): codes, place.file("depth", ".png"): depth}
    for number, one in enumerate(truth.objects):
        pictures[place.file("mask", ".png", number)] = one.whole * _MASK
        pictures[place.file("mask_visib", ".png", number)] = one.visible * _MASK
    return pictures


def _write(folder: Path, files: Mapping[str, NDArray[Any]]) -> None:
    try:
        folder.mkdir()  # without those above it, which whoever goes on may have removed
        for place in sorted({(folder / name).parent for name in (*files, f"{RECORDS}/x")}):
            place.mkdir()
    except OSError as error:
        raise disk_failure(folder, error) from error
    for name, codes in files.items():
        write_png(folder / name, codes)


def _move(made: Path, shard: Path, names: Sequence[str]) -> None:
    try:
        move_files(made, shard, names)
    except OSError as error:
        raise disk_failure(shard, error) from error


def depth_scale(depth: NDArray[np.float64]) -> float:
    """Step of a depth image [mm]: a power of ten, at least 1 um, by which the farthest point fits 16 bits."""
    farthest = float(depth.max()) * 1e3
    scale = _FINEST
    while farthest > _MOST * scale:
        scale = float(f"{scale * 10:g}")
    return scale


def depth_codes(depth: NDArray[np.float64], scale: float) -> NDArray[np.uint16]:
    """Depth [m] as whole numbers of steps of `scale` [mm]; 0 where there is nothing."""
    codes: NDArray[np.uint16] = np.rint(depth * 1e3 / scale).astype(np.uint16)
    return codes


def _camera(camera: Camera, scale: float) -> dict[str, Any]:
    """In OpenCV's frame: x right, y down, z forward, the centre of the first pixel at (0, 0); translations in mm."""
    world_from_camera = np.asarray(camera.pose.rotation)
    u, v = camera.principal_point
    width, height = camera.pitch
    told: dict[str, Any] = {
        "cam_K": [1 / width, 0.0, u, 0.0, 1 / height, v, 0.0, 0.0, 1.0],
        "cam_R_w2c": world_from_camera.T.ravel().tolist(),
        "cam_t_w2c": (points_to_local(camera.pose, np.zeros((1, 3)))[0] * 1e3).tolist(),
        "depth_scale": scale,
    }
    if camera.distortion is not None:
        told["distortion"] = plain(camera.distortion)
    return told


def _object(
    scene: Scene, one: ObjectTruth, categories: Mapping[str, str], numbers: Mapping[str, int]
) -> dict[str, Any]:
    camera, pose = scene.camera, one.part.pose
    rotation = np.asarray(camera.pose.rotation).T @ np.asarray(pose.rotation)
    translation = points_to_local(camera.pose, np.array([pose.position]))[0] * 1e3
    return {
        "name": one.part.name,
        "category": categories[one.part.name],
        "obj_id": numbers[one.part.name],
        "cam_R_m2c": rotation.ravel().tolist(),
        "cam_t_m2c": translation.tolist(),
        "bbox_obj": one.whole_box.values,
        "bbox_visib": one.visible_box.values,
        "px_count_all": one.whole_pixels,
        "px_count_valid": int(one.whole.sum()),
        "px_count_visib": one.visible_pixels,
        "visib_fract": one.visible_share,
    }


def is_whole(place: Place) -> bool:
    """Whether an image is done: its record appears after all its files, which are still what it says."""
    if not place.record.is_file():
        return False
    files = read_manifest(place.record)["files"]
    return all((place.shard / name).is_file() and sha256_of(place.shard / name) == told for name, told in files.items())
