"""Triangle meshes: where rays meet them, and what of them is nearest.

Triangles are sorted along a Morton curve into leaves of eight, and the leaves'
boxes form a complete binary tree; all rays walk down it together, level by
level. A million triangles take a few seconds and no other library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_LEAF: Final = 8
_BITS: Final = 10  # of each coordinate in the Morton code
_RAYS_AT_ONCE: Final = 2048
# Rays that graze a box or a triangle's side meet it: two triangles with a common side leave no gap. Relative to the
# mesh, the triangle, or the distance.
_SLACK: Final = 1e-9
# A ray that starts on a triangle does not meet it there [m].
_START: Final = 1e-12
# A direction that no modelled face is parallel to.
_ODD_DIRECTION: Final = np.array([0.5377, 0.2841, 0.7937])


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles, and the tree of their boxes.

    Attributes
    ----------
    vertices : ndarray of float64, shape (n, 3)
        [m].
    faces : ndarray of int, shape (m, 3)
        Corners, counter-clockwise seen from outside.
    order : ndarray of int
        Faces in the order of the leaves, filled up with -1.
    low, high : ndarray, shape (nodes, 3)
        Boxes; node i has the children 2 i + 1 and 2 i + 2.
    """

    vertices: Array
    faces: Index
    order: Index
    low: Array
    high: Array

    @property
    def corners(self) -> Array:
        """Corners of all triangles, shape (m, 3, 3) [m]."""
        return self.vertices[self.faces]

    @property
    def normals(self) -> Array:
        """Unit normals of all triangles, shape (m, 3)."""
        return _normals(self.corners)


