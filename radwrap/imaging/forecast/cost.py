"""What a run will cost: rays, memory, time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radwrap.errors import InputError
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.scene.scene import Scene

# Measured on rtrace 6.0a: a fixed part, and a part for each source, for each ray [s on one core].
_SECONDS_PER_RAY: Final = 0.6e-6
_SECONDS_PER_RAY_AND_SOURCE: Final = 0.6e-6
_TIMED_PIXELS: Final = 20_000
# Interpreter, libraries and one tracer [byte].
_BASE_MEMORY: Final = 150 << 20
# Float64 sums and images while merging, and each worker's float32 image with its copy for reading back [byte/pixel].
_MERGE_BYTES: Final = 60
_WORKER_BYTES: Final = 16
# Of replicates that are kept beside their image, each as float32 with what cells change and as float64 twice, once more
# while they are written: measured at 1.3 million pixels [byte/pixel].
_REPLICATE_BYTES: Final = 36


@dataclass(frozen=True, slots=True)
class Cost:
    """What a run will cost.

    Attributes
    ----------
    rays : int
        Rays in all.
    memory_bytes : int
        Peak memory of all its processes [byte].
    seconds : float
        Wall time [s].
    """

    rays: int
    memory_bytes: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.rays:.3g} rays, {self.memory_bytes / 2**30:.2g} GiB of memory, {duration(self.seconds)}"


def duration(seconds: float) -> str:
    """A time as people say it."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2g} s"


def seconds_per_ray(view: View) -> float:
    """Time a ray takes on one core [s], from pixels spread over the sensor."""
    sensor = view.camera.sensor
    pixels = np.unique(np.linspace(0, sensor.pixels - 1, min(_TIMED_PIXELS, sensor.pixels)).astype(np.intp))
    v, u = np.divmod(pixels.astype(np.float64), sensor.columns)
    start = time.monotonic()
    trace_rays(replace(view, workers=1), None, u, v)
    return (time.monotonic() - start) / len(pixels)


def estimate(
    scene: Scene, rays: float, workers: int, measure: Callable[[], float] | None = None, *, replicates: int = 0
) -> Cost:
    """Estimate what a run will cost.

    Parameters
    ----------
    scene : Scene
        For the size of the sensor and the number of sources.
    rays : float
        Rays in all.
    workers : int
        Tracer processes at a time.
    measure : callable, optional
        Gives the time a ray takes on one core [s]; default a model of rtrace.
    replicates : int
        Images that are kept beside the result, as runs of a study do.
    """
    pixels = scene.camera.sensor.pixels
    model = _SECONDS_PER_RAY + _SECONDS_PER_RAY_AND_SOURCE * len(scene.emitters)
    per_ray = model if measure is None else measure()
    return Cost(
        rays=round(rays),
        memory_bytes=_BASE_MEMORY + pixels * (_MERGE_BYTES + _WORKER_BYTES * workers + _REPLICATE_BYTES * replicates),
        seconds=rays * per_ray / workers,
    )


def check_size(scene: Scene, max_pixels: int, rays_per_pixel: float, workers: int, *, replicates: int = 0) -> None:
    """Refuse a sensor that is larger than the user wants to pay for.

    Raises
    ------
    InputError
        With what the run would cost.
    """
    pixels = scene.camera.sensor.pixels
    if pixels > max_pixels:
        raise InputError(
            f"{pixels:.4g} pixels are more than `max_pixels={max_pixels:.4g}`; this would take "
            f"{estimate(scene, pixels * rays_per_pixel, workers, replicates=replicates)}",
            where=f"{scene.origin}: camera.sensor",
            remedy="raise `max_pixels` if that is meant",
        )
