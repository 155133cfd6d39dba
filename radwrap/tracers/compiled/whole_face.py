"""Whether one flat face fills a block of an image, and nothing else is near it: its triangles may be many."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.compiled.arrays import TRIANGLE, Floats, Nodes, Shape, Shapes, Whole
from radwrap.tracers.compiled.compiler import compiled

# Corners that a quadrangle has at most once a triangle has cut it.
CORNERS: Final = 8
# Of lengths, and of areas: what rounding may leave between faces of one plane, and between triangles that fill it.
_ROUNDING: Final = 1e-7
_MISSED: Final = 1e-6


def room() -> Floats:
    """Room to work in: three polygons."""
    return np.empty((3, CORNERS, 2))


@compiled
def fills(
    shapes: Shapes,
    nodes: Nodes,
    edges: Floats,
    joined: bool,
    quad: Floats,
    but: int,
    near: float,
    stack: Whole,
    polygons: Floats,
) -> bool:
    """Whether faces in the plane of one fill a quadrangle in it, and no other shape is near.

    By their area only, unless they are to be `joined`: a gap may be as large as an overlap. Where no edge of a triangle
    ends or doubles what is there, all places lie in as many triangles, and so in one.

    Parameters
    ----------
    shapes, nodes
        All that is there.
    edges : ndarray
        What lies beyond edges of triangles, see `outlines.edges_of`.
    joined : bool
        Whether triangles must be.
    quad : ndarray, shape (4, 3)
        Corners, one after the other around it.
    but : int
        A face that the quadrangle touches; whole by itself unless it is a triangle.
    near : float
        Distance at which others count, along each axis.
    stack, polygons : ndarray
        Room to work in: of integers, and of `room`.
    """
    s = shapes[but]
    first, second = _axes(s)
    area, found, start = 0.0, 0.0, polygons[0]
    for k in range(4):
        start[k, 0], start[k, 1] = quad[k, first], quad[k, second]
    area = _area(start, 4)
    x0, x1 = _reach(quad, 0, near)
    y0, y1 = _reach(quad, 1, near)
    z0, z1 = _reach(quad, 2, near)
    size = abs(x1 - x0) + abs(y1 - y0) + abs(z1 - z0)
    height = 1
    stack[0] = 0
    while height:
        height -= 1
        node = stack[height]
        box = nodes[node]
        if box.x0 > x1 or box.x1 < x0 or box.y0 > y1 or box.y1 < y0 or box.z0 > z1 or box.z1 < z0:
            continue
        if not box.count:
            stack[height], stack[height + 1] = box.second, node + 1
            height += 2
            continue
        for i in range(box.first, box.first + box.count):
            t = shapes[i]
            if t.kind == TRIANGLE:
                p, q, r = corner(t, 0), corner(t, 1), corner(t, 2)
                if _is_apart(p, q, r, x0, y0, z0, x1, y1, z1):  # a leaf's box holds others
                    continue
            if not _in_one_plane(s, t, size):
                return False
            if t.kind == TRIANGLE:
                if joined and not _is_joined(t, edges[i], size, first, second, x0, y0, z0, x1, y1, z1):
                    return False
                found += _shared_area(start, t, first, second, polygons)
            elif i == but:
                found += area
    return area > 0 and abs(found - area) <= _MISSED * area


@compiled
def _is_joined(
    t: Shape,
    beyond: Floats,
    size: float,
    first: int,
    second: int,
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
) -> bool:
    """Whether each edge of a triangle that a box may hold has one other triangle, on its other side in that plane."""
    for k in range(3):
        p, q, r = corner(t, k), corner(t, (k + 1) % 3), corner(t, (k + 2) % 3)
        if _is_apart(p, q, q, x0, y0, z0, x1, y1, z1):
            continue
        w = (beyond[k, 1], beyond[k, 2], beyond[k, 3])
        across, up = q[first] - p[first], q[second] - p[second]
        own = across * (r[second] - p[second]) - up * (r[first] - p[first])
        other = across * (w[second] - p[second]) - up * (w[first] - p[first])
        off = abs((w[0] - t.x) * t.nx + (w[1] - t.y) * t.ny + (w[2] - t.z) * t.nz)
        if beyond[k, 0] == 0 or off > _ROUNDING * size or not own * other < 0:
            return False
    return True


@compiled
def corner(t: Shape, k: int) -> tuple[float, float, float]:
    """A corner of a triangle."""
    if k == 0:
        return t.x, t.y, t.z
    if k == 1:
        return t.x + t.ux, t.y + t.uy, t.z + t.uz
    return t.x + t.vx, t.y + t.vy, t.z + t.vz


@compiled
def _is_apart(
    p: tuple[float, float, float],
    q: tuple[float, float, float],
    r: tuple[float, float, float],
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
) -> bool:
    """Whether the box of three places does not touch another box."""
    return (
        min(p[0], q[0], r[0]) > x1
        or max(p[0], q[0], r[0]) < x0
        or min(p[1], q[1], r[1]) > y1
        or max(p[1], q[1], r[1]) < y0
        or min(p[2], q[2], r[2]) > z1
        or max(p[2], q[2], r[2]) < z0
    )


@compiled
def _reach(quad: Floats, axis: int, near: float) -> tuple[float, float]:
    a, b, c, d = quad[0, axis], quad[1, axis], quad[2, axis], quad[3, axis]
    return min(a, b, c, d) - near, max(a, b, c, d) + near


@compiled
def _axes(s: Shape) -> tuple[int, int]:
    """The two coordinates in which a plane is seen best."""
    x, y, z = abs(s.nx), abs(s.ny), abs(s.nz)
    if z >= x and z >= y:
        return 0, 1
    return (0, 2) if y >= x else (1, 2)


@compiled
def _in_one_plane(s: Shape, t: Shape, size: float) -> bool:
    """Whether a face belongs to the same target as another, and lies in its plane."""
    if s.owner != t.owner or s.kind != t.kind:
        return False
    across = math.sqrt((s.nx - t.nx) ** 2 + (s.ny - t.ny) ** 2 + (s.nz - t.nz) ** 2)
    off = abs((t.x - s.x) * s.nx + (t.y - s.y) * s.ny + (t.z - s.z) * s.nz)
    return across <= _ROUNDING and off <= _ROUNDING * size


@compiled
def _shared_area(start: Floats, t: Shape, first: int, second: int, polygons: Floats) -> float:
    """Area that a polygon of four corners and a triangle have in common."""
    corners = (corner(t, 0), corner(t, 1), corner(t, 2))
    ax, ay = corners[0][first], corners[0][second]
    bx, by = corners[1][first], corners[1][second]
    cx, cy = corners[2][first], corners[2][second]
    if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < 0:
        bx, by, cx, cy = cx, cy, bx, by
    count = _cut(start, 4, ax, ay, bx, by, polygons[1])
    count = _cut(polygons[1], count, bx, by, cx, cy, polygons[2])
    count = _cut(polygons[2], count, cx, cy, ax, ay, polygons[1])
    return _area(polygons[1], count)


@compiled
def _cut(polygon: Floats, count: int, ax: float, ay: float, bx: float, by: float, left: Floats) -> int:
    """Fill in what of a convex polygon lies left of a line from a to b; how many corners it has."""
    kept = 0
    for k in range(count):
        following = k + 1 if k + 1 < count else 0
        px, py, qx, qy = polygon[k, 0], polygon[k, 1], polygon[following, 0], polygon[following, 1]
        p = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        q = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
        if p >= 0:
            left[kept, 0], left[kept, 1] = px, py
            kept += 1
        if (p >= 0) != (q >= 0):
            share = p / (p - q)
            left[kept, 0], left[kept, 1] = px + share * (qx - px), py + share * (qy - py)
            kept += 1
    return kept


@compiled
def _area(polygon: Floats, count: int) -> float:
    twice = 0.0
    for k in range(count):
        following = k + 1 if k + 1 < count else 0
        twice += polygon[k, 0] * polygon[following, 1] - polygon[following, 0] * polygon[k, 1]
    return abs(twice) / 2
