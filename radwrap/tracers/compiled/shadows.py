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
from radwrap.tracers.compiled.intersect import NEAREST, has_plane, hidden, inverse_of
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
        if _is_hidden(lights[i], discs, nodes, tables, x, y, z, own, stack):
            given[i] = 0.0


@compiled
def _is_hidden(
    light: Light, shapes: Shapes, nodes: Nodes, tables: Floats, x: float, y: float, z: float, but: int, stack: Whole
) -> bool:
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

    What rays between them may pass lies, at each share t of their way, in a
    box that changes with t from one to the other: one walk down the tree in
    place of one for each ray. Only "yes" is sure.
    """
    if len(shapes) <= (but >= 0):
        return True
    ax, bx, ay, by, az, bz = there.x0 - x0, there.x1 - x1, there.y0 - y0, there.y1 - y1, there.z0 - z0, there.z1 - z1
    iax, ibx, iay, iby = inverse_of(ax), inverse_of(bx), inverse_of(ay), inverse_of(by)
    iaz, ibz = inverse_of(az), inverse_of(bz)
    height, node = 1, 0
    stack[0] = 0
    while height:
        height -= 1
        node = stack[height]
        box = nodes[node]
        near, far = overlap(box.x0 - x1, box.x1 - x0, ax, bx, iax, ibx, 0.0, 1.0)
        near, far = overlap(box.y0 - y1, box.y1 - y0, ay, by, iay, iby, near, far)
        near, far = overlap(box.z0 - z1, box.z1 - z0, az, bz, iaz, ibz, near, far)
        if near > far:
            continue
        count = box.count
        if count:
            first = box.first
            for i in range(first, first + count):
                if i != but and not aside(shapes[i], there, x0, y0, z0, x1, y1, z1, may_touch):
                    return False
        else:
            stack[height], stack[height + 1] = box.second, node + 1
            height += 2
    return True


@compiled
def overlap(
    low: float, high: float, a: float, b: float, ia: float, ib: float, near: float, far: float
) -> tuple[float, float]:
    """Shares of the way, within those given, at which [t a, t b] meets [low, high]; `i` are inverses."""
    if a >= 0:
        far = min(far, high * ia)
    else:
        near = max(near, high * ia)
    if b >= 0:
        near = max(near, low * ib)
    else:
        far = min(far, low * ib)
    return near, far


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
