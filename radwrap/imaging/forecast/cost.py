"""What a run will cost: rays, memory, time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from radwrap.errors import InputError
from radwrap.scene.scene import Scene
from radwrap.written import NotNegative

# Measured on rtrace 6.0a: a fixed part, and a part for each source, for each ray [s on one core].
_SECONDS_PER_RAY: Final = 0.6e-6
_SECONDS_PER_RAY_AND_SOURCE: Final = 0.6e-6
# Rays a pixel that a tolerance takes, where only a rough number is needed.
USUAL_RAYS: Final = 8
# Interpreter, libraries and one tracer [byte].
_BASE_MEMORY: Final = 150 << 20
# Float64 sums and images while merging, and each worker's float32 image with its copy for reading back [byte/pixel].
_MERGE_BYTES: Final = 60
_WORKER_BYTES: Final = 16
# Of replicates that are kept beside their image, each as float32 with what cells change and as float64 twice, once more
# while they are written: measured at 1.3 million pixels [byte/pixel].
_REPLICATE_BYTES: Final = 36
# Of what waves add, by a count of arrays of float64: two replicates at least, with their gray levels twice, and
# of their mean [byte/pixel].
_WAVE_BYTES: Final = 24
_WAVE_IMAGE_BYTES: Final = 48


@dataclass(frozen=True, slots=True)
class Cheaper:
    """A change to a run, and what it would take then.

    Attributes
    ----------
    change : str
        In words.
    wall_s : float
        Wall time [s].
    """

    change: str
    wall_s: NotNegative

    def __str__(self) -> str:
        return f"with {self.change} it would take about {duration(self.wall_s)}"


@dataclass(frozen=True, slots=True)
class Foretold:
    """What was said of a run's time before it was carried out.

    Attributes
    ----------
    wall_s : float
        Wall time [s].
    parts : Mapping[str, float]
        What is done -> its wall time [s].
    cheaper : tuple of Cheaper
        What would take less, where the run is long.
    """

    wall_s: NotNegative
    parts: Mapping[str, NotNegative]
    cheaper: tuple[Cheaper, ...] = ()


@dataclass(frozen=True, slots=True)
class Cost:
    """What a run will cost.

    Attributes
    ----------
    rays : int
        Rays in all.
    memory_bytes : int
        Peak memory of all its processes [byte].
    parts : Mapping[str, float]
        What is done -> its wall time [s].
    cheaper : tuple of Cheaper
        What would take less, where the run is long.
    """

    rays: int
    memory_bytes: int
    parts: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    cheaper: tuple[Cheaper, ...] = ()

    @property
    def seconds(self) -> float:
        """Wall time of all parts [s]."""
        return sum(self.parts.values())

    @property
    def foretold(self) -> Foretold:
        """Its times."""
        return Foretold(self.seconds, dict(self.parts), self.cheaper)

    def __str__(self) -> str:
        return f"{self.rays:.3g} rays, {self.memory_bytes / 2**30:.2g} GiB of memory, {duration(self.seconds)}"


def duration(seconds: float) -> str:
    """A time as people say it."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2g} s"


def estimate(scene: Scene, rays: float, workers: int, *, replicates: int = 0) -> Cost:
    """Estimate what a run will cost, by a model of rtrace.

    Parameters
    ----------
    scene : Scene
        For the size of the sensor and the number of sources.
    rays : float
        Rays in all.
    workers : int
        Tracer processes at a time.
    replicates : int
        Images that are kept beside the result, as runs of a study do.
    """
    pixels = scene.camera.sensor.pixels
    per_ray = _SECONDS_PER_RAY + _SECONDS_PER_RAY_AND_SOURCE * len(scene.emitters)
    each = _MERGE_BYTES + _WORKER_BYTES * workers + _REPLICATE_BYTES * replicates
    if scene.camera.diffraction is not None:
        each += _WAVE_IMAGE_BYTES + _WAVE_BYTES * max(replicates, 2)
    return Cost(
        rays=round(rays),
        memory_bytes=_BASE_MEMORY + pixels * each,
        parts={"image": rays * per_ray / workers},
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
