"""Upper bounds of mean squares from samples, as far as their coverage was measured.

A bound here is one-sided at 97.5 %, two of them added hold at 95 %. Squared
errors have heavy tails, for which a normal bound covers too little: the larger
of it and a bootstrap-t is taken. scripts/certificates.py measures how often
the sum holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

_NORMAL_QUANTILE: Final = 1.959963985  # of 0.975
_TAIL: Final = 0.025
_RESAMPLES: Final = 999
# Wilson and Hilferty's cube is good to some per cent from here on; below, nothing is certain.
_FEWEST_DEGREES: Final = 3.0


@dataclass(frozen=True, slots=True)
class Bounded:
    """A mean with its upper bound.

    Attributes
    ----------
    mean : float
        Estimate; unbiased, hence perhaps negative for a mean square.
    upper : float
        97.5 % one-sided bound.
    """

    mean: float
    upper: float

    def __add__(self, other: Bounded) -> Bounded:
        return Bounded(self.mean + other.mean, self.upper + other.upper)


NOTHING: Final = Bounded(0.0, 0.0)


def stratified_mean(
    values: NDArray[np.float64], stratum: NDArray[np.intp], shares: NDArray[np.float64], seed: tuple[int, ...]
) -> Bounded:
    """Mean of a population from samples of its strata.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Samples.
    stratum : ndarray of int, shape (n,)
        Stratum of each; each stratum has two samples or more.
    shares : ndarray, shape (strata,)
        Share of each stratum in the population.
    seed : tuple of int
        Of the resampling.
    """
    counts = np.bincount(stratum, minlength=len(shares))
    weights = (shares / counts)[stratum]
    mean = float((weights * values).sum())
    error = _standard_error(values[np.newaxis], stratum, counts, shares)[0]
    if error == 0.0:
        return Bounded(mean, mean)
    random = np.random.default_rng(seed)
    drawn = np.concatenate(
        [random.choice(np.flatnonzero(stratum == k), (_RESAMPLES, n)) for k, n in enumerate(counts.tolist()) if n],
        axis=1,
    )
    order = stratum[drawn[0]]
    samples = values[drawn]
    errors = _standard_error(samples, order, counts, shares)
    t = (samples @ (shares / counts)[order] - mean) / np.where(errors > 0, errors, np.inf)
    quantile = max(_NORMAL_QUANTILE, -float(np.quantile(t, _TAIL)))
    return Bounded(mean, mean + quantile * error)


def _standard_error(
    samples: NDArray[np.float64], stratum: NDArray[np.intp], counts: NDArray[np.intp], shares: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Standard error of the stratified mean of each row."""
    variance = np.zeros(len(samples))
    for k, n in enumerate(counts.tolist()):
        if n > 1:
            variance += shares[k] ** 2 * samples[:, stratum == k].var(axis=1, ddof=1) / n
    return np.sqrt(variance)


def mean_square_of_differences(differences: NDArray[np.float64], block: tuple[int, int]) -> Bounded:
    """Mean square over an image of errors of which one realisation is known.

    Parameters
    ----------
    differences : ndarray, shape (replicates - 1, rows, columns)
        Each distributed as the error of the image is, and independent of each other.
    block : tuple of int
        Rows and columns over which errors hang together [px].

    Notes
    -----
    The bound is that of a chi-square whose degrees of freedom are the number
    of blocks that share the error evenly, (sum s)^2 / sum s^2.
    """
    square = (differences**2).mean(axis=0)
    rows = np.arange(0, square.shape[0], max(1, block[0]))
    columns = np.arange(0, square.shape[1], max(1, block[1]))
    sums = np.add.reduceat(np.add.reduceat(square, rows, axis=0), columns, axis=1)
    mean = float(square.mean())
    if mean == 0.0:
        return NOTHING
    degrees = len(differences) * float(sums.sum() ** 2 / (sums**2).sum())
    return Bounded(mean, mean * degrees / _lower_chi_square(degrees))


def _lower_chi_square(degrees: float) -> float:
    """2.5 % quantile of chi-square (Wilson and Hilferty 1931); nearly 0 for few degrees of freedom."""
    if degrees < _FEWEST_DEGREES:
        return 1e-3
    return degrees * (1 - 2 / (9 * degrees) - _NORMAL_QUANTILE * math.sqrt(2 / (9 * degrees))) ** 3
