"""What an image hangs on that nobody published: gray levels and noise at both ends of what a value may be.

Keys of components that are assumed and tell a range are looked at one by one,
through the sensor model and without a ray: those of the sensor, the share of
light that a lens lets through and its f-number, and the level of a scene's one
source, or of those whose shares of the light are known: `level_shares` finds them. What changes the picture
itself is not: focal length, beams, sizes, the blur of another f-number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.methods.rays import sampled_radiance
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.noise import noise_variance
from radwrap.imaging.response.sensor import gray_levels
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Sensor
from radwrap.scene.catalog.presets import Taken
from radwrap.scene.file.load import BEHIND_THE_LIGHT, camera_with
from radwrap.scene.scene import Scene
from radwrap.scene.sources import emitters

_MOST_PIXELS: Final = 1 << 14  # evenly spread: means of more of them are hardly others
_MOST_SHARED: Final = 1 << 12  # likewise, where each of them takes a ray for each source
_NOTABLE_MEAN: Final = 0.01  # of the range of gray levels, from which on an image hangs on a value
_NOTABLE_NOISE: Final = 0.1
_SHOWN_GRAY: Final = 0.01
_SHOWN_NOISE: Final = 0.005
_NUMBER: Final = re.compile(r"\[(\d+)\]")
_QUANTITY: Final = re.compile(r"(\S+) (\S+)")
_SENSOR: Final = "camera.sensor"
_LIGHTS: Final = ("lights", "leds", "lamps")
_CURVE: Final = "quantum_efficiencies"


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


@dataclass(frozen=True, slots=True)
class Assumptions:
    """What an image hangs on: its camera, and what the scene takes from the catalog.

    Attributes
    ----------
    sensor : Sensor
        Of the camera.
    components : tuple of Taken
        What the scene takes from the catalog.
    sources : tuple of str
        Names of all sources.
    document, origin, folder : str, str, Path
        As of `Scene`.
    spectral : bool
        Whether the scene tells spectra.
    """

    sensor: Sensor
    components: tuple[Taken, ...]
    sources: tuple[str, ...]
    document: str
    origin: str
    folder: Path
    spectral: bool

    @classmethod
    def of(cls, scene: Scene) -> Assumptions:
        """Of a scene."""
        names = tuple(source.name for source in scene.sources)
        spectral = scene.spectral is not None
        return cls(scene.camera.sensor, scene.components, names, scene.document, scene.origin, scene.folder, spectral)


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """An image where an assumed value is at one end of its range.

    Attributes
    ----------
    value : str
        That end, as a scene writes it.
    sensor : Sensor
        That gives the image.
    light : ndarray of float64, shape (rows, columns)
        What it gets [J m^-2].
    """

    value: str
    sensor: Sensor
    light: NDArray[np.float64]


def assumed_effects(scene: Scene, exposure: NDArray[np.float64]) -> tuple[AssumedEffect, ...]:
    """Effects of all assumed values of a scene's components that tell a range.

    Parameters
    ----------
    scene : Scene
        With its components.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    """
    return effects_of(Assumptions.of(scene), exposure)


def effects_of(
    told: Assumptions, exposure: NDArray[np.float64], lights: Mapping[str, NDArray[np.float64]] | None = None
) -> tuple[AssumedEffect, ...]:
    """As `assumed_effects`, of an image of which only this is known.

    Parameters
    ----------
    told : Assumptions
        Of the image.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    lights : Mapping of str to ndarray, optional
        Name of a source -> its share of the exposure; of a scene's only source all of it is.
    """
    return _effects(told, _thinned(exposure), {name: _thinned(part) for name, part in (lights or {}).items()})


def effects_by_shares(
    told: Assumptions, exposure: NDArray[np.float64], shares: Mapping[str, NDArray[np.float64]]
) -> tuple[AssumedEffect, ...]:
    """As `effects_of`, of an image of whose light `level_shares` has found each source's share."""
    if not shares:
        return effects_of(told, exposure)
    light = _thinned(exposure, _MOST_SHARED)
    return _effects(told, light, {name: share * light for name, share in shares.items()})


