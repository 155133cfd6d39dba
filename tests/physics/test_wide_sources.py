"""Irradiance by wide sources, traced: closed forms on the axis, quadrature beside it."""

import math
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.scene.sources import WideSource
from radwrap.validate.closed_forms.sources import (
    disc_irradiance,
    disc_irradiance_beside,
    point_irradiance,
    rectangle_factor,
)

FLOAT32 = 1e-6  # the tracer's own digits
ASKED = 0.01
ENDS_OF_RAYS = 2e-4  # where the sheet is hit, beside the place that was meant


def wide(bench: Any, kind: str, height: float, **shape: Any) -> dict[str, Any]:
    place = {} if kind == "surround" else {"position": bench.metres(0, 0, height), "look_at": bench.metres(0, 0, -1)}
    return {"type": kind, "name": "wide", "radiance": "1 W/m^2/sr", "irradiance_error": ASKED, **place, **shape}


def lit(bench: Any, source: dict[str, Any], size: float = 0.2) -> radwrap.Scene:
    sheet = {"type": "sheet", "material": "gray", "size": bench.metres(size, size)}
    camera = bench.camera(position=(0, 0, 3), rows=16, columns=16, pitch=(1e-4, 1e-4))
    return bench.scene(camera, [source], {"gray": {"type": "lambertian", "reflectance": 0.5}}, [sheet])


@pytest.mark.parametrize("ratio", [0.1, 2.0])
def test_a_disc_on_its_axis(bench: Any, ratio: float) -> None:
    height = 0.05 / ratio
    scene = lit(bench, wide(bench, "disc", height, diameter="100 mm"))
    got = float(bench.radiance(scene, (0, 0, height / 2), [(0, 0, 0)])[0]) * math.pi / 0.5
    assert got == pytest.approx(disc_irradiance(1.0, 0.05, height), rel=ASKED)


def test_a_square_at_its_own_size(bench: Any) -> None:
    scene = lit(bench, wide(bench, "rectangle", 0.1, size=["100 mm", "100 mm"]))
    got = float(bench.irradiance(scene, [(0, 0, 0)], 0.5)[0])
    half = (-0.05, 0.05)
    assert got == pytest.approx(math.pi * rectangle_factor(half, half, 0.1), rel=ASKED)


def test_what_was_told_is_what_is_traced(bench: Any) -> None:
    """The sum of the patches is the tracer's, digit by digit: nothing else comes in."""
    scene = lit(bench, wide(bench, "area_ring", 0.04, diameter="100 mm", inner_diameter="60 mm"))
    point = np.array([0.013, -0.021, 0.0])
    total = 0.0
    for patch in scene.emitters:
        away = np.asarray(patch.position) - point
        square = float(away @ away)
        total += patch.radiance * math.pi * patch.radius**2 * away[2] ** 2 / square**2
    # From below the ring: its patches hide nothing of one another.
    eye = (0.013, -0.021, 0.02)
    got = float(bench.radiance(scene, eye, [point])[0]) * math.pi / 0.5
    assert got == pytest.approx(total, rel=FLOAT32 * 10)
    expected = disc_irradiance_beside(1.0, 0.05, 0.04, (point[0], point[1]), inner_radius=0.03)
    assert got == pytest.approx(expected, rel=ASKED)


def test_a_dome_at_its_centre(bench: Any) -> None:
    """The hole takes pi L sin^2 of its half angle."""
    scene = lit(bench, wide(bench, "dome", 0.0, diameter="1 m", opening_diameter="500 mm"), size=0.05)
    got = float(bench.irradiance(scene, [(0, 0, 0)], 0.5)[0])
    assert got == pytest.approx(math.pi * (1 - 0.25), rel=ASKED)


