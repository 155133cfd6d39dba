"""Whether the stretches that were left out show the same contour at another place.

A fit leaves out what does not look like its contour, be it a neighbour, a burr or a notch, and the rest is measured as
if nothing were beside it. Of a rim that is torn, by a shock or by lines that a camera lost, the other part is the same
contour elsewhere, and nobody knows which of both is meant. A circle of the same radius is looked for there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.step import mixed, pixel_step
from radwrap.measure.gauges.stretches import BLOCK, blocks_of
from radwrap.measure.gauges.strip import State, Strip

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_SHORT: Final = BLOCK / 2  # px along the contour, of stretches of which it ends within one
_FEWEST: Final = 5  # stretches, that lie elsewhere together
_LEAST: Final = 0.1  # of the contour, likewise: a straight side is as good as an arc over less
_FEWEST_PIXELS: Final = 12  # of a stretch
_ALIKE: Final = 2.0  # times what the fit leaves of stretches that were kept
_CONTRASTS: Final = (0.5, 2.0)  # of theirs
_FARTHEST: Final = 7.0  # px
_APART: Final = 1.0  # px from one place that is tried to the next


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Pixels of some stretches, fitted with a step of light in each by itself, at one distance from the contour."""

    shape: Shape
    strip: Strip
    state: State
    number: NDArray[np.intp]
    count: int

    def met(self, moved: Array) -> tuple[Array, Array]:
        """What a contour moved by so much of its first two units leaves in each, rms, and the contrasts there."""
        parameters = self.state.parameters.copy()
        parameters[:2] += moved * self.shape.units[:2]
        rim = self.shape.rims(parameters, self.strip.places)[0]
        blur = self.state.blur
        shares = np.concatenate([[1 - blur.shares.sum()], blur.shares])
        discs = [
            pixel_step(rim.distance, rim.normal, rim.curvature, radius, self.strip.aspect) for radius in blur.radii
        ]
        step, light, weight = mixed(discs, shares).step, self.strip.light, self.strip.weight**2

        def total(values: Array) -> Array:
            return np.bincount(self.number, values * weight, minlength=self.count).astype(np.float64)

        whole = np.maximum(total(np.ones_like(step)), 1e-300)
        off = step - (total(step) / whole)[self.number]
        power = total(off * off)
        contrast = total(off * light) / np.maximum(power, 1e-300)
        left = light - (total(light) / whole)[self.number] - contrast[self.number] * off
        free = np.maximum(np.bincount(self.number, minlength=self.count) - 2, 1)
        return np.sqrt(total(left * left) / free), contrast


def lies_elsewhere(shape: Shape, wide: Strip, state: State, sound: Flags) -> tuple[float, float] | None:
    """Share of a round contour that was left out and is the same one at another place, and how far that is [px].

    Parameters
    ----------
    shape : Shape
        Of one rim, whose first two parameters are its centre.
    wide, state
        Pixels also farther away, and the fit.
    sound : ndarray of bool
        Which stretches show the contour.

    Returns
    -------
    share, away : float
        None where no such part is seen.
    """
    from scipy.optimize import minimize

    if len(shape.units) < 3 or len(state.rims) > 1 or sound.all():
        return None
    rims = shape.rims(state.parameters, wide.places)
    block, count = blocks_of(shape, rims, _SHORT)
    number = np.bincount(block, minlength=count)
    share = np.bincount(block, sound[blocks_of(shape, rims)[0]], minlength=count) / np.maximum(number, 1)
    enough = number >= _FEWEST_PIXELS
    kept, rest = (_of(shape, wide, state, block, enough & some) for some in (share == 1, share == 0))
    needed = max(_FEWEST, math.ceil(_LEAST * count))
    if kept.count == 0 or rest.count < needed:
        return None
    rms, contrasts = kept.met(np.zeros(2))
    usual, contrast = max(float(np.median(rms)), 1e-300), float(np.median(contrasts))

    def cost(moved: Array) -> float:
        return float(np.log1p((rest.met(moved)[0] / usual) ** 2).sum())

    ways = np.arange(-_FARTHEST, _FARTHEST + _APART / 2, _APART)
    tried = [np.array([x, y]) for x in ways for y in ways if 0 < math.hypot(x, y) <= _FARTHEST]
    begins = sorted(tried, key=cost)[:2]
    found = min(
        (minimize(cost, at, method="Nelder-Mead", options={"xatol": 0.01}) for at in begins), key=lambda r: r.fun
    )
    left, there = rest.met(found.x)
    low, high = sorted(contrast * share for share in _CONTRASTS)
    good = (left < _ALIKE * usual) & (there > low) & (there < high)
    return (float(good.sum() / count), float(np.hypot(*found.x))) if good.sum() >= needed else None


def _of(shape: Shape, wide: Strip, state: State, block: NDArray[np.intp], some: Flags) -> _Stretches:
    here = some[block]
    number = (np.cumsum(some) - 1)[block[here]]
    return _Stretches(shape, wide.only(here), state, number, int(some.sum()))
