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

from radwrap.imaging.response.strips import strips_of
from radwrap.random_streams import generator

_NORMAL_QUANTILE: Final = 1.959963985  # of 0.975
_TAIL: Final = 0.025
_RESAMPLES: Final = 999
# Multiplications up to which OpenBLAS works alone: its threads wait for each other, for long where the machine is busy.
ALONE: Final = 1 << 18
_ROUNDING: Final = 1e-12  # of sums of squares in float64
# Wilson and Hilferty's cube is good to 1.5 per cent from here on; below, a series is.
_FEWEST_DEGREES: Final = 8.0
_FEWEST_OF_F: Final = 3  # degrees from which the quantile of F is no less than .99 of what it is
_TERMS: Final = 24  # of it, and steps: what is left is 1e-11 below that many degrees


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


@dataclass(frozen=True, slots=True, eq=False)
class Resampling:
    """How a stratified sample is drawn again, some hundred times: made once, used for any values of that sample.

    Attributes
    ----------
    members : tuple of ndarray of int
        Places of each stratum's samples.
    drawn : tuple of ndarray, shape (resamples, n)
        How often each sample of a stratum comes in each resample.
    shares : ndarray, shape (strata,)
        Share of each stratum in the population.
    """

    members: tuple[NDArray[np.intp], ...]
    drawn: tuple[NDArray[np.float64], ...]
    shares: NDArray[np.float64]


def resampling(stratum: NDArray[np.intp], shares: NDArray[np.float64], seed: tuple[int, ...]) -> Resampling:
    """Draw the resamples of a stratified sample; parameters as in `stratified_mean`."""
    random = generator(*seed)
    members = tuple(np.flatnonzero(stratum == k) for k in range(len(shares)))
    drawn = []
    for places in members:
        n = len(places)
        chosen = random.integers(0, max(n, 1), (_RESAMPLES, n))
        chosen += n * np.arange(_RESAMPLES)[:, np.newaxis]
        times = np.bincount(chosen.ravel(), minlength=_RESAMPLES * n).reshape(_RESAMPLES, n)
        drawn.append(times.astype(np.float64))
    return Resampling(members, tuple(drawn), shares)


def stratified_mean(
    values: NDArray[np.float64], stratum: NDArray[np.intp], shares: NDArray[np.float64], seed: tuple[int, ...]
) -> Bounded:
    """Mean of a population, which is known to be no less than zero, from samples of its strata.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Samples; products of two unbiased values, say, which noise may take below zero.
    stratum : ndarray of int, shape (n,)
        Stratum of each; each stratum has two samples or more.
    shares : ndarray, shape (strata,)
        Share of each stratum in the population.
    seed : tuple of int
        Of the resampling.
    """
    return stratified_means(values[np.newaxis], resampling(stratum, shares, seed))[0]


def mean_squares(first: NDArray[np.float64], second: NDArray[np.float64], again: Resampling) -> list[Bounded]:
    """Mean squares of errors of which two independent, unbiased values are known at each pixel of a sample.

    Parameters
    ----------
    first, second : ndarray, shape (sets, n)
        The values; of each set one mean square.
    again : Resampling
        Of the sample.

    Notes
    -----
    Values that are zero at most pixels and large at few seldom are so in both:
    most of their products vanish, and their scatter tells nothing. Products of
    independent values scatter by the product of the values' mean squares, less
    the square of their mean, which is left out here; and the mean squares are
    seen long before.
    """
    squares = (first**2 + second**2) / 2
    return stratified_means(first * second, again, squares)


