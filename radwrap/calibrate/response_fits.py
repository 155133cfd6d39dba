"""Fits of G = K H^gamma + G0 to frames between dark and saturation, and the variances that weigh them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
NoiseSource = Literal["given", "repeats", "residuals"]

FEWEST_REPEATS: Final = 5  # degrees of freedom for a variance: its own error is then 63 %
LEAST_VARIANCE: Final = 0.2  # of the mean one: no exposure gets all the weight by the chance of a few repeats
PLATEAU: Final = 4.0  # sigma within which two exposures have one level, in the first guess of saturation
GAMMA_LIMITS: Final = (0.01, 10.0)  # what a scene file takes
_HARMONICS: Final = 200  # of the saw-tooth of rounding; the rest is 0.3 % of 1/12
_VARIANCE_ROUNDS: Final = 8  # weights and variances settle to a few per cent, far below their own error


@dataclass(frozen=True, slots=True, eq=False)
class PowerFit:
    """One fit of Eq. 5.

    Attributes
    ----------
    gain : float
        K [gray exposure^-gamma].
    gamma : float
        Exponent.
    dark_gray : float
        G0.
    covariance : ndarray, shape (3, 3)
        Of (ln K, gamma, G0).
    frames : tuple of int
        Numbers of the frames that it used.
    chi_square : float
        Sum of squared residuals over their variances, over the exposures.
    degrees_of_freedom : int
        Exposures less parameters.
    """

    gain: float
    gamma: float
    dark_gray: float
    covariance: Array
    frames: tuple[int, ...]
    chi_square: float
    degrees_of_freedom: int

    @property
    def sigma(self) -> Mapping[str, float]:
        """Standard errors of K, gamma and dark_gray."""
        ln_gain, gamma, dark = np.sqrt(np.diag(self.covariance))
        return {"K": float(self.gain * ln_gain), "gamma": float(gamma), "dark_gray": float(dark)}

    def gray(self, radiant_exposure: Array) -> Array:
        """Gray level without saturation."""
        result: Array = self.gain * np.power(radiant_exposure, self.gamma) + self.dark_gray
        return result


def rounding_variance(noise_variance: Array, step: float) -> Array:
    """Variance of the error that rounding leaves in a mean of many repeats [gray^2].

    step^2/12 without noise, which repeats do not lessen; Gaussian noise of half
    a step or more dithers it away: sum over k of exp(-(2 pi k s/step)^2)/(2 pi^2 k^2).
    """
    if step == 0:
        return np.zeros_like(noise_variance)
    k = np.arange(1, _HARMONICS + 1)[:, np.newaxis]
    terms = np.exp(-((2 * np.pi * k) ** 2) * noise_variance / step**2) / (2 * np.pi**2 * k**2)
    whole = float(np.sum(1 / (2 * np.pi**2 * k**2)))
    result: Array = step**2 / 12 * terms.sum(axis=0) / whole
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Variance:
    """Variance of a frame's noise, offset + slope (G - dark), and where it comes from."""

    offset: float
    slope: float
    dark: float
    source: NoiseSource

    def of(self, gray: Array) -> Array:
        """Variance of one frame of that gray level [gray^2]."""
        return self.offset + self.slope * np.maximum(gray - self.dark, 0.0)


