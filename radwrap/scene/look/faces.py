"""The flat face that a target turns to the camera, and the round rims that lie on it."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.frames import to_local, to_world
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import directions, project
from radwrap.scene.targets import Box, Cylinder, Disc, MeshPart, Polygon, RadFile, Sphere, Target

Array = NDArray[np.float64]

_ONE_PLANE: Final = 1e-5  # of the mesh's size: triangles so near to a plane lie in it
_SAME_NORMAL: Final = 1e-4
_ROUND: Final = 2e-3  # of the radius: corners so near to a circle lie on it
_FEWEST_CORNERS: Final = 12  # of a loop that stands for a circle
_SAME_CENTRE: Final = 0.05  # of the radius


@dataclass(frozen=True, slots=True)
class FaceRim:
    """A circle on a face, or on one behind it.

    Attributes
    ----------
    centre : tuple of float
        (x, y) on the face [m].
    radius : float
        [m]; of a mesh's polygon that of the circle of the same area, which is what an image of it shows.
    below : float
        How far behind the face it lies [m].
    """

    centre: tuple[float, float]
    radius: float
    below: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A flat face of a target.

    Attributes
    ----------
    origin : ndarray, shape (3,)
        Of its plane, in the world [m].
    axes : ndarray, shape (2, 3)
        Unit vectors of its x and y in the world.
    rims : tuple of FaceRim
        Circles on it, the largest first.
    size : tuple of float or None
        Along x and y, of a rectangle about the origin [m].
    far_rims : tuple of FaceRim
        Circles on the body's faces that look the other way.
    """

    origin: Array
    axes: Array
    rims: tuple[FaceRim, ...] = ()
    size: tuple[float, float] | None = None
    far_rims: tuple[FaceRim, ...] = ()

    @property
    def normal(self) -> Array:
        """Unit normal in the world, towards the camera."""
        return np.asarray(np.cross(self.axes[0], self.axes[1]))

    def to_image(self, camera: Camera, places: Array, below: float = 0.0) -> Array:
        """Where a camera sees places (x, y), shape (n, 2) [m], so far behind: column and row [px]; NaN behind it."""
        uv, depth = project(camera, self.origin - below * self.normal + places @ self.axes)
        return np.asarray(np.where(depth[:, None] > 0, uv, np.nan))

    def from_image(self, camera: Camera, uv: Array) -> Array:
        """Which places (x, y) a camera sees at column and row, shape (n, 2) [px]; NaN where it looks past the plane."""
        rays = directions(camera, uv)
        start = np.asarray(camera.pose.position)
        falling = rays @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((self.origin - start) @ self.normal) / falling
        hits = start + distance[:, None] * rays - self.origin
        return np.asarray(np.where((distance > 0)[:, None], hits @ self.axes.T, np.nan))

    def depth(self, camera: Camera) -> float:
        """Of its origin along the camera's axis [m]."""
        return float(project(camera, self.origin[None])[1][0])


def face_towards(camera: Camera, target: Target) -> Face:
    """The face that a target turns to the camera: of a body the one that it shows most of.

    Raises
    ------
    InputError
        If it has none: a sphere, a Radiance file, or a body that shows its side alone.
    """
    if isinstance(target, Sphere | RadFile):
        raise InputError("has no flat face", where=target.name, remedy="measure without a plane")
    if isinstance(target, MeshPart):
        return _of_mesh(camera, target)
    x, y, z = to_local(target.pose, camera.pose.position)
    if isinstance(target, Cylinder):
        if abs(z) <= target.length / 2:
            raise InputError("turns its side to the camera, and no end", where=target.name)
        end = _placed(target, math.copysign(target.length / 2, z), z, radius=target.diameter / 2)
        return replace(end, far_rims=(replace(end.rims[0], below=target.length),))
    if isinstance(target, Box):
        return _of_box(target, np.array([x, y, z]))
    size = None if isinstance(target, Disc | Polygon) else (target.width, target.height)
    return _placed(target, 0.0, z, radius=target.diameter / 2 if isinstance(target, Disc) else None, size=size)


def _placed(
    target: Target, level: float, side: float, *, radius: float | None, size: tuple[float, float] | None = None
) -> Face:
    """A face across the target's z at a level; y is turned where the camera is behind."""
    axes = np.asarray(target.pose.rotation).T[:2].copy()
    if side < 0:
        axes[1] = -axes[1]
    rims = () if radius is None else (FaceRim((0.0, 0.0), radius),)
    return Face(np.array(to_world(target.pose, (0.0, 0.0, level))), axes, rims, size)


def _of_box(target: Box, viewer: Array) -> Face:
    half = np.asarray(target.size) / 2
    beyond = np.abs(viewer) - half
    if (beyond <= 0).all():
        raise InputError("holds the camera", where=target.name)
    # What the camera sees of a face goes with its area and with how squarely it looks at its middle.
    areas = np.array([half[1] * half[2], half[2] * half[0], half[0] * half[1]])
    middles = np.diag(np.copysign(half, viewer))
    away = np.linalg.norm(viewer - middles, axis=1)
    axis = int(np.argmax(np.where(beyond > 0, areas * beyond / away**3, -np.inf)))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.asarray(target.pose.rotation).T
    axes = np.stack([rotation[first], rotation[second]])
    if viewer[axis] < 0:
        axes[1] = -axes[1]
    place = middles[axis]
    origin = to_world(target.pose, (float(place[0]), float(place[1]), float(place[2])))
    return Face(np.array(origin), axes, (), (2 * float(half[first]), 2 * float(half[second])))


