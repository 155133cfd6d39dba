"""Where rays meet shapes, and that the tree hides none of them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.frames import Pose
from radwrap.scene.look.intersections import first_hit
from radwrap.scene.targets import MeshShape, PolygonShape, Shape, SphereShape, Target, surfaces
from radwrap.tracers.compiled.arrays import Tree
from radwrap.tracers.compiled.intersect import NEAREST, closest, crossing, hidden
from radwrap.tracers.compiled.kernels import normal_at
from radwrap.tracers.compiled.shape_rows import Piece, sorted_shapes
from radwrap.tracers.compiled.tree import DEPTH, tree_of
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.crowd import SHAPES, turned

# Places have 16 digits, and a ray that grazes a surface multiplies what they lack.
DIGITS = 1e-11
FRAME = TextFrame()  # mm about the world's origin
STACK = np.empty(DEPTH, dtype=np.int64)


def laid(shapes: Iterable[Shape], frame: TextFrame = FRAME) -> tuple[Tree, np.ndarray]:
    tables = [0.0]
    tree = sorted_shapes((Piece(shape, number) for number, shape in enumerate(shapes)), frame, tables)
    return tree, np.array(tables)


def target_laid(target: Target) -> tuple[Tree, np.ndarray]:
    return laid(surface.shape for surface in surfaces(target) if not surface.is_decal)


def hits(laid_out: tuple[Tree, np.ndarray], rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances [mm] and numbers by the tree, of rays in mm with unit directions."""
    (shapes, nodes), tables = laid_out
    found = [closest(shapes, nodes, tables, *ray, math.inf, STACK) for ray in rays.tolist()]
    distance, number = zip(*found, strict=True)
    return np.array(distance), np.array(number)


def by_force(laid_out: tuple[Tree, np.ndarray], ray: list[float]) -> float:
    """Distance to the nearest of all shapes, one after the other."""
    (shapes, _), tables = laid_out
    return min((crossing(shape, tables, *ray) for shape in shapes), default=math.inf)


def random_rays(random: np.random.Generator, eyes: np.ndarray, points: np.ndarray) -> np.ndarray:
    along = points - eyes
    return np.hstack([eyes, along / np.linalg.norm(along, axis=1, keepdims=True)])


@pytest.mark.parametrize("kind", list(SHAPES))
def test_shapes_are_met_where_closed_forms_say(kind: str) -> None:
    random = np.random.default_rng(list(SHAPES).index(kind))
    for _ in range(4):
        target = SHAPES[kind]("it", turned(random, 0.3), "bulk")
        middle = np.array(target.pose.position)
        eyes = middle + np.where(np.arange(200)[:, None] % 2, 0.02, 0.5) * random.normal(size=(200, 3))
        points = middle + random.uniform(-0.12, 0.12, (200, 3))
        rays = random_rays(random, eyes * 1000, points * 1000)
        expected, normals = first_hit(target, rays[:, :3] / 1000, rays[:, 3:])
        tree, tables = target_laid(target)
        distance, number = hits((tree, tables), rays)
        assert (np.isfinite(distance) == np.isfinite(expected)).all()
        met = np.isfinite(distance)
        assert met.mean() > 0.15
        assert distance[met] / 1000 == pytest.approx(expected[met], rel=DIGITS, abs=DIGITS)
        places = rays[met, :3] + distance[met, np.newaxis] * rays[met, 3:]
        mine = [normal_at(tree.shapes[n], *place) for n, place in zip(number[met], places.tolist(), strict=True)]
        assert np.abs(np.array(mine) - normals[met]).max() < 1e-9


def test_spheres_and_tubes_are_met_from_inside() -> None:
    tree, tables = laid([SphereShape((0.0, 0.0, 0.0), 1e-3)])
    (sphere,) = tree.shapes
    assert crossing(sphere, tables, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8) == 1.0
    assert crossing(sphere, tables, 0.0, 0.0, -3.0, 0.0, 0.0, 1.0) == 2.0
    assert crossing(sphere, tables, 0.0, 0.0, 3.0, 0.0, 0.0, 1.0) == math.inf
    # From a point on it, outwards nothing and inwards the other side.
    assert crossing(sphere, tables, 0.0, 0.0, 1.0, 0.0, 0.6, 0.8) == math.inf
    assert crossing(sphere, tables, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0) == 2.0


