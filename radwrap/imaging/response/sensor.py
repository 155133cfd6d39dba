"""From radiant exposure to gray level, Eq. 5: G = K H^gamma + G0."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radwrap.images import ExposureImage, GrayImage, Provenance
from radwrap.scene.camera import Sensor


def unclipped_gray(radiant_exposure: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Gray level by the power law alone, without saturation and rounding.

    Parameters
    ----------
    radiant_exposure : ndarray
        H [J m^-2]; below 0 it is an estimate of little light, and the law goes on as far below the dark level, so that
        replicates still show its noise.
    sensor : Sensor
        Response.

    Returns
    -------
    ndarray
        K H^gamma + G0; infinite where that overflows.
    """
    gamma = float(sensor.gamma)
    with np.errstate(over="ignore"):  # beyond saturation in any case
        # In place: of a large image most of the time is that of new memory.
        if gamma == 1.0 or not np.any(np.less(radiant_exposure, 0.0)):
            gray: NDArray[np.float64] = np.asarray(np.power(radiant_exposure, gamma))
        else:
            gray = np.asarray(np.copysign(np.abs(radiant_exposure) ** gamma, radiant_exposure))
        gray *= sensor.gain
        gray += sensor.dark_gray
    return gray


def gray_levels(radiant_exposure: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Gray level with saturation, before rounding."""
    gray = unclipped_gray(radiant_exposure, sensor)
    return np.minimum(gray, sensor.saturation_gray, out=gray)


@dataclass(frozen=True, slots=True, eq=False)
class GrayWhereAsked:
    """Gray levels of an image of which few pixels are looked at: indexed like the array of all.

    Attributes
    ----------
    radiance : ndarray, shape (rows, columns)
        [W m^-2 sr^-1].
    exposure_of_radiance : float
        [s sr].
    sensor : Sensor
    """

    radiance: NDArray[np.float64]
    exposure_of_radiance: float
    sensor: Sensor

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.radiance.shape
        return rows, columns

    @property
    def whole(self) -> NDArray[np.float64]:
        """Gray levels of all pixels, shape (rows, columns)."""
        return gray_levels(self.radiance * self.exposure_of_radiance, self.sensor)

    def __getitem__(self, places: tuple[NDArray[np.intp], ...]) -> NDArray[np.float64]:
        """Gray levels, saturated but not rounded, at rows and columns."""
        return gray_levels(self.radiance[places] * self.exposure_of_radiance, self.sensor)


def gray_image(exposure: ExposureImage, sensor: Sensor) -> GrayImage:
    """The image that the camera gives: Eq. 5, saturation, and rounding where the sensor rounds."""
    return image_of_levels(gray_levels(exposure.values, sensor), sensor, exposure.provenance)


def image_of_levels(gray: NDArray[np.float64], sensor: Sensor, provenance: Provenance) -> GrayImage:
    """What the camera gives of gray levels, see `gray_levels`: rounded where the sensor rounds."""
    return GrayImage(np.rint(gray) if sensor.rounding else gray, sensor.bit_depth, provenance)


def radiant_exposure_of(gray: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Invert Eq. 5 between dark and saturation: H = ((G - G0)/K)^(1/gamma) [J m^-2].

    Raises
    ------
    ValueError
        If a gray level lies below dark or at saturation, where no inverse exists.
    """
    if (gray < sensor.dark_gray).any() or (gray >= sensor.saturation_gray).any():
        raise ValueError("gray levels below dark or at saturation have no radiant exposure")
    exposure: NDArray[np.float64] = np.power((gray - sensor.dark_gray) / sensor.gain, 1 / sensor.gamma)
    return exposure


def with_gamma(sensor: Sensor, gamma: float, radiant_exposure: float) -> Sensor:
    """The sensor with another gamma, and K such that one radiant exposure keeps its gray level.

    Parameters
    ----------
    sensor : Sensor
        Response by the power law alone.
    gamma : float
        Exponent, above 0.
    radiant_exposure : float
        H whose gray level stays [J m^-2], above 0. K's unit goes with gamma: some exposure must be named.

    Raises
    ------
    ValueError
        If the sensor is a linear camera, whose gain has another meaning, or a number is not above 0.
    """
    if sensor.linear is not None or not (gamma > 0 and radiant_exposure > 0):
        raise ValueError("needs a sensor of Eq. 5, and gamma and exposure above 0")
    return replace(sensor, gamma=gamma, gain=sensor.gain * radiant_exposure ** (sensor.gamma - gamma))
