"""A board that is tilted the other way looks alike from afar: where an end is refused, a fit begins there again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.fitting.fit import Arrival, with_other_tilts
from radwrap.fitting.free_keys import FreeScene, free_scene
from radwrap.fitting.poses import mirrored_turns
from radwrap.fitting.verdict import Test as Sum
from radwrap.fitting.verdict import Verdict
from radwrap.frames import to_world
from radwrap.scene.scene import Scene
from tests.fitting.conftest import changed

EXACT: Final = 1e-12  # m, and of directions
ROUNDED: Final = 1e-9  # deg: through angles and back
POINTS: Final = ((0.03, 0.0, 0.0), (0.0, 0.02, 0.0), (-0.01, 0.015, 0.0))
NUMBERS: Final = [2.0, -1.0, 5.0, 12.0, -20.0, 30.0]  # mm and deg
EDGE: Final = "pose:edge"


@pytest.fixture
def board(bench: Scene) -> FreeScene:
    """Beside the optical axis, and turned before a fit turns it."""
    off = {"targets[0].position": ["40 mm", "-25 mm", "3 mm"], "targets[0].rotation": ["9 deg", "-5 deg", "10 deg"]}
    return free_scene(changed(bench, off), [EDGE])


def other(free: FreeScene, numbers: list[float]) -> list[float]:
    """Where a fit begins again."""
    scene = free.at(numbers)
    turns = mirrored_turns(free.poses[0], scene.targets[0].pose, scene.camera.pose.position)
    return [*numbers[:3], *turns.values()]


def test_the_other_tilt_shows_the_same_but_for_depth(board: FreeScene) -> None:
    """Across the line of sight each point stays, along it it changes sides; the front stays in front."""
    again = other(board, NUMBERS)
    poses = [board.at(numbers).targets[0].pose for numbers in (NUMBERS, again)]
    sight = np.subtract(poses[0].position, board.scene.camera.pose.position)
    sight = sight / np.linalg.norm(sight)
    for point in POINTS:
        before, after = (np.subtract(to_world(pose, point), pose.position) for pose in poses)
        assert after @ sight == pytest.approx(-(before @ sight), abs=EXACT)
        assert after - (after @ sight) * sight == pytest.approx(before - (before @ sight) * sight, abs=EXACT)
    assert np.abs(np.subtract(to_world(poses[0], POINTS[0]), poses[0].position) @ sight) > 1e-3
    facing = [np.dot(pose.z_axis, sight) for pose in poses]
    assert facing[1] == pytest.approx(facing[0], abs=EXACT)
    assert other(board, again) == pytest.approx(NUMBERS, abs=ROUNDED)


def arrival(values: list[float], chi_square: float, freedom: int = 100) -> Arrival:
    """An end whose sum may be 130."""
    solved: Any = SimpleNamespace(values=np.array(values))
    judged = Verdict(Sum(chi_square, freedom, 0.0, 130.0), None, ())
    return Arrival(SimpleNamespace(solved=solved), judged, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("first", "then", "kept"),
    [(200.0, 120.0, True), (200.0, 150.0, True), (200.0, 210.0, False)],
    ids=["explained", "nearer", "worse"],
)
def test_the_better_end_is_kept(board: FreeScene, first: float, then: float, kept: bool) -> None:
    asked = []

    def go(begin: np.ndarray[Any, Any] | None) -> Arrival:
        assert begin is not None
        asked.append(begin)
        return arrival(list(begin), then)

    begun = arrival(NUMBERS, first)
    found, told = with_other_tilts(board, begun, go)
    assert asked[0] == pytest.approx(other(board, NUMBERS)) and len(asked) == 1
    assert told == [{"pose": EDGE, "kept": kept}]
    assert (found is begun) != kept


@pytest.mark.parametrize(("chi_square", "freedom"), [(120.0, 100), (200.0, 0)], ids=["explained", "not judged"])
def test_an_end_that_is_not_refused_costs_nothing(board: FreeScene, chi_square: float, freedom: int) -> None:
    begun = arrival(NUMBERS, chi_square, freedom=freedom)
    assert with_other_tilts(board, begun, _never) == (begun, [])


def test_only_targets_are_tilted(bench: Scene) -> None:
    free = free_scene(bench, ["pose:camera", "camera.exposure_time"])
    begun = arrival([0.0] * 6 + [1.0], 200.0)
    assert with_other_tilts(free, begun, _never) == (begun, [])


def test_where_the_scene_is_none_the_first_end_stays(board: FreeScene) -> None:
    def go(begin: np.ndarray[Any, Any] | None) -> Arrival:
        raise InputError("takes no such values", where="scene")

    begun = arrival(NUMBERS, 200.0)
    assert with_other_tilts(board, begun, go) == (begun, [])


def _never(begin: np.ndarray[Any, Any] | None) -> Arrival:
    raise AssertionError("nothing asks for another beginning")
