"""The finite pinhole, the paper's way: one tracer process for each sub-viewpoint (Sec. 3.1).

Each sub-viewpoint becomes a float32 OpenEXR file; the files are the memory of
a run, so that a killed one goes on where it was, and they are merged one by
one with their area weights.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure
from radwrap.imaging.methods.pieces import log_call, read_piece, remove_strangers, run_jobs, write_piece
from radwrap.imaging.optics.aperture import Viewpoints
from radwrap.imaging.optics.view import PixelPlan, pixel_means, ray_blocks, traced
from radwrap.manifest import sha256_of_value
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Camera
from radwrap.tracers.tracer import Tracer


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
    traced_sha256 : str
        Hash of the scene as the tracer gets it, and of the tracer itself.
    """

    camera: Camera
    viewpoints: Viewpoints
    pixel_plan: PixelPlan
    traced_sha256: str

    def sha256(self) -> str:
        """Hash of all that the pixels depend on; exposure and sensor response are not among it."""
        camera = self.camera
        return sha256_of_value(
            {
                "scene": self.traced_sha256,
                "pose": camera.pose,
                "focal_length": camera.focal_length,
                "principal_point": camera.principal_point,
                "sensor": [getattr(camera.sensor, key) for key in ("rows", "columns", "pixel_width", "pixel_height")],
                "channel": camera.sensor.channel,
                "positions": self.viewpoints.positions.tolist(),
                "weights": self.viewpoints.weights.tolist(),
                "pixel_plan": self.pixel_plan,
                **({"window": camera.sensor.window} if camera.sensor.window else {}),
                **({"distortion": camera.distortion} if camera.distortion else {}),
                **({"lens": camera.lens} if camera.lens else {}),
            }
        )

    @property
    def rays(self) -> int:
        """Rays in all."""
        return self.camera.sensor.pixels * self.pixel_plan.rays * len(self.viewpoints)


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
        How many files were reused.
    """
    remove_strangers(folder, {viewpoint_file(folder, index).name for index in range(len(plan.viewpoints))})
    due = missing_viewpoints(plan, folder)
    reused = len(plan.viewpoints) - len(due)
    progress.skip(reused * plan.rays // len(plan.viewpoints))

    canvases = _canvases(plan, folder, due, workers)
    jobs = [partial(canvas.trace, part, tracer, progress) for canvas in canvases for part in range(canvas.parts)]
    run_jobs(jobs, programs, workers)
    return reused


def missing_viewpoints(plan: ViewpointPlan, folder: Path) -> list[int]:
    """Numbers of the sub-viewpoints whose file is not there, whole and of this plan."""
    name = plan.sha256()
    return [i for i in range(len(plan.viewpoints)) if read_piece(viewpoint_file(folder, i), _name(name, i)) is None]


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
                log_call(self._folder, self._index)
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
    metadata = {
        "index": index,
        "position_u": float(position[0]),
        "position_v": float(position[1]),
        "area": weight * plan.viewpoints.area,
        "weight": weight,
    }
    write_piece(viewpoint_file(folder, index), image, _name(plan.sha256(), index), metadata, packed=True)


def _name(plan: str, index: int) -> str:
    """A sub-viewpoint's plan: files of the same plan may not change places either."""
    return f"{plan}-{index}"


def merge(plan: ViewpointPlan, folder: Path) -> NDArray[np.float64]:
    """Area-weighted mean over the sub-viewpoints, reading one file at a time in a fixed order.

    Returns
    -------
    ndarray of float64, shape (rows, columns)
        [W m^-2 sr^-1]

    Raises
    ------
    EnvironmentFailure
        If a file changed since it was written.
    """
    name = plan.sha256()
    shape = (plan.camera.sensor.rows, plan.camera.sensor.columns)
    mean = np.zeros(shape)
    for index, weight in enumerate(plan.viewpoints.weights):
        path = viewpoint_file(folder, index)
        found = read_piece(path, _name(name, index))
        if found is None or found[0].shape != shape:
            raise EnvironmentFailure("was changed by somebody else", where=str(path), remedy="run again")
        mean += weight * found[0].astype(np.float64)
    return mean
