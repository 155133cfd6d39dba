"""The light basis: one image for each source by the same rays, so that any levels of the sources need no ray more.

An image is linear in the radiances of its sources. Which rays are traced is
decided once, in the light of all of them, and the very same rays are traced
for each alone: a sum of them is then the image that this ray plan gives, and
not only one like it. What the certificate needs is kept in radiance, before
Eq. 5, and is linear too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder
from radwrap.imaging.methods.by_source import gathered_sources
from radwrap.imaging.methods.central import Cells
from radwrap.imaging.methods.hybrid import HybridPlan, corrected, corrections
from radwrap.imaging.methods.kernel import Gathered, KernelPlan, gathered_tile, lattice
from radwrap.imaging.methods.pieces import Pieces, log_call, remove_strangers, run_jobs
from radwrap.imaging.methods.rays import RaysPlan, traced_tile
from radwrap.imaging.methods.smooth_blocks import with_known
from radwrap.imaging.optics.diffraction import Light
from radwrap.imaging.optics.view import LitView
from radwrap.imaging.relight.basis_files import FOLDER, PartsToWrite
from radwrap.imaging.relight.basis_pieces import BasisPieces
from radwrap.imaging.relight.basis_waves import BasisWaves
from radwrap.imaging.tolerance.certificate import PixelSample, model_lacks, rays_of_lacks
from radwrap.imaging.tolerance.corrected_replicates import corrections_seed, tile_numbers
from radwrap.imaging.tolerance.planner import Outcome
from radwrap.imaging.tolerance.plans import kernel_of
from radwrap.imaging.tolerance.replicates import Plan, Work, tile_cells, tile_seed
from radwrap.imaging.tolerance.wave_plan import WavePlan
from radwrap.manifest import SCHEMA_VERSION, plain, read_manifest, sha256_of_value, write_manifest
from radwrap.random_streams import Relighting, generator
from radwrap.scene.scene import Scene
from radwrap.tracers.radiance import PreparedScene

BASIS: Final = "basis.json"
WAVES: Final = "waves"  # a part: what the cells of waves may change, and below it what light from far away may
SEAL: Final = "sha256"
_WORK: Final = "basis"
# Pixels that tell what the size of the kernel's cells changes; the sampling error of so many is in the bound.
_GRID_PIXELS: Final = 4096
# Pairs of each pixel of the model's certificate, at least: any levels must do with them.
_LEAST_PAIRS: Final = 16
_MOST_IN_MEMORY: Final = 1 << 25  # values of pieces that need no file: 128 MiB


@dataclass(frozen=True, slots=True, eq=False)
class FrozenTile:
    """The rays of a tile, as they were decided in the light of all sources.

    Attributes
    ----------
    plan : KernelPlan, RaysPlan or HybridPlan
        Of the image.
    tile : int
        Number of the tile.
    seed : tuple of int
        Of all that is drawn.
    cells : Cells or None
        Of a kernel.
    like : Gathered, ndarray or None
        The tile in that light; by rays the number of each pixel. None where all sources are traced in one pass, and
        nothing but they decides.
    corrected : Corrected, optional
        How a hybrid corrects its kernel, whose rays the rest is of.
    """

    plan: Plan
    tile: int
    seed: tuple[int, ...]
    cells: Cells | None
    like: Gathered | NDArray[np.intp] | None
    corrected: Corrected | None = None

    def trace(
        self, lit: LitView, progress: Callable[[int], None]
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Trace the very same rays in the light of each of a view's sources.

        Yields
        ------
        values : ndarray, shape (rows, columns)
            Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
        change : ndarray, shape (n,)
            What the size of the kernel's cells changes at `grid_pixels` [W m^-2 sr^-1].
        """
        view = replace(lit.view, workers=1)
        if self.corrected is not None:
            yield from self.corrected.trace(lit, self, progress)
        elif isinstance(self.plan, KernelPlan):
            if self.cells is None:
                raise TypeError("a kernel's rays are decided by its cells")
            like = self.like if isinstance(self.like, Gathered) else None
            kept = _kept(self.plan, self.tile)
            yield from gathered_sources(
                view, self.plan, self.tile, self.cells, kept, seed=self.seed, progress=progress, like=like
            )
        elif isinstance(self.plan, RaysPlan):
            numbers = self.like if isinstance(self.like, np.ndarray) else None
            tile = traced_tile(view, self.plan, self.tile, self.seed, progress, numbers=numbers)
            for values in lit.each(tile.values, 2):
                yield values, np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """How a tile of a hybrid is corrected, as it was decided in the light of all sources.

    Attributes
    ----------
    plan : HybridPlan
        Of the image.
    seed : tuple of int
        Of the corrections.
    signed : ndarray of int, shape (rows, columns)
        See `corrections`.
    """

    plan: HybridPlan
    seed: tuple[int, ...]
    signed: NDArray[np.intp]

    def trace(
        self, lit: LitView, tile: FrozenTile, progress: Callable[[int], None]
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """As `FrozenTile.trace`, of that tile."""
        view = replace(lit.view, workers=1)
        more = corrections(view, self.plan, tile.tile, self.signed, seed=self.seed, progress=progress)
        each = lit.each(more, 2)
        # Where no pixel is corrected there is nothing that has an axis of sources.
        each = np.broadcast_to(each, (len(lit.names), *self.signed.shape))
        for one, (values, change) in zip(each, replace(tile, corrected=None).trace(lit, progress), strict=True):
            yield corrected(values, one, self.signed), change


def freeze_tile(
    work: Work,
    plan: Plan,
    replicate: int,
    tile: int,
    *,
    in_one_pass: bool,
    numbers: NDArray[np.intp] | None = None,
) -> FrozenTile:
    """Decide the rays of a tile in the light of all sources, which are to be traced `in_one_pass` or one by one.

    Of an image by rays the numbers of each pixel may be known.
    """
    view, progress = replace(work.view, workers=1), work.progress.add
    seed = tile_seed(work.seed, replicate, tile)
    if isinstance(plan, HybridPlan):
        kernel = freeze_tile(work, plan.kernel, replicate, tile, in_one_pass=in_one_pass)
        signed = tile_numbers(work, plan, tile)
        return replace(kernel, corrected=Corrected(plan, corrections_seed(work.seed, replicate, tile), signed))
    if isinstance(plan, KernelPlan):
        cells = tile_cells(work, plan, tile)
        like = None if in_one_pass else gathered_tile(view, plan, tile, cells, seed=seed, progress=progress)
        return FrozenTile(plan, tile, seed, cells, like)
    if numbers is None and plan.even is None and not in_one_pass:
        numbers = traced_tile(view, plan, tile, seed, progress).numbers
    return FrozenTile(plan, tile, seed, None, numbers)


def grid_pixels(plan: Plan) -> NDArray[np.intp]:
    """Numbers of the pixels, tile by tile, at which it is kept what the size of the kernel's cells changes."""
    kernel = kernel_of(plan)
    if kernel is None:
        return np.zeros(0, dtype=np.intp)
    numbers = []
    for tile in range(len(plan.tiles)):
        rows, columns = _telling(kernel, tile)
        places = (rows[:, np.newaxis] * plan.camera.sensor.columns + columns).ravel()
        numbers.append(places[_kept(kernel, tile)])
    return np.concatenate(numbers)


def _telling(plan: KernelPlan, tile: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of a tile's pixels that tell what the size of the kernel's cells changes."""
    return lattice(1.0 if plan.grid.even else 2 * plan.grid.cell, plan.tiles[tile])


def _kept(plan: KernelPlan, tile: int) -> NDArray[np.intp]:
    """Places in their list of those that are kept: alike in all replicates and all light."""
    rows, columns = _telling(plan, tile)
    size = len(rows) * len(columns)
    if plan.grid.even:
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
    outcome: Outcome
    sample: PixelSample | None
    pieces: BasisPieces
    waves: BasisWaves | None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for lit in self.pieces.views for name in lit.names)

    @property
    def plan(self) -> Plan:
        return self.outcome.ray_plan

    @property
    def replicates(self) -> int:
        return len(self.outcome.replicates.images)

    def kinds(self) -> Iterator[str]:
        yield from (self.tile_kind(replicate, tile) for replicate, tile in self.tiles())
        if self.sample is not None:
            yield "model"
        if self.waves is not None:
            yield from self.waves.kinds()

    def tiles(self) -> Iterator[tuple[int, int]]:
        return ((replicate, tile) for replicate in range(self.replicates) for tile in range(len(self.plan.tiles)))

    @staticmethod
    def tile_kind(replicate: int, tile: int) -> str:
        return f"tile_{replicate:03d}_{tile:05d}"

    def jobs(self) -> Iterator[Callable[[], None]]:
        """What is still to be traced."""
        for replicate, tile in self.tiles():
            due = self.pieces.due(self.tile_kind(replicate, tile))
            if due:
                yield partial(self._trace_tile, replicate, tile, due)
        if self.sample is not None:
            yield from (partial(self._trace_model, view) for view in self.pieces.due("model"))
        if self.waves is not None:
            yield from self.waves.jobs()

    def _trace_tile(self, replicate: int, tile: int, due: list[int]) -> None:
        kind = self.tile_kind(replicate, tile)
        frozen: dict[bool, FrozenTile] = {}
        for view in due:
            log_call(self.pieces.folder, f"{kind} {view}")
            in_one_pass = len(self.pieces.views[view].names) > 1
            if in_one_pass not in frozen:
                frozen[in_one_pass] = freeze_tile(self.work, self.plan, replicate, tile, in_one_pass=in_one_pass)
            traced = frozen[in_one_pass].trace(self.pieces.views[view], self.work.progress.add)
            self.pieces.write(kind, view, (np.concatenate([values.ravel(), change]) for values, change in traced))

    def _trace_model(self, view: int) -> None:
        kernel = kernel_of(self.plan)
        if self.sample is None or kernel is None:
            raise TypeError("only a kernel has a model")
        log_call(self.pieces.folder, f"model {view}")
        seed = (self.work.seed, Relighting.MODEL_RAYS)
        lit = replace(self.pieces.views[view].view, workers=1)
        lacks, rays = model_lacks(lit, kernel.layers, self.sample, seed=seed)
        self.work.progress.add(rays)
        self.pieces.write("model", view, lacks.reshape(-1, lacks.shape[-1]))

    def model_rays(self) -> int:
        """Rays of the model's certificate in the light of one source."""
        kernel = kernel_of(self.plan)
        return (
            0 if self.sample is None or kernel is None else rays_of_lacks(kernel.layers, int(self.sample.pairs.sum()))
        )

    def replicate(self, view: int, replicate: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Images of a view's sources, shape (sources, rows, columns), and the changes at the grid's pixels."""
        sensor = self.plan.camera.sensor
        images = np.empty((len(self.pieces.views[view].names), sensor.rows, sensor.columns), dtype=np.float32)
        changes = []
        for tile, (r0, r1, c0, c1) in enumerate(self.plan.tiles):
            size, each = (r1 - r0) * (c1 - c0), self.pieces.each(self.tile_kind(replicate, tile), view)
            for image, (values,) in zip(images, each, strict=True):
                image[r0:r1, c0:c1] = values[:size].reshape(r1 - r0, c1 - c0)
            changes.append(np.stack([values[size:] for (values,) in each]))
        return images, np.concatenate(changes, axis=1)


def write_basis(
    out: Path,
    work: Work,
    views: Sequence[LitView],
    outcome: Outcome,
    told: Mapping[str, Any],
    *,
    magnification: NDArray[np.float64] | None = None,
    waves: WavePlan | None = None,
    lights: tuple[Light, ...] = (),
    in_one: bool = False,
) -> list[str]:
    """Trace each source alone by the rays of an image to tolerance, and write its part of the basis.

    Parameters
    ----------
    out : Path
        Folder of the run; finished pieces in its working folder are not traced again.
    work : Work
        The run.
    views : sequence of LitView
        The same camera in the light of each source alone.
    outcome : Outcome
        The image in the light of all, which decides the rays.
    told : Mapping
        What else `basis.json` is to tell.
    magnification : ndarray, shape (rows, columns), optional
        M of what each pixel sees, where the uncertainty of relit images needs it.
    waves : WavePlan, optional
        By which rays the image got its diffraction, where it has it.
    lights : tuple of Light
        Likewise: which wavelength stands for which sources.
    in_one : bool
        See `PartsToWrite`.

    Returns
    -------
    list of str
        Names of the files, `basis.json` last.

    Raises
    ------
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    smooth = outcome.smooth
    if smooth is not None:
        work = replace(work, view=replace(work.view, smooth=smooth))
        views = [with_known(lit, smooth) for lit in views]
    maker = _maker(work, tuple(views), outcome, waves, lights)
    make_folder(maker.pieces.folder)
    ours = {maker.pieces.path(kind, number).name for kind in maker.kinds() for number in range(len(views))}
    remove_strangers(maker.pieces.folder, ours)
    passes = len(views) + any(len(lit.names) == 1 for lit in views)  # what is traced one by one needs the light of all
    rays = outcome.replicates.rays * passes + maker.model_rays() * len(views)
    work.progress.expect(outcome.record.rays + rays)
    run_jobs(list(maker.jobs()), work.programs, work.view.workers)
    make_folder(out / FOLDER)
    parts = PartsToWrite(out, in_one=in_one)
    for view in range(len(views)):
        _write_view(parts, maker, view)
    if magnification is not None:
        parts.write_magnification(magnification.astype(np.float32))
    files, told_of_files = parts.finish()
    write_manifest(out / BASIS, sealed({"tolerances": None, **_description(maker), **told, **told_of_files}))
    return [*files, BASIS]


def sealed(description: Mapping[str, Any]) -> dict[str, Any]:
    """What tells of a basis with its own hash: a number in it that was changed would make certificates wrong."""
    rest = {key: value for key, value in description.items() if key != SEAL}
    return {**rest, SEAL: sha256_of_value(rest)}


def read_sealed(path: Path) -> dict[str, Any]:
    """Read what was written with `sealed`.

    Raises
    ------
    InputError
        If it cannot be read, or is not as it was written.
    """
    told = read_manifest(path)
    if sealed(told)[SEAL] != told.get(SEAL):
        raise InputError("is not as it was made", where=str(path), remedy="make the basis again")
    return told


def _maker(
    work: Work, views: tuple[LitView, ...], outcome: Outcome, waves: WavePlan | None, lights: tuple[Light, ...]
) -> _Maker:
    sample = outcome.sample
    if sample is not None:
        sample = replace(sample, pairs=np.maximum(sample.pairs, _LEAST_PAIRS))
    what = {
        "scene": work.traced_sha256,
        "plan": outcome.ray_plan,
        "seed": work.seed,
        "sources": [name for lit in views for name in lit.names],
        **({} if waves is None else {"waves": waves.kernel, "wavelengths": [light.wavelength for light in lights]}),
    }
    name = sha256_of_value(
        {**what, "sample": None if sample is None else [sample.pixels.tolist(), sample.pairs.tolist()]}
    )
    pieces = BasisPieces(work.folder / _WORK, name, views, _kept_in(work, outcome, views))
    of_waves = None
    if waves is not None:
        plans = tuple(waves.at(light.wavelength, light.deviation) for light in lights)
        seen = views
        if waves.smooth is not None and waves.smooth is not work.view.smooth:  # the image was made anew since
            work = replace(work, view=replace(work.view, smooth=waves.smooth))
            seen = tuple(with_known(lit, waves.smooth) for lit in views)
        of_waves = BasisWaves(work, waves, pieces, seen, len(outcome.replicates.images), lights, plans)
    return _Maker(work, outcome, sample, pieces, of_waves)


def _kept_in(work: Work, outcome: Outcome, views: Sequence[LitView]) -> Pieces:
    """Where pieces are: with those of the image, if these are in memory and all of the basis are few."""
    images = outcome.replicates.images
    sources = sum(len(lit.names) for lit in views)
    few = 3 * sources * images.size <= _MOST_IN_MEMORY  # each source's image, what waves add, and how far that is off
    in_memory = few and work.pieces is not None and work.pieces.in_memory
    return Pieces(work.folder / _WORK, in_memory=in_memory)


def _write_view(parts: PartsToWrite, maker: _Maker, view: int) -> None:
    """Write the parts of a view's sources."""
    names = maker.pieces.views[view].names
    grids = []

    def written(part: str, each: Iterable[NDArray[np.float32]]) -> None:
        for name, values in zip(names, each, strict=True):
            parts.write(name, part, values)

    # All sources of a large sensor take a gigabyte: of each there is one at a time, and sums are made in place.
    waves: NDArray[np.float32] | None = None
    for replicate in range(maker.replicates):
        by_waves = None if maker.waves is None else maker.waves.replicate(view, replicate)
        images, grid = maker.replicate(view, replicate)
        if by_waves is not None:
            images += by_waves[0]
            waves = by_waves if waves is None else np.add(by_waves, waves, out=waves)
        written(str(replicate), images)
        grids.append(grid)
        del images, by_waves
    if grids[0].size:
        written("grid", np.stack(grids, axis=1))
    if maker.sample is not None:
        written("model", maker.pieces.each("model", view))
    if maker.waves is not None and waves is not None:
        waves /= np.float32(maker.replicates)
        beyond = maker.waves.beyond(view, waves[0])
        written(WAVES, (np.concatenate(each) for each in zip(waves[1], beyond, strict=True)))


def _description(maker: _Maker) -> dict[str, Any]:
    view, outcome, sample = maker.work.view, maker.outcome, maker.sample
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "light basis",
        "sources": list(maker.names),
        "method": outcome.method,
        "replicates": maker.replicates,
        "block": [max(size, maker.waves.plan.block if maker.waves else 0) for size in outcome.replicates.block],
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
        **({"waves": maker.waves.description} if maker.waves else {}),
        **({"every_pixel": True} if isinstance(maker.plan, HybridPlan) else {}),
        **({"even": True, "smooth_share": outcome.replicates.smooth_share} if _is_even(maker.plan) else {}),
    }


def _is_even(plan: Plan) -> bool:
    """Whether no image's light decided where rays go."""
    if isinstance(plan, RaysPlan):
        return plan.even is not None
    return isinstance(plan, KernelPlan) and bool(plan.grid.even)
