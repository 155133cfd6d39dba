"""Where rays meet shapes."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.compiled.arrays import (
    DISC,
    POLYGON,
    RECTANGLE,
    SPHERE,
    TRIANGLE,
    TUBE,
    Floats,
    Node,
    Nodes,
    Shape,
    Shapes,
    Whole,
)
from radwrap.tracers.compiled.compiler import compiled

# Radiance's FTINY: what is nearer, in the text's unit, is where the ray began.
NEAREST: Final = 1e-6
# A ray along a side of a triangle meets it, so that neighbours leave no gap; relative to the triangle.
SLACK: Final = 1e-9
_STEEPEST: Final = 1e300  # in place of 1/0, which times 0 is not a number


@compiled
def crossing(s: Shape, tables: Floats, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Distance along a ray to a shape; infinite where it is missed, or nearer than `NEAREST`."""
    kind = s.kind
    px, py, pz = ox - s.x, oy - s.y, oz - s.z
    if kind == TRIANGLE:
        t = _triangle(s, px, py, pz, dx, dy, dz)
        return t if s.a or _is_about(s, px + t * dx, py + t * dy, pz + t * dz) else math.inf
    if kind == SPHERE:
        return _sphere(s.a, px, py, pz, dx, dy, dz)
    if kind in (RECTANGLE, POLYGON, DISC):
        across = dx * s.nx + dy * s.ny + dz * s.nz
        if across == 0:
            return math.inf
        t = (s.c - (ox * s.nx + oy * s.ny + oz * s.nz)) / across
        if not t > NEAREST:
            return math.inf
        px, py, pz = px + t * dx, py + t * dy, pz + t * dz
        if kind == DISC:
            return t if s.b <= px * px + py * py + pz * pz <= s.a else math.inf
        x, y = px * s.ux + py * s.uy + pz * s.uz, px * s.vx + py * s.vy + pz * s.vz
        if kind == RECTANGLE:
            return t if abs(x) <= s.a and abs(y) <= s.b else math.inf
        return t if _inside(tables, int(s.a), int(s.b), x, y) else math.inf
    if kind == TUBE:
        return _tube(s, px, py, pz, dx, dy, dz)
    return _zone(s, px, py, pz, dx, dy, dz)


