"""Poses that are free: six numbers about where the scene has a camera, a target or a source."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.frames import (
    Pose,
    Rotation,
    Vector,
    dot,
    fixed_axis_angles,
    multiply,
    normalised,
    rotation_about_fixed_axes,
    subtract,
    to_world,
)
from radwrap.reading import shortened
from radwrap.scene.scene import Scene

PREFIX: Final = "pose:"
CAMERA: Final = "camera"
SHIFTS: Final = ("tx", "ty", "tz")
TURNS: Final = ("rx", "ry", "rz")
# What an aimed thing has in place of a rotation.
AIMED: Final = ("look_at", "up")


@dataclass(frozen=True, slots=True)
class FreePose:
    """Something whose pose is free.

    Attributes
    ----------
    name : str
        "camera", or the name of a target or a source.
    table : str
        Its place in the scene file.
    pose : Pose
        Where the scene has it.
    """

    name: str
    table: str
    pose: Pose

    @property
    def is_target(self) -> bool:
        """Whether it is a target that is seen, and neither a source nor the camera."""
        return self.table.startswith("targets[")

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the six numbers: shifts along its own axes [mm], turns about them [deg], the one about x first."""
        return tuple(f"{PREFIX}{self.name}.{part}" for part in (*SHIFTS, *TURNS))

    def written(self, numbers: Mapping[str, float]) -> dict[str, Any]:
        """Keys of the scene file for six numbers by their names; those that are not there are 0."""
        shift = [numbers.get(key, 0.0) * 1e-3 for key in self.keys[:3]]
        turn = [math.radians(numbers.get(key, 0.0)) for key in self.keys[3:]]
        place = to_world(self.pose, (shift[0], shift[1], shift[2]))
        angles = fixed_axis_angles(multiply(self.pose.rotation, rotation_about_fixed_axes(turn)))
        return {
            f"{self.table}.position": [f"{value!r} m" for value in place],
            f"{self.table}.rotation": [f"{value!r} rad" for value in angles],
            f"{self.table}.rotation_order": "xyz",
        }


def mirrored_turns(pose: FreePose, now: Pose, camera: Vector) -> dict[str, float]:
    """Turns [deg] by which a flat thing is tilted as much the other way.

    From afar both look alike: of each point only the sign of its depth is another one.

    Parameters
    ----------
    pose : FreePose
        Whose turns they are.
    now : Pose
        Where the thing is.
    camera : tuple of float, shape (3,)
        From where it is seen [m].
    """
    sight = normalised(subtract(now.position, camera))
    # Mirrored at a plane that faces the camera, and the normal turned back: of a flat thing that is a rotation.
    # mypy does not know that rows and columns are three.
    axes = [_mirrored(axis, sight) for axis in (now.x_axis, now.y_axis, now.z_axis)]
    rotation: Rotation = tuple((x, y, -z) for x, y, z in zip(*axes, strict=True))  # type: ignore[assignment]
    begun: Rotation = (pose.pose.x_axis, pose.pose.y_axis, pose.pose.z_axis)  # local_from_world
    return dict(zip(pose.keys[3:], map(math.degrees, fixed_axis_angles(multiply(begun, rotation))), strict=True))


def _mirrored(axis: Vector, normal: Vector) -> Vector:
    x, y, z = (part - 2 * dot(axis, normal) * along for part, along in zip(axis, normal, strict=True))
    return x, y, z


def free_pose(scene: Scene, document: dict[str, Any], name: str) -> FreePose:
    """The thing of a name; in the tables it then has a rotation, and no point that it looks at.

    Raises
    ------
    InputError
        If there is no such thing, or its pose does not stand in the scene file.
    """
    where = f"free {PREFIX}{shortened(name)}"
    found = _found(scene, document, name)
    if found is None:
        known = [CAMERA, *(one.name for one in (*scene.targets, *scene.sources) if hasattr(one, "pose"))]
        raise InputError("names nothing that has a pose", where=where, remedy=f"there are {', '.join(known)}")
    place, table, pose = found
    if "translation" in table or "calibration" in table or "calibration_file" in table:
        raise InputError("has its pose from a calibration", where=where, remedy="write position and rotation")
    one = FreePose(name, place, pose)
    for key in AIMED:
        table.pop(key, None)
    for key, value in one.written({}).items():
        table[key.rpartition(".")[2]] = value
    return one


def _found(scene: Scene, document: dict[str, Any], name: str) -> tuple[str, dict[str, Any], Pose] | None:
    if name == CAMERA:
        return CAMERA, document["camera"], scene.camera.pose
    for kind, things in (("targets", scene.targets), ("sources", scene.sources)):
        for number, (table, thing) in enumerate(zip(document.get(kind, []), things, strict=True)):
            pose = getattr(thing, "pose", None)
            if thing.name == name and isinstance(pose, Pose):
                return f"{kind}[{number}]", table, pose
    return None


def with_poses(poses: Sequence[FreePose], told: Mapping[str, Any]) -> dict[str, Any]:
    """Values by keys of the scene file, the six numbers of each pose made into its position and rotation."""
    result = {key: value for key, value in told.items() if not key.startswith(PREFIX)}
    for pose in poses:
        numbers = {key: float(str(told[key]).split()[0]) for key in pose.keys if key in told}
        if numbers:
            result.update(pose.written(numbers))
    return result


def aimed_keys(poses: Sequence[FreePose]) -> list[str]:
    """Keys that a scene file has no more once its poses are written."""
    return [f"{pose.table}.{key}" for pose in poses for key in AIMED]
