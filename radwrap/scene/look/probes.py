"""Points at which a scene is looked over before a ray is traced.

They come from three sides, so that what is small from one is large from
another: spread over each target, on rays from the camera's pixels, and on rays
within each source's beam.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Vector
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import SurfacePoints, directions
from radwrap.scene.look.intersections import clamped, first_hit, nearest_point, on_face
from radwrap.scene.patterns.marks import FlatDisc
from radwrap.scene.sources import Beam, Emitter
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    Flat,
    MeshPart,
    PatternTarget,
    Polygon,
    RadFile,
    Sheet,
    Solid,
    Sphere,
    Target,
)

Array = NDArray[np.float64]

_GRID: Final = 9  # points along each side of a surface
_POLAR: Final = 5
_MOST_DOTS: Final = 33  # rows and columns of dots whose centres are looked at
_MOST_TRIANGLES: Final = 512
_BEAM_CIRCLES: Final = 8
_BEAM_AZIMUTHS: Final = 16
_BORDER: Final = 128  # points on each side of a border
_LOOKS: Final = 12  # each half as wide as the one before
_VIEW_RAYS: Final = 33  # along each side of the sensor
# Points that get less than this share of a source's axial intensity do not count as lit by it.
LIT_SHARE: Final = 1e-4


def surface_points(target: Target, viewer: Vector) -> tuple[SurfacePoints, ...]:
    """Points spread over a target, one group for each of its materials, and the one nearest to the viewer."""
    if isinstance(target, RadFile):
        return ()
    rotation = np.asarray(target.pose.rotation)
    if isinstance(target, Solid):
        local, normals = _solid_points(target)
    elif isinstance(target, MeshPart):
        local, normals = _mesh_points(target)
    else:
        local = _flat_points(target)
        normals = np.tile([0.0, 0.0, 1.0], (len(local), 1))
    near, normal = nearest_point(target, viewer)
    points = np.vstack([near, local @ rotation.T + target.pose.position])
    return _groups(target, points, np.vstack([normal, normals @ rotation.T]))


def seen_points(target: Target, camera: Camera) -> tuple[SurfacePoints, ...]:
    """Where rays through the pinhole's centre from pixels spread over the sensor meet a target."""
    sensor = camera.sensor
    u, v = (np.linspace(0, count - 1, min(count, _VIEW_RAYS)) for count in (sensor.columns, sensor.rows))
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return hit_points(target, camera.pose.position, directions(camera, uv))


def lit_points(target: Target, emitter: Emitter, beam: Array | None = None) -> tuple[SurfacePoints, ...]:
    """Where a source's beam meets a target: its axis, circles about it, and the way to what is nearest.

    The beam's rays are those of `beam_rays`, which whoever asks of many targets makes once.
    Where the nearest point lies outside the beam, the ray at the beam's rim
    towards it stands for it: on a plane nothing that is lit is nearer. Where
    the axis misses a flat target, the point nearest to where it meets the plane is looked at.
    """
    if isinstance(target, RadFile):
        return ()
    axis = np.asarray(emitter.axis)
    reach = beam_reach(emitter.beam)
    rays = [beam_rays(emitter) if beam is None else beam]
    near, normal = nearest_point(target, emitter.position)
    away = near - np.asarray(emitter.position)
    if (distance := float(np.linalg.norm(away))) > 0:
        rays.append(_within(away / distance, axis, reach)[np.newaxis])
    groups = list(hit_points(target, emitter.position, np.vstack(rays)))
    groups += _groups(target, near[np.newaxis], normal[np.newaxis])
    groups += _near_axis(target, emitter)
    return merged(groups)


