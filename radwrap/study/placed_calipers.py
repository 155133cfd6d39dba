"""Calipers placed on targets of a scene: where its geometry says that a rim or an edge lies."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.truth import edge_line
from radwrap.measure.gauges import Box, Caliper, Plane, Response, StraightCaliper
from radwrap.nearest import did_you_mean
from radwrap.scene.camera import Camera
from radwrap.scene.look.faces import Face, FaceRim, face_towards, rings
from radwrap.scene.look.seen_box import seen_box
from radwrap.scene.scene import Scene
from radwrap.scene.targets import EdgeTarget, Target

Array = NDArray[np.float64]
RimName = Literal["outer", "inner"]
Axis = Literal["x", "y"]

RIMS: Final[tuple[RimName, ...]] = ("outer", "inner")
AXES: Final[tuple[Axis, ...]] = ("x", "y")
_BAND: Final = 0.2  # of the radius
_SMALLEST_BAND: Final = 4.0  # px
_LARGEST_BAND: Final = 16.0  # px
_MOST_OF_RADIUS: Final = 0.9
_LENGTH: Final = 0.6  # of a true edge, so that the caliper keeps clear of its ends
_MARGIN: Final = 10.0  # px of band beyond true edges
_LEAST_MARGIN: Final = 3.0  # px of it, where the image ends beside the edges: light beside a blur of a pixel or two
_ROUND: Final = 64  # points that stand for a rim
_ALONG: Final = 257  # points that stand for an edge
_SAME_AXIS: Final = 0.1  # of the radius; a far rim so like the near one bounds the same hole or body
_SAME_SIZE: Final = 1e-6  # of the radius
_SIGNIFICANT: Final = 3.0  # standard errors
_OF_SIDE: Final = 0.25  # of the way from the near rim to the far one, from where on the far one is what was measured


@dataclass(frozen=True, slots=True)
class RimPlace:
    """About where a rim is in the image.

    Attributes
    ----------
    centre : tuple of float
        (u, v) [px].
    radius : float
        In pixel widths [px].
    true_diameter : float or None
        Of the scene's geometry [m].
    with_side : float or None
        That of what the whole part covers, as seen in the plane of the face [m]: less than a hole whose side is seen.
    """

    centre: tuple[float, float]
    radius: float
    true_diameter: float | None = None
    with_side: float | None = None

    def band(self, others: list[float]) -> float:
        """How far from the radius to look [px]: at most half-way to other rims, as what lies there is theirs."""
        band = min(max(_BAND * self.radius, _SMALLEST_BAND), _LARGEST_BAND, _MOST_OF_RADIUS * self.radius)
        return min([band, *(max(abs(self.radius - other) / 2, 1.0) for other in others)])


def region_of(scene: Scene, name: str) -> Box:
    """The largest rectangle of pixels that show a target alone.

    Raises
    ------
    InputError
        If there is no such target, or none of it is seen alone.
    """
    named_target(scene, name)
    return Box(*seen_box(scene.camera, scene.targets, name))


def aspect_of(camera: Camera) -> float:
    """Height of a pixel over its width."""
    return camera.sensor.pixel_height / camera.sensor.pixel_width


def response_of(camera: Camera) -> Response:
    """The camera's response, as gauges need it."""
    sensor = camera.sensor
    return Response(sensor.dark_gray, sensor.gamma, sensor.saturation_gray)


def plane_of(camera: Camera, face: Face, sigma: float = 0.0) -> Plane:
    """The plane of a face; `sigma` is the standard error of its distance [m]."""
    relative = sigma / face.depth(camera) if sigma else 0.0
    return Plane(lambda uv: face.from_image(camera, uv), lambda xy: face.to_image(camera, xy), relative)


