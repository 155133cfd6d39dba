"""Waves by the rays of the image that they are added to: where its cells suffice only light beside it is traced.

The sum of both is the image as waves blur it, gathered from one central image:
rays that are noisy in it are so once, and waves blur their noise too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.central import (
    Cells,
    CentralImage,
    EdgeSampling,
    central_image,
    decide_cells,
    edge_sampling,
)
from radwrap.imaging.methods.kernel import NO_CELLS, KernelPlan, coarsened, is_smooth, region_of
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.replicates import Work, plan_name, tile_cells, tile_seed
from radwrap.imaging.tolerance.seen_tiles import (
    Rect,
    SeenTile,
    SeenTiles,
    cells_of,
    kept_cell,
    may_be_kept,
    part_of,
    seen_in,
)
from radwrap.imaging.tolerance.wave_far import whole_blocks
from radwrap.imaging.tolerance.wave_plan import WavePlan, bare
from radwrap.random_streams import Rendering

Array = NDArray[np.float64]

_RIM: Final = 3  # cells more than waves reach, which coarser ones may need


@dataclass(frozen=True, slots=True, eq=False)
class OwnRays:
    """Rays of an image by a kernel.

    Attributes
    ----------
    work : Work
        By whom they were traced.
    plan : KernelPlan
        Where they went.
    replicates : int
        How many sets of them there are.
    name : str
        What the image is known by.
    seen : SeenTiles
        What they saw, if that is still kept.
    """

    work: Work
    plan: KernelPlan
    replicates: int
    name: str
    seen: SeenTiles

    @classmethod
    def of(cls, work: Work, plan: KernelPlan, replicates: int) -> OwnRays | None:
        """Of an image by a plan; None where what they saw was not to be kept."""
        if work.seen is None:
            return None
        name = plan_name(work, plan)
        work.seen.begin(name, plan, replicates)  # of several images the last need not be the best
        return cls(work, plan, replicates, name, work.seen)

    @property
    def cell(self) -> float:
        """Size of the cells that are kept [px]."""
        return kept_cell(self.plan, self.replicates)

    def central(self, waves: WavePlan, tile: int, beside: Sequence[SeenTile], replicate: int) -> CentralImage:
        """What a tile of waves gathers from, by the rays of a replicate in the image and beside it."""
        (row, column), (rows, columns) = region_of(waves.kernel, tile)
        values = np.empty((rows, columns))
        depth = np.empty_like(values) if waves.kernel.grid.with_depth else None
        whole = (row, row + rows, column, column + columns)
        inside = self._met(whole, waves.kernel.grid.cell, replicate)
        for place, seen in itertools.chain(inside, ((_common(whole, seen.place), seen) for seen in beside)):
            if not _is_any(place):
                continue
            here, there = _part(place, whole), _part(place, seen.place)
            values[here] = seen.values[there]
            if depth is not None and seen.magnification is not None:
                depth[here] = seen.magnification[there]
        return CentralImage((row, column), values, depth, 0)

    def _met(self, whole: Rect, cell: float, replicate: int) -> Iterator[tuple[Rect, SeenTile]]:
        """What was seen of all cells of a size [px] that lie in a place, tile by tile."""
        for tile in range(len(self.plan.tiles)):
            place = _common(whole, cells_of(self.plan, tile, cell))
            if _is_any(place):
                seen = self._tile(tile, replicate)
                yield place, self._smooth(place, cell) if seen is None else _widened(seen, place, cell / self.cell)

    def means(self, block: float, replicate: int) -> Array:
        """Mean light of blocks of a side [px] that lie on the sensor, shape (rows, columns)."""
        rows, columns = whole_blocks(self.plan.camera.sensor, block)
        # What lies in no whole block goes to one more row and column.
        light, area = np.zeros((2, rows + 1, columns + 1))
        for tile in range(len(self.plan.tiles)):
            seen, cell = self._tile(tile, replicate), self.cell
            if seen is None:
                cell = max(cell, 1.0)
                seen = self._smooth(cells_of(self.plan, tile, cell), cell)
            if (times := round(cell)) > 1:  # no block is smaller than a pixel, but such cells may be wider than blocks
                seen, cell = _parted(seen, times), 1.0
            place = seen.place
            (first_row, row), (first_column, column) = (
                _blocks(begin, end, cell / block, most)
                for begin, end, most in ((*place[:2], rows), (*place[2:], columns))
            )
            by_rows = np.add.reduceat(seen.values, first_row, axis=0, dtype=np.float64)
            at = np.ix_(row, column)
            light[at] += cell**2 * np.add.reduceat(by_rows, first_column, axis=1)
            numbers = (
                np.diff(first, append=size)
                for first, size in zip((first_row, first_column), seen.values.shape, strict=True)
            )
            area[at] += cell**2 * np.outer(*numbers)
        return light[:rows, :columns] / area[:rows, :columns]

    def _tile(self, tile: int, replicate: int) -> SeenTile | None:
        """A tile, by the very same rays once more where it was made before this run; None where all is smooth."""
        work, plan, which = self.work, self.plan, (replicate, tile)
        if plan.grid.smooth and is_smooth(work.view.smooth, plan, plan.tiles[tile]):
            return None
        if (found := self.seen.get(self.name, which)) is None:
            cells, seed = tile_cells(work, plan, tile), tile_seed(work.seed, *which)
            central = central_image(work.view, plan.grid, cells, seed=seed, progress=lambda _: None)
            coarser = coarsened(central)
            found = seen_in(plan, tile, self.cell, central, coarser)
            self.seen.put(self.name, which, plan, central, coarser)
        return found

    def _smooth(self, place: Rect, cell: float) -> SeenTile:
        """Part of a tile that lies in smooth blocks."""
        known = self.work.view.smooth
        if known is None:
            raise TypeError("no block of this view is known to be smooth")
        v, u = np.indices((place[1] - place[0], place[3] - place[2]), dtype=np.float64)
        found = known.at(*(((at + first + 0.5) * cell - 0.5).ravel() for at, first in ((u, place[2]), (v, place[0]))))
        values, depth = (each.reshape(v.shape).astype(np.float32) for each in found)
        return SeenTile(place, values, depth)


def suffice(plan: KernelPlan, replicates: int, waves: WavePlan) -> bool:
    """Whether rays of so many replicates of an image tell waves: by cells, by depths, and where they can be kept."""
    kept, cell = kept_cell(plan, replicates), waves.kernel.grid.cell
    # Cells wider than a pixel may lie across the sensor's edge.
    do = kept == cell or kept < cell <= 1
    return do and may_be_kept(plan, replicates) and (plan.grid.with_depth or len(waves.kernel.layers) == 1)


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """What is seen beside the sensor, as far as waves reach.

    Attributes
    ----------
    seen : tuple of tuple of SeenTile
        Of each replicate, above, below, on the left and on the right.
    sampling : EdgeSampling
        Rays in cells that differ much.
    """

    seen: tuple[tuple[SeenTile, ...], ...]
    sampling: EdgeSampling


def strips_beside(waves: WavePlan) -> tuple[Rect, ...]:
    """Cells beside the sensor that waves reach: above, below, on the left and on the right of it."""
    sensor, cell = waves.kernel.camera.sensor, waves.kernel.grid.cell
    across, down = (math.ceil(reach / cell) + _RIM for reach in waves.kernel.reach_px)
    rows, columns = (math.ceil(size / cell) for size in (sensor.rows, sensor.columns))
    wide = -across, columns + across
    return (-down, 0, *wide), (rows, rows + down, *wide), (0, rows, -across, 0), (0, rows, columns, columns + across)


def traced_beside(
    view: View,
    waves: WavePlan,
    replicates: int,
    count: Callable[[int], None],
    run: Callable[[list[Callable[[], None]]], None],
) -> Beside:
    """Trace what waves reach beside the sensor; parameters as of `wave_parts`."""
    grid, strips, number = waves.kernel.grid, strips_beside(waves), range(replicates)
    decided, seen = dict[int, Cells](), dict[tuple[int, int], SeenTile]()

    def decide(strip: int, place: Rect) -> None:
        region = (place[0], place[2]), (place[1] - place[0], place[3] - place[2])
        seed = (waves.seed, Rendering.WAVE_CELLS, strip)
        decided[strip] = decide_cells(bare(view), grid, region, seed=seed, progress=count)

    run([partial(decide, *one) for one in enumerate(strips)])
    # What rays beside the image are off by is shared by all of it.
    areas = [(cells, cells.levels.size * grid.cell**2) for _, cells in sorted(decided.items())]
    sampling = edge_sampling(grid, [*areas, (NO_CELLS, waves.kernel.camera.sensor.pixels)])

    def trace(replicate: int, strip: int) -> None:
        cells = decided[strip].with_rays(grid.levels, sampling)
        seed = (waves.seed, Rendering.WAVE_RAYS, replicate, strip)
        central = central_image(bare(view), grid, cells, seed=seed, progress=count)
        seen[replicate, strip] = part_of(central, strips[strip])

    run([partial(trace, replicate, strip) for replicate in number for strip in decided])
    return Beside(tuple(tuple(seen[each, strip] for strip in range(len(strips))) for each in number), sampling)


def _blocks(begin: int, end: int, share: float, most: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where among some cells, each of a share of a block, blocks begin, and which of them; at `most` this one."""
    block = np.minimum(np.floor((np.arange(begin, end) + 0.5) * share).astype(np.intp), most)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    return first, block[first]


