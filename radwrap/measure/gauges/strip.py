"""Pixels in a strip along a contour, and the least squares of shape, blur and light in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Rim, Shape
from radwrap.measure.gauges.step import pixel_step

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

NARROWEST: Final = 0.02  # px; blur below this is the sharp step
_HARMONIC: Final = 16.0  # px of contour for each harmonic of its light
_HARMONICS: Final = 2
_STEPS: Final = 12  # of Gauss and Newton
_DONE: Final = 1e-6  # px; a smaller step is the last
ROUGH: Final = 1e-3  # px; enough to tell which pixels belong to something else
_SHARES: Final = (1.0, 0.5, 0.25, 0.1)  # of a step, where a whole one makes it worse


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Pixels near a contour.

    Attributes
    ----------
    places : ndarray, shape (n, 2)
        In pixel widths.
    light, slope, weight : ndarray, shape (n,)
        What they see, its slope by gray, and one over the standard deviation of its noise.
    aspect : float
        Height of a pixel over its width.
    """

    places: Array
    light: Array
    slope: Array
    weight: Array
    aspect: float

    def only(self, some: Flags) -> Strip:
        """Some of the pixels."""
        return Strip(self.places[some], self.light[some], self.slope[some], self.weight[some], self.aspect)


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """What the levels are multiplied with.

    Attributes
    ----------
    wide, slow : ndarray, shape (n, terms)
        Functions along the contour, by which levels and their slopes across it change.
    steps : sequence of ndarray, shape (n,)
        Share of each pixel's light that is bright, by each rim.
    matrix : ndarray, shape (n, levels)
        Of one rim: dark side, its slope, contrast, slope of the contrast. Of two, between which it is bright: dark
        side, contrast of the first rim, and of the second.
    """

    wide: Array
    slow: Array
    steps: Sequence[Array]
    matrix: Array

    @property
    def brightness(self) -> Array:
        """Share of each pixel's light that is bright."""
        share: Array = np.clip(np.asarray(sum(self.steps)) - (len(self.steps) - 1), 0.0, 1.0)
        return share

    def parts(self, levels: Array) -> list[Array]:
        """Levels by the blocks of columns."""
        wide, slow = self.wide.shape[1], self.slow.shape[1]
        sizes = [wide, slow, wide, slow] if len(self.steps) == 1 else [wide, slow, slow]
        return np.split(levels, np.cumsum(sizes)[:-1])


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Parameters, blur and levels, and the weighted residual that they leave."""

    parameters: Array
    blur: float
    rims: Sequence[Rim]
    terms: Terms
    levels: Array
    residual: Array

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    @property
    def fitted(self) -> Array:
        """Light as the model has it."""
        return np.asarray(self.terms.matrix @ self.levels, dtype=np.float64)

    @property
    def nearest(self) -> NDArray[np.intp]:
        """Which rim is nearer, pixel by pixel."""
        return nearest_of(self.rims)


def nearest_of(rims: Sequence[Rim]) -> NDArray[np.intp]:
    """Which rim is nearer, pixel by pixel."""
    number: NDArray[np.intp] = np.argmin([np.abs(rim.distance) for rim in rims], axis=0)
    return number


def terms_of(shape: Shape, rims: Sequence[Rim], blur: float, aspect: float) -> Terms:
    """Terms of the levels for rims as they lie."""
    along = rims[0].along
    wide = _basis(shape, along, _HARMONICS)
    slow = wide[:, : 1 + min(1, int(shape.length / _HARMONIC)) * (2 if shape.closed else 1)]
    seen = [pixel_step(rim.distance, rim.normal, rim.curvature, blur, aspect) for rim in rims]
    steps = [step for step, _ in seen]
    if len(rims) == 1:
        parts = [wide, slow * rims[0].distance[:, None], wide * steps[0][:, None], slow * seen[0][1][:, None]]
    else:
        parts = [wide, slow * steps[0][:, None], slow * (steps[1] - 1)[:, None]]
    return Terms(wide, slow, steps, np.concatenate(parts, axis=1))


def _basis(shape: Shape, along: Array, most: int) -> Array:
    """Slowly changing functions along the contour, shape (n, terms)."""
    count = min(most, int(shape.length / _HARMONIC))
    if shape.closed:
        turn = 2 * math.pi * along / shape.length
        waves = [wave(k * turn) for k in range(1, count + 1) for wave in (np.cos, np.sin)]
        return np.column_stack([np.ones_like(along), *waves])
    x = 2 * along / shape.length - 1
    return np.column_stack([x**k for k in range(count + 1)])


def jacobian_of(shape: Shape, strip: Strip, state: State) -> Array:
    """Weighted derivatives by shape and blur with the levels as they are, then by the levels."""
    here = state.fitted
    found = []
    for number, unit in enumerate(shape.units):
        moved = state.parameters.copy()
        moved[number] += 1e-4 * unit
        rims = shape.rims(moved, strip.places)
        found.append((terms_of(shape, rims, state.blur, strip.aspect).matrix @ state.levels - here) / (1e-4 * unit))
    step = 1e-3 * state.blur
    wider = terms_of(shape, state.rims, state.blur + step, strip.aspect).matrix @ state.levels
    whole: Array = np.column_stack([*found, (wider - here) / step, state.terms.matrix]) * strip.weight[:, None]
    return whole


def solved(shape: Shape, strip: Strip, parameters: Array, blur: float, *, done: float = _DONE) -> State:
    """Gauss and Newton, with shorter steps where a whole one makes it worse; a step below `done` [px] is the last."""
    state = _state(shape, strip, parameters, blur)
    count = len(parameters)
    for _ in range(_STEPS):
        jacobian = jacobian_of(shape, strip, state)
        change = np.linalg.lstsq(jacobian, state.residual, rcond=1e-12)[0][: count + 1]
        change[:count] = np.clip(change[:count] / shape.units, -1.0, 1.0) * shape.units
        tried = state
        for share in _SHARES:
            blurred = min(max(state.blur + share * change[count], state.blur / 2, NARROWEST), 2 * state.blur + 0.1)
            tried = _state(shape, strip, state.parameters + share * change[:count], blurred)
            if tried.cost <= state.cost:
                break
        else:
            return state
        size = max(np.abs((tried.parameters - state.parameters) / shape.units).max(), abs(tried.blur - state.blur))
        state = tried
        if size < done:
            break
    return state


def _state(shape: Shape, strip: Strip, parameters: Array, blur: float) -> State:
    rims = shape.rims(parameters, strip.places)
    terms = terms_of(shape, rims, blur, strip.aspect)
    weighted = terms.matrix * strip.weight[:, None]
    levels = np.asarray(np.linalg.lstsq(weighted, strip.light * strip.weight, rcond=1e-10)[0], dtype=np.float64)
    return State(parameters, blur, rims, terms, levels, strip.light * strip.weight - weighted @ levels)
