"""Walks by the compiled tracer: the draws, steps and directions of numpy's walks, and of those by Radiance."""

from __future__ import annotations

import json
import math
import threading
import time
import tomllib
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("numba")

import radwrap
from radwrap.errors import TracerError
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import laid_out
from radwrap.scene.materials import Specular
from radwrap.scene.scene import Scene
from radwrap.tracers.agreement import agreement
from radwrap.tracers.bouncing import BouncingTracer, _diffuse, _draws, _shiny, keys_of, reflecting_parts
from radwrap.tracers.compiled.arrays import Floats
from radwrap.tracers.compiled.compiler import compiled_with_memory
from radwrap.tracers.compiled.engine import CompiledEngine
from radwrap.tracers.compiled.walker import WalkingTracer
from radwrap.tracers.compiled.walks import scattered
from radwrap.tracers.text_frame import traced_frame
from tests.physics.conftest import Bench

TENT = Path(__file__).parents[2] / "rad_scenes" / "white_tent" / "scene.toml"
# cos, sin and log of our own and of numpy's are apart in their last digits, which some tens of steps make more of.
LAST_DIGITS = 1e-9
ONE_STEP = 1e-13
# The command promises .5 s from the key to the end of the process; this is the tracer's part of it.
AT_ONCE_S = 0.3
SURE = 4.0  # standard errors
OF_SO_FEW_PIXELS = 0.15  # 750 of them, whose errors are not alike
FORESEEN = 0.4  # by eight walks of each pixel of a sample


@dataclass(frozen=True)
class Met:
    """A compiled tracer as numpy's walks ask it: for part numbers with their distances and normals."""

    engine: CompiledEngine

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        return self.engine.numbered().trace(rays)

    def surfaces(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats, Floats]]:
        tracer = self.engine.tracer(self.engine.scene)
        for block in rays:
            (numbers,), ((_, distances, normals),) = self.trace([block]), tracer.surfaces([block])
            yield numbers, distances, normals


def engine_of(scene: Scene) -> CompiledEngine:
    return CompiledEngine.of(scene, traced_frame(scene), bool)


def walker(scene: Scene, orders: int | None = None) -> WalkingTracer:
    engine = engine_of(scene)
    return engine.bouncing(scene, reflecting_parts(scene, engine.arrays.parts), orders)


def tent() -> Scene:
    return radwrap.load_scene(TENT)


def rays_into(scene: Scene, count: int, seed: int) -> np.ndarray:
    """From the camera to even directions about its axis."""
    random = np.random.default_rng(seed)
    axes = np.asarray(scene.camera.pose.rotation)
    local = np.column_stack([random.uniform(-0.25, 0.25, (count, 2)), np.ones(count)])
    return np.hstack([np.broadcast_to(scene.camera.pose.position, (count, 3)), local @ axes.T])


@compiled_with_memory
def scattered_all(
    material: Floats, along: Floats, normals: Floats, keys: NDArray[np.uint64], step: int
) -> tuple[Floats, Floats]:  # pragma: no cover  (compiled)
    going, weights = np.empty((len(along), 3)), np.empty(len(along))
    for r in range(len(along)):
        n, v = (normals[r, 0], normals[r, 1], normals[r, 2]), (-along[r, 0], -along[r, 1], -along[r, 2])
        d, weights[r] = scattered(material[0], material[1], material[2], n, v, keys[r], step)
        going[r, 0], going[r, 1], going[r, 2] = d
    return going, weights