def _parted(seen: SeenTile, times: int) -> SeenTile:
    """A tile's light in cells so many times as small."""
    r0, r1, c0, c1 = (times * end for end in seen.place)
    return SeenTile((r0, r1, c0, c1), seen.values.repeat(times, axis=0).repeat(times, axis=1), None)


def _widened(seen: SeenTile, place: Rect, times: float) -> SeenTile:
    """A place, in cells so many times as wide, of a tile that holds it."""
    if times == 1:
        return seen
    r0, r1, c0, c1 = (round(times * end) for end in place)
    part = _part((r0, r1, c0, c1), seen.place)
    depth = None if seen.magnification is None else seen.magnification[part].astype(np.float64)
    image = CentralImage((r0, c0), seen.values[part].astype(np.float64), depth, 0)
    for _ in range(round(math.log2(times))):
        image = coarsened(image)
    return part_of(image, place)


def _common(one: Rect, other: Rect) -> Rect:
    return max(one[0], other[0]), min(one[1], other[1]), max(one[2], other[2]), min(one[3], other[3])


def _is_any(place: Rect) -> bool:
    return place[0] < place[1] and place[2] < place[3]


def _part(place: Rect, whole: Rect) -> tuple[slice, slice]:
    return slice(place[0] - whole[0], place[1] - whole[0]), slice(place[2] - whole[2], place[3] - whole[2])
