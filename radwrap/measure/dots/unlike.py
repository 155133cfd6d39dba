"""Which dots do not look like the others: a dark middle, a scratch that parts it, a highlight, a shadow or dirt.

All definitions of a centre take a dot for a disc of even light. What is missing or added on one side moves the centre,
and no standard error of noise holds that. The dots of a board look alike, though: the light of each as a function of
the distance from its rim, in units of its own level, is that of the usual one, the median of all. A dot's level, ground
and place are fitted to it by robust least squares, and what is left is held against the noise of its pixels, which is
that of all dots: how much it is, and how far it moves the centroid of the light, which a small highlight near the rim
does while little differs. Dots that are all weak in the middle are alike, and that is looked for by itself: their
level is taken there, and thresholds hang on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.dots.centres import Window

Field = NDArray[np.float64]

# Of the level, rms over a dot's window, from which on light differs by more than pixels' places make of a sharp rim.
LEAST: Final = 0.02
# The same where dots run together: the model that takes neighbours' light away leaves up to a half of this.
LEAST_TOUCHING: Final = 0.06
_TIMES: Final = 4.0  # what is usual on the board: fall-off and tilt make all dots differ a little
_SIGMAS: Final = 6.0  # beyond noise
# The same of half as much: where the others are alike to that, it is a spot on the rim, which moves an ellipse.
_FAINT: Final = 0.5
_FAINT_SIGMAS: Final = 8.0
# Where light differs beyond noise, but by less than that, a centroid that it moves by so much is a matter: px,
# times what is usual, and standard errors, as noise moves it on one of 200 boards of 30 dots at most.
_MOVES: Final = 0.02
_MOVES_TIMES: Final = 3.0
_MOVES_SIGMAS: Final = 4.2
_HOLLOW: Final = 0.1  # of a dot's level, by which its middle may be weaker than what lies around it
_MIDDLE: Final = 0.4  # radii, that are its middle
_FEWEST: Final = 4  # dots that tell what is usual
_STEP: Final = 0.5  # px between places of the usual light
_ROUNDS: Final = 2  # of the usual light and the fits
_FITS: Final = 4  # of one dot, with weights by what the one before left
_HUBER: Final = 1.5  # standard deviations
_BODY: Final = 0.8  # radii, within which the first level is looked for
_BRIGHT: Final = 0.75  # quantile of the body's light that is its level, if a part of it is dark
_NORMAL: Final = 1.4826  # standard deviations in a median of absolute values


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """Whether dots look like one another, and like a disc.

    Attributes
    ----------
    unlike : ndarray, shape (n,)
        Of each dot: rms over its window of what its light differs by from the usual dot's, beyond noise, as a share of
        its level; 0 where that is by chance, or as of the others, and does not move its centroid.
    hollow : float
        By how much the usual dot is weaker in its middle than around it, as a share of its level; 0 where it is not.
    """

    unlike: Field
    hollow: float


@dataclass(slots=True)
class _Seen:
    """The pixels of one dot: place from the middle [px], distance from the rim [px], its slope, and light.

    The mean radius [px]; level, ground and shift are those of the fit so far.
    """

    place: Field
    distance: Field
    slope: Field
    light: Field
    radius: float
    level: float
    ground: float
    shift: Field

    @classmethod
    def of(cls, window: Window) -> _Seen:
        """Of a window."""
        rows, columns = np.nonzero(window.inside)
        light = window.signal[rows, columns]
        place = window.origin + np.column_stack([columns, rows]) - window.place
        to_disc = np.linalg.inv(window.affine) / window.radius
        on_disc = place @ to_disc.T
        away = np.maximum(np.hypot(*on_disc.T), 1e-6)
        # Pixels to a radius in the direction of each; in the very middle there is none.
        pixels = np.hypot(*(on_disc @ np.linalg.inv(to_disc).T).T) / away
        radius = math.sqrt(abs(1 / float(np.linalg.det(to_disc))))
        pixels = np.where(away > 1e-3, pixels, radius)
        body = light[away < _BODY]
        level = float(np.quantile(body, _BRIGHT)) if body.size else window.level
        slope = (on_disc @ to_disc) * (pixels / away)[:, None]
        return cls(place, (away - 1) * pixels, slope, light, radius, max(level, 1e-9), 0.0, np.zeros(2))

    @property
    def moved(self) -> Field:
        """Distance from the rim at the fitted place [px]."""
        return np.asarray(self.distance - self.slope @ self.shift)


@dataclass(frozen=True, slots=True)
class _Usual:
    """The median of all dots' light over the distance from the rim, in units of the level."""

    first: float
    light: Field

    @classmethod
    def of(cls, dots: Sequence[_Seen]) -> _Usual:
        """Of dots."""
        first = min(float(dot.distance.min()) for dot in dots) - 1
        count = math.ceil((max(float(dot.distance.max()) for dot in dots) + 1 - first) / _STEP) + 1
        means = np.stack(
            [_binned((dot.moved - first) / _STEP, (dot.light - dot.ground) / dot.level, count) for dot in dots]
        )
        known = np.isfinite(means).any(axis=0)
        places = np.arange(count)
        return cls(first, np.interp(places, places[known], np.nanmedian(means[:, known], axis=0)))

    def hollow(self, radius: float) -> float:
        """By how much the middle of such a dot is weaker than the strongest light around it, over that [1]."""
        share = (self.first + _STEP * np.arange(len(self.light))) / radius + 1
        inside = share < 1
        middle = inside & (share < max(_MIDDLE, float(share[share > 0].min(initial=1.0)) + 1e-9))
        strongest = float(self.light[inside].max(initial=0.0))
        return 1 - float(self.light[middle].min()) / strongest if strongest > 0 and middle.any() else 0.0

    def at(self, distance: Field) -> tuple[Field, Field]:
        """Light, and its slope [1/px]."""
        where = (distance - self.first) / _STEP
        places = np.arange(len(self.light))
        return np.interp(where, places, self.light), np.interp(where, places, np.gradient(self.light, _STEP))


