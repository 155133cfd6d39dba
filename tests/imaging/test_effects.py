"""What leaving an effect out costs, against closed forms."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.imaging.demand import Demand
from radwrap.imaging.forecast.effects import Probe, bounces, effects
from radwrap.imaging.optics.view import rays_through
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.plans import Plans, choose
from radwrap.imaging.tolerance.survey import survey
from radwrap.imaging.tracing import laid_out
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, gray, view

# Two sets of 256 pixels with 8 rays each: what is drawn at random spreads by so much (about three standard deviations).
SPREAD = 0.3


def root_mean_square(values: Array) -> float:
    """Of an array."""
    return math.sqrt(float((values**2).mean()))


def test_cos4_costs_what_the_angles_say() -> None:
    """An even field: each pixel lacks L (1 - cos^4)."""
    seen = view(Aperture("round", 0.0), (1.0, lambda x, y: np.ones_like(x)), f=0.0005)
    v, u = np.divmod(np.arange(seen.camera.sensor.pixels, dtype=float), seen.camera.sensor.columns)
    _, cos4 = rays_through(seen.camera, (0.0, 0.0), u, v)
    probe = Probe.of(seen, 0)
    found = math.sqrt(probe.mean_square(probe.without_cos4()).mean)
    assert found == pytest.approx(root_mean_square(gray(seen, 1 - cos4)), rel=0.1)
    assert found > 1.0


def test_the_finite_aperture_costs_what_the_blur_of_an_edge_says() -> None:
    """A step of contrast c, blurred over 2R by a square opening: rms c sqrt(R/6/W) over a width of W."""
    side, f = 3e-4, 0.01
    seen = view(Aperture("square", side), (1.0, lambda x, y: np.where(x > 0, 1.0, 0.0)), rows=64, columns=96, f=f)
    radius = side / 2 * (1 + f) / seen.camera.sensor.pixel_width
    probe = Probe.of(seen, 0)
    expected = 100 * math.sqrt(radius / 6 / 96)
    square = probe.mean_square(probe.through_centre())
    assert math.sqrt(square.mean) == pytest.approx(expected, rel=SPREAD)
    assert math.sqrt(square.upper) > expected


def test_depths_are_told_apart_only_where_it_matters() -> None:
    """A scene of two depths needs two layers, one of a single depth does not; the planner goes by that number."""

    def stripes(x: Array, y: Array) -> Array:
        return np.where(np.sin(x / 3e-3) > 0, 1.0, 0.1)

    def half(x: Array, y: Array) -> Array:
        return np.where(y < 0, np.where(np.sin(x / 1e-4) > 0, 1.0, 0.1), np.nan)

    flat = view(Aperture("round", 1e-4), (1.0, stripes))
    deep = view(Aperture("round", 1e-4), (0.02, half), (1.0, stripes))
    level, uneven = survey(flat, 0), survey(deep, 0)
    assert uneven.one_layer.mean > 0.5**2 > 100 * abs(level.one_layer.upper)
    assert choose(Plans(flat, level, Demand(0.5), 0)).one_layer
    assert not choose(Plans(deep, uneven, Demand(0.5), 0)).one_layer


def document(targets: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    """A small scene with a linear sensor that does not saturate."""
    sensor = {"rows": 12, "columns": 12, "pixel_width": "20 um", "pixel_height": "20 um", "gain": "1e9 (J/m^2)^-1"}
    sensor |= {"gamma": 1, "dark_gray": 0, "saturation_gray": 65535, "bit_depth": 16, "rounding": False}
    return {
        "camera": {
            "position": ["0 mm", "0 mm", "1000 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "focal_length": "10 mm",
            "exposure_time": "10 ms",
            "aperture": {"diameter": "0.1 mm"},
            "diffraction": "off",
            "sensor": sensor,
        },
        "sources": [],
        "materials": {
            "bright": {"type": "lambertian", "reflectance": 0.8},
            "dim": {"type": "lambertian", "reflectance": 0.1},
        },
        "targets": targets,
    } | more


def lamp(*position: str) -> dict[str, Any]:
    """A far Lambertian lamp that shines down."""
    return {
        "type": "lamp",
        "name": "lamp",
        "position": list(position),
        "rotation": ["180 deg", "0 deg", "0 deg"],
        "diameter": "10 mm",
        "radiance": "1e6 W/m^2/sr",
        "beam": {"profile": "lambertian"},
    }


def test_a_wall_that_only_the_floor_lights() -> None:
    """Irradiance from a lit Lambertian rectangle at right angles, by quadrature; nothing else lights the wall."""
    floor = {"type": "sheet", "name": "floor", "size": ["200 mm", "200 mm"], "position": ["100 mm", "0 mm", "0 mm"]}
    wall = {"type": "sheet", "name": "wall", "size": ["200 mm", "200 mm"], "position": ["0 mm", "0 mm", "100 mm"]}
    wall |= {"rotation": ["0 deg", "90 deg", "0 deg"], "material": "dim"}
    told = document([{**floor, "material": "bright"}, wall], sources=[lamp("-20 mm", "0 mm", "20 m")])
    told["camera"] |= {"position": ["500 mm", "0 mm", "50 mm"], "look_at": ["0 mm", "0 mm", "50 mm"], "up": [0, 0, 1]}
    scene = radwrap.scene_from_document(told)
    with laid_out(scene, RenderOptions()) as traced:
        seen = traced.view()
        effect = bounces(scene, seen, 0, 0.5)
    lit = 1e6 * math.pi * 0.005**2 / 20**2
    x, y = (0.2 * ((np.arange(800) + 0.5) / 800) for _ in range(2))
    x, y = np.meshgrid(x, y - 0.1)
    square = x**2 + y**2 + 0.05**2
    received = (0.8 * lit / math.pi * (x * 0.05) / square**2).sum() * (0.2 / 800) ** 2
    expected = gray(seen, np.array([0.1 / math.pi * received]))[0]
    # 2 % for the further bounces off the wall, 2 % for the random draws.
    assert effect.needed and effect.rms_gray == pytest.approx(expected, rel=0.04)
    assert effect.rms_gray_upper95 > 0.96 * expected


def test_what_cannot_light_itself_costs_no_ray() -> None:
    sheet = {"type": "sheet", "name": "sheet", "size": ["200 mm", "200 mm"], "material": "bright"}
    told = {
        one["name"]: one
        for one in effects(radwrap.scene_from_document(document([sheet], sources=[lamp("0 m", "0 m", "2 m")])))[
            "effects"
        ]
    }
    assert told["bounces"] == {**told["bounces"], "needed": False, "rms_gray": 0.0, "rms_gray_upper95": 0.0, "rays": 0}
    assert "leds" not in told and not told["depth_spread"]["needed"]


def test_a_ring_in_one_point_is_too_bright_by_its_angles() -> None:
    """On the axis a Lambertian ring of radius r gives E = N I h^2/(h^2 + r^2)^2, one source in its place N I/h^2."""
    height, radius = 0.3, 0.1
    ring = {"type": "ring", "name": "ring", "position": ["0 mm", "0 mm", "300 mm"], "look_at": ["0 mm", "0 mm", "0 mm"]}
    ring |= {"count": 8, "diameter": "200 mm", "led_diameter": "2 mm", "radiance": "1e4 W/m^2/sr"}
    ring |= {"beam": {"profile": "lambertian"}, "leds": [{"index": 0, "radiance_factor": 1.5}]}
    sheet = {"type": "sheet", "name": "sheet", "size": ["50 mm", "50 mm"], "material": "bright"}
    scene = radwrap.scene_from_document(document([sheet], sources=[ring]))
    told = {one["name"]: one for one in effects(scene, RenderOptions(tolerance=1.0))["effects"]}
    intensity = 1e4 * math.pi * 0.001**2 * 8.5
    each = [intensity / height**2, intensity * height**2 / (height**2 + radius**2) ** 2]
    camera = scene.camera
    scale = camera.exposure_time * camera.aperture.area / camera.focal_length**2 * 1e9 * 0.8 / math.pi
    # The field of view, 24 mm, lies about the axis: 1 % off in the mean.
    assert told["leds"]["rms_gray"] == pytest.approx(scale * (each[0] - each[1]), rel=0.02)
    # On the axis all LEDs count the same; 12 mm off it they no longer do.
    assert 0 < told["led_differences"]["rms_gray"] < 0.02 * scale * each[1]


def test_a_coloured_file_needs_its_channel(tmp_path: Path) -> None:
    """Reflectances .6, .3, .3: the mean of the channels is .4, a third below red."""
    (tmp_path / "part.rad").write_text(
        "void plastic red\n0\n0\n5 .6 .3 .3 0 0\n\nred polygon sheet\n0\n0\n12 -1 -1 0 1 -1 0 1 1 0 -1 1 0\n"
    )
    part = {"type": "rad", "name": "part", "rad": "part.rad", "length_unit": "1 m"}
    told = document([part], sources=[lamp("0 m", "0 m", "2 m")])
    told["camera"]["sensor"]["channel"] = "red"
    scene = radwrap.scene_from_document(told, folder=tmp_path)
    found = {one["name"]: one for one in effects(scene)["effects"]}
    level = radwrap.render(scene, tolerance=1.0).gray.values.mean()
    assert found["bands"]["rms_gray"] == pytest.approx(level / 3, rel=0.01)


def test_light_that_is_left_out_is_told(tmp_path: Path) -> None:
    """Every render says what bounces would add; a warning where that is more than a small part of the tolerance."""
    floor = {"type": "sheet", "name": "floor", "size": ["200 mm", "200 mm"], "material": "bright"}
    ball = {
        "type": "sphere",
        "name": "ball",
        "diameter": "8 mm",
        "position": ["0 mm", "0 mm", "4.1 mm"],
        "material": "dim",
    }
    scene = radwrap.scene_from_document(document([floor, ball], sources=[lamp("0.5 m", "0 m", "2 m")]))
    # What bounces add, 20 gray levels, is found by its own rays, whatever the tolerance.
    manifest = radwrap.render(scene, tolerance=4.0).manifest
    told = manifest["left_out"]["bounces"]
    assert told["needed"] and 0 < told["rms_gray"] <= told["rms_gray_upper95"]
    assert any("one surface to another" in line for line in manifest["warnings"])
    calm = radwrap.render(scene, tolerance=5000.0).manifest
    assert not any("one surface to another" in line for line in calm["warnings"])
