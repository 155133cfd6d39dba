"""Images of each source by one pass of rays and nothing else: no image in the light of all, and no certificate.

`render --basis` traces an image first, looks at how far it may be off, and then traces the same rays source by source.
Who makes many of them by one plan, and learns from their replicates how far they are off, needs only the last of these.
"""

from __future__ import annotations

import io
import math
import zipfile
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.files import make_folder, write_bytes
from radwrap.images import digest
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.methods.pieces import Pieces, remove_pieces, run_jobs
from radwrap.imaging.methods.rays import RaysPlan, plan_rays, rays_of_pixels
from radwrap.imaging.methods.smooth_blocks import with_known
from radwrap.imaging.optics.view import LitView, View, magnifications_at
from radwrap.imaging.relight.basis import FrozenTile, freeze_tile, shining
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.bounds import NOTHING
from radwrap.imaging.tolerance.plans import kernel_of
from radwrap.imaging.tolerance.replicates import Plan, Work
from radwrap.imaging.tolerance.sampling import even_plan
from radwrap.imaging.tolerance.survey import Survey, surveyed_places, with_smooth_blocks
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import sha256_of_value
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.random_streams import Rendering
from radwrap.scene.scene import Scene

_FILE: Final = "source_images.npz"
_PIECES: Final = "pieces"
_RAYS: Final = "rays"
# Rays of a pass, a second or two of work: a smaller one is kept as a whole, not tile by tile, which takes longer.
_SHORT: Final = 1 << 20
_MOST_CARRYING: Final = 0.5  # of the variance of images: so much what changes from scene to scene may add


@dataclass(frozen=True, slots=True)
class AimedRays:
    """Rays over pixel and opening, the more, the more a pixel needs: for images that nothing is compared with.

    Attributes
    ----------
    rms : float
        Error of the mean of all replicates to aim at [gray level].
    replicates : int
        Independent images, by the same number of rays in each pixel.
    numbers : ndarray of int, shape (rows, columns), optional
        Rays of each pixel, where another image has decided them: both have the same rays.
    """

    rms: float
    replicates: int
    numbers: NDArray[np.intp] | None = None

    def as_json(self) -> dict[str, Any]:
        """For a manifest."""
        return {"method": "rays", "rms": self.rms, "replicates": self.replicates}


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
    numbers : ndarray of int, shape (rows, columns), optional
        Of each pixel and replicate, where they were aimed.
    carrying : float
        What the variance of the mean has beyond what replicates show, over that: see `carried`.
    """

    sources: tuple[str, ...]
    images: NDArray[np.float32]
    rays: int
    numbers: NDArray[np.intp] | None = None
    carrying: float = 0.0

    @property
    def waves(self) -> None:
        """There are none: see `suffice`."""
        return

    def carried(self, some: SourceImages) -> SourceImages | None:
        """Images of another scene, by some of these replicates there: what they change by, the others do on average.

        None where that is not known better than the images are: the scene is another one by too much.
        """
        count = some.images.shape[1]
        change = some.images - self.images[:, :count]
        of_change, of_images = (
            float(one.sum(axis=0, dtype=np.float64).var(axis=0, ddof=1).mean()) / one.shape[1]
            for one in (change, self.images)
        )
        if of_change > _MOST_CARRYING * of_images:
            return None
        moved = self.images[:, count:] + change.mean(axis=1, keepdims=True)
        images = np.concatenate([some.images, moved], axis=1)
        carrying = self.carrying + (of_change / of_images if of_images else 0.0)
        return replace(self, images=images, rays=some.rays, carrying=carrying)


def suffice(scene: Scene, options: RenderOptions) -> bool:
    """Whether nothing but these images would be in a basis by a plan: no diffraction, and no light between surfaces.

    A plan by `AimedRays` has no diffraction where an even one of `options` has none.
    """
    plan = options.sampling
    return (
        plan is not None
        and plan.wave_cell is None
        and scene.camera.diffraction != "on"
        and scene.camera.sensor.mosaic is None
        and not options.bounces
    )


def source_images(scene: Scene, folder: Path, options: RenderOptions, plan: SamplingPlan | AimedRays) -> SourceImages:
    """Trace each source alone by the rays that a basis of the same plan and seed has; bit by bit its images.

    A long pass that is killed goes on with its finished tiles, of one replicate each.

    Parameters
    ----------
    scene : Scene
        What is there.
    folder : Path
        Where they are kept: what lies there already, and was made by the same rays, is not traced again.
    options : RenderOptions
        How: tracer, tolerance and seed.
    plan : SamplingPlan or AimedRays
        By which rays; a basis has none that are aimed.

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
        told = [traced.sha256(), scene.camera, _told(plan), options.seed, options.gray_tolerance, names]
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
        bands = traced.banding.bands
        tiles = _Tiles(work, _planned(view, found, plan), lights, 1 if bands is None else len(bands.bands))
        numbers, looks = tiles.aimed(plan) if isinstance(plan, AimedRays) else (None, 0)
        images, rays = tiles.traced(plan.replicates, numbers)
    made = SourceImages(names, images, found.rays + looks + rays, numbers)
    with io.BytesIO() as file:
        aimed = np.zeros((0, 0), dtype=np.intp) if numbers is None else numbers
        np.savez(file, images=made.images, rays=made.rays, known_by=known_by, numbers=aimed)
        write_bytes(folder / _FILE, file.getvalue())
    remove_pieces(pieces)
    return made


def _told(plan: SamplingPlan | AimedRays) -> Any:
    """What a plan decides, for a hash."""
    if not isinstance(plan, AimedRays):
        return plan
    return [plan.as_json(), None if plan.numbers is None else digest(plan.numbers)]


