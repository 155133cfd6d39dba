"""Points near each other, and what may stand between them and lights: asked once for all of them."""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arrays import (
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
from radwrap.tracers.compiled.intersect import NEAREST, SLACK, crossing, has_plane
from radwrap.tracers.compiled.shadows import OFF, ON, TOGETHER, WELL_OFF, clear, is_hidden
from radwrap.tracers.compiled.shaft import Box, box_of, next_leaf, shaft_between
from radwrap.tracers.compiled.shine import towards

# Points that are asked about together: more share the cost of asking, but lie farther apart, so that more may stand
# between them and a light.
NEIGHBOURS: Final = 16
# Shapes for which a list has room; where more may stand between, as for points that are far apart, each point asks the
# tree: to look through long lists takes longer.
LISTED: Final = 24
NOT_ASKED: Final = -1
ALL_HIDDEN: Final = -2
# How much of a box lies behind something, as a light sees it.
NOWHERE: Final = 0
PARTLY: Final = 1
WHOLLY: Final = 2


@compiled
def darken(
    lights: Lights,
    cluster: Cluster,
    number: int,
    parts: Clusters,
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    points: Floats,
    count: int,
    around: Floats,
    x: float,
    y: float,
    z: float,
    itself: int,
    given: Floats,
    asked: Whole,
    between: Whole,
    heights: Floats,
    stack: Whole,
) -> None:
    """Take away what a point gets of the lights of a cluster that any shape but one hides from it.

    What stands between all points and the whole cluster is asked first, then what does between them and a part of it,
    and of that what does between them and a light: often nothing, or what hides it from all.

    Parameters
    ----------
    lights, cluster, number, parts
        All lights, some that follow each other, the number of this cluster, and smaller groups.
    shapes, nodes, tables
        What may stand between.
    points, count, around : ndarray, shape (NEIGHBOURS, 3), int, ndarray, shape (6,)
        Points that lie together, the point among them, how many they are, and the box about them.
    x, y, z : float
        The point.
    itself : int
        Shape that does not count, or -1.
    given : ndarray, shape (lights,)
        What each light gives; 0 afterwards where it is hidden.
    asked : ndarray of int, shape (lights + parts + clusters,)
        How many shapes may stand between all these points and each; or `NOT_ASKED` yet, or known to be `ALL_HIDDEN`.
    between : ndarray of int, shape (lights + parts, LISTED)
        Which.
    heights : ndarray, shape (parts, LISTED, 2)
        See `_standing`.
    stack : ndarray of int, shape (DEPTH,)
        Room to work in.
    """
    whole = len(lights) + len(parts) + number
    own, own_free = -1, False
    for i in range(cluster.first, cluster.end):
        if not given[i] > 0:
            continue
        part = cluster.part + (i - cluster.first) // TOGETHER
        group = len(lights) + part
        if asked[whole] == NOT_ASKED:
            box = box_of(cluster)
            asked[whole] = _standing(shapes, nodes, points, count, around, box, between[group], heights[part], 0, stack)
        if asked[whole] == 0:
            return
        if asked[group] == NOT_ASKED:
            box, row = box_of(parts[part]), between[group]
            asked[group] = _standing(shapes, nodes, points, count, around, box, row, heights[part], LISTED, stack)
        if asked[group] == 0:
            continue
        light = lights[i]
        if asked[group] > LISTED:
            if own < 0 and clear(shapes, nodes, cluster, x, y, z, itself, stack):
                return
            if part != own:
                own, own_free = part, clear(shapes, nodes, parts[part], x, y, z, itself, stack)
            if not own_free and is_hidden(light, shapes, nodes, tables, x, y, z, itself, stack):
                given[i] = 0.0
            continue
        if asked[i] == NOT_ASKED:
            asked[i] = _before(shapes, around, light, asked[group], between[group], heights[part], between[i])
        if asked[i] == 0:
            continue
        if asked[i] == ALL_HIDDEN:
            if between[i, 0] != itself or is_hidden(light, shapes, nodes, tables, x, y, z, itself, stack):
                given[i] = 0.0
            continue
        lx, ly, lz, away, _ = towards(light, x, y, z)
        for k in range(asked[i]):
            s = between[i, k]
            if s != itself and crossing(shapes[s], tables, x, y, z, lx, ly, lz) < away:
                given[i] = 0.0
                break


@compiled
def put_around(points: Floats, count: int, around: Floats) -> None:
    """Fill in the least and largest places of points, shape (6,)."""
    for axis in range(3):
        low = high = points[0, axis]
        for n in range(1, count):
            low, high = min(low, points[n, axis]), max(high, points[n, axis])
        around[axis], around[3 + axis] = low, high


@compiled
def _standing(
    shapes: Shapes,
    nodes: Nodes,
    points: Floats,
    count: int,
    around: Floats,
    there: Box,
    found: Whole,
    heights: Floats,
    room: int,
    stack: Whole,
) -> int:
    """How many shapes may stand between points and any place in a box, at most one more than there is room for.

    As `shadows.clear_between`, but with the points themselves held against the planes of shapes. What is found is sure
    to hold all that do, each with the points' least and largest height over its plane.
    """
    if not len(nodes):
        return 0
    here = (around[0], around[1], around[2], around[3], around[4], around[5])
    shaft, away, height, listed = shaft_between(here, there), farthest(around, there), 1, 0
    stack[0] = 0
    while True:
        leaf, height = next_leaf(nodes, shaft, height, stack)
        if leaf < 0:
            return listed
        first = nodes[leaf].first
        for i in range(first, first + nodes[leaf].count):
            low, high = _heights(shapes[i], points, count)
            if not _on_one_side(shapes[i], low, high, there, away):
                if listed == room:
                    return room + 1
                found[listed], heights[listed, 0], heights[listed, 1] = i, low, high
                listed += 1


@compiled
def farthest(around: Floats, there: Box) -> float:
    """At least the distance of any two places in two boxes."""
    return (
        max(there[3] - around[0], around[3] - there[0])
        + max(there[4] - around[1], around[4] - there[1])
        + max(there[5] - around[2], around[5] - there[2])
    )


@compiled
def _heights(s: Shape, points: Floats, count: int) -> tuple[float, float]:
    """Least and largest height of points over a flat shape's plane; no bounds where it is not flat."""
    if not has_plane(s):
        return -math.inf, math.inf
    low, high = math.inf, -math.inf
    for n in range(count):
        height = (points[n, 0] - s.x) * s.nx + (points[n, 1] - s.y) * s.ny + (points[n, 2] - s.z) * s.nz
        low, high = min(low, height), max(high, height)
    return low, high


@compiled
def _on_one_side(s: Shape, low: float, high: float, there: Box, away: float) -> bool:
    """Whether points of known heights and a box, at most so far apart, lie on one side of a flat shape's plane.

    The points may touch it, as rays then meet it no farther from their ends than they may.
    """
    x, y, z = (there[0] + there[3]) / 2 - s.x, (there[1] + there[4]) / 2 - s.y, (there[2] + there[5]) / 2 - s.z
    dx, dy, dz = there[3] - there[0], there[4] - there[1], there[5] - there[2]
    middle, half = x * s.nx + y * s.ny + z * s.nz, (abs(s.nx) * dx + abs(s.ny) * dy + abs(s.nz) * dz) / 2
    if middle < 0:
        middle, low = -middle, -high
    far, off = middle - half, OFF * away
    return (far > WELL_OFF * away and low > ON) or (far > off and low > off)


@compiled
def _before(
    shapes: Shapes, around: Floats, light: Light, count: int, group: Whole, heights: Floats, found: Whole
) -> int:
    """How many of the shapes that may stand between points and a group of lights may before one, or `ALL_HIDDEN`.

    Parameters
    ----------
    shapes, around, light
        As `darken`.
    count, group, heights : int, ndarray of int, ndarray
        How many shapes; which, and the points' heights over them.
    found : ndarray of int, shape (LISTED,)
        Filled with those that may, or first with the one that hides the light from all but points on it: the normal of
        a sliver may be so far off that these seem to lie behind it.
    """
    there = (light.x, light.y, light.z, light.x, light.y, light.z)
    away = farthest(around, there)
    left = 0
    for k in range(count):
        s, low, high = shapes[group[k]], heights[k, 0], heights[k, 1]
        if _on_one_side(s, low, high, there, away):
            continue
        seen = _seen_behind(s, around, light) if s.kind == TRIANGLE and s.a else PARTLY
        if seen == WHOLLY and _is_parted(s, low, high, light, away):
            found[0] = group[k]
            return ALL_HIDDEN
        if seen != NOWHERE:
            found[left] = group[k]
            left += 1
    return left


@compiled
def _is_parted(s: Shape, low: float, high: float, light: Light, away: float) -> bool:
    """Whether a flat shape's plane is between a light and points of known heights, and none touches it."""
    far = (light.x - s.x) * s.nx + (light.y - s.y) * s.ny + (light.z - s.z) * s.nz
    if far < 0:
        far, high = -far, -low
    return far > WELL_OFF * away and high < -(2 * NEAREST + OFF * away)


@compiled
def _seen_behind(s: Shape, around: Floats, light: Light) -> int:
    """How much of a box lies in the cone in which a light sees a triangle."""
    ax, ay, az = s.x - light.x, s.y - light.y, s.z - light.z
    bx, by, bz = ax + s.ux, ay + s.uy, az + s.uz
    cx, cy, cz = ax + s.vx, ay + s.vy, az + s.vz
    # Normals of the planes through the light and each side, all to the inside or all to the outside.
    px, py, pz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    inside = px * cx + py * cy + pz * cz
    # A ray may meet a triangle beside it by a share of its size, which grows on the way from there; a light that is so
    # near the triangle's plane that rounding decides on its side may see it anywhere.
    size = abs(s.ux) + abs(s.uy) + abs(s.uz) + abs(s.vx) + abs(s.vy) + abs(s.vz)
    height = abs(ax * s.nx + ay * s.ny + az * s.nz)
    if height <= OFF * size:
        return PARTLY
    slack = OFF + SLACK * size / height
    side = 1.0 if inside > 0 else -1.0
    one = _beyond(side, px, py, pz, around, light, slack)
    if one == NOWHERE:
        return NOWHERE
    qx, qy, qz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    two = _beyond(side, qx, qy, qz, around, light, slack)
    if two == NOWHERE:
        return NOWHERE
    rx, ry, rz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    return min(one, two, _beyond(side, rx, ry, rz, around, light, slack))


@compiled
def _beyond(side: float, nx: float, ny: float, nz: float, around: Floats, light: Light, slack: float) -> int:
    """How much of a box lies on that side of a plane through a light, by more than a share of its distance."""
    x, y, z = (
        (around[0] + around[3]) / 2 - light.x,
        (around[1] + around[4]) / 2 - light.y,
        (around[2] + around[5]) / 2 - light.z,
    )
    dx, dy, dz = around[3] - around[0], around[4] - around[1], around[5] - around[2]
    wide, high, deep = abs(nx), abs(ny), abs(nz)
    place, half = side * (nx * x + ny * y + nz * z), (wide * dx + high * dy + deep * dz) / 2
    off = slack * (wide + high + deep) * (abs(x) + abs(y) + abs(z))
    if place + half < -off:
        return NOWHERE
    return WHOLLY if place - half > off else PARTLY
