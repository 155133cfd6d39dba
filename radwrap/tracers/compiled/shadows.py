"""Which lights are hidden from a point: first asked of many at once, as most of them never are."""

from __future__ import annotations

from typing import Final

from radwrap.tracers.compiled.arrays import (
    DISC,
    POLYGON,
    RECTANGLE,
    TRIANGLE,
    Cluster,
    Clusters,
    Floats,
    Light,
    Lights,
    Nodes,
    Shape,
    Shapes,
    Whole,
)
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import NEAREST, hidden, inverse_of
from radwrap.tracers.compiled.shine import towards

# Lights of a part of a cluster.
TOGETHER: Final = 8
# What is lower than this over a plane, for each unit of distance, is not taken to be well off it.
_WELL_OFF: Final = 0.01


@compiled
def darken(
    lights: Lights,
    cluster: Cluster,
    parts: Clusters,
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    x: float,
    y: float,
    z: float,
    itself: int,
    given: Floats,
    stack: Whole,
) -> None:
    """Take away what a point gets of the lights of a cluster that any shape but one hides from it.

    Parameters
    ----------
    lights, cluster, parts
        All lights, some that follow each other, and these in smaller groups.
    shapes, nodes, tables
        What may stand between.
    x, y, z : float
        The point.
    itself : int
        Shape that does not count, or -1.
    given : ndarray, shape (lights,)
        What each light gives; 0 afterwards where it is hidden.
    stack : ndarray of int, shape (DEPTH,)
        Room to work in.
    """
    asked, part, part_free = False, -1, False
    for i in range(cluster.first, cluster.end):
        if not given[i] > 0:
            continue
        if not asked:
            asked = True
            if clear(shapes, nodes, cluster, x, y, z, itself, stack):
                return
        if cluster.part + (i - cluster.first) // TOGETHER != part:
            part = cluster.part + (i - cluster.first) // TOGETHER
            part_free = clear(shapes, nodes, parts[part], x, y, z, itself, stack)
        if not part_free and _is_hidden(lights[i], shapes, nodes, tables, x, y, z, itself, stack):
            given[i] = 0.0


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
    shapes: Shapes, nodes: Nodes, lights: Cluster, ox: float, oy: float, oz: float, but: int, stack: Whole
) -> bool:
    """Whether no shape but one can stand between a point and any place in a box, here that of a cluster of lights.

    What a ray to the box may pass lies, at each share t of its way, in a box
    that grows with t from the point: one walk down the tree of boxes in place
    of one for each light. Only "yes" is sure.
    """
    if len(shapes) <= (but >= 0):
        return True
    ax, bx = lights.x0 - ox, lights.x1 - ox
    ay, by = lights.y0 - oy, lights.y1 - oy
    az, bz = lights.z0 - oz, lights.z1 - oz
    iax, ibx, iay, iby, iaz, ibz = (
        inverse_of(ax),
        inverse_of(bx),
        inverse_of(ay),
        inverse_of(by),
        inverse_of(az),
        inverse_of(bz),
    )
    height, node = 1, 0
    stack[0] = 0
    while height:
        height -= 1
        node = stack[height]
        box = nodes[node]
        near, far = _overlap(box.x0 - ox, box.x1 - ox, ax, bx, iax, ibx, 0.0, 1.0)
        near, far = _overlap(box.y0 - oy, box.y1 - oy, ay, by, iay, iby, near, far)
        near, far = _overlap(box.z0 - oz, box.z1 - oz, az, bz, iaz, ibz, near, far)
        if near > far:
            continue
        count = box.count
        if count:
            first = box.first
            for i in range(first, first + count):
                if i != but and not _aside(shapes[i], lights, ox, oy, oz):
                    return False
        else:
            stack[height], stack[height + 1] = box.second, node + 1
            height += 2
    return True


@compiled
def _overlap(
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
def _aside(s: Shape, lights: Cluster, ox: float, oy: float, oz: float) -> bool:
    """Whether a point and a box lie on one side of a flat shape's plane: one may lie on it if the other is well off."""
    if s.kind not in (TRIANGLE, RECTANGLE, POLYGON, DISC):
        return False
    nx, ny, nz = s.nx, s.ny, s.nz
    x, y, z = (lights.x0 + lights.x1) / 2, (lights.y0 + lights.y1) / 2, (lights.z0 + lights.z1) / 2
    reach = abs(nx) * (lights.x1 - lights.x0) + abs(ny) * (lights.y1 - lights.y0) + abs(nz) * (lights.z1 - lights.z0)
    there = (x - s.x) * nx + (y - s.y) * ny + (z - s.z) * nz
    here = (ox - s.x) * nx + (oy - s.y) * ny + (oz - s.z) * nz
    if there + here < 0:
        there, here = -there, -here
    there -= reach / 2
    off = _WELL_OFF * (abs(x - ox) + abs(y - oy) + abs(z - oz) + reach)
    on = -_WELL_OFF * NEAREST  # so that a ray meets the plane no farther from its end than it may
    return (there > off and here > on) or (here > off and there > on)
