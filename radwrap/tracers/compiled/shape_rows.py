"""Surfaces of targets and emitters as rows of numbers, sorted into a tree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.sources import Emitter, Luminaire, Patch
from radwrap.scene.targets import DiscShape, MeshShape, PolygonShape, SphereShape, TubeShape
from radwrap.scene.targets import Shape as WorldShape
from radwrap.tracers.compiled.arrays import (
    DISC,
    POLYGON,
    RECTANGLE,
    SPHERE,
    TRIANGLE,
    TUBE,
    Floats,
    Shape,
    Tree,
    put,
    rows,
)
from radwrap.tracers.compiled.intersect import padded
from radwrap.tracers.compiled.tree import tree_of
from radwrap.tracers.text_frame import TextFrame

# Width over length of triangles that rounding may turn by as much as a ten-millionth.
_THIN: Final = 1e-6
# How far from parallel, in their lengths, opposite sides of a rectangle may be, and adjacent ones from a right angle.
_RECTANGULAR: Final = 1e-12


@dataclass(frozen=True, slots=True)
class Piece:
    """One shape, whose it is, and what is painted on it.

    Attributes
    ----------
    shape : Shape
        In the world.
    owner : int
        Cover, or number of the emitter.
    decal : int
        Row of what is painted on it, or -1.
    """

    shape: WorldShape
    owner: int
    decal: int = -1


def emitter_shape(emitter: Emitter) -> WorldShape:
    """Where an emitter shines and what it hides."""
    if isinstance(emitter, Luminaire):
        return SphereShape(emitter.position, emitter.radius)
    if isinstance(emitter, Patch):
        return PolygonShape(emitter.corners)
    return DiscShape(emitter.position, emitter.axis, emitter.radius)


def sorted_shapes(
    pieces: Iterable[Piece],
    frame: TextFrame,
    tables: list[float],
    others: Sequence[tuple[NDArray[np.void], Floats]] = (),
) -> Tree:
    """Pieces as rows in the frame of the text, with their tree.

    Parameters
    ----------
    pieces : iterable of Piece
        Shapes in the world.
    frame : TextFrame
        Of the text.
    tables : list of float
        To which corners of polygons are added.
    others : sequence of (ndarray, ndarray)
        Rows that are made already, and their boxes, shape (n, 6).
    """
    found, boxes = [rows(Shape, 0)], [np.empty((0, 6))]
    for made, box in others:
        found.append(made)
        boxes.append(box)
    for piece in pieces:
        made, box = _row(piece.shape, frame, tables)
        made["owner"], made["decal"] = piece.owner, piece.decal
        found.append(made)
        boxes.append(box)
    box = np.concatenate(boxes)
    order, nodes = tree_of(*padded(box[:, :3], box[:, 3:]))
    return Tree(np.concatenate(found)[order], nodes)


def _row(shape: WorldShape, frame: TextFrame, tables: list[float]) -> tuple[NDArray[np.void], Floats]:
    """Rows of a shape, and their boxes."""
    match shape:
        case MeshShape(vertices, faces):
            return _triangles(frame.points(vertices)[faces])
        case PolygonShape(vertices):
            points = np.array([frame.point(vertex) for vertex in vertices])
            return _flat(points, tables), _box(points)
        case DiscShape(centre, normal, radius):
            middle, n, r = np.array(frame.point(centre)), np.array(normal), radius * frame.units
            reach = r * np.sqrt(np.maximum(1 - n**2, 0.0))
            row = _one(DISC, middle, (r * r, 0.0, float(n @ middle)), normal=n)
            return row, _box(np.array([middle - reach, middle + reach]))
        case SphereShape(centre, radius):
            middle, r = np.array(frame.point(centre)), radius * frame.units
            return _one(SPHERE, middle, (r, 0.0, 0.0)), _box(np.array([middle - r, middle + r]))
        case TubeShape(start, end, radius):
            ends, r = np.array([frame.point(start), frame.point(end)]), radius * frame.units
            length = float(np.linalg.norm(ends[1] - ends[0]))
            axis = (ends[1] - ends[0]) / length
            reach = r * np.sqrt(np.maximum(1 - axis**2, 0.0))
            row = _one(TUBE, ends[0], (r, length, 0.0), normal=axis)
            return row, _box(np.concatenate([ends - reach, ends + reach]))
        case _:
            assert_never(shape)


_NO_VECTOR: Final = np.zeros(3)


def _one(
    kind: int,
    point: Floats,
    sizes: tuple[float, float, float],
    *,
    u: Floats = _NO_VECTOR,
    v: Floats = _NO_VECTOR,
    normal: Floats = _NO_VECTOR,
) -> NDArray[np.void]:
    row = rows(Shape, 1)
    row["kind"] = kind
    put(row, "x y z ux uy uz vx vy vz nx ny nz a b c", np.concatenate([point, u, v, normal, sizes]))
    return row


def _box(points: Floats) -> Floats:
    return np.concatenate([points.min(axis=0), points.max(axis=0)])[np.newaxis]


def _triangles(corners: Floats) -> tuple[NDArray[np.void], Floats]:
    """Rows and boxes of triangles, shape (n, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(first, second)
    made = rows(Shape, len(corners))
    made["kind"] = TRIANGLE
    put(made, "x y z", corners[:, 0])
    put(made, "ux uy uz", first)
    put(made, "vx vy vz", second)
    area = np.linalg.norm(across, axis=1, keepdims=True)
    put(made, "nx ny nz", across / area)
    sides = (first, second, second - first)
    longest2 = np.max([np.sum(side * side, axis=1) for side in sides], axis=0)
    made["a"] = area[:, 0] > _THIN * longest2
    return made, np.hstack([corners.min(axis=1), corners.max(axis=1)])


def _flat(points: Floats, tables: list[float]) -> NDArray[np.void]:
    """Row of a flat polygon."""
    normal = area_vector(points)
    normal /= np.linalg.norm(normal)
    # A plane through the middle: the corners of a polygon may miss it by rounding.
    middle = points.mean(axis=0)
    height = float(normal @ middle)
    sides = np.roll(points, -1, axis=0) - points
    if len(points) == 4 and _is_rectangle(sides):
        width, depth = (float(np.linalg.norm(side)) for side in sides[:2])
        sizes = (width / 2, depth / 2, height)
        return _one(RECTANGLE, middle, sizes, u=sides[0] / width, v=sides[1] / depth, normal=normal)
    u = sides[0] - (sides[0] @ normal) * normal
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    sizes = (float(len(tables)), float(len(points)), height)
    tables += ((points - points[0]) @ np.stack([u, v], axis=1)).ravel().tolist()
    return _one(POLYGON, points[0], sizes, u=u, v=v, normal=normal)


def _is_rectangle(sides: Floats) -> bool:
    size = float(np.linalg.norm(sides, axis=1).max())
    parallel = np.abs(sides[:2] + sides[2:]).max() <= _RECTANGULAR * size
    return bool(parallel and abs(sides[0] @ sides[1]) <= _RECTANGULAR * size * size)


def area_vector(points: Floats) -> Floats:
    """Normal of a flat polygon, as long as its area is large (Newell)."""
    from_first = points - points[0]
    vector: Floats = np.cross(from_first, np.roll(from_first, -1, axis=0)).sum(axis=0) / 2
    return vector