@compiled
def _triangle(s: Shape, px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> float:
    """After Moeller and Trumbore (1997)."""
    nx, ny, nz = dy * s.vz - dz * s.vy, dz * s.vx - dx * s.vz, dx * s.vy - dy * s.vx
    determinant = s.ux * nx + s.uy * ny + s.uz * nz
    if determinant == 0:
        return math.inf
    inverse = 1 / determinant
    u = (px * nx + py * ny + pz * nz) * inverse
    if u < -SLACK or u > 1 + SLACK:
        return math.inf
    qx, qy, qz = py * s.uz - pz * s.uy, pz * s.ux - px * s.uz, px * s.uy - py * s.ux
    v = (dx * qx + dy * qy + dz * qz) * inverse
    if v < -SLACK or u + v > 1 + SLACK:
        return math.inf
    t = (s.vx * qx + s.vy * qy + s.vz * qz) * inverse
    return t if t > NEAREST else math.inf


@compiled
def _is_about(s: Shape, x: float, y: float, z: float) -> bool:
    """Whether a place, from a triangle's first corner, lies in the box about it: of thin ones rounding meets others."""
    size = max(abs(s.ux), abs(s.uy), abs(s.uz), abs(s.vx), abs(s.vy), abs(s.vz))
    slack = SLACK * size + NEAREST
    return (
        min(0.0, s.ux, s.vx) - slack <= x <= max(0.0, s.ux, s.vx) + slack
        and min(0.0, s.uy, s.vy) - slack <= y <= max(0.0, s.uy, s.vy) + slack
        and min(0.0, s.uz, s.vz) - slack <= z <= max(0.0, s.uz, s.vz) + slack
    )


@compiled
def has_plane(s: Shape) -> bool:
    """Whether a shape lies in a plane whose normal is sure."""
    return s.kind in (RECTANGLE, POLYGON, DISC) or (s.kind == TRIANGLE and s.a != 0)


@compiled
def _sphere(radius: float, px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> float:
    along = -(px * dx + py * dy + pz * dz)
    # The foot of the centre on the ray: no difference of large squares.
    fx, fy, fz = px + along * dx, py + along * dy, pz + along * dz
    square = radius * radius - (fx * fx + fy * fy + fz * fz)
    if square < 0:
        return math.inf
    half = math.sqrt(square)
    if along - half > NEAREST:
        return along - half
    return along + half if along + half > NEAREST else math.inf


@compiled
def _tube(s: Shape, px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> float:
    """The side of a cylinder, from outside or from inside."""
    place, slope = px * s.nx + py * s.ny + pz * s.nz, dx * s.nx + dy * s.ny + dz * s.nz
    px, py, pz = px - place * s.nx, py - place * s.ny, pz - place * s.nz
    dx, dy, dz = dx - slope * s.nx, dy - slope * s.ny, dz - slope * s.nz
    square = dx * dx + dy * dy + dz * dz
    if square == 0:
        return math.inf
    along = -(px * dx + py * dy + pz * dz) / square
    fx, fy, fz = px + along * dx, py + along * dy, pz + along * dz
    inside = s.a * s.a - (fx * fx + fy * fy + fz * fz)
    if inside < 0:
        return math.inf
    half = math.sqrt(inside / square)
    for t in (along - half, along + half):
        if t > NEAREST and 0 <= place + t * slope <= s.b:
            return t
    return math.inf


@compiled
def _zone(s: Shape, px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> float:
    """The part of a sphere between two heights, from outside or from inside."""
    along = -(px * dx + py * dy + pz * dz)
    fx, fy, fz = px + along * dx, py + along * dy, pz + along * dz
    square = s.a * s.a - (fx * fx + fy * fy + fz * fz)
    if square < 0:
        return math.inf
    half, place, slope = math.sqrt(square), px * s.nx + py * s.ny + pz * s.nz, dx * s.nx + dy * s.ny + dz * s.nz
    for t in (along - half, along + half):
        if t > NEAREST and s.b <= place + t * slope <= s.c:
            return t
    return math.inf


@compiled
def _inside(tables: Floats, first: int, count: int, x: float, y: float) -> bool:
    """Whether a point lies in a polygon: a ray from it crosses the sides an odd number of times."""
    odd = False
    last = first + 2 * (count - 1)
    for here in range(first, first + 2 * count, 2):
        x0, y0, x1, y1 = tables[last], tables[last + 1], tables[here], tables[here + 1]
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            odd = not odd
        last = here
    return odd


@compiled
def inverse_of(direction: float) -> float:
    """1/x, large in place of infinite."""
    if abs(direction) < 1 / _STEEPEST:
        return _STEEPEST
    return 1 / direction


@compiled
def _meets(box: Node, ox: float, oy: float, oz: float, ix: float, iy: float, iz: float, farthest: float) -> float:
    """Distance to a box, or infinity; `i` are inverses of the direction."""
    a, b = (box.x0 - ox) * ix, (box.x1 - ox) * ix
    near, far = min(a, b), max(a, b)
    a, b = (box.y0 - oy) * iy, (box.y1 - oy) * iy
    near, far = max(near, min(a, b)), min(far, max(a, b))
    a, b = (box.z0 - oz) * iz, (box.z1 - oz) * iz
    near, far = max(near, min(a, b)), min(far, max(a, b))
    return near if near <= far and far >= 0 and near <= farthest else math.inf


@compiled
def closest(
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    farthest: float,
    stack: Whole,
) -> tuple[float, int]:
    """Distance to the first shape that a ray meets nearer than `farthest`, and its number; else that and -1."""
    found = -1
    if not len(nodes):
        return farthest, found
    ix, iy, iz = inverse_of(dx), inverse_of(dy), inverse_of(dz)
    height, node = 0, 0
    if _meets(nodes[0], ox, oy, oz, ix, iy, iz, farthest) == math.inf:
        return farthest, found
    while True:
        count = nodes[node].count
        if count:
            first = nodes[node].first
            for i in range(first, first + count):
                t = crossing(shapes[i], tables, ox, oy, oz, dx, dy, dz)
                if t < farthest:
                    farthest, found = t, i
        else:
            one, two = node + 1, nodes[node].second
            near = _meets(nodes[one], ox, oy, oz, ix, iy, iz, farthest)
            other = _meets(nodes[two], ox, oy, oz, ix, iy, iz, farthest)
            if other < near:
                one, two, near, other = two, one, other, near
            if near < math.inf:
                if other < math.inf:
                    stack[height] = two
                    height += 1
                node = one
                continue
        node = -1
        while height and node < 0:
            height -= 1
            if _meets(nodes[stack[height]], ox, oy, oz, ix, iy, iz, farthest) < math.inf:
                node = stack[height]
        if node < 0:
            return farthest, found


@compiled
def hidden(
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    farthest: float,
    but: int,
    stack: Whole,
) -> bool:
    """Whether any shape but one stands on a ray before `farthest`."""
    if len(shapes) <= (but >= 0):
        return False
    stack[0] = 0
    return hider(shapes, nodes, tables, ox, oy, oz, dx, dy, dz, farthest, but, 1, stack) >= 0


@compiled
def hider(
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    farthest: float,
    but: int,
    height: int,
    stack: Whole,
) -> int:
    """Number of a shape, but one, that stands on a ray before `farthest`, or -1.

    Those are asked that nodes hold of which so many numbers are on the stack.
    """
    ix, iy, iz = inverse_of(dx), inverse_of(dy), inverse_of(dz)
    while height:
        height -= 1
        node = stack[height]
        if _meets(nodes[node], ox, oy, oz, ix, iy, iz, farthest) == math.inf:
            continue
        count = nodes[node].count
        if count:
            first = nodes[node].first
            for i in range(first, first + count):
                if i != but and crossing(shapes[i], tables, ox, oy, oz, dx, dy, dz) < farthest:
                    return i
        else:
            stack[height], stack[height + 1] = nodes[node].second, node + 1
            height += 2
    return -1


def padded(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Boxes wider by what rounding may take, so that a flat shape in the plane of its box's face is not missed."""
    size = max(float(np.abs(low).max(initial=0.0)), float(np.abs(high).max(initial=0.0)))
    return low - SLACK * size - NEAREST, high + SLACK * size + NEAREST
