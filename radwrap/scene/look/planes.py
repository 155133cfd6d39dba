"""Surfaces that share a place: of those a tracer shows either, by chance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.look.geometry import across, circle
from radwrap.scene.look.intersections import in_polygon
from radwrap.scene.look.superposed import superposed
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire, Patch, Ring, emitters
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DiscShape,
    DotBoard,
    EdgeTarget,
    MeshPart,
    PatternTarget,
    Polygon,
    PolygonShape,
    RadFile,
    Sheet,
    Sphere,
    Target,
    surfaces,
)

Array = NDArray[np.float64]

# Radiance takes surfaces for one within 1e-6 units, which are mm, along a ray; ten times that for oblique rays.
_ONE_PLANE: Final = 1e-8  # m
# Sides that only touch cross at their ends, give or take rounding; so do circles of a row of discs.
_ENDS: Final = 1e-6
_INNER: Final = 15
# Files of meshes hold float32: of their corners so large a share is chance.
_FLOAT32: Final = 1e-7
_MOST_PAIRS: Final = 1_000_000  # of faces that are looked at together
# Triangles in a face's plane that are held against it one by one; of more, only their middles are.
_MOST_TRIANGLES: Final = 2000


@dataclass(frozen=True, slots=True, eq=False)
class _Face:
    """A flat face.

    Attributes
    ----------
    owner : str
        Name of its target or source.
    normal : ndarray, shape (3,)
        Unit normal.
    corners : ndarray, shape (n, 3)
        In the world [m].
    shines : bool
        Whether it belongs to a source.
    solid : bool
        Whether it bounds a body, which hides it from behind.
    turned_to_camera : bool
        Whether the camera is on the side of its normal.
    """

    owner: str
    normal: Array
    corners: Array
    shines: bool
    solid: bool
    turned_to_camera: bool


def check_planes(scene: Scene) -> None:
    """No two surfaces may overlap in one plane, unless they are sources that add up.

    Bodies that touch face to face are allowed: nobody sees either face.

    Raises
    ------
    InputError
        Naming the first two, or the ring whose LEDs overlap.
    """
    for source in scene.sources:
        if isinstance(source, Ring):
            _check_ring(scene, source)
    shown = {group[0].name for group in superposed(scene.emitters)}
    shining = [(source.name, one) for source in scene.sources for one in emitters(source) if one.name in shown]
    _check_luminaires(scene, shining)
    faces = [face for target in scene.targets for face in _faces(scene, target)]
    faces += [_emitter_face(scene, name, one) for name, one in shining if not isinstance(one, Luminaire)]
    for first, second in _in_one_plane(faces):
        if _compete(first, second) and _overlap(first, second):
            raise _refused(scene, first.owner, second.owner)
    for part in scene.targets:
        if isinstance(part, MeshPart):
            _check_mesh(scene, part, [face for face in faces if face.owner != part.name])


def _refused(scene: Scene, first: str, second: str) -> InputError:
    kind, things = next(
        (kind, things)
        for kind, things in (("sources", scene.sources), ("targets", scene.targets))
        if any(thing.name == second for thing in things)
    )
    number = [thing.name for thing in things].index(second)
    return InputError(
        f'"{first}" and "{second}" overlap in one plane: which of them is seen would be left to chance',
        where=f"{scene.origin}: {kind}[{number}]",
        remedy="move one of them by 0.01 mm or more",
    )


def _check_ring(scene: Scene, ring: Ring) -> None:
    diameter = 2 * ring.led_radius
    if ring.count < 2 or ring.diameter * math.sin(math.pi / ring.count) >= diameter * (1 - _ENDS):
        return
    room = int(math.pi / math.asin(diameter / ring.diameter) + _ENDS) if diameter < ring.diameter else 1
    raise InputError(
        f'the LEDs of "{ring.name}" overlap: a circle of {ring.diameter * 1e3:g} mm has room for {room} LEDs of '
        f"{diameter * 1e3:g} mm",
        where=f"{scene.origin}: sources[{scene.sources.index(ring)}].count",
        remedy="take fewer or smaller LEDs, or a larger ring",
    )


def _check_luminaires(scene: Scene, shining: list[tuple[str, Emitter]]) -> None:
    """The sphere of a luminaire may not meet another source: either would hide the other's light."""
    places = np.array([emitter.position for _, emitter in shining]).reshape(-1, 3)
    radii = np.array([emitter.radius for _, emitter in shining])
    for number, (name, emitter) in enumerate(shining):
        if isinstance(emitter, Luminaire):
            near = np.linalg.norm(places - places[number], axis=1) < (radii + emitter.radius) * (1 - _ENDS)
            near[number] = False
            if near.any():
                raise InputError(
                    f'"{name}" and "{shining[int(near.argmax())][0]}" meet: either would hide light of the other',
                    where=f"{scene.origin}: sources",
                    remedy="move one of them",
                )


