"""Distances to targets, and points on them at which a scene is looked over."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Vector, points_to_local, to_local
from radwrap.scene.camera import Camera
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    Polygon,
    RadFile,
    Sheet,
    Sphere,
    Target,
)

_GRID = 9  # points along each side of a surface that is looked over
_POLAR = 5


@dataclass(frozen=True, slots=True)
class SurfacePoints:
    """Points on one material of one target.

    Attributes
    ----------
    target, material : str
        Names.
    points, normals : ndarray, shape (n, 3)
        In the world [m]; unit normals of the front.
    """

    target: str
    material: str
    points: NDArray[np.float64]
    normals: NDArray[np.float64]


def extent(target: Sheet | DotBoard | EdgeTarget | Polygon | Disc) -> tuple[float, float, float, float]:
    """Bounding rectangle (x_min, x_max, y_min, y_max) of a flat target in its plane [m]."""
    match target:
        case Polygon():
            xs, ys = zip(*target.vertices, strict=True)
            return min(xs), max(xs), min(ys), max(ys)
        case Disc():
            r = target.diameter / 2
            return -r, r, -r, r
    return -target.width / 2, target.width / 2, -target.height / 2, target.height / 2


def signed_distance(target: Target, point: Vector) -> float:
    """Distance from a point of the world to a target [m], negative inside a solid.

    A polygon counts as its bounding rectangle; of a Radiance file nothing is
    known, so it is infinitely far.
    """
    x, y, z = to_local(target.pose, point)
    match target:
        case RadFile():
            return math.inf
        case Disc():
            return math.hypot(max(math.hypot(x, y) - target.diameter / 2, 0.0), z)
        case Sphere():
            return math.hypot(x, y, z) - target.diameter / 2
        case Cylinder():
            return _solid(math.hypot(x, y) - target.diameter / 2, abs(z) - target.length / 2)
        case Box():
            return _solid(*(abs(a) - side / 2 for a, side in zip((x, y, z), target.size, strict=True)))
    x_min, x_max, y_min, y_max = extent(target)
    return math.hypot(max(x_min - x, x - x_max, 0.0), max(y_min - y, y - y_max, 0.0), z)


def _solid(*beyond: float) -> float:
    outside = math.hypot(*(max(b, 0.0) for b in beyond))
    return outside if outside > 0 else max(beyond)


def surface_points(target: Target, viewer: Vector) -> tuple[SurfacePoints, ...]:
    """Points spread over a target, one group for each of its materials, and those nearest to the viewer."""
    match target:
        case RadFile():
            return ()
        case DotBoard():
            centres = np.array([centre for _, _, centre in target.dot_centres()])
            return _group(target, target.material, _grid(target, viewer)), _group(target, target.dot_material, centres)
        case EdgeTarget():
            near = target.width * 1e-6  # both sides of the edge are looked at close to it
            grid = _grid(target, viewer, (target.edge_position - near, target.edge_position + near))
            bright = grid[:, 0] > target.edge_position
            return _group(target, target.material, grid[~bright]), _group(target, target.edge_material, grid[bright])
        case Sphere() | Cylinder() | Box():
            points, normals = _solid_points(target, viewer)
            rotation = np.asarray(target.pose.rotation)
            return (
                SurfacePoints(
                    target.name,
                    target.material,
                    points @ rotation.T + target.pose.position,
                    normals @ rotation.T,
                ),
            )
    return (_group(target, target.material, _grid(target, viewer)),)


def _grid(
    target: Sheet | DotBoard | EdgeTarget | Polygon | Disc, viewer: Vector, more_x: tuple[float, ...] = ()
) -> NDArray[np.float64]:
    x_min, x_max, y_min, y_max = extent(target)
    x, y, _ = to_local(target.pose, viewer)
    xs = np.append(np.linspace(x_min, x_max, _GRID), [np.clip(x, x_min, x_max), *more_x])
    ys = np.append(np.linspace(y_min, y_max, _GRID), np.clip(y, y_min, y_max))
    grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    if isinstance(target, Disc):
        radius = np.hypot(grid[:, 0], grid[:, 1])
        grid *= np.minimum(1.0, target.diameter / 2 / np.maximum(radius, 1e-300))[:, np.newaxis]
    return np.column_stack([grid, np.zeros(len(grid))])


def _group(target: Target, material: str, local: NDArray[np.float64]) -> SurfacePoints:
    points = local @ np.asarray(target.pose.rotation).T + target.pose.position
    return SurfacePoints(target.name, material, points, np.tile(target.pose.z_axis, (len(points), 1)))


def _solid_points(target: Sphere | Cylinder | Box, viewer: Vector) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and normals of a solid in its own frame, the one towards the viewer first."""
    azimuth, polar = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * _GRID, endpoint=False), np.linspace(0, np.pi, _POLAR))
    directions = np.column_stack(
        [
            (np.sin(polar) * np.cos(azimuth)).ravel(),
            (np.sin(polar) * np.sin(azimuth)).ravel(),
            np.cos(polar).ravel(),
        ]
    )
    towards = np.asarray(to_local(target.pose, viewer))
    towards = towards / max(float(np.linalg.norm(towards)), 1e-300)
    directions = np.vstack([towards, directions])
    match target:
        case Sphere():
            return directions * (target.diameter / 2), directions
        case Cylinder():
            half = np.array([target.diameter / 2, target.diameter / 2, target.length / 2])
            reach = np.maximum(
                np.hypot(directions[:, 0], directions[:, 1]) / half[0], np.abs(directions[:, 2]) / half[2]
            )
            on_side = np.hypot(directions[:, 0], directions[:, 1]) / half[0] >= np.abs(directions[:, 2]) / half[2]
            normals = np.where(on_side[:, np.newaxis], directions * [1, 1, 0], directions * [0, 0, 1])
        case Box():
            scaled = np.abs(directions) / (np.asarray(target.size) / 2)
            reach = scaled.max(axis=1)
            normals = np.where(np.arange(3) == scaled.argmax(axis=1)[:, np.newaxis], directions, 0.0)
    return directions / reach[:, np.newaxis], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def project(camera: Camera, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Image points of world points through the pinhole's centre.

    Parameters
    ----------
    camera : Camera
        The camera.
    points : ndarray, shape (n, 3)
        World points [m].

    Returns
    -------
    uv : ndarray, shape (n, 2)
        (column, row) [px]; meaningless where depth is not above 0.
    depth : ndarray, shape (n,)
        Distance along the axis [m].
    """
    local = points_to_local(camera.pose, points)
    depth = local[:, 2]
    safe = np.where(depth > 0, depth, 1.0)
    pitch = np.array([camera.sensor.pixel_width, camera.sensor.pixel_height])
    uv = np.asarray(camera.principal_point) + camera.focal_length * local[:, :2] / safe[:, np.newaxis] / pitch
    return uv, depth


def in_view(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points fall on the sensor."""
    uv, depth = project(camera, points)
    sensor = camera.sensor
    inside: NDArray[np.bool_] = (
        (depth > 0) & (uv >= -0.5).all(axis=1) & (uv[:, 0] <= sensor.columns - 0.5) & (uv[:, 1] <= sensor.rows - 0.5)
    )
    return inside
