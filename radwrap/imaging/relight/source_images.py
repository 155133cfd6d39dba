"""Images of each source by one pass of rays and nothing else: no image in the light of all, and no certificate.

`render --basis` traces an image first, looks at how far it may be off, and then traces the same rays source by source.
Who makes many of them by one plan, and learns from their replicates how far they are off, needs only the last of these.
"""

from __future__ import annotations

import io
import zipfile
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.files import make_folder, write_bytes
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.methods.pieces import Pieces, run_jobs
from radwrap.imaging.methods.smooth_blocks import with_known
from radwrap.imaging.optics.view import LitView, magnifications_at
from radwrap.imaging.relight.basis import FrozenTile, freeze_tile, shining
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.bounds import NOTHING
from radwrap.imaging.tolerance.replicates import Plan, Work
from radwrap.imaging.tolerance.sampling import even_plan
from radwrap.imaging.tolerance.survey import Survey, surveyed_places, with_smooth_blocks
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import sha256_of_value
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.scene import Scene

_FILE: Final = "source_images.npz"
_PIECES: Final = "pieces"


@dataclass(frozen=True, slots=True, eq=False)
class SourceImages:
    """Images of each source alone.

    Attributes
    ----------
    sources : tuple of str
        Names, in the order of the images' first axis.
    images : ndarray of float32, shape (sources, replicates, rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1], as `Basis` has them.
    rays : int
        How many were traced for them.
    """

    sources: tuple[str, ...]
    images: NDArray[np.float32]
    rays: int

    @property
    def waves(self) -> None:
        """There are none: see `suffice`."""
        return


def suffice(scene: Scene, options: RenderOptions) -> bool:
    """Whether nothing but these images would be in a basis by a plan: no diffraction, and no light between surfaces."""
    plan = options.sampling
    return (
        plan is not None
        and plan.wave_cell is None
        and scene.camera.diffraction != "on"
        and scene.camera.sensor.mosaic is None
        and not options.bounces
    )


def source_images(scene: Scene, folder: Path, options: RenderOptions, plan: SamplingPlan) -> SourceImages:
    """Trace each source alone by the rays that a basis of the same plan and seed has; bit by bit its images.

    Parameters
    ----------
    scene : Scene
        What is there.
    folder : Path
        Where they are kept: what lies there already, and was made by the same rays, is not traced again.
    options : RenderOptions
        How: tracer, tolerance and seed.
    plan : SamplingPlan
        By which rays.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As a render of the scene.
    """
    make_folder(folder)
    pieces = folder / _PIECES
    make_folder(pieces)
    with Programs() as programs:
        traced = LaidOutScene(scene, options, programs, pieces)
        names = shining(scene, traced.prepared)
        told = [traced.sha256(), scene.camera, plan, options.seed, options.gray_tolerance, names]
        known_by = sha256_of_value(told)
        if (known := _read(folder / _FILE, known_by, names)) is not None:
            return known
        progress = Progress("tracing", 1, shown=False)
        memory = Pieces(pieces, in_memory=True)
        work = Work(traced.view(), pieces, programs, progress, known_by, options.seed, memory)
        found = _looked_at(work)
        view = with_smooth_blocks(work.view, found, options.gray_tolerance, work.seed, sampled=False)
        work = replace(work, view=view)
        lights = traced.views_of(names)
        if view.smooth is not None:
            lights = tuple(with_known(lit, view.smooth) for lit in lights)
        rays: list[int] = []
        images = _traced(work, even_plan(view, found, plan), plan.replicates, lights, rays)
    made = SourceImages(names, images, found.rays + sum(rays))
    with io.BytesIO() as file:
        np.savez(file, images=made.images, rays=made.rays, known_by=known_by)
        write_bytes(folder / _FILE, file.getvalue())
    return made


def _looked_at(work: Work) -> Survey:
    """What there is of a survey that an even plan hangs on: depths."""
    sensor = work.view.camera.sensor
    depths = magnifications_at(work.view, *surveyed_places(sensor))
    none = np.zeros(0)
    return Survey(depths, NOTHING, NOTHING, none, none.astype(np.intp), none, depths.size)


def _traced(
    work: Work, plan: Plan, replicates: int, lights: tuple[LitView, ...], rays: list[int]
) -> NDArray[np.float32]:
    sensor = plan.camera.sensor
    number = sum(len(lit.names) for lit in lights)
    images = np.empty((number, replicates, sensor.rows, sensor.columns), dtype=np.float32)

    def trace(replicate: int, tile: int) -> None:
        r0, r1, c0, c1 = plan.tiles[tile]
        frozen: dict[bool, FrozenTile] = {}
        first = 0
        for lit in lights:
            in_one_pass = len(lit.names) > 1
            if in_one_pass not in frozen:
                frozen[in_one_pass] = freeze_tile(work, plan, replicate, tile, in_one_pass=in_one_pass)
            for values, _ in frozen[in_one_pass].trace(lit, rays.append):
                images[first, replicate, r0:r1, c0:c1] = values
                first += 1

    jobs = [partial(trace, replicate, tile) for replicate in range(replicates) for tile in range(len(plan.tiles))]
    run_jobs(jobs, work.programs, work.view.workers)
    return images


def _read(path: Path, known_by: str, names: tuple[str, ...]) -> SourceImages | None:
    """What a file holds, where it was made by the same rays."""
    with (
        suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile),
        np.load(path, allow_pickle=False) as found,
    ):
        if str(found["known_by"]) == known_by:
            return SourceImages(names, found["images"], int(found["rays"]))
    return None