def _in_one_plane(faces: list[_Face]) -> Iterator[tuple[_Face, _Face]]:
    """Pairs of faces of two owners that may lie in one plane, near enough to meet; in the order of the faces."""
    middles = np.array([face.corners.mean(axis=0) for face in faces]).reshape(-1, 3)
    normals = np.array([face.normal for face in faces]).reshape(-1, 3)
    reach = np.array(
        [np.linalg.norm(face.corners - middle, axis=1).max() for face, middle in zip(faces, middles, strict=True)]
    )
    lows = np.array([face.corners.min(axis=0) for face in faces]).reshape(-1, 3) - _ONE_PLANE
    highs = np.array([face.corners.max(axis=0) for face in faces]).reshape(-1, 3) + _ONE_PLANE
    owners = np.unique([face.owner for face in faces], return_inverse=True)[1]
    found = [np.empty((0, 2), dtype=np.intp)]
    for pairs in _beside_each_other(lows, highs):
        a, b = pairs[owners[pairs[:, 0]] != owners[pairs[:, 1]]].T
        gap = middles[b] - middles[a]
        # A plane through a face's corners holds their mean too.
        flat = np.abs((gap * normals[a]).sum(axis=1)) <= _ONE_PLANE + _ENDS * reach[a]
        near = np.linalg.norm(gap, axis=1) <= reach[a] + reach[b] + _ONE_PLANE
        found.append(np.stack([a, b], axis=1)[flat & near])
    together = np.concatenate(found)
    for first, second in together[np.lexsort((together[:, 1], together[:, 0]))]:
        yield faces[first], faces[second]


def _beside_each_other(lows: Array, highs: Array) -> Iterator[NDArray[np.intp]]:
    """Pairs of numbers, shape (n, 2), the lower first, of boxes along the world's axes that meet.

    Those that overlap along the axis along which fewest do are looked at: each against all others takes minutes.
    """
    if len(lows) < 2:
        return
    order, counts = min((_along(lows[:, axis], highs[:, axis]) for axis in range(3)), key=lambda found: found[1].sum())
    ends = np.cumsum(counts)
    start = 0
    while start < len(order):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + _MOST_PAIRS, side="right")))
        each = counts[start:stop]
        one = np.repeat(np.arange(start, stop), each)
        other = one + 1 + np.arange(len(one)) - np.repeat(ends[start:stop] - each - done, each)
        one, other = order[one], order[other]
        meet = ((lows[one] <= highs[other]) & (lows[other] <= highs[one])).all(axis=1)
        yield np.sort(np.stack([one[meet], other[meet]], axis=1), axis=1)
        start = stop


