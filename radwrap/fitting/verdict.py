"""Whether a scene explains its captures within noise and the error of the prediction, and where not.

Two sums of squares are judged, each at half the level: that of all pixels, which sees what is off here and there, and
that of the means of blocks, which sees what is off by little everywhere in a neighbourhood. The prediction's own error
is no noise of the captures: it is one unknown image. What its square is expected to be adds to the sum, and so does how
far that may be from what is expected: where a few pixels have most of it, by much.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.fitting.covariance import PredictionErrors

Array = NDArray[np.float64]
LEVEL: Final = 0.01
_BLOCKS: Final = 8  # along the longer side
_LEAST_SIDE: Final = 2  # px
_TOLD: Final = 5
_VANISHES: Final = 1e-3  # variance of a block mean that the fit has taken away but for this share


@dataclass(frozen=True, slots=True)
class Test:
    """A sum of squares and what it may be.

    Attributes
    ----------
    chi_square : float
        The sum.
    freedom : int
        Its degrees of freedom.
    prediction : float
        Its expected part by the error of the prediction.
    largest : float
        What an explained one exceeds with half of `LEVEL`; infinite without a degree of freedom.
    """

    chi_square: float
    freedom: int
    prediction: float
    largest: float

    @property
    def is_judged(self) -> bool:
        """Whether anything is left to judge by."""
        return self.freedom > 0

    @property
    def passed(self) -> bool:
        """Whether it was judged, and does not exceed that."""
        return self.is_judged and self.chi_square <= self.largest

    @property
    def by_noise(self) -> bool:
        """Whether noise explains it, without any error of the prediction."""
        return self.is_judged and self.chi_square <= _largest(self.freedom, _Error())


@dataclass(frozen=True, slots=True)
class Block:
    """A part of the image, and what is left there.

    Attributes
    ----------
    rows, columns : tuple of int
        First, and the one after the last.
    mean_gray : float
        Mean of captured - predicted [gray level].
    deviations : float
        That, in what the mean of the block may be off by noise and prediction.
    pixels : int
        That were used.
    capture : int or None
        Which of several captures it stands in, from 0 on.
    """

    rows: tuple[int, int]
    columns: tuple[int, int]
    mean_gray: float
    deviations: float
    pixels: int
    capture: int | None = None

    def told(self) -> str:
        """In words."""
        side = "brighter" if self.mean_gray > 0 else "darker"
        which = "" if self.capture is None else f"capture {self.capture}, "
        return (
            f"{which}rows {self.rows[0]} to {self.rows[1] - 1}, columns {self.columns[0]} to {self.columns[1] - 1}: "
            f"the capture is {abs(self.mean_gray):.3g} gray {side} ({abs(self.deviations):.3g} expected deviations)"
        )


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether captures are explained.

    Attributes
    ----------
    pixels, blocks : Test
        The two sums; blocks have none where they are fewer than what was fitted.
    worst : tuple of Block
        Where most is left, the worst first.
    """

    pixels: Test
    blocks: Test | None
    worst: tuple[Block, ...]

    @property
    def is_judged(self) -> bool:
        """Whether more pixels count than what was fitted: else any captures are met."""
        return self.pixels.is_judged

    @property
    def explained(self) -> bool:
        """Both tests passed; never where nothing can be judged."""
        return self.pixels.passed and (self.blocks is None or self.blocks.passed)


