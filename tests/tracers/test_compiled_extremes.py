"""The compiled tracer where numbers are extreme: sizes, places, counts, and rays that are none."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.errors import TracerError
from radwrap.frames import Pose, aim
from radwrap.process import Programs
from radwrap.scene.mesh import mesh_hit, mesh_of
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Beam, Emitter, SingleSource, WideSource
from radwrap.scene.targets import MeshPart, Sheet, Sphere
from radwrap.scene.wide_shapes import Rectangle
from radwrap.tracers.agreement import SAME
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.text_frame import traced_frame
from tests.tracers.crowd import (
    MATERIALS,
    Both,
    camera,
    crowd,
    patches,
    rays_at,
    rays_scaled,
    relative,
    scaled,
    source,
    whole,
)

# Rims of parts and shadows, and what Radiance hides from itself (see test_compiled_same_rays).
FEW = 4
# Places 10 km away have 12 digits after the point [m]; a lobe of 0.3 deg makes ten times as much of a direction.
ROUNDED = 1e-7
# Half a second of work at most before an interruption is heeded.
MOST_AT_ONCE = 1.1e6
DOWN = np.array([[0.0, 0.0, 0.3, 0.0, 0.0, -2.0]])
BESIDE = np.array([[0.2, 0.1, 0.3, 0.0, 0.0, -2.0]])
LAMP = (0.3, 0.2, 1.0)
# From below at the lamp, in which nothing stands.
SEEN = np.array([[0.03, 0.02, 0.1, 0.27, 0.18, 0.9]])


@pytest.fixture
def folders(tmp_path: Path) -> Iterator[Path]:
    return (tmp_path / str(number) for number in count())


def compiled_of(scene: Scene) -> CompiledTracer:
    return CompiledTracer(compiled_scene(scene, traced_frame(scene)))


def table(*sources: object, extra: tuple[object, ...] = ()) -> Scene:
    """A gray sheet in some light."""
    sheet = Sheet("sheet", Pose(), "bulk", 1.0, 1.0)
    return Scene(camera(), tuple(sources), {"bulk": MATERIALS["bulk"]}, (sheet, *extra))  # type: ignore[arg-type]  # of any kind


@pytest.mark.parametrize(
    ("factor", "shift"),
    [
        (1e-3, (0.0, 0.0, 0.0)),
        pytest.param(1e3, (0.0, 0.0, 0.0), marks=pytest.mark.long),
        (1.0, (1e4, -2e4, 3e4)),
    ],
)
def test_size_and_place_change_nothing(
    factor: float, shift: tuple[float, float, float], folders: Iterator[Path]
) -> None:
    scene = crowd(3)
    rays = rays_at(scene, 600, 5)
    moved, moved_rays = scaled(scene, factor, shift), rays_scaled(rays, factor, shift)
    (expected,) = compiled_of(scene).trace([rays])
    with Programs() as programs:
        both = Both.of(moved, programs, next(folders))
        radiance, compiled = (whole(tracer, moved_rays) for tracer in both.tracers())
    # Near the camera's place and in its scale, no digit that counts is lost.
    assert np.sort(relative(compiled, expected))[-FEW] < ROUNDED
    assert np.sort(relative(compiled, radiance))[-FEW] < SAME


@pytest.mark.parametrize("cuts", [8, pytest.param(12, marks=pytest.mark.long)])
def test_up_to_4096_patches(cuts: int, folders: Iterator[Path]) -> None:
    pose, shape, beam = aim((0.0, 0.3, 0.8), (0.0, 0.0, 0.0)), Rectangle(0.6, 0.4), Beam("cosine_power", 0.5)
    made = patches("panel", shape, cuts, pose, level=5.0, beam=beam)
    assert len(made) == 2**cuts
    panel = WideSource("panel", "rectangle", pose, shape, 5.0, beam, 0.1, 1, made)
    ball = Sphere("ball", Pose((0.05, 0.05, 0.1)), "bulk", 0.1)
    scene = table(panel, extra=(ball,))
    random = np.random.default_rng(1)
    points = np.column_stack([random.uniform(-0.2, 0.2, (60, 2)), np.zeros(60)])
    eyes = points + random.normal(size=(60, 3)) * 0.05 + [0.0, 0.0, 0.3]
    rays = np.hstack([eyes, points - eyes])
    with Programs() as programs:
        radiance, compiled = (whole(tracer, rays) for tracer in Both.of(scene, programs, next(folders)).tracers())
    assert (radiance > 0).all()
    # On the ball's horizon Radiance may hide a patch.
    assert np.sort(relative(compiled, radiance))[-FEW] < SAME


def test_a_small_panel_shines_as_a_point() -> None:
    """E = L A cos cos'/d^2 under a patch of 1 mm at 1 m."""
    pose, shape = aim((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), Rectangle(1e-3, 1e-3)
    made = patches("panel", shape, 0, pose, level=7.0, beam=Beam("lambertian"))
    scene = table(WideSource("panel", "rectangle", pose, shape, 7.0, Beam("lambertian"), 0.1, 1, made))
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, -0.4, 0.0]])
    rays = np.hstack([points + np.array([0.1, 0.1, 0.2]), np.tile([-0.1, -0.1, -0.2], (3, 1))])
    (found,) = compiled_of(scene).trace([rays])
    square = 1 + (points**2).sum(axis=1)
    assert found == pytest.approx(0.4 / math.pi * 7.0 * 1e-6 / square**2, rel=1e-12)


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_rays_that_are_none_are_refused(place: int, value: float) -> None:
    tracer = compiled_of(table(source("lambertian", LAMP)))
    ray = DOWN.copy()
    ray[0, place] = value
    rays = np.vstack([DOWN, ray, DOWN])
    for ask in (tracer.trace, tracer.distances, tracer.parts, tracer.surfaces, tracer.trace_with_distances):
        with pytest.raises(ValueError, match="a ray holds NaN or infinity, or has no direction"):
            list(ask([rays]))


