"""Blocks of the central image that mostly change smoothly, though nothing proves it: in half shadows of wide lights.

What lies between their corners is taken where the middle does not contradict. How far it is off is found by rays of
their own, at places that were drawn: an unbiased sample of the squared error, from which its bound comes. Each ray has
the noise of the points of the lights that it asks, so that those through corners ask more of them. Where blocks are
not smooth, as something is near, those of half the size and of a quarter may be.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.smooth_blocks import bundles, finer_field, retraced
from radwrap.imaging.optics.smooth import BLOCK, SmoothField, mean_of_corners, most_about
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tolerance.bounds import Bounded, stratified_mean
from radwrap.random_streams import Rendering, generator
from radwrap.tracers.noise import FALL, MOST_DOUBLINGS

Array = NDArray[np.float64]

# Fewer blocks are not worth their sample.
_FEWEST: Final = 64
# Rays along each side of a square of a pixel about a middle.
_PILOTS: Final = 2
_PILOT_HALVINGS: Final = 1  # of the points of wide lights that they ask
_SIZES: Final = 3  # of blocks, each half of the one before
# Of the tolerance: noise of what lies between corners, and all error of these blocks.
_NOISE_SHARE: Final = 0.3
# Of the smaller blocks, which fill less of the image and have more corners, a larger one: with a corner for each four
# pixels it would cost as much as rays through these.
_BY_SIZE: Final = 5 / 3
_ERROR_SHARE: Final = 0.5
# Mean over a block of the summed squares of its corners' weights.
_BETWEEN: Final = 4 / 9
# How far a middle may be off: in standard errors of the noise, and in shares of the tolerance; tried in turn.
_ALLOWED: Final = ((2.0, 0.2), (1.5, 0.1), (1.0, 0.05))
_SAMPLED: Final = 4096  # blocks, at most


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
    left = (_ERROR_SHARE * tolerance) ** 2
    fields = [_sampled(view, field, tolerance, left, (seed, 0))]
    known = fields[0].smooth
    for size in range(1, _SIZES):
        finer = finer_field(view, fields[-1], known)
        if finer is None:
            break
        left -= fields[-1].upper
        fields.append(_sampled(view, finer, tolerance, left, (seed, size)))
        known = np.repeat(np.repeat(known, 2, axis=0), 2, axis=1) | fields[-1].smooth
    whole = fields.pop()
    while fields:
        larger, both = fields.pop(), Bounded(whole.square, whole.upper)
        both += Bounded(larger.square, larger.upper)
        whole = replace(larger, finer=whole, square=both.mean, upper=both.upper, rays=larger.rays + whole.rays)
    return whole


def _sampled(view: View, field: SmoothField, tolerance: float, left: float, seed: tuple[int, int]) -> SmoothField:
    """Add blocks of one size, whose mean square over the image is bounded by what is left [gray level^2]."""
    if np.count_nonzero(field.likely) < _FEWEST:
        return field
    most = (_NOISE_SHARE * tolerance) ** 2 * (BLOCK / field.block) ** _BY_SIZE
    places = field.corners
    u, v = (corner[:-1, :-1][field.likely] + field.block / 2 for corner in places)
    pilots = bundles(view.with_noise(_PILOT_HALVINGS), (u, v), _PILOTS)
    middle, noise = pilots.mean(axis=0), np.zeros(field.likely.shape)
    few = np.exp2(FALL * _PILOT_HALVINGS)  # times the noise of the usual points
    noise[field.likely] = _gray(view, pilots).var(axis=0, ddof=1) / few
    wanted = np.maximum(np.ceil(np.log2(np.maximum(_BETWEEN * noise / most, 1.0)) / FALL), 0.0).astype(np.int8)
    likely = field.likely & (wanted <= MOST_DOUBLINGS)
    doublings = most_about(np.where(likely, wanted, np.int8(0)))
    values = field.values.copy()
    rays = field.rays + pilots.size + retraced(view, values, places, doublings)
    field = replace(field, values=values, doublings=doublings, rays=rays)
    off = np.zeros(noise.shape)
    off[field.likely] = np.abs(_gray(view, middle) - _gray(view, field.at(u, v)[0]))
    at_corners = mean_of_corners(most_about(noise) / np.exp2(FALL * doublings))
    error = np.sqrt(few * noise / _PILOTS**2 + at_corners / 4)
    for noises, share in _ALLOWED:
        kept = likely & (off <= noises * error + share * tolerance)
        if np.count_nonzero(kept) < _FEWEST:
            break
        enough = (_NOISE_SHARE * tolerance) ** 2 / float(kept.mean())
        halves = _sample(view, field, kept, enough / float(noise[kept].mean() or enough), seed)
        field = replace(field, rays=field.rays + halves.size)
        square = _square(halves, np.count_nonzero(kept) / kept.size, seed)
        if square.upper <= left:
            both = Bounded(field.square, field.upper) + square
            return replace(field, smooth=field.smooth | kept, square=both.mean, upper=both.upper)
    return field


def _sample(view: View, field: SmoothField, kept: NDArray[np.bool_], enough: float, seed: tuple[int, int]) -> Array:
    """What rays see less what lies between corners [gray level], at a place in each of some blocks.

    Two rays at each place, shape (2, blocks), by so many points that what noise leaves in the mean of their products is
    no more than the share that is enough of that of the usual points.
    """
    random = generator(seed[0], Rendering.SAMPLED_BLOCKS, 0, seed[1])
    blocks = np.flatnonzero(kept)
    if len(blocks) > _SAMPLED:
        blocks = random.choice(blocks, _SAMPLED, replace=False)
    row, column = np.divmod(blocks, kept.shape[1])
    inside = random.random((2, len(blocks)))
    v = field.block * (field.first[0] + row + inside[0]) - 0.5
    u = field.block * (field.first[1] + column + inside[1]) - 0.5
    wanted = math.ceil(math.log2(max(2 / (enough * math.sqrt(len(blocks))), 1.0)) / FALL)
    asked = view.with_noise(-min(wanted, MOST_DOUBLINGS))
    du, dv = random.uniform(-0.5, 0.5, (2, 2, len(blocks)))
    value, _ = trace_rays(asked, None, (u + du).ravel(), (v + dv).ravel())
    seen: Array = _gray(view, value.reshape(du.shape)) - _gray(view, field.at(u, v)[0])
    return seen


def _square(halves: Array, share: float, seed: tuple[int, int]) -> Bounded:
    """Mean square over the image of what two independent errors, shape (2, blocks), have in common."""
    stratum = np.zeros(halves.shape[1], dtype=np.intp)
    return stratified_mean(
        halves[0] * halves[1], stratum, np.array([share]), (seed[0], Rendering.SAMPLED_BLOCKS, 1, seed[1])
    )


def _gray(view: View, radiance: Array) -> Array:
    return unclipped_gray(radiance * view.exposure_of_radiance, view.camera.sensor)
