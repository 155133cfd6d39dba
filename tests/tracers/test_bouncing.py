"""Light from surface to surface: closed spaces of known sum, single orders, Ward's albedo, and what is refused.

What walks find is asked of both tracers.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.forecast.effects import bounces, bounces_beyond, effects
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import laid_out
from radwrap.scene.materials import Specular
from radwrap.tracers.bouncing import _draws, _shiny, keys_of
from radwrap.validate.bounces import _DIRECT, _cube
from tests.physics.conftest import Bench

# Walks are drawn from fixed rays; bounds are four standard errors of what was measured: a false alarm in 1.6e4.
SURE = 4.0
PROBED = 0.1  # 256 pixels of 16 walks
TURNED_OTHERWISE = 0.02


@pytest.fixture(params=[pytest.param("radiance", marks=pytest.mark.long), "compiled"])
def how(request: pytest.FixtureRequest) -> RenderOptions:
    """By whom walks are traced: that they are the same ones test_compiled_walks sees."""
    if request.param == "compiled":
        pytest.importorskip("numba")
    return RenderOptions(tracer=request.param)


def rays_up(count: int) -> np.ndarray:
    """From the middle of the cube to points of its upper face, evenly spread."""
    random = np.random.default_rng(1)
    points = np.column_stack([random.uniform(-2, 2, (count, 2)), np.full(count, 2.0)])
    eye = np.array([0.0, 0.0, 0.01])
    return np.hstack([np.broadcast_to(eye, points.shape), points - eye])


def walked(reflectance: float, orders: int | None, how: RenderOptions, count: int = 4000) -> np.ndarray:
    with laid_out(_cube(reflectance, 1.0), how) as traced:
        view, rays = traced.bouncing_view(orders), rays_up(count)
        (whole,) = view.tracer.trace([rays])
        (direct,) = traced.view().tracer.trace([rays])
    return (whole - direct) * math.pi / reflectance


@pytest.mark.parametrize(("orders", "share"), [(1, 0.5), (2, 0.75), (None, 1.0)])
def test_each_reflection_in_a_closed_cube_brings_rho_of_the_last(
    orders: int | None, share: float, how: RenderOptions
) -> None:
    found = walked(0.5, orders, how)
    assert abs(found.mean() - share * _DIRECT) < SURE * found.std() / math.sqrt(len(found))
    assert found.std() / math.sqrt(len(found)) < 0.02 * _DIRECT  # the bound above says something


@pytest.mark.parametrize(("reflectance", "orders"), [(0.5, 1), (0.9, 3)])
def test_what_a_limit_leaves_out_is_told(reflectance: float, orders: int, how: RenderOptions) -> None:
    """Of the direct light rho^(n + 1)/(1 - rho); over the pixels of a face it goes as cos^4."""
    middles = (np.arange(320) + 0.5) / 80 - 2
    x, y = np.meshgrid(middles, middles)
    cos4 = 1 / (1 + (x**2 + y**2) / 1.99**2) ** 2
    expected = 1000 * reflectance ** (orders + 1) / (1 - reflectance) * math.sqrt((cos4**2).mean())
    with laid_out(_cube(reflectance, _DIRECT), how) as traced:
        found = bounces_beyond(traced, orders, 0, 0.5)
    assert found.needed and found.name == f"bounces_beyond_{orders}"
    assert found.rms_gray == pytest.approx(expected, rel=PROBED)
    assert found.rms_gray_upper95 > 0.97 * expected  # indirect light is a little uneven, which cos^4 does not know


def test_the_manifest_and_explain_tell_what_a_limit_leaves_out(how: RenderOptions) -> None:
    scene = _cube(0.5, _DIRECT)
    told = radwrap.render(scene, options=how, tolerance=100.0, bounces=1).manifest
    assert told["left_out"]["bounces_beyond_1"]["rms_gray"] == pytest.approx(243, rel=PROBED)
    assert any("reflected more than 1 times on its way is left out" in line for line in told["warnings"])
    found = {one["name"]: one for one in effects(scene, how)["effects"]}
    # One share of eight of all bounces is beyond the third.
    ratio = found["bounces_beyond_3"]["rms_gray"] / found["bounces"]["rms_gray"]
    assert ratio == pytest.approx(1 / 7, rel=2 * PROBED)


def test_a_ray_has_its_own_draws_in_any_order_and_block(how: RenderOptions) -> None:
    with laid_out(_cube(0.5, 1.0), how) as traced:
        tracer, rays = traced.bouncing_view(None).tracer, rays_up(300)
        (whole,) = tracer.trace([rays])
        pieces = np.concatenate(list(tracer.trace([rays[:7], rays[7:200], rays[200:]])))
        backwards = np.concatenate(list(tracer.trace([rays[::-1]])))
    assert (whole == pieces).all() and (whole == backwards[::-1]).all()


def test_draws_are_even_and_independent() -> None:
    draws = _draws(keys_of(rays_up(20_000)), 3)
    assert draws.min() >= 0 and draws.max() < 1
    assert np.abs(draws.mean(axis=0) - 0.5).max() < SURE / math.sqrt(12 * len(draws))
    between = np.corrcoef(np.hstack([draws, _draws(keys_of(rays_up(20_000)), 4)]).T) - np.eye(8)
    assert np.abs(between).max() < SURE / math.sqrt(len(draws))


@pytest.mark.parametrize(("view", "albedo"), [(0.0, 0.99), (60.0, 0.97396), (80.0, 0.86742)])
def test_a_shiny_surface_reflects_wards_albedo(view: float, albedo: float) -> None:
    """The lobe's integral by quadrature on 1e6 directions; roughness 0.1."""
    count = 40_000
    tilt = math.radians(view)
    seen = np.broadcast_to([math.sin(tilt), 0.0, math.cos(tilt)], (count, 3))
    normal = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
    draws = np.random.default_rng(2).random((count, 4))
    direction, weight = _shiny(Specular(0.0, 1.0, 0.1), normal, seen, draws)
    assert np.allclose(np.linalg.norm(direction, axis=1), 1.0)
    assert abs(weight.mean() - albedo) < SURE * weight.std() / math.sqrt(count) + 1e-5
    whole = _shiny(Specular(0.3, 0.5, 0.1), normal, seen, draws)[1].mean()
    assert whole == pytest.approx(0.3 + 0.5 * albedo, abs=0.01)


