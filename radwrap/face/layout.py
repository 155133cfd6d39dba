"""Where things stand, for a page that draws them: targets, sources with their beams, the camera and what it sees.

All places are in the camera's frame: x to the right and y down as it looks, z the way that it looks [m]. So
a page needs no geometry but a rotation.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.convert.preview_files import colour_of, triangles
from radwrap.frames import points_to_local
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import directions
from radwrap.scene.look.intersections import first_hit
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Luminaire
from radwrap.scene.targets import surfaces

Array = NDArray[np.float64]
MOST_TRIANGLES: Final = 20_000  # of one scene; a page draws them in a tenth of a second
_DIGITS: Final = 6  # of a metre: a micrometre
_STEPS: Final = 9001  # of an angle from 0 to 90 degrees
_BOX: Final = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def layout(scene: Scene) -> dict[str, Any]:
    """A scene as a page draws it.

    Returns
    -------
    dict
        ``targets``: name, ``place`` (its middle), ``world`` (its origin in the scene file), ``boxed``: whether only its
        bounds are drawn, ``surfaces``: colour, ``decal``, vertices and faces; ``sources``: name, place, world, axis,
        radius, ``half_angle``: at which the radiant intensity is half of that on the axis [rad], None where it shines
        all around; ``camera``: ``world``, ``corners``: of what the sensor sees, at depth 1, ``depth`` of the farthest
        target's middle, ``focus`` of a lens; ``unknown``: targets whose shapes are not known.
    """
    camera, left = scene.camera, MOST_TRIANGLES
    targets: list[dict[str, Any]] = []
    for target in scene.targets:
        pieces = [(surface, *triangles(surface.shape)) for surface in surfaces(target)]
        if not pieces:
            continue
        count = sum(len(faces) for _, _, faces in pieces)
        every = points_to_local(camera.pose, np.concatenate([vertices for _, vertices, _ in pieces]))
        boxed = count > left
        left -= 0 if boxed else count
        found = [
            {
                "colour": colour_of(scene.materials[surface.material]),
                "decal": surface.is_decal,
                "vertices": _rounded(points_to_local(camera.pose, vertices)),
                "faces": np.asarray(faces).tolist(),
            }
            for surface, vertices, faces in ([] if boxed else pieces)
        ]
        if boxed:
            colour = colour_of(scene.materials[pieces[0][0].material])
            found = [{"colour": colour, "decal": False, "vertices": _rounded(_corners(every)), "faces": _BOX.tolist()}]
        middle = (every.min(axis=0) + every.max(axis=0)) / 2
        targets.append(
            {
                "name": target.name,
                "place": _rounded(middle),
                "world": _rounded(np.asarray(target.pose.position)),
                "boxed": boxed,
                "surfaces": found,
            }
        )
    depths = [target["place"][2] for target in targets if target["place"][2] > 0]
    return {
        "targets": targets,
        "sources": [_source(camera, emitter) for emitter in scene.emitters],
        "camera": {
            "world": _rounded(np.asarray(camera.pose.position)),
            "corners": _rounded(corners_of(camera)),
            "depth": max(depths, default=1.0),
            "focus": None if camera.lens is None else camera.lens.focus_distance,
        },
        "unknown": [one.name for one in scene.included],
    }


def corners_of(camera: Camera) -> Array:
    """What the sensor's corners see at the depth 1 [m] in the camera's frame, in their order round it, shape (4, 3)."""
    right, bottom = camera.sensor.columns - 0.5, camera.sensor.rows - 0.5
    uv = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    local = directions(camera, uv) @ np.asarray(camera.pose.rotation)
    corners: Array = local / local[:, 2:]
    return corners


def seen_at(scene: Scene, column: int, row: int) -> dict[str, Any] | None:
    """What the middle of a pixel sees through the opening's centre.

    Returns
    -------
    dict or None
        ``target``, ``distance`` [m], ``place`` in the camera's frame; None where it is none of the targets whose shapes
        are known.
    """
    camera = scene.camera
    ray = directions(camera, np.array([[float(column), float(row)]]))
    origin = np.asarray(camera.pose.position)
    hits = [(float(first_hit(target, origin, ray)[0][0]), target.name) for target in scene.targets]
    distance, name = min(hits, default=(math.inf, ""))
    if not math.isfinite(distance):
        return None
    place = points_to_local(camera.pose, origin + distance * ray)
    return {"target": name, "distance": distance, "place": _rounded(place[0])}


def _source(camera: Camera, emitter: Emitter) -> dict[str, Any]:
    position = np.asarray(emitter.position)
    return {
        "name": emitter.source,
        "place": _rounded(points_to_local(camera.pose, position[np.newaxis])[0]),
        "world": _rounded(position),
        "axis": _rounded(np.asarray(emitter.axis) @ np.asarray(camera.pose.rotation)),
        "radius": emitter.radius,
        "half_angle": None if isinstance(emitter, Luminaire) else half_angle(emitter),
    }


def half_angle(emitter: Emitter) -> float:
    """Least angle to the axis at which the radiant intensity is half of that on the axis, or less [rad]."""
    angles = np.linspace(0.0, math.pi / 2, _STEPS)
    less = emitter.beam.relative_intensity(angles) <= 0.5 * float(emitter.beam.relative_intensity(np.zeros(1))[0])
    return float(angles[int(np.argmax(less))]) if less.any() else math.pi / 2


def _corners(points: Array) -> Array:
    """Of the bounds of some points."""
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for k in (0, 1) for j in (0, 1) for i in (0, 1)])


def _rounded(values: Array) -> Any:
    return np.round(values, _DIGITS).tolist()