def mesh_of(vertices: Array, faces: Index) -> Mesh:
    """Sort triangles, which must have an area, into a tree."""
    corners = vertices[faces]
    middle = corners.mean(axis=1)
    low, size = vertices.min(axis=0), max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    cell = np.minimum((middle - low) / size * 2**_BITS, 2**_BITS - 1).astype(np.int64)
    code = np.zeros(len(faces), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    leaves = 1 << max(0, math.ceil(math.log2(len(faces) / _LEAF)))
    padded = np.full(leaves * _LEAF, -1, dtype=np.intp)
    padded[: len(order)] = order
    filled = (padded >= 0)[:, np.newaxis]
    slack = _SLACK * size
    lows = np.where(filled, corners.min(axis=1)[padded] - slack, np.inf).reshape(leaves, _LEAF, 3).min(axis=1)
    highs = np.where(filled, corners.max(axis=1)[padded] + slack, -np.inf).reshape(leaves, _LEAF, 3).max(axis=1)
    levels = [(lows, highs)]
    while len(levels[0][0]) > 1:
        lows, highs = levels[0]
        levels.insert(0, (np.minimum(lows[::2], lows[1::2]), np.maximum(highs[::2], highs[1::2])))
    return Mesh(
        vertices,
        faces,
        padded,
        np.concatenate([lows for lows, _ in levels]),
        np.concatenate([highs for _, highs in levels]),
    )


def mesh_hit(mesh: Mesh, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Where rays first meet a mesh.

    Parameters
    ----------
    mesh : Mesh
        The triangles.
    origins, directions : ndarray, shape (n, 3)
        In the mesh's frame [m]; unit vectors.

    Returns
    -------
    distance : ndarray, shape (n,)
        [m]; infinite where a ray misses.
    normals : ndarray, shape (n, 3)
        Of the triangles that are met; 0 where a ray misses.
    """
    distance, normals = np.full(len(directions), np.inf), np.zeros_like(directions)
    for start in range(0, len(directions), _RAYS_AT_ONCE):
        part = slice(start, start + _RAYS_AT_ONCE)
        ray, t, face = _all_hits(mesh, origins[part], directions[part])
        nearest = np.lexsort((t, ray))
        first, place = np.unique(ray[nearest], return_index=True)
        chosen = nearest[place]
        distance[start + first] = t[chosen]
        normals[start + first] = _normals(mesh.vertices[mesh.faces[face[chosen]]])
    return distance, normals


def contains(mesh: Mesh, point: Array) -> bool:
    """Whether a point lies inside a closed mesh; of one with holes it may be either."""
    direction = (_ODD_DIRECTION / np.linalg.norm(_ODD_DIRECTION))[np.newaxis]
    return len(_all_hits(mesh, point[np.newaxis], direction)[0]) % 2 == 1


def nearest_on(mesh: Mesh, point: Array) -> tuple[Array, Array]:
    """The nearest point of a mesh and the normal of its triangle, each shape (3,)."""
    # Corners of triangles only: a file may have others, nearer than any triangle.
    bound = float(np.sqrt(((mesh.corners - point) ** 2).sum(axis=-1).min()))
    leaves = len(mesh.order) // _LEAF
    low, high = mesh.low[-leaves:], mesh.high[-leaves:]
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0), axis=1)
    near = mesh.order.reshape(leaves, _LEAF)[away <= bound * (1 + _SLACK)].ravel()
    near = near[near >= 0]
    corners = mesh.vertices[mesh.faces[near]]
    closest = _closest(corners, point)
    best = int(((closest - point) ** 2).sum(axis=1).argmin())
    return closest[best], _normals(corners[best : best + 1])[0]


def _normals(corners: Array) -> Array:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit: Array = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    return unit


def _all_hits(mesh: Mesh, origins: Array, directions: Array) -> tuple[Index, Array, Index]:
    """Every crossing: number of the ray, distance along it, and face."""
    with np.errstate(divide="ignore"):
        inverse = 1.0 / directions
    ray, node = np.arange(len(directions)), np.zeros(len(directions), dtype=np.intp)
    leaves = len(mesh.order) // _LEAF
    for level in range(leaves.bit_length()):
        if level:
            ray, node = np.repeat(ray, 2), np.concatenate([2 * node + 1, 2 * node + 2]).reshape(2, -1).T.ravel()
        kept = _meets_box(mesh.low[node], mesh.high[node], origins[ray], inverse[ray])
        ray, node = ray[kept], node[kept]
    faces = mesh.order.reshape(leaves, _LEAF)[node - (leaves - 1)]
    ray = np.repeat(ray, _LEAF)
    face = faces.ravel()
    ray, face = ray[face >= 0], face[face >= 0]
    t = _crossing(mesh.vertices[mesh.faces[face]], origins[ray], directions[ray])
    met = np.isfinite(t)
    return ray[met], t[met], face[met]


def _meets_box(low: Array, high: Array, origin: Array, inverse: Array) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        first, second = (low - origin) * inverse, (high - origin) * inverse
    near = np.fmax.reduce(np.fmin(first, second), axis=1)
    far = np.fmin.reduce(np.fmax(first, second), axis=1)
    # An empty box runs from infinity to minus infinity, and would be met by every ray.
    meets: NDArray[np.bool_] = (near <= far + _SLACK * np.abs(far)) & (far > 0) & (low[:, 0] <= high[:, 0])
    return meets


def _crossing(corners: Array, origin: Array, direction: Array) -> Array:
    """Distance to triangles after Moeller and Trumbore (1997); infinite where they are missed."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(direction, second)
    determinant = (first * normal).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = origin - corners[:, 0]
        u = (away * normal).sum(axis=1) / determinant
        turned = np.cross(away, first)
        v = (direction * turned).sum(axis=1) / determinant
        t = (second * turned).sum(axis=1) / determinant
        inside = (u >= -_SLACK) & (v >= -_SLACK) & (u + v <= 1 + _SLACK) & (t > _START)
    return np.where(inside, t, np.inf)


def _closest(corners: Array, point: Array) -> Array:
    """The point of each triangle that is nearest: its foot inside, else the nearest of the three sides."""
    a = corners[:, 0]
    normal = _normals(corners)
    foot = point - ((point - a) * normal).sum(axis=1)[:, np.newaxis] * normal
    sides = np.roll(corners, -1, axis=1) - corners
    turn = (np.cross(sides, foot[:, np.newaxis] - corners) * normal[:, np.newaxis]).sum(axis=2)
    share = ((point - corners) * sides).sum(axis=2) / np.maximum((sides**2).sum(axis=2), 1e-300)
    feet = corners + np.clip(share, 0.0, 1.0)[..., np.newaxis] * sides
    which = ((feet - point) ** 2).sum(axis=2).argmin(axis=1)
    nearest: Array = np.where((turn >= 0).all(axis=1)[:, np.newaxis], foot, feet[np.arange(len(feet)), which])
    return nearest
