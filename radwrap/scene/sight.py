"""What stands in the camera's sight: sources that hide targets or shine in, targets that share a plane."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.geometry import directions, project
from radwrap.scene.intersections import first_hit, in_polygon
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Source, WideSource, emitters
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DiscShape,
    DotBoard,
    EdgeTarget,
    Polygon,
    PolygonShape,
    Sheet,
    Target,
    surfaces,
)

Array = NDArray[np.float64]

_NEAREST: Final = 1e-9  # m; what lies in the pinhole's own plane is in nobody's sight
_VIEW_RAYS: Final = 33
_ROUND: Final = 32  # points on a circle
_INNER: Final = 15
# Radiance takes surfaces for one within 1e-6 units, which are mm, along a ray; ten times that for oblique rays.
_ONE_PLANE: Final = 1e-8  # m
# Sides that only touch cross at their ends, give or take rounding.
_ENDS: Final = 1e-6


def sources_in_sight(scene: Scene) -> Iterator[str]:
    """A line for each source whose disc is seen from the front, or hides a part of a target.

    A dark source has no disc: it is left out of what is traced.
    """
    for source in scene.sources:
        facing, hiding, hidden = 0, 0, ""
        if isinstance(source, WideSource) and source.kind == "surround":
            continue  # nothing lies behind it
        for emitter in emitters(source):
            behind = _behind(scene, emitter) if emitter.radiance > 0 else None
            if behind is None:
                continue
            towards = np.asarray(scene.camera.pose.position) - emitter.position
            if towards @ np.asarray(emitter.axis) > 0:
                facing += 1
            elif behind:
                hiding, hidden = hiding + 1, behind
        if facing:
            yield f"{_discs(source, facing)} in view from the front: there the image shows the light itself"
        if hiding:
            yield f'{_discs(source, hiding)} between the camera and "{hidden}", part of which is hidden'


def _discs(source: Source, number: int) -> str:
    if isinstance(source, WideSource):
        return f'a part of "{source.name}" is'
    return f'the disc of "{source.name}" is' if number == 1 else f'{number} discs of "{source.name}" are'


def _behind(scene: Scene, emitter: Emitter) -> str | None:
    """Name of the target behind what is seen of a disc, "" where there is none; None where nothing of it is seen."""
    eye = np.asarray(scene.camera.pose.position)
    points = _in_sight(scene, emitter)
    away = points - eye
    distance = np.linalg.norm(away, axis=1)
    met = {target.name: first_hit(target, eye, away / distance[:, np.newaxis])[0] for target in scene.targets}
    seen = np.all([distance < further for further in met.values()], axis=0)
    if not seen.any():
        return None
    return next((name for name, further in met.items() if np.isfinite(further[seen]).any()), "")


def _in_sight(scene: Scene, emitter: Emitter) -> Array:
    """Points of a disc that fall on the sensor, or through a finite pinhole beside it; shape (n, 3) [m]."""
    camera, sensor = scene.camera, scene.camera.sensor
    points = np.vstack([_on_disc(emitter), _on_rays(scene, emitter)])
    uv, depth = project(camera, points)
    before = depth > _NEAREST
    uv, depth, points = uv[before], depth[before], points[before]
    blur = camera.aperture.reach * np.abs(camera.magnification(depth))
    off = np.maximum(-0.5 - uv, uv - [sensor.columns - 0.5, sensor.rows - 0.5])
    beside = np.maximum(off, 0.0) * [sensor.pixel_width, sensor.pixel_height]
    seen: Array = points[np.hypot(*beside.T) <= blur]
    return seen


def _on_disc(emitter: Emitter) -> Array:
    circle = _circle() @ _across(np.asarray(emitter.axis))
    shares = np.array([0.0, 0.5, 1.0])[:, np.newaxis, np.newaxis]
    points: Array = np.asarray(emitter.position) + (shares * emitter.radius * circle).reshape(-1, 3)
    return points


def _on_rays(scene: Scene, emitter: Emitter) -> Array:
    """Where rays of the camera meet a disc, which may be larger than the field of view."""
    sensor, eye, axis = scene.camera.sensor, np.asarray(scene.camera.pose.position), np.asarray(emitter.axis)
    u, v = (np.linspace(0, count - 1, min(count, _VIEW_RAYS)) for count in (sensor.columns, sensor.rows))
    rays = directions(scene.camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        points = eye + ((emitter.position - eye) @ axis / (rays @ axis))[:, np.newaxis] * rays
        met: Array = points[np.linalg.norm(points - emitter.position, axis=1) <= emitter.radius]
    return met


@dataclass(frozen=True, slots=True, eq=False)
class _Face:
    """A flat face: its target, unit normal, and corners in the world, shape (n, 3) [m]."""

    target: str
    normal: Array
    corners: Array


def shared_planes(scene: Scene) -> Iterator[str]:
    """A line for each two targets of which one lies in the other's plane, and on it."""
    faces = [face for target in scene.targets for face in _faces(scene, target)]
    middles = np.array([face.corners.mean(axis=0) for face in faces]).reshape(-1, 3)
    told = set()
    for number, face in enumerate(faces):
        reach = np.linalg.norm(face.corners - middles[number], axis=1).max()
        later = middles[number + 1 :]
        # A plane through a face's corners holds their mean too.
        candidates = np.flatnonzero(np.abs((later - middles[number]) @ face.normal) <= _ONE_PLANE + 1e-6 * reach)
        for other in (faces[number + 1 + index] for index in candidates):
            pair = (face.target, other.target)
            if face.target != other.target and pair not in told and _overlap(face, other):
                told.add(pair)
                yield (
                    f'"{face.target}" and "{other.target}" overlap in one plane: the later one is taken to lie on top; '
                    "move one of them by 0.01 mm or more"
                )


def _faces(scene: Scene, target: Target) -> Iterator[_Face]:
    """Flat faces; of solids those that the camera may see."""
    match target:
        case Sheet() | DotBoard() | EdgeTarget():
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (target.width / 2, target.height / 2)
        case Disc():
            corners = _circle() * target.diameter / 2
        case Polygon():
            corners = np.asarray(target.vertices)
        case Box() | Cylinder():
            for surface in surfaces(target):
                face = _shape_face(target.name, surface.shape)
                if face and (scene.camera.pose.position - face.corners[0]) @ face.normal > 0:
                    yield face
            return
        case _:
            return
    local = np.column_stack([corners, np.zeros(len(corners))])
    world = local @ np.asarray(target.pose.rotation).T + target.pose.position
    yield _Face(target.name, np.asarray(target.pose.z_axis), world)


def _circle() -> Array:
    angle = np.linspace(0, 2 * np.pi, _ROUND, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _shape_face(name: str, shape: object) -> _Face | None:
    if isinstance(shape, PolygonShape):
        corners = np.asarray(shape.vertices)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
        return _Face(name, normal / np.linalg.norm(normal), corners)
    if isinstance(shape, DiscShape):
        normal = np.asarray(shape.normal)
        across = _across(normal)
        return _Face(name, normal, np.asarray(shape.centre) + shape.radius * _circle() @ across)
    return None


def _across(normal: Array) -> Array:
    """Two unit vectors in the plane of a normal, shape (2, 3)."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _overlap(a: _Face, b: _Face) -> bool:
    """Whether two faces share more than a border, in one plane."""
    away = [np.abs((of.corners - on.corners[0]) @ on.normal).max() for of, on in ((a, b), (b, a))]
    if min(away) > _ONE_PLANE:
        return False
    across = _across(a.normal)
    first, second = (a.corners - a.corners[0]) @ across.T, (b.corners - a.corners[0]) @ across.T
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