def named_target(scene: Scene, name: str) -> Target:
    """The target of a name.

    Raises
    ------
    InputError
        If there is none.
    """
    target = next((one for one in scene.targets if one.name == name), None)
    if target is None:
        if any(source.name == name for source in scene.sources):
            raise InputError(
                f'"{name}" is a source of light, not a target: its geometry places nothing in the image',
                remedy="give pixels or numbers by hand in its place (`against`, `region` or `at`)",
            )
        names = [one.name for one in scene.targets]
        near = did_you_mean(name, names)
        raise InputError(f'the scene has no target "{name}"', remedy=near or f"its targets are {', '.join(names)}")
    return target


def named_face(scene: Scene, name: str) -> Face:
    """The face that the target of a name turns to the camera.

    Raises
    ------
    InputError
        If there is no such target, or it shows no flat face.
    """
    target = named_target(scene, name)
    try:
        return face_towards(scene.camera, target)
    except InputError as error:
        raise InputError(f'"{name}" {error.what}', remedy=error.remedy) from error


def rim_places(camera: Camera, face: Face, aspect: float) -> dict[RimName, RimPlace]:
    """The outer rim of a face, and the inner one where it has one.

    Raises
    ------
    InputError
        If it has none, or lies behind the camera.
    """
    circles = rings(face)
    if not circles:
        raise InputError("has no round rim on the face that it shows")
    return {name: _place(camera, face, rim, aspect, name) for name, rim in zip(RIMS, circles, strict=False)}


def _place(camera: Camera, face: Face, rim: FaceRim, aspect: float, name: RimName) -> RimPlace:
    """The mean of the rim's points, and their mean distance from it in pixel widths."""
    turn = 2 * np.pi * np.arange(_ROUND) / _ROUND
    uv = face.to_image(camera, np.array(rim.centre) + rim.radius * np.column_stack([np.cos(turn), np.sin(turn)]))
    _check_before(uv)
    centre = uv.mean(axis=0)
    radius = float(np.linalg.norm((uv - centre) * np.array([1.0, aspect]), axis=1).mean())
    return RimPlace((float(centre[0]), float(centre[1])), radius, 2 * rim.radius, _with_side(camera, face, rim, name))


def _with_side(camera: Camera, face: Face, rim: FaceRim, name: RimName) -> float | None:
    """Diameter by the area that near and far rims leave or cover together, as seen in the plane of the face [m]."""
    turn = 2 * np.pi * np.arange(_ROUND) / _ROUND
    away = np.column_stack([np.cos(turn), np.sin(turn)])
    seen = np.full(_ROUND, rim.radius)
    for far in face.far_rims:
        if math.dist(far.centre, rim.centre) > _SAME_AXIS * rim.radius or abs(far.radius / rim.radius - 1) > _SAME_AXIS:
            continue
        there = face.from_image(camera, face.to_image(camera, np.array(far.centre) + far.radius * away, far.below))
        if not np.isfinite(there).all():
            continue
        # Seen from the rim's centre, it is a circle about another one.
        middle = there.mean(axis=0) - rim.centre
        radius = float(np.linalg.norm(there - there.mean(axis=0), axis=1).mean())
        along = away @ middle
        beyond = radius**2 - float(middle @ middle) + along**2
        reach = along + np.sqrt(np.maximum(beyond, 0.0))
        seen = np.minimum(seen, reach) if name == "inner" else np.maximum(seen, reach)
    same_area = 2 * math.sqrt(float(np.mean(seen**2)))
    return same_area if abs(same_area - 2 * rim.radius) > _SAME_SIZE * rim.radius else None


def side_warnings(place: RimPlace, measured: float, error: float) -> tuple[str, ...]:
    """What speaks for the side of a thick part in a measured diameter [m] of this error [m].

    A gauge of images cannot know: the far rim is as sharp and as round as the near one.
    """
    if place.true_diameter is None or place.with_side is None:
        return ()
    off, side = measured - place.true_diameter, place.with_side - place.true_diameter
    if off * side <= 0 or abs(off) < max(_SIGNIFICANT * error, _OF_SIDE * abs(side)):
        return ()
    return (
        "the far rim is what was measured, at least in part: the side of the part is seen beside the face's rim of "
        f"{place.true_diameter / 1e-3:.4f} mm, and both rims together leave {place.with_side / 1e-3:.4f} mm",
    )


