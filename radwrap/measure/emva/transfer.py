"""Photon transfer: what the mean and the variance of frames say of gain, noise, saturation and linearity.

::

    sigma_y^2 - sigma_y.dark^2 = K (mu_y - mu_y.dark)      its slope is the gain, whatever the light
    sigma_d^2 = (sigma_y.dark^2 - 1/12)/K^2                read noise
    SNR = (mu_y - mu_y.dark)/sigma_y,  SNRmax = sqrt(mu_e.sat)

Source: key emva1288 (release 4.0 linear, chapters 2 to 8). Fits go up to 70 % of
saturation, which is where the variance is largest; linearity is judged from 5 to
95 %. Before PRNU a plane and bowl is taken from the light; the standard's filters
against uneven light are others. Whole gray levels change the variance of a quiet
camera's dark frames, through which the standard's line goes: where that bends it,
the gain is the slope of a line with an intercept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.measure.emva.frames import Stack

Array = NDArray[np.float64]

ROUNDING_VARIANCE: Final = 1 / 12  # of whole gray levels
_FIT_SHARE: Final = 0.7  # of the way from dark to saturation, for gain and responsivity
_LINEARITY: Final = (0.05, 0.95)  # likewise, for linearity
_FEWEST: Final = 3  # exposures in a fit
_LEAST_DARK_VARIANCE: Final = 0.24  # below it rounding hides the noise (the standard's rule) [gray level^2]
_OUTLIER: Final = 6.0  # robust standard deviations from which on a pixel is called a defect
# Variance of n values of a normal distribution is known to sqrt(2/n) of itself; a fall by so many of these is none of
# chance: a false alarm in 30 000.
_SURE: Final = 4.0
# At a noise of 0.6 gray levels rounding changes a variance by 0.1 % of a squared level, less above [gray level].
_QUIET: Final = 0.6
_BENT: Final = 0.002  # share of the gain from which on a bend by rounding counts, where it is more than chance
_BENT_SIGMAS: Final = 3.0
_PULLED: Final = 0.01  # share of the DSNU from which on a pull by rounding is told
_PLATEAU: Final = 0.01  # of the saturation signal: exposures whose levels differ by less lie on one plateau
_PLATEAU_STEP: Final = 0.01  # share by which their exposures differ at least
_TO_SIGMA: Final = 1.4826  # from the median of absolute deviations of a normal distribution


@dataclass(frozen=True, slots=True)
class Step:
    """One exposure.

    Attributes
    ----------
    exposure : float
        As the table has it.
    gray, dark_gray : float
        Mean gray level with light and without.
    variance, dark_variance : float
        Temporal variances [gray level^2].
    """

    exposure: float
    gray: float
    dark_gray: float
    variance: float
    dark_variance: float

    @property
    def signal(self) -> float:
        """Gray levels above dark."""
        return self.gray - self.dark_gray

    @property
    def snr(self) -> float:
        """Signal over its noise."""
        return self.signal / math.sqrt(self.variance) if self.variance > 0 else 0.0


@dataclass(frozen=True, slots=True)
class PhotonTransfer:
    """A camera's figures; standard errors where they are known, None where the frames cannot tell.

    Attributes
    ----------
    steps : tuple of Step
        Exposures with light, rising.
    gain, gain_sigma : float
        K [DN/e].
    quantum_efficiency : float or None
        eta, where photons are known.
    responsivity : float
        Gray levels for each unit of exposure.
    read_noise : float
        sigma_d [e]; an upper limit where `notes` say so.
    dark_gray : float
        At the shortest exposure, or at none where dark frames of three exposure times tell.
    dark_current : float or None
        [e/s], where dark frames of three exposure times tell.
    saturation_gray, saturation_electrons : float
        Where the variance is largest, the standard's saturation; electrons above dark. Lower limits where saturation
        is not reached. Less than the full well by up to a step of the exposures and what the pixels differ by.
    full_well : float or None
        Electrons of the plateau that the longest exposures reach, dark signal included; of the converter's end where
        that comes first. None where there is no plateau.
    saturated : bool
        Whether the variance falls again beyond its peak, by more than chance.
    dsnu : float or None
        [e], of the pixels that are not called defect.
    prnu : float or None
        A share, likewise.
    dsnu_all_pixels, prnu_all_pixels : float or None
        The standard's: defect pixels count; None where they hide the others.
    defects : int
        Pixels six robust standard deviations or more from the others, in the dark or half-way to saturation.
    snr_max : float
    dynamic_range : float
        mu_p.sat/mu_p.min, of which the quantum efficiency cancels.
    threshold : float
        mu_e.min, electrons at which SNR is 1.
    linearity_error, linearity_error_max : float or None
        Mean and largest |deviation| from the line of least relative error, as a share.
    notes : tuple of str
        What to know before relying on the numbers.
    """

    steps: tuple[Step, ...]
    gain: float
    gain_sigma: float
    quantum_efficiency: float | None
    responsivity: float
    read_noise: float
    dark_gray: float
    dark_current: float | None
    saturation_gray: float
    saturation_electrons: float
    full_well: float | None
    saturated: bool
    dsnu: float | None
    prnu: float | None
    dsnu_all_pixels: float | None
    prnu_all_pixels: float | None
    defects: int
    snr_max: float
    dynamic_range: float
    threshold: float
    linearity_error: float | None
    linearity_error_max: float | None
    notes: tuple[str, ...]


def photon_transfer(kind: str, stacks: Sequence[Stack], photons_of_exposure: float | None = None) -> PhotonTransfer:
    """Evaluate frames.

    Parameters
    ----------
    kind : str
        "exposure_time", "radiant_exposure" or "photons".
    stacks : sequence of Stack
        Of light and dark.
    photons_of_exposure : float, optional
        Photons a pixel for each unit of exposure, where known.

    Raises
    ------
    InputError
        If there are too few exposures, none dark, or the signal does not rise with its noise.
    """
    dark = sorted((stack for stack in stacks if stack.dark), key=lambda stack: stack.exposure)
    light = sorted((stack for stack in stacks if not stack.dark), key=lambda stack: stack.exposure)
    if not dark:
        raise InputError("no dark frames", remedy="add frames without light: dark = 1, or exposure 0")
    if len(light) < _FEWEST:
        raise InputError(f"{len(light)} exposures with light, at least {_FEWEST} are needed")
    notes: list[str] = []
    steps = tuple(_step(stack, dark) for stack in light)
    full, saturated = _saturation(steps, light)
    if not saturated:
        notes.append("saturation is not reached: full well, SNR and dynamic range are lower limits")
    used = [step for step in steps if step.signal <= _FIT_SHARE * full.signal]
    if len(used) < _FEWEST:
        raise InputError(
            f"{len(used)} exposures lie below 70 % of saturation (gray {full.gray:.4g}), at least {_FEWEST} are needed",
            remedy="add shorter exposures",
        )
    signal = np.array([step.signal for step in used])
    rise = np.array([step.variance - step.dark_variance for step in used])
    gain, sigma = _slope(signal, rise)
    responsivity, _ = _slope(np.array([step.exposure for step in used]), signal)
    if not (gain > 0 and responsivity > 0):
        raise InputError("the variance does not rise with the signal", remedy="give raw frames of rising exposure")
    gain, sigma = _unbent((gain, sigma), signal, rise, used[0].dark_variance, notes)
    dark_gray, dark_variance, rate = _dark(dark if kind == "exposure_time" else dark[:1])
    read_noise = _read_noise(dark_variance, gain, notes)
    if dark_gray < 3 * math.sqrt(max(dark_variance, ROUNDING_VARIANCE)):
        notes.append("the dark level lies within three sigma of 0: what is cut there makes the read noise too small")
    electrons = full.signal / gain
    threshold = math.sqrt(max(read_noise**2 + ROUNDING_VARIANCE / gain**2, 0.0) + 0.25) + 0.5
    pull = _pull(dark_variance)
    if pull > _PULLED:
        notes.append(
            f"whole gray levels pull the means of quiet pixels together or apart: DSNU may be off by up to {pull:.1%}"
        )
    result = PhotonTransfer(
        steps=steps,
        gain=gain,
        gain_sigma=sigma,
        quantum_efficiency=None if photons_of_exposure is None else responsivity / gain / photons_of_exposure,
        responsivity=responsivity,
        read_noise=read_noise,
        dark_gray=dark_gray,
        dark_current=None if rate is None else rate / gain,
        saturation_gray=full.gray,
        saturation_electrons=electrons,
        full_well=_plateau(light, full.signal, dark_gray, gain) if saturated else None,
        saturated=saturated,
        dsnu=None,
        prnu=None,
        dsnu_all_pixels=None,
        prnu_all_pixels=None,
        defects=0,
        snr_max=math.sqrt(electrons),
        dynamic_range=electrons / threshold,
        threshold=threshold,
        **_linearity(steps, full, notes),
        notes=tuple(notes),
    )
    half = min(light, key=lambda stack: abs(stack.level - (full.gray + full.dark_gray) / 2))
    return _with_pattern(result, _nearest(dark, half.exposure), half)


def _saturation(steps: Sequence[Step], light: Sequence[Stack]) -> tuple[Step, bool]:
    """The step of largest variance, and whether the last one's is surely less; else the last step, a lower limit."""
    peak = int(np.argmax([step.variance for step in steps]))
    errors = [math.sqrt(2 / (stack.mean.size * (stack.frames - 1))) for stack in light]
    fall = steps[peak].variance - steps[-1].variance
    chance = math.hypot(steps[peak].variance * errors[peak], steps[-1].variance * errors[-1])
    return (steps[peak], True) if fall > _SURE * chance else (steps[-1], False)


