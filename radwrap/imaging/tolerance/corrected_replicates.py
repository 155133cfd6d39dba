"""Replicates by any plan; those of a hybrid are a kernel's, each with corrections of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure
from radwrap.imaging.methods.hybrid import (
    HybridPlan,
    Needs,
    corrected,
    corrections,
    needs_of_rows,
    pilot,
    pilot_rays,
    rays_of,
    signed_numbers,
)
from radwrap.imaging.methods.pieces import log_call, run_jobs
from radwrap.imaging.tolerance.replicates import (
    Plan,
    Replicates,
    TooManyRays,
    Work,
    among,
    decide_tiles,
    make_tiles,
    pieces_of,
    plan_name,
    trace_replicates,
)
from radwrap.manifest import sha256_of_value
from radwrap.random_streams import Rendering


def trace_plan(work: Work, plan: Plan, number: int, most: float = math.inf) -> Replicates:
    """Trace so many replicates; parameters and errors as `trace_replicates`, which does it but for a hybrid."""
    if not isinstance(plan, HybridPlan):
        return trace_replicates(work, plan, number, most)
    kernel = trace_replicates(work, plan.kernel, number, most)
    name, tiles = plan_name(work, plan), range(len(plan.tiles))
    pilots = [_PilotPiece(among(work, len(tiles)), plan, tile) for tile in tiles]
    if kernel.rays + pilot_rays(plan) > most:
        raise TooManyRays(kernel.parts, kernel.rays + pilot_rays(plan))
    run_jobs([piece.make for piece in pilots if piece.read() is None], work.programs, work.view.workers)
    numbers = [signed_of(piece, plan) for piece in pilots]
    parts = {**kernel.parts, pilots[0].name: sum(piece.needs()[1] for piece in pilots)}
    whole = sum(parts.values()) + number * sum(rays_of(signed, plan.pair_rays) for signed in numbers)
    if whole > most:
        raise TooManyRays(parts, whole)
    shared = among(work, number * len(tiles))
    pieces = [
        _CorrectionsPiece(shared, plan, name, (replicate, tile), numbers[tile])
        for replicate in range(number)
        for tile in tiles
    ]
    found: dict[_CorrectionsPiece, NDArray[np.float32]] = {}

    def make(piece: _CorrectionsPiece) -> None:
        found[piece] = piece.make()

    due = []
    for piece in pieces:
        if (there := piece.read()) is None:
            due.append(piece)
        else:
            found[piece] = there[0]
    run_jobs([partial(make, piece) for piece in due], work.programs, work.view.workers)
    images = kernel.images.copy()
    own_rays, squares = np.zeros(images.shape[1:], dtype=bool), kernel.grid_squares.copy()
    change = None if kernel.change is None else kernel.change.copy()
    for piece in pieces:
        r0, r1, c0, c1 = plan.tiles[piece.tile]
        place = images[piece.replicate, r0:r1, c0:c1]
        place[...] = corrected(place.astype(np.float64), found[piece].astype(np.float64), piece.signed)
        own_rays[r0:r1, c0:c1] = piece.signed != 0
        for of_cells in (squares, change):  # rays in the kernel's place have none of its cells
            if of_cells is not None:
                of_cells[r0:r1, c0:c1][piece.signed > 0] = 0.0
    reused = kernel.reused + len(pieces) - len(due)
    return replace(
        kernel,
        images=images,
        grid_squares=squares,
        change=change,
        rays=whole,
        reused=reused,
        own_rays=own_rays,
        uncorrected=kernel.images,
        parts=parts,
    )


def decide_plan(work: Work, plan: Plan) -> None:
    """Find out what each of a plan's tiles needs, which `make_plan` then has."""
    if not isinstance(plan, HybridPlan):
        decide_tiles(work, plan)
        return
    decide_tiles(work, plan.kernel)
    tiles = range(len(plan.tiles))
    shared = among(work, len(tiles))
    run_jobs([_PilotPiece(shared, plan, tile).make for tile in tiles], work.programs, work.view.workers)


