"""Before which lights another emitter may stand: most have none, and are spared the question."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.sources import Emitter, Patch
from radwrap.tracers.compiled.arrays import LUMINAIRE, Floats, Lights, Tree, Whole
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.shadows import clear_between
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.text_frame import TextFrame

# An emitter that rises no more than this above another's plane, in their distance, cannot stand before its centre.
_COPLANAR: Final = 1e-7


def own_shapes(
    shown: Sequence[Emitter], wides: NDArray[np.void], lights: NDArray[np.void], discs: Tree, frame: TextFrame
) -> Whole:
    """Of each light before whose centre another emitter may stand, its own shape; else -1. Wide lights come last."""
    own = np.empty(len(lights), dtype=np.int64)
    own[discs.shapes["owner"]] = np.arange(len(lights))
    # Discs and spheres by what they rise over a plane, patches by their corners, wide lights by their box's.
    places = [*(_places(emitter, frame) for emitter in shown), *((_box_corners(wide), 0.0) for wide in wides)]
    points = np.concatenate([np.empty((0, 3)), *(place for place, _ in places)])
    whose = np.repeat(np.arange(len(lights)), [len(place) for place, _ in places])
    may_hide(lights, points, np.array([radius for _, radius in places])[whose], whose, own)
    return own


def nothing_before(light: Any, targets: Tree, discs: Tree) -> bool:
    """Whether no emitter but a wide light itself, a row of `Wide`, can stand between it and any target."""
    if not len(targets.nodes):
        return True
    x0, y0, z0, x1, y1, z1 = (float(targets.nodes[0][name]) for name in ("x0", "y0", "z0", "x1", "y1", "z1"))
    stack, own = np.empty(DEPTH, dtype=np.int64), int(light["own"])
    return clear_between(discs.shapes, discs.nodes, light, x0, y0, z0, x1, y1, z1, own, False, stack)


def _box_corners(box: Any) -> Floats:
    return np.array(list(product(*((box[f"{axis}0"], box[f"{axis}1"]) for axis in "xyz"))), dtype=np.float64)


def _places(emitter: Emitter, frame: TextFrame) -> tuple[Floats, float]:
    """Corners of a patch and 0, or the centre and radius of a disc or sphere."""
    if isinstance(emitter, Patch):
        return np.array([frame.point(corner) for corner in emitter.corners]), 0.0
    return np.array([frame.point(emitter.position)]), emitter.radius * frame.units


@compiled
def may_hide(lights: Lights, points: Floats, radii: Floats, whose: Whole, own: Whole) -> None:
    """Take away the own shape of lights over whose plane no other emitter rises.

    Parameters
    ----------
    lights
        Rows of `Light`.
    points : ndarray, shape (n, 3)
        Places of emitters.
    radii : ndarray, shape (n,)
        What they reach beyond their places, discs in their plane.
    whose : ndarray of int, shape (n,)
        Numbers of the emitters.
    own : ndarray of int
        Of each light its own shape, or -1 afterwards.
    """
    for i in range(len(lights)):
        light = lights[i]
        before = False
        for p in range(len(points)):
            if whose[p] == i:
                continue
            x, y, z, radius = points[p, 0] - light.x, points[p, 1] - light.y, points[p, 2] - light.z, radii[p]
            other = lights[whose[p]]
            tilt = light.nx * other.nx + light.ny * other.ny + light.nz * other.nz
            if other.beam == LUMINAIRE:
                tilt = 0.0
            rise = x * light.nx + y * light.ny + z * light.nz + radius * math.sqrt(max(1 - tilt * tilt, 0.0))
            away = max(abs(x), abs(y), abs(z)) + radius
            if light.beam == LUMINAIRE or rise > _COPLANAR * away:
                before = True
                break
        if not before:
            own[i] = -1
