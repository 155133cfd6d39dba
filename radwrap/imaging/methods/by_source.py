"""A tile of the kernel's image in the light of each source alone, by the rays of one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.central import Cells, CentralImage, TracedCells, central_image, traced_cells
from radwrap.imaging.methods.kernel import (
    Gathered,
    KernelPlan,
    coarsened,
    gathered_each,
    grid_share,
    has_small_footprints,
    lattice,
    layer_places,
    layer_share,
    layers_met,
    smooth_tiles,
)
from radwrap.imaging.optics.footprint import footprint
from radwrap.imaging.optics.view import View

Array = NDArray[np.float64]
Place = tuple[int, int, int, int]
# Sources that are gathered by transforms at a time: each takes the memory of a tile, its transform and its layers.
_AT_ONCE: Final = 4


def gathered_sources(
    view: View,
    plan: KernelPlan,
    tile: int,
    cells: Cells,
    kept: NDArray[np.intp],
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
    like: Gathered | None = None,
) -> Iterator[tuple[Array, Array]]:
    """Trace what a tile needs of the central image, and gather it for each source that the view's tracer tells apart.

    Parameters
    ----------
    view, plan, tile, cells, seed, progress
        As `gathered_tile`.
    kept : ndarray of int, shape (n,)
        Of the pixels that tell what the cells' size changes, those that are to.
    like : Gathered, optional
        The same tile in the light of all sources: the very same rays are traced as for it, see `central_image`. None
        is needed where the view has the light of all.

    Yields
    ------
    values : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
    change : ndarray, shape (n,)
        What the cells' size changes [W m^-2 sr^-1].
    """
    place = plan.tiles[tile]
    if not cells.samples:
        each = smooth_tiles(view, plan, place)
    elif like is not None:
        central = central_image(view, plan.grid, cells, seed=seed, progress=progress, like=like.central)
        each = gathered_each(plan, place, central, coarsened(central, like.coarser))
    else:
        with_depth = plan.grid.with_depth
        traced = traced_cells(view, plan.grid, cells, seed=seed, progress=progress, with_depth=with_depth)
        if traced.values.ndim > 1 and all(has_small_footprints(plan, times * plan.grid.cell) for times in (1, 2)):
            yield from _by_sums(plan, place, cells, traced, kept)
            return
        each = _by_transforms(plan, place, cells, traced)
    yield from ((one.values, one.change.ravel()[kept]) for one in each)


def _by_transforms(plan: KernelPlan, place: Place, cells: Cells, traced: TracedCells) -> Iterator[Gathered]:
    of_all = _light_of_all(plan, cells, traced)
    coarser = coarsened(of_all)
    if traced.values.ndim == 1:
        yield from gathered_each(plan, place, of_all, coarser)
        return
    for start in range(0, len(traced.values), _AT_ONCE):
        some = replace(of_all, values=traced.laid_out(traced.values[start : start + _AT_ONCE]))
        yield from gathered_each(plan, place, some, coarsened(some, coarser))


def _light_of_all(plan: KernelPlan, cells: Cells, traced: TracedCells) -> CentralImage:
    values = traced.values if traced.values.ndim == 1 else traced.values.sum(axis=0)
    magnification = traced.laid_out(traced.magnification) if plan.grid.with_depth else None
    return CentralImage(cells.first, traced.laid_out(values), magnification, traced.rays)


def _by_sums(
    plan: KernelPlan, place: Place, cells: Cells, traced: TracedCells, kept: NDArray[np.intp]
) -> Iterator[tuple[Array, Array]]:
    """All sources of a pixel at once: which cells it gathers from, and how much of each, is the same for all."""
    cell, of_all, numbers = plan.grid.cell, _light_of_all(plan, cells, traced), traced.numbers
    by_cell = np.ascontiguousarray(traced.values.T)
    rows, columns = lattice(cell, place)
    every = [axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij")]
    fine = _Field.of(plan, cell, of_all).gathered(by_cell, numbers, (every[0], every[1]))
    # Every pixel tells what cells of twice the size change, as these too are smaller than a pixel.
    coarse_cells = _Field.of(plan, 2 * cell, coarsened(of_all))
    coarse = coarse_cells.gathered(by_cell, numbers, (every[0][kept], every[1][kept]), of_all.first)
    for one, rough in zip(fine.T, coarse.T, strict=True):
        yield one.reshape(len(rows), len(columns)), grid_share(plan) * (rough - one[kept])


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """Cells of a size, and how pixels gather from them.

    Attributes
    ----------
    cell : float
        Their size [px].
    first : tuple of int
        Row and column of the first.
    shares : ndarray, shape (layers, rows, columns)
        Of each layer in each cell's light.
    weights : ndarray, shape (layers, rows, columns)
        Of cells about the one in which a pixel's corner lies.
    corner : tuple of int
        Row and column of the first weight, from that cell.
    """

    cell: float
    first: tuple[int, int]
    shares: Array
    weights: Array
    corner: tuple[int, int]

    @classmethod
    def of(cls, plan: KernelPlan, cell: float, seen: CentralImage) -> _Field:
        """Of an image in the light of all sources."""
        places = None if seen.magnification is None else layer_places(plan.layers, seen.magnification)
        each = (
            (number, np.ones_like(seen.values) if places is None else layer_share(places, number))
            for number in layers_met(places)
        )
        some = [(footprint(plan.camera, plan.layers[number], cell), share) for number, share in each if np.any(share)]
        corner = min(one.first[0] for one, _ in some), min(one.first[1] for one, _ in some)
        begins = [(one.first[0] - corner[0], one.first[1] - corner[1]) for one, _ in some]
        ends = [np.add(begin, one.weights.shape) for begin, (one, _) in zip(begins, some, strict=True)]
        weights = np.zeros((len(some), *np.max(ends, axis=0)))
        for layer, begin, end, (one, _) in zip(weights, begins, ends, some, strict=True):
            layer[begin[0] : end[0], begin[1] : end[1]] = one.weights
        return cls(cell, seen.first, np.stack([share for _, share in some]), weights, corner)

    def gathered(
        self,
        values: Array,
        numbers: NDArray[np.intp],
        pixels: tuple[NDArray[np.intp], NDArray[np.intp]],
        finer: tuple[int, int] | None = None,
    ) -> Array:
        """What pixels gather, shape (pixels, sources), of traced cells, shape (n, sources).

        Parameters
        ----------
        values, numbers
            What is seen of the traced cells, and which of them covers each of the finest ones.
        pixels : tuple of ndarray of int, shape (pixels,)
            Rows and columns.
        finer : tuple of int, optional
            Row and column of the first of the finest cells, where these here are twice as large.
        """
        from radwrap.imaging.methods.direct_gather import gathered_by_source

        corners = [
            (axis / self.cell).astype(np.intp) - first + begin
            for axis, first, begin in zip(pixels, self.first, self.corner, strict=True)
        ]
        pieces, (down, right) = (1, (0, 0)) if finer is None else (2, finer)
        inside = numbers[down % 2 :, right % 2 :]
        return gathered_by_source(
            values, inside, pieces, shares=self.shares, weights=self.weights, corners=(corners[0], corners[1])
        )
