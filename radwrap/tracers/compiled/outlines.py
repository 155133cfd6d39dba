"""Blocks in shadows, and between them: where no outline falls on a block, each light reaches all of it or none.

From a point of light a shape hides more or less of a block only if its outline, as seen from there, lies before the
block. The outline of a mesh consists of edges whose two triangles lie on one side, as the light sees them, and of edges
that have one triangle only. Edges between two triangles that part them, as most do, change nothing.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.compiled.arrays import (
    RECTANGLE,
    TRIANGLE,
    Cluster,
    Clusters,
    Floats,
    Nodes,
    Shape,
    Shapes,
    Whole,
    put,
    rows,
)
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.shadows import OFF, aside
from radwrap.tracers.compiled.shaft import box_of, next_leaf, shaft_between
from radwrap.tracers.compiled.whole_face import corner

# Lights that are asked one by one, and triangles whose neighbours are looked up, at most: what it saves is rays of one
# image, and each light costs as much as a ray for each block.
MOST_LIGHTS: Final = 256
_MOST_TRIANGLES: Final = 200_000
# Of the size of all that is there: corners of triangles that are so near are one.
_ONE_CORNER: Final = 1e-9
# Of the product of lengths: a corner so near to the plane through a light and an edge may lie on either side.
_IN_PLANE: Final = 1e-9
# Rows of what a light sees of a block, see `_aim`.
_LIGHT: Final = 4
_MIDDLE: Final = 5
_NORMAL: Final = 6
_HEIGHTS: Final = 7


def room() -> Floats:
    """Room to work in: what a light sees of a block, see `_aim`."""
    return np.empty((_HEIGHTS + 1, 3))


def edges_of(shapes: NDArray[np.void]) -> Floats:
    """What lies beyond the edges of triangles, shape (shapes, 3, 4).

    The edge k leads from the corner k to the next. Of each: 1 where one other triangle has it too, else 0, and the
    corner of that triangle which is not on the edge.
    """
    found = np.zeros((len(shapes), 3, 4))
    triangles = np.flatnonzero(shapes["kind"] == TRIANGLE)
    if not 0 < len(triangles) <= _MOST_TRIANGLES:
        return found
    corners = corners_of_triangles(shapes[triangles])
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    near = np.rint((corners - corners.min(axis=(0, 1))) / (_ONE_CORNER * size)).astype(np.int64)
    _, number = np.unique(near.reshape(-1, 3), axis=0, return_inverse=True)
    ends = np.stack([number.reshape(-1, 3), np.roll(number.reshape(-1, 3), -1, axis=1)], axis=-1).reshape(-1, 2)
    _, edge, count = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.ravel(), kind="stable")
    pairs = order[count[edge.ravel()[order]] == 2].reshape(-1, 2)
    for own, other in (pairs.T, pairs.T[::-1]):
        there = found[triangles[own // 3], own % 3]
        there[:, 0], there[:, 1:] = 1.0, corners[other // 3, (other % 3 + 2) % 3]
        found[triangles[own // 3], own % 3] = there
    return found


def corners_of_triangles(triangles: NDArray[np.void]) -> Floats:
    """Shape (triangles, 3, 3)."""
    first, u, v = (
        np.stack([triangles[name] for name in names.split()], axis=-1) for names in ("x y z", "ux uy uz", "vx vy vz")
    )
    return np.stack([first, first + u, first + v], axis=1)


def places_of(lights: NDArray[np.void], clusters: NDArray[np.void]) -> NDArray[np.void]:
    """Boxes without size, of all lights of some clusters: also of those that are switched off, as others may ask."""
    some = np.concatenate([np.arange(0), *(np.arange(one["first"], one["end"]) for one in clusters)])
    boxes = rows(Cluster, len(some))
    for end in "01":
        put(boxes, f"x{end} y{end} z{end}", np.stack([lights[axis][some] for axis in "xyz"], axis=-1))
    return boxes


@compiled
def settle(
    shapes: Shapes,
    nodes: Nodes,
    edges: Floats,
    lights: Clusters,
    boxes: Clusters,
    places: Floats,
    met: Whole,
    spare: float,
    eye: Floats,
    stack: Whole,
    seen: Floats,
    even: NDArray[np.bool_],
) -> None:
    """Take away, of the blocks that may be `even`, those on which an outline may fall.

    Parameters
    ----------
    shapes, nodes, edges
        What may hide, and what lies beyond its edges, see `edges_of`.
    lights : Clusters
        Boxes without size.
    boxes : Clusters
        Those of the blocks.
    places : ndarray, shape (blocks, 5, 3)
        Corners of the blocks, one after the other around them, and their middles.
    met : ndarray of int, shape (blocks,)
        A face of each.
    spare : float
        By this share of its size each block is taken to be larger.
    eye : ndarray, shape (3,)
        From where they are seen.
    stack, seen : ndarray
        Room to work in: of integers, and of `room`.
    even : ndarray of bool, shape (blocks,)
        Changed.
    """
    for b in range(len(boxes)):
        i = 0
        while even[b] and i < len(lights):
            _aim(shapes[met[b]], places[b], spare, eye, lights[i], seen)
            even[b] = _is_even(shapes, nodes, edges, lights[i], boxes[b], met[b], stack, seen)
            i += 1


@compiled
def _aim(face: Shape, places: Floats, spare: float, eye: Floats, light: Cluster, seen: Floats) -> None:
    """Fill in what a light sees of a block.

    These are normals of the four planes through the light and the block's sides, which show to its middle; the light;
    the middle; the face's normal on the side of the eye; and heights over the face: the light's, and the least that
    differs from 0.
    """
    lx, ly, lz = light.x0, light.y0, light.z0
    mx, my, mz = places[4, 0], places[4, 1], places[4, 2]
    share = 1 + spare
    for k in range(4):
        p, q = k, k + 1 if k < 3 else 0
        px, py, pz = (
            mx - lx + share * (places[p, 0] - mx),
            my - ly + share * (places[p, 1] - my),
            mz - lz + share * (places[p, 2] - mz),
        )
        qx, qy, qz = (
            mx - lx + share * (places[q, 0] - mx),
            my - ly + share * (places[q, 1] - my),
            mz - lz + share * (places[q, 2] - mz),
        )
        sx, sy, sz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        side = 1.0 if sx * (mx - lx) + sy * (my - ly) + sz * (mz - lz) >= 0 else -1.0
        seen[k, 0], seen[k, 1], seen[k, 2] = side * sx, side * sy, side * sz
    side = 1.0 if (eye[0] - mx) * face.nx + (eye[1] - my) * face.ny + (eye[2] - mz) * face.nz >= 0 else -1.0
    seen[_LIGHT, 0], seen[_LIGHT, 1], seen[_LIGHT, 2] = lx, ly, lz
    seen[_MIDDLE, 0], seen[_MIDDLE, 1], seen[_MIDDLE, 2] = mx, my, mz
    seen[_NORMAL, 0], seen[_NORMAL, 1], seen[_NORMAL, 2] = side * face.nx, side * face.ny, side * face.nz
    seen[_HEIGHTS, 0] = _height(lx, ly, lz, seen)
    seen[_HEIGHTS, 1] = OFF * (abs(lx - mx) + abs(ly - my) + abs(lz - mz))


@compiled
def _height(x: float, y: float, z: float, seen: Floats) -> float:
    """Of a place over the face."""
    return (
        (x - seen[_MIDDLE, 0]) * seen[_NORMAL, 0]
        + (y - seen[_MIDDLE, 1]) * seen[_NORMAL, 1]
        + (z - seen[_MIDDLE, 2]) * seen[_NORMAL, 2]
    )


@compiled
def _is_even(
    shapes: Shapes, nodes: Nodes, edges: Floats, light: Cluster, block: Cluster, but: int, stack: Whole, seen: Floats
) -> bool:
    """Whether no outline lies between a point of light and a block; only "yes" is sure."""
    over, least = seen[_HEIGHTS, 0], seen[_HEIGHTS, 1]
    if over < -least:  # it shines on the face's other side
        return True
    if over <= least:
        return False
    x0, y0, z0, x1, y1, z1 = box_of(block)
    shaft, height = shaft_between((x0, y0, z0, x1, y1, z1), box_of(light)), 1
    stack[0] = 0
    while True:
        leaf, height = next_leaf(nodes, shaft, height, stack)
        if leaf < 0:
            return True
        for i in range(nodes[leaf].first, nodes[leaf].first + nodes[leaf].count):
            s = shapes[i]
            if i == but or aside(s, light, x0, y0, z0, x1, y1, z1, True):
                continue
            if s.kind == TRIANGLE:
                if _has_outline(s, edges[i], seen):
                    return False
            elif s.kind != RECTANGLE or _has_rim(s, seen):
                return False


@compiled
def _has_outline(s: Shape, beyond: Floats, seen: Floats) -> bool:
    """Whether an edge of a triangle may be an outline before the block."""
    for k in range(3):
        px, py, pz = corner(s, k)
        qx, qy, qz = corner(s, (k + 1) % 3)
        if _is_outside(px, py, pz, qx, qy, qz, seen):
            continue
        if beyond[k, 0] == 0:
            return True
        lx, ly, lz = seen[_LIGHT, 0], seen[_LIGHT, 1], seen[_LIGHT, 2]
        rx, ry, rz = corner(s, (k + 2) % 3)
        ax, ay, az, bx, by, bz = px - lx, py - ly, pz - lz, qx - lx, qy - ly, qz - lz
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        wx, wy, wz = beyond[k, 1] - lx, beyond[k, 2] - ly, beyond[k, 3] - lz
        rx, ry, rz = rx - lx, ry - ly, rz - lz
        own, other = cx * rx + cy * ry + cz * rz, cx * wx + cy * wy + cz * wz
        if own < 0:
            own, other = -own, -other
        # Products of lengths, not of what they differ by: as large as rounding of the sums above may be.
        size = math.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz))
        least = _IN_PLANE * size * math.sqrt(max(rx * rx + ry * ry + rz * rz, wx * wx + wy * wy + wz * wz))
        if not (own > least and other < -least):  # both on one side, as far as is sure
            return True
    return False


@compiled
def _has_rim(s: Shape, seen: Floats) -> bool:
    """Whether a side of a rectangle may be before the block."""
    across, up = s.a, s.b
    for _ in range(4):  # a quarter of a turn from corner to corner: (a, b), (-a, b), (-a, -b), (a, -b)
        following_across, following_up = (-across, up) if across * up > 0 else (across, -up)
        if not _is_outside(
            s.x + across * s.ux + up * s.vx,
            s.y + across * s.uy + up * s.vy,
            s.z + across * s.uz + up * s.vz,
            s.x + following_across * s.ux + following_up * s.vx,
            s.y + following_across * s.uy + following_up * s.vy,
            s.z + following_across * s.uz + following_up * s.vz,
            seen,
        ):
            return True
        across, up = following_across, following_up
    return False


@compiled
def _is_outside(px: float, py: float, pz: float, qx: float, qy: float, qz: float, seen: Floats) -> bool:
    """Whether a line from p to q lies beside, beyond or behind all light from a point to a block.

    Only "yes" is sure.
    """
    p, q = _height(px, py, pz, seen), _height(qx, qy, qz, seen)
    if max(p, q) <= seen[_HEIGHTS, 1] or min(p, q) >= seen[_HEIGHTS, 0]:
        return True
    lx, ly, lz = seen[_LIGHT, 0], seen[_LIGHT, 1], seen[_LIGHT, 2]
    for k in range(4):
        sx, sy, sz = seen[k, 0], seen[k, 1], seen[k, 2]
        p = (px - lx) * sx + (py - ly) * sy + (pz - lz) * sz
        q = (qx - lx) * sx + (qy - ly) * sy + (qz - lz) * sz
        if p < 0 and q < 0:
            return True
    return False