def nearest_lit(target: Target, emitter: Emitter) -> float:
    """Distance from a source to the nearest point of a target that it lights [m]; infinite where it lights none.

    From the nearest of the points that are looked over, ever finer looks about it go on. They would stall where a
    beam's rim crosses a flat target's border, so the border is looked over as well.
    """
    origin = np.asarray(emitter.position)
    points = [group.points for group in (*surface_points(target, emitter.position), *lit_points(target, emitter))]
    away = np.vstack([*points, _border(target)]) - origin
    away = away[emitter.relative_intensity_at(away + origin) > LIT_SHARE]
    if not len(away):
        return math.inf
    distance = np.linalg.norm(away, axis=1)
    least = int(distance.argmin())
    best, ray = float(distance[least]), away[least] / max(float(distance[least]), 1e-300)
    width = math.tan(min(beam_reach(emitter.beam), 1.0)) / 4
    for _ in range(_LOOKS):
        aside = _unit_across(ray)
        steps = np.stack(np.meshgrid(*[np.linspace(-width, width, _GRID)] * 2), axis=-1).reshape(-1, 2)
        rays = ray + steps @ np.stack([aside, np.cross(ray, aside)])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        distance, _ = first_hit(target, origin, rays)
        distance = np.where(emitter.relative_intensity_at(origin + rays) > LIT_SHARE, distance, math.inf)
        least = int(distance.argmin())
        if distance[least] < best:
            best, ray = float(distance[least]), rays[least]
        width /= 2
    return best


def _border(target: Target) -> Array:
    """Points close together on a flat target's border, shape (n, 3) [m]; none of a solid."""
    match target:
        case RadFile() | Sphere() | Cylinder() | Box() | MeshPart():
            return np.empty((0, 3))
        case Disc():
            angle = np.linspace(0, 2 * np.pi, 4 * _BORDER, endpoint=False)
            xy = np.column_stack([np.cos(angle), np.sin(angle)]) * target.diameter / 2
        case Sheet() | DotBoard() | EdgeTarget() | PatternTarget() | Polygon():
            corners = _corners(target)
            sides = np.roll(corners, -1, axis=0) - corners
            share = np.linspace(0, 1, _BORDER, endpoint=False)[:, np.newaxis, np.newaxis]
            xy = (corners + share * sides).reshape(-1, 2)
        case _:
            assert_never(target)
    local = np.column_stack([xy, np.zeros(len(xy))])
    border: Array = local @ np.asarray(target.pose.rotation).T + target.pose.position
    return border


def _corners(target: Sheet | DotBoard | EdgeTarget | PatternTarget | Polygon) -> Array:
    if isinstance(target, Polygon):
        return np.asarray(target.vertices)
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (target.width / 2, target.height / 2)


def _near_axis(target: Target, emitter: Emitter) -> tuple[SurfacePoints, ...]:
    """The point of a flat target that is nearest to where the beam's axis meets its plane."""
    if not isinstance(target, Flat):
        return ()
    rotation = np.asarray(target.pose.rotation)
    start = (np.asarray(emitter.position) - target.pose.position) @ rotation
    along = np.asarray(emitter.axis) @ rotation
    if along[2] * start[2] >= 0:
        return ()
    place = clamped(target, (start - along * (start[2] / along[2]))[:2])
    point = rotation @ np.append(place, 0.0) + np.asarray(target.pose.position)
    return _groups(target, point[np.newaxis], rotation[:, 2][np.newaxis])


def feet(target: Target, positions: Array, reach: Array, most: int) -> tuple[SurfacePoints, ...]:
    """Points of a target that are nearest to positions, shape (n, 3) [m], no farther than their reach, shape (n,)."""
    if isinstance(target, RadFile):
        return ()
    found = []
    for position, far in zip(positions.tolist(), reach.tolist(), strict=True):
        near, normal = nearest_point(target, (position[0], position[1], position[2]))
        if math.dist(near.tolist(), position) <= far:
            found.append((near, normal))
    found = found[:: max(1, math.ceil(len(found) / most))]
    if not found:
        return ()
    points, normals = (np.array(of) for of in zip(*found, strict=True))
    return _groups(target, points, normals)


def hit_points(target: Target, origin: Vector, rays: Array) -> tuple[SurfacePoints, ...]:
    """Where rays from one point, unit vectors of shape (n, 3), meet a target."""
    distance, normals = first_hit(target, np.asarray(origin), rays)
    met = np.isfinite(distance)
    points = np.asarray(origin) + distance[met, np.newaxis] * rays[met]
    return _groups(target, points, normals[met])


