"""Polygons of mesh files as triangles that cover them once, whatever their shape."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# Cutting ears takes a time that grows with the cube of the corners.
_MOST_CORNERS: Final = 1000
# A triangle is turned over if its area is below minus so much of its polygon's: rounding of corners in one line.
_TURNED: Final = 1e-9
# Lobes that run otherwise cancel: an area vector that is this small beside the triangles' areas is that of a bow.
_CANCELLED: Final = 1e-6
# Rounding crosses the sides of slivers. Less than this share of the mesh's square, covered twice, shows nothing.
_SLIVER: Final = 1e-9


def checked(vertices: Array, corners: Index, where: str) -> None:
    """Refuse corners that are not there, and vertices that are no places.

    Raises
    ------
    InputError
        So too where a vertex that is used is NaN or infinite.
    """
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        raise InputError("names vertices that it does not hold", where=where, remedy="correct it")
    used = np.zeros(len(vertices), dtype=bool)
    used[corners] = True
    if not np.isfinite(vertices[used]).all():
        raise InputError("holds NaN or infinity", where=where, remedy="correct it")


def triangulated(vertices: Array, corners: Index, counts: Index, where: str) -> Index:
    """Triangles of polygons, in their order.

    A polygon is fanned from its first corner. Where that turns a triangle over, ears are cut off. Triangles that all
    run as their polygon does cover each place as often as the polygon winds about it: once, if no sides cross.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3)
        Places.
    corners : ndarray of int
        Numbers of vertices of all polygons, one after the other.
    counts : ndarray of int
        Corners of each polygon.
    where : str
        What named them, for messages.

    Raises
    ------
    InputError
        If a polygon has less than three corners, or crosses itself.
    """
    checked(vertices, corners, where)
    if not len(counts):
        return np.empty((0, 3), dtype=np.intp)
    if counts.min() < 3:
        raise InputError("holds a face of less than three corners", where=where, remedy="correct it")
    negligible = _SLIVER * float(np.ptp(vertices[corners], axis=0).max()) ** 2
    starts = np.cumsum(counts) - counts
    places = np.cumsum(counts - 2) - (counts - 2)
    faces = np.empty((int((counts - 2).sum()), 3), dtype=np.intp)
    for number in np.unique(counts):
        alike = counts == number
        polygons = corners[starts[alike, np.newaxis] + np.arange(number)]
        cut = _fanned(polygons)
        wrong = np.flatnonzero(~_covered(vertices[cut])) if number > 3 else ()
        for place in wrong:
            cut[place] = _cut(vertices, polygons[place], negligible, where)
        faces[places[alike, np.newaxis] + np.arange(number - 2)] = cut
    return faces


def ears(corners: Array) -> Index:
    """Triangles of a flat polygon without crossing sides, shape (n, 3), by cutting off one ear after the other."""
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners, following).sum(axis=0)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    flat = corners @ np.stack([first, np.cross(normal, first)]).T
    left = np.arange(len(corners))
    found = []
    while len(left) > 3:
        place = next((i for i in range(len(left)) if _is_ear(flat[left], i)), 0)
        found.append((left[place - 1], left[place], left[(place + 1) % len(left)]))
        left = np.delete(left, place)
    return np.array([*found, tuple(left)], dtype=np.intp)


def _is_ear(flat: Array, place: int) -> bool:
    a, b, c = (flat[(place + step) % len(flat)] for step in (-1, 0, 1))

    def turn(p: Array, q: Array, r: Array) -> Array:
        turned: Array = (q[0] - p[0]) * (r[..., 1] - p[1]) - (q[1] - p[1]) * (r[..., 0] - p[0])
        return turned

    if turn(a, b, c) <= 0:
        return False
    inside = (turn(a, b, flat) >= 0) & (turn(b, c, flat) >= 0) & (turn(c, a, flat) >= 0)
    corner = (flat == a).all(axis=1) | (flat == b).all(axis=1) | (flat == c).all(axis=1)
    return not (inside & ~corner).any()


def _fanned(polygons: Index) -> Index:
    first = np.broadcast_to(polygons[:, :1], polygons[:, 2:].shape)
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)


def _covered(places: Array, negligible: float = 0.0) -> NDArray[np.bool_]:
    """Whether all triangles of a polygon run as it does; shape (n,) of corners (n, triangles, 3, 3)."""
    across = np.cross(places[:, :, 1] - places[:, :, 0], places[:, :, 2] - places[:, :, 0])
    whole = across.sum(axis=1)
    square = (whole**2).sum(axis=1)
    along = (across * whole[:, np.newaxis]).sum(axis=2)
    areas, area = np.linalg.norm(across, axis=2).sum(axis=1), np.sqrt(square)
    one_way = (along >= -_TURNED * square[:, np.newaxis]).all(axis=1) & (area >= _CANCELLED * areas)
    found: NDArray[np.bool_] = one_way | (areas - area <= negligible)
    return found


def _cut(vertices: Array, polygon: Index, negligible: float, where: str) -> Index:
    if len(polygon) > _MOST_CORNERS:
        raise InputError(
            f"holds a face of {len(polygon)} corners that is not convex", where=where, remedy="cut it into triangles"
        )
    corners = vertices[polygon]
    cut = polygon[ears(corners - corners[0])]
    if not _covered(vertices[cut][np.newaxis], negligible)[0]:
        raise InputError("holds a face whose sides cross", where=where, remedy="cut it into triangles")
    return cut
