"""What is true of a scene's image: depth, which part each pixel sees, where dots, edges and targets are."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.frames import points_to_local, to_world
from radwrap.imaging.optics.view import PixelPlan, ray_blocks, traced
from radwrap.imaging.pattern_truth import pattern_truth
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import in_view, project
from radwrap.scene.scene import Scene
from radwrap.scene.targets import DotBoard, EdgeTarget, PatternTarget, Target
from radwrap.tracers.tracer import Tracer

_EDGE_POINTS: Final = 65


@dataclass(frozen=True, slots=True)
class DotPlace:
    """Where the centre of a dot is in the image.

    Attributes
    ----------
    row, column : int
        Of the dot on its board.
    u, v : float
        Column and row of the image [px].
    in_view : bool
        Whether that lies on the sensor and before the camera; what stands before it is not asked.
    """

    row: int
    column: int
    u: float
    v: float
    in_view: bool


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """Where an edge is in the image: u cos(angle) + v sin(angle) = offset.

    Attributes
    ----------
    ends : ndarray of float64, shape (2, 2)
        u, v of the ends of the edge [px].
    angle : float
        Of the normal, which points to the right, or downwards [rad].
    offset : float
        Of the line from the centre of the first pixel [px].
    bow : float or None
        How far the edge lies off that line at most [px]; None where the lens does not distort.
    """

    ends: NDArray[np.float64]
    angle: float
    offset: float
    bow: float | None = None

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit vector across the edge, shape (2,)."""
        return np.array([math.cos(self.angle), math.sin(self.angle)])


def central_maps(camera: Camera, numbered: Tracer) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """Depth and part of what each pixel's centre sees through the pinhole's centre.

    Parameters
    ----------
    camera : Camera
        The camera.
    numbered : Tracer
        Of the scene in which each part glows with its number.

    Returns
    -------
    depth : ndarray of float32, shape (rows, columns)
        Distance along the axis [m]; 0 where nothing is seen.
    parts : ndarray of uint16, shape (rows, columns)
        Number of the part; 0 where nothing is seen.
    """
    camera = camera.without_lens  # the same rays, with their own cosines
    parts = np.empty(camera.sensor.pixels, dtype=np.uint16)
    depth = np.empty(camera.sensor.pixels, dtype=np.float32)
    for block, number in traced(numbered.trace, ray_blocks(camera, (0.0, 0.0), PixelPlan())):
        parts[block.first : block.first + block.pixels] = np.rint(number)
    for block, distance in traced(numbered.distances, ray_blocks(camera, (0.0, 0.0), PixelPlan())):
        here = slice(block.first, block.first + block.pixels)
        depth[here] = np.where(parts[here] > 0, distance, 0.0) * block.cos4**0.25
    shape = (camera.sensor.rows, camera.sensor.columns)
    return depth.reshape(shape), parts.reshape(shape)


def geometry(scene: Scene, part_names: tuple[str, ...]) -> dict[str, Any]:
    """True places of what measurements look for, by projection through the pinhole's centre.

    Returns
    -------
    dict
        ``parts``: name -> number in mask.png; ``targets``: for each target
        its pose ``camera_from_target`` (4 x 4, m), its dots (row, column,
        u, v [px], in_view) or its edge (end points and the line
        u cos(angle) + v sin(angle) = offset [px], and where the lens distorts
        the `bow`, the edge's largest distance from that line [px]), or what
        `pattern_truth` says.
    """
    return {
        "pixel_convention": "u is the column, v the row; the centre of the first pixel is (0, 0)",
        "parts": {name: number for number, name in enumerate(part_names, start=1)},
        "targets": {target.name: _target(scene.camera, target) for target in scene.targets},
    }


def _target(camera: Camera, target: Target) -> dict[str, Any]:
    kind = type(target.layout if isinstance(target, PatternTarget) else target).__name__
    entry: dict[str, Any] = {"kind": kind, "camera_from_target": _pose(camera, target)}
    if isinstance(target, DotBoard):
        entry["dots"] = [asdict(place) for place in dot_places(camera, target)]
    if isinstance(target, EdgeTarget):
        entry["edge"] = _told(edge_line(camera, target))
    if isinstance(target, PatternTarget):
        entry |= pattern_truth(camera, target)
    return entry


def _told(line: EdgeLine | None) -> dict[str, Any]:
    if line is None:
        return {"ends": None, "angle": None, "offset": None}
    told = {"ends": line.ends.tolist(), "angle": line.angle, "offset": line.offset}
    return told if line.bow is None else {**told, "bow": line.bow}


def dot_places(camera: Camera, board: DotBoard) -> tuple[DotPlace, ...]:
    """True places of a board's dots, by projection through the pinhole's centre."""
    centres = board.dot_centres()
    points = np.array([to_world(board.pose, centre) for _, _, centre in centres])
    uv, _ = project(camera, points)
    return tuple(
        DotPlace(row, column, float(u), float(v), bool(visible))
        for (row, column, _), (u, v), visible in zip(centres, uv, in_view(camera, points), strict=True)
    )


def _pose(camera: Camera, target: Target) -> list[list[float]]:
    camera_from_world = np.asarray(camera.pose.rotation).T
    rotation = camera_from_world @ np.asarray(target.pose.rotation)
    translation = points_to_local(camera.pose, np.array([target.pose.position]))[0]
    rows = np.column_stack([rotation, translation]).tolist()
    return [*rows, [0.0, 0.0, 0.0, 1.0]]


def edge_line(camera: Camera, target: EdgeTarget) -> EdgeLine | None:
    """True place of an edge, by projection through the pinhole's centre; None if it lies behind the camera."""
    ends = [(target.edge_position, y, 0.0) for y in (-target.height / 2, target.height / 2)]
    uv, depth = project(camera, np.array([to_world(target.pose, end) for end in ends]))
    if (depth <= 0).any():
        return None
    along = uv[1] - uv[0]
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    normal = normal if normal[0] > 0 or (normal[0] == 0 and normal[1] > 0) else -normal
    angle, offset = float(np.arctan2(normal[1], normal[0])), float(normal @ uv[0])
    if camera.distortion is None:
        return EdgeLine(uv, angle, offset)
    # A lens that distorts bends the line: how far it lies off its chord.
    between = np.linspace(-target.height / 2, target.height / 2, _EDGE_POINTS)
    places = np.array([to_world(target.pose, (target.edge_position, float(y), 0.0)) for y in between])
    return EdgeLine(uv, angle, offset, float(np.abs(project(camera, places)[0] @ normal - offset).max()))