@pytest.mark.parametrize("sine", [1e-2, 1e-5, 1e-7])
def test_grazing_rays_meet_flat_shapes_where_they_should(sine: float) -> None:
    for kind in ("sheet", "polygon", "disc"):
        tree, tables = target_laid(SHAPES[kind]("it", Pose(), "bulk"))
        height = 20.0 * sine  # 20 mm before the middle
        distance, _ = hits((tree, tables), np.array([[-20.0, 5.0, height, math.sqrt(1 - sine**2), 0.0, -sine]]))
        assert distance[0] == pytest.approx(20.0, rel=1e-8)


def test_a_gap_of_a_micrometre_is_seen() -> None:
    square = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)]
    sheets = [PolygonShape(tuple((x, y, z) for x, y in square)) for z in (0.0, 1e-6)]
    tree, tables = laid(sheets)
    distance, number = hits((tree, tables), np.array([[0, 0, 50, 0, 0, -1.0], [0, 0, -50, 0, 0, 1.0]]))
    assert distance.tolist() == pytest.approx([49.999, 50.0], rel=1e-13)
    assert tree.shapes["owner"][number].tolist() == [1, 0]
    # From the lower one, the upper one is 0.001 mm away, and not where the ray began.
    up = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert hidden(*tree, tables, *up, 100.0, -1, STACK)
    assert not hidden(*tree, tables, *up, 100.0, int(number[0]), STACK)
    assert not hidden(*tree, tables, *up, 1e-3 * (1 - 1e-9), -1, STACK)
    assert by_force((tree, tables), list(up)) == pytest.approx(1e-3, rel=1e-12)
    assert NEAREST < 1e-3


def test_no_ray_slips_between_triangles() -> None:
    """Rays to points on the common sides of a closed body's triangles, from inside and outside."""
    random = np.random.default_rng(3)
    target = SHAPES["mesh"]("it", turned(random, 0.2), "bulk")
    shape = surfaces(target)[0].shape
    assert isinstance(shape, MeshShape)
    corners = shape.vertices[shape.faces]
    share = random.random((len(corners), 3, 1))
    on_sides = (share * corners + (1 - share) * np.roll(corners, 1, axis=1)).reshape(-1, 3) * 1000
    on_sides = np.vstack([on_sides, corners.reshape(-1, 3) * 1000])
    middle = shape.vertices.mean(axis=0) * 1000
    for _ in range(5):
        eyes = middle + random.normal(scale=5.0, size=on_sides.shape)
        rays = random_rays(random, eyes, on_sides)
        distance, _ = hits(target_laid(target), rays)
        assert np.isfinite(distance).all()
        assert np.abs(distance - np.linalg.norm(on_sides - eyes, axis=1)).max() < 1e-6


def test_polygons_need_not_be_convex() -> None:
    """A comb of three teeth: its area by random points."""
    comb = [(0, 0), (5, 0), (5, 4), (4, 4), (4, 1), (3, 1), (3, 4), (2, 4), (2, 1), (1, 1), (1, 4), (0, 4)]
    tree, tables = laid([PolygonShape(tuple((x / 1000, y / 1000, 0.0) for x, y in comb))])
    random = np.random.default_rng(5)
    places = np.column_stack([random.uniform(0, 5, 3000), random.uniform(0, 4, 3000), np.full(3000, 7.0)])
    distance, _ = hits((tree, tables), np.hstack([places, np.tile([0.0, 0.0, -1.0], (3000, 1))]))
    x, y = places[:, 0], places[:, 1]
    inside = (y < 1) | (np.floor(x).astype(int) % 2 == 0)
    assert (np.isfinite(distance) == inside).all()
    assert distance[inside] == pytest.approx(7.0, rel=1e-14)


