"""How sure the values of a fit are: noise of the captures, and the error of the prediction itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Singular values of the Jacobian, its columns made of one length, below this share of the largest: the difference of
# two predictions tells no smaller one.
RANK: Final = 1e-6
# The same where renders are compared: rays of the two have some of their grain in common, not all of it.
GRAIN: Final = 1e-2
_NOTHING: Final = 1e-10  # of the longest column: rounding of two predictions, over their step
_TOUCHED: Final = 1e-3  # share of a key in a direction that is not determined
_UNSURE: Final = 3.0  # times the share of a singular value that is none: so unsure are directions
SURE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class PredictionErrors:
    """How far a prediction may be off, by others of its kind with other seeds.

    Attributes
    ----------
    replicates : ndarray, shape (replicates, pixels)
        Independent predictions of the used pixels, over sigma; at least two.
    predictions : int
        Of how many such the prediction is the mean.
    model : float
        Rms error over sigma that all of them have in common, at most.
    """

    replicates: Array
    predictions: int
    model: float

    @property
    def deviations(self) -> Array:
        """From their mean, shape (replicates, pixels)."""
        return np.asarray(self.replicates - self.replicates.mean(axis=0))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of what they tell of their variance."""
        return len(self.replicates) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """Noise that several captures have in common: what pixels of one specimen differ by.

    Attributes
    ----------
    deviations : ndarray, shape (causes, pixels)
        Of the used pixels of all captures, by each cause, over sigma.
    pixel : ndarray of int, shape (pixels,)
        Which pixel of the sensor each of them is.
    """

    deviations: Array
    pixel: NDArray[np.intp]

    def beyond_own(self, inverse: Array) -> Array:
        """What it adds to the covariance of J+ times the noise, whose pixels count as if each had its own.

        Parameters
        ----------
        inverse : ndarray, shape (keys, pixels)
            J+.
        """
        keys, count = len(inverse), int(self.pixel.max()) + 1
        found = np.zeros((keys, keys))
        for cause in self.deviations:
            moved = inverse * cause
            # One error a pixel, which each capture hands on: their sum counts, and each by itself has been counted.
            together = np.stack([np.bincount(self.pixel, row, count) for row in moved])
            found += together @ together.T - moved @ moved.T
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """What the captures determine, all in units of the keys' scales.

    Attributes
    ----------
    noise : ndarray, shape (keys, keys)
        Covariance by noise and rounding: (J^T J)^-1, and what captures have in common.
    prediction : ndarray, shape (keys, keys)
        Covariance by what the rays of the prediction may be off: the same error in all captures.
    freedom : int
        Independent predictions less one, that tell it.
    bound : ndarray, shape (keys,)
        By how much the model of the rays' method may move each value, at most.
    half_width : ndarray, shape (keys,)
        Of the 95 % interval; NaN where the captures do not determine a key.
    rank : int
        Determined directions.
    null : ndarray, shape (directions, keys)
        Those that are not determined.
    basis : ndarray, shape (pixels, rank)
        Orthonormal, of all changes of the prediction that the keys make, over sigma.
    """

    noise: Array
    prediction: Array
    freedom: int
    bound: Array
    half_width: Array
    rank: int
    null: Array
    basis: Array

    @property
    def covariance(self) -> Array:
        """Of noise and prediction."""
        return self.noise + self.prediction

    @property
    def correlation(self) -> Array:
        """Of the values; 0 where a value has no deviation."""
        covariance = self.covariance
        deviation = np.sqrt(np.diag(covariance))
        scale = np.where(deviation > 0, deviation, np.inf)
        return np.asarray(covariance / np.outer(scale, scale))


def lengths(jacobian: Array) -> Array:
    """Lengths of a Jacobian's columns; infinite for a key that changes nothing, whose column is rounding."""
    lengths = np.linalg.norm(jacobian, axis=0)
    return np.where(lengths > _NOTHING * float(lengths.max(initial=0.0)), lengths, np.inf)


def spread(jacobian: Array, errors: PredictionErrors, rank_share: float = RANK, shared: Shared | None = None) -> Spread:
    """Find it from a weighted Jacobian.

    Parameters
    ----------
    jacobian : ndarray, shape (pixels, keys)
        Change of the prediction with each key's scale, over sigma.
    errors : PredictionErrors
        Of the same pixels.
    rank_share : float
        Below this share of the largest a singular value is none: `RANK`, or `GRAIN` where keys need renders.
    shared : Shared, optional
        Noise that captures have in common.
    """
    from scipy.stats import norm, t

    scale = lengths(jacobian)
    left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    keys = jacobian.shape[1]
    good = singular > rank_share * float(singular.max(initial=0.0))
    rank = int(good.sum())
    inverse = (right[good].T / singular[good]) @ left[:, good].T / scale[:, np.newaxis]
    noise = inverse @ inverse.T
    if shared is not None:
        noise = noise + shared.beyond_own(inverse)
    moved, freedom = errors.deviations @ inverse.T, errors.freedom
    prediction = moved.T @ moved / freedom / errors.predictions
    bound = np.linalg.norm(inverse, axis=1) * errors.model * np.sqrt(len(jacobian))
    # In the keys' own scales: a change of columns made of one length is one of a value divided by it.
    undetermined = _complement(right[good], keys)
    null = undetermined / np.where(np.isfinite(scale), scale, 1.0)
    half = np.sqrt(
        (norm.ppf(0.5 + SURE / 2) ** 2) * np.diag(noise) + (t.ppf(0.5 + SURE / 2, freedom) ** 2) * np.diag(prediction)
    )
    touched = np.sqrt((undetermined**2).sum(axis=0)) > max(_TOUCHED, _UNSURE * rank_share)
    return Spread(noise, prediction, freedom, bound, np.where(touched, np.nan, half + bound), rank, null, left[:, good])


def _complement(determined: Array, keys: int) -> Array:
    """Orthonormal rows that stand on some orthonormal rows."""
    whole = np.linalg.svd(determined, full_matrices=True)[2] if len(determined) else np.eye(keys)
    return np.asarray(whole[len(determined) :])
