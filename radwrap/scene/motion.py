"""How a target moves, and where it is at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from radwrap.frames import Pose, Rotation, Vector, along, multiply, norm, normalised
from radwrap.scene.targets import Target

STILL: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Motion:
    """A steady motion.

    Attributes
    ----------
    velocity : tuple of float, shape (3,)
        Of the target's origin, along the world's axes [m s^-1].
    angular_velocity : tuple of float, shape (3,)
        About the world's axes through the target's origin [rad s^-1]: its length is the speed, its direction the axis,
        and the turn is counter-clockwise seen from its tip.
    """

    velocity: Vector = STILL
    angular_velocity: Vector = STILL

    @property
    def is_still(self) -> bool:
        """Whether nothing moves."""
        return not any((*self.velocity, *self.angular_velocity))


def rotation_by(turn: Vector) -> Rotation:
    """Rotation by a vector: its length is the angle [rad], its direction the axis (Rodrigues)."""
    angle = norm(turn)
    if angle == 0:
        return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    x, y, z = normalised(turn)
    c, s = math.cos(angle), math.sin(angle)
    d = 1 - c
    return (
        (c + x * x * d, x * y * d - z * s, x * z * d + y * s),
        (y * x * d + z * s, c + y * y * d, y * z * d - x * s),
        (z * x * d - y * s, z * y * d + x * s, c + z * z * d),
    )


def moved(target: Target, motion: Motion, time: float) -> Target:
    """The target so much later [s] than where its pose holds."""
    x, y, z = motion.angular_velocity
    turn = rotation_by((x * time, y * time, z * time))
    pose = target.pose
    return replace(target, pose=Pose(along(pose.position, motion.velocity, time), multiply(turn, pose.rotation)))
