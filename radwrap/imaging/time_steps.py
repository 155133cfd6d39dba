"""At which instants a scene is rendered in which light, and how long each counts in each row of the image.

Between two instants light is taken to go straight. What that misses is seen by leaving out every second instant. The
instants are not evenly apart, so that a pattern that passes does not keep step with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.random_streams import Rendering, generator
from radwrap.scene.instants import windows_of
from radwrap.scene.scene import Scene
from radwrap.scene.shutter import Strobe, lit_time, shares_of_times
from radwrap.scene.sources import emitters

Array = NDArray[np.float64]
# How far a middle instant lies off the middle at most, as a share of the distance between its neighbours.
_OFF_MIDDLE: Final = 0.125


@dataclass(frozen=True, slots=True)
class Light:
    """Sources that shine at the same times.

    Attributes
    ----------
    sources : tuple of str
        Their names.
    strobe : Strobe, optional
        Their pulses.
    first, last : float
        Between these times it reaches any row [s].
    """

    sources: tuple[str, ...]
    strobe: Strobe | None
    first: float
    last: float


def lights_of(scene: Scene) -> tuple[Light, ...]:
    """The light of a scene by its times; what reaches no row, or is dark at all times beside other light, is left out.

    Raises
    ------
    InputError
        If no source shines while a row is exposed.
    """
    start, end = windows_of(scene)
    opened, closed = float(start.min()), float(end.max())
    if not scene.sources:  # an included file shines
        return (Light((), None, opened, closed),)
    found = []
    for strobe in dict.fromkeys(scene.strobes.get(source.name) for source in scene.sources):
        names = tuple(source.name for source in scene.sources if scene.strobes.get(source.name) == strobe)
        if not lit_time(strobe, start, end).any():
            continue
        first, last = opened, closed
        if strobe is not None:
            first = max(opened, strobe.delay)
            last = closed if strobe.period is not None else min(closed, strobe.delay + strobe.width)
        found.append(Light(names, strobe, first, last))
    if not found:
        pulsed = next(number for number, source in enumerate(scene.sources) if source.name in scene.strobes)
        raise InputError(
            "no pulse meets the exposure of any row, so that the image would be dark",
            where=f"{scene.origin}: sources[{pulsed}].strobe",
            remedy=f"rows are exposed from {opened * 1e3:.4g} to {closed * 1e3:.4g} ms: change delay",
        )
    bright = {source.name for source in scene.sources if any(one.radiance > 0 for one in emitters(source))}
    return tuple(light for light in found if bright.intersection(light.sources)) or tuple(found)


def places(level: int, seed: int) -> Array:
    """2^level + 1 places from 0 to 1; every second one is those of the level below."""
    found = np.array([0.0, 1.0])
    for lower in range(level):
        width = np.diff(found)
        off = _OFF_MIDDLE * (2 * generator(seed, Rendering.INSTANTS, lower).random(len(width)) - 1)
        finer = np.empty(2 * len(found) - 1)
        finer[::2], finer[1::2] = found, found[:-1] + (0.5 + off) * width
        found = finer
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The instants of one light.

    Attributes
    ----------
    light : Light
        Whose.
    times : ndarray, shape (n,)
        [s].
    weights, without_every_second : ndarray, shape (rows, n)
        How long each counts, as a share of the exposure time: of all, and of every second one alone.
    """

    light: Light
    times: Array
    weights: Array
    without_every_second: Array

    def rows_of(self, number: int) -> tuple[int, int] | None:
        """First row and the one after the last in which an instant counts; None where in none."""
        rows = np.flatnonzero((self.weights[:, number] > 0) | (self.without_every_second[:, number] > 0))
        return (int(rows[0]), int(rows[-1]) + 1) if rows.size else None


def steps_of(scene: Scene, light: Light, level: int, seed: int) -> Steps:
    """The instants of a light; `level` is 1 or more, or 0 for one instant, where nothing moves."""
    (start, end), time = windows_of(scene), scene.camera.exposure_time
    if level == 0:
        times = np.array([(light.first + light.last) / 2])
        weights = shares_of_times(light.strobe, start, end, times) / time
        return Steps(light, times, weights, weights)
    times = light.first + (light.last - light.first) * places(level, seed)
    weights = shares_of_times(light.strobe, start, end, times) / time
    coarse = np.zeros_like(weights)
    coarse[:, ::2] = shares_of_times(light.strobe, start, end, times[::2]) / time
    return Steps(light, times, weights, coarse)


def level_for(path: float, least: int, most: int) -> int:
    """Level at which what moves over so many pixels [px] goes a pixel at most from one instant to the next."""
    return min(max(least, math.ceil(math.log2(max(path, 1.0)))), most)
