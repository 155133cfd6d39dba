"""Independent images of the same scene by kernel or rays: their mean is the result, their differences its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure
from radwrap.imaging.methods.central import Cells, central_rays
from radwrap.imaging.methods.hybrid import HybridPlan, slope_in_gray
from radwrap.imaging.methods.kernel import KernelPlan, decide_tile, gathered_tile, grid_squares, smooth_share
from radwrap.imaging.methods.pieces import (
    Pieces,
    log_call,
    packed_levels,
    remove_halves,
    run_jobs,
    unpacked_levels,
)
from radwrap.imaging.methods.rays import RaysPlan, traced_tile
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.response.strips import strips_of
from radwrap.imaging.tolerance.bounds import Bounded, mean_square_of_differences
from radwrap.imaging.tolerance.seen_tiles import SeenTiles
from radwrap.kept import Kept
from radwrap.manifest import sha256_of_value
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.random_streams import Rendering

PurePlan = KernelPlan | RaysPlan
Plan = PurePlan | HybridPlan
_LOOKS: Final = 8
_HANGS_TOGETHER: Final = 1.2
# Degrees of freedom that are asked for: the bound is then a third above the error at most.
_DEGREES: Final = 30
_MOST_REPLICATES: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class Replicates:
    """Images by the same plan, each with its own rays.

    Attributes
    ----------
    images : ndarray, shape (replicates, rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1], as their files hold it.
    grid_squares : ndarray, shape (rows, columns)
        Squares of what the size of the kernel's cells changes at each pixel [gray level^2].
    rays : int
        How many were traced for all of them.
    reused : int
        How many pieces were found on the disk.
    block : tuple of int
        Rows and columns over which errors hang together [px].
    change : ndarray, shape (rows, columns), optional
        What the size of the kernel's cells may add to each pixel of the mean [W m^-2 sr^-1]; of a kernel.
    own_rays : ndarray of bool, shape (rows, columns), optional
        Pixels whose values have no part of the kernel's model, where a hybrid made the image.
    uncorrected : ndarray, shape (replicates, rows, columns), optional
        A hybrid's images without corrections, whose errors alone hang together over blocks.
    parts : Mapping[str, int]
        Rays of what other plans may have in common with this one, by its name.
    smooth_share : float
        Part of that change which is left in what is measured over many pixels, see `kernel.smooth_share`.
    """

    images: NDArray[np.float32]
    grid_squares: NDArray[np.float32]
    rays: int
    reused: int
    block: tuple[int, int]
    change: NDArray[np.float64] | None = None
    own_rays: NDArray[np.bool_] | None = None
    uncorrected: NDArray[np.float32] | None = None
    parts: Mapping[str, int] = field(default_factory=dict)
    smooth_share: float = 1.0

    @property
    def grid_square(self) -> float:
        """Mean square of what the size of the kernel's cells changes [gray level^2]."""
        return float(self.grid_squares.mean(dtype=np.float64))

    @property
    def mean(self) -> NDArray[np.float64]:
        """The result; noise of a correction may take light where there is none below zero."""
        mean: NDArray[np.float64] = self.images.mean(axis=0, dtype=np.float64)
        return mean if self.own_rays is None else np.maximum(mean, 0.0, out=mean)

    def with_waves(self, change: NDArray[np.float64], cells: NDArray[np.float32]) -> Replicates:
        """The images with what waves add to each.

        Parameters
        ----------
        change : ndarray, shape (replicates, rows, columns)
            That [W m^-2 sr^-1].
        cells : ndarray, shape (rows, columns)
            What the size of their cells may change of it, all of which may be left over many pixels.
        """
        known = 0.0 if self.change is None else self.change
        images = (self.images + change).astype(np.float32)
        return replace(self, images=images, change=known + cells.astype(np.float64) / self.smooth_share)


