"""Levels of sources on a light basis: by a convex program where the problem is one, else by a local search."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.designing.convex import EvenLight, Limit, Measure, least, most_even, unevenness
from radwrap.designing.keys import SearchKey
from radwrap.designing.local import best_nearby, worst
from radwrap.designing.quantities import PEAK, TIME_OF_EXPOSURE, Constraint, Objective
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.response.sensor import gray_levels, radiant_exposure_of
from radwrap.measure.gauges import Box
from radwrap.measure.gauges.uniformity import cells_of
from radwrap.scene.camera import Sensor
from radwrap.scene.file.keys import expanded, found, with_all_leds
from radwrap.scene.scene import Scene
from radwrap.scene.sources import emitters
from radwrap.study.factors import in_si, written
from radwrap.study.image_error import ErrorFields, image_error
from radwrap.study.placed_calipers import region_of
from radwrap.study.responses import Response, answer
from radwrap.study.seen import Seen

Array = NDArray[np.float64]

_LED: Final = re.compile(r"sources\[(\d+)\]\.leds\[(\d+)\]\.radiance_factor")
_SOURCE: Final = re.compile(r"sources\[(\d+)\]\.")
_MEASURES: Final[Mapping[str, Measure]] = {"uniformity": "deviation", "unevenness": "extremes"}
MEANS: Final = ("mean_gray", "region_mean")
CONVEX: Final = "convex program"
LOCAL: Final = "local search"


@dataclass(frozen=True, slots=True)
class Level:
    """A level that is sought.

    Attributes
    ----------
    path : str
        Key path of the scene.
    names : tuple of str
        Sources of a light basis that it scales.
    value : float
        In the scene, in SI; above zero.
    unit : str
        In which it is told.
    low, high : float
        Bounds, as factors on `value`.
    """

    path: str
    names: tuple[str, ...]
    value: float
    unit: str
    low: float
    high: float

    def written(self, factor: float) -> Any:
        """The level as the scene's file would hold it."""
        return written(factor * self.value / (in_si(f"1 {self.unit}") or 1.0 if self.unit else 1.0), self.unit)


@dataclass(frozen=True, slots=True)
class LightAim:
    """What levels are sought for.

    Attributes
    ----------
    levels : tuple of Level
    objective : Objective
    constraints : tuple of Constraint
    responses : tuple of Response
        That these name.
    time : Level, optional
        The exposure time, where it is sought too.
    time_off : tuple of float
        The shortest and the longest time that tolerances make of it, over the time itself.
    second : Objective, optional
        The other one of two.
    share : float
        How far levels go from those that are best by the first objective to those that are best by the second.
    """

    levels: tuple[Level, ...]
    objective: Objective
    constraints: tuple[Constraint, ...]
    responses: tuple[Response, ...]
    time: Level | None = None
    time_off: tuple[float, float] = (1.0, 1.0)
    second: Objective | None = None
    share: float = 0.0

    def alone(self, objective: Objective, *limits: Constraint) -> LightAim:
        """The same for one objective, within limits more."""
        return replace(self, objective=objective, second=None, constraints=(*self.constraints, *limits))

    @property
    def sought(self) -> tuple[Level, ...]:
        """Levels, and the time behind them, within what is allowed of it."""
        if self.time is None:
            return self.levels
        own = [one for one in self.constraints if one.quantity.name == TIME_OF_EXPOSURE]
        low = max([self.time.low, *(one.low / self.time.value / self.time_off[0] for one in own)])
        high = min([self.time.high, *(one.high / self.time.value / self.time_off[1] for one in own)])
        return (*self.levels, replace(self.time, low=low, high=high))

    def response(self, name: str) -> Response | None:
        """The response of a name; None of what a scene tells without a ray."""
        return next((one for one in self.responses if one.name == name), None)

    def way(self, sensors: Sequence[Sensor]) -> str:
        """`CONVEX` where the problem is a convex one in radiant exposure for each of some sensors, else `LOCAL`."""
        aimed = self.response(self.objective.quantity.name)
        wanted = aimed is not None and not aimed.repeatability and aimed.user is None and aimed.kind in _MEASURES
        if aimed is None or not wanted or self.objective.is_maximised != (aimed.kind == "uniformity"):
            return LOCAL
        return CONVEX if all(self.is_linear(one, sensors) for one in self.constraints) else LOCAL

    def is_linear(self, constraint: Constraint, sensors: Sequence[Sensor]) -> bool:
        """Whether limits are linear in radiant exposure for each of some sensors."""
        name = constraint.quantity.name
        response = self.response(name)
        if response is None:
            return name != "leds"
        if response.repeatability or response.user is not None:
            return False
        if response.kind == "peak_gray":
            return math.isinf(constraint.low)
        return response.kind in MEANS and all(sensor.gamma == 1 for sensor in sensors)