def _planned(view: View, found: Survey, plan: SamplingPlan | AimedRays) -> Plan:
    if isinstance(plan, AimedRays):
        return plan_rays(view, plan.rms * math.sqrt(plan.replicates))
    return even_plan(view, found, plan)


def _looked_at(work: Work) -> Survey:
    """What there is of a survey that an even plan hangs on: depths."""
    sensor = work.view.camera.sensor
    depths = magnifications_at(work.view, *surveyed_places(sensor))
    none = np.zeros(0)
    return Survey(depths, NOTHING, NOTHING, none, none.astype(np.intp), none, depths.size)


@dataclass(frozen=True, slots=True, eq=False)
class _Tiles:
    """Tiles of each replicate, which are kept as they are finished.

    Attributes
    ----------
    work : Work
        Who traces, and by which seed.
    plan : Plan
        By which rays.
    lights : tuple of LitView
        The sources.
    passes : int
        How often a ray is traced in the light of all: once in each band.
    """

    work: Work
    plan: Plan
    lights: tuple[LitView, ...]
    passes: int

    def aimed(self, plan: AimedRays) -> tuple[NDArray[np.intp], int]:
        """Rays of each pixel, alike for all replicates, and how many it took to learn that."""
        if plan.numbers is not None:
            return plan.numbers, 0
        if not isinstance(self.plan, RaysPlan):
            raise TypeError("only rays over pixel and opening are aimed")
        sensor, rays = self.plan.camera.sensor, self.plan
        numbers, count = np.empty((sensor.rows, sensor.columns), dtype=np.intp), Progress("tracing", 1, shown=False)
        view = replace(self.work.view, workers=1)

        def look(tile: int) -> None:
            r0, r1, c0, c1 = rays.tiles[tile]
            seed = (self.work.seed, Rendering.RAYS_OF_PIXELS, tile)
            found = rays_of_pixels(view, rays, tile, seed, count.add)
            numbers[r0:r1, c0:c1] = found.reshape(r1 - r0, c1 - c0)

        self._run([partial(look, tile) for tile in range(len(self.plan.tiles))])
        return numbers, self.passes * count.state.done

    def traced(self, replicates: int, numbers: NDArray[np.intp] | None) -> tuple[NDArray[np.float32], int]:
        """Images of all sources, shape (sources, replicates, rows, columns), and rays that they took."""
        sensor = self.plan.camera.sensor
        number = sum(len(lit.names) for lit in self.lights)
        images = np.empty((number, replicates, sensor.rows, sensor.columns), dtype=np.float32)
        rays: list[int] = []
        each = self._rays_of_all(numbers) * len(self.lights)
        kept = Pieces(self.work.folder, in_memory=replicates * each < _SHORT)

        def lay(replicate: int, tile: int) -> None:
            r0, r1, c0, c1 = self.plan.tiles[tile]
            own = None if numbers is None else numbers[r0:r1, c0:c1].ravel()
            values, count = self._one(replicate, tile, own, kept)
            images[:, replicate, r0:r1, c0:c1] = values.reshape(number, r1 - r0, c1 - c0)
            rays.append(count)

        tiles = range(len(self.plan.tiles))
        self._run([partial(lay, replicate, tile) for replicate in range(replicates) for tile in tiles])
        return images, sum(rays)

    def _run(self, jobs: list[partial[None]]) -> None:
        run_jobs(jobs, self.work.programs, self.work.view.workers)

    def _rays_of_all(self, numbers: NDArray[np.intp] | None) -> float:
        """About how many a replicate takes in one light."""
        if numbers is not None:
            return float(numbers.sum())
        pixels = float(self.plan.camera.sensor.pixels)
        if isinstance(self.plan, RaysPlan):
            return pixels * (self.plan.even or 1)
        kernel = kernel_of(self.plan)
        return pixels if kernel is None else pixels / kernel.grid.cell**2

    def _one(
        self, replicate: int, tile: int, numbers: NDArray[np.intp] | None, kept: Pieces
    ) -> tuple[NDArray[np.float32], int]:
        """A tile of each source, one below the other, and its rays; as it was kept, where it was."""
        name, known_by = f"{replicate:03d}_{tile:05d}.exr", self.work.traced_sha256
        if (found := kept.read(name, known_by)) is not None:
            return found[0], int(found[1][_RAYS])
        every, each = (Progress("tracing", 1, shown=False) for _ in range(2))
        work = replace(self.work, progress=every)
        frozen: dict[bool, FrozenTile] = {}
        images = []
        for lit in self.lights:
            in_one_pass = len(lit.names) > 1
            if in_one_pass not in frozen:
                frozen[in_one_pass] = freeze_tile(
                    work, self.plan, replicate, tile, in_one_pass=in_one_pass, numbers=numbers
                )
            images += [values for values, _ in frozen[in_one_pass].trace(lit, each.add)]
        values, rays = np.concatenate(images).astype(np.float32), self.passes * every.state.done + each.state.done
        kept.write(name, values, known_by, {_RAYS: rays})
        return values, rays


def _read(path: Path, known_by: str, names: tuple[str, ...]) -> SourceImages | None:
    """What a file holds, where it was made by the same rays."""
    with (
        suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile),
        np.load(path, allow_pickle=False) as found,
    ):
        if str(found["known_by"]) == known_by:
            numbers = found["numbers"]
            return SourceImages(names, found["images"], int(found["rays"]), numbers if numbers.size else None)
    return None
