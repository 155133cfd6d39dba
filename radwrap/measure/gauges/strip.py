"""Pixels in a strip along a contour, and the least squares of shape, blur and light in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.edges.blur import DISCS, USUAL_SHARE
from radwrap.measure.gauges.rims import Rim, Shape
from radwrap.measure.gauges.step import Step, mixed, pixel_step

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

NARROWEST: Final = 0.02  # px; blur below this is the sharp step
_HARMONIC: Final = 16.0  # px of contour for each harmonic of its light
_HARMONICS: Final = 2
_STEPS: Final = 12  # of Gauss and Newton
DONE: Final = 1e-6  # px; a smaller step is the last
ROUGH: Final = 1e-3  # px; enough to tell which pixels belong to something else
_DEPENDENT: Final = 1e-9  # of the largest: what is less is rounding
_UNSEEN: Final = 0.05  # of a way of length 1 that no pixel sees
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
class Blur:
    """One disc, or a sum of discs, which follows any blur without a side.

    Attributes
    ----------
    radius : float
        Of the first disc [px].
    shares : ndarray, shape (0,) or (others,)
        Of the light that is in the other discs.
    ratios : ndarray, shape (others,)
        Of their radii to the first one's.
    held : float
        Weighted light that a share of 1 weighs as much as.
    """

    radius: float
    shares: Array = field(default_factory=lambda: np.zeros(0))
    ratios: Array = field(default_factory=lambda: np.zeros(0))
    held: float = 0.0

    @property
    def radii(self) -> list[float]:
        """Of all discs [px]."""
        return [self.radius, *(self.radius * self.ratios)]

    @property
    def size(self) -> int:
        """How many of its parameters are fitted: the radius, or the shares at that radius."""
        return self.shares.size or 1

    def changed(self, change: Array) -> Blur:
        """With other shares; or another radius, which at most halves or doubles."""
        if self.shares.size:
            return replace(self, shares=self.shares + change)
        radius = max(self.radius + change[0], self.radius / 2, NARROWEST)
        return replace(self, radius=min(radius, 2 * self.radius + 0.1))

    def distance_from(self, other: Blur) -> float:
        """How far the parameters that are fitted differ [px]."""
        if self.shares.size:
            return float(np.abs(self.shares - other.shares).max()) * self.radius
        return abs(self.radius - other.radius)


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """What the levels are multiplied with.

    Attributes
    ----------
    wide, slow : ndarray, shape (n, terms)
        Functions along the contour, by which levels and their slopes across it change.
    half : ndarray, shape (n,)
        Of two rims half of their distance [px], else 0.
    slopes : ndarray, shape (2, m)
        Of the shape.
    steepness : ndarray, shape (n, ways)
        Functions along the contour, by which slopes from one of two rims to the other change.
    by_disc : sequence of sequence of Step
        What each pixel sees of each rim by each disc of the blur.
    seen : sequence of Step
        The same by all the blur.
    matrix : ndarray, shape (n, levels)
        Of one rim: dark side, its slope, contrast, slope of the contrast. Of two, between which it is bright: dark
        side, contrast of the first rim, and of the second, and the shape's ways to slope.
    """

    wide: Array
    slow: Array
    half: Array
    slopes: Array
    steepness: Array
    by_disc: Sequence[Sequence[Step]]
    seen: Sequence[Step]
    matrix: Array

    @property
    def brightness(self) -> Array:
        """Share of each pixel's light that is bright."""
        share: Array = np.clip(sum(rim.step for rim in self.seen) - (len(self.seen) - 1), 0.0, 1.0)
        return share

    def parts(self, levels: Array) -> list[Array]:
        """Levels by the blocks of columns."""
        wide, slow = self.wide.shape[1], self.slow.shape[1]
        sizes = [wide, slow, wide, slow] if len(self.seen) == 1 else [wide, slow, slow]
        return np.split(levels, np.cumsum(sizes)[:3])

    def at_rims(self, levels: Array) -> list[tuple[Array, Array]]:
        """Contrast of each rim's step, and slope of its ramp."""
        parts = self.parts(levels)
        if len(self.seen) == 1:
            return [(self.wide @ parts[2], self.slow @ parts[3])]
        each = parts[3].reshape(self.steepness.shape[1], self.slopes.shape[1])
        slope = self.steepness @ (each @ self.slopes[1])
        first, second = self.slow @ parts[1], self.slow @ parts[2]
        return [(first - slope * self.half, slope), (second + slope * self.half, -slope)]

    def by_shares(self, levels: Array) -> list[Array]:
        """Derivatives of the light by the shares of the other discs."""
        pairs = list(zip(self.at_rims(levels), self.by_disc, strict=True))
        return [
            np.asarray(
                sum(
                    contrast * (discs[k].step - discs[0].step) + slope * (discs[k].ramp - discs[0].ramp)
                    for (contrast, slope), discs in pairs
                )
            )
            for k in range(1, len(self.by_disc[0]))
        ]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Parameters, blur and levels, and the weighted residual that they leave."""

    parameters: Array
    blur: Blur
    rims: Sequence[Rim]
    terms: Terms
    levels: Array
    residual: Array

    @property
    def cost(self) -> float:
        """Sum of squares."""
        shares = self.blur.held * self.blur.shares
        return float(self.residual @ self.residual + shares @ shares)

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


def terms_of(shape: Shape, rims: Sequence[Rim], blur: Blur, aspect: float) -> Terms:
    """Terms of the levels for rims as they lie."""
    by_disc = [
        [pixel_step(rim.distance, rim.normal, rim.curvature, radius, aspect) for radius in blur.radii] for rim in rims
    ]
    shares = np.concatenate([[1 - blur.shares.sum()], blur.shares])  # all the light is in the discs together
    seen = [mixed(discs, shares) for discs in by_disc]
    wide, slow = _bases(shape, rims)
    half = (rims[0].distance + rims[1].distance) / 2 if len(rims) > 1 else np.zeros(len(slow))
    matrix = _matrix(shape, wide, slow, rims, [(rim.step, rim.ramp) for rim in seen])
    return Terms(wide, slow, half, shape.slopes, _steepness(shape, slow), by_disc, seen, matrix)


def _matrix(shape: Shape, wide: Array, slow: Array, rims: Sequence[Rim], seen: Sequence[tuple[Array, Array]]) -> Array:
    (step, ramp), *others = seen
    if not others:
        parts = [wide, slow * rims[0].distance[:, None], wide * step[:, None], slow * ramp[:, None]]
        return np.concatenate(parts, axis=1)
    parts = [wide, slow * step[:, None], slow * (others[0][0] - 1)[:, None]]
    ways = slopes_of(rims, seen) @ shape.slopes
    return np.concatenate([*parts, *(ways * one for one in _steepness(shape, slow).T[:, :, None])], axis=1)


def _steepness(shape: Shape, slow: Array) -> Array:
    """Across a straight thing light changes alike everywhere; across a ring as the cosine, as it does over a plane."""
    return slow[:, 1:] if shape.closed else slow[:, :1]


def slopes_of(rims: Sequence[Rim], seen: Sequence[tuple[Array, Array]]) -> Array:
    """Light that changes from one of two rims to the other: of the dark side, and between, shape (n, 2) [px]."""
    (step, ramp), (far_step, far_ramp) = seen
    first, second = rims[0].distance, rims[1].distance
    # The distance from the middle where it lies between the rims: beyond the first one, less that beyond the second.
    between = ramp - far_ramp - (first + second) / 2 * (step - far_step + 1) + second
    return np.column_stack([(first - second) / 2, between])


def _bases(shape: Shape, rims: Sequence[Rim]) -> tuple[Array, Array]:
    wide = _basis(shape, rims[0].along, _HARMONICS)
    return wide, wide[:, : 1 + min(1, int(shape.length / _HARMONIC)) * (2 if shape.closed else 1)]


def moved_light(shape: Shape, state: State, rims: Sequence[Rim]) -> Array:
    """Light of the model with its levels where the rims have moved a little."""
    seen = [
        one.moved(new.distance - old.distance, new.curvature - old.curvature)
        for one, new, old in zip(state.terms.seen, rims, state.rims, strict=True)
    ]
    return np.asarray(_matrix(shape, *_bases(shape, rims), rims, seen) @ state.levels)


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
        found.append((moved_light(shape, state, rims) - here) / (1e-4 * unit))
    if state.blur.shares.size:
        found += state.terms.by_shares(state.levels)
    else:
        step = 1e-3 * state.blur.radius
        wider = terms_of(shape, state.rims, replace(state.blur, radius=state.blur.radius + step), strip.aspect)
        found.append((wider.matrix @ state.levels - here) / step)
    whole: Array = np.column_stack([*found, state.terms.matrix]) * strip.weight[:, None]
    held = np.zeros((state.blur.shares.size, whole.shape[1]))
    first = len(shape.units)
    held[:, first : first + state.blur.shares.size] = state.blur.held * np.eye(state.blur.shares.size)
    return np.concatenate([whole, held])


def influence_of(shape: Shape, strip: Strip, state: State) -> tuple[Array, bool]:
    """What an error of each pixel's weighted light, and then of what holds the shares, does to all parameters.

    And whether a change of the shape can be made up for by blur and levels, so that the pixels look the same: such a
    change is left out, and standard errors say nothing then.
    """
    jacobian = jacobian_of(shape, strip, state)
    norms = np.linalg.norm(jacobian, axis=0)
    norms[norms == 0] = 1.0
    left, sizes, ways = np.linalg.svd(jacobian / norms, full_matrices=False)
    seen = sizes > _DEPENDENT * sizes[0]
    unseen = ways[~seen, : len(shape.units)]
    inverse = (ways[seen].T / sizes[seen]) @ left[:, seen].T / norms[:, None]
    return np.asarray(inverse), bool((np.abs(unseen) > _UNSEEN).any())


def solved(shape: Shape, strip: Strip, parameters: Array, blur: Blur, *, done: float = DONE) -> State:
    """Gauss and Newton, with shorter steps where a whole one makes it worse; a step below `done` [px] is the last."""
    state = _state(shape, strip, parameters, blur)
    count = len(parameters)
    for _ in range(_STEPS):
        jacobian = jacobian_of(shape, strip, state)
        left = np.concatenate([state.residual, -state.blur.held * state.blur.shares])
        change = np.linalg.lstsq(jacobian, left, rcond=1e-12)[0][: count + state.blur.size]
        change[:count] = np.clip(change[:count] / shape.units, -1.0, 1.0) * shape.units
        tried = state
        for share in _SHARES:
            there = state.parameters + share * change[:count]
            tried = _state(shape, strip, there, state.blur.changed(share * change[count:]))
            if tried.cost <= state.cost:
                break
        else:
            return state
        moved = float(np.abs((tried.parameters - state.parameters) / shape.units).max())
        size = max(moved, tried.blur.distance_from(state.blur))
        state = tried
        if size < done:
            break
    return state


def any_blur(shape: Shape, strip: Strip, disc: State, before: Blur | None = None, *, done: float = DONE) -> State:
    """From the best fit with one disc that with a sum of discs; it may begin with the shares of an earlier one."""
    held = math.sqrt(disc.cost / max(strip.light.size, 1)) / USUAL_SHARE
    radius, shares = disc.blur.radius, np.zeros(len(DISCS))
    if before is not None and before.shares.size:
        shares = before.shares
    # A disc larger than the strip is all but a slope there.
    largest = max(float(np.abs(rim.distance).max()) for rim in disc.rims)
    blur = Blur(radius, shares, np.minimum(DISCS, largest / radius), held)
    return solved(shape, strip, disc.parameters, blur, done=done)


def _state(shape: Shape, strip: Strip, parameters: Array, blur: Blur, levels: Array | None = None) -> State:
    """Rims, terms and what is left; levels by least squares, where none are given."""
    rims = shape.rims(parameters, strip.places)
    terms = terms_of(shape, rims, blur, strip.aspect)
    weighted, light = terms.matrix * strip.weight[:, None], strip.light * strip.weight
    if levels is None:
        levels = np.asarray(np.linalg.lstsq(weighted, light, rcond=1e-10)[0], dtype=np.float64)
    return State(parameters, blur, rims, terms, levels, light - weighted @ levels)


def carried(shape: Shape, strip: Strip, state: State) -> State:
    """The same parameters, blur and levels, and what they leave of other pixels."""
    return _state(shape, strip, state.parameters, state.blur, state.levels)


def lit_anew(shape: Shape, strip: Strip, state: State) -> State:
    """The same parameters and blur, and the levels that suit other pixels best."""
    return _state(shape, strip, state.parameters, state.blur)