def _binned(where: Field, values: Field, count: int) -> Field:
    """Means about whole numbers, each value shared between its two; NaN where there is none."""
    left = np.clip(where, 0, count - 1.001)
    index = left.astype(np.intp)
    share = left - index
    weight = np.bincount(index, 1 - share, count) + np.bincount(index + 1, share, count)
    total = np.bincount(index, (1 - share) * values, count) + np.bincount(index + 1, share * values, count)
    return np.where(weight > 0.5, total / np.maximum(weight, 0.5), np.nan)


def likeness_of(windows: Sequence[Window | None], touching: NDArray[np.bool_], noise: float) -> Likeness:
    """Hold each dot against the usual one, and that against a disc.

    Parameters
    ----------
    windows : sequence of Window or None
        Of all dots of a board, the fall-off of light over each taken out where it is known.
    touching : ndarray of bool, shape (n,)
        Whether a dot's light runs into a neighbour's.
    noise : float
        Standard deviation of a pixel [gray].

    Returns
    -------
    Likeness
    """
    found: Field = np.zeros(len(windows))
    seen = {
        number: _Seen.of(one) for number, one in enumerate(windows) if one is not None and one.inside.sum() > _FEWEST
    }
    if len(seen) < _FEWEST:
        return Likeness(found, 0.0)
    left: dict[int, tuple[Field, Field]] = {}
    usual = _Usual.of(list(seen.values()))
    for again in range(_ROUNDS):
        usual = _Usual.of(list(seen.values())) if again else usual
        left = {number: _fitted(dot, usual, noise) for number, dot in seen.items()}
    ground, by_light = _noise(list(left.values()), noise)
    excess, sigma, moved, moved_sigma = np.zeros((4, len(windows)))
    for number, (residual, light) in left.items():
        variance = ground + by_light * np.maximum(light, 0.0)
        level = max(seen[number].level, 1e-9)
        excess[number] = float(np.mean(residual**2 - variance)) / level**2
        sigma[number] = math.sqrt(2 * float(np.sum(variance**2))) / len(variance) / level**2
        moved[number], moved_sigma[number] = _moved(seen[number], residual, variance)
    share = np.sqrt(np.maximum(excess, 0.0))
    usually = float(np.median(share[list(seen)]))
    least = np.where(touching, LEAST_TOUCHING, LEAST)
    differs = (share > least) & (excess > _SIGMAS * sigma)
    differs |= (share > _FAINT * least) & (excess > _FAINT_SIGMAS * sigma)
    moves = np.maximum(_MOVES_SIGMAS * moved_sigma, max(_MOVES, _MOVES_TIMES * float(np.median(moved[list(seen)]))))
    far = (differs & (share > _TIMES * usually)) | ((moved > moves) & (excess > _SIGMAS * sigma))
    found[far] = share[far]
    dots = list(seen.values())
    hollow = usual.hollow(float(np.median([dot.radius for dot in dots])))
    # What noise makes of the mean of the pixels in all middles, of each of which the same light is expected.
    middles = sum(int((dot.distance < (_MIDDLE - 1) * dot.radius).sum()) for dot in dots)
    level = float(np.median([dot.level for dot in dots]))
    error = math.sqrt((ground + by_light * level) / max(middles, 1)) / level
    return Likeness(found, hollow if hollow > _HOLLOW + _SIGMAS * error else 0.0)