def levels_of(keys: Sequence[SearchKey], document: Mapping[str, Any], scene: Scene, origin: str) -> tuple[Level, ...]:
    """The levels that some keys free.

    Raises
    ------
    InputError
        If one is dark in the scene, or two scale one source.
    """
    document = with_all_leds(document, [path for key in keys for path in key.keys])
    levels: list[Level] = []
    seen: dict[str, str] = {}
    for key in keys:
        for path in (one for asked in key.keys for one in expanded(asked, document)):
            level = _level(key, path, document, scene, f"{origin}: keys.{key.name}")
            for name in level.names:
                if name in seen:
                    raise InputError(f"{path} scales {name}, as {seen[name]} does", where=f"{origin}: keys.{key.name}")
                seen[name] = path
            levels.append(level)
    return tuple(levels)


def _level(key: SearchKey, path: str, document: Mapping[str, Any], scene: Scene, where: str) -> Level:
    assert key.span is not None  # noqa: S101  (a level has bounds)
    led, source = _LED.fullmatch(path), _SOURCE.match(path)
    assert source is not None  # noqa: S101  (asked before)
    held = scene.sources[int(source[1])]
    names = (f"{held.name}.led{int(led[2]):02d}",) if led else tuple(dict.fromkeys(e.source for e in emitters(held)))
    told = found(document, path)
    value = in_si(1.0 if told is None and led else told)
    if value is None or not value > 0:
        raise InputError(
            f"{path} is dark in the scene, and a light basis begins with its light",
            where=where,
            remedy="give it a level above zero in the scene",
        )
    low, high = (in_si(key.span.written(end)) for end in (key.span.low, key.span.high))
    if low is None or high is None or low < 0:
        raise InputError("levels are not negative", where=f"{where}.low")
    return Level(path, names, value, key.span.unit, low / value, high / value)


def time_of(key: SearchKey, scene: Scene) -> Level:
    """The exposure time as a level of all light."""
    assert key.span is not None  # noqa: S101  (it has bounds)
    value = scene.camera.exposure_time
    low, high = (in_si(key.span.written(end)) or 0.0 for end in (key.span.low, key.span.high))
    return Level(key.keys[0], (), value, key.span.unit, low / value, high / value)