def rim_caliper(places: dict[RimName, RimPlace], name: RimName) -> Caliper:
    """A caliper on one of the rims."""
    place = places[name]
    others = [other.radius for other in places.values() if other is not place]
    return Caliper(place.centre, place.radius, place.band(others))


def width_caliper(camera: Camera, face: Face, across: Axis, aspect: float) -> tuple[StraightCaliper, float]:
    """A caliper over two opposite sides of a rectangle, and its true width [m].

    Raises
    ------
    InputError
        If the face is no rectangle, or lies behind the camera.
    """
    if face.size is None:
        raise InputError("shows no rectangle")
    axis = AXES.index(across)
    ends = np.zeros((4, 2))
    ends[0, axis], ends[1, axis] = face.size[axis] / 2, -face.size[axis] / 2
    ends[2, 1 - axis], ends[3, 1 - axis] = face.size[1 - axis] / 2, -face.size[1 - axis] / 2
    uv = face.to_image(camera, ends)
    _check_before(uv)
    flat = uv * np.array([1.0, aspect])
    span, along = flat[0] - flat[1], flat[2] - flat[3]
    # The edges run along the other axis, which perspective may turn.
    normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    middle = (uv[0] + uv[1]) / 2
    caliper = StraightCaliper(
        (float(middle[0]), float(middle[1])),
        math.atan2(normal[1], normal[0]),
        _LENGTH * float(np.linalg.norm(along)),
        abs(float(span @ normal)) / 2 + _MARGIN,
    )
    return _within(caliper, camera, aspect), face.size[axis]


def line_caliper(scene: Scene, name: str, aspect: float) -> StraightCaliper:
    """A caliper along the part of an edge target's edge that lies in the image.

    Raises
    ------
    InputError
        If there is none.
    """
    target = next((one for one in scene.targets if isinstance(one, EdgeTarget) and one.name == name), None)
    line = None if target is None else edge_line(scene.camera, target)
    if line is None:
        raise InputError("is not a target of type edge before the camera")
    sensor = scene.camera.sensor
    between = np.linspace(line.ends[0], line.ends[1], _ALONG)
    seen = between[
        (between >= 0).all(axis=1) & (between[:, 0] <= sensor.columns - 1) & (between[:, 1] <= sensor.rows - 1)
    ]
    if len(seen) == 0:
        raise InputError("lies outside the image")
    middle = seen.mean(axis=0)
    length = float(np.linalg.norm((line.ends[1] - line.ends[0]) * np.array([1.0, aspect]))) * len(seen) / len(between)
    # In pixel widths, where rows are `aspect` apart.
    angle = math.atan2(math.sin(line.angle) / aspect, math.cos(line.angle))
    return StraightCaliper((float(middle[0]), float(middle[1])), angle, _LENGTH * length, _MARGIN)


def _within(caliper: StraightCaliper, camera: Camera, aspect: float) -> StraightCaliper:
    """With as much less of the margin as lets the caliper lie in the image; the same where none does."""
    last = np.array([camera.sensor.columns - 1, (camera.sensor.rows - 1) * aspect])
    normal = np.array([math.cos(caliper.angle), math.sin(caliper.angle)])
    side = caliper.length / 2 * np.abs(normal[::-1])
    middle = np.array(caliper.centre) * np.array([1.0, aspect])
    room = np.minimum(middle, last - middle) - side
    fits = float(np.min(room / np.maximum(np.abs(normal), 1e-9)))
    band = min(caliper.band, fits)
    return caliper if band < caliper.band - _MARGIN + _LEAST_MARGIN else replace(caliper, band=band)


def _check_before(uv: Array) -> None:
    if not np.isfinite(uv).all():
        raise InputError("lies behind the camera")