def _plateau(light: Sequence[Stack], signal: float, dark_gray: float, gain: float) -> float | None:
    """Electrons at the level that does not rise any more with the exposure; defect pixels have no part in it."""
    before, last = light[-2:]
    if last.exposure < before.exposure * (1 + _PLATEAU_STEP) or last.level - before.level > _PLATEAU * signal:
        return None
    return float(last.mean[~_outliers(last.mean)].mean() - dark_gray) / gain


def _unbent(
    line: tuple[float, float], signal: Array, rise: Array, dark_variance: float, notes: list[str]
) -> tuple[float, float]:
    """The gain, free of what rounding does to the dark frames' variance: that shifts all of `rise` alike."""
    gain, sigma = line
    if dark_variance >= _QUIET**2 + ROUNDING_VARIANCE or gain <= 0:
        return gain, sigma
    away = signal - signal.mean()
    free, free_sigma = _slope(away, rise - rise.mean(), hold=1 / len(signal))
    if free <= 0 or abs(gain - free) <= max(_BENT * free, _BENT_SIGMAS * free_sigma):
        return gain, sigma
    notes.append(
        f"rounding changes the variance of dark frames as quiet as these: the gain is the slope of a line with an "
        f"intercept; the standard's, through the origin, gives {gain:.5g} ({gain / free - 1:+.2%})"
    )
    return free, free_sigma