def soup(random: np.random.Generator, count: int) -> MeshShape:
    """Triangles of all sizes and slimness, anywhere; some in the planes of their boxes' faces."""
    middle = random.uniform(-1, 1, (count, 1, 3))
    corners = middle + random.normal(size=(count, 3, 3)) * 10 ** random.uniform(-3, -0.5, (count, 1, 1))
    corners[: count // 10, :, 2] = np.round(corners[: count // 10, :1, 2], 1)
    return MeshShape(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def test_the_tree_hides_nothing() -> None:
    """5000 random triangles, and all of them one after the other by numpy."""
    random = np.random.default_rng(6)
    shape = soup(random, 5000)
    laid_out = tree, tables = laid([shape])
    rays = random_rays(random, random.uniform(-1500, 1500, (300, 3)), random.uniform(-900, 900, (300, 3)))
    rays[:60, 3:] = np.eye(3)[np.arange(60) % 3] * np.where(np.arange(60)[:, None] % 2, 1, -1)  # along the axes
    distance, number = hits(laid_out, rays)
    shapes = tree.shapes
    for ray, found, which in zip(rays.tolist(), distance, number, strict=True):
        each = numpy_crossings(shapes, np.array(ray))
        assert found == pytest.approx(each.min(), rel=1e-9)
        if which >= 0:
            assert crossing(shapes[which], tables, *ray) == found
            assert not hidden(*tree, tables, *ray, found, -1, STACK)
            assert hidden(*tree, tables, *ray, found * (1 + 1e-12), -1, STACK)
            second = np.partition(each, 1)[1]
            if second > found * (1 + 1e-6):
                assert not hidden(*tree, tables, *ray, second * (1 - 1e-9), which, STACK)
                assert hidden(*tree, tables, *ray, second * (1 + 1e-9), which, STACK) == np.isfinite(second)
    assert np.isfinite(distance).sum() > 100


def numpy_crossings(shapes: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Distance to each triangle: a ray that passes its three sides on one side meets its plane within it."""
    a, u, v = (
        np.stack([shapes[name] for name in names.split()], axis=1) for names in ("x y z", "ux uy uz", "vx vy vz")
    )
    corners = np.stack([a, a + u, a + v], axis=1) - ray[:3]
    turns = np.cross(corners, np.roll(corners, -1, axis=1)) @ ray[3:]
    within = (turns > 0).all(axis=1) | (turns < 0).all(axis=1)
    normal = np.cross(u, v)
    across = normal @ ray[3:]
    t = (corners[:, 0] * normal).sum(axis=1) / np.where(within, across, 1.0)
    return np.where(within & (t > NEAREST), t, np.inf)


def test_other_shapes_in_a_tree() -> None:
    """Spheres, discs, tubes and polygons together, against each alone."""
    random = np.random.default_rng(8)
    targets = [
        SHAPES[kind](f"it{n}", turned(random, 0.5), "bulk") for n in range(12) for kind in SHAPES if kind != "mesh"
    ]
    laid_out = laid(s.shape for target in targets for s in surfaces(target) if not s.is_decal)
    rays = random_rays(random, random.uniform(-900, 900, (150, 3)), random.uniform(-400, 400, (150, 3)))
    distance, _ = hits(laid_out, rays)
    assert distance.tolist() == [by_force(laid_out, ray) for ray in rays.tolist()]
    assert np.isfinite(distance).sum() > 50


def test_a_thousand_shapes_in_one_place() -> None:
    spheres = [SphereShape((0.1, 0.2, 0.3), 1e-3 * (1 + n % 7)) for n in range(1000)]
    tree, tables = laid(spheres)
    distance, _ = hits((tree, tables), np.array([[100.0, 200.0, 400.0, 0.0, 0.0, -1.0]]))
    assert distance[0] == pytest.approx(93.0, rel=1e-14)
    assert tree.nodes["count"].sum() == 1000


def test_the_tree_holds_each_shape_once_and_is_shallow() -> None:
    random = np.random.default_rng(9)
    # Ever smaller towards a corner: the heuristic cuts off one by one.
    middle = 2.0 ** -np.arange(900.0)[:, np.newaxis] * random.uniform(0.9, 1.1, (900, 3))
    order, nodes = tree_of(middle * 0.999, middle * 1.001)
    assert sorted(order.tolist()) == list(range(900))
    assert nodes["count"].sum() == 900
    depth, waiting = 0, [(0, 1)]
    while waiting:
        node, level = waiting.pop()
        depth = max(depth, level)
        if not nodes[node]["count"]:
            waiting += [(node + 1, level + 1), (int(nodes[node]["second"]), level + 1)]
    assert depth < DEPTH
    assert (nodes["x0"][nodes["count"] > 0] <= nodes["x1"][nodes["count"] > 0]).all()


def test_where_nothing_is() -> None:
    tree, tables = laid([])
    ray = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert closest(*tree, tables, *ray, math.inf, STACK) == (math.inf, -1)
    assert closest(*tree, tables, *ray, 5.0, STACK) == (5.0, -1)
    assert not hidden(*tree, tables, *ray, math.inf, -1, STACK)
