"""Candidates and the grid: what of the walks over them need not be looked at twice."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from radwrap.measure.dots import order as ordering
from radwrap.measure.dots.order import order

SHEAR = ((1, 1), (0, 1))
TURNS = [((a, 0), (0, b)) for a, b in itertools.product((1, -1), repeat=2)] + [
    ((0, a), (b, 0)) for a, b in itertools.product((1, -1), repeat=2)
]


def walk(turn: tuple[tuple[int, int], tuple[int, int]], shift: tuple[int, int] = (0, 0)) -> dict[tuple[int, int], int]:
    places = [(i, j) for i in range(4) for j in range(3)] + [(5, 1)]
    turned = np.array(places) @ np.array(turn).T + shift
    return {(int(i), int(j)): number for number, (i, j) in enumerate(turned)}


@pytest.mark.parametrize("turn", TURNS)
def test_turned_and_mirrored_walks_are_alike(turn: tuple[tuple[int, int], tuple[int, int]]) -> None:
    assert ordering._is_turned(walk(turn, (3, -7)), walk(TURNS[0]))


def test_a_sheared_walk_is_another() -> None:
    assert not ordering._is_turned(walk(SHEAR), walk(TURNS[0]))


def test_bases_and_their_turns_are_all_changes_of_a_lattices_steps() -> None:
    turns = [np.array(turn) for turn in TURNS if np.linalg.det(np.array(turn)) > 0]
    made = [tuple((turn @ basis).ravel()) for turn in turns for basis in ordering._PLANE_BASES]
    every = {(a, b, c, d) for a, b, c, d in itertools.product(range(-2, 3), repeat=4) if a * d - b * c == 1}
    assert len(made) == len(every) == 52
    assert set(made) == every


@pytest.mark.parametrize("lost", [0, 1, 3])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 8))])
def test_leaving_out_walks_that_are_alike_changes_no_grid(
    seed: int, lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(seed)
    board = np.array([(c, r) for r in range(5) for c in range(6)], dtype=float)
    slant = np.array([[1.0, random.uniform(-0.3, 0.3)], [random.uniform(-0.3, 0.3), 1.0]])
    points = board @ slant.T * 20 + random.normal(0, 0.5, board.shape)
    points = np.concatenate([random.permutation(points)[lost:], random.uniform(-40, 160, (lost, 2))])
    found = order(points, 5, 6)
    monkeypatch.setattr(ordering, "_is_turned", lambda *_: False)
    every = order(points, 5, 6)
    assert found is not None
    assert every is not None
    assert found.found >= 30 - lost
    assert np.array_equal(found.board, every.board)
    assert np.array_equal(found.image, every.image)
    assert np.array_equal(found.beyond, every.beyond)


@pytest.mark.parametrize("rows_columns", [(2, 3), (2, 7), (7, 2), (3, 3)])
@pytest.mark.parametrize("corner", [0, -1])
def test_a_narrow_board_without_a_corner_is_not_sheared(rows_columns: tuple[int, int], corner: int) -> None:
    """Sheared by a dot, the other dots fill two rows as well."""
    rows, columns = rows_columns
    board = np.array([(c, r) for r in range(rows) for c in range(columns)], dtype=float)
    found = order(np.delete(board * 20 + 100, corner, axis=0), rows, columns)
    assert found is not None
    assert {tuple(place) for place in found.board.tolist()} == {tuple(p) for p in np.delete(board, corner, axis=0)}
