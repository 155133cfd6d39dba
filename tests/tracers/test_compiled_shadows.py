"""What lights give a point, many at once, and what hides many of them: against one light and one ray at a time."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.scene.targets import MeshShape, PolygonShape, Shape, SphereShape, surfaces
from radwrap.tracers.compiled.arrays import GAUSSIAN, LAMBERTIAN, Cluster, Light, put, rows
from radwrap.tracers.compiled.beams import radiance_along
from radwrap.tracers.compiled.intersect import NEAREST, hidden
from radwrap.tracers.compiled.layout import clusters_of
from radwrap.tracers.compiled.shadows import clear
from radwrap.tracers.compiled.shine import received, side_by_side, towards
from radwrap.tracers.compiled.tree import DEPTH
from tests.tracers.crowd import SHAPES, turned
from tests.tracers.test_compiled_intersect import laid, soup

STACK = np.empty(DEPTH, dtype=np.int64)
TABLES = np.zeros(1)


def box(low: np.ndarray, high: np.ndarray) -> np.void:
    cluster = rows(Cluster, 1)
    put(cluster, "x0 y0 z0 x1 y1 z1", np.concatenate([low, high]))
    return cluster[0]


def crowd(random: np.random.Generator) -> list[Shape]:
    made = [SHAPES[kind](f"it{n}", turned(random, 0.4), "bulk") for n in range(4) for kind in SHAPES if kind != "mesh"]
    return [s.shape for target in made for s in surfaces(target) if not s.is_decal]


def on_shapes(random: np.random.Generator, tree: np.ndarray, count: int) -> list[tuple[np.ndarray, int]]:
    """Places on triangles and rectangles of a tree, some on their sides and corners."""
    flat = np.flatnonzero(tree["kind"] <= 1)
    found = []
    for number in random.choice(flat, count):
        s = tree[number]
        if s["kind"] == 0:
            a, b = random.random(2)
            a, b = (a, b) if a + b <= 1 else (1 - a, 1 - b)
            a = random.choice([a, 0.0])
        else:
            a, b = random.uniform(-1, 1, 2) * [s["a"], s["b"]]
        found.append((np.array([s[p] + a * s["u" + p] + b * s["v" + p] for p in "xyz"]), int(number)))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_nothing_hides_what_is_clear(seed: int) -> None:
    random = np.random.default_rng(seed)
    shapes = crowd(random) if seed % 2 else [soup(random, 400)]
    (tree, nodes), tables = laid(shapes)
    points = [(random.uniform(-900, 900, 3), -1) for _ in range(300)] + on_shapes(random, tree, 300)
    clears = 0
    for point, itself in points:
        middle, size = random.uniform(-1500, 1500, 3), random.uniform(0, 300, 3) * random.integers(0, 2, 3)
        if not clear(tree, nodes, box(middle - size, middle + size), *point, itself, STACK):
            continue
        clears += 1
        for place in middle + size * np.vstack(
            [random.uniform(-1, 1, (20, 3)), 1 - 2 * np.indices((2, 2, 2)).reshape(3, -1).T]
        ):
            along = place - point
            away = float(np.linalg.norm(along))
            assert not hidden(tree, nodes, tables, *point, *(along / away), away - NEAREST, itself, STACK)
    assert clears > 60


def test_a_wall_hides_what_lies_behind_it() -> None:
    wall = PolygonShape(((-1.0, -1.0, 0.5), (1.0, -1.0, 0.5), (1.0, 1.0, 0.5), (-1.0, 1.0, 0.5)))
    (tree, nodes), _ = laid([wall, SphereShape((5.0, 0.0, 0.5), 0.1)])
    low, high = np.array([-100.0, -100.0, 900.0]), np.array([100.0, 100.0, 950.0])
    assert not clear(tree, nodes, box(low, high), 0.0, 0.0, 0.0, -1, STACK)
    assert clear(tree, nodes, box(low, high), 0.0, 0.0, 501.0, -1, STACK)
    assert clear(tree, nodes, box(low, high), 0.0, 0.0, 500.0, -1, STACK)  # on it, the lights well off it
    assert clear(tree, nodes, box(low, high), 2500.0, 0.0, 0.0, -1, STACK)  # beside it and beside the sphere
    above = np.array([4900.0, -100.0, 900.0])
    assert not clear(tree, nodes, box(above, above + 200.0), 5020.0, 0.0, 0.0, -1, STACK)  # below the sphere
    # A light in the wall's plane is beside it only for who is well off the plane.
    at = np.array([500.0, 500.0, 500.0])
    assert clear(tree, nodes, box(at, at), 0.0, 0.0, 0.0, -1, STACK)
    assert not clear(tree, nodes, box(at, at), 0.0, 0.0, 499.0, -1, STACK)


def test_a_closed_mesh_does_not_shade_its_own_top() -> None:
    """All triangles of a convex body lie behind each face's plane: no shadow ray is needed."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * 0.05
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
    (tree, nodes), _ = laid([MeshShape(corners, np.array(faces))])
    lights = box(np.array([-60.0, -60.0, 300.0]), np.array([60.0, 60.0, 300.0]))
    random = np.random.default_rng(3)
    for x, y in random.uniform(-49, 49, (100, 2)):
        itself = next(i for i, s in enumerate(tree) if abs(s["nz"]) > 0.9 and abs(s["z"] - 50) < 1e-9)
        assert clear(tree, nodes, lights, x, y, 50.0, itself, STACK)
        assert not clear(tree, nodes, lights, x, y, -51.0, -1, STACK)