class LitBy:
    """A basis as light of each sought level, and of all others together."""

    def __init__(self, aim: LightAim, basis: Basis, scene: Scene) -> None:
        self.aim, self._sensor, self._scene = aim, basis.sensor, scene
        exposure = basis.images.mean(axis=1, dtype=np.float64) * basis.exposure_of_radiance
        row = {name: number for number, name in enumerate(basis.sources)}
        governed = [[row[name] for name in level.names] for level in aim.levels]
        taken = {number for rows in governed for number in rows}
        fixed = [number for number in range(len(basis.sources)) if number not in taken]
        parts = [exposure[rows].sum(axis=0) for rows in (*governed, fixed)]
        self._light: Array = np.stack(parts, axis=-1)  # (rows, columns, levels + 1) [J m^-2]
        self.low = np.array([level.low for level in aim.sought])
        self.high = np.array([level.high for level in aim.sought])
        if (self.low > self.high).any():
            raise InputError("no exposure time keeps all limits", where="levels")
        if aim.time is not None:  # all light hangs on it: what does not change is none
            none = np.zeros((*self._light.shape[:-1], 1))
            self._light = np.concatenate([self._light, none], axis=-1)

    def _in(self, response: Response) -> Array:
        """Light of the pixels of a response's region, shape (rows, columns, levels + 1)."""
        rows, columns = self._light.shape[:2]
        asked = response.options.get("region", (0, 0, columns - 1, rows - 1))
        box = region_of(self._scene, asked) if isinstance(asked, str) else Box(*asked)
        return self._light[box.v0 : box.v1 + 1, box.u0 : box.u1 + 1]

    def extreme(self) -> Array:
        """Factors by which a mean, or the time, is as small or large as limits allow."""
        aimed, sign = self.aim.response(self.aim.objective.quantity.name), self.aim.objective.sign
        if aimed is None:
            row = np.zeros(self._light.shape[-1])
            row[-2] = sign  # the time: light that does not change comes after it
            region = self._light
        else:
            region = self._in(aimed)
            row = sign * _flat(region).mean(axis=0)
        problem = self._within(region)
        if aimed is not None:  # no pixel of what has a mean may be saturated
            limit = Limit(_flat(region), -math.inf, self._exposure(self._brightest()))
            problem = replace(problem, limits=(*problem.limits, limit))
        return self._factors(least(problem, row))

    def even_light(self) -> EvenLight:
        """The convex program."""
        aimed = self.aim.response(self.aim.objective.quantity.name)
        assert aimed is not None  # noqa: S101  (the way says so)
        return self._within(self._in(aimed))

    def _factors(self, levels: Array) -> Array:
        """Factors from levels, which with a time are those of light."""
        return levels if self.aim.time is None else np.append(levels[:-1] / levels[-1], levels[-1])

    def _within(self, region: Array) -> EvenLight:
        """Cells of a region, bounds, and limits."""
        parts = [cells_of(region[..., k]) for k in range(region.shape[-1])]
        cells = np.stack([means.ravel() for means, _, _ in parts], axis=-1)
        weights = parts[0][1].ravel() / parts[0][1].sum()
        limits = [Limit(_flat(region), -math.inf, self._exposure(self._brightest()))]
        for one in self.aim.constraints:
            response = self.aim.response(one.quantity.name)
            if response is None:
                continue
            if response.kind == "peak_gray":
                limits.append(Limit(_flat(self._light), -math.inf, self._exposure(min(one.high, self._brightest()))))
            else:
                means = _flat(self._in(response))
                limits.append(Limit(means, -math.inf, self._exposure(self._brightest())))
                mean = means.mean(axis=0, keepdims=True)
                limits.append(Limit(mean, self._exposure(one.low), self._exposure(one.high)))
        return EvenLight(cells, weights, self.low, self.high, tuple(limits), self.aim.time is not None)

    def _brightest(self) -> float:
        """Gray level below which a pixel is not saturated, rounded or not."""
        saturation = self._sensor.saturation_gray
        return saturation - 0.5 if self._sensor.rounding else saturation * (1 - 1e-9)

    def _exposure(self, gray: float) -> float:
        """The inverse of Eq. 5, without end beyond what it has."""
        if gray >= self._sensor.saturation_gray:
            return math.inf
        if gray <= self._sensor.dark_gray:
            return -math.inf if math.isinf(gray) else 0.0
        return float(radiant_exposure_of(np.array([gray]), self._sensor)[0])

    def _exposed(self, factors: Array) -> Array:
        """Radiant exposure in some levels, shape (rows, columns) [J m^-2]."""
        if self.aim.time is not None:
            factors = np.append(factors[:-1] * factors[-1], factors[-1])
        return np.asarray(np.maximum(self._light @ np.append(factors, 1.0), 0.0))

    def share_of_full(self, factors: Array) -> float:
        """Light of the brightest pixel over that of a full one."""
        return float(self._exposed(factors).max()) / self._exposure(self._brightest())

    def peak(self, constraint: Constraint) -> Limit | None:
        """Light of all pixels below a limit of the brightest one; None where that is not linear in the levels."""
        response = self.aim.response(constraint.quantity.name)
        is_peak = response is not None and response.kind == PEAK and not response.repeatability
        if not is_peak or math.isfinite(constraint.low) or self.aim.time is not None:
            return None
        high = self._exposure(min(constraint.high, self._brightest()))
        return Limit(_flat(self._light), -math.inf, high) if high > 0 else None

    def measured(self, name: str, factors: Array) -> float:
        """A quantity for some levels, on the image without error and rounding; NaN where it cannot be measured."""
        response, time = self.aim.response(name), self.aim.time
        if response is None:
            return float(factors[-1]) * time.value if time is not None and name == TIME_OF_EXPOSURE else 0.0
        exposure = self._exposed(factors)
        gray = gray_levels(exposure, self._sensor)
        image = GrayImage(np.clip(gray, 0.0, self._sensor.saturation_gray), self._sensor.bit_depth)
        none = ErrorFields(np.zeros((0, *gray.shape)))
        seen = Seen(self._scene, image, gray, image_error(gray, 0.0, (0.5, 0.5)), none, exposure=exposure)
        try:
            return answer(response, seen).value
        except InputError:
            return math.nan


class Lit:
    """Images of a scene as it stands, and in the corners of its tolerances, for one set of levels."""

    def __init__(self, images: Sequence[LitBy]) -> None:
        self._images, self._aim = images, images[0].aim

    def convex(self) -> tuple[Array, float]:
        """Factors and the objective of the worst image, exactly."""
        problem, *around = (one.even_light() for one in self._images)
        aimed = self._aim.response(self._aim.objective.quantity.name)
        assert aimed is not None  # noqa: S101  (the way says so)
        measure = _MEASURES[aimed.kind]
        try:
            factors = most_even(problem, measure, around)
        except InputError as error:
            raise self._unkept(error) from error
        uneven = max(unevenness(one, factors, measure) for one in (problem, *around))
        factors = self._images[0]._factors(factors)
        return factors, 1 - uneven if measure == "deviation" else uneven

    def _unkept(self, error: InputError) -> InputError:
        """What is said where no levels keep all limits; corners are asked where some do in the scene as it stands."""
        if len(self._images) == 1:
            return error
        return InputError(f"{error.what} in all corners of the tolerances", where=error.where, remedy=error.remedy)

    def local(self) -> tuple[Array, float]:
        """Factors and the objective of the worst image, near the scene's own levels."""
        factors = best_nearby(self._images, self._aim.objective, self._aim.constraints)
        return factors, worst(self._images, self._aim.objective, factors)


def _flat(light: Array) -> Array:
    return light.reshape(-1, light.shape[-1])
