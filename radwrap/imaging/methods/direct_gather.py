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


def compile_ahead() -> None:
    """Compile what is not compiled yet, so that no image waits for it."""
    _add(np.zeros((1, 1, 1)), np.ones((1, 1)), (0, 0), 1, np.zeros((1, 1)))


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
