"""What an image hangs on that nobody published: gray levels and noise at both ends of what a value may be.

Keys of components that are assumed and tell a range are looked at one by one,
through the sensor model and without a ray: those of the sensor, the share of
light that a lens lets through and its f-number, and the level of a scene's one
source. What changes the picture itself is not: focal length, beams, sizes, the
blur of another f-number, one of several sources.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.response.noise import noise_variance
from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.camera import Sensor
from radwrap.scene.catalog.component import Entry
from radwrap.scene.catalog.presets import Taken
from radwrap.scene.file.load import with_camera
from radwrap.scene.scene import Scene

_MOST_PIXELS: Final = 1 << 14  # evenly spread: means of more of them are hardly others
_NOTABLE_MEAN: Final = 0.01  # of the range of gray levels, from which on an image hangs on a value
_NOTABLE_NOISE: Final = 0.1
_SHOWN_GRAY: Final = 0.01
_SHOWN_NOISE: Final = 0.005
_QUANTITY: Final = re.compile(r"(\S+) (\S+)")
_SENSOR: Final = "camera.sensor"


@dataclass(frozen=True, slots=True)
class AssumedEffect:
    """What an assumed value decides.

    Attributes
    ----------
    key : str
        Of the scene.
    low, high : str
        Ends of its range.
    mean_gray : tuple of float
        Change of the mean gray level at both ends [gray level].
    noise : tuple of float or None
        Likewise of the mean temporal and spatial noise of a frame, as a share; None where the sensor has no noise.
    notable : bool
        Whether it is 1 % of the range of gray levels, or 10 % of the noise, or more.
    """

    key: str
    low: str
    high: str
    mean_gray: tuple[float, float]
    noise: tuple[float, float] | None
    notable: bool


def assumed_effects(scene: Scene, exposure: NDArray[np.float64]) -> tuple[AssumedEffect, ...]:
    """Effects of all assumed values of a scene's components that tell a range.

    Parameters
    ----------
    scene : Scene
        With its components.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    """
    step = max(1, math.ceil(math.sqrt(exposure.size / _MOST_PIXELS)))
    light = np.ascontiguousarray(exposure[::step, ::step])
    return tuple(
        _effect(scene, taken, key, taken.component.entries[key], light)
        for taken in scene.components
        for key in taken.used
        if _is_looked_at(scene, taken, key)
    )


def warnings_of_assumed(effects: tuple[AssumedEffect, ...]) -> Iterator[str]:
    """One line, where an image hangs on any of them."""
    told = [
        f"{effect.key} from {effect.low} to {effect.high}: {_changes(effect)}" for effect in effects if effect.notable
    ]
    if told:
        yield f"the image depends on values that nobody published: {'; '.join(told)}"


def _changes(effect: AssumedEffect) -> str:
    """Those of the two changes that can be seen in their digits."""
    low, high = effect.mean_gray
    told = [f"mean gray {low:+.3g} to {high:+.3g}"] if max(abs(low), abs(high)) >= _SHOWN_GRAY else []
    if effect.noise is not None and max(map(abs, effect.noise)) >= _SHOWN_NOISE:
        told.append(f"noise {effect.noise[0]:+.0%} to {effect.noise[1]:+.0%}")
    return ", ".join(told)


def _is_looked_at(scene: Scene, taken: Taken, key: str) -> bool:
    entry = taken.component.entries.get(key)
    if entry is None or (entry.range is None and entry.range_factor is None):
        return False
    if key not in taken.elsewhere and entry.basis != "assumed":
        return False
    match taken.component.kind:
        case "sensors":
            return scene.spectral is None  # where spectra are told, a sensor is weighed by them
        case "lenses":
            return key in ("transmission", "f_number")
        case "lights" | "leds" | "lamps":
            return key.startswith("radian") and len(scene.sources) == 1
    return False


def _effect(scene: Scene, taken: Taken, key: str, entry: Entry, light: NDArray[np.float64]) -> AssumedEffect:
    value = taken.component.values[key]
    ends = entry.range or tuple(_times(value, factor) for factor in entry.range_factor or ())
    sensor = scene.camera.sensor
    before = _image(sensor, light)
    images = []
    for end in ends:
        if taken.component.kind == "sensors":
            try:
                other = with_camera(scene, {f"{_SENSOR}.{key}": end}).camera.sensor
            except InputError as error:
                where = f"{taken.component.path}: catalog.from.{key}.range"
                raise InputError(error.what, where=where, remedy="see `radwrap catalog check`") from error
            images.append(_image(other, light))
        else:
            share = _number(end) / _number(value)
            images.append(_image(sensor, light * (share**-2 if key == "f_number" else share)))
    low, high = (mean - before[0] for mean, _ in images)
    noise = None
    if before[1] is not None:
        first, last = (other / before[1] - 1 if other is not None and before[1] else 0.0 for _, other in images)
        noise = (first, last)
    span = sensor.saturation_gray - sensor.dark_gray
    notable = max(abs(low), abs(high)) >= _NOTABLE_MEAN * span or (
        noise is not None and max(map(abs, noise)) >= _NOTABLE_NOISE
    )
    shown = [f"{end:g}" if isinstance(end, int | float) else str(end) for end in ends]
    if isinstance(value, list):
        shown = [f"{factor:g} times" for factor in entry.range_factor or ()]
    return AssumedEffect(f"{taken.place_of(key)}.{key}", shown[0], shown[1], (low, high), noise, notable)


def _image(sensor: Sensor, light: NDArray[np.float64]) -> tuple[float, float | None]:
    """Mean gray level, and mean noise where the sensor has any."""
    noise = None if sensor.linear is None else float(np.sqrt(noise_variance(light, sensor)).mean())
    return float(gray_levels(light, sensor).mean()), noise


def _times(value: Any, factor: float) -> Any:
    """A value of a scene, that many times; shares of a table stay at most 1."""
    if isinstance(value, list):
        return [[at, min(share * factor, 1.0)] for at, share in value]
    if isinstance(value, str) and (found := _QUANTITY.fullmatch(value)):
        return f"{float(found[1]) * factor:.10g} {found[2]}"
    return value * factor


def _number(value: Any) -> float:
    return float(value.split(" ")[0]) if isinstance(value, str) else float(value)
