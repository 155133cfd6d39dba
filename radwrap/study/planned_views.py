"""Views of a target as a calibration would take them: how many, how tilted, all over the image."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.camera_model import turn
from radwrap.calibrate.views import CalibrationView
from radwrap.errors import InputError
from radwrap.frames import points_to_local
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import directions, in_view, project
from radwrap.scene.targets import PatternTarget
from radwrap.study.target_points import places_of

Array = NDArray[np.float64]

# A target that turns its front to the camera: its x runs right, its y up, its normal comes back.
_FACING: Final = np.diag([1.0, -1.0, -1.0])
_GOLDEN: Final = math.pi * (3 - math.sqrt(5))  # rad; turns by it never come round
_HALVINGS: Final = 20
# Views that cannot stand apart by more than this share of the image are one view again and again.
_APART: Final = 1e-3


def planned_views(camera: Camera, target: PatternTarget, count: int, tilt: float) -> list[CalibrationView]:
    """Views with exact points, at the distance that the target has in the scene.

    The target's plane is tilted against the image plane, about one axis after the other (by golden angles). Its middle
    goes to places all over the image (Halton's points), as far out as all points stay in view.

    Parameters
    ----------
    camera : Camera
        Who sees them.
    target : PatternTarget
        A chessboard, a ChArUco board or a grid of circles.
    count : int
        How many views.
    tilt : float
        Angle between the target and the image plane [rad].

    Raises
    ------
    InputError
        If the target does not fit into the image.
    """
    from scipy.stats.qmc import Halton

    places = np.array(places_of(target.layout))
    points = np.column_stack([places, np.zeros(len(places))])
    distance = float(np.linalg.norm(points_to_local(camera.pose, np.array([target.pose.position]))))
    size = np.array([camera.sensor.columns, camera.sensor.rows])
    middle = (size - 1) / 2
    spread = Halton(2, scramble=False).fast_forward(1).random(count) * size - 0.5  # its first point is a corner
    found = []
    for number, wanted in enumerate(spread):
        about = number * _GOLDEN
        arms = points @ (turn(tilt * np.array([math.cos(about), math.sin(about), 0.0]))[0] @ _FACING).T
        share = _farthest(camera, arms, middle, wanted, distance)
        world = _placed(camera, arms, middle + share * (wanted - middle), distance)
        found.append(CalibrationView(points, project(camera, world)[0], str(number + 1)))
    return found


def _placed(camera: Camera, arms: Array, middle: Array, distance: float) -> Array:
    """World points of a target whose middle is seen at a pixel; arms are in the camera's frame."""
    centre = np.asarray(camera.pose.position) + distance * directions(camera, middle[np.newaxis])[0]
    world: Array = centre + arms @ np.asarray(camera.pose.rotation).T
    return world


def _farthest(camera: Camera, arms: Array, middle: Array, wanted: Array, distance: float) -> float:
    """Share of the way from the image's middle to a place up to which all points are in view."""

    def fits(share: float) -> bool:
        world = _placed(camera, arms, middle + share * (wanted - middle), distance)
        return bool(in_view(camera, world).all())

    if not fits(0.0):
        raise InputError(
            f"does not fit into the image at {distance:.3g} m, so tilted", remedy="move it away, or tilt it less"
        )
    if fits(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        half = (low + high) / 2
        low, high = (half, high) if fits(half) else (low, half)
    if low < _APART:
        raise InputError(
            f"fills the image at {distance:.3g} m, so that views cannot differ", remedy="move it away, or tilt it less"
        )
    return low
