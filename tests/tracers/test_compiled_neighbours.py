"""What is asked of points that lie together, against one ray from each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.scene.targets import MeshShape
from radwrap.tracers.compiled.along_curve import along_curve
from radwrap.tracers.compiled.arrays import Floats, Light, Whole, put, rows
from radwrap.tracers.compiled.intersect import hidden
from radwrap.tracers.compiled.kernels import meet
from radwrap.tracers.compiled.layout import clusters_of, compiled_scene
from radwrap.tracers.compiled.neighbours import ALL_HIDDEN, LISTED, NEIGHBOURS, NOT_ASKED, darken, put_around
from radwrap.tracers.compiled.shine import towards
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.belt import at, scene_of
from tests.tracers.test_compiled_intersect import laid, soup
from tests.tracers.test_compiled_shadows import STACK, crowd, on_shapes, random_lights

LIGHTS = 30
PIN = {
    "type": "cylinder",
    "name": "pin",
    "material": "shiny",
    "position": at(2, 0, 3),
    "diameter": "8 mm",
    "length": "6 mm",
}


@dataclass
class Seen:
    """How often each answer was given."""

    free: int = 0
    all_hidden: int = 0
    listed: int = 0
    too_many: int = 0
    hidden: int = 0


def groups_of(random: np.random.Generator, tree: np.ndarray) -> list[list[tuple[np.ndarray, int]]]:
    """Points that lie near each other, in the open and on one shape."""
    found = []
    for size in (0.01, 1.0, 10.0, 100.0):
        for _ in range(10):
            middle = random.uniform(-600, 600, 3)
            found.append([(middle + random.uniform(-size, size, 3), -1) for _ in range(NEIGHBOURS)])
        for place, number in on_shapes(random, tree, 10):
            s = tree[number]
            along = np.array([s["ux"], s["uy"], s["uz"]])
            step = random.uniform(0, 0.01 * size, NEIGHBOURS)[:, np.newaxis] * along
            found.append([(point, number) for point in (place + step)[: random.integers(1, NEIGHBOURS + 1)]])
    return found


def darkened(
    lights: np.ndarray, laid_out: tuple[Any, Floats], group: list[tuple[np.ndarray, int]], seen: Seen
) -> list[Floats]:
    """What is left of 1 from each light, at each of the points."""
    (shapes, nodes), tables = laid_out
    clusters, parts = clusters_of(lights)
    points, around = np.full((NEIGHBOURS, 3), np.nan), np.empty(6)
    points[: len(group)] = [point for point, _ in group]
    put_around(points, len(group), around)
    asked: Whole = np.full(len(lights) + len(parts) + len(clusters), NOT_ASKED)
    between = np.empty((len(lights) + len(parts), LISTED), dtype=np.int64)
    heights = np.empty((len(parts), LISTED, 2))
    left = []
    for point, itself in group:
        x, y, z = point.tolist()
        given = np.ones(len(lights))
        for c, cluster in enumerate(clusters):
            darken(
                lights,
                cluster,
                c,
                parts,
                shapes,
                nodes,
                tables,
                points,
                len(group),
                around,
                x,
                y,
                z,
                itself,
                given,
                asked,
                between,
                heights,
                STACK,
            )
        left.append(given)
    of_lights = asked[: len(lights)]
    seen.free += int((of_lights == 0).sum())
    seen.all_hidden += int((of_lights == ALL_HIDDEN).sum())
    seen.listed += int(((of_lights > 0) & (of_lights <= LISTED)).sum())
    seen.too_many += int((asked[len(lights) : -len(clusters)] > LISTED).sum())
    return left


def held_against_single_rays(random: np.random.Generator, lights: np.ndarray, laid_out: tuple[Any, Floats]) -> Seen:
    """See that points which are asked together find what each finds by a ray of its own."""
    (tree, nodes), tables = laid_out
    seen = Seen()
    for group in groups_of(random, tree):
        left = darkened(lights, laid_out, group, seen)
        for (point, itself), given in zip(group, left, strict=True):
            x, y, z = point.tolist()
            for light, value in zip(lights, given.tolist(), strict=True):
                lx, ly, lz, away, _ = towards(light, x, y, z)
                due = not hidden(tree, nodes, tables, x, y, z, lx, ly, lz, away, itself, STACK)
                assert value == due
                seen.hidden += not due
    return seen


@pytest.mark.parametrize("seed", range(4))
def test_what_is_asked_of_all_is_what_each_would_find(seed: int) -> None:
    random = np.random.default_rng(seed)
    shapes = crowd(random) if seed % 2 else [soup(random, 400 if seed else 4000)]
    (tree, nodes), tables = laid(shapes)
    lights = random_lights(random, LIGHTS)
    lights["radiance"] = 1.0
    put(lights, "x y z", random.uniform(-1500, 1500, 3) + random.uniform(-200, 200, (LIGHTS, 3)))
    seen = held_against_single_rays(random, lights, ((tree, nodes), tables))
    assert seen.hidden > 20
    assert min(seen.listed, seen.free) > 0
    assert seed % 2 or seen.all_hidden > 20  # only soup has triangles
    assert (seen.too_many > 20) == (seed == 0)


def test_light_in_the_plane_of_a_triangle() -> None:
    """It hides nothing there, whichever way rounding turns it."""
    random = np.random.default_rng(8)
    lights = rows(Light, 1)
    lights["own"], lights["radiance"] = -1, 1.0
    for n in range(300):
        (tree, nodes), tables = laid([soup(random, 1)])
        s = tree[0]
        a, b = random.uniform(-3, 3, 2)
        put(lights, "x y z", np.array([[s[p] + a * s["u" + p] + b * s["v" + p] for p in "xyz"]]))
        middle = np.array([s[p] + (s["u" + p] + s["v" + p]) / 3 for p in "xyz"])
        group = [(middle + random.uniform(-1, 1, 3) * 10.0 ** random.uniform(-9, 2), -1) for _ in range(5)]
        group += [(middle, 0)]  # on it: it does not hide itself
        for (point, itself), given in zip(group, darkened(lights, ((tree, nodes), tables), group, Seen()), strict=True):
            x, y, z = point.tolist()
            lx, ly, lz, away, _ = towards(lights[0], x, y, z)
            assert (given[0] == 0) == hidden(tree, nodes, tables, x, y, z, lx, ly, lz, away, itself, STACK), n


def test_places_follow_each_other_along_the_curve() -> None:
    arrays = compiled_scene(scene_of(PIN), TextFrame())
    random = np.random.default_rng(2)
    rays = np.zeros((4000, 6))
    rays[:, 2], rays[:, 5] = 0.4, -1.0
    rays[:, :2] = random.uniform(-0.02, 0.02, (4000, 2))
    rays[::7, 5] = 1.0  # these meet nothing
    lengths, met = np.empty(4000), np.empty(4000, dtype=np.int64)
    there = (arrays.targets.shapes, arrays.targets.nodes, arrays.emitters.shapes, arrays.emitters.nodes)
    (x0, y0, z0), units = arrays.frame.origin, float(arrays.frame.units)
    assert meet(*there, arrays.tables, rays, x0, y0, z0, units, lengths, met, np.empty(DEPTH, dtype=np.int64))
    order = along_curve(arrays.targets.nodes, rays, x0, y0, z0, units, lengths, met)
    assert sorted(order.tolist()) == list(range(4000))
    assert (met[order[: (met >= 0).sum()]] >= 0).all()
    steps = np.linalg.norm(np.diff(rays[order[met[order] >= 0], :2], axis=0), axis=1)
    # 3428 places in 40 mm x 40 mm lie .7 mm from each other.
    assert np.median(steps) < 1e-3
    assert np.mean(steps) < 1.5e-3


def test_radiance_does_not_hang_on_which_rays_are_asked_together() -> None:
    random = np.random.default_rng(4)
    tracer = CompiledTracer(compiled_scene(scene_of(PIN), TextFrame()))
    rays = np.zeros((3000, 6))
    rays[:, 2], rays[:, 5] = 0.4, -1.0
    rays[:, :2], rays[:, 3:5] = random.uniform(-0.012, 0.012, (3000, 2)), random.uniform(-0.05, 0.05, (3000, 2))
    values = next(tracer.trace([rays]))
    mixed = random.permutation(3000)
    assert next(tracer.trace([rays[mixed]])).tobytes() == values[mixed].tobytes()
    one_by_one = [next(tracer.trace([ray[np.newaxis]]))[0] for ray in rays[:300]]
    assert one_by_one == values[:300].tolist()
    assert len(np.unique(values)) > 1000


def test_a_sliver_does_not_hide_its_own_points() -> None:
    """Rounding turns the normal of a very thin triangle, so that places on it seem to lie behind it."""
    (tree, nodes), tables = laid([soup(np.random.default_rng(3), 1)])
    s = tree[0]
    side, other = (np.array([s[name + p] for p in "xyz"]) for name in "uv")
    corner, normal = np.array([s[p] for p in "xyz"]), np.array([s["n" + p] for p in "xyz"])
    middle = corner + (side + other) / 3
    put(tree, "nx ny nz", normal - 0.01 * (middle - corner) / np.linalg.norm(middle - corner))
    lights = rows(Light, 1)
    lights["own"], lights["radiance"] = -1, 1.0
    put(lights, "x y z", (middle + 500.0 * normal)[np.newaxis])
    group = [(middle + step * side, 0) for step in (0.0, 1e-4, 2e-4)]
    behind = [(middle - 5.0 * normal, -1)]
    left = darkened(lights, ((tree, nodes), tables), group + behind, seen := Seen())
    assert [given[0] for given in left] == [1.0, 1.0, 1.0, 0.0]
    assert seen.all_hidden == 1


def needles(random: np.random.Generator, count: int) -> MeshShape:
    """Triangles of a width of 1e-13 to 1e-3 of their length."""
    first, along, other = (
        random.uniform(-1, 1, (count, 3)),
        random.normal(size=(count, 3)),
        random.normal(size=(count, 3)),
    )
    across = np.cross(along, other)
    third = first + along * random.uniform(0, 1, (count, 1)) + across * 10 ** random.uniform(-13, -3, (count, 1))
    return MeshShape(
        np.stack([first, first + along, third], axis=1).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    )


@pytest.mark.parametrize("seed", range(3))
def test_needles_with_lights_on_them(seed: int) -> None:
    """Where rounding decides, it decides for each point as if that were asked by itself."""
    random = np.random.default_rng(50 + seed)
    (tree, nodes), tables = laid([needles(random, 20)])
    lights = random_lights(random, LIGHTS)
    lights["radiance"] = 1.0
    some = tree[random.choice(20, LIGHTS)]
    share = random.uniform(0, 1, LIGHTS)
    put(lights, "x y z", np.stack([some[p] + share * some["u" + p] for p in "xyz"], axis=1))
    seen = held_against_single_rays(random, lights, ((tree, nodes), tables))
    assert seen.listed > 20
    assert seen.hidden > 0


def test_nothing_leaks_along_the_common_side_of_two_triangles() -> None:
    """A light, the side and the points lie in one plane, within some digits: rounding may not leave out both."""
    random = np.random.default_rng(9)
    for _ in range(60):
        across, size = random.uniform(-500, 500), random.uniform(1, 100)
        low, high = across - size, across + size
        corners = np.array([[low, -size, 50], [across, -size, 50], [across, size, 50], [low, size, 50], [high, 0, 50]])
        plate = MeshShape(corners / 1e3, np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]]))
        (tree, nodes), tables = laid([plate])
        lights = rows(Light, 1)
        lights["own"], lights["radiance"] = -1, 1.0
        put(lights, "x y z", np.array([[across * (1 + random.integers(-4, 5) * 2e-16), 0.3 * size, 90.0]]))
        for count in (1, 5, NEIGHBOURS):
            group = []
            for _ in range(count):
                off = across * random.integers(-4, 5) * 2e-16 + random.choice([0.0, 1e-9, -1e-10, 1e-12])
                group.append((np.array([across + off, random.uniform(-0.3, 0.3) * size, 0.0]), -1))
            assert [float(given[0]) for given in darkened(lights, ((tree, nodes), tables), group, Seen())] == [
                0.0
            ] * count
