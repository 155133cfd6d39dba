"""What an engineer asks of a cell before an image is made: millimetres, sharpness, gray levels, electrons and noise.

By closed form: one reflection, no shadows, on rays from the opening's centre that are spread over the sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.forecast.preview import Brightest, spread_look
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.noise import ROUNDING_VARIANCE, noise_variance, without_pattern
from radwrap.imaging.response.sensor import gray_levels
from radwrap.manifest import plain
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]

ADVISED_SHARE: Final = 0.8  # of the gray range above dark, for the brightest of an image
_EIGHT: Final = 8
# A step of the converter hides nothing where noise is this share of it: EMVA 1288 asks as much of a camera in the dark.
_DITHERED: Final = 0.5


@dataclass(frozen=True, slots=True)
class Level:
    """What the camera makes of a radiant exposure.

    Attributes
    ----------
    gray : float
        Mean gray level.
    electrons : float or None
        Of a linear camera, dark signal included.
    snr : float or None
        Gray level above dark over one frame's temporal noise; None without noise, or saturated.
    """

    gray: float
    electrons: float | None
    snr: float | None


@dataclass(frozen=True, slots=True)
class InSight:
    """A target as the camera sees it.

    Attributes
    ----------
    target : str
        Its name.
    nearest, farthest : float
        Depths of what is seen of it [m].
    field_of_view : tuple of float
        Width and height of what the sensor sees at their median [m].
    pixel : tuple of float
        Width and height of a pixel there [m].
    blur_radius_px : tuple of float
        At the nearest and the farthest depth, in pixel widths.
    middle, peak : Level
        Of the median and the brightest of what is seen.
    exposure_for_80_percent : float or None
        Exposure time that brings that brightest there [s]; None without light.
    """

    target: str
    nearest: float
    farthest: float
    field_of_view: tuple[float, float]
    pixel: tuple[float, float]
    blur_radius_px: tuple[float, float]
    middle: Level
    peak: Level
    exposure_for_80_percent: float | None


def in_sight(scene: Scene, brightest: Brightest | None = None) -> tuple[InSight, ...]:
    """Each target that the camera sees, in the order of the scene; included Radiance files are not known.

    `brightest`, where it is known, is a search's: it finds highlights that lie between the rays of a look.
    """
    camera = scene.camera
    seen, depth = spread_look(scene)
    found = []
    for target in scene.targets:
        own = [number for number, (name, _) in enumerate(seen.names) if name == target.name]
        mine = np.isin(seen.number, own)
        if mine.any():
            value = seen.value[mine]
            searched = brightest.radiance if brightest is not None and brightest.target == target.name else 0.0
            found.append(_in_sight(camera, target.name, depth[mine], value, max(float(value.max()), searched)))
    return tuple(found)


def _in_sight(camera: Camera, name: str, depth: Array, value: Array, peak: float) -> InSight:
    nearest, farthest = float(depth.min()), float(depth.max())
    middle = float(np.median(depth))  # of a part its face, and not the walls that are seen beside it
    width, height = (middle * pitch for pitch in camera.pitch)
    blur = [
        camera.aperture.diameter / 2 * abs(float(camera.magnification(place))) / camera.sensor.pixel_width
        for place in (nearest, farthest)
    ]
    exposure = exposure_of_radiance(camera)
    return InSight(
        name,
        nearest,
        farthest,
        (camera.sensor.columns * width, camera.sensor.rows * height),
        (width, height),
        (blur[0], blur[1]),
        level_of(float(np.median(value)) * exposure, camera.sensor),
        level_of(peak * exposure, camera.sensor),
        exposure_for_advice(camera, peak),
    )


def exposure_for_advice(camera: Camera, radiance: float) -> float | None:
    """Exposure time that brings a radiance on the sensor [W m^-2 sr^-1] to 80 % [s]; None without light."""
    irradiance = radiance * exposure_of_radiance(replace(camera, exposure_time=1.0))
    if irradiance <= 0:
        return None
    sensor, linear, time = camera.sensor, camera.sensor.linear, camera.exposure_time
    span = sensor.saturation_gray - sensor.dark_gray
    share: float = ADVISED_SHARE ** (1 / sensor.gamma)
    # The dark current raises black meanwhile, and so lowers what is left above it [gray level s^-1].
    drift = linear.system_gain * linear.dark_signal / time if linear is not None and time else 0.0
    rate = irradiance * span * (sensor.gain / span) ** (1 / sensor.gamma)
    advised: float = share * (span + drift * time) / (rate + share * drift)
    return advised


def level_of(radiant_exposure: float, sensor: Sensor) -> Level:
    """What a sensor makes of a radiant exposure [J m^-2]."""
    values = np.array([radiant_exposure])
    gray = float(gray_levels(values, sensor)[0])
    linear = sensor.linear
    if linear is None:
        return Level(gray, None, None)
    electrons = radiant_exposure * linear.electrons_of_exposure(sensor.pixel_area) + linear.dark_signal
    if gray >= sensor.saturation_gray:
        return Level(gray, min(electrons, linear.full_well), None)
    noise = math.sqrt(float(noise_variance(values, without_pattern(sensor))[0]))
    return Level(gray, electrons, (gray - sensor.dark_gray) / noise)


def eight_bits(scene: Scene, seen: tuple[InSight, ...]) -> dict[str, Any] | None:
    """Whether 8 bits would do: their step against the noise of the darkest target; None of a camera without noise.

    Returns
    -------
    dict
        ``step``, of 8 bits, and ``noise`` of one frame on the ``target`` whose median is darkest, both in gray levels
        of this camera; ``enough``.
    """
    sensor = scene.camera.sensor
    if sensor.linear is None or sensor.bit_depth <= _EIGHT or not seen:
        return None
    darkest = min(seen, key=lambda one: one.middle.gray)
    exposure = max(darkest.middle.gray - sensor.dark_gray, 0.0)
    light = (exposure / sensor.gain) ** (1 / sensor.gamma)
    variance = float(noise_variance(np.array([light]), without_pattern(sensor))[0])
    noise = math.sqrt(max(variance - (ROUNDING_VARIANCE if sensor.rounding else 0.0), 0.0))
    step = 2.0 ** (sensor.bit_depth - _EIGHT)
    return {"target": darkest.target, "step": step, "noise": noise, "enough": noise >= _DITHERED * step}


def told(seen: tuple[InSight, ...]) -> list[dict[str, Any]]:
    """As JSON."""
    found: list[dict[str, Any]] = plain(seen, named=False)
    return found
