"""Gathering by a small footprint, compiled: for few cells sums are faster than transforms.

This module needs the compiler, which an installation may lack: it is imported
where the compiled tracer is in use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.footprint import Footprint
from radwrap.tracers.compiled.compiler import compiled

Array = NDArray[np.float64]
Whole = NDArray[np.intp]


def gathered_directly(values: Array, footprint: Footprint, corner: tuple[int, int], step: int, out: Array) -> None:
    """Add what pixels gather from the cells of one layer.

    Parameters
    ----------
    values : ndarray, shape (..., rows, columns)
        Cells.
    footprint : Footprint
        Of every pixel.
    corner : tuple of int
        Row and column of the cell in which the first pixel's corner lies.
    step : int
        Cells from one pixel to the next.
    out : ndarray, shape (..., pixel rows, pixel columns)
        To which is added.
    """
    row, column = (at + first for at, first in zip(corner, footprint.first, strict=True))
    # Columns that lie alike in their pixels side by side: the inner loop then reads what lies together.
    padding = -values.shape[-1] % step
    padded = np.pad(values.reshape(-1, *values.shape[-2:]), ((0, 0), (0, 0), (0, padding)))
    phases = np.ascontiguousarray(np.moveaxis(padded.reshape(*padded.shape[:2], -1, step), -1, 1))
    for cells, pixels in zip(phases, out.reshape(-1, *out.shape[-2:]), strict=True):
        _add(cells, footprint.weights, (row, column), step, pixels)


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
    _add(np.zeros((1, 1, 1)), np.ones((1, 1)), (0, 0), 1, np.zeros((1, 1)))
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
def _add(phases: Array, weights: Array, corner: tuple[int, int], step: int, out: Array) -> None:
    height, width = weights.shape
    row, column = corner
    for i in range(out.shape[0]):
        for a in range(height):
            for b in range(width):
                weight = weights[a, b]
                if weight == 0:
                    continue
                phase, first, line = (column + b) % step, (column + b) // step, row + i * step + a
                for j in range(out.shape[1]):
                    out[i, j] += weight * phases[phase, line, first + j]
