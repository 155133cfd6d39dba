"""Where the central image can only change smoothly, so that few rays tell it.

A lattice of central rays cuts the image into blocks. Where the tracer can
prove that nothing but a flat, matte, undisturbed face is seen, see
`Engine.smooth_blocks`, a block's values are those between its corners; a ray
through its middle tells how far they are off.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.diffraction import Light
from radwrap.imaging.optics.smooth import BLOCK, SmoothField, corners_around, corners_of, most_about
from radwrap.imaging.optics.view import LitView, View, central_rays, trace_rays
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.scene.camera import Camera
from radwrap.tracers.engine import BlockLight, Prover

Array = NDArray[np.float64]
_Lit = TypeVar("_Lit", Light, LitView)

# Values between corners may be off in the middle by so much of the tolerance.
_ERROR_SHARE: Final = 0.05


def smooth_field(view: View, reach: float, tolerance: float) -> SmoothField | None:
    """Find the smooth blocks of a view; None where its tracer cannot prove any.

    Parameters
    ----------
    view : View
        Who traces, and proves.
    reach : float
        How far light is gathered from beyond the sensor [px].
    tolerance : float
        Of the image [gray level].
    """
    if view.prover is None:
        return None
    sensor, margin = view.camera.sensor, math.ceil(reach / BLOCK)
    shape = (-(-sensor.rows // BLOCK) + 2 * margin, -(-sensor.columns // BLOCK) + 2 * margin)
    first = (-margin, -margin)
    corners = corners_of(first, shape)
    middles = tuple(places[:-1, :-1] + BLOCK / 2 for places in corners)
    light = _light_in(view.prover, view.camera, np.ones(shape, dtype=np.bool_), corners, middles)
    proved = light == BlockLight.PROVED
    values, magnification = _traced(view, *corners)
    likely = light == BlockLight.LIKELY
    field = SmoothField(
        first,
        proved,
        values,
        magnification,
        likely,
        0.0,
        0.0,
        magnification.size,
        np.zeros_like(magnification, dtype=np.int8),
    )
    at = tuple(places[proved] for places in middles)
    middle, _ = trace_rays(view, None, *at)
    gray = (unclipped_gray(found * view.exposure_of_radiance, sensor) for found in (middle, field.at(*at)[0]))
    off = np.abs(np.subtract(*gray))
    kept = off <= _ERROR_SHARE * tolerance
    smooth = np.zeros_like(proved)
    smooth[proved] = kept
    # Between the corners of what can only change smoothly nothing is farther off than the middle.
    square = float((off[kept] ** 2).mean()) if kept.any() else 0.0
    return replace(field, smooth=smooth, square=square, upper=square, rays=magnification.size + middle.size)


def in_other_light(field: SmoothField, view: View) -> SmoothField:
    """The same blocks as another view of the same places sees them."""
    values, magnification = _traced(view, *field.corners)
    rays = magnification.size + retraced(view, values, field.corners, field.doublings)
    finer = None if field.finer is None else in_other_light(field.finer, view)
    rays += 0 if finer is None else finer.rays
    return replace(field, values=values, magnification=magnification, rays=rays, finer=finer)


def with_known(lit: _Lit, field: SmoothField) -> _Lit:
    """Light whose view knows the same blocks, as it sees them."""
    return replace(lit, view=replace(lit.view, smooth=in_other_light(field, lit.view)))


def retraced(view: View, values: Array, places: tuple[Array, Array], doublings: NDArray[np.int8]) -> int:
    """Trace again where points of wide lights are to be doubled; gives how many rays that took."""
    rays = 0
    for often in np.unique(doublings[doublings > 0]).tolist():
        there = doublings == often
        u, v = (axis[there] for axis in places)
        values[..., there] = trace_rays(view.with_noise(-often), None, u, v)[0]
        rays += len(u)
    return rays


def finer_field(view: View, field: SmoothField, known: NDArray[np.bool_]) -> SmoothField | None:
    """Blocks of half the size that may be smooth where a field's are not yet known to be; None as `smooth_field`.

    None of them is taken to be smooth yet.
    """
    if view.prover is None:
        return None
    first, block = (2 * field.first[0], 2 * field.first[1]), field.block // 2
    shape = tuple(2 * size for size in field.smooth.shape)
    corners = corners_of(first, shape, block)
    middles = tuple(places[:-1, :-1] + block / 2 for places in corners)
    rest = ~np.repeat(np.repeat(known, 2, axis=0), 2, axis=1)
    likely = _light_in(view.prover, view.camera, rest, corners, middles) != BlockLight.UNKNOWN
    needed = most_about(likely)
    values, magnification = np.zeros((*field.values.shape[:-2], *needed.shape)), np.ones(needed.shape)
    at = tuple(places[needed] for places in corners)
    values[..., needed], magnification[needed] = trace_rays(view, None, *at, with_depth=True)
    return SmoothField(
        first,
        np.zeros_like(likely),
        values,
        magnification,
        likely,
        0.0,
        0.0,
        len(at[0]),
        np.zeros(needed.shape, dtype=np.int8),
        block,
    )


def _light_in(
    prover: Prover,
    camera: Camera,
    blocks: NDArray[np.bool_],
    corners: tuple[Array, ...],
    middles: tuple[Array, ...],
) -> NDArray[np.int8]:
    """How light can change within some of all blocks, a `BlockLight`; nothing is known of the others."""
    needed, around = corners_around(blocks)
    through_corners = central_rays(camera, *(axis[needed] for axis in corners))
    through_middles = central_rays(camera, *(axis[blocks] for axis in middles))
    light = np.full(blocks.shape, BlockLight.UNKNOWN, dtype=np.int8)
    light[blocks] = prover(through_corners, through_middles, around)
    return light


def bundles(view: View, places: tuple[Array, Array], side: int) -> Array:
    """L cos^4(theta) along side x side rays in a square of a pixel about each of n places, shape (..., side^2, n)."""
    (u, v), steps = places, (np.arange(side) + 0.5) / side - 0.5
    du, dv = (a.ravel()[:, np.newaxis] for a in np.meshgrid(steps, steps))
    values, _ = trace_rays(view, None, (u + du).ravel(), (v + dv).ravel())
    return values.reshape(*values.shape[:-1], side * side, len(u))


def _traced(view: View, u: Array, v: Array) -> tuple[Array, Array]:
    values, magnification = trace_rays(view, None, u.ravel(), v.ravel(), with_depth=True)
    return values.reshape(*values.shape[:-1], *u.shape), magnification.reshape(u.shape)
