"""Where rays meet targets, and what of a target is nearest: closed forms, without a tracer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Vector, points_to_local
from radwrap.scene.mesh import mesh_hit, nearest_on
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
    Sphere,
    Target,
)

Array = NDArray[np.float64]

# A ray that starts on a surface does not meet it there [m]; no scene has parts as small.
_START: Final = 1e-12
_ROUNDING: Final = 1e-12  # of a squared distance, which is a difference of squares
_TINY: Final = 1e-300  # is no distance


@dataclass(frozen=True, slots=True, eq=False)
class Bounded:
    """Targets, and spheres that hold them.

    Attributes
    ----------
    targets : tuple of Target
        Without Radiance files, of which nothing is known.
    centres : ndarray, shape (n, 3)
        In the world [m].
    radii : ndarray, shape (n,)
        Of the spheres [m].
    """

    targets: tuple[Target, ...]
    centres: Array
    radii: Array

    @classmethod
    def of(cls, targets: Iterable[Target]) -> Bounded:
        """The spheres of some targets: of many, whoever asks more than once makes them once."""
        known = tuple(target for target in targets if not isinstance(target, RadFile))
        centres = np.array([target.pose.position for target in known]).reshape(-1, 3)
        return cls(known, centres, np.array([_reach(target) for target in known]))

    def nearer_than(self, point: Vector, distance: float) -> Iterator[Target]:
        """Targets that may be nearer to a point than a distance [m]; those left out are not."""
        away = np.linalg.norm(self.centres - np.asarray(point), axis=1)
        for number in np.flatnonzero(away * (1 - _ROUNDING) - self.radii <= distance):
            yield self.targets[number]


def reached(among: Bounded, origin: Vector, rays: Array) -> Iterator[tuple[Target, NDArray[np.intp]]]:
    """Targets that rays from one point may meet, each with the numbers of these rays.

    Most rays pass most targets by: a sphere that holds the target says so at once.

    Parameters
    ----------
    among : Bounded
        The targets.
    origin : Vector
        In the world [m].
    rays : ndarray, shape (n, 3)
        Unit vectors.
    """
    if not len(rays):
        return
    away = among.centres - np.asarray(origin)
    square = (away**2).sum(axis=1)
    size = among.radii**2 + _ROUNDING * square
    within = square <= size
    # A ray that meets a sphere ends, one unit from the origin, within a chord of where the way to its centre does: of
    # rays that are sorted along an axis only a run may.
    sine = np.minimum(np.sqrt(size / np.maximum(square, _TINY)), 1.0)
    chord = np.where(within, 2.0, sine * np.sqrt(2 / (1 + np.sqrt(1 - sine**2)))) + _ROUNDING
    axis = int(np.ptp(rays, axis=0).argmax())
    order = np.argsort(rays[:, axis], kind="stable")
    along, middle = rays[order, axis], away[:, axis] / np.sqrt(np.maximum(square, _TINY))
    first, last = np.searchsorted(along, middle - chord, "left"), np.searchsorted(along, middle + chord, "right")
    for number in np.flatnonzero(last > first):
        some = order[first[number] : last[number]]
        ahead = rays[some] @ away[number]
        # Those behind the origin are passed by too, unless it lies within the sphere.
        near = (square[number] - ahead**2 <= size[number]) & ((ahead > 0) | within[number])
        if near.any():
            yield among.targets[number], np.sort(some[near])


def _reach(target: Target) -> float:
    """Radius of a sphere about a target's origin that holds it [m]."""
    match target:
        case Sheet() | DotBoard() | EdgeTarget() | PatternTarget():
            return math.hypot(target.width, target.height) / 2
        case Disc() | Sphere():
            return target.diameter / 2
        case Polygon():
            return max(math.hypot(*vertex) for vertex in target.vertices)
        case Cylinder():
            return math.hypot(target.diameter, target.length) / 2
        case Box():
            return math.hypot(*target.size) / 2
        case MeshPart():
            return float(np.linalg.norm(target.mesh.vertices, axis=1).max())
        case RadFile():
            return 0.0
        case _:
            assert_never(target)