class Groups:
    """Frames of equal exposure together."""

    def __init__(self, exposure: Array, gray: Array, step: float) -> None:
        self.frame_exposure, self.frame_gray, self.step = exposure, gray, step
        self.exposure, self.of_frame, self.count = np.unique(exposure, return_inverse=True, return_counts=True)
        self.mean = np.bincount(self.of_frame, gray) / self.count
        squares = np.bincount(self.of_frame, (gray - self.mean[self.of_frame]) ** 2)
        self.freedom = self.count - 1
        self.squares = squares
        self.is_dark: Flags = self.exposure == 0

    def plateau(self) -> tuple[float, Flags]:
        """First guess of saturation: the level that the largest exposures share."""
        pooled = self.squares.sum() / max(1, int(self.freedom.sum()))
        variance = pooled / self.count + self.step**2 / 12
        first = len(self.mean) - 1
        while first > 0:
            level = float(np.average(self.mean[first:], weights=self.count[first:]))
            spread = math.sqrt(float(variance[first - 1]) + float(variance[first:].mean()) / (len(self.mean) - first))
            if abs(self.mean[first - 1] - level) > max(PLATEAU * spread, 1e-12 * abs(level)):
                break
            first -= 1
        if first > len(self.mean) - 2:
            raise no_plateau()
        flags = np.zeros(len(self.mean), dtype=np.bool_)
        flags[first:] = True
        return float(np.average(self.mean[first:], weights=self.count[first:])), flags

    def noise_model(self, noise: float | None, dark: float, unsaturated: Flags) -> Variance:
        """Variance of one frame: as given, or dark and shot noise fitted to the repeats."""
        if noise is not None:
            return Variance(noise**2, 0.0, dark, "given" if noise or self.step else "residuals")
        use = unsaturated & (self.freedom > 0)
        if self.freedom[use].sum() < FEWEST_REPEATS:
            return Variance(0.0, 0.0, dark, "residuals")
        from scipy.optimize import nnls

        sample = self.squares[use] / self.freedom[use]
        largest = max(float(sample.mean()), self.step**2 / 12)
        if largest == 0:
            return Variance(0.0, 0.0, dark, "residuals")
        design = np.column_stack([np.ones(use.sum()), np.maximum(self.mean[use] - dark, 0.0)])
        model = np.full_like(sample, largest)
        for _ in range(_VARIANCE_ROUNDS):
            # A sample variance scatters by itself times sqrt(2/degrees of freedom).
            weight = np.sqrt(self.freedom[use]) / model
            offset, slope = nnls(design * weight[:, np.newaxis], sample * weight)[0]
            model = np.maximum(design @ [offset, slope], LEAST_VARIANCE * largest)
        return Variance(max(float(offset), LEAST_VARIANCE * largest), float(slope), dark, "repeats")

    def mean_variance(self, variance: Variance, gray: Array) -> Array:
        """Variance of each exposure's mean gray level."""
        frame = variance.of(gray)
        # The sample variance of rounded repeats already holds 1/12 of the step squared, once there is noise.
        before = frame if variance.source == "given" else np.maximum(frame - self.step**2 / 12, 0.0)
        own = frame + (rounding_variance(np.zeros_like(frame), self.step) if variance.source == "given" else 0.0)
        result: Array = own / self.count + rounding_variance(before, self.step)
        return result

    def frames_of(self, groups: Flags) -> tuple[int, ...]:
        """Numbers of the frames in some groups."""
        return tuple(int(i) for i in np.flatnonzero(groups[self.of_frame]))


