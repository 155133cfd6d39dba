"""Rays in an order in which those that meet near places are near each other."""

from __future__ import annotations

from typing import Final

import numpy as np

from radwrap.tracers.compiled.arrays import Floats, Nodes, Whole
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.kernels import placed

# Places along each axis, as a power of two; three of them fit a whole number.
_BITS: Final = 20
_LAST: Final = 1 << (3 * _BITS)


def along_curve(
    nodes: Nodes, rays: Floats, x0: float, y0: float, z0: float, units: float, lengths: Floats, met: Whole
) -> Whole:
    """Numbers of rays as the places that they meet lie along the curve of Morton (1966); those without a place last.

    Parameters
    ----------
    nodes, rays, x0, y0, z0, units, lengths, met
        As `kernels.trace`.
    """
    keys = np.empty(len(rays), dtype=np.int64)
    put_keys(nodes, rays, x0, y0, z0, units, lengths, met, keys)
    return np.argsort(keys, kind="stable")


@compiled
def put_keys(
    nodes: Nodes,
    rays: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    lengths: Floats,
    met: Whole,
    keys: Whole,
) -> None:
    """Fill in how far along the curve each ray's place is."""
    keys[:] = _LAST
    if not len(nodes):
        return
    box = nodes[0]
    scale = ((1 << _BITS) - 1) / max(box.x1 - box.x0, box.y1 - box.y0, box.z1 - box.z0)
    for r in range(len(rays)):
        if met[r] < 0:
            continue
        _, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        t = lengths[r]
        x, y, z = ox + t * dx - box.x0, oy + t * dy - box.y0, oz + t * dz - box.z0
        keys[r] = (_apart(x * scale) << 2) | (_apart(y * scale) << 1) | _apart(z * scale)


@compiled
def _apart(place: float) -> int:
    """A place's bits with two zeros between neighbours."""
    bits = min(max(int(place), 0), (1 << _BITS) - 1)
    bits = (bits | bits << 32) & 0x1F00000000FFFF
    bits = (bits | bits << 16) & 0x1F0000FF0000FF
    bits = (bits | bits << 8) & 0x100F00F00F00F00F
    bits = (bits | bits << 4) & 0x10C30C30C30C30C3
    return (bits | bits << 2) & 0x1249249249249249
