"""Walks down a tree that begin in few of its boxes: against those that begin at the root."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.scene.targets import PolygonShape
from radwrap.tracers.compiled.intersect import hidden
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_shadow import NOTHING_HIDES, hidden_by
from radwrap.tracers.compiled.wide_ways import WAYS, find_ways
from tests.tracers.test_compiled_intersect import laid, soup
from tests.tracers.test_compiled_shadows import box, crowd, on_shapes

pytestmark = pytest.mark.long  # most of the time is that of compiling what else is part of the kernels
STACK = np.empty(DEPTH, dtype=np.int64)


@pytest.mark.parametrize("seed", range(4))
def test_they_find_all_that_hides(seed: int) -> None:
    random = np.random.default_rng(seed)
    tree, tables = laid(crowd(random) if seed % 2 else [soup(random, 400)])
    points = [(random.uniform(-900, 900, 3), -1) for _ in range(100)] + on_shapes(random, tree.shapes, 200)
    hidden_ones, from_root, ways = 0, 0, np.empty(WAYS, dtype=np.int64)
    for point, itself in points:
        middle, size = random.uniform(-1500, 1500, 3), random.uniform(0, 300, 3) * random.integers(0, 2, 3)
        count = find_ways(box(middle - size, middle + size), *tree, tuple(point.tolist()), itself, ways, STACK)
        places = middle + size * random.uniform(-1, 1, (20, 3))
        last = NOTHING_HIDES
        for place in places:
            along = place - point
            away = float(np.linalg.norm(along))
            p, d = tuple(point.tolist()), tuple((along / away).tolist())
            found = hidden_by(*tree, tables, p, d, away, itself, ways, count, last, STACK)
            is_hidden = hidden(*tree, tables, *p, *d, away * (1 - 1e-7), itself, STACK)
            assert (found != NOTHING_HIDES) == is_hidden
            last, hidden_ones = found if is_hidden else last, hidden_ones + is_hidden
        from_root += ways[:count].tolist() == [0]
    assert 500 < hidden_ones < 5500
    assert from_root < 150


def test_a_point_of_an_open_face_has_none() -> None:
    """Beside it lie its neighbours, in its plane: nothing is asked of them."""
    corners = [((x, 0.0, 0.0), (x + 1.0, 0.0, 0.0), (x + 1.0, 1.0, 0.0), (x, 1.0, 0.0)) for x in range(9)]
    tree, _ = laid([PolygonShape(one) for one in corners])
    ways = np.empty(WAYS, dtype=np.int64)
    light = box(np.array([2.0, -3.0, 4.0]), np.array([7.0, 3.0, 4.5]))
    assert find_ways(light, *tree, (4.5, 0.5, 0.0), 4, ways, STACK) == 0
    assert find_ways(light, *tree, (4.5, 0.5, -1.0), -1, ways, STACK) > 0