def no_plateau() -> InputError:
    """The error where nothing tells the saturation."""
    return InputError(
        "the frames show no plateau, so saturation is unknown", remedy="add two longer exposures or give `saturation`"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The exposures that one fit uses, shape (n,) flags, and the variance of every exposure's mean."""

    groups: Groups
    use: Flags
    spread: Array
    variance: Variance

    @property
    def weight(self) -> Array:
        """1/variance; equal where frames have none at all."""
        spread = self.spread[self.use]
        return 1 / spread if (spread > 0).all() else np.ones_like(spread)

    def scale(self, chi_square: float, freedom: int) -> float:
        """Factor on the variances: the residuals tell it where nothing else does, never less than rounding alone."""
        if self.variance.source != "residuals":
            return 1.0
        return max(1.0 if self.groups.step > 0 else 0.0, chi_square / freedom)


def _from_middle(covariance: Array, middle: float) -> Array:
    """Covariance of (ln K, gamma, G0) from that of (ln of the level at exposure exp(middle), gamma, G0)."""
    turn = np.array([[1.0, -middle, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    result: Array = turn @ covariance @ turn.T
    return result


def fit_logarithms(
    frames: Selection, predicted: Array, dark: float, dark_variance: float, gamma: float | None = None
) -> PowerFit:
    """Eq. 7 as a weighted straight line; the weights are 1/var(ln(G - G0)) = (G - G0)^2/var(G).

    Parameters
    ----------
    frames : Selection
        Exposures clear of dark and saturation.
    predicted : ndarray
        Gray level of every exposure, for the weights.
    dark, dark_variance : float
        G0 and its variance.
    gamma : float, optional
        Where it is known.
    """
    groups, lit = frames.groups, frames.use
    size = 2 if gamma is None else 1
    clear = groups.mean[lit] - dark
    weight = frames.weight * (predicted[lit] - dark) ** 2
    ln_exposure = np.log(groups.exposure[lit])
    middle = float(np.average(ln_exposure, weights=weight))
    known = 0.0 if gamma is None else gamma * (ln_exposure - middle)
    design = np.column_stack([np.ones(len(clear)), ln_exposure - middle])[:, :size]
    normal = np.linalg.inv(design.T @ (design * weight[:, np.newaxis]))
    pull = normal @ (design * weight[:, np.newaxis]).T
    solution = pull @ (np.log(clear) - known)
    residual = np.log(clear) - known - design @ solution
    chi_square, freedom = float(residual @ (weight * residual)), len(clear) - size
    # G0 is one number for all frames: its error moves them together.
    factor = frames.scale(chi_square, freedom)
    by_dark = np.zeros(3)
    by_dark[:size], by_dark[2] = pull @ (-1 / clear), 1.0
    small = factor * dark_variance * np.outer(by_dark, by_dark)
    small[:size, :size] += factor * normal
    slope = float(solution[1]) if gamma is None else gamma
    gain = math.exp(solution[0] - slope * middle)
    covariance = _from_middle(small, middle)
    return PowerFit(gain, slope, dark, covariance, groups.frames_of(lit), chi_square, freedom)


def fit_gray(
    frames: Selection, start_gamma: float, dark: float, *, free_dark: bool, free_gamma: bool = True
) -> PowerFit:
    """Weighted least squares of Eq. 5 in gray levels.

    Parameters
    ----------
    frames : Selection
        Unsaturated exposures.
    start_gamma : float
        Where gamma starts; the best K and G0 for it are a linear matter. Gamma itself where it is known.
    dark : float
        G0 where it is known.
    free_dark, free_gamma : bool
        Whether G0 and gamma are fitted.

    Raises
    ------
    InputError
        If the gray levels do not rise as a power of the exposure.
    """
    from scipy.optimize import least_squares

    groups, used = frames.groups, frames.use
    exposure, gray, weight = groups.exposure[used], groups.mean[used], np.sqrt(frames.weight)
    lit = exposure > 0
    # Against the middle exposure the unknowns hardly depend on each other, and are of the order of the gray levels.
    middle = float(np.log(exposure[lit]).mean())
    ln_exposure = np.log(exposure, where=lit, out=np.zeros_like(exposure)) - middle
    free = [0] + [1] * free_gamma + [2] * free_dark  # of level, gamma, G0
    found = np.array([0.0, min(max(start_gamma, GAMMA_LIMITS[0]), GAMMA_LIMITS[1]), dark])

    def power(gamma: float) -> Array:
        result: Array = np.where(lit, np.exp(np.minimum(gamma * ln_exposure, 300.0)), 0.0)
        return result

    def whole(unknown: Array) -> Array:
        values = found.copy()
        values[free] = unknown
        return values

    def slopes(unknown: Array) -> Array:
        level, gamma, _ = whole(unknown)
        shape = power(gamma)
        columns = np.column_stack([shape, level * shape * ln_exposure, np.ones(len(gray))])
        result: Array = columns[:, free] * weight[:, np.newaxis]
        return result

    def residual(unknown: Array) -> Array:
        level, gamma, offset = whole(unknown)
        result: Array = (level * power(gamma) + offset - gray) * weight
        return result

    # For the first gamma the best level and G0 are a linear matter: the only one where gamma is known.
    linear = [place for place, number in enumerate(free) if number != 1]
    first = found[free]
    first[linear] = 0.0
    first[linear] = np.linalg.lstsq(slopes(first)[:, linear], -residual(first), rcond=None)[0]
    if free_gamma:
        first = least_squares(residual, first, slopes, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    found = whole(first)
    level, gamma, offset = map(float, found)
    if not (level > 0 and GAMMA_LIMITS[0] <= gamma <= GAMMA_LIMITS[1]):
        raise InputError(
            f"the gray levels do not rise as a power of the exposure (gamma {gamma:.3g})",
            remedy="check that the columns are not swapped and the lamp was stable",
        )
    design = slopes(first)
    design[:, 0] *= level  # the level's logarithm in place of the level
    chi_square, freedom = float(np.sum(residual(first) ** 2)), len(gray) - len(free)
    small = np.zeros((3, 3))
    small[np.ix_(free, free)] = np.linalg.inv(design.T @ design) * frames.scale(chi_square, freedom)
    return PowerFit(
        gain=level * math.exp(-gamma * middle),
        gamma=gamma,
        dark_gray=offset,
        covariance=_from_middle(small, middle),
        frames=groups.frames_of(used),
        chi_square=chi_square,
        degrees_of_freedom=freedom,
    )