@pytest.mark.parametrize("bench", ["compiled", pytest.param("radiance", marks=pytest.mark.long)], indirect=True)
def test_a_surround_gives_pi_everywhere_and_is_seen_itself(bench: Any) -> None:
    ball = {"type": "sphere", "material": "gray", "diameter": "100 mm"}
    scene = bench.scene(
        bench.camera(rows=16, columns=16, pitch=(1e-4, 1e-4)),
        [wide(bench, "surround", 0.0)],
        {"gray": {"type": "lambertian", "reflectance": 0.5}},
        [ball],
    )
    (sky,) = scene.sources
    assert isinstance(sky, WideSource) and sky.reached <= ASKED
    random = np.random.default_rng(1)
    outwards = random.normal(size=(200, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    outwards[:, 2] = np.abs(outwards[:, 2])  # what the camera sees, for which the error was asked
    got = bench.radiance(scene, outwards * 0.2, outwards * 0.05) * math.pi / 0.5
    assert np.abs(got / math.pi - 1).max() < ASKED
    around = random.normal(size=(20000, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    background = bench.radiance(scene, around * 0.2, around * 0.3)
    assert np.abs(background - 1).max() < FLOAT32


def test_coaxial_light_goes_through_its_splitter_twice(bench: Any) -> None:
    """Reflected once, transmitted once; a lamp beside the camera is seen through the splitter too."""
    sheet = {"type": "sheet", "material": "gray", "size": ["20 mm", "20 mm"]}
    splitter = {"distance": "200 mm", "splitter_reflectance": 0.4, "splitter_transmittance": 0.5}
    coaxial = {"type": "coaxial", "name": "coax", "radiance": "10 W/m^2/sr", "diameter": "40 mm", **splitter}
    lamp = bench.lamp((0.3, 0, 0.4))
    materials = {"gray": {"type": "lambertian", "reflectance": 0.5}}
    camera = bench.camera(position=(0, 0, 0.3), rows=8, columns=8, pitch=(5e-5, 5e-5))
    disc = 0.4 * 0.5 * disc_irradiance(10, 0.02, 0.5)
    beside = 0.5 * point_irradiance(1.0, 0.4, 0.3)
    for sources, expected in (([coaxial], disc), ([coaxial, lamp], disc + beside), ([lamp], beside / 0.5)):
        got = float(bench.irradiance(bench.scene(camera, sources, materials, [sheet]), [(0, 0, 0)], 0.5)[0])
        assert got == pytest.approx(expected, rel=ASKED)
    for wrong, told in (
        ({**coaxial, "splitter_reflectance": 0.7}, "must not exceed 1"),
        ({**coaxial, "splitter_transmittance": 0.0}, "shows nothing"),
    ):
        with pytest.raises(radwrap.InputError, match=told):
            bench.scene(camera, [wrong], materials, [sheet])
    with pytest.raises(radwrap.InputError, match="second beam splitter"):
        bench.scene(camera, [coaxial, {**coaxial, "name": "b"}], materials, [sheet])


def test_the_papers_halide_lamps(bench: Any) -> None:
    """I/d^2 in the beam's axis; the preset's level is told as an assumption."""
    lamp = {"type": "lamp", "preset": "metal_halide_400w", "look_at": bench.metres(0, 0, 0)}
    places = [(0.06, 0.06, 0.82), (-0.06, 0.06, 0.82)]
    sources = [{**lamp, "name": f"lamp{k}", "position": bench.metres(*place)} for k, place in enumerate(places)]
    sheet = {"type": "sheet", "material": "gray", "size": ["200 mm", "200 mm"]}
    scene = bench.scene(bench.camera(), sources, {"gray": {"type": "lambertian", "reflectance": 0.5}}, [sheet])
    got = float(bench.irradiance(scene, [(0, 0, 0)], 0.5)[0])
    assert got == pytest.approx(2 * point_irradiance(11.14, 0.82, math.hypot(0.06, 0.06)), rel=2e-4)  # (10 mm/0.82 m)^2
    assert "assumptions" in scene.assumed["sources[0].preset"]
    with pytest.raises(radwrap.InputError, match='no lamp "sun"; known: metal_halide_400w'):
        bench.scene(bench.camera(), [{**sources[0], "preset": "sun"}], {}, [sheet])


def test_no_hot_spots_right_below_a_near_bar(bench: Any) -> None:
    """100 x 2 mm at 5 mm: what is lit is smaller than the steps in which a sheet of 400 mm is looked over."""
    x0, y0, height = 0.013, 0.0117, 0.005
    bar = wide(bench, "rectangle", height, size=["100 mm", "2 mm"])
    place = {"position": bench.metres(x0, y0, height), "look_at": bench.metres(x0, y0, 0)}
    scene = lit(bench, {**bar, **place}, size=0.4)
    (source,) = scene.sources
    assert isinstance(source, WideSource) and len(source.patches) < 400
    along, across = np.linspace(x0 - 0.055, x0 + 0.055, 45), np.linspace(y0 - 0.01, y0 + 0.01, 21)
    points = np.vstack([[(x, y0, 0.0) for x in along], [(x0 + 0.003, y, 0.0) for y in across]])
    got = bench.radiance(scene, points + np.array([0.0, 0.05, 0.004]), points) * math.pi / 0.5
    nodes, weights = np.polynomial.legendre.leggauss(60)
    u, v = np.meshgrid(x0 + 0.05 * nodes, y0 + 0.001 * nodes)
    share = np.outer(weights, weights) * 0.05 * 0.001
    due = [(share * height**2 / ((u - x) ** 2 + (v - y) ** 2 + height**2) ** 2).sum() for x, y, _ in points]
    assert got == pytest.approx(np.array(due), rel=ASKED)
