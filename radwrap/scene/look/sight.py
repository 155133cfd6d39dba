"""What stands in the camera's sight: sources that hide targets or shine in, targets that share a plane."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.look.geometry import across, circle, directions, project
from radwrap.scene.look.intersections import Bounded, first_hit, reached
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Source, WideSource, emitters

Array = NDArray[np.float64]

_NEAREST: Final = 1e-9  # m; what lies in the pinhole's own plane is in nobody's sight
_VIEW_RAYS: Final = 33
_INNER: Final = 15
# Radiance takes surfaces for one within 1e-6 units, which are mm, along a ray; ten times that for oblique rays.
_ONE_PLANE: Final = 1e-8  # m
# Sides that only touch cross at their ends, give or take rounding.
_ENDS: Final = 1e-6


def sources_in_sight(scene: Scene) -> Iterator[str]:
    """A line for each source whose disc is seen from the front, or hides a part of a target.

    A dark source has no disc: it is left out of what is traced.
    """
    targets, rays = Bounded.of(scene.targets), _rays(scene)
    for source in scene.sources:
        facing, hiding, hidden = 0, 0, ""
        if isinstance(source, WideSource) and source.kind == "surround":
            continue  # nothing lies behind it
        for emitter in emitters(source):
            behind = _behind(scene, targets, emitter, rays) if emitter.radiance > 0 else None
            if behind is None:
                continue
            towards = np.asarray(scene.camera.pose.position) - emitter.position
            if towards @ np.asarray(emitter.axis) > 0:
                facing += 1
            elif behind:
                hiding, hidden = hiding + 1, behind
        if facing:
            yield f"{_discs(source, facing)} in view from the front: there the image shows the light itself"
        if hiding:
            yield f'{_discs(source, hiding)} between the camera and "{hidden}", part of which is hidden'


def _discs(source: Source, number: int) -> str:
    if isinstance(source, WideSource):
        return f'a part of "{source.name}" is'
    return f'the disc of "{source.name}" is' if number == 1 else f'{number} discs of "{source.name}" are'


def _behind(scene: Scene, targets: Bounded, emitter: Emitter, rays_of_view: Array) -> str | None:
    """Name of the target behind what is seen of a disc, "" where there is none; None where nothing of it is seen."""
    eye = np.asarray(scene.camera.pose.position)
    points = _in_sight(scene, emitter, rays_of_view)
    away = points - eye
    distance = np.linalg.norm(away, axis=1)
    rays = away / distance[:, np.newaxis]
    met = [
        (target.name, numbers, first_hit(target, eye, rays[numbers])[0])
        for target, numbers in reached(targets, scene.camera.pose.position, rays)
    ]
    seen = np.ones(len(points), dtype=bool)
    for _, numbers, further in met:
        seen[numbers] &= distance[numbers] < further
    if not seen.any():
        return None
    return next((name for name, numbers, further in met if np.isfinite(further[seen[numbers]]).any()), "")


def _in_sight(scene: Scene, emitter: Emitter, rays: Array) -> Array:
    """Points of a disc that fall on the sensor, or through a finite pinhole beside it; shape (n, 3) [m]."""
    camera, sensor = scene.camera, scene.camera.sensor
    points = np.vstack([_on_disc(emitter), _on_rays(scene, emitter, rays)])
    uv, depth = project(camera, points)
    before = depth > _NEAREST
    uv, depth, points = uv[before], depth[before], points[before]
    blur = camera.aperture.reach * np.abs(camera.magnification(depth))
    off = np.maximum(-0.5 - uv, uv - [sensor.columns - 0.5, sensor.rows - 0.5])
    beside = np.maximum(off, 0.0) * [sensor.pixel_width, sensor.pixel_height]
    seen: Array = points[np.hypot(*beside.T) <= blur]
    return seen


def _on_disc(emitter: Emitter) -> Array:
    rim = circle() @ across(np.asarray(emitter.axis))
    shares = np.array([0.0, 0.5, 1.0])[:, np.newaxis, np.newaxis]
    points: Array = np.asarray(emitter.position) + (shares * emitter.radius * rim).reshape(-1, 3)
    return points


def _rays(scene: Scene) -> Array:
    """Directions of rays of the camera, evenly over its view, shape (n, 3)."""
    sensor = scene.camera.sensor
    u, v = (np.linspace(0, count - 1, min(count, _VIEW_RAYS)) for count in (sensor.columns, sensor.rows))
    return directions(scene.camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))


def _on_rays(scene: Scene, emitter: Emitter, rays: Array) -> Array:
    """Where rays of the camera meet a disc, which may be larger than the field of view."""
    eye, axis = np.asarray(scene.camera.pose.position), np.asarray(emitter.axis)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = eye + ((emitter.position - eye) @ axis / (rays @ axis))[:, np.newaxis] * rays
        met: Array = points[np.linalg.norm(points - emitter.position, axis=1) <= emitter.radius]
    return met
