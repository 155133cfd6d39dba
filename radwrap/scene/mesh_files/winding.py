"""How the triangles of a mesh hang together: flipped ones, holes, separate bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Wound:
    """A mesh whose neighbours run the same way round, closed bodies counter-clockwise seen from outside.

    Attributes
    ----------
    faces : ndarray of int, shape (m, 3)
        Corners.
    flipped : int
        Triangles that were turned over.
    bodies : int
        Parts that share no side.
    open_sides : int
        Sides that belong to one triangle alone.
    holes : int
        Rims that those form.
    crowded_sides : int
        Sides that more than two triangles share.
    """

    faces: Index
    flipped: int
    bodies: int
    open_sides: int
    holes: int
    crowded_sides: int

    @property
    def closed(self) -> bool:
        """Whether there is an inside."""
        return self.open_sides == 0 and self.crowded_sides == 0


def wound(vertices: Array, faces: Index) -> Wound:
    """Turn triangles over until neighbours agree; of each body those that are fewer, or, if closed, its outside out.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3)
        [m]; equal ones joined.
    faces : ndarray of int, shape (m, 3)
        Corners.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    side = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    order = np.argsort(side, kind="stable")
    _, first, count = np.unique(side[order], return_index=True, return_counts=True)
    pairs = first[count == 2]
    one, other = order[pairs], order[pairs + 1]
    turned = start[one] == start[other]  # the same way along a common side: one of the two is flipped
    links = coo_array((np.ones(len(one)), (one // 3, other // 3)), shape=(len(faces), len(faces)))
    bodies, body = connected_components(links, directed=False)
    odd = _parities(one // 3, other // 3, turned, body, bodies)
    lone = order[first[count == 1]]
    turn = _turn(vertices, faces, odd, body, np.bincount(body[lone // 3], minlength=bodies) == 0)
    return Wound(
        np.where(turn[:, np.newaxis], faces[:, ::-1], faces),
        int(turn.sum()),
        int(bodies),
        len(lone),
        _rims(start[lone], end[lone]),
        int((count > 2).sum()),
    )


def _parities(one: Index, other: Index, turned: NDArray[np.bool_], body: NDArray[np.int32], bodies: int) -> Array:
    """0 or 1 for each triangle: whether it runs otherwise than the first of its body."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    number = len(body)
    # A node beyond the last triangle is joined to the first triangle of each body, so that one walk reaches all.
    roots = np.unique(body, return_index=True)[1]
    rows, columns = np.concatenate([one, np.full(bodies, number)]), np.concatenate([other, roots])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(number + 1, number + 1)).tocsr()
    before = breadth_first_order(graph, number, directed=False)[1].astype(np.intp)
    before[number] = number
    keys = np.concatenate([one * number + other, other * number + one])
    order = np.argsort(keys)
    odd = np.zeros(number + 1, dtype=np.int8)
    inner = np.flatnonzero(before[:number] < number)
    odd[inner] = np.tile(turned, 2)[order][np.searchsorted(keys, inner * number + before[inner], sorter=order)]
    # Each step doubles the way that a triangle has asked back towards its root.
    while (before != number).any():
        odd = odd ^ odd[before]
        before = before[before]
    flips: Array = odd[:number].astype(np.float64)
    return flips


def _turn(
    vertices: Array, faces: Index, odd: Array, body: NDArray[np.int32], closed: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    corners = vertices[faces] - vertices.mean(axis=0)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) * (1 - 2 * odd)
    inside_out = np.bincount(body, volume) < 0
    more_odd = np.bincount(body, odd) > np.bincount(body) / 2
    other_way: NDArray[np.bool_] = (odd > 0) ^ np.where(closed, inside_out, more_odd)[body]
    return other_way


def _rims(start: Index, end: Index) -> int:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(start):
        return 0
    names, place = np.unique(np.concatenate([start, end]), return_inverse=True)
    one, other = place.reshape(2, -1)
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(names), len(names)))
    return int(connected_components(graph, directed=False)[0])
