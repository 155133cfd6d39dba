"""The light basis: one image for each source by the same rays, so that any levels of the sources need no ray more.

An image is linear in the radiances of its sources. Which rays are traced is
decided once, in the light of all of them, and the very same rays are traced
for each alone: a sum of them is then the image that this ray plan gives, and
not only one like it. What the certificate needs is kept in radiance, before
Eq. 5, and is linear too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import make_folder, sha256_of
from radwrap.images import write_exr
from radwrap.imaging.methods.central import Cells
from radwrap.imaging.methods.kernel import Gathered, KernelPlan, decide_tile, gathered_tile, lattice
from radwrap.imaging.methods.pieces import log_call, read_piece, remove_strangers, run_jobs, write_piece
from radwrap.imaging.methods.rays import RaysPlan, TracedTile, traced_tile
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.certificate import PixelSample, model_lacks
from radwrap.imaging.tolerance.planner import Outcome
from radwrap.imaging.tolerance.replicates import Plan, Work, cells_seed, tile_seed
from radwrap.manifest import SCHEMA_VERSION, plain, sha256_of_value, write_manifest
from radwrap.random_streams import Relighting, generator
from radwrap.scene.scene import Scene
from radwrap.tracers.radiance import PreparedScene

BASIS: Final = "basis.json"
FOLDER: Final = "basis"
MAGNIFICATION: Final = f"{FOLDER}/magnification.exr"  # no part of a source: their files have two dots
SEAL: Final = "sha256"
_WORK: Final = "basis"
# Pixels that tell what the size of the kernel's cells changes; the sampling error of so many is in the bound.
_GRID_PIXELS: Final = 4096
# Pairs of each pixel of the model's certificate, at least: any levels must do with them.
_LEAST_PAIRS: Final = 16


@dataclass(frozen=True, slots=True, eq=False)
class FrozenTile:
    """The rays of a tile, as they were decided in some light.

    Attributes
    ----------
    plan : KernelPlan or RaysPlan
        Of the image.
    tile : int
        Number of the tile.
    seed : tuple of int
        Of all that is drawn.
    decided : tuple of Cells and Gathered, or TracedTile
        The tile in that light, with all that was decided.
    """

    plan: Plan
    tile: int
    seed: tuple[int, ...]
    decided: tuple[Cells, Gathered] | TracedTile

    def trace(self, view: View, progress: Callable[[int], None]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Trace the very same rays in other light.

        Returns
        -------
        values : ndarray, shape (rows, columns)
            Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
        change : ndarray, shape (n,)
            What the size of the kernel's cells changes at `grid_pixels` [W m^-2 sr^-1].
        """
        if isinstance(self.plan, KernelPlan):
            if not isinstance(self.decided, tuple):
                raise TypeError("a kernel's rays are decided by its cells")
            cells, like = self.decided
            gathered = gathered_tile(view, self.plan, self.tile, cells, seed=self.seed, progress=progress, like=like)
            return gathered.values, gathered.change.ravel()[_chosen(self.plan, self.tile, gathered.change.size)]
        numbers = self.decided.numbers if isinstance(self.decided, TracedTile) else None
        traced = traced_tile(view, self.plan, self.tile, self.seed, progress, numbers=numbers)
        return traced.values, np.zeros(0)


def freeze_tile(work: Work, plan: Plan, replicate: int, tile: int) -> FrozenTile:
    """Decide the rays of a tile in the light of all sources."""
    view, progress = _alone(work.view), work.progress.add
    seed = tile_seed(work.seed, replicate, tile)
    if isinstance(plan, KernelPlan):
        cells = decide_tile(view, plan, tile, cells_seed(work.seed, tile), progress)
        return FrozenTile(
            plan, tile, seed, (cells, gathered_tile(view, plan, tile, cells, seed=seed, progress=progress))
        )
    return FrozenTile(plan, tile, seed, traced_tile(view, plan, tile, seed, progress))


def grid_pixels(plan: Plan) -> NDArray[np.intp]:
    """Numbers of the pixels, tile by tile, at which it is kept what the size of the kernel's cells changes."""
    if not isinstance(plan, KernelPlan):
        return np.zeros(0, dtype=np.intp)
    numbers = []
    for tile, place in enumerate(plan.tiles):
        rows, columns = lattice(1.0 if plan.grid.even else 2 * plan.grid.cell, place)
        places = (rows[:, np.newaxis] * plan.camera.sensor.columns + columns).ravel()
        numbers.append(places[_chosen(plan, tile, places.size)])
    return np.concatenate(numbers)


