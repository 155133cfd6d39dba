"""How fast what is seen moves over the sensor."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.instants import at_time, pose_time, windows_of
from radwrap.scene.look.geometry import directions, project
from radwrap.scene.look.intersections import Bounded, first_hit, reached
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
# Rays each way that look for what moves; and the time over which speed is taken, as a share of the exposure.
_LOOKS: Final = 48
_SHORT: Final = 1e-6


def image_speeds(scene: Scene) -> dict[str, float]:
    """Largest speed over the sensor of what is seen of each moving target [px s^-1]; those out of sight are not in it.

    Looked for along rays through the opening's centre, at the beginning, where the poses hold, and at the end of the
    frame. Of Radiance files nothing is known.
    """
    start, end = windows_of(scene)
    found: dict[str, float] = {}
    for time in (float(start.min()), pose_time(scene), float(end.max())):
        for name, speed in _at(scene, time).items():
            found[name] = max(speed, found.get(name, 0.0))
    return found


def _at(scene: Scene, time: float) -> dict[str, float]:
    camera, then = scene.camera, at_time(scene, time)
    sensor = camera.sensor
    u, v = np.meshgrid(
        np.linspace(-0.5, sensor.columns - 0.5, _LOOKS), np.linspace(-0.5, sensor.rows - 0.5, _LOOKS), indexing="xy"
    )
    rays = directions(camera, np.column_stack([u.ravel(), v.ravel()]))
    origin = np.asarray(camera.pose.position)
    nearest, owner = np.full(len(rays), np.inf), np.full(len(rays), "", dtype=object)
    for target, some in reached(Bounded.of(then.targets), camera.pose.position, rays):
        distance, _ = first_hit(target, origin, rays[some])
        nearer = distance < nearest[some]
        nearest[some[nearer]], owner[some[nearer]] = distance[nearer], target.name
    speeds = {}
    for target in then.targets:
        mine = owner == target.name
        if target.name not in scene.motions or not mine.any():
            continue
        motion = scene.motions[target.name]
        points = origin + nearest[mine, np.newaxis] * rays[mine]
        away = points - np.asarray(target.pose.position)
        velocity = np.asarray(motion.velocity) + np.cross(np.asarray(motion.angular_velocity), away)
        step = _SHORT * max(camera.exposure_time, _SHORT)
        before, after = (project(camera, points + sign * step / 2 * velocity)[0] for sign in (-1, 1))
        speeds[target.name] = float(np.hypot(*((after - before) / step).T).max())
    return speeds
