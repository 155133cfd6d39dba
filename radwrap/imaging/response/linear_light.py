"""From an error of radiant exposure to one of gray levels: light adds up over time, and gray levels do not."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
# Shares of the pixels at which an image is parted into dark and bright ones.
_PARTS: Final = np.linspace(0.0, 1.0, 33)
_HALVINGS: Final = 60  # of an interval of doubles


def gray_bound(error: float, exposure: Array, sensor: Sensor) -> float:
    """Bound of the root mean square of gray levels' errors [gray level].

    By the slope of Eq. 5 where a pixel is bright; with gamma below 1 that grows without limit towards 0, and there
    |a^g - b^g| <= |a - b|^g holds. The best place to part both is taken.

    Parameters
    ----------
    error : float
        Root mean square over the image of the error of radiant exposure [J m^-2].
    exposure : ndarray
        Of all pixels [J m^-2].
    sensor : Sensor
        Response.
    """
    gain, gamma = sensor.gain, sensor.gamma
    if gamma == 1 or error == 0:
        return gain * error
    full = full_exposure(sensor)
    if gamma > 1:
        return float(gain * gamma * min(exposure.max(), full) ** (gamma - 1) * error)
    bounds = []
    for dark, least in zip(_PARTS, np.quantile(exposure, _PARTS), strict=True):
        bright = 0.0 if dark == 1 else math.inf
        if dark < 1 and least > 0:
            bright = (gain * gamma * least ** (gamma - 1) * error) ** 2
        bounds.append(math.sqrt(bright + dark ** (1 - gamma) * (gain * error**gamma) ** 2))
    return min(bounds)


def allowed_exposure_error(gray: float, exposure: Array, sensor: Sensor) -> float:
    """Largest root mean square of the error of radiant exposure [J m^-2] that is within a bound [gray level]."""
    low, high = 0.0, full_exposure(sensor)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if gray_bound(middle, exposure, sensor) <= gray else (low, middle)
    return low


def full_exposure(sensor: Sensor) -> float:
    """Radiant exposure at which a pixel saturates [J m^-2]."""
    return float(((sensor.saturation_gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma))