def _chosen(plan: Plan, tile: int, size: int) -> NDArray[np.intp]:
    """Places in a tile's list of pixels of those that are kept: alike in all replicates and all light."""
    if isinstance(plan, KernelPlan) and plan.grid.even:
        return np.arange(size)
    r0, r1, c0, c1 = plan.tiles[tile]
    count = -(-_GRID_PIXELS * (r1 - r0) * (c1 - c0) // plan.camera.sensor.pixels)
    if size <= count:
        return np.arange(size)
    return np.sort(generator(tile, Relighting.KEPT_PIXELS).choice(size, count, replace=False))


def shining(scene: Scene, prepared: PreparedScene, asked_by: str = "basis") -> tuple[str, ...]:
    """Names of the sources of a basis: LEDs and wide sources that are not dark; errors name who asked.

    Raises
    ------
    InputError
        If an included file has light of its own, which no column of levels could name.
    """
    if prepared.shining_files:
        raise InputError(
            f'the included file of "{prepared.shining_files[0]}" holds light of its own, which has no name',
            where=asked_by,
            remedy=f"describe it in [[sources]], or leave out `{asked_by}`",
        )
    return tuple(dict.fromkeys(emitter.source for emitter in scene.emitters if emitter.radiance > 0))


@dataclass(frozen=True, slots=True, eq=False)
class _Maker:
    """What all pieces of a basis have in common."""

    work: Work
    views: Mapping[str, View]
    outcome: Outcome
    sample: PixelSample | None
    folder: Path
    name: str

    @property
    def plan(self) -> Plan:
        return self.outcome.ray_plan

    @property
    def replicates(self) -> int:
        return len(self.outcome.replicates.images)

    def path(self, kind: str, source: int) -> Path:
        return self.folder / f"{kind}_{source:05d}.exr"

    def read(self, kind: str, source: int) -> NDArray[np.float32] | None:
        found = read_piece(self.path(kind, source), f"{self.name}-{kind}-{source}")
        return None if found is None else found[0]

    def whole(self, kind: str, source: int) -> NDArray[np.float32]:
        pixels = self.read(kind, source)
        if pixels is None:
            where = str(self.path(kind, source))
            raise EnvironmentFailure("was changed by somebody else", where=where, remedy="run again")
        return pixels

    def write(self, kind: str, source: int, values: NDArray[np.float64]) -> None:
        write_piece(self.path(kind, source), values.astype(np.float32), f"{self.name}-{kind}-{source}", {})

    def kinds(self) -> Iterator[str]:
        yield from (self.tile_kind(replicate, tile) for replicate, tile in self.tiles())
        if self.sample is not None:
            yield "model"

    def tiles(self) -> Iterator[tuple[int, int]]:
        return ((replicate, tile) for replicate in range(self.replicates) for tile in range(len(self.plan.tiles)))

    @staticmethod
    def tile_kind(replicate: int, tile: int) -> str:
        return f"tile_{replicate:03d}_{tile:05d}"

    def jobs(self) -> Iterator[Callable[[], None]]:
        """What is still to be traced."""
        numbers = range(len(self.views))
        for replicate, tile in self.tiles():
            kind = self.tile_kind(replicate, tile)
            due = [number for number in numbers if self.read(kind, number) is None]
            if due:
                yield partial(self._trace_tile, replicate, tile, due)
        if self.sample is not None:
            yield from (partial(self._trace_model, k) for k in numbers if self.read("model", k) is None)

    def _trace_tile(self, replicate: int, tile: int, due: list[int]) -> None:
        frozen = freeze_tile(self.work, self.plan, replicate, tile)
        kind, views = self.tile_kind(replicate, tile), list(self.views.values())
        for number in due:
            log_call(self.folder, f"{kind} {number}")
            values, change = frozen.trace(_alone(views[number]), self.work.progress.add)
            self.write(kind, number, np.concatenate([values.ravel(), change])[np.newaxis])

    def _trace_model(self, number: int) -> None:
        if self.sample is None or not isinstance(self.plan, KernelPlan):
            raise TypeError("only the kernel has a model")
        log_call(self.folder, f"model {number}")
        view = _alone(list(self.views.values())[number])
        seed = (self.work.seed, Relighting.MODEL_RAYS)
        lacks, rays = model_lacks(view, self.plan.layers, self.sample, seed=seed)
        self.work.progress.add(rays)
        self.write("model", number, lacks)

    def model_rays(self) -> int:
        """Rays of the model's certificate in the light of one source."""
        if self.sample is None or not isinstance(self.plan, KernelPlan):
            return 0
        return 2 * int(self.sample.pairs.sum()) * (1 + len(self.plan.layers))

    def source(self, number: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Images of a source, shape (replicates, rows, columns), and the changes at the grid's pixels."""
        sensor = self.plan.camera.sensor
        images = np.empty((self.replicates, sensor.rows, sensor.columns), dtype=np.float32)
        changes: list[list[NDArray[np.float32]]] = [[] for _ in range(self.replicates)]
        for replicate, tile in self.tiles():
            r0, r1, c0, c1 = self.plan.tiles[tile]
            values = self.whole(self.tile_kind(replicate, tile), number)[0]
            size = (r1 - r0) * (c1 - c0)
            images[replicate, r0:r1, c0:c1] = values[:size].reshape(r1 - r0, c1 - c0)
            changes[replicate].append(values[size:])
        return images, np.stack([np.concatenate(parts) for parts in changes])


def _alone(view: View) -> View:
    """A view whose rays are traced one process at a time: the jobs share the cores."""
    return View(view.camera, view.tracer)


def write_basis(
    out: Path,
    work: Work,
    views: Mapping[str, View],
    outcome: Outcome,
    told: Mapping[str, Any],
    *,
    magnification: NDArray[np.float64] | None = None,
) -> list[str]:
    """Trace each source alone by the rays of an image to tolerance, and write its part of the basis.

    Parameters
    ----------
    out : Path
        Folder of the run; finished pieces in its working folder are not traced again.
    work : Work
        The run.
    views : Mapping[str, View]
        Source -> the same camera in the light of this source alone.
    outcome : Outcome
        The image in the light of all, which decides the rays.
    told : Mapping
        What else `basis.json` is to tell.
    magnification : ndarray, shape (rows, columns), optional
        M of what each pixel sees, where the uncertainty of relit images needs it.

    Returns
    -------
    list of str
        Names of the files, `basis.json` last.

    Raises
    ------
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    maker = _maker(work, views, outcome)
    make_folder(maker.folder)
    ours = {maker.path(kind, number).name for kind in maker.kinds() for number in range(len(views))}
    remove_strangers(maker.folder, ours)
    rays = outcome.replicates.rays * (1 + len(views)) + maker.model_rays() * len(views)
    work.progress.expect(outcome.record.rays + rays)
    run_jobs(list(maker.jobs()), work.programs, work.view.workers)
    make_folder(out / FOLDER)
    files = [name for number, source in enumerate(views) for name in _write_source(out, maker, number, source)]
    if magnification is not None:
        write_exr(out / MAGNIFICATION, magnification.astype(np.float32), channel="magnification")
        files.append(MAGNIFICATION)
    hashes = {name: sha256_of(out / name) for name in files}
    write_manifest(out / BASIS, sealed({"tolerances": None, **_description(maker), **told, "files": hashes}))
    return [*files, BASIS]


def sealed(description: Mapping[str, Any]) -> dict[str, Any]:
    """What tells of a basis with its own hash: a number in it that was changed would make certificates wrong."""
    rest = {key: value for key, value in description.items() if key != SEAL}
    return {**rest, SEAL: sha256_of_value(rest)}


def _maker(work: Work, views: Mapping[str, View], outcome: Outcome) -> _Maker:
    sample = outcome.sample
    if sample is not None:
        sample = replace(sample, pairs=np.maximum(sample.pairs, _LEAST_PAIRS))
    what = {"scene": work.traced_sha256, "plan": outcome.ray_plan, "seed": work.seed, "sources": list(views)}
    name = sha256_of_value(
        {**what, "sample": None if sample is None else [sample.pixels.tolist(), sample.pairs.tolist()]}
    )
    return _Maker(work, views, outcome, sample, work.folder / _WORK, name)


def _write_source(out: Path, maker: _Maker, number: int, source: str) -> Iterator[str]:
    """Write the files of a source; yields their names."""
    images, grid = maker.source(number)
    parts = {str(replicate): image for replicate, image in enumerate(images)}
    if grid.size:
        parts["grid"] = grid
    if maker.sample is not None:
        parts["model"] = maker.whole("model", number)
    for part, values in parts.items():
        name = file_name(source, part)
        write_exr(out / name, values, channel="radiance_cos4", metadata={"radwrap:unit": "W m^-2 sr^-1"})
        yield name


def file_name(source: str, part: str) -> str:
    """Name of a file of the basis; the part is the number of a replicate, "grid" or "model"."""
    return f"{FOLDER}/{source}.{part}.exr"


def _description(maker: _Maker) -> dict[str, Any]:
    view, outcome, sample = maker.work.view, maker.outcome, maker.sample
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "light basis",
        "sources": list(maker.views),
        "method": outcome.method,
        "replicates": maker.replicates,
        "block": list(outcome.replicates.block),
        "exposure_of_radiance": view.exposure_of_radiance,
        "camera": plain(view.camera),
        "grid_pixels": grid_pixels(maker.plan).tolist(),
        "model": None
        if sample is None
        else {
            "pixels": sample.pixels.tolist(),
            "stratum": sample.stratum.tolist(),
            "shares": sample.shares.tolist(),
            "pairs": sample.pairs.tolist(),
            "rays": maker.model_rays(),
        },
        "ray_plan": plain(maker.plan),
        **({"even": True, "smooth_share": outcome.replicates.smooth_share} if _is_even(maker.plan) else {}),
    }


def _is_even(plan: KernelPlan | RaysPlan) -> bool:
    """Whether no image's light decided where rays go."""
    return bool(plan.grid.even) if isinstance(plan, KernelPlan) else plan.even is not None