@dataclass(frozen=True, slots=True)
class Work:
    """Where and by whom a run's pieces are made.

    Attributes
    ----------
    view : View
        The camera, and who traces.
    folder : Path
        Where the pieces are.
    programs : Programs
        Ended at the first failure.
    progress : Progress
        Counts rays.
    traced_sha256 : str
        Hash of the scene as the tracer gets it, and of the tracer.
    seed : int
        Of all that is drawn.
    pieces : Pieces, optional
        Of the images; default those of the folder.
    kept : Kept, optional
        Where what does not hang on the image is looked up, and kept.
    seen : SeenTiles, optional
        Where what rays saw is kept, if waves may be told by it.
    """

    view: View
    folder: Path
    programs: Programs
    progress: Progress
    traced_sha256: str
    seed: int
    pieces: Pieces | None = None
    kept: Kept | None = None
    seen: SeenTiles | None = None


class TooManyRays(Exception):
    """A plan turns out to need more rays than it may.

    Attributes
    ----------
    parts : Mapping[str, int]
        Rays that were traced to find that out, as of `Replicates`.
    whole : int
        Rays that it needs, those included.
    """

    def __init__(self, parts: Mapping[str, int], whole: int) -> None:
        super().__init__(parts, whole)
        self.parts, self.whole = parts, whole


def trace_replicates(work: Work, plan: PurePlan, number: int, most: float = math.inf) -> Replicates:
    """Trace so many replicates, tile by tile; pieces that are finished are not traced again.

    Raises
    ------
    TooManyRays
        If the kernel's cells, once they are decided, ask for more than `most` rays in all.
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    name = plan_name(work, plan)
    if work.seen is not None and isinstance(plan, KernelPlan):
        work.seen.begin(name, plan, number)
    tiles = range(len(plan.tiles))
    shared = among(work, len(tiles))
    decided = [_CellsPiece(shared, plan, name, tile) for tile in tiles] if isinstance(plan, KernelPlan) else []
    shared = among(work, number * len(tiles))
    pieces = [_TilePiece(shared, plan, name, replicate, tile) for replicate in range(number) for tile in tiles]
    # Pieces of earlier plans stay: a search that is killed goes through them again.
    remove_halves(work.folder)
    sensor = work.view.camera.sensor
    images = np.empty((number, sensor.rows, sensor.columns), dtype=np.float32)
    squares, change = np.zeros((2, *images.shape[1:]))
    told: dict[_TilePiece, Mapping[str, Any]] = {}
    grids: dict[_TilePiece, NDArray[np.float32]] = {}

    def lay(piece: _TilePiece, found: tuple[NDArray[np.float32], Mapping[str, Any]]) -> None:
        r0, r1, c0, c1 = plan.tiles[piece.tile]
        pixels, told[piece] = found
        images[piece.replicate, r0:r1, c0:c1] = pixels[: r1 - r0]
        grids[piece] = pixels[r1 - r0 :]

    def make(piece: _TilePiece) -> None:
        lay(piece, piece.make())

    due = []
    for piece in pieces:
        if (found := piece.read()) is None:
            due.append(piece)
        else:
            lay(piece, found)
    # What is finished counts too: a run that goes on after a kill gives up where it would have without the kill.
    wanted = {piece.tile for piece in (due if math.isinf(most) else pieces)}
    run_jobs(
        [piece.make for piece in decided if piece.tile in wanted and piece.read() is None],
        work.programs,
        work.view.workers,
    )
    if isinstance(plan, KernelPlan) and math.isfinite(most):
        cells = [piece.cells() for piece in decided]
        taken = sum(one.rays for one in cells)
        whole = taken + number * sum(central_rays(plan.grid, one) for one in cells)
        if whole > most:
            raise TooManyRays({f"cells of {name}": taken}, whole)
    run_jobs([partial(make, piece) for piece in due], work.programs, work.view.workers)
    rays = 0
    for piece in pieces:
        r0, r1, c0, c1 = plan.tiles[piece.tile]
        rays += int(told[piece]["rays"])
        if isinstance(plan, KernelPlan):  # in the order of the pieces, whoever was finished first
            each = grids[piece].astype(np.float64) / number
            change[r0:r1, c0:c1] += each[: r1 - r0]
            squares[r0:r1, c0:c1] += each[r1 - r0 :] if len(each) > r1 - r0 else 0.0
    reused = len(pieces) - len(due)
    made = Replicates(images, squares.astype(np.float32), rays, reused, block_of(plan), parts={name: rays})
    if not isinstance(plan, KernelPlan):
        return made
    if not plan.grid.even:
        return replace(made, change=change)
    # What replicates have in common, without the noise of each.
    squares = grid_squares(made.mean, change, work.view.exposure_of_radiance, sensor)
    return replace(made, grid_squares=squares.astype(np.float32), change=change, smooth_share=smooth_share(plan))


def decide_tiles(work: Work, plan: PurePlan) -> None:
    """Find the cells of each of a plan's tiles, which `make_tiles` then has."""
    tiles, name = range(len(plan.tiles)), plan_name(work, plan)
    shared = among(work, len(tiles))
    if isinstance(plan, KernelPlan):
        run_jobs([_CellsPiece(shared, plan, name, tile).make for tile in tiles], work.programs, work.view.workers)


