"""Frames, rotations and poses.

A transform is named target_from_source: ``world_from_board`` takes points
of the board into the world. Right-handed frames, lengths in m, angles in rad,
a positive angle turns counter-clockwise seen from the tip of the axis.

A camera or a source looks along its own +z, its +x is right and its +y is
down, as in Tsai's camera frame; a flat target lies in its own xy plane and
faces +z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Rotation = tuple[Vector, Vector, Vector]

IDENTITY: Final[Rotation] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

# Below this sine of the angle between the viewing direction and "up" the roll is undefined in practice.
_PARALLEL_SINE: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Pose:
    """Place and attitude of a local frame in the world.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        Origin of the local frame in the world [m].
    rotation : tuple of tuple of float, shape (3, 3)
        world_from_local; its columns are the local axes in the world.
    """

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Rotation = IDENTITY

    @property
    def x_axis(self) -> Vector:
        """Local x axis in the world."""
        return _column(self.rotation, 0)

    @property
    def y_axis(self) -> Vector:
        """Local y axis in the world."""
        return _column(self.rotation, 1)

    @property
    def z_axis(self) -> Vector:
        """Local z axis in the world."""
        return _column(self.rotation, 2)


def _column(rotation: Rotation, index: int) -> Vector:
    return rotation[0][index], rotation[1][index], rotation[2][index]


def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return math.fsum(x * y for x, y in zip(a, b, strict=True))


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def subtract(a: Vector, b: Vector) -> Vector:
    """Vector from b to a."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def along(origin: Vector, direction: Vector, distance: float) -> Vector:
    """Point at `distance` from `origin` along `direction`."""
    x, y, z = (o + distance * d for o, d in zip(origin, direction, strict=True))
    return x, y, z


def norm(a: Vector) -> float:
    """Length of a vector, without overflow."""
    return math.hypot(*a)


def normalised(a: Vector) -> Vector:
    """Unit vector along a.

    Raises
    ------
    ValueError
        If the vector has no length.
    """
    length = norm(a)
    if not 0.0 < length < math.inf:
        raise ValueError("a direction needs a length above zero")
    return a[0] / length, a[1] / length, a[2] / length


def multiply(a: Rotation, b: Rotation) -> Rotation:
    """Rotation b followed by rotation a."""
    columns = [apply_rotation(a, _column(b, j)) for j in range(3)]
    rows = [(columns[0][i], columns[1][i], columns[2][i]) for i in range(3)]
    return rows[0], rows[1], rows[2]


def apply_rotation(rotation: Rotation, vector: Vector) -> Vector:
    """Turn a vector."""
    return dot(rotation[0], vector), dot(rotation[1], vector), dot(rotation[2], vector)


def to_world(pose: Pose, point: Vector) -> Vector:
    """Take a point of the local frame into the world."""
    x, y, z = apply_rotation(pose.rotation, point)
    return pose.position[0] + x, pose.position[1] + y, pose.position[2] + z


def to_local(pose: Pose, point: Vector) -> Vector:
    """Take a point of the world into the local frame."""
    away = subtract(point, pose.position)
    return dot(pose.x_axis, away), dot(pose.y_axis, away), dot(pose.z_axis, away)


def points_to_local(pose: Pose, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take points of the world, shape (n, 3) [m], into the local frame."""
    local: NDArray[np.float64] = (points - np.asarray(pose.position)) @ np.asarray(pose.rotation)
    return local


def rotation_about(axis: str, angle: float) -> Rotation:
    """Rotation about one fixed axis.

    Parameters
    ----------
    axis : str
        "x", "y" or "z".
    angle : float
        Angle [rad], counter-clockwise seen from the tip of the axis.
    """
    c, s = math.cos(angle), math.sin(angle)
    if axis == "x":
        return (1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)
    if axis == "y":
        return (c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)
    return (c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)


def rotation_about_fixed_axes(angles: Sequence[float], order: str = "xyz") -> Rotation:
    """Rotate about the fixed world axes, one after the other.

    With the default order "xyz" this is R = Rz Ry Rx, the convention of Tsai
    (1987) and of the paper's board as we read it (ERRATA of Sec. 4.4).

    Parameters
    ----------
    angles : sequence of float, shape (3,)
        Angles about x, y and z [rad]; always in this order.
    order : str
        The order in which the three rotations are carried out.
    """
    rotation = IDENTITY
    for axis in order:
        rotation = multiply(rotation_about(axis, angles["xyz".index(axis)]), rotation)
    return rotation


def fixed_axis_angles(rotation: Rotation) -> tuple[float, float, float]:
    """Angles about x, y, z [rad] of R = Rz Ry Rx; z is 0 where y is at +-90 degrees."""
    r00, r10, r20 = _column(rotation, 0)
    cosine = math.hypot(r00, r10)
    if cosine > _PARALLEL_SINE:
        about_x = math.atan2(rotation[2][1], rotation[2][2])
        return about_x, math.atan2(-r20, cosine), math.atan2(r10, r00)
    return math.atan2(-rotation[1][2], rotation[1][1]), math.atan2(-r20, cosine), 0.0


def default_up(position: Vector, look_at: Vector) -> Vector:
    """What appears upwards where nobody says: world +y, or world +z where the view is along y.

    Raises
    ------
    ValueError
        If the two points coincide.
    """
    z_axis = normalised(subtract(look_at, position))
    return (0.0, 1.0, 0.0) if norm(cross(z_axis, (0.0, 1.0, 0.0))) > _PARALLEL_SINE else (0.0, 0.0, 1.0)


def aim(position: Vector, look_at: Vector, up: Vector | None = None) -> Pose:
    """Pose of a camera or source that looks from one point at another.

    Parameters
    ----------
    position, look_at : tuple of float, shape (3,)
        Where it stands and what it looks at [m].
    up : tuple of float, shape (3,), optional
        What appears upwards; default as `default_up`.

    Raises
    ------
    ValueError
        If the two points coincide, or `up` is parallel to the viewing direction.
    """
    z_axis = normalised(subtract(look_at, position))
    right = cross(z_axis, normalised(default_up(position, look_at) if up is None else up))
    if norm(right) <= _PARALLEL_SINE:
        raise ValueError("up is parallel to the viewing direction")
    x_axis = normalised(right)
    y_axis = cross(z_axis, x_axis)
    rows = [(x_axis[i], y_axis[i], z_axis[i]) for i in range(3)]
    return Pose(position, (rows[0], rows[1], rows[2]))