def _of_mesh(camera: Camera, target: MeshPart) -> Face:
    """The plane in which most triangles that the camera can see lie."""
    viewer = np.array(to_local(target.pose, camera.pose.position))
    corners, normals = target.mesh.corners, target.mesh.normals
    middle = corners.mean(axis=1)
    away = viewer - middle
    distance = np.linalg.norm(away, axis=1)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    shown = area * (away * normals).sum(axis=1) / distance**3
    if not (shown > 0).any():
        raise InputError("turns no face to the camera", where=target.name)
    extent = float(np.ptp(target.mesh.vertices, axis=0).max())
    best = _fullest(normals, (middle * normals).sum(axis=1), shown, extent)
    normal = normals[best]
    level = float(middle[best] @ normal)
    inside = (normals @ normal > 1 - _SAME_NORMAL) & (
        np.abs(corners @ normal - level).max(axis=1) < _ONE_PLANE * extent
    )
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across = across / np.linalg.norm(across)
    axes = np.stack([across, np.cross(normal, across)])
    rims = _loops(corners[inside] @ axes.T, extent)
    start = normal * level
    rotation = np.asarray(target.pose.rotation)
    origin = np.array(to_world(target.pose, (float(start[0]), float(start[1]), float(start[2]))))
    back = (normals @ normal < _SAME_NORMAL - 1) & (np.ptp(corners @ normal, axis=1) < _ONE_PLANE * extent)
    return Face(origin, axes @ rotation.T, rims, far_rims=_behind(corners[back], axes, normal, level, extent))


def _behind(corners: Array, axes: Array, normal: Array, level: float, extent: float) -> tuple[FaceRim, ...]:
    """Circles of triangles that look the other way, shape (n, 3, 3) [m], plane by plane."""
    below = level - (corners @ normal).mean(axis=1)
    planes = np.round(below / (_ONE_PLANE * extent))
    found = []
    for plane in np.unique(planes[below > 0]):
        here = planes == plane
        found += [replace(rim, below=float(below[here].mean())) for rim in _loops(corners[here] @ axes.T, extent)]
    return tuple(found)


def _fullest(normals: Array, levels: Array, shown: Array, extent: float) -> int:
    """A triangle of the plane of which the camera sees most."""
    keys = np.column_stack([np.round(normals / 1e-3), np.round(levels / (1e-4 * extent))])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    total = np.bincount(group.ravel(), np.maximum(shown, 0.0))
    members = np.flatnonzero(group.ravel() == int(total.argmax()))
    return int(members[shown[members].argmax()])


def _loops(triangles: Array, extent: float) -> tuple[FaceRim, ...]:
    """Circles among the borders of some triangles of one plane, shape (n, 3, 2) [m]."""
    named = np.round(triangles / (1e-7 * extent)).astype(np.int64)
    sides: dict[tuple[tuple[int, ...], tuple[int, ...]], int] = {}
    for triangle in named.tolist():
        a, b, c = map(tuple, triangle)
        for side in ((a, b), (b, c), (c, a)):
            back = side[::-1]
            if back in sides:
                del sides[back]  # inside: another triangle goes on there
            else:
                sides[side] = 1
    following = defaultdict(list)
    for first, second in sides:
        following[first].append(second)
    found = []
    while following:
        here = start = next(iter(following))
        loop = [start]
        while following.get(here):
            here = following[here].pop()
            loop.append(here)
            if here == start:
                break
        following = defaultdict(list, {key: rest for key, rest in following.items() if rest})
        rim = _round(np.array(loop[:-1], dtype=np.float64) * 1e-7 * extent)
        if rim is not None:
            found.append(rim)
    return tuple(sorted(found, key=lambda rim: -rim.radius))


def _round(corners: Array) -> FaceRim | None:
    if len(corners) < _FEWEST_CORNERS:
        return None
    columns = np.column_stack([2 * corners, np.ones(len(corners))])
    x, y, rest = np.linalg.lstsq(columns, (corners**2).sum(axis=1), rcond=None)[0]
    radius = math.sqrt(max(float(rest + x * x + y * y), 0.0))
    off = np.abs(np.hypot(corners[:, 0] - x, corners[:, 1] - y) - radius)
    if radius <= 0 or off.max() >= _ROUND * radius:
        return None
    # Corners of a polygon lie on the circle, its sides within: a gauge measures what they hold.
    before = corners - (x, y)
    after = np.roll(before, -1, axis=0)
    area = abs(float((before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).sum())) / 2
    return FaceRim((float(x), float(y)), math.sqrt(area / math.pi))


def rings(face: Face) -> tuple[FaceRim, ...]:
    """The largest rim, and the next that goes round the same centre."""
    if not face.rims:
        return ()
    first = face.rims[0]
    near = _SAME_CENTRE * first.radius
    inner = [rim for rim in face.rims[1:] if math.dist(rim.centre, first.centre) < near]
    return (first, *inner[:1])
