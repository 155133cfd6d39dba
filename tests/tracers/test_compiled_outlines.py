"""Blocks that are proved smooth in shadows: each light reaches all of such a block, or none of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

import trimesh

import radwrap
from radwrap.imaging.optics.smooth import BLOCK
from radwrap.imaging.optics.view import central_rays
from radwrap.scene.scene import Scene
from radwrap.tracers.compiled.arrays import TRIANGLE, Shape, put, rows
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.outlines import corners_of_triangles, edges_of
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.belt import COLUMNS, FLAT, ROWS, at, block_of, proved

LED: dict[str, Any] = {
    "type": "led",
    "name": "led",
    "position": at(0, 0, 300),
    "look_at": at(0, 0, 0),
    "diameter": "3 mm",
    "radiant_intensity": "0.2 W/sr",
    "beam": {"profile": "lambertian"},
}


def with_part(folder: Path, mesh: trimesh.Trimesh, *more: dict[str, Any], **changes: Any) -> Scene:
    """The belt under some lights, with a mesh in mm over it."""
    mesh.export(folder / "part.obj")
    part = {"part": "part.obj", "length_unit": "1 mm", "name": "part", "material": "dark"}
    document = {**FLAT, **changes, "targets": [*FLAT["targets"], part, *more]}
    return radwrap.scene_from_document(document, folder=folder)


def plate(size: float, height: float, cuts: int = 0) -> trimesh.Trimesh:
    """A square plate of one sheet, of 2 times 4^cuts triangles."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size / 2 + [0, 0, height]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    for _ in range(cuts):
        mesh = mesh.subdivide()
    return mesh


def every_ray(scene: Scene, found: np.ndarray, each: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rays somewhere in each block that is proved, `each` of them, and the block's number."""
    row, column = np.nonzero(found)
    number = np.repeat(np.arange(len(row)), each)
    u, v = (BLOCK * (axis[number] + random.random(len(number))) - 0.5 for axis in (column, row))
    return central_rays(scene.camera, u, v), number


@pytest.mark.parametrize("cuts", [0, 3])
def test_the_middle_of_a_shadow_is_smooth_and_its_rim_is_not(tmp_path: Path, cuts: int) -> None:
    """A plate high over the belt, out of sight of the eye, shades it through edges between triangles that part them.

    It lies at 150 mm of the lamp's 300, so that its shadow is twice as large.
    """
    mesh = plate(10.0, 150.0, cuts)
    mesh.apply_translation([60, 0, 0])
    lamp = {**LED, "position": at(120, 0, 300)}  # the shadow falls on the middle
    found = proved(with_part(tmp_path, mesh, sources=[lamp]))
    seen = {(x, y): bool(found[block_of(x, y)]) for x in (-9.9, -5, 0, 5, 9.9) for y in (-8, 0, 4)}
    assert seen == {(x, y): abs(x) < 9 for x, y in seen}


def test_the_outline_of_a_wall_begins_below_the_belt(tmp_path: Path) -> None:
    """It is 4 mm wide and stands 20 mm high: its shadow's sides are those of edges that go through the belt."""
    wall = trimesh.creation.box([0.2, 4, 40])
    found = proved(with_part(tmp_path, wall, sources=[{**LED, "position": at(120, 0, 300)}]))
    assert [bool(found[block_of(-5, y)]) for y in (0.8, 2.2, 4.0)] == [True, False, True]


def test_a_side_that_a_light_lies_in_has_outlines(tmp_path: Path) -> None:
    """Rounding alone would say on which side of it the corners of the next faces are."""
    side = np.array([[41.4, -4.28, 143], [21.1, -0.92, 86], [53.1, -8.92, 142], [73.4, -12.28, 199.0]])
    faces = [
        [0, 1, 2],
        [0, 2, 3],
        [4, 6, 5],
        [4, 7, 6],
        [0, 4, 5],
        [0, 5, 1],
        [1, 5, 6],
        [1, 6, 2],
        [2, 6, 7],
        [2, 7, 3],
    ]
    wall = trimesh.Trimesh(
        np.concatenate([side, side + np.array([8, -6, 0])]), [*faces, [3, 7, 4], [3, 4, 0]], process=False
    )
    scene = with_part(tmp_path, wall, sources=[{**LED, "position": at(98, -15, 285)}])
    found = proved(scene)
    rays, _ = every_ray(scene, found, 256, np.random.default_rng(1))
    values = next(CompiledTracer(compiled_scene(scene, TextFrame())).trace([rays])).reshape(-1, 256)
    assert not found.all()
    assert set(np.unique((values > 0).mean(axis=1))) <= {0.0, 1.0}


def test_a_gap_that_is_as_large_as_an_overlap_is_seen(tmp_path: Path) -> None:
    """One square of a floor is cut along both diagonals, so that a quarter is there twice and another is not."""
    count = 25
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(count + 1) - count / 2] * 2, indexing="ij"))
    corners = np.stack([x, y, np.full(x.shape, 5.0)], axis=1)
    start = np.arange(count * (count + 1)).reshape(count, -1)[:, :-1].ravel()
    a, b, c, d = start, start + count + 1, start + count + 2, start + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    whole = proved(with_part(tmp_path, trimesh.Trimesh(corners, faces, process=False)))
    middle = int(np.argmin(np.hypot(x[start] + 0.5, y[start] + 0.5)))
    faces[len(start) + middle] = a[middle], b[middle], d[middle]
    found = proved(with_part(tmp_path, trimesh.Trimesh(corners, faces, process=False)))
    assert whole.all()
    assert not found[block_of(0, 0)]
    assert found.mean() > 0.9


