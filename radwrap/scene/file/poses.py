"""Where things of a scene file are and where they look."""

from __future__ import annotations

from radwrap.errors import InputError
from radwrap.frames import Pose, aim, default_up, rotation_about_fixed_axes
from radwrap.scene.file.border import Aimed, Placed

_ORIGIN = (0.0, 0.0, 0.0)


def pose_of(table: Aimed, where: str, key: str, assumed: dict[str, str], *, has_roll: bool = True) -> Pose:
    """Pose of a camera or a source; a single disc has no roll, so nothing is assumed of it."""
    position = table.position or getattr(table, "translation", None)
    if position is None:
        raise InputError("is missing", where=f"{where}.position")
    if table.rotation is not None:
        if table.rotation_order is None:
            assumed[f"{key}.rotation_order"] = "xyz"
        return Pose(position, rotation_about_fixed_axes(table.rotation, table.rotation_order or "xyz"))
    look_at = table.look_at or _ORIGIN
    try:
        up = default_up(position, look_at)
    except ValueError as error:
        raise InputError(
            "is the position itself: a direction needs a length above zero",
            where=f"{where}.look_at",
            remedy="look at another point",
        ) from error
    if table.up is None and has_roll:
        assumed[f"{key}.up"] = f"[{', '.join(f'{value:g}' for value in up)}]"
    try:
        return aim(position, look_at, table.up)
    except ValueError as error:
        raise InputError(str(error), where=f"{where}.up", remedy="choose another up") from error


def placed_pose(table: Placed) -> Pose:
    """Pose of a target."""
    return Pose(table.position, rotation_about_fixed_axes(table.rotation, table.rotation_order))