def _fitted(dot: _Seen, usual: _Usual, noise: float) -> tuple[Field, Field]:
    """Fit level, ground and shift of a dot; what is left, and the fitted light [gray]."""
    shape, slope = usual.at(dot.moved)
    model = np.column_stack([shape, np.ones_like(shape), -slope[:, None] * dot.slope])
    weight = np.ones(len(shape))
    solved, residual = np.zeros(4), dot.light
    for _ in range(_FITS):
        weighted = model.T * weight
        solved = np.asarray(np.linalg.lstsq(weighted @ model, weighted @ dot.light, rcond=None)[0], dtype=np.float64)
        residual = np.asarray(dot.light - model @ solved)
        spread = max(_NORMAL * float(np.median(np.abs(residual))), noise, 1e-9 * dot.level)
        weight = 1 / np.maximum(1.0, np.abs(residual) / (_HUBER * spread))
    if solved[0] > 0:
        dot.level, dot.ground = float(solved[0]), float(solved[1])
        dot.shift = dot.shift + np.clip(solved[2:] / solved[0], -1.0, 1.0)
    return residual, np.asarray(solved[0] * shape)


def _moved(dot: _Seen, residual: Field, variance: Field) -> tuple[float, float]:
    """How far what a fit leaves of a dot moves the centroid of its light, and the standard error by axis [px]."""
    total = max(float(np.sum(dot.light - dot.ground)), 1e-9 * dot.level)
    lever = (dot.place - dot.shift) / total
    return float(np.hypot(*(residual @ lever))), math.sqrt(float(np.sum(variance[:, None] * lever**2)) / 2)


def _noise(left: Sequence[tuple[Field, Field]], least: float) -> tuple[float, float]:
    """Variance of a pixel off the dots, and how it grows with their light, by medians over all dots."""
    residual, light = (np.concatenate(part) for part in zip(*left, strict=True))
    bright = light > 0.5 * float(np.quantile(light, 0.95))
    ground = least**2
    if (~bright).any():
        ground = max(ground, (_NORMAL * float(np.median(np.abs(residual[~bright])))) ** 2)
    there = (_NORMAL * float(np.median(np.abs(residual[bright])))) ** 2 if bright.any() else ground
    return ground, max(there - ground, 0.0) / max(float(np.median(light[bright])), 1e-9) if bright.any() else 0.0
