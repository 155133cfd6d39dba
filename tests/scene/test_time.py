"""Shutter, strobes and motion: windows, pulses and poses against closed forms; what is taken and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.frames import Pose, apply_rotation, rotation_about
from radwrap.manifest import sha256_of_value
from radwrap.scene.instants import at_time, held, keys_of_time, pose_time, refuse_time, row_levels
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.motion import Motion, moved, rotation_by
from radwrap.scene.shutter import Shutter, Strobe, lit_time, row_windows, shares_of_times
from radwrap.scene.targets import Sheet

BOARD = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"
# Sums of doubles of about 1.
ROUNDING = 1e-12


def test_a_rolling_shutter_exposes_each_row_as_long_and_a_line_time_later() -> None:
    start, end = row_windows(Shutter("rolling", 2e-5), 4, 1e-3)
    assert start.tolist() == pytest.approx([0, 2e-5, 4e-5, 6e-5])
    assert (end - start).tolist() == pytest.approx([1e-3] * 4)
    up, _ = row_windows(Shutter("rolling", 2e-5, "up"), 4, 1e-3)
    assert up.tolist() == (-start).tolist()  # row 0 begins at time 0 and comes last


def test_poses_hold_at_the_middle_of_the_first_exposure_of_the_frame() -> None:
    changes = {"camera.sensor.shutter": "rolling", "camera.sensor.line_time": "20 us", "camera.exposure_time": "1 ms"}
    scene = radwrap.load_scene(BOARD, changes)
    assert pose_time(scene) == pytest.approx(0.5e-3)
    up = radwrap.load_scene(BOARD, {**changes, "camera.sensor.readout": "up"})
    rows = up.camera.sensor.rows
    assert pose_time(up) == pytest.approx(0.5e-3 - (rows - 1) * 20e-6)  # of the last row


def test_after_a_global_reset_each_row_is_exposed_a_line_time_longer() -> None:
    start, end = row_windows(Shutter("global_reset", 2e-5), 4, 1e-3)
    assert start.tolist() == [0] * 4
    assert end.tolist() == pytest.approx([1e-3, 1.02e-3, 1.04e-3, 1.06e-3])


@pytest.mark.parametrize(
    ("strobe", "start", "end", "lit"),
    [
        (None, 2.0, 5.0, 3.0),
        (Strobe(1.0, 2.0), 0.0, 10.0, 2.0),
        (Strobe(1.0, 2.0), 2.5, 10.0, 0.5),
        (Strobe(1.0, 2.0), 3.0, 10.0, 0.0),
        (Strobe(-1.0, 2.0), 0.0, 10.0, 1.0),
        (Strobe(-1.0, 2.0), 0.25, 0.5, 0.25),
        (Strobe(0.5, 0.25, 1.0), 0.0, 3.0, 0.75),  # at .5, 1.5, 2.5
        (Strobe(0.5, 0.25, 1.0), 0.6, 1.6, 0.25),
        (Strobe(0.5, 0.25, 1.0), 0.8, 1.4, 0.0),
        (Strobe(-7.5, 0.25, 1.0), 0.0, 1.0, 0.25),
        (Strobe(5.0, 0.25, 1.0), 0.0, 4.0, 0.0),  # no pulse comes before the first
        (Strobe(0.0, 1.0, 1.0), 0.3, 7.1, 6.8),
    ],
)
def test_a_source_shines_where_its_pulses_overlap_the_exposure(
    strobe: Strobe | None, start: float, end: float, lit: float
) -> None:
    assert lit_time(strobe, np.array([start]), np.array([end]))[0] == pytest.approx(lit, abs=ROUNDING)


@pytest.mark.parametrize("strobe", [None, Strobe(0.2, 0.45), Strobe(-0.35, 0.11, 0.27)])
def test_times_count_as_the_integral_of_what_goes_straight_between_them(strobe: Strobe | None) -> None:
    """Against a sum of a million steps of a broken line."""
    times = np.array([0.1, 0.3, 0.35, 0.8])
    light = np.array([1.0, 3.0, -1.0, 2.0])
    start, end = np.array([0.0, 0.25, 0.5]), np.array([1.0, 0.33, 0.9])
    found = shares_of_times(strobe, start, end, times) @ light
    steps = 1_000_000
    for row in range(3):
        t = start[row] + (np.arange(steps) + 0.5) / steps * (end[row] - start[row])
        lit = np.ones(steps)
        if strobe is not None:
            after = t - strobe.delay
            lit = (after >= 0) & ((after if strobe.period is None else after % strobe.period) < strobe.width)
        expected = (np.interp(t, times, light) * lit).mean() * (end[row] - start[row])
        assert found[row] == pytest.approx(expected, abs=1e-5)  # a pulse ends within one of the steps


def test_one_time_counts_for_all() -> None:
    weights = shares_of_times(Strobe(0.0, 0.5), np.array([0.0, 0.4]), np.array([1.0, 1.4]), np.array([0.2]))
    assert weights.ravel().tolist() == pytest.approx([0.5, 0.1])


def test_a_target_turns_about_its_own_origin_while_that_moves() -> None:
    sheet = Sheet("s", Pose((1.0, 2.0, 3.0), rotation_about("x", 0.3)), "m", 1.0, 1.0)
    late = moved(sheet, Motion((10.0, 0.0, -2.0), (0.0, 0.0, math.pi)), 0.25)
    assert late.pose.position == pytest.approx((3.5, 2.0, 2.5))
    about_z = rotation_about("z", math.pi / 4)
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        turned = apply_rotation(about_z, apply_rotation(sheet.pose.rotation, axis))
        assert apply_rotation(late.pose.rotation, axis) == pytest.approx(turned)


@pytest.mark.parametrize("axis", "xyz")
def test_a_vector_along_an_axis_turns_about_it(axis: str) -> None:
    x, y, z = (0.7 if axis == name else 0.0 for name in "xyz")
    assert np.abs(np.subtract(rotation_by((x, y, z)), rotation_about(axis, 0.7))).max() < ROUNDING


def test_units_of_speed() -> None:
    scene = radwrap.load_scene(
        BOARD,
        {
            "targets[0].velocity": ["30 m/min", "100 ft/min", "-20 mm/s"],
            "targets[0].angular_velocity": ["60 rpm", "90 deg/s", "1 rad/s"],
        },
    )
    motion = scene.motions[scene.targets[0].name]
    assert motion.velocity == pytest.approx((0.5, 0.508, -0.02))
    assert motion.angular_velocity == pytest.approx((2 * math.pi, math.pi / 2, 1.0))


def test_poses_hold_at_the_middle_of_the_first_exposure() -> None:
    scene = radwrap.load_scene(BOARD, {"targets[0].velocity": ["1 m/s", "0 m/s", "0 m/s"]})
    then = at_time(scene, pose_time(scene))
    assert then.targets == scene.targets and not keys_of_time(then)
    later = at_time(scene, pose_time(scene) + 0.01).targets[0].pose.position
    assert later[0] == pytest.approx(scene.targets[0].pose.position[0] + 0.01)


def test_strobes_shorter_than_the_line_time_light_some_rows_in_full() -> None:
    """Width of 3 us, lines of 10 us, exposures of 100 us: ten or eleven rows see the whole pulse, one a part of it."""
    scene = radwrap.load_scene(
        BOARD,
        {
            "camera.exposure_time": "100 us",
            "camera.sensor.shutter": "rolling",
            "camera.sensor.line_time": "10 us",
            "sources[0].strobe": {"delay": "251 us", "width": "3 us"},
        },
    )
    levels = row_levels(scene)[scene.sources[0].name] * 100
    # Row r is open from 10 r to 10 r + 100: whole for 10 r <= 251 and 254 <= 10 r + 100.
    assert np.flatnonzero(levels > 0).tolist() == list(range(16, 26))
    assert levels[16:26].tolist() == pytest.approx([3.0] * 10)
    partly = radwrap.with_value(scene, "sources[0].strobe", {"delay": "259 us", "width": "3 us"})
    levels = row_levels(partly)[scene.sources[0].name] * 100
    assert levels[15:28].tolist() == pytest.approx([0.0, 1.0, *[3.0] * 9, 2.0, 0.0])


def test_a_global_reset_ramps_steady_light_and_not_a_flash() -> None:
    scene = radwrap.load_scene(
        BOARD,
        {
            "camera.exposure_time": "1 ms",
            "camera.sensor.shutter": "global_reset",
            "camera.sensor.line_time": "10 us",
        },
    )
    name = scene.sources[0].name
    rows = scene.camera.sensor.rows
    assert row_levels(scene)[name] == pytest.approx(1 + np.arange(rows) / 100)
    flash = radwrap.with_value(scene, "sources[0].strobe", {"delay": "100 us", "width": "500 us"})
    assert row_levels(flash)[name] == pytest.approx(np.full(rows, 0.5))


def test_a_scene_without_these_keys_is_as_it_was() -> None:
    plain, told = radwrap.load_scene(BOARD), radwrap.load_scene(BOARD, {"camera.sensor.shutter": "global"})
    assert sha256_of_value(plain.camera) == sha256_of_value(told.camera)
    assert not keys_of_time(told) and not plain.motions and not plain.strobes
    still = radwrap.load_scene(BOARD, {"targets[0].velocity": ["0 m/s", "0 m/s", "0 m/s"]})
    assert not keys_of_time(still)
    assert "shutter" not in json.dumps(radwrap.explain(plain))


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("camera.sensor.shutter", "rolling", "line_time: is missing"),
        ("camera.sensor.shutter", "curtain", "shutter"),
        ("camera.sensor.line_time", "10 us", "leave it out"),
        ("camera.sensor.readout", "up", "leave it out"),
        ("sources[0].strobe", {"delay": "0 s", "width": "2 ms", "period": "1 ms"}, "period must not be shorter"),
        ("sources[0].strobe", {"delay": "0 s", "width": "0 s"}, "strobe.width"),
        ("sources[0].strobe", {"delay": 0, "width": "1 ms"}, "strobe.delay: 0 has no unit"),
        ("targets[0].velocity", "1 m/s", "targets[0].velocity"),
        ("targets[0].velocity", ["1 m", "0 m/s", "0 m/s"], "is not a unit of speed"),
        ("targets[0].angular_velocity", ["1 m/s", "0 rpm", "0 rpm"], "is not a unit of angular velocity"),
    ],
)
def test_what_is_wrong_is_named(key: str, value: Any, told: str) -> None:
    with pytest.raises(InputError) as failure:
        radwrap.load_scene(BOARD, {key: value})
    assert told in str(failure.value)


def test_what_knows_one_instant_refuses_by_key() -> None:
    scene = radwrap.load_scene(BOARD, {"targets[0].velocity": ["1 m/s", "0 m/s", "0 m/s"]})
    with pytest.raises(InputError, match=r"targets\[0\].velocity.*a trade knows one instant.*leave the key out"):
        refuse_time(scene, "a trade")
    refuse_time(held(scene), "a trade")


def test_a_source_whose_pulses_come_too_late_is_warned_of() -> None:
    belt = Path(__file__).parents[2] / "rad_scenes" / "moving_belt" / "scene.toml"
    assert not [text for text in warnings_of(radwrap.load_scene(belt)) if "pulses" in text]
    late = radwrap.load_scene(belt, {"sources[0].strobe.delay": "20 ms"})
    assert [text for text in warnings_of(late) if '"flash" is dark in the image' in text]
