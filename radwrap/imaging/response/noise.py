"""Frames of a linear camera: the mean image with the noise of light, of pixels and of the read-out (EMVA 1288).

::

    electrons  ~ Poisson(mu_e (1 + PRNU_i) + mu_d), at most the full well
    signal     = electrons + DSNU_i + read noise              [e]
    gray level = offset + K signal, cut to the converter's range, then rounded

PRNU_i and DSNU_i belong to the specimen (`device_seed`), all else to the frame.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.response.sensor import gray_levels
from radwrap.random_streams import Camera, generator
from radwrap.scene.camera import Sensor
from radwrap.scene.linear_sensor import LinearSensor

Array = NDArray[np.float64]

# A mean so many standard deviations above the full well fills it always: the largest mean that is drawn.
_CERTAINLY_FULL: Final = 40.0
_FRAME: Final = re.compile(r"frame_[0-9]{4}\.png")
ROUNDING_VARIANCE: Final = 1 / 12  # of a whole number, where the noise covers a step


@dataclass(frozen=True, slots=True, eq=False)
class FixedPattern:
    """What one specimen's pixels differ by.

    Attributes
    ----------
    responsivity : ndarray, shape (rows, columns)
        1 + PRNU_i, not negative.
    dark : ndarray, shape (rows, columns)
        DSNU_i [e].
    hot, dead : ndarray of bool, shape (rows, columns)
        Pixels that always saturate, and that never see light.
    """

    responsivity: Array
    dark: Array
    hot: NDArray[np.bool_]
    dead: NDArray[np.bool_]


def linear_of(sensor: Sensor) -> LinearSensor:
    """The linear camera that a sensor is.

    Raises
    ------
    InputError
        If it is none, and nothing is known of its noise.
    """
    if sensor.linear is None:
        raise InputError(
            "the power law has no noise",
            where="camera.sensor.model",
            remedy='describe the camera with model = "linear"',
        )
    return sensor.linear


def fixed_pattern(sensor: Sensor) -> FixedPattern:
    """Draw a specimen; the same one for the same `device_seed`."""
    linear = linear_of(sensor)
    random = generator(linear.device_seed, Camera.PATTERN)
    shape = (sensor.rows, sensor.columns)
    responsivity = np.maximum(1 + linear.prnu * random.standard_normal(shape), 0.0)
    dark = linear.dsnu * random.standard_normal(shape)
    chance = random.random(shape)
    hot = chance < linear.hot_share
    return FixedPattern(responsivity, dark, hot, ~hot & (chance < linear.hot_share + linear.dead_share))


def noisy_frame(exposure: ExposureImage, sensor: Sensor, pattern: FixedPattern, seed: int, number: int) -> GrayImage:
    """One frame as the camera would send it.

    Parameters
    ----------
    exposure : ExposureImage
        H, mean over each pixel [J m^-2].
    sensor : Sensor
        A linear camera.
    pattern : FixedPattern
        The specimen.
    seed, number : int
        Decide the frame's noise.

    Raises
    ------
    InputError
        If the sensor is no linear camera.
    """
    linear = linear_of(sensor)
    random = generator(seed, number, Camera.FRAME)
    light = exposure.values * linear.electrons_of_exposure(sensor.pixel_area) * pattern.responsivity
    mean = np.where(pattern.dead, 0.0, light) + linear.dark_signal
    full = linear.full_well
    drawn = random.poisson(np.minimum(mean, full + _CERTAINLY_FULL * (1 + np.sqrt(full)))).astype(np.float64)
    electrons = np.where(pattern.hot, full, np.minimum(drawn, full))
    signal = electrons + pattern.dark + linear.read_noise * random.standard_normal(mean.shape)
    gray = np.clip(linear.offset + linear.system_gain * signal, 0.0, 2.0**sensor.bit_depth - 1)
    gray = _through_power_law(gray, sensor)
    return GrayImage(np.rint(gray) if sensor.rounding else gray, sensor.bit_depth, exposure.provenance)


def _through_power_law(gray: Array, sensor: Sensor) -> Array:
    """The look-up table behind the converter; what lies below dark is cut to it."""
    if sensor.gamma == 1.0:
        return gray
    span = sensor.saturation_gray - sensor.dark_gray
    shares = np.clip((gray - sensor.dark_gray) / span, 0.0, 1.0)
    bent: Array = sensor.dark_gray + span * shares**sensor.gamma
    return bent


def noise_variance(radiant_exposure: Array, sensor: Sensor) -> Array:
    """Variance of one frame of an unknown specimen about the mean image [gray level^2].

    K^2 (sigma_d^2 + mu_e + mu_d + DSNU^2 + PRNU^2 mu_e^2), through the slope of the response; 1/12 where gray levels
    are whole; defect pixels are no noise. Where the signal saturates its noise is cut: of light, dark signal and PRNU
    by the full well; all of it by the converter, or by the power law behind it.

    Parameters
    ----------
    radiant_exposure : ndarray
        H [J m^-2].
    sensor : Sensor
        A linear camera.
    """
    linear = linear_of(sensor)
    light = radiant_exposure * linear.electrons_of_exposure(sensor.pixel_area)
    square = linear.read_noise**2 + light + linear.dark_signal + linear.dsnu**2 + (linear.prnu * light) ** 2
    variance, high = _through_response(radiant_exposure, square, sensor)
    top = 2.0**sensor.bit_depth - 1
    if sensor.saturation_gray < top and sensor.gamma == 1.0:
        # The full well is before the read-out: what is added behind it is not cut by it.
        mean = gray_levels(radiant_exposure, sensor)
        behind = linear.read_noise**2 + linear.dsnu**2
        step = linear.system_gain * math.sqrt(behind)
        added = ((np.minimum(mean + step, top) - (mean - step)) / 2) ** 2
        cut, _ = _through_response(radiant_exposure, np.maximum(square - behind, 0.0), sensor)
        variance = np.where(high >= sensor.saturation_gray, cut + added, variance)
    return variance + (ROUNDING_VARIANCE if sensor.rounding else 0.0)


def without_pattern(sensor: Sensor) -> Sensor:
    """The sensor with pixels that are all alike: what differs between them is the same in every frame."""
    return replace(sensor, linear=replace(linear_of(sensor), dsnu=0.0, prnu=0.0))


def _through_response(radiant_exposure: Array, square: Array, sensor: Sensor) -> tuple[Array, Array]:
    """Variance of some electrons^2 as gray levels, and the gray level of a standard deviation more."""
    linear = linear_of(sensor)
    step = np.sqrt(square) / linear.electrons_of_exposure(sensor.pixel_area)
    high = gray_levels(radiant_exposure + step, sensor)
    low = gray_levels(np.maximum(radiant_exposure - step, 0.0), sensor)
    # Below dark the response of the mean ends, the converter's does not: there the upper half tells.
    mean = gray_levels(radiant_exposure, sensor)
    lower = np.where(radiant_exposure >= step, mean - low, high - mean if sensor.gamma == 1.0 else mean - low)
    variance: Array = ((high - mean + lower) / 2) ** 2
    return variance, high


def frame_file(number: int) -> str:
    """Name of a frame with noise."""
    return f"frame_{number:04d}.png"


def frames_in(folder: Path) -> list[str]:
    """Names of the frames in a folder, whether or not a manifest is still there to name them."""
    return sorted(file.name for file in folder.glob("frame_*.png") if _FRAME.fullmatch(file.name))
