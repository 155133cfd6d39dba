"""A ring's radiant intensities from captures: the twin, held against a camera, calibrates itself.

With LED i alone on, Eq. 5 gives G - G0 = K (f_i H_i)^gamma, where H_i is what
the scene predicts for it and f_i = I_i/I_nominal. That is linear in
a_i = f_i^gamma, so that least squares over the pixels gives a_i without bias
by rounding, and Eq. 5 inverted f_i = a_i^(1/gamma).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.camera import Sensor

# Of the dark frame's mean against the sensor's dark level [gray level]: half a step is what rounding can hide.
_SAME_DARK: Final = 0.6
# Pixels that come this near saturation may be clipped [gray level].
_BELOW_SATURATION: Final = 1.5
# Below, rounding is no noise: a signal of 0.4 is always 0 [gray level].
_ABOVE_DARK: Final = 1.0
# Of what is left to what was captured, rms; more is another scene, another LED or another place.
_LARGEST_RESIDUAL: Final = 0.25
# A frame without a pixel this much above dark is no capture of an LED that is on [gray level].
_LEAST_SIGNAL: Final = 5.0
_ROUNDS: Final = 4
_HARMONICS: Final = 8  # of the rounding error; the rest, 1/k^2 each, is below 8 % of the variance
_NEIGHBOURS: Final = np.linspace(0.95, 1.05, 11)
_BLOCK: Final = 8  # px over which errors of a prediction hang together


@dataclass(frozen=True, slots=True)
class Factor:
    """One LED's radiant intensity over the scene's.

    Attributes
    ----------
    value : float
        f = I/I_nominal.
    standard_error : float
        Of f, from rounding, noise and what the prediction lacks.
    pixels : int
        Pixels that told.
    residual_rms : float
        What the fit leaves [gray level].
    """

    value: float
    standard_error: float
    pixels: int
    residual_rms: float


def check_dark(dark: NDArray[np.float64], sensor: Sensor) -> None:
    """The dark frame must be the sensor's dark level.

    Raises
    ------
    InputError
        If it is not: light came from elsewhere, or the sensor's dark level is wrong.
    """
    mean = float(dark.mean())
    if abs(mean - sensor.dark_gray) > _SAME_DARK:
        raise InputError(
            f"its mean is {mean:.2f} gray levels, the sensor's dark level {sensor.dark_gray:g}",
            where="dark frame",
            remedy="shut out other light, or calibrate the sensor",
        )


def factor(captured: NDArray[np.float64], predicted_exposure: NDArray[np.float64], sensor: Sensor) -> Factor:
    """Factor on one LED's radiant intensity.

    Parameters
    ----------
    captured : ndarray, shape (rows, columns)
        Gray levels with that LED alone on.
    predicted_exposure : ndarray, shape (rows, columns)
        H of the scene with that LED alone on, at its radiant intensity in the scene [J m^-2].
    sensor : Sensor
        Response.

    Raises
    ------
    InputError
        If the shapes differ, or no pixel tells.
    """
    if captured.shape != predicted_exposure.shape:
        raise InputError(f"has the shape {captured.shape}, the prediction {predicted_exposure.shape}")
    shape = sensor.gain * np.power(predicted_exposure, sensor.gamma)
    signal = captured - sensor.dark_gray
    if signal.max() < _LEAST_SIGNAL or shape.max() <= 0:
        raise InputError("is dark", remedy="raise the level or the exposure time")
    # Pixels are left out by what is predicted, not by what was captured: else the errors would choose.
    scale = float(np.sum(shape * signal) / np.sum(shape**2))
    used = shape > 0
    for _ in range(_ROUNDS):
        expected = scale * shape
        used = (expected > _ABOVE_DARK) & (expected < sensor.saturation_gray - sensor.dark_gray - _BELOW_SATURATION)
        if not used.any():
            raise InputError("has no pixel between dark and saturation", remedy="change the level or the exposure time")
        scale = float(np.sum(shape[used] * signal[used]) / np.sum(shape[used] ** 2))
    residual = np.where(used, signal - scale * shape, 0.0)
    if np.sum(residual**2) > _LARGEST_RESIDUAL**2 * np.sum(signal[used] ** 2):
        raise InputError("does not look like what the scene predicts", remedy="is it that LED, and the scene's pose?")
    weight = np.where(used, shape, 0.0)
    variance = max(_rounding(weight, scale, sensor), _blocks(weight * residual)) / float(np.sum(weight**2)) ** 2
    value = scale ** (1 / sensor.gamma)
    return Factor(
        value=value,
        standard_error=value / sensor.gamma * math.sqrt(variance) / scale,
        pixels=int(used.sum()),
        residual_rms=float(np.sqrt(np.mean(residual[used] ** 2))),
    )


def _rounding(weight: NDArray[np.float64], scale: float, sensor: Sensor) -> float:
    """Variance of sum(weight x rounding error), where nothing is known of the gray levels' common offset.

    The error of rounding is the saw tooth sum_k (-1)^k sin(2 pi k g)/(pi k), so that two pixels whose gray levels
    differ by d have the covariance sum_k cos(2 pi k d)/(2 pi^2 k^2): even images, whose errors are all the same,
    are seen as what they are. At one scale the sum may vanish by chance: it is averaged over scales nearby.
    """
    if not sensor.rounding:
        return 0.0
    lit = weight[weight > 0]
    total = 0.0
    for near in scale * _NEIGHBOURS:
        turn = np.exp(2j * math.pi * near * lit)
        power = np.ones_like(turn)
        for k in range(1, _HARMONICS + 1):
            power *= turn
            total += float(abs(np.sum(lit * power)) ** 2) / (2 * math.pi**2 * k**2)
    return total / len(_NEIGHBOURS)


def _blocks(errors: NDArray[np.float64]) -> float:
    """Variance of the sum, where errors hang together within blocks and not beyond."""
    rows, columns = (-(-n // _BLOCK) * _BLOCK for n in errors.shape)
    padded = np.zeros((rows, columns))
    padded[: errors.shape[0], : errors.shape[1]] = errors
    sums = padded.reshape(rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK).sum(axis=(1, 3))
    return float(np.sum(sums**2))