def _nearest(dark: Sequence[Stack], exposure: float) -> Stack:
    return min(dark, key=lambda stack: abs(stack.exposure - exposure))


def _step(stack: Stack, dark: Sequence[Stack]) -> Step:
    beside = _nearest(dark, stack.exposure)
    return Step(stack.exposure, stack.level, beside.level, stack.temporal_variance, beside.temporal_variance)


def _slope(x: Array, y: Array, hold: float = 0.0) -> tuple[float, float]:
    """Slope of the line through the origin, and its standard error: what leaving out each point in turn changes.

    A variance is known to a share of itself, so that bright points scatter most, and these hold the slope. By residuals
    that are taken as equally large the error is too small, by 1.34 where exposures are even.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Points.
    hold : float
        By which share each point has drawn their common mean to itself before, where that was taken away.
    """
    square = float(x @ x)
    if square == 0:
        return 0.0, math.inf
    slope = float(x @ y) / square
    free = 1 - x * x / square - hold
    if (free <= 0).any():
        return slope, math.inf
    return slope, float(np.linalg.norm(x * (y - slope * x) / free)) / square


def _dark(dark: Sequence[Stack]) -> tuple[float, float, float | None]:
    """Gray level and variance without exposure, and gray levels a second; of the shortest one where times are few."""
    times = np.array([stack.exposure for stack in dark])
    levels = np.array([stack.level for stack in dark])
    variances = np.array([stack.temporal_variance for stack in dark])
    if len(dark) < _FEWEST:
        return float(levels[0]), float(variances[0]), None
    rate, level = np.polyfit(times, levels, 1)
    _, variance = np.polyfit(times, variances, 1)
    return float(level), float(variance), float(rate)


