"""A scene in which something moves, or is lit or read out at its own time: what it is at one instant."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.motion import moved
from radwrap.scene.scene import Scene
from radwrap.scene.shutter import lit_time, row_windows
from radwrap.scene.sources import dimmed

Array = NDArray[np.float64]


def keys_of_time(scene: Scene) -> tuple[str, ...]:
    """Keys by which a scene is not the same all the time."""
    keys = ["camera.sensor.shutter"] if scene.camera.sensor.shutter is not None else []
    keys += [f"sources[{i}].strobe" for i, source in enumerate(scene.sources) if source.name in scene.strobes]
    for i, target in enumerate(scene.targets):
        if (motion := scene.motions.get(target.name)) is not None:
            keys.append(f"targets[{i}].{'velocity' if any(motion.velocity) else 'angular_velocity'}")
    return tuple(keys)


def refuse_time(scene: Scene, what: str) -> None:
    """For what knows one instant only; `what` names it.

    Raises
    ------
    InputError
        If something moves in the scene, is strobed, or has a shutter that is not global.
    """
    for key in keys_of_time(scene):
        raise InputError(
            f"makes the scene another one in the course of the exposure, and {what} knows one instant",
            where=f"{scene.origin}: {key}",
            remedy="leave the key out",
        )


def held(scene: Scene) -> Scene:
    """The scene as if nothing moved, all sources shone steadily and all rows were exposed at once."""
    camera = replace(scene.camera, sensor=replace(scene.camera.sensor, shutter=None))
    return replace(scene, camera=camera, motions={}, strobes={})


def pose_time(scene: Scene) -> float:
    """When the poses of the scene file hold [s]: at the middle of the frame's first exposure."""
    start, _ = windows_of(scene)
    return float(start.min()) + scene.camera.exposure_time / 2


def at_time(scene: Scene, time: float) -> Scene:
    """The scene `held` at a time [s], all sources lit."""
    late = float(time) - pose_time(scene)  # of numpy it would be written as such into Radiance's text
    targets = tuple(
        moved(target, scene.motions[target.name], late) if target.name in scene.motions else target
        for target in scene.targets
    )
    return replace(held(scene), targets=targets)


def lit_by(scene: Scene, levels: dict[str, float]) -> Scene:
    """The scene with a factor on the radiance of its sources; those that are not named are dark."""
    sources = tuple(dimmed(source, levels.get(source.name, 0.0)) for source in scene.sources)
    return replace(scene, sources=sources)


def windows_of(scene: Scene) -> tuple[Array, Array]:
    """Start and end of each row's exposure [s]."""
    camera = scene.camera
    return row_windows(camera.sensor.shutter, camera.sensor.rows, camera.exposure_time)


def row_levels(scene: Scene) -> dict[str, Array]:
    """Of each source, how long it shines into each row's exposure, as a share of the exposure time, shape (rows,)."""
    start, end = windows_of(scene)
    time = scene.camera.exposure_time
    if time == 0:
        return {source.name: np.ones(len(start)) for source in scene.sources}
    return {source.name: lit_time(scene.strobes.get(source.name), start, end) / time for source in scene.sources}


def averaged(scene: Scene) -> Scene:
    """The scene at the middle of the first exposure, each source with the mean of its levels over the rows."""
    if not keys_of_time(scene):
        return scene
    levels = {name: float(level.mean()) for name, level in row_levels(scene).items()}
    return lit_by(held(scene), levels)


def is_even(levels: Collection[Array]) -> bool:
    """Whether each source's level is the same in all rows."""
    return all(float(np.ptp(level)) == 0.0 for level in levels)
