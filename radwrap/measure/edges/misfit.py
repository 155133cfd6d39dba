"""What speaks against one edge with a symmetric blur: light that the fit leaves all along it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.background import QUANTISATION

Array = NDArray[np.float64]

_BIN: Final = 0.5  # px across the edge
_FEWEST: Final = 4  # pixels of a bin, and bins
SIGNIFICANT: Final = 5.0  # standard deviations of chi-square; rounding and uneven light leave a little more than noise


def misfit_of(across: Array, residual: Array, reach: float, contrast: float, *, rounded: bool) -> tuple[float, float]:
    """Mean of what a fit leaves at each distance from the edge: rms beyond noise, of all of it and of its even part.

    What a symmetric blur leaves has opposite signs on both sides. A fringe, a shadow, coma or a second edge leaves an
    even part too, and such moves the edge.

    Parameters
    ----------
    across, residual : ndarray, shape (n,)
        Distance from the edge [px], and model less image [gray].
    reach : float
        How far from the edge to look [px].
    contrast : float
        Of the edge [gray].
    rounded : bool
        Whether gray levels are whole numbers; along the columns they are rounded alike in all rows.

    Returns
    -------
    misfit, even_misfit : float
        Over the contrast; 0 where it is by chance.
    """
    number = np.rint(across / _BIN).astype(np.intp)
    most = int(reach / _BIN)
    here = np.abs(number) <= most
    index = number[here] + most
    count = np.bincount(index, minlength=2 * most + 1)
    some = np.maximum(count, 1)
    mean = np.bincount(index, residual[here], minlength=len(count)) / some
    spread = np.bincount(index, residual[here] ** 2, minlength=len(count)) / some - mean**2
    noise = float((spread * count).sum() / max(count.sum() - len(count), 1))
    variance = noise / some
    if rounded:
        # Noise takes the first harmonic of rounding away.
        variance = variance + QUANTISATION * math.exp(-4 * math.pi**2 * noise)
    full = count >= _FEWEST
    both = full & full[::-1]
    even = (mean + mean[::-1])[: most + 1] / 2
    even_variance = (variance + variance[::-1])[: most + 1] / 4
    return (
        _of_bins(mean[full], variance[full]) / contrast,
        _of_bins(even[both[: most + 1]], even_variance[both[: most + 1]]) / contrast,
    )


def _of_bins(mean: Array, variance: Array) -> float:
    return 0.0 if mean.size < _FEWEST else beyond_noise(mean, variance)


def beyond_noise(mean: Array, variance: Array) -> float:
    """Root mean square of means beyond the variance of each; 0 where they are so by chance."""
    chi = float((mean**2 / np.maximum(variance, 1e-300)).sum())
    if chi < mean.size + SIGNIFICANT * math.sqrt(2 * mean.size):
        return 0.0
    return math.sqrt(max(float(np.mean(mean**2 - variance)), 0.0))
