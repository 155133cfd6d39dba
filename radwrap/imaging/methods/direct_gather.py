"""Gathering by a small footprint, compiled: for few cells sums are faster than transforms.

This module needs the compiler, which an installation may lack: it is imported
where the compiled tracer is in use.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.footprint import Footprint
from radwrap.tracers.compiled.compiler import compiled

Array = NDArray[np.float64]
Whole = NDArray[np.intp]


def gathered_directly(
    values: Array,
    places: Array | None,
    prints: Mapping[int, Footprint],
    *,
    corner: tuple[int, int],
    step: int,
    out: Array,
) -> None:
    """Add what pixels gather from cells, each layer by its own footprint.

    Parameters
    ----------
    values : ndarray, shape (..., rows, columns)
        Cells.
    places : ndarray, shape (rows, columns), optional
        Numbers of the layers that their light lies at or between, see `kernel.layer_places`; default is the first.
    prints : dict of Footprint
        Of every pixel, of the layers that have light, by their number.
    corner : tuple of int
        Row and column of the cell in which the first pixel's corner lies.
    step : int
        Cells from one pixel to the next.
    out : ndarray, shape (..., pixel rows, pixel columns)
        To which is added.
    """
    height, width = values.shape[-2:]
    each = np.ascontiguousarray(values.reshape(-1, height, width))
    # Columns that lie alike in their pixels side by side: the inner loop then reads what lies together.
    phases = np.zeros((step, height, -(-width // step)))
    for number, footprint in prints.items():
        row, column = (at + begin for at, begin in zip(corner, footprint.first, strict=True))
        for cells, pixels in zip(each, out.reshape(-1, *out.shape[-2:]), strict=True):
            if places is None:
                _lay_out(cells, phases)
                lit = (0, height)
            else:
                lit = _lay_out_layer(cells, places, number, phases)
            _add(phases, footprint.weights, (row, column), step, lit, pixels)


def gathered_by_source(
    values: Array, numbers: Whole, pieces: int, *, shares: Array, weights: Array, corners: tuple[Whole, Whole]
) -> Array:
    """What pixels gather of each source from cells that are known by their numbers: what is even is one cell.

    Parameters
    ----------
    values : ndarray, shape (n, sources)
        What is seen of each cell.
    numbers : ndarray of int, shape (rows, columns)
        Which cell each place belongs to.
    pieces : int
        Places along a side of the squares that are gathered.
    shares : ndarray, shape (layers, fewer rows, fewer columns)
        Of each layer in the light of these squares.
    weights : ndarray, shape (layers, height, width)
        Of those around a pixel.
    corners : tuple of ndarray of int, shape (pixels,)
        Row and column of the first of them.

    Returns
    -------
    ndarray, shape (pixels, sources)
    """
    found = np.zeros((len(corners[0]), values.shape[1]))
    room = np.full(len(values), -1), np.zeros(len(values), dtype=np.intp)
    size = weights.shape[1] * weights.shape[2] * pieces * pieces
    terms = np.zeros(size, dtype=np.intp), np.zeros(size)
    _add_sources(values, np.ascontiguousarray(numbers), pieces, shares, weights, *corners, *room, *terms, found)
    return found


def compile_ahead() -> None:
    """Compile what is not compiled yet, so that no image waits for it."""
    cell, pixel = np.zeros((1, 1)), np.zeros((1, 1))
    for places in (None, cell):
        gathered_directly(cell, places, {0: Footprint((0, 0), np.ones((1, 1)))}, corner=(0, 0), step=1, out=pixel)
    nothing = np.zeros(1, dtype=np.intp)
    one = np.ones((1, 1, 1))
    gathered_by_source(one[0], nothing.reshape(1, 1), 1, shares=one, weights=one, corners=(nothing, nothing))


@compiled
def _add_sources(  # noqa: PLR0917  (compiled functions take their arrays one by one)
    values: Array,
    numbers: Whole,
    pieces: int,
    shares: Array,
    weights: Array,
    rows: Whole,
    columns: Whole,
    last: Whole,
    slots: Whole,
    which: Whole,
    counts: Array,
    out: Array,
) -> None:
    """Add each pixel's terms up by cell, and then the cells' light of all sources."""
    for p in range(len(rows)):
        terms = 0
        for a in range(weights.shape[1]):
            for b in range(weights.shape[2]):
                row, column = rows[p] + a, columns[p] + b
                weight = 0.0
                for layer in range(weights.shape[0]):
                    weight += weights[layer, a, b] * shares[layer, row, column]
                if weight == 0:
                    continue
                weight /= pieces * pieces
                for i in range(pieces):
                    for j in range(pieces):
                        cell = numbers[row * pieces + i, column * pieces + j]
                        if last[cell] != p:
                            last[cell], slots[cell] = p, terms
                            which[terms], counts[terms] = cell, 0.0
                            terms += 1
                        counts[slots[cell]] += weight
        for term in range(terms):
            cell, weight = which[term], counts[term]
            for source in range(values.shape[1]):
                out[p, source] += weight * values[cell, source]


@compiled
def _lay_out(values: Array, phases: Array) -> None:
    """Cells that lie alike in their pixels side by side."""
    step = len(phases)
    for i in range(values.shape[0]):
        for phase in range(step):
            for j in range((values.shape[1] - phase + step - 1) // step):
                phases[phase, i, j] = values[i, j * step + phase]


@compiled
def _lay_out_layer(values: Array, places: Array, number: int, phases: Array) -> tuple[int, int]:
    """The same of one layer's share in them; between which rows it has any."""
    step = len(phases)
    first, end = values.shape[0], 0
    for i in range(values.shape[0]):
        for phase in range(step):
            most = 0.0
            for j in range((values.shape[1] - phase + step - 1) // step):
                share = max(1 - abs(places[i, j * step + phase] - number), 0.0)
                phases[phase, i, j] = values[i, j * step + phase] * share
                most = max(most, share)
            if most > 0:
                first, end = min(first, i), i + 1
    return first, end


@compiled
def _add(  # noqa: PLR0917  (compiled functions take their arrays one by one)
    phases: Array, weights: Array, corner: tuple[int, int], step: int, lit: tuple[int, int], out: Array
) -> None:
    """Add what pixels gather of one layer, which has light between some rows of cells."""
    height, width = weights.shape
    row, column = corner
    for i in range(out.shape[0]):
        for a in range(height):
            line = row + i * step + a
            if line < lit[0] or line >= lit[1]:
                continue
            for b in range(width):
                weight = weights[a, b]
                if weight == 0:
                    continue
                phase, first = (column + b) % step, (column + b) // step
                for j in range(out.shape[1]):
                    out[i, j] += weight * phases[phase, line, first + j]