def verdict(
    residual: Array, sigma: Array, basis: Array, errors: PredictionErrors, *, of_capture: Sequence[int] = (0,)
) -> Verdict:
    """Judge what a fit leaves.

    Parameters
    ----------
    residual : ndarray, shape (captures * rows, columns)
        (captured - predicted)/sigma; NaN where a pixel was not used.
    sigma : ndarray, shape (captures * rows, columns)
        Expected deviation [gray level].
    basis : ndarray, shape (pixels, n)
        Orthonormal, of all changes of the used pixels that the fit took away, over sigma.
    errors : PredictionErrors
        Of the used pixels.
    of_capture : sequence of int
        For each of the images that stand one below the other, the capture that it is of, or whose pixels of one colour.
    """
    used = np.isfinite(residual)
    left = residual[used]
    off = errors.deviations
    off = (off - (off @ basis) @ basis.T) / np.sqrt(errors.predictions)
    common = float((errors.bound**2).sum())
    pixels = _test(float(left @ left), left.size - basis.shape[1], _Error.of(off, common))
    rows = len(used) // len(of_capture)
    places = list(_blocks(used, rows))
    sums = np.zeros((len(places), left.size))
    number = np.cumsum(used.ravel()).reshape(used.shape) - 1
    for row, place in enumerate(places):
        here = number[place][used[place]]
        sums[row, here] = 1 / np.sqrt(here.size)
    taken = sums @ basis
    covariance = np.eye(len(places)) - taken @ taken.T
    values, vectors = np.linalg.eigh(covariance)
    good = values > _VANISHES
    white = vectors[:, good].T / np.sqrt(values[good])[:, np.newaxis]
    means = sums @ left
    wrong = sums @ off.T
    blocks = None
    if good.any():
        statistic = white @ means
        blocks = _test(float(statistic @ statistic), int(good.sum()), _Error.of((white @ wrong).T, common))
    spread_of = np.sqrt(np.maximum(np.diag(covariance), _VANISHES) + (wrong**2).sum(axis=1) / errors.freedom)
    deviations = means / spread_of
    order = np.argsort(-np.abs(deviations), kind="stable")[:_TOLD]
    gray = residual * sigma
    worst = [_block(places[k], gray, used, float(deviations[k]), rows) for k in order]
    several = len(set(of_capture)) > 1
    named = [replace(one, capture=of_capture[one.capture or 0] if several else None) for one in worst]
    return Verdict(pixels, blocks, tuple(named))


@dataclass(frozen=True, slots=True)
class _Error:
    """What the square of the prediction's error is expected to be, and how far it may be from that.

    Attributes
    ----------
    square : float
        Expected; the trace of its covariance C.
    scatter : float
        The trace of C^2.
    freedom : float
        Degrees of freedom that tell them.
    """

    square: float = 0.0
    scatter: float = 0.0
    freedom: float = np.inf

    @classmethod
    def of(cls, deviations: Array, common: float) -> _Error:
        """Of so many replicates' deviations from their mean, over the root of their number, shape (replicates, n).

        Of S by f degrees of freedom tr S^2 is f (f + 1)/f^2 tr C^2 + (tr C)^2/f on average (M. S. Srivastava, 2005).
        """
        freedom = len(deviations) - 1
        seen = deviations @ deviations.T / freedom
        square, twice = float(np.trace(seen)), float((seen**2).sum())
        if freedom > 1:
            twice = max((twice - square**2 / freedom) * freedom**2 / ((freedom - 1) * (freedom + 2)), 0.0)
        return cls(square + common, twice, freedom)


def _test(value: float, freedom: int, error: _Error) -> Test:
    return Test(value, freedom, error.square, _largest(freedom, error))


def _largest(freedom: int, error: _Error) -> float:
    """What an explained sum exceeds with half of `LEVEL`.

    The sum is taken for a multiple of a chi-square of its mean and variance: noise adds 2 n to that, the error
    2 tr C^2, and both together 4 tr C. What it is held against is known by replicates: a ratio, as of Fisher's F.
    """
    from scipy.stats import chi2, f

    if freedom < 1:
        return float("inf")
    mean = freedom + error.square
    own = 2 * mean**2 / (2 * freedom + 4 * error.square + 2 * error.scatter)
    if not error.scatter or math.isinf(error.freedom):
        return float(mean / own * chi2(own).ppf(1 - LEVEL / 2))
    return float(mean * f(own, error.freedom * mean**2 / error.scatter).ppf(1 - LEVEL / 2))


def _blocks(used: NDArray[np.bool_], rows: int) -> Iterator[tuple[slice, slice]]:
    """Parts of each image with pixels that were used."""
    height, width = used.shape
    side = max(_LEAST_SIDE, -(-max(rows, width) // _BLOCKS))
    for top in range(0, height, rows):
        for row in range(top, top + rows, side):
            for column in range(0, width, side):
                place = slice(row, min(row + side, top + rows)), slice(column, min(column + side, width))
                if used[place].any():
                    yield place


def _block(place: tuple[slice, slice], gray: Array, used: NDArray[np.bool_], deviations: float, height: int) -> Block:
    """What is told of a block; rows count in its own image, of those of that height that stand below each other."""
    rows, columns = place
    here = used[place]
    image = rows.start // height
    top = image * height
    return Block(
        (rows.start - top, rows.stop - top),
        (columns.start, columns.stop),
        float(gray[place][here].mean()),
        deviations,
        int(here.sum()),
        image,
    )