def material_number(target: Target, points: Array) -> NDArray[np.intp]:
    """Which of its `materials_of` a target has at points of its surface, shape (n, 3) [m]."""
    number = np.zeros(len(points), dtype=np.intp)
    if isinstance(target, DotBoard | EdgeTarget | PatternTarget):
        local = (points - np.asarray(target.pose.position)) @ np.asarray(target.pose.rotation)
        if isinstance(target, PatternTarget):
            number[target.partition.covered(local[:, :2])] = 1
        elif isinstance(target, EdgeTarget):
            number[local[:, 0] > target.edge_position] = 1
        else:
            middle = np.array([target.columns - 1, target.rows - 1]) / 2
            nearest = np.clip(np.rint(local[:, :2] / target.pitch + middle), 0, 2 * middle) - middle
            number[np.hypot(*(local[:, :2] - nearest * target.pitch).T) <= target.dot_diameter / 2] = 1
    return number


def materials_of(target: Target) -> tuple[str, ...]:
    """Names of a target's materials; the one that is covered by the other comes first."""
    match target:
        case RadFile():
            return ()
        case DotBoard():
            return target.material, target.dot_material
        case EdgeTarget():
            return target.material, target.edge_material
        case PatternTarget():
            return target.material, target.pattern_material
        case Sheet() | Polygon() | Disc() | Sphere() | Cylinder() | Box() | MeshPart():
            return (target.material,)


def merged(groups: Iterable[SurfacePoints]) -> tuple[SurfacePoints, ...]:
    """One group for each target and material."""
    parts: dict[tuple[str, str], list[SurfacePoints]] = {}
    for group in groups:
        parts.setdefault((group.target, group.material), []).append(group)
    return tuple(
        SurfacePoints(
            *names,
            np.concatenate([group.points for group in members]),
            np.concatenate([group.normals for group in members]),
            members[0].grain,
        )
        for names, members in parts.items()
    )


def _groups(target: Target, points: Array, normals: Array) -> tuple[SurfacePoints, ...]:
    number = material_number(target, points)

    def chosen() -> Iterator[SurfacePoints]:
        for index, material in enumerate(materials_of(target)):
            if (of := number == index).any():
                yield SurfacePoints(target.name, material, points[of], normals[of], target.pose.x_axis)

    return tuple(chosen())


def _flat_points(target: Flat) -> Array:
    """A grid over a flat target, and what a grid misses: corners, dots, both sides of an edge; shape (n, 3) [m]."""
    match target:
        case Polygon():
            corners = np.asarray(target.vertices)
            low, high = corners.min(axis=0), corners.max(axis=0)
            grid = _rectangle(low, high)
            xy = np.vstack([grid[on_face(target, grid)], corners, (corners + np.roll(corners, -1, axis=0)) / 2])
        case Disc():
            xy = _rectangle(np.full(2, -target.diameter / 2), np.full(2, target.diameter / 2))
            xy = xy * np.minimum(1.0, target.diameter / 2 / np.maximum(np.hypot(*xy.T), 1e-300))[:, np.newaxis]
        case Sheet() | DotBoard() | EdgeTarget() | PatternTarget():
            half = np.array([target.width, target.height]) / 2
            xy = _rectangle(-half, half)
        case _:
            assert_never(target)
    if isinstance(target, DotBoard):
        xy = np.vstack([xy, _dots(target)])
    if isinstance(target, PatternTarget):
        xy = np.vstack([xy, _marks(target)])
    if isinstance(target, EdgeTarget):
        x = target.edge_position + target.width * np.array([-1e-6, 1e-6])
        y = np.linspace(-target.height / 2, target.height / 2, _GRID)
        xy = np.vstack([xy, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)])
    return np.column_stack([xy, np.zeros(len(xy))])