def _along(low: Array, high: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Numbers of stretches in the order of their beginnings, and how many that follow each begin before it ends."""
    order = np.argsort(low, kind="stable")
    return order, np.searchsorted(low[order], high[order], side="right") - np.arange(1, len(order) + 1)


def _compete(first: _Face, second: _Face) -> bool:
    """Whether a ray may meet both faces from one side, with nothing before them."""
    if first.shines and second.shines:
        return True
    if first.shines or second.shines:
        body = second if first.shines else first
        return not body.solid or float(first.normal @ second.normal) > 0
    return all(face.turned_to_camera or not face.solid for face in (first, second))


def _face(
    scene: Scene, owner: str, normal: Array, corners: Array, *, shines: bool = False, solid: bool = False
) -> _Face:
    seen = float((np.asarray(scene.camera.pose.position) - corners[0]) @ normal) > 0
    return _Face(owner, normal, corners, shines, solid, seen)


def _emitter_face(scene: Scene, owner: str, emitter: Emitter) -> _Face:
    normal = np.asarray(emitter.axis)
    if isinstance(emitter, Patch):
        return _face(scene, owner, normal, np.asarray(emitter.corners), shines=True)
    corners = np.asarray(emitter.position) + emitter.radius * circle() @ across(normal)
    return _face(scene, owner, normal, corners, shines=True)


def _faces(scene: Scene, target: Target) -> Iterator[_Face]:
    """Flat faces of a target, without those of meshes."""
    match target:
        case Sheet() | DotBoard() | EdgeTarget() | PatternTarget():
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (target.width / 2, target.height / 2)
        case Disc():
            corners = circle() * target.diameter / 2
        case Polygon():
            corners = np.asarray(target.vertices)
        case Box() | Cylinder():
            for surface in surfaces(target):
                if isinstance(surface.shape, PolygonShape):
                    points = np.asarray(surface.shape.vertices)
                    normal = np.cross(points[1] - points[0], points[2] - points[1])
                    yield _face(scene, target.name, normal / np.linalg.norm(normal), points, solid=True)
                elif isinstance(surface.shape, DiscShape):
                    normal = np.asarray(surface.shape.normal)
                    points = np.asarray(surface.shape.centre) + surface.shape.radius * circle() @ across(normal)
                    yield _face(scene, target.name, normal, points, solid=True)
            return
        case Sphere() | MeshPart() | RadFile():
            return
        case _:
            assert_never(target)
    local = np.column_stack([corners, np.zeros(len(corners))])
    world = local @ np.asarray(target.pose.rotation).T + target.pose.position
    yield _face(scene, target.name, np.asarray(target.pose.z_axis), world)


def _check_mesh(scene: Scene, part: MeshPart, faces: list[_Face]) -> None:
    """None of a mesh's triangles may overlap another part's face in one plane."""
    vertices = part.mesh.vertices @ np.asarray(part.pose.rotation).T + part.pose.position
    near = _ONE_PLANE + _FLOAT32 * float(np.abs(part.mesh.vertices).max())
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    box = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    for face in faces:
        beside = (box - face.corners[0]) @ face.normal
        if beside.min() > near or beside.max() < -near:
            continue
        inside = (np.abs((vertices - face.corners[0]) @ face.normal) <= near)[part.mesh.faces].all(axis=1)
        if inside.any() and _meets(scene, part, face, vertices[part.mesh.faces[inside]]):
            raise _refused(scene, part.name, face.owner)


def _meets(scene: Scene, part: MeshPart, face: _Face, triangles: Array) -> bool:
    """Whether one of a mesh's triangles in a face's plane, shape (n, 3, 3), competes with it."""
    axes = across(face.normal)
    flat, rim = (triangles - face.corners[0]) @ axes.T, (face.corners - face.corners[0]) @ axes.T
    touches = (flat.max(axis=1) > rim.min(axis=0)).all(axis=1) & (flat.min(axis=1) < rim.max(axis=0)).all(axis=1)
    made = [_triangle(scene, part, corners) for corners in triangles[touches][:_MOST_TRIANGLES]]
    if any(_compete(one, face) and _overlap(one, face, math.inf) for one in made):
        return True
    rest = flat[touches][_MOST_TRIANGLES:]
    return bool(in_polygon(rim, rest.mean(axis=1)).any())


def _triangle(scene: Scene, part: MeshPart, corners: Array) -> _Face:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return _face(scene, part.name, normal / np.linalg.norm(normal), corners, solid=part.closed)


def _beside(face: _Face, plane: _Face) -> float:
    """How far a face leaves another one's plane [m]."""
    return float(np.abs((face.corners - plane.corners[0]) @ plane.normal).max())


def _overlap(a: _Face, b: _Face, near: float = _ONE_PLANE) -> bool:
    """Whether two faces share more than a border, in one plane."""
    if min(_beside(a, b), _beside(b, a)) > near:
        return False
    axes = across(a.normal)
    first, second = (a.corners - a.corners[0]) @ axes.T, (b.corners - a.corners[0]) @ axes.T
    if (first.max(axis=0) <= second.min(axis=0)).any() or (second.max(axis=0) <= first.min(axis=0)).any():
        return False
    return (
        bool(in_polygon(second, _inner_points(first)).any())
        or bool(in_polygon(first, _inner_points(second)).any())
        or _cross(first, second)
    )


def _inner_points(corners: Array) -> Array:
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y = (np.linspace(a, b, _INNER + 2)[1:-1] for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return grid[in_polygon(corners, grid)]


def _cross(first: Array, second: Array) -> bool:
    """Whether sides of two polygons cross, not only touch."""
    along = np.roll(second, -1, axis=0) - second
    for start, end in zip(first, np.roll(first, -1, axis=0), strict=True):
        side = end - start
        turn = side[0] * along[:, 1] - side[1] * along[:, 0]
        gap = second - start
        with np.errstate(divide="ignore", invalid="ignore"):
            on_first = (gap[:, 0] * along[:, 1] - gap[:, 1] * along[:, 0]) / turn
            on_second = (gap[:, 0] * side[1] - gap[:, 1] * side[0]) / turn
        parallel = np.abs(turn) <= _ENDS * math.hypot(*side) * np.hypot(*along.T)
        inside = [(share > _ENDS) & (share < 1 - _ENDS) for share in (on_first, on_second)]
        if (inside[0] & inside[1] & ~parallel).any():
            return True
    return False