def make_plan(work: Work, plan: Plan, number: int) -> int:
    """Make so many replicates of each of a plan's tiles, and no image of them; gives how many rays they took."""
    if not isinstance(plan, HybridPlan):
        return make_tiles(work, plan, number)
    rays = make_tiles(work, plan.kernel, number)
    name, tiles = plan_name(work, plan), range(len(plan.tiles))
    shared = among(work, number * len(tiles))
    numbers = [tile_numbers(work, plan, tile) for tile in tiles]
    pieces = [
        _CorrectionsPiece(shared, plan, name, (replicate, tile), numbers[tile])
        for replicate in range(number)
        for tile in tiles
    ]

    def make(piece: _CorrectionsPiece) -> None:
        piece.make()

    run_jobs([partial(make, piece) for piece in pieces], work.programs, work.view.workers)
    pilots = sum(_PilotPiece(work, plan, tile).needs()[1] for tile in tiles)
    return rays + pilots + sum(number * rays_of(signed, plan.pair_rays) for signed in numbers)


def tile_numbers(work: Work, plan: HybridPlan, tile: int) -> NDArray[np.intp]:
    """How a tile of an image that was made is corrected; piloted again where that is no longer on the disk."""
    piece = _PilotPiece(work, plan, tile)
    if piece.read() is None:
        piece.make()
    return signed_of(piece, plan)


def signed_of(piece: _PilotPiece, plan: HybridPlan) -> NDArray[np.intp]:
    """Rays and pairs of each pixel of a tile, shape (rows, columns), see `corrections`."""
    r0, r1, c0, c1 = plan.tiles[piece.tile]
    needs, _ = piece.needs()
    return signed_numbers(plan, needs, len(needs.due)).reshape(r1 - r0, c1 - c0)


def corrections_seed(seed: int, replicate: int, tile: int) -> tuple[int, ...]:
    """Seed of all that is drawn to correct a tile of a replicate."""
    return (seed, Rendering.CORRECTIONS, replicate, tile)


class _PilotPiece:
    """What pilot pairs say of a tile's pixels, which all replicates have in common, whatever their aim."""

    def __init__(self, work: Work, plan: HybridPlan, tile: int) -> None:
        self.tile = tile
        self.name = sha256_of_value({"scene": work.traced_sha256, "pilot": plan.piloted, "seed": work.seed})
        self._file = f"pilot_{self.name[:12]}_{tile:05d}.exr"
        self._work, self._plan = work, plan

    def read(self) -> tuple[NDArray[np.float32], Mapping[str, Any]] | None:
        return pieces_of(self._work).read(self._file, f"{self.name}-{self.tile}")

    def make(self) -> None:
        work = self._work
        log_call(work.folder, Path(self._file).stem)
        seed = (work.seed, Rendering.CORRECTED_PIXELS, self.tile)
        needs, rays = pilot(work.view, self._plan, self.tile, seed, work.progress.add)
        pieces_of(work).write(self._file, needs.as_rows(), f"{self.name}-{self.tile}", {"rays": rays})

    def needs(self) -> tuple[Needs, int]:
        found = self.read()
        if found is None:
            where = str(self._work.folder / self._file)
            raise EnvironmentFailure("was changed by somebody else", where=where, remedy="run again")
        rows, told = found
        return needs_of_rows(rows), int(told["rays"])


class _CorrectionsPiece:
    """What a tile of a replicate gets beside its kernel."""

    def __init__(
        self, work: Work, plan: HybridPlan, name: str, place: tuple[int, int], signed: NDArray[np.intp]
    ) -> None:
        self.replicate, self.tile = replicate, tile = place
        self.signed = signed
        self._file = f"corrections_{name[:12]}_{replicate:03d}_{tile:05d}.exr"
        self._work, self._plan, self._name = work, plan, f"{name}-corrections-{replicate}-{tile}"

    def read(self) -> tuple[NDArray[np.float32], Mapping[str, Any]] | None:
        return pieces_of(self._work).read(self._file, self._name)

    def make(self) -> NDArray[np.float32]:
        """Make it, and give it as `read` does."""
        work = self._work
        log_call(work.folder, Path(self._file).stem)
        seed = corrections_seed(work.seed, self.replicate, self.tile)
        more = corrections(work.view, self._plan, self.tile, self.signed, seed=seed, progress=work.progress.add).astype(
            np.float32
        )
        pieces_of(work).write(self._file, more, self._name, {})
        return more