@pytest.mark.parametrize("material", [Specular(0.7, 0.0, 0.1), Specular(0.0, 1.0, 0.05), Specular(0.3, 0.5, 0.2)])
def test_one_step_is_that_of_numpy(material: Specular) -> None:
    random = np.random.default_rng(7)
    normals = random.normal(size=(5000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    along = -normals + random.normal(scale=0.4, size=(5000, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    keys = keys_of(np.hstack([random.normal(size=(5000, 3)), along]))
    numbers = np.array([material.diffuse_reflectance, material.specular_reflectance, material.roughness])
    for step in (1, 5):
        draws = _draws(keys, step)
        expected, weights = _shiny(material, normals, -along, draws)
        going, found = scattered_all(numbers, along, normals, keys, step)
        goes = weights > 0
        assert ((found > 0) == goes).all() and goes.mean() > 0.8
        assert np.abs(going[goes] - expected[goes]).max() < ONE_STEP
        assert found[goes] == pytest.approx(weights[goes], rel=1e-12)
        if material.specular_reflectance == 0:
            assert np.abs(going - _diffuse(normals, draws)).max() < ONE_STEP


@pytest.mark.parametrize("orders", [None, *(pytest.param(orders, marks=pytest.mark.long) for orders in (1, 4))])
def test_the_same_walk_as_numpys_over_the_same_hits(orders: int | None) -> None:
    scene = tent()
    engine, rays = engine_of(scene), rays_into(scene, 2000, 1)
    materials = reflecting_parts(scene, engine.arrays.parts)
    lit: Any = engine.tracer(scene)
    met: Any = Met(engine)
    (expected,) = BouncingTracer(lit, met, materials, orders).trace([rays])
    ((found, distances),) = engine.bouncing(scene, materials, orders).trace_with_distances([rays])
    assert (expected > 0).mean() > 0.4
    apart = np.abs(found - expected) / np.maximum(expected, 1e-3 * expected.mean())
    assert np.sort(apart)[-3] < LAST_DIGITS  # two whose last digits decide of an edge
    assert (distances == next(lit.distances([rays]))).all()


def test_without_steps_there_is_direct_light_only() -> None:
    scene = tent()
    rays = rays_into(scene, 500, 2)
    up = rays * [1, 1, 1, 1, 1, -1]  # to the lit ceiling
    (direct,), (walked,) = engine_of(scene).tracer(scene).trace([up]), walker(scene, 0).trace([up])
    assert direct.any() and (direct == walked).all()


def test_the_same_walk_as_by_radiance() -> None:
    scene = tent()
    rays = rays_into(scene, 1500, 3)
    with laid_out(scene, RenderOptions(tracer="radiance")) as traced:
        reference = traced.bouncing_view(None).tracer
        found = agreement(reference, walker(scene), rays, places=9)  # so many places on average
    assert found.agree and found.differing < 0.01 * len(rays)
    assert found.rms_relative_difference < 1e-5


@pytest.mark.parametrize("size", [700, *(pytest.param(size, marks=pytest.mark.long) for size in (1, 2999))])
def test_blocks_and_threads_change_nothing(size: int) -> None:
    scene = tent()
    tracer, rays = walker(scene), rays_into(scene, 3000, 4)
    (expected,) = tracer.trace([rays])
    blocks = [rays[start : start + size] for start in range(0, 3000, size)]
    with ThreadPoolExecutor(3) as pool:
        found = np.concatenate(list(pool.map(lambda block: next(tracer.trace([block])), blocks)))
    assert found.tobytes() == expected.tobytes()


def ball(reflectance: float, lamps: list[dict[str, Any]]) -> Scene:
    """A hollow ball of 1 m radius; the camera, which plays no part, is outside."""
    wall = {"type": "sphere", "name": "ball", "material": "white", "diameter": "2 m"}
    white = {"type": "lambertian", "reflectance": reflectance}
    return Bench.scene(Bench.camera((0, 0, 3)), lamps, {"white": white}, [wall])


@pytest.mark.parametrize(
    ("engine", "reflectance", "orders", "share"),
    [
        ("compiled", 0.5, 2, 1.5),
        ("compiled", 0.9, None, 10.0),
        pytest.param("compiled", 0.5, 1, 1.0, marks=pytest.mark.long),
        # Radiance's walks are the same, see above.
        *(
            pytest.param("radiance", *one, marks=pytest.mark.long)
            for one in ((0.5, 1, 1.0), (0.5, 2, 1.5), (0.9, None, 10.0))
        ),
    ],
)
def test_an_integrating_sphere(engine: Any, reflectance: float, orders: int | None, share: float) -> None:
    """What is reflected is even, wherever the lamp shines: rho Phi/(4 pi R^2), and rho of that from each more order."""
    lamp = Bench.lamp((0.3, 0.1, 0.2), (1.0, 0.4, 0.3), half_angle=30.0)
    scene = ball(reflectance, [lamp])
    count = 16_000
    random = np.random.default_rng(5)
    toward = random.normal(size=(count, 3))
    rays = np.hstack([np.broadcast_to([-0.2, 0.0, 0.1], (count, 3)), toward])
    with laid_out(scene, RenderOptions(tracer=engine)) as traced:
        (whole,) = traced.bouncing_view(orders).tracer.trace([rays])
        (direct,) = traced.view().tracer.trace([rays])
    indirect = (whole - direct) * math.pi / reflectance
    flux = 2 * math.pi * (1 - math.cos(math.radians(30.0)))  # of 1 W/sr
    expected = share * reflectance * flux / (4 * math.pi)
    noise = indirect.std() / math.sqrt(count)
    assert noise < 0.05 * expected
    assert abs(indirect.mean() - expected) < SURE * noise + 1e-3 * expected


def under_a_baffle() -> Scene:
    """The tent in the light of an area under a sheet that hides half of it from each place of the ceiling."""
    document = tomllib.loads(TENT.read_text())
    document["sources"] = [
        {
            "type": "rectangle",
            "name": "area",
            "position": ["-120 mm", "0 mm", "100 mm"],
            "look_at": ["-120 mm", "0 mm", "500 mm"],
            "size": ["120 mm", "120 mm"],
            "radiance": "3000 W/m^2/sr",
        }
    ]
    sheet = {"type": "sheet", "name": "baffle", "material": "painted", "size": ["80 mm", "120 mm"]}
    document["targets"].append({**sheet, "position": ["-120 mm", "0 mm", "160 mm"]})
    return radwrap.scene_from_document(document)


@pytest.mark.long
@pytest.mark.parametrize("scene", [tent, under_a_baffle])
def test_the_certificate_holds_the_noise_of_walks(scene: Callable[[], Scene]) -> None:
    """Two images of other rays differ by it; a plan keeps the tolerance with hardly more rays than it needs."""
    asked = 12.0
    changes: dict[str, Any] = {"camera.sensor.rows": 25, "camera.sensor.columns": 30, "camera.sensor.rounding": False}
    changes |= {f"camera.sensor.pixel_{side}": "120 um" for side in ("width", "height")}
    # So much noise beside an edge looks like light that is not even, which waves are bounded by.
    changes["camera.diffraction"] = "off"
    found = radwrap.scene_from_document(json.loads(scene().document), changes)
    images = [radwrap.render(found, bounces="all", tolerance=asked, tracer="compiled", seed=seed) for seed in (0, 1)]
    first, second = (image.gray.values for image in images)
    got = math.sqrt(((first - second) ** 2).mean() / 2)
    told = math.sqrt(sum(image.run.error.rms_gray**2 for image in images) / 2)
    assert got == pytest.approx(told, rel=OF_SO_FEW_PIXELS)
    for image in images:
        error = image.run.error
        assert 0.4 * asked < error.rms_gray_upper95 <= asked
        assert image.run.plan is not None and len(image.run.plan.attempts) <= 3
        assert image.run.plan.attempts[0].rays == pytest.approx(image.run.plan.expected_rays["rays"], rel=FORESEEN)
    assert bool(images[0].manifest["tracer"].get("whole")) == (scene is under_a_baffle)
    assert first.mean() > 3 * asked


def test_a_cancelled_walk_ends_at_once() -> None:
    lamp = Bench.lamp((0.3, 0.1, 0.2), (1.0, 0.4, 0.3))
    scene = ball(0.999, [lamp])
    ended = threading.Event()
    engine = CompiledEngine.of(scene, traced_frame(scene), ended.is_set)
    tracer = engine.bouncing(scene, reflecting_parts(scene, engine.arrays.parts), 1000)
    rays = np.random.default_rng(6).normal(scale=0.1, size=(1 << 17, 6))
    next(tracer.trace([rays[:1]]))  # compiled
    said: list[float] = []

    def say() -> None:
        said.append(time.monotonic())
        ended.set()

    timer = threading.Timer(0.2, say)
    timer.start()
    with pytest.raises(TracerError, match="cancelled"):
        next(tracer.trace([rays]))
    assert time.monotonic() - said[0] < AT_ONCE_S


def test_a_ray_without_a_direction_is_refused() -> None:
    with pytest.raises(ValueError, match="has no direction"):
        next(walker(tent()).trace([np.zeros((1, 6))]))