def make_tiles(work: Work, plan: PurePlan, number: int) -> int:
    """Make so many replicates of each of a plan's tiles, and no image of them; gives how many rays they took."""
    tiles, name = range(len(plan.tiles)), plan_name(work, plan)
    shared = among(work, number * len(tiles))
    pieces = [_TilePiece(shared, plan, name, replicate, tile) for replicate in range(number) for tile in tiles]
    rays: list[int] = []

    def make(piece: _TilePiece) -> None:
        rays.append(int(piece.make()[1]["rays"]))

    run_jobs([partial(make, piece) for piece in pieces], work.programs, work.view.workers)
    return sum(rays)


def among(work: Work, jobs: int) -> Work:
    """The work of each of some jobs that run at a time: with its share of the workers."""
    return replace(work, view=replace(work.view, workers=max(1, work.view.workers // jobs)))


def block_of(plan: Plan) -> tuple[int, int]:
    """Rows and columns over which errors hang together [px].

    The correlation of noise that was gathered over a disc of radius R has the
    integral of its square 1.41 R^2: a square of 1.2 R.
    """
    if isinstance(plan, RaysPlan):
        return (1, 1)
    reach = plan.reach_px
    return (math.ceil(_HANGS_TOGETHER * reach[1]) + 1, math.ceil(_HANGS_TOGETHER * reach[0]) + 1)


def replicates_needed(plan: Plan) -> int:
    """How many replicates tell their noise: two, but more where the image is small beside the blur."""
    sensor, block = plan.camera.sensor, block_of(plan)
    blocks = max(1.0, sensor.rows / block[0]) * max(1.0, sensor.columns / block[1])
    return min(max(1 + math.ceil(_DEGREES / blocks), 2), _MOST_REPLICATES)


class _TilePiece:
    """A tile of a replicate; of a kernel it holds, below its values, what the cells' size does to each.

    That is the change, and unless the plan is even, below it, its square in gray levels.
    """

    def __init__(self, work: Work, plan: PurePlan, name: str, replicate: int, tile: int) -> None:
        self.replicate, self.tile = replicate, tile
        self._file = f"piece_{name[:12]}_{replicate:03d}_{tile:05d}.exr"
        self._work, self._plan, self._name = work, plan, f"{name}-{replicate}-{tile}-change"
        self._whole = name

    def read(self) -> tuple[NDArray[np.float32], dict[str, str]] | None:
        return pieces_of(self._work).read(self._file, self._name)

    def make(self) -> tuple[NDArray[np.float32], Mapping[str, Any]]:
        """Make it, and give it as `read` does; the disk gave it back already when it was written."""
        work = self._work
        seed = tile_seed(work.seed, self.replicate, self.tile)
        log_call(work.folder, Path(self._file).stem)
        if isinstance(self._plan, RaysPlan):
            traced = traced_tile(work.view, self._plan, self.tile, seed, work.progress.add)
            values, found = traced.values, {"rays": traced.rays}
        else:
            values, found = self._gathered(self._plan, seed)
        pixels = values.astype(np.float32)
        pieces_of(work).write(self._file, pixels, self._name, found)
        return pixels, found

    def _gathered(self, plan: KernelPlan, seed: tuple[int, ...]) -> tuple[NDArray[np.float64], dict[str, Any]]:
        work = self._work
        cells = _CellsPiece(work, plan, self._whole, self.tile).cells()
        gathered = gathered_tile(work.view, plan, self.tile, cells, seed=seed, progress=work.progress.add)
        if work.seen is not None and cells.samples:
            work.seen.put(self._whole, (self.replicate, self.tile), plan, gathered.central, gathered.coarser)
        grid = [gathered.change]
        if not plan.grid.even:
            squares = gathered.grid_squares(plan.grid.exposure_of_radiance, plan.camera.sensor)
            grid = [gathered.spread(gathered.change), squares]
        # The rays that decided the cells are counted once.
        rays = gathered.central.rays + (cells.rays if self.replicate == 0 else 0)
        return np.concatenate([gathered.values, *grid]), {"rays": rays}


class _CellsPiece:
    """The cells of a tile, which all replicates have in common."""

    def __init__(self, work: Work, plan: KernelPlan, name: str, tile: int) -> None:
        self.tile = tile
        self._file = f"cells_{name[:12]}_{tile:05d}.exr"
        self._work, self._plan, self._name = work, plan, f"{name}-packed-cells-{tile}"

    def read(self) -> tuple[NDArray[np.float32], dict[str, str]] | None:
        return pieces_of(self._work).read(self._file, self._name)

    def make(self) -> None:
        work = self._work
        log_call(work.folder, Path(self._file).stem)
        cells = decide_tile(work.view, self._plan, self.tile, cells_seed(work.seed, self.tile), work.progress.add)
        told = {
            "first_row": cells.first[0],
            "first_column": cells.first[1],
            "samples": cells.samples,
            "predicted_rms": repr(cells.predicted_rms),
            "rays": cells.rays,
            "columns": cells.levels.shape[1],
        }
        pieces_of(work).write(self._file, packed_levels(cells.levels), self._name, told)

    def cells(self) -> Cells:
        found = self.read()
        if found is None:
            where = str(self._work.folder / self._file)
            raise EnvironmentFailure("was changed by somebody else", where=where, remedy="run again")
        levels, told = found
        return Cells(
            first=(int(told["first_row"]), int(told["first_column"])),
            levels=unpacked_levels(levels, int(told["columns"])),
            samples=int(told["samples"]),
            predicted_rms=float(told["predicted_rms"]),
            rays=int(told["rays"]),
        )


def tile_cells(work: Work, plan: KernelPlan, tile: int) -> Cells:
    """Cells of a tile of an image that was made; they are decided again where they are no longer on the disk."""
    piece = _CellsPiece(work, plan, plan_name(work, plan), tile)
    if piece.read() is None:
        piece.make()
    return piece.cells()


def pieces_of(work: Work) -> Pieces:
    """Where the pieces of a run are."""
    return Pieces(work.folder, in_memory=False) if work.pieces is None else work.pieces


def plan_name(work: Work, plan: Plan) -> str:
    """What the pieces of a plan are known by."""
    return sha256_of_value({"scene": work.traced_sha256, "plan": plan, "seed": work.seed})


def cells_seed(seed: int, tile: int) -> tuple[int, ...]:
    """Seed of all that is drawn to find out a tile's cells."""
    return (seed, Rendering.CELLS, tile)


def tile_seed(seed: int, replicate: int, tile: int) -> tuple[int, ...]:
    """Seed of all that is drawn for a tile of a replicate."""
    return (seed, Rendering.TILE, replicate, tile)


def discretisation(view: View, replicates: Replicates) -> tuple[Bounded, NDArray[np.float64]]:
    """Mean square error from the finite number of rays, and samples of it for each pixel.

    Returns
    -------
    square : Bounded
        [gray level^2]
    errors : ndarray, shape (replicates - 1, rows, columns)
        Each distributed as the error of the mean [gray level].
    """
    camera, block = view.camera, replicates.block

    def noise(images: NDArray[np.float32], block: tuple[int, int]) -> tuple[Bounded, NDArray[np.float64]]:
        rows, columns = steps = looks(block)
        seen = images[:, ::rows, ::columns]
        errors = np.empty((len(seen) - 1, *seen.shape[1:]))
        for strip in strips_of(*seen.shape[1:]):
            radiance = np.maximum(seen[:, strip].astype(np.float64), 0.0)
            errors[:, strip] = contrasts(gray_levels(radiance * view.exposure_of_radiance, camera.sensor))
        return mean_square_of_differences(errors, looked_at(block, steps)), errors

    grid = Bounded(replicates.grid_square, replicates.grid_square)
    if replicates.uncorrected is None:
        found, errors = noise(replicates.images, block)
        return found + grid, errors
    # Corrections of different pixels are independent. Of the kernel's part fewer independent errors are seen.
    _, ended = noise(replicates.images, (1, 1))
    _, straight = noise_of(_straight_gray(view, replicates), (1, 1), (1, 1))
    # Where single images end at dark or at saturation, their own gray levels differ by less than their mean is off.
    errors = np.where(np.abs(straight) > np.abs(ended), straight, ended)
    found = mean_square_of_differences(errors, (1, 1))
    kernel, _ = noise(replicates.uncorrected, block)
    return found + Bounded(0.0, kernel.upper - kernel.mean) + grid, errors


def noise_beside(replicates: Replicates, errors: NDArray[np.float64], risky: NDArray[np.bool_]) -> float:
    """Mean square of an image's noise [gray level^2], but for what risky pixels have: rays may stand in its place."""
    rows, columns = looks(replicates.block)
    safe = ~risky
    noise = np.where(safe[::rows, ::columns], (errors**2).mean(axis=0), 0.0)
    return float(noise.mean() + np.where(safe, replicates.grid_squares, 0.0).mean(dtype=np.float64))


def _straight_gray(view: View, replicates: Replicates) -> NDArray[np.float64]:
    """Gray levels along the slope of Eq. 5 at the mean of all images, which end nowhere."""
    mean, scale, sensor = replicates.mean, view.exposure_of_radiance, view.camera.sensor
    found = np.empty(replicates.images.shape)
    for strip in strips_of(*mean.shape):
        images = replicates.images[:, strip].astype(np.float64)
        error = images.std(axis=0, ddof=1) / math.sqrt(len(images))
        found[:, strip] = slope_in_gray(mean[strip], error, scale, sensor) * images
    return found


def looks(block: tuple[int, int]) -> tuple[int, int]:
    """Steps between the rows and columns [px] that are looked at, where errors hang together over blocks.

    Neighbours tell the same: an eighth of the distance over which errors hang together is near enough.
    """
    return max(1, block[0] // _LOOKS), max(1, block[1] // _LOOKS)


def noise_of(
    gray: NDArray[np.float64], block: tuple[int, int], steps: tuple[int, int]
) -> tuple[Bounded, NDArray[np.float64]]:
    """Mean square error of the mean of some replicates, and samples of it for each pixel that is looked at.

    Parameters
    ----------
    gray : ndarray, shape (replicates, rows, columns)
        Gray levels at the pixels that are looked at.
    block : tuple of int
        Rows and columns over which errors hang together [px].
    steps : tuple of int
        Between the rows and columns that are looked at [px], see `looks`; 1 where pixels have errors of their own.
    """
    errors = contrasts(gray)
    return mean_square_of_differences(errors, looked_at(block, steps)), errors


def contrasts(gray: NDArray[np.float64]) -> NDArray[np.float64]:
    """Helmert's contrasts of replicates, shape (replicates - 1, rows, columns).

    They are independent, each with the variance of the mean of all replicates.
    """
    number = len(gray)
    return np.stack([(gray[:k].mean(axis=0) - gray[k]) * math.sqrt(k / (k + 1) / number) for k in range(1, number)])


def looked_at(block: tuple[int, int], steps: tuple[int, int]) -> tuple[int, int]:
    """Of a block, the rows and columns that are looked at, by such steps."""
    return -(-block[0] // steps[0]), -(-block[1] // steps[1])
