"""Which lights are hidden from a point: first asked of many at once, as most of them never are."""

from __future__ import annotations

from typing import Final

from radwrap.tracers.compiled.arrays import (
    Cluster,
    Floats,
    Light,
    Lights,
    Nodes,
    Shape,
    Shapes,
    Whole,
    Wide,
)
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import NEAREST, has_plane, hidden
from radwrap.tracers.compiled.shaft import box_of, next_leaf, shaft_between
from radwrap.tracers.compiled.shine import towards

# Lights of a part of a cluster.
TOGETHER: Final = 8
# Heights over a plane, for each unit of distance, from which on rounding does not matter, and from which on what is at
# the other end may touch the plane.
OFF: Final = 1e-7
WELL_OFF: Final = 0.01
ON: Final = -WELL_OFF * NEAREST


@compiled
def darken_own(
    lights: Lights,
    cluster: Cluster,
    discs: Shapes,
    nodes: Nodes,
    tables: Floats,
    x: float,
    y: float,
    z: float,
    given: Floats,
    stack: Whole,
) -> None:
    """Take away what a point gets of the lights of a cluster that other emitters hide from it; see `darken`."""
    asked = False
    for i in range(cluster.first, cluster.end):
        own = lights[i].own
        if own < 0 or not given[i] > 0:
            continue
        if not asked:
            asked = True
            if clear(discs, nodes, cluster, x, y, z, -1, stack):
                return
        if is_hidden(lights[i], discs, nodes, tables, x, y, z, own, stack):
            given[i] = 0.0


@compiled
def is_hidden(
    light: Light, shapes: Shapes, nodes: Nodes, tables: Floats, x: float, y: float, z: float, but: int, stack: Whole
) -> bool:
    """Whether any shape but one stands between a point and a light."""
    lx, ly, lz, away, _ = towards(light, x, y, z)
    return hidden(shapes, nodes, tables, x, y, z, lx, ly, lz, away, but, stack)


@compiled
def clear(
    shapes: Shapes, nodes: Nodes, there: Cluster | Wide, x: float, y: float, z: float, but: int, stack: Whole
) -> bool:
    """Whether no shape but one can stand between a point and any place in a box; see `clear_between`."""
    return clear_between(shapes, nodes, there, x, y, z, x, y, z, but, True, stack)


@compiled
def clear_between(
    shapes: Shapes,
    nodes: Nodes,
    there: Cluster | Wide,
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    but: int,
    may_touch: bool,
    stack: Whole,
) -> bool:
    """Whether no shape but one can stand between any places of two boxes, the second here that of a light or cluster.

    Where they `may_touch`, a flat shape in whose plane one of the boxes lies stands between nothing.

    Only "yes" is sure.
    """
    if len(shapes) <= (but >= 0):
        return True
    shaft, height = shaft_between((x0, y0, z0, x1, y1, z1), box_of(there)), 1
    stack[0] = 0
    while True:
        leaf, height = next_leaf(nodes, shaft, height, stack)
        if leaf < 0:
            return True
        first = nodes[leaf].first
        for i in range(first, first + nodes[leaf].count):
            if i != but and not aside(shapes[i], there, x0, y0, z0, x1, y1, z1, may_touch):
                return False


@compiled
def aside(
    s: Shape,
    there: Cluster | Wide,
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    may_touch: bool,
) -> bool:
    """Whether two boxes lie on one side of a flat shape's plane, which one of them `may_touch`."""
    if not has_plane(s):
        return False
    # Of each box the middle and half of what it reaches along the normal.
    x, y, z = (there.x0 + there.x1) / 2, (there.y0 + there.y1) / 2, (there.z0 + there.z1) / 2
    ox, oy, oz = (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2
    nx, ny, nz = abs(s.nx), abs(s.ny), abs(s.nz)
    reach = (nx * (there.x1 - there.x0) + ny * (there.y1 - there.y0) + nz * (there.z1 - there.z0)) / 2
    half = (nx * (x1 - x0) + ny * (y1 - y0) + nz * (z1 - z0)) / 2
    far = (x - s.x) * s.nx + (y - s.y) * s.ny + (z - s.z) * s.nz
    here = (ox - s.x) * s.nx + (oy - s.y) * s.ny + (oz - s.z) * s.nz
    if far + here < 0:
        far, here = -far, -here
    away = abs(x - ox) + abs(y - oy) + abs(z - oz) + reach + half
    far, here = far - reach, here - half
    if far > OFF * away and here > OFF * away:
        return True
    # One may touch the plane, as rays then meet it no farther from their ends than they may.
    off = WELL_OFF * away
    return may_touch and ((far > off and here > ON) or (here > off and far > ON))
