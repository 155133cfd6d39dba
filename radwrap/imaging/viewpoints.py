"""The finite pinhole, the paper's way: one tracer process for each sub-viewpoint (Sec. 3.1).

Each sub-viewpoint becomes a float32 OpenEXR file; the files are the memory of
a run, so that a killed one goes on where it was, and they are merged one by
one with their area weights.
"""

from __future__ import annotations

import threading
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import TEMPORARY_SUFFIX
from radwrap.images import digest, read_image, write_exr
from radwrap.imaging.aperture import Viewpoints
from radwrap.imaging.view import PixelPlan, pixel_means, ray_blocks, traced
from radwrap.manifest import sha256_of_value
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Camera
from radwrap.tracers.tracer import Tracer

CALL_LOG: Final = "tracer_calls.log"
_CHANNEL: Final = "radiance_cos4"
_TICK: Final = 0.2  # s


@dataclass(frozen=True, slots=True)
class ViewpointPlan:
    """Everything that decides the pixels of the sub-viewpoints.

    Attributes
    ----------
    camera : Camera
        Pose, focal length and pixels.
    viewpoints : Viewpoints
        Where the sub-viewpoints lie.
    pixel_plan : PixelPlan
        Rays of each pixel.
    scene_sha256 : str
        Hash of the scene as the tracer gets it, and of the tracer itself.
    """

    camera: Camera
    viewpoints: Viewpoints
    pixel_plan: PixelPlan
    scene_sha256: str

    def sha256(self) -> str:
        """Hash of all that the pixels depend on; exposure and sensor response are not among it."""
        camera = self.camera
        return sha256_of_value(
            {
                "scene": self.scene_sha256,
                "pose": camera.pose,
                "focal_length": camera.focal_length,
                "principal_point": camera.principal_point,
                "sensor": [getattr(camera.sensor, key) for key in ("rows", "columns", "pixel_width", "pixel_height")],
                "channel": camera.sensor.channel,
                "positions": self.viewpoints.positions.tolist(),
                "weights": self.viewpoints.weights.tolist(),
                "pixel_plan": self.pixel_plan,
            }
        )

    @property
    def rays(self) -> int:
        """Rays in all."""
        return self.camera.sensor.pixels * self.pixel_plan.rays * len(self.viewpoints)


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Area-weighted means over the sub-viewpoints, float64, shape (rows, columns) [W m^-2 sr^-1].

    Attributes
    ----------
    mean : ndarray
        Over all of them.
    halves : tuple of ndarray
        Over every second one and over the others, each with its own weights;
        empty where there is only one.
    """

    mean: NDArray[np.float64]
    halves: tuple[NDArray[np.float64], ...]


def viewpoint_file(folder: Path, index: int) -> Path:
    """File of a sub-viewpoint."""
    return folder / f"viewpoint_{index:05d}.exr"


def trace_viewpoints(
    plan: ViewpointPlan, tracer: Tracer, folder: Path, *, programs: Programs, workers: int, progress: Progress
) -> int:
    """Trace every sub-viewpoint whose file is not there, whole and of this plan.

    Parameters
    ----------
    plan : ViewpointPlan
        What to trace.
    tracer : Tracer
        Who traces.
    folder : Path
        Where the files are.
    programs : Programs
        Ended at the first failure.
    workers : int
        Sub-viewpoints at a time.
    progress : Progress
        Counts rays.

    Returns
    -------
    int
        How many files were re-used.
    """
    _remove_strangers(folder, len(plan.viewpoints))
    due = missing_viewpoints(plan, folder)
    reused = len(plan.viewpoints) - len(due)
    progress.skip(reused * plan.rays // len(plan.viewpoints))

    with ThreadPoolExecutor(max_workers=workers) as pool:
        jobs = [
            pool.submit(canvas.trace, part, tracer, progress)
            for canvas in _canvases(plan, folder, due, workers)
            for part in range(canvas.parts)
        ]
        try:
            waiting: set[Future[None]] = set(jobs)
            while waiting:
                # Awake now and then: a signal that another thread got is heard by the main one only when it runs.
                done, waiting = wait(waiting, timeout=_TICK, return_when=FIRST_EXCEPTION)
                for job in done:
                    job.result()
        except BaseException:
            # Ctrl-C comes here too: the programs end at once, and so do the threads that wait for them.
            for job in jobs:
                job.cancel()
            programs.cancel()
            raise
    return reused


def missing_viewpoints(plan: ViewpointPlan, folder: Path) -> list[int]:
    """Numbers of the sub-viewpoints whose file is not there, whole and of this plan."""
    name = plan.sha256()
    return [i for i in range(len(plan.viewpoints)) if not _is_whole(viewpoint_file(folder, i), name, i)]


def _remove_strangers(folder: Path, count: int) -> None:
    """Remove half-written files and sub-viewpoints that this plan does not have."""
    ours = {viewpoint_file(folder, index).name for index in range(count)}
    for path in folder.iterdir():
        if path.suffix == ".exr" and (path.name not in ours or TEMPORARY_SUFFIX in path.suffixes):
            path.unlink(missing_ok=True)


def _is_whole(path: Path, plan: str, index: int) -> bool:
    """Whether a file holds this sub-viewpoint of this plan, every pixel of it."""
    if not path.is_file():
        return False
    try:
        pixels, metadata = read_image(path)
    except InputError:
        return False
    return (metadata.get("radwrap:plan"), metadata.get("radwrap:index"), metadata.get("radwrap:pixels")) == (
        plan,
        str(index),
        digest(pixels),
    )


class _Canvas:
    """A sub-viewpoint while it is traced, in one part or in several; the last part to end writes the file."""

    def __init__(self, plan: ViewpointPlan, folder: Path, index: int, parts: int) -> None:
        self.parts = parts
        self._plan = plan
        self._folder = folder
        self._index = index
        self._pixels: NDArray[np.float32] | None = None
        self._due = parts
        self._guard = threading.Lock()

    def trace(self, part: int, tracer: Tracer, progress: Progress) -> None:
        """Trace one part, and write the file if it was the last one."""
        plan, index = self._plan, self._index
        pixels = self._begun()
        position = (float(plan.viewpoints.positions[index, 0]), float(plan.viewpoints.positions[index, 1]))
        blocks = ray_blocks(plan.camera, position, plan.pixel_plan, index, part=part, parts=self.parts)
        for block, radiance in traced(tracer.trace, blocks):
            pixels[block.first : block.first + block.pixels] = pixel_means(block, radiance)
            progress.add(len(radiance))
        with self._guard:
            self._due -= 1
            whole = not self._due
        if whole:
            self._pixels = None
            _write(plan, self._folder, index, pixels)

    def _begun(self) -> NDArray[np.float32]:
        with self._guard:
            if self._pixels is None:
                with (self._folder / CALL_LOG).open("a", encoding="ascii") as log:
                    log.write(f"{self._index}\n")
                self._pixels = np.empty(self._plan.camera.sensor.pixels, dtype=np.float32)
            return self._pixels


def _canvases(plan: ViewpointPlan, folder: Path, due: list[int], workers: int) -> list[_Canvas]:
    """One for each sub-viewpoint that is due; the last ones, too few for all workers, are traced in parts."""
    whole = len(due) - len(due) % workers
    return [_Canvas(plan, folder, index, 1 if place < whole else workers) for place, index in enumerate(due)]


def _write(plan: ViewpointPlan, folder: Path, index: int, pixels: NDArray[np.float32]) -> None:
    sensor = plan.camera.sensor
    image = pixels.reshape(sensor.rows, sensor.columns)
    position, weight = plan.viewpoints.positions[index], float(plan.viewpoints.weights[index])
    metadata: dict[str, Any] = {
        "plan": plan.sha256(),
        "index": index,
        "pixels": digest(image),
        "position_u": float(position[0]),
        "position_v": float(position[1]),
        "area": weight * plan.viewpoints.area,
        "weight": weight,
        "unit": "W m^-2 sr^-1",
    }
    write_exr(
        viewpoint_file(folder, index),
        image,
        channel=_CHANNEL,
        metadata={f"radwrap:{key}": str(value) for key, value in metadata.items()},
    )


def merge(plan: ViewpointPlan, folder: Path) -> Merged:
    """Area-weighted means, reading one file at a time in a fixed order.

    Raises
    ------
    EnvironmentFailure
        If a file changed since it was written.
    """
    name = plan.sha256()
    weights = plan.viewpoints.weights
    shape = (plan.camera.sensor.rows, plan.camera.sensor.columns)
    sums = [np.zeros(shape), np.zeros(shape)]
    for index, weight in enumerate(weights):
        path = viewpoint_file(folder, index)
        pixels, metadata = read_image(path)
        if metadata.get("radwrap:plan") != name or pixels.shape != shape:
            raise EnvironmentFailure("was changed by somebody else", where=str(path), remedy="run again")
        sums[index % 2] += weight * pixels.astype(np.float64)
    mean = sums[0] + sums[1]
    if len(weights) < 2:
        return Merged(mean, ())
    return Merged(mean, tuple(part / weights[first::2].sum() for first, part in enumerate(sums)))