def floor_and_wall(material: dict[str, Any], turn: float = 90.0) -> radwrap.Scene:
    """A lit white wall lights a floor that is seen from above; its own lamp shines past the floor."""
    wall = {"type": "sheet", "name": "wall", "material": "white", "size": Bench.metres(1, 1)}
    wall |= {"position": Bench.metres(-0.5, 0, 0.5), "rotation": Bench.degrees(0, turn, 0)}
    floor = {"type": "sheet", "name": "floor", "material": "it", "size": Bench.metres(1, 1)}
    lamp = Bench.lamp((1.5, 0, 0.5), (-0.5, 0, 0.5), half_angle=10.0)
    view = Bench.camera((0, 0, 1), rows=8, columns=8, pitch=(1e-4, 1e-4))
    view["sensor"] |= {"gain": "2e7 (J/m^2)^-1"}
    white = {"type": "lambertian", "reflectance": 0.8}
    return Bench.scene(view, [lamp], {"white": white, "it": material}, [wall, floor])


def test_the_back_of_a_sheet_reflects_as_its_front(how: RenderOptions) -> None:
    gray = {"type": "lambertian", "reflectance": 0.4}
    points = np.column_stack([np.linspace(-0.4, 0.4, 200), np.linspace(0.3, -0.3, 200), np.zeros(200)])
    rays = np.hstack([np.broadcast_to([0.0, 0.0, 1.0], (200, 3)), points - [0.0, 0.0, 1.0]])
    sides = []
    for turn in (90.0, -90.0):
        with laid_out(floor_and_wall(gray, turn), how) as traced:
            sides.append([next(traced.bouncing_view(orders).tracer.trace([rays])) for orders in (1, None)])
    once, whole = zip(*sides, strict=True)
    assert once[0].max() > 0
    assert once[0] == pytest.approx(once[1], rel=1e-5, abs=1e-9)
    # The last digit of a turned normal may decide about which axes the next draws are turned.
    assert (np.abs(whole[0] - whole[1]) > 1e-5 * whole[1] + 1e-9).sum() <= TURNED_OTHERWISE * len(rays)


