"""Blocks of the central image that mostly change smoothly, though nothing proves it: in half shadows of wide lights.

What lies between their corners is taken where the middle does not contradict. How far it is off is found by rays of
their own, at places that were drawn: an unbiased sample of the squared error, from which its bound comes. A corner is
the mean of some rays beside each other, as each has the noise of the points of the light that it asks.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.smooth_blocks import bundles, retraced
from radwrap.imaging.optics.smooth import BLOCK, SmoothField, mean_of_corners, most_about
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tolerance.bounds import Bounded, stratified_mean
from radwrap.random_streams import Rendering, generator

Array = NDArray[np.float64]

# Fewer blocks are not worth their sample.
_FEWEST: Final = 64
# Rays along each side of a square of a pixel about a middle, and about a corner: a block of smaller cells takes more.
_PILOTS: Final = 2
_BESIDE: Final = (2, 3, 4, 6, 8, 12, 16, 24)
# Of the tolerance: noise of what lies between corners, and all error of these blocks.
_NOISE_SHARE: Final = 0.15
_ERROR_SHARE: Final = 0.4
# Mean over a block of the summed squares of its corners' weights.
_BETWEEN: Final = 4 / 9
# How far a middle may be off: in standard errors of the noise, and in shares of the tolerance; tried in turn.
_ALLOWED: Final = ((2.0, 0.2), (1.5, 0.1), (1.0, 0.05))
_SAMPLED: Final = 4096  # blocks, at most
_MOST_ASKED: Final = 64


def with_sampled_blocks(view: View, field: SmoothField, tolerance: float, seed: int) -> SmoothField:
    """Add blocks that may be smooth to those that are, as far as a sample of them keeps its share of the tolerance.

    Parameters
    ----------
    view : View
        Who traces.
    field : SmoothField
        What is smooth, and may be.
    tolerance : float
        Of the image [gray level].
    seed : int
        Of the places of the sample.
    """
    if np.count_nonzero(field.likely) < _FEWEST:
        return field
    most = (_NOISE_SHARE * tolerance) ** 2
    places = field.corners
    u, v = (corner[:-1, :-1][field.likely] + BLOCK / 2 for corner in places)
    pilots = bundles(view, (u, v), _PILOTS)
    middle, noise = pilots.mean(axis=0), np.zeros(field.likely.shape)
    noise[field.likely] = _gray(view, pilots).var(axis=0, ddof=1)
    sides = np.array(_BESIDE, dtype=np.int8)
    wanted = np.searchsorted(sides.astype(np.float64) ** 2, _BETWEEN * noise / most)
    likely = field.likely & (wanted < len(sides))
    beside = most_about(np.where(likely, sides[np.minimum(wanted, len(sides) - 1)], np.int8(1)))
    values = field.values.copy()
    rays = field.rays + pilots.size + retraced(view, values, places, beside)
    field = replace(field, values=values, beside=beside, rays=rays)
    off = np.zeros(noise.shape)
    off[field.likely] = np.abs(_gray(view, middle) - _gray(view, field.at(u, v)[0]))
    error = np.sqrt(noise / _PILOTS**2 + mean_of_corners(most_about(noise) / beside.astype(np.float64) ** 2) / 4)
    for noises, share in _ALLOWED:
        kept = likely & (off <= noises * error + share * tolerance)
        if np.count_nonzero(kept) < _FEWEST:
            break
        halves = _sample(view, field, kept, most / float(noise[kept].mean() or most), seed)
        field = replace(field, rays=field.rays + halves.size)
        square = _square(halves.mean(axis=1), np.count_nonzero(kept) / kept.size, seed)
        if square.upper <= (_ERROR_SHARE * tolerance) ** 2:
            both = Bounded(field.square, field.upper) + square
            return replace(field, smooth=field.smooth | kept, square=both.mean, upper=both.upper)
    return field


def _sample(view: View, field: SmoothField, kept: NDArray[np.bool_], enough: float, seed: int) -> Array:
    """What rays see less what lies between corners [gray level], at a place in each of some blocks.

    Two bundles of rays at each place, shape (2, rays, blocks): so many that what noise leaves in the mean of products
    of two is no more than the share that is enough of one ray's.
    """
    random = generator(seed, Rendering.SAMPLED_BLOCKS)
    blocks = np.flatnonzero(kept)
    if len(blocks) > _SAMPLED:
        blocks = random.choice(blocks, _SAMPLED, replace=False)
    row, column = np.divmod(blocks, kept.shape[1])
    inside = random.random((2, len(blocks)))
    v = BLOCK * (field.first[0] + row + inside[0]) - 0.5
    u = BLOCK * (field.first[1] + column + inside[1]) - 0.5
    asked = min(max(math.ceil(2 / (enough * math.sqrt(len(blocks)))), 1), _MOST_ASKED)
    du, dv = random.uniform(-0.5, 0.5, (2, 2, asked, len(blocks)))
    value, _ = trace_rays(view, None, (u + du).ravel(), (v + dv).ravel())
    seen: Array = _gray(view, value.reshape(du.shape)) - _gray(view, field.at(u, v)[0])
    return seen


def _square(halves: Array, share: float, seed: int) -> Bounded:
    """Mean square over the image of what two independent errors, shape (2, blocks), have in common."""
    stratum = np.zeros(halves.shape[1], dtype=np.intp)
    return stratified_mean(halves[0] * halves[1], stratum, np.array([share]), (seed, Rendering.SAMPLED_BLOCKS, 1))


def _gray(view: View, radiance: Array) -> Array:
    return unclipped_gray(radiance * view.exposure_of_radiance, view.camera.sensor)
