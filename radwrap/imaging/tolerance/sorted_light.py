"""Light sorted by its depths, and cells added one by one, compiled.

This module needs the compiler, which an installation may lack: it is imported
where the compiled tracer is in use.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.compiled.compiler import compiled

Array = NDArray[np.float64]
Whole = NDArray[np.intp]

_LEAST: Final = 1e-9  # share of a layer, what rounding leaves


def in_phases(near: Array, step: int) -> Array:
    """Weights around a pixel for `added_one_by_one`: those that one cell has for pixels beside each other lie together.

    Parameters
    ----------
    near : ndarray, shape (rows, columns)
        Those of a pixel in the middle.
    step : int
        Cells from one pixel to the next.

    Returns
    -------
    ndarray, shape (step, step, fewer rows, fewer columns)
        Columns turned round.
    """
    wide = np.pad(near, [(0, -size % step) for size in near.shape])
    parts = wide.reshape(wide.shape[0] // step, step, wide.shape[1] // step, step)
    return np.ascontiguousarray(parts.transpose(1, 3, 0, 2)[..., ::-1])


def compile_ahead() -> None:
    """Compile what is not compiled yet, so that no image waits for it."""
    cell, none, one = np.ones((1, 1)), np.zeros(0, dtype=np.intp), np.zeros(1, dtype=np.intp)
    counted(cell, 0 * cell, cell[0], 0.0, one, np.zeros(2, dtype=np.intp))
    sorted_out(
        cell, 0 * cell, cell[0], 0.0, one, np.zeros(2, dtype=np.intp), np.zeros((1, 1, 1)), np.zeros((1, 2), np.intp),
        none, none, none, np.zeros(0), 0,
    )  # fmt: skip
    added_one_by_one(one, one, one, cell[0], np.ones((1, 1, 1, 1, 1)), (0, 0), 1, 0 * cell)


@compiled
def counted(  # noqa: PLR0917  (compiled functions take their arrays one by one)
    values: Array, places: Array, even: Array, near: float, of_even: Whole, of_layers: Whole
) -> None:
    """Count cells that have light at even places, within so much of them, and those that layers share else."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            if values[i, j] == 0:
                continue
            place = places[i, j]
            at = _even_at(place, even, near)
            if at >= 0:
                of_even[at] += 1
                continue
            number = int(place)
            share = place - number
            if share < 1 - _LEAST:
                of_layers[number] += 1
            if share > _LEAST:
                of_layers[number + 1] += 1


@compiled
def _even_at(place: float, even: Array, near: float) -> int:
    for k in range(len(even)):
        if abs(place - even[k]) <= near:
            return k
    return -1


@compiled
def sorted_out(  # noqa: PLR0917  (compiled functions take their arrays one by one)
    values: Array,
    places: Array,
    even: Array,
    near: float,
    to_even: Whole,
    to_layers: Whole,
    sheets: Array,
    spans: Whole,
    rows: Whole,
    columns: Whole,
    layers: Whole,
    light: Array,
    found: int,
) -> int:
    """Add light to the sheets of even places and of layers, what has none to a list; how many that holds."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            value = values[i, j]
            if value == 0:
                continue
            place = places[i, j]
            at = _even_at(place, even, near)
            if at >= 0:
                _put(value, sheets[to_even[at]], spans[to_even[at]], i, j)
                continue
            number = int(place)
            share = place - number
            for k in range(2):
                part = share if k else 1 - share
                if part <= _LEAST:
                    continue
                sheet = to_layers[number + k]
                if sheet >= 0:
                    _put(value * part, sheets[sheet], spans[sheet], i, j)
                else:
                    rows[found], columns[found], layers[found], light[found] = i, j, number + k, value * part
                    found += 1
    return found


@compiled
def _put(light: float, sheet: Array, span: Whole, i: int, j: int) -> None:
    sheet[i, j] += light
    span[0], span[1] = min(span[0], i), max(span[1], i + 1)


@compiled
def added_one_by_one(  # noqa: PLR0917  (compiled functions take their arrays one by one)
    rows: Whole,
    columns: Whole,
    layers: Whole,
    light: Array,
    weights: Array,
    origin: tuple[int, int],
    step: int,
    out: Array,
) -> None:
    """Add what pixels gather of single cells.

    Weights are those of `in_phases`, shape (layers, ...); the origin is the cell of the first pixel's corner less
    the cells that weights reach before it.
    """
    height, width = weights.shape[3:]
    for k in range(len(light)):
        row, column = rows[k] - origin[0], columns[k] - origin[1]
        if row < 0 or column < 0:
            continue
        down, across = row // step, column // step
        first, last, begin = max(across - width + 1, 0), min(across + 1, out.shape[1]), width - 1 - across
        for i in range(max(down - height + 1, 0), min(down + 1, out.shape[0])):
            line = weights[layers[k], row % step, column % step, down - i, begin + first : begin + last]
            pixels = out[i, first:last]
            for j in range(len(pixels)):
                pixels[j] += light[k] * line[j]
