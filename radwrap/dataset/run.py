"""A dataset from its file to its shards: what is due is made by processes, and whoever is killed goes on."""

from __future__ import annotations

import shutil
import time
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from radwrap.dataset.bop import CAMERA, MODELS, camera_file, scene_files, write_models
from radwrap.dataset.coco import COCO_FILE, coco_file
from radwrap.dataset.collisions import OVERLAPS
from radwrap.dataset.document import Dataset
from radwrap.dataset.one_image import TRAIN, WORK, ImageJob, Place, is_whole, make_image
from radwrap.dataset.tables import BOP, COCO, YOLO
from radwrap.dataset.yolo import DATA, LABELS, data_text, label_text
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.extras import require
from radwrap.files import make_folder, sole_owner, write_bytes
from radwrap.imaging.render_options import RenderOptions, TracerName
from radwrap.manifest import (
    COMPILER_PACKAGES,
    SCHEMA_VERSION,
    json_text,
    plain,
    read_manifest,
    sha256_of_value,
    versions,
    write_manifest,
)
from radwrap.process import available_cores
from radwrap.progress import Progress
from radwrap.scene.file.input_hashes import input_hashes
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.targets import MeshPart
from radwrap.study.pool import WORKER_TIMEOUT, DaskPool, LocalPool, Pool, check_workers

DATASET: Final = "dataset.json"
MANIFEST: Final = "manifest.json"
# What a dataset has beside its dataset.json: somebody else's is neither written over nor removed.
_WRITTEN: Final = {TRAIN: "folder", MODELS: "folder", DATA: "file", CAMERA: "file"}
_AHEAD: Final = 2  # jobs in the pool's hands for each worker
_LOOK: Final = 1.0  # s for which an interrupt may wait at most
# What decides images besides radwrap's own needs: which parts cross, and where rays meet them.
_PACKAGES: Final = ("python-fcl", "trimesh", "scipy")
_DEATHS: Final = 3  # of workers over one image, after which it is blamed


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How a dataset is made; nothing of it changes a byte but `tracer`.

    Attributes
    ----------
    workers : int, optional
        Processes; default one a core.
    dask : str, optional
        Address of a Dask scheduler, in place of own processes.
    worker_timeout : float, optional
        How long the cluster may have no worker before the run ends [s]; default 60.
    force : bool
        Remove another dataset from the folder.
    trust, radiance, tracer_timeout, tracer
        As in `RenderOptions`.
    progress : bool
        Show progress on stderr.
    """

    workers: int | None = None
    dask: str | None = None
    worker_timeout: float | None = None
    force: bool = False
    trust: bool = False
    radiance: str | None = None
    tracer_timeout: float = 600.0
    tracer: TracerName = "auto"
    progress: bool = False

    def __post_init__(self) -> None:
        check_workers(self.workers, self.dask, self.worker_timeout)


def run_dataset(dataset: Dataset, out: Path, options: RunOptions) -> dict[str, Any]:
    """Make a dataset; images that are whole in the folder are kept.

    Returns
    -------
    dict
        What dataset.json holds, and ``made``, the number of images that were made now.

    Raises
    ------
    InputError
        If the folder holds another dataset, or an image cannot be made.
    EnvironmentFailure
        If a library, a tracer or the disk fails.
    """
    if dataset.most_objects > 1:
        require("dataset", OVERLAPS)
    how = RenderOptions(
        tolerance=dataset.tolerance,
        workers=1,
        trust=options.trust,
        radiance=options.radiance,
        tracer_timeout=options.tracer_timeout,
        tracer=options.tracer,
    )
    make_folder(out)
    with sole_owner(out):
        _remove_work(out)  # of a run that was killed
        told = _take_possession(dataset, out, options)
        due = [number for number in range(dataset.images) if not is_whole(Place.of(out, dataset, number))]
        if due:
            make_folder(out / WORK)
            try:
                _make(dataset, out, how, options, due)
            finally:
                _remove_work(out)
        return {**told, **_gather(dataset, out), "made": len(due)}


def _remove_work(out: Path) -> None:
    """Remove what is not whole. A cluster's worker who is still at an image finds no folder of that name any more."""
    gone = out / f"{WORK}.gone"
    shutil.rmtree(gone, ignore_errors=True)
    with suppress(OSError):
        (out / WORK).rename(gone)
    for folder in (gone, out / WORK):
        shutil.rmtree(folder, ignore_errors=True)


def _take_possession(dataset: Dataset, out: Path, options: RunOptions) -> dict[str, Any]:
    told = {
        "schema_version": SCHEMA_VERSION,
        "title": dataset.title,
        "dataset": _told_of(dataset),
        "files": input_hashes(
            [dataset.document],
            dataset.scene_origin,
            dataset.folder,
            trust=options.trust,
            beside=[plain(one) for one in dataset.vary],
        ),
        "tracer": options.tracer,
        "versions": versions(*COMPILER_PACKAGES),
    }
    told["dataset_sha256"] = sha256_of_value(told)
    if (out / DATASET).exists():
        if read_manifest(out / DATASET).get("dataset_sha256") == told["dataset_sha256"]:
            return told
        if not options.force:
            raise InputError(
                "holds another dataset, or one made with other files or programs",
                where=str(out),
                remedy="choose another `out`, or remove it by `force`",
            )
        # Its dataset.json goes last, so that one who is killed here may go on.
        for name, kind in _WRITTEN.items():
            if kind == "folder":
                shutil.rmtree(out / name, ignore_errors=True)
            else:
                (out / name).unlink(missing_ok=True)
    else:
        for name, kind in _WRITTEN.items():
            if (out / name).exists():
                raise InputError(
                    f'holds a {kind} "{name}" that no dataset wrote', where=str(out), remedy="choose another `out`"
                )
    write_manifest(out / DATASET, told)
    return told


