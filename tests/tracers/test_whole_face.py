"""Flat faces of many triangles fill a block of an image or they do not, and others are near or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

import trimesh

from radwrap.frames import Pose
from radwrap.scene.targets import MeshPart
from radwrap.tracers.compiled.layout import CompiledScene, compiled_scene
from radwrap.tracers.compiled.outlines import edges_of
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.whole_face import fills, room
from radwrap.tracers.text_frame import TextFrame
from tests.tracers.belt import scene_of
from tests.tracers.crowd import mesh_of

INNER, OUTER, HEIGHT = 0.010, 0.020, 0.003  # m


@pytest.fixture(scope="module")
def washer() -> CompiledScene:
    """A washer of many thin triangles, its top at z = 3 mm."""
    solid = trimesh.creation.annulus(INNER, OUTER, HEIGHT, sections=90)
    mesh = mesh_of(solid.vertices + np.array([0, 0, HEIGHT / 2]), solid.faces.astype(np.intp))
    part = MeshPart("washer", Pose(), "belt", "washer.obj", "0" * 64, mesh, closed=True)
    return compiled_scene(replace(scene_of(), targets=(part,)), TextFrame())


def top_fills(scene: CompiledScene, corners_mm: list[tuple[float, float]], near_mm: float) -> bool:
    shapes, units = scene.targets.shapes, scene.frame.units
    top = int(np.flatnonzero((shapes["nz"] > 0.99) & (np.abs(shapes["z"] - HEIGHT * units) < 1e-9 * units))[0])
    corners = np.array([(x * 1e-3, y * 1e-3, HEIGHT) for x, y in corners_mm]) * units
    stack = np.empty(DEPTH, dtype=np.int64)
    found = {
        bool(
            fills(
                shapes,
                scene.targets.nodes,
                edges_of(shapes),
                joined,
                corners,
                top,
                near_mm * 1e-3 * units,
                stack,
                room(),
            )
        )
        for joined in (False, True)
    }
    assert len(found) == 1  # of a whole mesh
    return found.pop()


def square(x: float, y: float, half: float) -> list[tuple[float, float]]:
    return [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]


def test_inside_the_ring_its_triangles_fill_a_block_together(washer: CompiledScene) -> None:
    for angle in np.linspace(0, 6, 25):
        assert top_fills(washer, square(15 * np.cos(angle), 15 * np.sin(angle), 1.5), 0.1)


@pytest.mark.parametrize("middle", [(0.0, 0.0), (10.2, 0.0), (19.9, 0.0), (0.0, 21.0), (30.0, 30.0)])
def test_at_a_rim_in_the_hole_and_beside_they_do_not(washer: CompiledScene, middle: tuple[float, float]) -> None:
    assert not top_fills(washer, square(*middle, 0.5), 0.0)


def test_a_hole_smaller_than_the_block_is_seen(washer: CompiledScene) -> None:
    """The block's corners lie on the ring, all around its hole."""
    assert not top_fills(washer, square(0, 0, 11), 0.1)


def test_what_is_near_counts(washer: CompiledScene) -> None:
    """The walls begin 3.5 mm beside the block's sides."""
    assert top_fills(washer, square(15, 0, 1.5), 2.5)
    assert not top_fills(washer, square(15, 0, 1.5), 4.5)
