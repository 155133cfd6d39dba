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
# The same where captures pull by more than noise. Searches wander by two thirds of an exposure along what shows as 3e-3
# to 1e-2, and where the end stays there, right scenes are refused. What stands out of measured grain is known by that.
PULLED: Final = 1e-3
_NOTHING: Final = 1e-10  # of the longest column: rounding of two predictions, over their step
_TOUCHED: Final = 1e-3  # share of a key in a direction that is not determined
# Of what slopes show in a direction, by its square: where more is grain, nothing is known.
MOST_GRAIN: Final = 0.5
# Of a key's variance: what directions that are not determined may add to it, where it is determined all the same.
_NEGLIGIBLE: Final = 0.1
_UNSURE: Final = 3.0  # times the share of a singular value that is none: so unsure are directions
SURE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class PredictionErrors:
    """How far a prediction may be off, by independent ones whose mean it is.

    Attributes
    ----------
    replicates : ndarray, shape (replicates, pixels)
        Independent predictions of the used pixels, over sigma; at least two.
    common : ndarray, shape (pixels,), or float
        By how much all of them may be off alike, at most, over sigma.
    """

    replicates: Array
    common: Array | float = 0.0

    def over(self, weight: Array) -> PredictionErrors:
        """The same of pixels that count by some weights, shape (pixels,)."""
        return PredictionErrors(self.replicates * weight, self.common * weight)

    @property
    def deviations(self) -> Array:
        """From their mean, shape (replicates, pixels)."""
        return np.asarray(self.replicates - self.replicates.mean(axis=0))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of what they tell of their variance."""
        return len(self.replicates) - 1

    @property
    def predictions(self) -> int:
        """Of how many the prediction is the mean."""
        return len(self.replicates)

    @property
    def bound(self) -> Array:
        """What they have in common, shape (pixels,)."""
        return np.broadcast_to(np.asarray(self.common, dtype=np.float64), self.replicates.shape[1:])


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

    def over(self, weight: Array) -> Shared:
        """The same of pixels that count by some weights, shape (pixels,)."""
        return Shared(self.deviations * weight, self.pixel)

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
        By how much what all replicates have in common may move each value, at most.
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


def shown(jacobian: Array, rank_share: float = RANK) -> Array:
    """A Jacobian without what the last digits of predictions show: a solver takes that for a way, and goes it far."""
    scale = lengths(jacobian)
    left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    singular[singular <= rank_share * float(singular.max(initial=0.0))] = 0.0
    return np.asarray((left * singular) @ right * np.where(np.isfinite(scale), scale, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """How keys answer to what is left, in the directions that stand out of the grain of the slopes.

    Attributes
    ----------
    matrix : ndarray, shape (keys, pixels)
        What is left -> change of the keys, in their scales.
    square : ndarray, shape (keys, keys)
        Slopes times what is left -> the same.
    basis : ndarray, shape (pixels, rank)
        Orthonormal, of all changes of the prediction that the keys make, over sigma.
    undetermined : ndarray, shape (directions, keys)
        Orthonormal, in columns of one length.
    scale : ndarray, shape (keys,)
        Lengths of the columns.
    """

    matrix: Array
    square: Array
    basis: Array
    undetermined: Array
    scale: Array


def inverse_of(jacobian: Array, rank_share: float = RANK, grain: Array | None = None) -> Inverse:
    """Invert slopes that have a grain.

    Slopes J + D, whose grain D is by chance, look steeper than they are: (J + D)^T (J + D) is J^T J + D^T D on average.
    What the grain adds is taken away again, so that a step is neither too small nor too sure (W. A. Fuller,
    Measurement Error Models, 1987, Eq. 2.2.12), and a direction in which the grain is most of what shows is none.

    Parameters
    ----------
    jacobian : ndarray, shape (pixels, keys)
        Change of the prediction with each key's scale, over sigma.
    rank_share : float
        Below this share of the largest a singular value is none.
    grain : ndarray, shape (keys, keys), optional
        Expected D^T D.
    """
    scale = lengths(jacobian)
    left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    good = singular > rank_share * float(singular.max(initial=0.0))
    left, right, singular = left[:, good], right[good], singular[good]
    undetermined = _complement(right, jacobian.shape[1])
    # Moved along one of these columns, the prediction changes by one expected deviation.
    ways, gain = right.T / singular, np.ones(len(singular))
    if grain is not None and len(singular):
        share = ways.T @ (grain / np.outer(scale, scale)) @ ways
        values, vectors = np.linalg.eigh(share)
        seen = values < MOST_GRAIN
        lost = np.linalg.qr(ways @ vectors[:, ~seen])[0].T
        undetermined = np.concatenate([undetermined, lost])
        ways, left, gain = ways @ vectors[:, seen], left @ vectors[:, seen], 1 / (1 - values[seen])
    ways = ways / scale[:, np.newaxis]
    return Inverse((ways * gain) @ left.T, (ways * gain) @ ways.T, left, undetermined, scale)


def spread(
    jacobian: Array,
    errors: PredictionErrors,
    rank_share: float = RANK,
    shared: Shared | None = None,
    grain: Array | None = None,
    *,
    variance: Array | None = None,
    left: Array | float = 0.0,
) -> Spread:
    """Find it from a weighted Jacobian.

    Parameters
    ----------
    jacobian : ndarray, shape (pixels, keys)
        Change of the prediction with each key's scale, over sigma.
    errors : PredictionErrors
        Of the same pixels.
    rank_share, grain
        As of `inverse_of`: `RANK`, or `GRAIN` where keys need renders.
    shared : Shared, optional
        Noise that captures have in common.
    variance : ndarray, shape (pixels,), optional
        Of what is left by noise, over sigma; default 1.
    left : ndarray, shape (pixels,), optional
        Of the captures, over sigma: it says how far off the values are at least along what is not determined.
    """
    from scipy.stats import norm, t

    found = inverse_of(jacobian, rank_share, grain)
    inverse, scale = found.matrix, found.scale
    noise = (inverse if variance is None else inverse * variance) @ inverse.T
    if shared is not None:
        noise = noise + shared.beyond_own(inverse)
    moved, freedom = errors.deviations @ inverse.T, errors.freedom
    prediction = moved.T @ moved / freedom / errors.predictions
    bound = np.abs(inverse) @ errors.bound
    # In the keys' own scales: a change of columns made of one length is one of a value divided by it.
    null = found.undetermined / np.where(np.isfinite(scale), scale, 1.0)
    half = np.sqrt(
        (norm.ppf(0.5 + SURE / 2) ** 2) * np.diag(noise) + (t.ppf(0.5 + SURE / 2, freedom) ** 2) * np.diag(prediction)
    )
    touched = np.sqrt((found.undetermined**2).sum(axis=0)) > max(_TOUCHED, _UNSURE * rank_share)
    leaning = _leaning(jacobian / scale, found.undetermined, rank_share, left) * scale**-2.0
    touched |= leaning > _NEGLIGIBLE * np.diag(noise + prediction)
    half = np.where(touched, np.nan, half + bound)
    return Spread(noise, prediction, freedom, bound, half, found.basis.shape[1], null, found.basis)


def _leaning(jacobian: Array, undetermined: Array, rank_share: float, left: Array | float) -> Array:
    """Variance that keys have by directions that are not determined, at least, shape (keys,).

    A key with a small share of a direction still goes along with it, as far as nobody knows. The steepness that shows
    there is grain, more than half of it: the square of the true one is at most half of that. No fit goes along it, so
    where the captures pull by several deviations, the values are off by as many.
    """
    floor = rank_share * float(np.linalg.norm(jacobian, 2)) if jacobian.size else 0.0
    images = jacobian @ undetermined.T
    seen = np.linalg.norm(images, axis=0)
    shown = np.maximum(seen, floor)
    shown[shown == 0] = np.inf  # where nothing shows at all, each key lies in such a direction anyway
    pulled = (images * np.reshape(left, (-1, 1))).sum(axis=0) / np.where(seen > 0, seen, np.inf)
    off = np.maximum(np.abs(pulled), 1.0) / shown
    return np.asarray(((undetermined * off[:, np.newaxis]) ** 2).sum(axis=0) / (1 - MOST_GRAIN))


def _complement(determined: Array, keys: int) -> Array:
    """Orthonormal rows that stand on some orthonormal rows."""
    whole = np.linalg.svd(determined, full_matrices=True)[2] if len(determined) else np.eye(keys)
    return np.asarray(whole[len(determined) :])