def random_lights(random: np.random.Generator, count: int) -> np.ndarray:
    lights = rows(Light, count)
    axis = random.normal(size=(count, 3))
    put(lights, "x y z", random.uniform(-500, 500, (count, 3)))
    put(lights, "nx ny nz", axis / np.linalg.norm(axis, axis=1, keepdims=True))
    lights["area"], lights["radiance"] = random.uniform(1, 9, count), random.uniform(0, 9, count)
    lights["radiance"][:3] = 0.0
    lights["spread"], lights["own"] = random.uniform(0.05, 1.5, count), -1
    lights["beam"] = np.where(np.arange(count) < count // 2, GAUSSIAN, LAMBERTIAN)
    return lights


def test_many_lights_give_what_each_gives() -> None:
    """Digit by digit: a loop that the compiler computes several at a time, and one that it does not."""
    random = np.random.default_rng(5)
    lights = random_lights(random, 150)
    clusters, parts = clusters_of(lights)
    assert [(c["first"], c["end"]) for c in clusters] == [(0, 64), (64, 75), (75, 139), (139, 150)]
    assert [int(parts[c["part"]]["first"]) for c in clusters] == [0, 64, 75, 139]
    assert sum(int(c["end"] - c["first"]) for c in parts) == 150
    beside, given = side_by_side(lights), np.empty(150)
    lit = 0
    for _ in range(200):
        point, normal = random.uniform(-400, 400, 3), random.normal(size=3)
        normal /= np.linalg.norm(normal)
        for diffuse in (0.0, 0.3):
            for cluster in clusters:
                received(lights, beside, cluster, TABLES, *point, *normal, 1e-6, diffuse > 0, diffuse, given)
            for light, value in zip(lights, given.tolist(), strict=True):
                lx, ly, lz, _, solid_angle = towards(light, *point)
                down = lx * normal[0] + ly * normal[1] + lz * normal[2]
                due = 0.0
                if solid_angle > 0 and down > 1e-6:
                    due = radiance_along(light, TABLES, -lx, -ly, -lz) * solid_angle
                    due *= diffuse * down if diffuse else 1.0
                assert value == due
                lit += due > 0
    assert lit > 5000


def test_a_light_at_the_point_itself_gives_nothing() -> None:
    lights = random_lights(np.random.default_rng(6), 4)
    put(lights, "x y z", np.zeros(3))
    clusters, _ = clusters_of(lights)
    given = np.full(4, np.nan)
    for cluster in clusters:
        received(lights, side_by_side(lights), cluster, TABLES, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1e-6, False, 0.0, given)
    assert given.tolist() == [0.0] * 4