def first_hit(target: Target, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Where rays first meet a target.

    Parameters
    ----------
    target : Target
        Of a Radiance file nothing is known: it is never met.
    origins : ndarray, shape (3,) or (n, 3)
        In the world [m].
    directions : ndarray, shape (n, 3)
        Unit vectors.

    Returns
    -------
    distance : ndarray, shape (n,)
        Along the ray [m]; infinite where it misses.
    normals : ndarray, shape (n, 3)
        Unit normals of the front, which for solids is the outside; meaningless where the ray misses.
    """
    rotation = np.asarray(target.pose.rotation)
    directions = np.atleast_2d(directions)
    start = np.broadcast_to(points_to_local(target.pose, np.atleast_2d(origins)), directions.shape)
    along = directions @ rotation
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        match target:
            case RadFile():
                return np.full(len(along), math.inf), np.zeros_like(along)
            case Sphere():
                distance, normals = _sphere_hit(target, start, along)
            case Cylinder():
                distance, normals = _cylinder_hit(target, start, along)
            case Box():
                distance, normals = _box_hit(target, start, along)
            case MeshPart():
                distance, normals = mesh_hit(target.mesh, start, along)
            case Sheet() | DotBoard() | EdgeTarget() | PatternTarget() | Polygon() | Disc():
                distance = -start[:, 2] / along[:, 2]
                met = (distance > _START) & on_face(target, (start + distance[:, np.newaxis] * along)[:, :2])
                distance = np.where(met, distance, math.inf)
                normals = np.broadcast_to([0.0, 0.0, 1.0], along.shape)
            case _:
                assert_never(target)
    return distance, normals @ rotation.T


def on_face(target: Flat, xy: Array) -> NDArray[np.bool_]:
    """Which points of its plane, shape (n, 2) [m], belong to a flat target."""
    x, y = xy[:, 0], xy[:, 1]
    inside: NDArray[np.bool_]
    match target:
        case Polygon():
            return in_polygon(np.asarray(target.vertices), xy)
        case Disc():
            inside = np.hypot(x, y) <= target.diameter / 2
        case Sheet() | DotBoard() | EdgeTarget() | PatternTarget():
            inside = (np.abs(x) <= target.width / 2) & (np.abs(y) <= target.height / 2)
        case _:
            assert_never(target)
    return inside


def in_polygon(vertices: Array, xy: Array) -> NDArray[np.bool_]:
    """Which points, shape (n, 2), lie in a polygon, shape (m, 2): even-odd rule; on the border it may be either."""
    inside = np.zeros(len(xy), dtype=bool)
    x, y = np.ascontiguousarray(xy.T)
    for (x0, y0), (x1, y1) in zip(vertices.tolist(), np.roll(vertices, -1, axis=0).tolist(), strict=True):
        if y0 != y1:
            some = np.flatnonzero((y0 > y) != (y1 > y))  # few, of a polygon with many sides
            inside[some] ^= x[some] < x0 + (y[some] - y0) * (x1 - x0) / (y1 - y0)
    return inside


def _roots(a: Array, half_b: Array, c: Array) -> tuple[Array, Array]:
    """Roots of a t^2 + 2 half_b t + c, NaN where there are none."""
    root = np.sqrt(half_b**2 - a * c)
    return (-half_b - root) / a, (-half_b + root) / a


def _nearest(*candidates: Array) -> Array:
    """Smallest positive value; infinity where there is none."""
    stacked = np.stack(candidates)
    smallest: Array = np.where(stacked > _START, stacked, math.inf).min(axis=0)
    return smallest


def _at(start: Array, along: Array, distance: Array) -> Array:
    return start + np.where(np.isfinite(distance), distance, 0.0)[:, np.newaxis] * along


def _sphere_hit(target: Sphere, start: Array, along: Array) -> tuple[Array, Array]:
    radius = target.diameter / 2
    half_b, c = (start * along).sum(axis=1), (start**2).sum(axis=1) - radius**2
    distance = _nearest(*_roots(np.ones(len(along)), half_b, c))
    return distance, _at(start, along, distance) / radius


def _cylinder_hit(target: Cylinder, start: Array, along: Array) -> tuple[Array, Array]:
    radius, half = target.diameter / 2, target.length / 2
    a = (along[:, :2] ** 2).sum(axis=1)
    half_b, c = (start[:, :2] * along[:, :2]).sum(axis=1), (start[:, :2] ** 2).sum(axis=1) - radius**2
    side = [np.where(np.abs(start[:, 2] + t * along[:, 2]) <= half, t, math.inf) for t in _roots(a, half_b, c)]
    caps = []
    for end in (-half, half):
        t = (end - start[:, 2]) / along[:, 2]
        away = np.hypot(start[:, 0] + t * along[:, 0], start[:, 1] + t * along[:, 1])
        caps.append(np.where(away <= radius, t, math.inf))
    on_side, on_cap = _nearest(*side), _nearest(*caps)
    distance = np.minimum(on_side, on_cap)
    normals = _at(start, along, distance)
    is_side = (on_side <= on_cap)[:, np.newaxis]
    normals = np.where(is_side, normals * [1 / radius, 1 / radius, 0], np.sign(normals) * [0, 0, 1])
    return distance, normals


def _box_hit(target: Box, start: Array, along: Array) -> tuple[Array, Array]:
    half = np.asarray(target.size) / 2
    low, high = (-half - start) / along, (half - start) / along
    near = np.fmax.reduce(np.fmin(low, high), axis=1)
    far = np.fmin.reduce(np.fmax(low, high), axis=1)
    distance = np.where(near <= far, _nearest(near, far), math.inf)
    scaled = _at(start, along, distance) / half
    axis = np.abs(scaled).argmax(axis=1)
    normals = np.where(np.arange(3) == axis[:, np.newaxis], np.sign(scaled), 0.0)
    return distance, normals


def nearest_point(target: Target, point: Vector) -> tuple[Array, Array]:
    """The point of a target's surface that is nearest to a point of the world.

    Returns
    -------
    nearest, normal : ndarray, shape (3,)
        In the world [m]; unit normal of the front. A Radiance file has none:
        its point is infinitely far.
    """
    rotation = np.asarray(target.pose.rotation)
    local = points_to_local(target.pose, np.array([point]))[0]
    place, normal = _nearest_local(target, local)
    return rotation @ place + np.asarray(target.pose.position), rotation @ normal


def _nearest_local(target: Target, local: Array) -> tuple[Array, Array]:
    match target:
        case RadFile():
            return np.full(3, math.inf), np.zeros(3)
        case Sphere():
            normal = _unit(local)
            return normal * target.diameter / 2, normal
        case Cylinder():
            radius, half = target.diameter / 2, target.length / 2
            radial = _unit(local * [1, 1, 0])
            axial = np.array([0.0, 0.0, 1.0 if local[2] >= 0 else -1.0])
            place = radial * min(math.hypot(*local[:2]), radius) + axial * min(abs(local[2]), half)
            beyond = math.hypot(*local[:2]) - radius, abs(local[2]) - half
            if beyond[0] >= beyond[1]:
                return radial * radius + place * [0, 0, 1], radial
            return place * [1, 1, 0] + axial * half, axial
        case Box():
            size = np.asarray(target.size) / 2
            face = int((np.abs(local) - size).argmax())
            normal = np.zeros(3)
            normal[face] = 1.0 if local[face] >= 0 else -1.0
            place = np.clip(local, -size, size)
            place[face] = normal[face] * size[face]
            return place, normal
        case MeshPart():
            return nearest_on(target.mesh, local)
    return np.append(clamped(target, local[:2]), 0.0), np.array([0.0, 0.0, 1.0])


def _unit(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0 else np.array([1.0, 0.0, 0.0])


def clamped(target: Flat, xy: Array) -> Array:
    """The point of a flat target's face that is nearest to a point of its plane, shape (2,) [m]."""
    if on_face(target, xy[np.newaxis])[0]:
        return xy
    match target:
        case Polygon():
            start = np.asarray(target.vertices)
            side = np.roll(start, -1, axis=0) - start
            share = np.clip(((xy - start) * side).sum(axis=1) / (side**2).sum(axis=1), 0.0, 1.0)
            feet = start + share[:, np.newaxis] * side
            nearest: Array = feet[np.hypot(*(feet - xy).T).argmin()]
            return nearest
        case Disc():
            return xy * (target.diameter / 2 / math.hypot(*xy))
    half = np.array([target.width, target.height]) / 2
    return np.clip(xy, -half, half)
