"""The compiled tracer against Radiance along the same rays: every material on every shape in every beam."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.process import Programs
from radwrap.scene.mesh import mesh_of
from radwrap.scene.targets import MeshPart
from radwrap.tracers.agreement import SAME
from radwrap.tracers.compiled.tracer import CompiledTracer
from tests.tracers.by_numpy import radiance_by_numpy
from tests.tracers.crowd import MATERIALS, SOURCES, Both, crowd, rays_at, relative, turned, whole

# Rays that meet a rim, or the rim of a shadow, may pass it on either side.
BY_CHANCE = 1e-4
# Radiance's points on surfaces are off by some 1e-8 mm, on meshes by 1e-6 mm, so some there lose the light of a source
# to their own surface. So many of all rays at most, each by an independent opinion.
SELF_SHADOWED = 2e-3
# The third opinion takes angles from their cosines.
OPINION = 1e-3
# Radiance answers in float32, and places of its frozen octree have 31 bits.
DISTANCE = 1e-6


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Both]:
    with Programs() as programs:
        yield Both.of(crowd(1), programs, tmp_path_factory.mktemp("crowd"))


def judged(both: Both, rays: np.ndarray, radiance: np.ndarray, compiled: np.ndarray) -> tuple[float, int, int]:
    """Largest difference of rays that agree, how many Radiance has wrong, how many are open."""
    apart = relative(compiled, radiance)
    other = np.flatnonzero(apart > SAME)
    opinion = radiance_by_numpy(both.scene, rays[other])
    ours = np.abs(compiled[other] - opinion) <= OPINION * np.abs(radiance[other] - opinion) + SAME * opinion
    return float(np.delete(apart, other).max()), int(ours.sum()), int((~ours).sum())


def test_same_radiance(both: Both) -> None:
    rays = rays_at(both.scene, 1200, 1)
    radiance, compiled = (whole(tracer, rays) for tracer in both.tracers())
    largest, wrong, still_open = judged(both, rays, radiance, compiled)
    assert (radiance > 0).mean() > 0.8
    assert largest < SAME
    assert wrong <= 5 and still_open == 0


@pytest.mark.parametrize("name", SOURCES)
def test_same_radiance_of_each_source_alone(name: str, both: Both) -> None:
    """The others are switched off, and hide all the same."""
    rays = rays_at(both.scene, 500, 2)
    tracers = both.tracers([name])
    radiance, compiled = (whole(tracer, rays) for tracer in tracers)
    assert (radiance > 0).mean() > 0.03
    apart = relative(compiled, radiance)
    assert np.sort(apart)[-3] < SAME  # two for rims and shadows


def test_same_parts_and_distances(both: Both) -> None:
    rays = rays_at(both.scene, 3000, 3)
    _, tracer = both.tracers()
    numbered = both.radiance.numbered()
    assert tracer.scene.parts == both.radiance.prepared.parts
    answers = zip(*numbered.trace_with_distances([rays]), strict=True)
    expected, distances = (np.concatenate(answer) for answer in answers)
    (parts,), (found,) = tracer.parts([rays]), tracer.distances([rays])
    assert (parts != np.rint(expected)).sum() <= 1
    assert (parts == 0).mean() > 0.02 and len(np.unique(parts)) > len(MATERIALS) * 8
    assert (np.isfinite(found) == np.isfinite(distances)).all()
    met = np.isfinite(found)
    assert np.abs(found[met] / distances[met] - 1).max() < DISTANCE
    ((_, again, normals),) = tracer.surfaces([rays])
    assert (again == found).all()
    assert np.abs(np.linalg.norm(normals[met], axis=1) - 1).max() < 1e-12 and not normals[~met].any()


def test_sources_one_by_one_add_up(both: Both) -> None:
    rays = rays_at(both.scene, 2000, 4)
    tracer = both.compiled
    (together,) = tracer.trace([rays])
    number = {name: k for k, name in enumerate(SOURCES)}
    column = np.array([number[group[0][0]] for group in tracer.scene.members])
    ((each, _),) = tracer.trace_by_source([rays], column, int(column.max()) + 1)
    assert each.shape == (2000, len(SOURCES) + 1)
    assert each.sum(axis=1) == pytest.approx(together, rel=1e-12, abs=0)
    for name in ("gaussian", "surround"):
        (alone,) = CompiledTracer(tracer.scene.in_light([name])).trace([rays])
        with_sky = each[:, number[name]] + (each[:, -1] if name == "surround" else 0.0)
        assert (with_sky == alone).all()


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_same_radiance_of_many_rays(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    with Programs() as programs:
        both = Both.of(crowd(seed), programs, tmp_path_factory.mktemp("crowd"))
        rays = rays_at(both.scene, 20000, 10 + seed)
        radiance, compiled = (whole(tracer, rays) for tracer in both.tracers())
        largest, wrong, still_open = judged(both, rays, radiance, compiled)
        print(
            f"seed {seed}: largest difference {largest:.2g}, Radiance wrong {wrong}, open {still_open} of {len(rays)}"
        )
        assert largest < SAME
        assert wrong < SELF_SHADOWED * len(rays)
        assert still_open <= BY_CHANCE * len(rays)
        for name in SOURCES:
            radiance, compiled = (whole(tracer, rays[:4000]) for tracer in both.tracers([name]))
            apart = np.sort(relative(compiled, radiance))
            print(f"  {name}: all but 10 of 4000 within {apart[-11]:.2g}")
            assert apart[-11] < SAME


@pytest.mark.long
def test_same_radiance_of_a_fine_mesh(tmp_path: Path) -> None:
    """Where Radiance hides points of a mesh behind their own triangles, by closed forms."""
    side = 80
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, side), np.linspace(-0.2, 0.2, side))
    vertices = np.column_stack([x.ravel(), y.ravel(), 0.02 * np.sin(40 * x.ravel()) * np.sin(30 * y.ravel())])
    corner = (np.arange(side - 1)[:, np.newaxis] * side + np.arange(side - 1)).ravel()
    halves = [(corner, corner + 1, corner + side), (corner + 1, corner + side + 1, corner + side)]
    mesh = mesh_of(vertices, np.vstack([np.column_stack(half) for half in halves]).astype(np.intp))
    hills = MeshPart("hills", turned(np.random.default_rng(2), 0.1), "satin", "hills.obj", "0" * 64, mesh, closed=False)
    scene = replace(crowd(6, materials=["satin"], shapes=["mesh", "sheet"]), targets=(hills,))
    with Programs() as programs:
        both = Both.of(scene, programs, tmp_path / "hills")
        rays = rays_at(scene, 20000, 1)
        radiance, compiled = (whole(tracer, rays) for tracer in both.tracers())
        largest, wrong, still_open = judged(both, rays, radiance, compiled)
    print(f"fine mesh: largest difference {largest:.2g}, Radiance wrong {wrong}, open {still_open} of {len(rays)}")
    assert largest < SAME
    assert wrong < SELF_SHADOWED * len(rays) and still_open <= BY_CHANCE * len(rays)
