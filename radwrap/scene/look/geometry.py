"""Distances to targets; points on them, and where the camera sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import Vector, points_to_local, to_local
from radwrap.scene.camera import Camera
from radwrap.scene.look.intersections import clamped
from radwrap.scene.mesh import contains, nearest_on
from radwrap.scene.targets import Box, Cylinder, MeshPart, RadFile, Sphere, Target

_ROUND: Final = 32  # points that stand for a circle


@dataclass(frozen=True, slots=True)
class SurfacePoints:
    """Points on one material of one target.

    Attributes
    ----------
    target, material : str
        Names.
    points, normals : ndarray, shape (n, 3)
        In the world [m]; unit normals of the front.
    grain : tuple of float, or ndarray of shape (n, 3)
        The target's x in the world.
    """

    target: str
    material: str
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    grain: Vector | NDArray[np.float64] = (1.0, 0.0, 0.0)


def signed_distance(target: Target, point: Vector) -> float:
    """Distance from a point of the world to a target [m], negative inside a solid.

    Of a Radiance file nothing is known, so it is infinitely far.
    """
    x, y, z = to_local(target.pose, point)
    match target:
        case RadFile():
            return math.inf
        case Sphere():
            return math.hypot(x, y, z) - target.diameter / 2
        case Cylinder():
            return _solid(math.hypot(x, y) - target.diameter / 2, abs(z) - target.length / 2)
        case Box():
            return _solid(*(abs(a) - side / 2 for a, side in zip((x, y, z), target.size, strict=True)))
        case MeshPart():
            local = np.array([x, y, z])
            distance = float(np.linalg.norm(nearest_on(target.mesh, local)[0] - local))
            return -distance if target.closed and contains(target.mesh, local) else distance
    near = clamped(target, np.array([x, y]))
    return math.hypot(x - near[0], y - near[1], z)


def _solid(*beyond: float) -> float:
    outside = math.hypot(*(max(b, 0.0) for b in beyond))
    return outside if outside > 0 else max(beyond)


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
    if camera.distortion is not None:
        slopes = local[:, :2] / safe[:, np.newaxis]
        bent = np.column_stack(camera.distortion.distorted(slopes[:, 0], slopes[:, 1]))
        return np.asarray(camera.principal_point) + bent / camera.pitch, depth
    uv = np.asarray(camera.principal_point) + camera.image_distance * local[:, :2] / safe[:, np.newaxis] / pitch
    return uv, depth


def directions(camera: Camera, uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors, shape (n, 3), from the pinhole's centre to what is seen at (column, row) uv, shape (n, 2) [px]."""
    pitch = np.array([camera.sensor.pixel_width, camera.sensor.pixel_height])
    local = np.column_stack([(uv - camera.principal_point) * pitch, np.full(len(uv), camera.image_distance)])
    if camera.distortion is not None:
        flat = (uv - camera.principal_point) * camera.pitch
        x, y, _ = camera.distortion.undistorted(flat[:, 0], flat[:, 1])
        local[:, :2] = np.column_stack([x, y]) * camera.image_distance
    rays = local @ np.asarray(camera.pose.rotation).T
    unit: NDArray[np.float64] = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit


def in_view(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points fall on the sensor."""
    uv, depth = project(camera, points)
    sensor = camera.sensor
    inside: NDArray[np.bool_] = (
        (depth > 0) & (uv >= -0.5).all(axis=1) & (uv[:, 0] <= sensor.columns - 0.5) & (uv[:, 1] <= sensor.rows - 0.5)
    )
    return inside


def circle() -> NDArray[np.float64]:
    """Points evenly on a circle of radius 1, shape (n, 2)."""
    angle = np.linspace(0, 2 * np.pi, _ROUND, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def across(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors in the plane of a normal, at right angles, shape (2, 3)."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])