def test_a_ray_without_direction_is_refused() -> None:
    with pytest.raises(ValueError, match="has no direction"):
        list(compiled_of(table(source("lambertian", LAMP))).trace([np.zeros((1, 6))]))


def test_a_direction_may_have_any_length() -> None:
    tracer = compiled_of(table(source("lambertian", LAMP)))
    rays = np.hstack([np.tile(DOWN[:, :3], (5, 1)), DOWN[:, 3:] * np.array([[1e-150], [1e-3], [1], [1e3], [1e150]])])
    ((values, distances),) = tracer.trace_with_distances([rays])
    assert values == pytest.approx(values[2], rel=1e-14) and values[2] > 0
    assert distances == pytest.approx(0.3, rel=1e-14)


def test_what_is_seen_where_nothing_is() -> None:
    """Inside a surround all looks alike, on its patches and between them; a dark world is black."""
    tracer = compiled_of(table(source("surround", LAMP)))
    random = np.random.default_rng(2)
    out = random.normal(size=(2000, 3))
    out[:, 2] = np.abs(out[:, 2]) + 0.01
    rays = np.hstack([np.tile([0.0, 0.0, 0.1], (2000, 1)), out])
    ((values, distances),) = tracer.trace_with_distances([rays])
    assert values == pytest.approx(0.3, rel=1e-14)
    # Of light that goes away from a patch nothing is seen: from outside it is dark, and between the patches as bright.
    outside = np.hstack([10 * out / np.linalg.norm(out, axis=1, keepdims=True), -out])
    ((seen, far),) = tracer.trace_with_distances([outside])
    assert not seen[np.isfinite(far)].any() and np.isfinite(distances).all()
    between = np.array([[10.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    assert next(tracer.trace([between])) == pytest.approx(0.3, rel=1e-14)
    dark = CompiledTracer(tracer.scene.in_light([]))
    assert not next(dark.trace([np.vstack([rays, DOWN])])).any()


def test_nothing_but_light_and_nothing_to_trace() -> None:
    scene = replace(table(source("gaussian", LAMP)), targets=())
    tracer = compiled_of(scene)
    seen = np.array([[*LAMP, 0.0, 0.0, 0.0]])
    axis = np.array(aim(LAMP, (0.0, 0.0, 0.0)).z_axis)
    seen[0, :3] += 0.5 * axis
    seen[0, 3:] = -axis
    ((values, distances),) = tracer.trace_with_distances([np.vstack([seen, DOWN])])
    assert values.tolist() == pytest.approx([10000.0, 0.0], rel=1e-12)
    assert distances.tolist() == [pytest.approx(0.5, rel=1e-12), math.inf]
    assert next(tracer.trace([np.empty((0, 6))])).shape == (0,)
    assert list(tracer.trace([])) == []


def test_sources_in_one_place_add_up(folders: Iterator[Path]) -> None:
    first = source("gaussian", LAMP)
    assert isinstance(first, SingleSource)
    twin = SingleSource("led", replace(first.emitter, name="twin", radiance=2500.0))
    other = SingleSource("led", Emitter("other", (-0.5, 0.0, 0.6), (0.6, 0.0, -0.8), 0.01, 800.0, Beam("cone", 0.5)))
    scene = table(first, twin, other)
    rays = np.vstack([DOWN, SEEN, BESIDE])
    with Programs() as programs:
        both = Both.of(scene, programs, next(folders))
        found = {}
        for lit in (None, ("gaussian",), ("twin",), ("other",), ("gaussian", "other")):
            radiance, compiled = (whole(tracer, rays) for tracer in both.tracers(lit))
            assert relative(compiled, radiance).max() < SAME
            found[lit] = compiled
    assert found[None] == pytest.approx(found["gaussian",] + found["twin",] + found["other",], rel=1e-13)
    assert found["twin",] == pytest.approx(found["gaussian",] / 4, rel=1e-13)
    assert (found["gaussian",] > 0).all()


def test_work_is_cut_into_pieces_and_counted() -> None:
    scene = crowd(1, materials=["bulk"], shapes=["sheet"])
    asked: list[None] = []
    spent: list[float] = []

    def cancelled() -> bool:
        asked.append(None)
        return False

    arrays = compiled_scene(scene, traced_frame(scene))
    rays = rays_at(scene, 60000, 1)
    list(CompiledTracer(arrays, cancelled, spent.append).trace([rays]))
    assert len(asked) == len(spent) >= 60000 * len(arrays.lights) / MOST_AT_ONCE > 2
    assert all(second >= 0 for second in spent) and sum(spent) > 0
    with pytest.raises(TracerError, match="cancelled"):
        list(CompiledTracer(arrays, lambda: True).trace([rays[:10]]))


@pytest.mark.long
def test_a_million_triangles() -> None:
    side = 708
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, side), np.linspace(-0.5, 0.5, side))
    vertices = np.column_stack([x.ravel(), y.ravel(), 0.05 * np.sin(20 * x.ravel()) * np.sin(17 * y.ravel())])
    corner = (np.arange(side - 1)[:, np.newaxis] * side + np.arange(side - 1)).ravel()
    halves = [(corner, corner + 1, corner + side), (corner + 1, corner + side + 1, corner + side)]
    faces = np.vstack([np.column_stack(half) for half in halves])
    mesh = mesh_of(vertices, faces.astype(np.intp))
    part = MeshPart("hills", Pose(), "bulk", "hills.obj", "0" * 64, mesh, closed=False)
    scene = Scene(camera(), (source("lambertian", LAMP),), {"bulk": MATERIALS["bulk"]}, (part,))
    tracer = compiled_of(scene)
    assert len(tracer.scene.targets.shapes) == 2 * (side - 1) ** 2 > 999_000
    random = np.random.default_rng(4)
    points = np.column_stack([random.uniform(-0.49, 0.49, (3000, 2)), np.zeros(3000)])
    eyes = random.uniform(-0.4, 0.4, (3000, 3)) + np.array([0.0, 0.0, 0.6])
    along = (points - eyes) / np.linalg.norm(points - eyes, axis=1, keepdims=True)
    expected, _ = mesh_hit(mesh, eyes, along)
    (distances,) = tracer.distances([np.hstack([eyes, along])])
    assert distances == pytest.approx(expected, rel=1e-11)
    assert np.isfinite(distances).mean() > 0.95
