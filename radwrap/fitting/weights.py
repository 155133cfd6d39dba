"""How much each pixel counts: noise, rounding, and what saturated and dark pixels still say.

A pixel whose prediction lies within `NEAR` standard deviations of where the sensor cuts says only "at least" or "at
most": it is left out, unless the capture lies `FAR` standard deviations off. Which pixels these are is decided by the
prediction and not by the capture, since pixels that are chosen by their noise would pull the fit. Where the capture is
cut and the prediction is not, the difference to the cut is what the prediction is off by at least.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.captured import Captured
from radwrap.imaging.response.noise import ROUNDING_VARIANCE, linear_of, noise_variance, without_pattern
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
NEAR: Final = 3.0
FAR: Final = 6.0
# Gray levels: of less noise than this a level that is rounded says nothing of most of what lies between two levels, and
# steps by what it says would no longer come to an end.
_LEAST_DITHER: Final = 0.2
_HARMONICS: Final = 3  # of a rounding error: by that much noise the next one is below 1e-7 of a level


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """What a fit knows of each pixel.

    Attributes
    ----------
    sigma : ndarray, shape (rows, columns)
        Expected deviation of the mean of the captures from the prediction [gray level].
    used : ndarray of bool
        Pixels with a residual.
    censored : ndarray of bool
        Of the pixels that count those that only say "at least" or "at most", and agree.
    rounded : ndarray
        What rounding is expected to add to the prediction [gray level].
    """

    sigma: Array
    used: Flags
    censored: Flags
    rounded: Array


def check_noise(sensor: Sensor, noise: float | None, repeats: int) -> None:
    """Refuse a fit that cannot know the noise of its captures."""
    if sensor.linear is None and noise is None and repeats == 1:
        raise InputError(
            "the power law has no noise, and without it no residual can be judged",
            where="noise",
            remedy="give the standard deviation of one capture, several captures, or a linear sensor",
        )


def rounding_error(gray: Array, deviation: Array) -> Array:
    """Mean error of whole gray levels, where noise scatters them: E[round(x + n)] - x for normal n.

    Sum over k of (-1)^k sin(2 pi k x) exp(-2 pi^2 k^2 sigma^2)/(pi k) (B. Widrow, I. Kollar, Quantization Noise, 2008).
    Pixels of one level have it in common: what is far from white in a background is not gone by counting many.
    """
    spread = np.maximum(deviation, _LEAST_DITHER)
    found = np.zeros(np.broadcast(gray, spread).shape)
    for k in range(1, _HARMONICS + 1):
        found += (-1) ** k * np.sin(2 * np.pi * k * gray) * np.exp(-2 * (np.pi * k * spread) ** 2) / (np.pi * k)
    return found


def _of_one(exposure: Array, captured: Captured, sensor: Sensor, noise: float | None) -> Array:
    """Variance of one capture before it is rounded, by a specimen that is not known [gray level^2]."""
    if noise is not None:
        return np.full(exposure.shape, noise**2)
    known = captured.variance if sensor.linear is None else noise_variance(exposure, sensor)
    return np.maximum((0.0 if known is None else known) - ROUNDING_VARIANCE, 0.0)


def variance_of(exposure: Array, captured: Captured, sensor: Sensor, noise: float | None) -> Array:
    """Variance of the captures' mean about the prediction [gray level^2]."""
    rounding = ROUNDING_VARIANCE if sensor.rounding else 0.0
    if noise is not None:
        return np.full(exposure.shape, (noise**2 + rounding) / captured.repeats)
    if sensor.linear is not None:
        whole = noise_variance(exposure, sensor)
        frame = noise_variance(exposure, without_pattern(sensor))
        # The specimen's pattern is the same in all repeats.
        return np.asarray(frame / captured.repeats + np.maximum(whole - frame, 0.0))
    if captured.variance is None:
        raise InputError("is not known", where="noise")
    return np.maximum(captured.variance, rounding) / captured.repeats


def patterns(exposure: Array, sensor: Sensor) -> Array:
    """What pixels of one specimen differ by, the same in each of its captures.

    Returns
    -------
    ndarray, shape (2, rows, columns)
        Standard deviations by DSNU and by PRNU [gray level].
    """
    linear = linear_of(sensor)
    exposure = np.minimum(exposure, _below(exposure, sensor))
    whole = noise_variance(exposure, sensor)
    without = [
        noise_variance(exposure, replace(sensor, linear=alike))
        for alike in (replace(linear, dsnu=0.0), replace(linear, prnu=0.0))
    ]
    return np.asarray(np.sqrt(np.maximum(whole - np.stack(without), 0.0)))


def weighed(exposure: Array, unclipped: Array, captured: Captured, sensor: Sensor, noise: float | None) -> Weighed:
    """Decide for a prediction how much each pixel counts.

    Parameters
    ----------
    exposure : ndarray, shape (rows, columns)
        Predicted radiant exposure [J m^-2].
    unclipped : ndarray, shape (rows, columns)
        Its gray level without saturation.
    captured : Captured
        The captures.
    sensor : Sensor
        At the prediction's values.
    noise : float or None
        Standard deviation of one capture, where it is told [gray level].

    Raises
    ------
    InputError
        If nothing is known of the noise, or it is 0.
    """
    uncut = np.minimum(exposure, _below(exposure, sensor))
    variance = variance_of(uncut, captured, sensor, noise)
    if not (variance > 0).all():
        raise InputError("is 0: no residual can be judged", where="noise", remedy="give the noise of one capture")
    sigma = np.sqrt(variance)
    high, low = sensor.saturation_gray, floor_gray(sensor)
    at_top, at_bottom = unclipped > high - NEAR * sigma, unclipped < low + NEAR * sigma
    agrees = (at_top & (captured.mean > high - FAR * sigma)) | (at_bottom & (captured.mean < low + FAR * sigma))
    rounded = np.zeros(exposure.shape)
    if sensor.rounding:
        rounded = rounding_error(unclipped, np.sqrt(_of_one(uncut, captured, sensor, noise)))
    return Weighed(sigma, captured.mask & ~agrees, captured.mask & agrees, rounded)


def _below(exposure: Array, sensor: Sensor) -> float:
    """Exposure above which noise is cut: beyond it the noise of the brightest uncut pixel counts."""
    share = 1 - 1e-2
    span = share * (sensor.saturation_gray - sensor.dark_gray)
    return float((span / sensor.gain) ** (1 / sensor.gamma)) if span > 0 else float(exposure.max())


def floor_gray(sensor: Sensor) -> float:
    """Gray level below which the camera gives none."""
    return sensor.dark_gray if sensor.linear is not None and sensor.gamma != 1.0 else 0.0
