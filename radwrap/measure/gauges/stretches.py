"""Stretches of a contour: which of them show it, and which pixels of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Rim, Shape
from radwrap.measure.gauges.strip import Blur, State, Strip, nearest_of, terms_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_OUTLIER: Final = 4.5  # standard deviations
BLOCK: Final = 8.0  # px along the contour
_SHORTEST_CONTOUR: Final = 8  # blocks of a short contour, which are then shorter
_BAD_BLOCK: Final = 2.0  # times the usual rms of a block, from where on it shows something else
# Quantile of a rim's blocks' rms that is usual, where some show something else. Of two rims the larger one is: without
# noise one may be met many times as closely as the other, and all of this one would be left out.
_USUAL: Final = 0.35
_FULL_CONTRAST: Final = 0.9  # quantile of the stretches' contrasts that is the contour's, where some have none
_FLAT: Final = 0.3  # of it; a stretch of less does not show the contour
_FLAT_SIGMAS: Final = 3.0  # so far below, or noise decides
_BOTH_SIDES: Final = 0.02  # variance of the brightness, without which a stretch sees one side only
FEWEST_BLOCKS: Final = 6
LEAST_CONTOUR: Final = 0.4  # of it must be seen as the model has it


def stepping_of(shape: Shape, strip: Strip, at: tuple[Array, Blur]) -> tuple[Flags, float]:
    """Pixels of stretches across which light steps, and the share of the contour that these are.

    Levels of the model change along the contour. Where it is not there, a contrast of nothing would fit, and such a
    stretch would count as seen and bend the levels of the others.
    """
    rims = shape.rims(at[0], strip.places)
    bright = terms_of(shape, rims, at[1], strip.aspect).brightness
    block, count = blocks_of(shape, rims)
    number = np.bincount(block, minlength=count)
    some = np.maximum(number, 1)

    def product(one: Array, other: Array) -> Array:
        """Covariance in each stretch."""
        sums = [np.bincount(block, values, minlength=count) / some for values in (one * other, one, other)]
        return np.asarray(sums[0] - sums[1] * sums[2])

    light = strip.light - strip.light.mean()
    power, both = product(bright, bright), product(bright, light)
    known = (number > 2) & (power > _BOTH_SIDES)
    if known.sum() < FEWEST_BLOCKS:
        return np.ones(len(block), dtype=np.bool_), 1.0
    # Of two rims the model has a sign: between them it may be dark.
    contrast = math.copysign(1.0, float(both[known].sum())) * both / np.where(known, power, 1.0)
    rest = np.maximum(product(light, light) - contrast**2 * power, 0.0)
    sigma = np.sqrt(rest / np.maximum(number - 2, 1) / np.where(known, power, 1.0))
    usual = float(np.quantile(contrast[known], _FULL_CONTRAST))
    flat = known & (contrast + _FLAT_SIGMAS * sigma < _FLAT * usual)
    return ~flat[block], 1 - float(flat.sum() / (number > 0).sum())


def kept_of(shape: Shape, state: State) -> tuple[Flags, float, Flags]:
    """Pixels that show the contour, the share of the stretches that do, and which these are."""
    scale = max(spread_of(state.residual), 1e-300)
    block, count = blocks_of(shape, state.rims)
    number = np.bincount(block, minlength=count)
    seen = number > 0
    if seen.sum() < FEWEST_BLOCKS:
        return np.abs(state.residual) < _OUTLIER * scale, 1.0, np.ones(count, dtype=np.bool_)
    square = np.bincount(block, np.minimum((state.residual / scale) ** 2, 100.0), minlength=count)
    rms = np.sqrt(square / np.maximum(number, 1))
    by_rim = zip(np.split(rms, len(state.rims)), np.split(seen, len(state.rims)), strict=True)
    usual = max(float(np.quantile(blocks[here], _USUAL)) for blocks, here in by_rim if here.any())
    bad = seen & (rms > _BAD_BLOCK * usual)
    # What something else shows is no measure of what the others leave.
    good = np.abs(state.residual) < _OUTLIER * max(spread_of(state.residual[~bad[block]]), 1e-300)
    return good & ~bad[block], 1 - float(bad.sum() / seen.sum()), seen & ~bad


def pixels_of(shape: Shape, rims: Sequence[Rim], sound: Flags) -> Flags:
    """Pixels of some stretches, if these are enough; else all."""
    some = sound[blocks_of(shape, rims)[0]]
    return some if some.mean() > LEAST_CONTOUR else np.ones_like(some)


def with_next(off: Flags, shape: Shape, rims: int) -> Flags:
    """Stretches that show something else on one of the rims, and those next to them: its blur reaches there."""
    here: Flags = np.any(off.reshape(rims, -1), axis=0, keepdims=True)[0]
    wide = here.copy()
    wide[1:] |= here[:-1]
    wide[:-1] |= here[1:]
    if shape.closed:
        wide[0] |= here[-1]
        wide[-1] |= here[0]
    return np.tile(wide, rims)


def blocks_of(shape: Shape, rims: Sequence[Rim], length: float = BLOCK) -> tuple[NDArray[np.intp], int]:
    """Number of each pixel's stretch of the contour, and how many there are."""
    count = max(_SHORTEST_CONTOUR, round(shape.length / length))
    share = np.clip(rims[0].along / shape.length, 0, 1 - 1e-9)
    return np.asarray((share * count).astype(np.intp) + count * nearest_of(rims)), count * len(rims)


def spread_of(values: Array) -> float:
    """Standard deviation, by the median of what few are off, but not below half of the plain one."""
    if values.size == 0:
        return 0.0
    return max(1.4826 * float(np.median(np.abs(values))), 0.5 * float(np.sqrt(np.mean(values**2))))