def test_a_hole_in_a_plate_lights_a_block_in_its_shadow(tmp_path: Path) -> None:
    """A triangle of .05 mm is missing of 2048: no ray of the lattice knows of it."""
    mesh = plate(10.0, 150.0, 5)
    mesh.apply_translation([60, 0, 0])
    middles = mesh.triangles_center - [60, 0, 150]
    missing = int(np.argmin(np.hypot(middles[:, 0] - 1.3, middles[:, 1] - 0.8)))
    lamp = {**LED, "position": at(120, 0, 300)}
    whole = proved(with_part(tmp_path, mesh, sources=[lamp]))
    mesh.update_faces(np.arange(len(mesh.faces)) != missing)
    found = proved(with_part(tmp_path, mesh, sources=[lamp]))
    x, y = 2 * middles[missing, :2]
    assert whole[block_of(x, y)] and not found[block_of(x, y)]
    assert np.count_nonzero(whole != found) <= 4


def test_each_light_reaches_all_of_a_block_or_none(tmp_path: Path) -> None:
    assert sum(blocks_in_shadows(tmp_path, seed) for seed in range(8)) > 10


def blocks_in_shadows(folder: Path, seed: int) -> int:
    """How many there are under random meshes, open and closed, and sheets over a belt, of all lights.

    What is said of them is tried by each light by itself, and by many rays a block.
    """
    random = np.random.default_rng(seed)
    parts = []
    for _ in range(4):
        size = float(random.uniform(4, 15))
        shapes = [
            trimesh.creation.icosphere(subdivisions=2, radius=size / 2),
            trimesh.creation.annulus(size / 3, size / 2, 1.0, sections=24),
            trimesh.creation.box([size, size / 2, size / 4]),
            plate(size, 0.0, 2),
        ]
        one = shapes[int(random.integers(len(shapes)))]
        one.apply_transform(trimesh.transformations.random_rotation_matrix(random.random(3)))
        one.apply_translation([*random.uniform(-25, 25, 2), 10 ** random.uniform(1, 1.8)])
        parts.append(one)
    more = [
        {
            "type": "sheet",
            "name": f"s{number}",
            "material": "dark",
            "size": ["5 mm", "8 mm"],
            "position": at(*random.uniform(-11, 11, 2), float(random.uniform(2, 60))),
            "rotation": [f"{value} deg" for value in random.uniform(-80, 80, 3)],
        }
        for number in range(2)
    ]
    places = random.uniform(-150, 150, (6, 2))
    sources = [
        {**LED, "name": f"lamp{number}", "position": at(x, y, 300), "look_at": at(x, y, 0)}
        for number, (x, y) in enumerate(places.tolist())
    ]
    scene = with_part(folder, trimesh.util.concatenate(parts), *more, sources=sources)
    found = proved(scene)
    assert found.any()
    rays, number = every_ray(scene, found, 60, random)
    flat = compiled_scene(scene, TextFrame())
    shaded = 0
    for source in scene.sources:
        values = next(CompiledTracer(flat.in_light([source.name])).trace([rays])).reshape(-1, 60)
        reached = (values > 0).mean(axis=1)
        assert set(np.unique(reached)) <= {0.0, 1.0}, source.name
        shaded += int((reached == 0).sum())
    assert number.max() + 1 == len(values)
    return shaded


def test_neighbours_of_edges() -> None:
    """Two triangles with a common side, and one that touches a corner only."""
    corners = np.array(
        [
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            [[1, 0, 0], [1, 1, 0], [0, 1, 0]],
            [[1, 1, 0], [2, 1, 0], [2, 2, 0.0]],
        ],
        dtype=float,
    )
    made = rows(Shape, 4)
    made["kind"] = [TRIANGLE, TRIANGLE, TRIANGLE, 1]
    put(made[:3], "x y z", corners[:, 0])
    put(made[:3], "ux uy uz", corners[:, 1] - corners[:, 0])
    put(made[:3], "vx vy vz", corners[:, 2] - corners[:, 0])
    np.testing.assert_array_equal(corners_of_triangles(made[:3]), corners)
    found = edges_of(made)
    assert found[..., 0].tolist() == [[0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_array_equal(found[0, 1, 1:], [1, 1, 0])
    np.testing.assert_array_equal(found[1, 2, 1:], [0, 0, 0])


def test_three_triangles_at_one_edge_are_an_outline_always() -> None:
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0.5, y, z]] for y, z in ((1, 0), (-1, 0), (0, 1))], dtype=float)
    made = rows(Shape, 3)
    put(made, "x y z", corners[:, 0])
    put(made, "ux uy uz", corners[:, 1] - corners[:, 0])
    put(made, "vx vy vz", corners[:, 2] - corners[:, 0])
    assert not edges_of(made)[..., 0].any()


def test_a_shadow_of_what_is_no_triangle_is_never_proved(tmp_path: Path) -> None:
    """A ball's outline is not looked for: all that it may shade is left."""
    lamp = {**LED, "position": at(120, 0, 300)}
    ball = {"type": "sphere", "name": "ball", "material": "dark", "position": at(60, 0, 150), "diameter": "2 mm"}
    found = proved(radwrap.scene_from_document({**FLAT, "sources": [lamp], "targets": [*FLAT["targets"], ball]}))
    assert not found[block_of(0, 0)]
    assert found[block_of(10, 8)]
    assert found.shape == (ROWS // BLOCK, COLUMNS // BLOCK)
