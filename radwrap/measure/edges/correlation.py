"""How much more the residual of a fit weighs because it is not independent from pixel to pixel.

What the model leaves is seldom noise alone: rounding, the steps of a finite number of sub-viewpoints and light
that is no quadratic are the same all along the edge. Each row then tells the same again, and a standard error
that counts pixels is too small by the square root of the rows.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK: Final = 10.0  # px along the edge; misfit of the light changes over some tens of pixels
FALSE_ALARM: Final = 3.0  # standard deviations; independent noise passes for correlated once in 700 fits
FEWEST_CELLS: Final = 8  # fewer tell no ratio of variances


def variance_factor(across: Array, along: Array, residual: Array) -> float:
    """Factor on the variance of fitted parameters, 1 where the residual is independent.

    The mean of n independent pixels has 1/n of their variance. Means over cells, one pixel wide across the edge
    and a block long, or all of the edge long, show by how much more it is; the larger ratio counts, and what
    neighbouring cells have in common is added.

    Parameters
    ----------
    across, along : ndarray, shape (n,)
        Of each pixel from and along the edge [px].
    residual : ndarray, shape (n,)
        What the fit leaves [gray].

    Returns
    -------
    float
        At least 1.
    """
    variance = float(np.mean(residual**2))
    if variance == 0:
        return 1.0
    columns = np.floor(across - across.min()).astype(np.int64)
    lengths = (max(float(np.ptp(along)), 0.0) + 1.0, BLOCK)
    return max(
        _ratio(columns, np.floor((along - along.min()) / length), residual / math.sqrt(variance)) for length in lengths
    )


def _ratio(columns: NDArray[np.int64], blocks: Array, residual: Array) -> float:
    """Sum over lags of the cells' covariances, over what independent pixels have."""
    width, height = int(columns.max()) + 1, int(blocks.max()) + 1
    cell = columns + width * blocks.astype(np.int64)
    count = np.bincount(cell, minlength=width * height).reshape(height, width)
    total = np.bincount(cell, residual, minlength=width * height).reshape(height, width)
    full = count > 1
    cells = int(full.sum())
    if cells < FEWEST_CELLS:
        return 1.0
    # Each has variance 1 where pixels are independent.
    scaled = np.where(full, total / np.sqrt(np.maximum(count, 1)), 0.0)
    ratio = float((scaled**2).sum()) / cells
    if ratio < 1 + FALSE_ALARM * math.sqrt(2 / cells):
        return 1.0
    # Neighbours across the edge, as far as they still go together.
    common = 0.0
    for lag in range(1, width // 2):
        product = float((scaled[:, lag:] * scaled[:, :-lag]).sum()) / cells
        if product <= 0:
            break
        common += 2 * product
    return ratio + common