def _told_of(dataset: Dataset) -> dict[str, Any]:
    """A dataset as JSON, without the place where it lies."""
    told: dict[str, Any] = plain(asdict(replace(dataset, folder=Path())))
    del told["folder"]
    return told


def _make(dataset: Dataset, out: Path, how: RenderOptions, options: RunOptions, due: list[int]) -> None:
    """Make the images that are due; the first that fails ends the run."""
    waiting = list(reversed(due))
    running: dict[Future[Any], int] = {}
    deaths: Counter[int] = Counter()
    progress = Progress("images", dataset.images, shown=options.progress)
    progress.skip(dataset.images - len(due))
    dataset = replace(dataset, folder=dataset.folder.absolute())  # workers of a cluster have their own working folder
    with closing(progress), closing(_open_pool(options, out, len(due))) as pool:
        while waiting or running:
            broken: list[int] = []
            while waiting and len(running) < _AHEAD * pool.workers:
                number = waiting.pop()
                try:
                    running[pool.submit(make_image, ImageJob(dataset, number, str(out.absolute()), how))] = number
                except RuntimeError as error:
                    if not pool.is_broken(error):
                        raise
                    broken.append(number)
                    break
            done = _done(running, pool)
            while done or (broken and running):  # the others of a broken pool come to an end too
                for future in done:
                    number = running.pop(future)
                    if future.cancelled():
                        pool.look()  # which may know why
                        raise EnvironmentFailure(
                            "its work was cancelled by somebody else", remedy="the same command continues"
                        )
                    failure = future.exception()
                    if failure is None:
                        progress.add(1)
                    elif pool.is_broken(failure):
                        broken.append(number)
                    else:
                        raise failure
                done = _done(running, pool) if broken else set()
            if broken:
                deaths.update(broken)
                number, times = deaths.most_common(1)[0]
                if times > _DEATHS:
                    raise EnvironmentFailure(f"its worker died {times} times", where=f"image {number}")
                waiting += sorted(broken, reverse=True)
                pool.rebuild()


def _done(running: Mapping[Future[Any], int], pool: Pool) -> set[Future[Any]]:
    """Jobs that came to an end; where none did for a while, the workers are looked after."""
    if running:
        done = wait(running, _LOOK, FIRST_COMPLETED).done
    else:
        done = set()
        if not pool.workers:
            time.sleep(_LOOK)
    if not done:
        pool.look()
    return done


def _open_pool(options: RunOptions, out: Path, jobs: int) -> Pool:
    """Workers for the dataset in a folder, to be closed by the caller."""
    if options.dask is not None:
        patience = options.worker_timeout or WORKER_TIMEOUT
        return DaskPool(options.dask, out, options.radiance, patience, _PACKAGES)
    return LocalPool(min(options.workers or available_cores(), jobs))


def _gather(dataset: Dataset, out: Path) -> dict[str, Any]:
    """Write what a shard has of all its images, from their records."""
    missed: dict[str, float | None] = {}
    objects: Counter[str] = Counter()
    for first in range(0, dataset.images, dataset.shard):
        numbers = range(first, min(first + dataset.shard, dataset.images))
        records = [read_manifest(Place.of(out, dataset, number).record) for number in numbers]
        shard = Place.of(out, dataset, first).shard
        _write_formats(dataset, shard, records)
        write_manifest(shard / MANIFEST, {"schema_version": SCHEMA_VERSION, "images": [_short(one) for one in records]})
        for record in records:
            objects.update(one["category"] for one in record["objects"])
            if not record["met"]:
                missed[str(record["image"])] = record["error"]["rms_gray_upper95"]
    _write_roots(dataset, out)
    return {"images": dataset.images, "objects": {name: objects[name] for name in dataset.categories}, "missed": missed}


def _write_formats(dataset: Dataset, shard: Path, records: list[dict[str, Any]]) -> None:
    """What the formats have of a shard."""
    if COCO in dataset.formats:
        write_bytes(shard / COCO_FILE, json_text(coco_file(dataset.title, dataset.categories, records)).encode())
    if BOP in dataset.formats:
        for name, told in scene_files(records).items():
            write_bytes(shard / name, json_text(told).encode())
    if YOLO in dataset.formats:
        make_folder(shard / LABELS)
        for record in records:
            write_bytes(shard / LABELS / f"{Path(record['gray']).stem}.txt", label_text(record).encode())


def _write_roots(dataset: Dataset, out: Path) -> None:
    """What the formats have of all shards."""
    if BOP in dataset.formats:
        base = scene_from_document(dataset.document, origin=dataset.scene_origin, folder=dataset.folder)
        parts = (target for target in base.targets if isinstance(target, MeshPart))
        write_models(out, parts, dataset.symmetries)
        first = read_manifest(Place.of(out, dataset, 0).record)
        write_bytes(out / CAMERA, json_text(camera_file(first, base.camera.sensor)).encode())
    if YOLO in dataset.formats:
        shards = range(-(-dataset.images // dataset.shard))
        folders = [f"{TRAIN}/{number:06d}/{dataset.gray_folder}" for number in shards]
        write_bytes(out / DATA, data_text(folders, dataset.categories).encode())


def _short(record: Mapping[str, Any]) -> dict[str, Any]:
    """What a shard's manifest says of an image: its certificate, and what was drawn."""
    return {
        key: record[key] for key in ("image", "gray", "seed", "error", "met", "tracer", "method", "by_box", "values")
    }