def stratified_means(
    values: NDArray[np.float64], again: Resampling, squares: NDArray[np.float64] | None = None
) -> list[Bounded]:
    """As `stratified_mean`, for several sets of values of one sample, shape (sets, n).

    Where the values are products of two, `squares`, of the same shape, are those two's mean squares: the variance
    in a stratum is no less than the square of their mean.
    """
    sets = len(values)
    mean, variance, floor = np.zeros(sets), np.zeros(sets), np.zeros(sets)
    shift, variances = np.zeros((_RESAMPLES, sets)), np.zeros((_RESAMPLES, sets))
    parts = zip(again.members, again.drawn, again.shares.tolist(), strict=True)
    for places, drawn, share in parts:
        n = len(places)
        if not n:
            continue
        middle = values[:, places].mean(axis=1)
        mean += share * middle
        centred = values[:, places] - middle[:, np.newaxis]
        moved = small_products(drawn, centred.T) / n
        shift += share * moved
        if n > 1:
            scatter = (centred**2).sum(axis=1) / (n - 1)
            variance += share**2 * scatter / n
            known = 0.0 if squares is None else squares[:, places].mean(axis=1) ** 2
            floor += share**2 * np.maximum(scatter, known) / n
            redrawn = small_products(drawn, (centred**2).T) / n
            spread = redrawn - moved**2
            # A resample of equal values has no spread; what rounding leaves of it is no measure of an error.
            variances += share**2 * np.where(spread > _ROUNDING * redrawn, spread, 0.0) / (n - 1)
    errors = np.sqrt(variances)
    t = shift / np.where(errors > 0, errors, np.inf)
    quantiles = np.maximum(_NORMAL_QUANTILE, -np.quantile(t, _TAIL, axis=0))
    # A mean that noise took below zero tells no more than one of zero: what could not be seen stays in the bound.
    widths = np.maximum(quantiles * np.sqrt(variance), _NORMAL_QUANTILE * np.sqrt(floor))
    upper = np.maximum(mean, 0.0) + widths
    return [Bounded(*pair) for pair in zip(mean.tolist(), upper.tolist(), strict=True)]


def small_products(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Product of two matrices by parts, each made by one thread."""
    result = np.empty((left.shape[0], right.shape[1]))
    step = max(1, ALONE // max(1, right.size))
    for start in range(0, len(left), step):
        np.matmul(left[start : start + step], right, out=result[start : start + step])
    return result


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
    Degrees of freedom are the number of blocks that share the error evenly,
    (sum s)^2 / sum s^2. The image is one draw of so many, whose mean square is
    bounded, and not what it would be in the mean: over what is known of that by
    all realisations it is distributed as F; below three degrees of freedom the mean itself is bounded.
    """
    square: NDArray[np.float64] = np.empty(differences.shape[1:])
    for strip in strips_of(*square.shape):
        np.mean(differences[:, strip] ** 2, axis=0, out=square[strip])
    rows = np.arange(0, square.shape[0], max(1, block[0]))
    columns = np.arange(0, square.shape[1], max(1, block[1]))
    sums = np.add.reduceat(np.add.reduceat(square, rows, axis=0), columns, axis=1)
    mean = float(square.mean())
    if mean == 0.0:
        return NOTHING
    of_image = float(sums.sum() ** 2 / (sums**2).sum())
    known = len(differences) * of_image
    times = _upper_f(of_image, known) if known >= _FEWEST_OF_F else 0.0
    if known < _FEWEST_DEGREES:
        times = max(times, known / _lower_chi_square(known))
    return Bounded(mean, mean * times)


def _upper_f(of_image: float, known: float) -> float:
    """97.5 % quantile of F, the ratio of mean squares of so many degrees of freedom (key paulson).

    Their cube roots are about normal: of the quantile y^3, (1 - b) y - (1 - a) is the normal's over the root of
    b y^2 + a.
    """
    a, b, z2 = 2 / (9 * of_image), 2 / (9 * known), _NORMAL_QUANTILE**2
    square, middle = (1 - b) ** 2 - z2 * b, (1 - a) * (1 - b)
    return ((middle + math.sqrt(middle**2 - square * ((1 - a) ** 2 - z2 * a))) / square) ** 3


def _lower_chi_square(degrees: float) -> float:
    """2.5 % quantile of chi-square (Wilson and Hilferty 1931); for few degrees of freedom by its series."""
    if degrees >= _FEWEST_DEGREES:
        return degrees * (1 - 2 / (9 * degrees) - _NORMAL_QUANTILE * math.sqrt(2 / (9 * degrees))) ** 3
    # The share below 2 y is y^a e^-y times the sum of y^k / gamma(a + k + 1).
    a, y = degrees / 2, 0.0
    for _ in range(_TERMS):
        terms = sum(y**k * math.exp(-y) / math.gamma(a + k + 1) for k in range(_TERMS))
        y = (_TAIL / terms) ** (1 / a)
    return 2 * y