SHEETING = {"type": "retroreflective", "model": "coefficient", "function": "glass_beads", "anchor": "95 cd/lx/m^2"}


def test_sheeting_in_indirect_light_is_refused_by_name() -> None:
    scene = floor_and_wall(SHEETING | {"outside": "hold"})
    with pytest.raises(InputError, match=r"materials\.it: retroreflective data end"):
        radwrap.render(scene, bounces="all", tolerance=1.0)


@pytest.mark.parametrize("options", [{"method": "kernel"}, {"viewpoints": 7}, {"method": "pinhole"}, {"basis": True}])
def test_methods_without_walks_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="bounces"):
        RenderOptions(bounces="all", **options)


@pytest.mark.parametrize("bounces", [-1, 1001, "many"])
def test_numbers_that_are_none_are_refused(bounces: Any) -> None:
    with pytest.raises(InputError, match="bounces: "):
        RenderOptions(bounces=bounces)


def test_auto_includes_what_matters_and_nothing_else(tmp_path: Path, how: RenderOptions) -> None:
    gray = {"type": "lambertian", "reflectance": 0.4}
    scene = floor_and_wall(gray)
    done = radwrap.render(scene, tmp_path / "wall", how, bounces="auto", tolerance=1.0)
    assert done.manifest["bounces"]["orders"] == "all" and set(done.manifest["left_out"]) <= {"diffraction"}
    assert done.manifest["error"]["rms_gray_upper95"] <= 1.0
    # Without the wall's light the floor is dark: the wall's lamp shines along it.
    assert done.gray.values.mean() > 10 * radwrap.render(scene, options=how, tolerance=1.0).gray.values.mean()
    alone = Bench.scene(
        Bench.camera((0, 0, 1), rows=4, columns=4),
        [Bench.lamp((0.2, 0, 1))],
        {"it": gray},
        [{"type": "sheet", "material": "it", "size": Bench.metres(1, 1)}],
    )
    for name, options in (("auto", {"bounces": "auto"}), ("none", {})):
        radwrap.render(alone, tmp_path / name, how, tolerance=1.0, **options)
    for file in ("gray.png", "radiant_exposure.exr"):
        assert (tmp_path / "auto" / file).read_bytes() == (tmp_path / "none" / file).read_bytes()


def test_auto_refuses_sheeting_only_where_bounces_matter(tmp_path: Path) -> None:
    """It was refused before that was known."""
    bench = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"
    scene = radwrap.load_scene(bench, {"camera.sensor.scale": "1/8", "camera.diffraction": "off"})
    for name, options in (("auto", {"bounces": "auto"}), ("none", {})):
        radwrap.render(scene, tmp_path / name, tolerance=4.0, **options)
    for file in ("gray.png", "radiant_exposure.exr"):
        assert (tmp_path / "auto" / file).read_bytes() == (tmp_path / "none" / file).read_bytes()
    with pytest.raises(InputError, match="retroreflective"):
        radwrap.render(scene, tolerance=4.0, bounces="all")


def test_light_of_the_wall_on_the_floor_by_quadrature(how: RenderOptions) -> None:
    """One reflection: E at a floor point is the integral of the wall's radiance over its area."""
    scene = floor_and_wall({"type": "lambertian", "reflectance": 0.5})
    point = np.array([0.1, 0.05, 0.0])

    middles = (np.arange(1000) + 0.5) / 1000
    y, z = np.meshgrid(middles - 0.5, middles)
    lamp = np.stack([np.full_like(y, 2.0), -y, 0.5 - z])
    distance = np.sqrt((lamp**2).sum(axis=0))
    radiance = np.where(lamp[0] > distance * math.cos(math.radians(10)), 0.8 / math.pi * lamp[0] / distance**3, 0.0)
    way = np.stack([np.full_like(y, -0.6), y - point[1], z])
    irradiance = (radiance * way[2] * 0.6 / (way**2).sum(axis=0) ** 2).mean()
    count = 20_000
    random = np.random.default_rng(3)
    eyes = np.array([0, 0, 1.0]) + random.normal(0, 1e-3, (count, 3))
    with laid_out(scene, how) as traced:
        (seen,) = traced.bouncing_view(1).tracer.trace([np.hstack([eyes, point - eyes])])
        (direct,) = traced.view().tracer.trace([np.hstack([eyes, point - eyes])])
    found = (seen - direct) * math.pi / 0.5
    assert abs(found.mean() - irradiance) < SURE * found.std() / math.sqrt(count) + 1e-3 * irradiance
    assert found.std() / math.sqrt(count) < 0.03 * irradiance