def _rectangle(low: Array, high: Array) -> Array:
    x, y = (np.linspace(a, b, _GRID) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _dots(board: DotBoard) -> Array:
    """Centres of dots; of large boards those of rows and columns that are spread over it."""
    column, row = (
        np.unique(np.linspace(0, count - 1, min(count, _MOST_DOTS)).astype(int)) - (count - 1) / 2
        for count in (board.columns, board.rows)
    )
    return np.stack(np.meshgrid(column, row), axis=-1).reshape(-1, 2) * board.pitch


def _marks(target: PatternTarget) -> Array:
    """A place within each mark; of many those of marks that are spread over the plate."""
    marks = list(target.layout.marks())
    chosen = marks[:: max(1, len(marks) // _MOST_DOTS**2)]
    return np.array(
        [(mark.x, mark.y) if isinstance(mark, FlatDisc) else np.mean(mark.vertices, axis=0).tolist() for mark in chosen]
    )


def _solid_points(target: Sphere | Cylinder | Box) -> tuple[Array, Array]:
    """Points and normals of a solid in its own frame."""
    azimuth, polar = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * _GRID, endpoint=False), np.linspace(0, np.pi, _POLAR))
    outwards = np.column_stack(
        [
            (np.sin(polar) * np.cos(azimuth)).ravel(),
            (np.sin(polar) * np.sin(azimuth)).ravel(),
            np.cos(polar).ravel(),
        ]
    )
    match target:
        case Sphere():
            return outwards * (target.diameter / 2), outwards
        case Cylinder():
            half = np.array([target.diameter / 2, target.diameter / 2, target.length / 2])
            sideways, endways = np.hypot(outwards[:, 0], outwards[:, 1]) / half[0], np.abs(outwards[:, 2]) / half[2]
            reach = np.maximum(sideways, endways)
            normals = np.where((sideways >= endways)[:, np.newaxis], outwards * [1, 1, 0], outwards * [0, 0, 1])
        case Box():
            scaled = np.abs(outwards) / (np.asarray(target.size) / 2)
            reach = scaled.max(axis=1)
            normals = np.where(np.arange(3) == scaled.argmax(axis=1)[:, np.newaxis], outwards, 0.0)
    return outwards / reach[:, np.newaxis], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _mesh_points(target: MeshPart) -> tuple[Array, Array]:
    """Middles and normals of triangles that are spread over a mesh."""
    mesh = target.mesh
    leaves = mesh.order[mesh.order >= 0]
    chosen = leaves[np.unique(np.linspace(0, len(leaves) - 1, min(len(leaves), _MOST_TRIANGLES)).astype(int))]
    return mesh.corners[chosen].mean(axis=1), mesh.normals[chosen]


def beam_reach(beam: Beam) -> float:
    """Angle to the axis [rad] up to which a beam counts as light."""
    match beam.profile:
        case "gaussian":
            return min(beam.spread * math.sqrt(-2 * math.log(LIT_SHARE)), math.pi / 2)
        case "cosine_power":
            return math.acos(LIT_SHARE ** (beam.spread**2))
        case "cone":
            return min(beam.spread, math.pi / 2)
    return math.acos(LIT_SHARE)


def beam_rays(emitter: Emitter) -> Array:
    """A beam's axis and circles about it up to the rim, unit vectors of shape (n, 3)."""
    axis = np.asarray(emitter.axis)
    aside = _unit_across(axis)
    other = np.cross(axis, aside)
    polar = np.linspace(0, _inside(beam_reach(emitter.beam)), _BEAM_CIRCLES + 1)[1:]
    azimuth = np.linspace(0, 2 * np.pi, _BEAM_AZIMUTHS, endpoint=False)
    around = np.outer(np.cos(azimuth), aside) + np.outer(np.sin(azimuth), other)
    circles = np.cos(polar)[:, np.newaxis, np.newaxis] * axis + np.sin(polar)[:, np.newaxis, np.newaxis] * around
    return np.vstack([axis[np.newaxis], circles.reshape(-1, 3)])


def _within(direction: Array, axis: Array, reach: float) -> Array:
    """A direction, or where it lies outside the beam the rim's nearest to it; unit vectors of shape (3,)."""
    across = direction - (direction @ axis) * axis
    sine = float(np.linalg.norm(across))
    if math.atan2(sine, float(direction @ axis)) < reach:
        return direction
    across = across / sine if sine > 0 else _unit_across(axis)
    rim: Array = math.cos(_inside(reach)) * axis + math.sin(_inside(reach)) * across
    return rim


def _inside(reach: float) -> float:
    """Just inside the rim, where a cone still shines, whatever the rounding of an arc cosine."""
    return reach * (1 - 1e-6)


def _unit_across(axis: Array) -> Array:
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    unit: Array = across / np.linalg.norm(across)
    return unit
