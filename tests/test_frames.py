"""Rotations and poses: axes, order and signs."""

import math

import numpy as np
import pytest

from radwrap.frames import (
    Pose,
    aim,
    apply_rotation,
    fixed_axis_angles,
    rotation_about,
    rotation_about_fixed_axes,
    to_local,
    to_world,
)

RIGHT = math.pi / 2


@pytest.mark.parametrize(
    ("axis", "start", "end"),
    [("x", (0, 1, 0), (0, 0, 1)), ("y", (0, 0, 1), (1, 0, 0)), ("z", (1, 0, 0), (0, 1, 0))],
)
def test_a_positive_angle_turns_counter_clockwise(axis: str, start: tuple, end: tuple) -> None:
    assert apply_rotation(rotation_about(axis, RIGHT), start) == pytest.approx(end, abs=1e-15)


def test_rotations_about_fixed_axes_are_rz_ry_rx() -> None:
    a, b, c = 0.3, -0.7, 1.1
    rx, ry, rz = (np.array(rotation_about(axis, angle)) for axis, angle in zip("xyz", (a, b, c), strict=True))
    assert np.allclose(rotation_about_fixed_axes((a, b, c)), rz @ ry @ rx, atol=1e-15)
    assert np.allclose(rotation_about_fixed_axes((a, b, c), "zyx"), rx @ ry @ rz, atol=1e-15)
    assert not np.allclose(rz @ ry @ rx, rx @ ry @ rz, atol=0.1)


@pytest.mark.parametrize("angles", [(0.3, -0.7, 1.1), (3.0, 0.2, -2.0), (0.4, RIGHT, 0.0), (0.0, -RIGHT, 0.0)])
def test_angles_come_back(angles: tuple) -> None:
    rotation = rotation_about_fixed_axes(angles)
    again = rotation_about_fixed_axes(fixed_axis_angles(rotation))
    assert np.allclose(rotation, again, atol=1e-12)


def test_a_camera_looks_along_z_with_x_right_and_y_down() -> None:
    pose = aim((0, 0, 2.0), (0, 0, 0))
    assert pose.z_axis == pytest.approx((0, 0, -1))
    assert pose.x_axis == pytest.approx((1, 0, 0))
    assert pose.y_axis == pytest.approx((0, -1, 0))
    assert np.linalg.det(np.array(pose.rotation)) == pytest.approx(1)


def test_up_has_a_default_also_along_y_and_is_refused_where_it_is_parallel() -> None:
    assert aim((0, 1, 0), (0, 0, 0)).y_axis == pytest.approx((0, 0, -1))
    with pytest.raises(ValueError, match="parallel"):
        aim((0, 0, 1), (0, 0, 0), (0, 0, 5))
    with pytest.raises(ValueError, match="length"):
        aim((1, 2, 3), (1, 2, 3))


def test_poses_go_there_and_back() -> None:
    pose = Pose((0.1, -2.0, 3e5), rotation_about_fixed_axes((0.3, -0.7, 1.1)))
    point = (0.4, 0.5, -0.6)
    assert to_local(pose, to_world(pose, point)) == pytest.approx(point, abs=1e-9)