def level_shares(
    scene: Scene, view_of: Callable[[str], View], seed: int, *, complete: bool = True
) -> dict[str, NDArray[np.float64]]:
    """Share of each source's light in the pixels that effects are found from, where that needs to be known.

    By some thousand rays of direct light for each source, spread over these pixels and the opening, so that shadows
    and blur are in it. It is needed where one of several sources has an assumed level with a range.

    Parameters
    ----------
    scene : Scene
        What is there.
    view_of : callable
        Name of a source -> the camera in its light alone.
    seed : int
        Of the rays.
    complete : bool
        Whether the scene's sources are all of the light; shares are not known where included files shine.

    Returns
    -------
    dict of str to ndarray, shape (rows, columns)
        Name of a source whose level is assumed -> its share; where no light was met, that of the whole image.
    """
    asked = with_assumed_level(Assumptions.of(scene)) if complete and len(scene.sources) > 1 else ()
    if not asked:
        return {}
    bright = [one.name for one in scene.sources if any(emitter.radiance > 0 for emitter in emitters(one))]
    asked = tuple(name for name in asked if name in bright)  # nothing changes what is dark
    if not asked:
        return {}
    sensor = scene.camera.sensor
    step = _step(sensor.pixels, _MOST_SHARED)
    rows, columns = np.arange(0, sensor.rows, step), np.arange(0, sensor.columns, step)
    v, u = (axis.ravel().astype(float) for axis in np.meshgrid(rows, columns, indexing="ij"))
    number = max(1, _MOST_SHARED // u.size)
    lights = {}
    for name in bright:  # the same rays for each
        traced = sampled_radiance(view_of(name), u, v, number, generator(seed, Rendering.LEVEL_SHARES))
        lights[name] = traced.mean(axis=-1).reshape(len(rows), len(columns))
    total: NDArray[np.float64] = np.sum(list(lights.values()), axis=0)
    whole = float(total.sum())
    return {
        name: np.divide(
            lights[name], total, out=np.full_like(total, lights[name].sum() / whole if whole else 0.0), where=total > 0
        )
        for name in asked
    }


def _step(pixels: int, most: int) -> int:
    return max(1, math.ceil(math.sqrt(pixels / most)))


def _thinned(values: NDArray[np.float64], most: int = _MOST_PIXELS) -> NDArray[np.float64]:
    step = _step(values.size, most)
    return np.ascontiguousarray(values[::step, ::step])


def _effects(
    told: Assumptions, light: NDArray[np.float64], parts: Mapping[str, NDArray[np.float64]]
) -> tuple[AssumedEffect, ...]:
    before = _image(told.sensor, light)
    return tuple(_effect(told.sensor, before, key, ends) for key, ends in assumed_ends(told, light, parts))


def assumed_ends(
    told: Assumptions, light: NDArray[np.float64], lights: Mapping[str, NDArray[np.float64]] | None = None
) -> Iterator[tuple[str, tuple[End, End]]]:
    """Key of each assumed value that tells a range, and the image at both ends; arguments as `effects_of`."""
    parts = dict(lights or {})
    if len(told.sources) == 1:
        parts[told.sources[0]] = light
    for taken in told.components:
        for key in taken.used:
            if _is_looked_at(told, taken, key, parts):
                low, high = _ends(told, taken, key, light, parts)
                yield f"{taken.place_of(key)}.{key}", (low, high)


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


def with_assumed_level(told: Assumptions) -> tuple[str, ...]:
    """Names of the sources whose level nobody published, where a range of it is told."""
    parts = dict.fromkeys(told.sources)
    return tuple(
        _source_of(told, taken)
        for taken in told.components
        if taken.component.kind in _LIGHTS and any(_is_looked_at(told, taken, key, parts) for key in taken.used)
    )


def _is_looked_at(told: Assumptions, taken: Taken, key: str, parts: Mapping[str, Any]) -> bool:
    entry = taken.component.entries.get(key)
    if entry is None or (entry.range is None and entry.range_factor is None):
        return False
    if key not in taken.elsewhere and entry.basis != "assumed":
        return False
    match taken.component.kind:
        case "sensors":
            # Where spectra are told, they are weighed by the sensor: a factor on all of its curve is one on the light.
            by_factor = key == _CURVE and entry.range_factor is not None
            return not told.spectral or by_factor or f"{_SENSOR}.{key}" in BEHIND_THE_LIGHT
        case "lenses":
            return key in ("transmission", "f_number")
        case kind if kind in _LIGHTS:
            return key.startswith("radian") and _source_of(told, taken) in parts
    return False


def _source_of(told: Assumptions, taken: Taken) -> str:
    """Name of the source that takes a component."""
    number = _NUMBER.search(taken.key)
    return told.sources[int(number[1])] if number else ""


def _ends(
    told: Assumptions, taken: Taken, key: str, light: NDArray[np.float64], parts: Mapping[str, NDArray[np.float64]]
) -> Iterator[End]:
    value, entry = taken.component.values[key], taken.component.entries[key]
    ends = entry.range or tuple(_times(value, factor) for factor in entry.range_factor or ())
    for number, end in enumerate(ends):
        shown = f"{end:g}" if isinstance(end, int | float) else str(end)
        if isinstance(value, list) and entry.range_factor is not None:
            shown = f"{entry.range_factor[number]:g} times"
        sensor, seen = told.sensor, light
        if told.spectral and key == _CURVE:
            # Also the end of a curve that would pass one electron for each photon somewhere.
            seen = light * (max(one for _, one in end) / max(one for _, one in value))
        elif taken.component.kind == "sensors":
            sensor = _other_sensor(told, taken, key, end)
        elif taken.component.kind == "lenses":
            share = _number(end) / _number(value)
            seen = light * (share**-2 if key == "f_number" else share)
        else:
            seen = light + parts[_source_of(told, taken)] * (_number(end) / _number(value) - 1)
        yield End(shown, sensor, seen)


def _other_sensor(told: Assumptions, taken: Taken, key: str, end: Any) -> Sensor:
    try:
        changes = {f"{_SENSOR}.{key}": end}
        made = camera_with(told.document, changes, origin=told.origin, folder=told.folder, spectral=told.spectral)
    except InputError as error:
        where = f"{taken.component.path}: catalog.from.{key}.range"
        raise InputError(error.what, where=where, remedy="see `radwrap catalog check`") from error
    return made.camera.sensor


def _effect(sensor: Sensor, before: tuple[float, float | None], key: str, ends: tuple[End, End]) -> AssumedEffect:
    images = [_image(end.sensor, end.light) for end in ends]
    low, high = (mean - before[0] for mean, _ in images)
    noise = None
    if before[1] is not None:
        first, last = (other / before[1] - 1 if other is not None and before[1] else 0.0 for _, other in images)
        noise = (first, last)
    span = sensor.saturation_gray - sensor.dark_gray
    notable = max(abs(low), abs(high)) >= _NOTABLE_MEAN * span or (
        noise is not None and max(map(abs, noise)) >= _NOTABLE_NOISE
    )
    return AssumedEffect(key, ends[0].value, ends[1].value, (low, high), noise, notable)


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