def _read_noise(dark_variance: float, gain: float, notes: list[str]) -> float:
    if dark_variance < _LEAST_DARK_VARIANCE:
        notes.append("rounding hides the read noise: it is at most the value given")
        return math.sqrt(_LEAST_DARK_VARIANCE - ROUNDING_VARIANCE) / gain
    return math.sqrt(dark_variance - ROUNDING_VARIANCE) / gain


def _pull(dark_variance: float) -> float:
    """Largest change by rounding of the slope of a pixel's mean: |d/dx E round(x + noise) - 1|, as a share.

    E round(x + noise) = x + sum over k of (-1)^k/(pi k) sin(2 pi k x) exp(-2 pi^2 k^2 sigma^2); its first term. Below
    half a gray level the noise itself is not known well, and all may be hidden: at most 100 %.
    """
    return min(1.0, 2 * math.exp(-2 * math.pi**2 * max(dark_variance - ROUNDING_VARIANCE, 0.0)))


def _linearity(steps: Sequence[Step], full: Step, notes: list[str]) -> dict[str, float | None]:
    """Deviation from the line of least relative error."""
    low, high = _LINEARITY
    inside = [step for step in steps if low * full.signal <= step.signal <= high * full.signal]
    if len(inside) < _FEWEST:
        notes.append("too few exposures from 5 to 95 % of saturation for a linearity error")
        return {"linearity_error": None, "linearity_error_max": None}
    exposure, signal = (np.array([getattr(step, key) for step in inside]) for key in ("exposure", "signal"))
    design = np.stack([np.ones_like(exposure), exposure], axis=1) / signal[:, np.newaxis]
    offset, slope = np.linalg.lstsq(design, np.ones_like(signal), rcond=None)[0]
    deviation = np.abs(signal / (offset + slope * exposure) - 1)
    return {"linearity_error": float(deviation.mean()), "linearity_error_max": float(deviation.max())}


def _with_pattern(result: PhotonTransfer, dark: Stack, half: Stack) -> PhotonTransfer:
    """With DSNU, PRNU and defects; none where the picture has too few pixels."""
    if dark.mean.size < 100:
        return replace(result, notes=(*result.notes, "too few pixels for DSNU and PRNU"))
    flat = replace(half, mean=_levelled(half.mean))
    good = ~(_outliers(dark.mean) | _outliers(flat.mean))
    signal = half.level - dark.level
    found: list[float | None] = []
    for used in (good, None):
        variance, lit = dark.spatial_variance(used), flat.spatial_variance(used)
        found += [_root(variance, result.gain), _root(lit - variance, signal)]
    return replace(
        result,
        dsnu=found[0],
        prnu=found[1],
        dsnu_all_pixels=found[2],
        prnu_all_pixels=found[3],
        defects=int((~good).sum()),
    )


def _root(variance: float, unit: float) -> float | None:
    """Standard deviation in some unit; None where the variance came out below zero."""
    return math.sqrt(variance) / unit if variance >= 0 else None


def _levelled(image: Array) -> Array:
    """The image without the plane and bowl that fit it best: uneven light is no pattern of the pixels."""
    rows, columns = (np.linspace(-1, 1, size) if size > 1 else np.zeros(1) for size in image.shape)
    y, x = np.meshgrid(rows, columns, indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    # Defects must not tilt it: the second fit goes without them.
    flat = image.ravel()
    kept = np.ones(flat.size, dtype=bool)
    for _ in range(2):
        fit = np.linalg.lstsq(terms[kept], flat[kept], rcond=None)[0]
        rest = flat - terms @ fit
        kept = ~_outliers(rest)
    levelled: Array = (rest + flat.mean()).reshape(image.shape)
    return levelled


def _outliers(values: Array) -> NDArray[np.bool_]:
    off = np.abs(values - np.median(values))
    # Whole gray levels of a quiet camera may have a spread of nothing.
    spread = max(_TO_SIGMA * float(np.median(off)), math.sqrt(ROUNDING_VARIANCE))
    found: NDArray[np.bool_] = off > _OUTLIER * spread
    return found