@pytest.mark.long
def test_a_wide_source_lights_a_ceiling_that_lights_the_floor(how: RenderOptions) -> None:
    """A square of 0.4 m shines upwards: E on the ceiling and from it on the floor by quadrature, less what it hides."""
    wide = {"type": "rectangle", "name": "wide", "size": Bench.metres(0.4, 0.4), "radiance": "10 W/m^2/sr"}
    wide |= {"position": Bench.metres(0, 0, 0.2), "look_at": Bench.metres(0, 0, 1)}
    sheet = {"type": "sheet", "material": "floor", "name": "floor", "size": Bench.metres(1.4, 1.4)}
    ceiling = {**sheet, "name": "ceiling", "material": "ceiling", "size": Bench.metres(3, 3)}
    ceiling |= {"position": Bench.metres(0, 0, 1), "rotation": Bench.degrees(180, 0, 0)}
    materials = {name: {"type": "lambertian", "reflectance": rho} for name, rho in (("floor", 0.5), ("ceiling", 0.8))}
    scene_camera = Bench.camera((0.5, 0, 0.6), (0.5, 0, 0), rows=16, columns=16, pitch=(5e-5, 5e-5))
    scene_camera["sensor"]["gain"] = "1e9 (J/m^2)^-1"
    scene = Bench.scene(scene_camera, [wide], materials, [sheet, ceiling])
    assert len(scene.emitters) > 9
    point = np.array([0.5, 0.1, 0.0])

    nodes, weights = np.polynomial.legendre.leggauss(12)
    u, v = np.meshgrid(0.2 * nodes, 0.2 * nodes)
    middles = ((np.arange(400) + 0.5) / 400 - 0.5) * 3
    x, y = np.meshgrid(middles, middles)
    onto = np.zeros_like(x)
    for du, dv, share in zip(u.flat, v.flat, (np.outer(weights, weights) * 0.04).flat, strict=True):
        onto += 10 * share * 0.8**2 / ((x - du) ** 2 + (y - dv) ** 2 + 0.8**2) ** 2
    through = np.maximum(np.abs(point[0] + 0.2 * (x - point[0])), np.abs(point[1] + 0.2 * (y - point[1])))
    seen = np.where(through > 0.2, 0.8 / math.pi * onto, 0.0)
    irradiance = (seen / ((x - point[0]) ** 2 + (y - point[1]) ** 2 + 1) ** 2).mean() * 9
    count = 30_000
    eyes = np.array([0.5, 0, 0.6]) + np.random.default_rng(4).normal(0, 1e-3, (count, 3))
    rays = np.hstack([eyes, point - eyes])
    with laid_out(scene, how) as traced:
        assert bool(traced.whole) == (how.tracer == "compiled")
        (whole,) = traced.bouncing_view(1).tracer.trace([rays])
        (direct,) = traced.view().tracer.trace([rays])
        finer = Bench.scene(scene_camera, [{**wide, "least_patches": 120}], materials, [sheet, ceiling])
    with laid_out(finer, how) as traced:
        view = traced.view()
        by_tracer = bounces(finer, traced.radiance_view(), 0, 0.5)
        by_walks = bounces(finer, view, 0, 0.5, traced=traced)
    assert by_walks.rms_gray == pytest.approx(by_tracer.rms_gray, rel=PROBED)
    assert not direct.any()  # it shines away from the floor
    found = whole * math.pi / 0.5
    noise = found.std() / math.sqrt(count)
    assert noise < 0.01 * irradiance
    # Patches are asked for 1 % where the camera sees, and do better.
    assert abs(found.mean() - irradiance) < SURE * noise + 0.005 * irradiance
