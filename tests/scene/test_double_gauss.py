"""The catalog's double Gauss: what its files say against paraxial optics, and where they may be used."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.aberrations import Wavefront
from radwrap.scene.catalog.places import find
from radwrap.scene.scene import Scene
from radwrap.units import LENGTH, parse_quantity

PRESCRIPTION = Path(__file__).parents[2] / "scripts" / "double_gauss" / "prescription.csv"
SENSOR = {"preset": "sony_imx265.allied_alvium_1800_c", "wavelength": "529 nm"}
PROJECTED = 2e-3  # the sensor is where the whole pupil's light meets, not the paraxial one's
GROWN = 0.015  # share by which aberrations of the entrance pupil widen the beam at f/8


def scene(name: str, lens: dict[str, Any] | None = None, **camera: Any) -> Scene:
    told = {
        "lens": {"preset": name, "focus_distance": "300 mm", **(lens or {})},
        "exposure_time": "1 ms",
        "sensor": SENSOR,
        "position": ["0 mm", "0 mm", "300 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        **camera,
    }
    materials = {
        "black": {"type": "lambertian", "reflectance": 0.05},
        "white": {"type": "lambertian", "reflectance": 1.0},
    }
    edge = {"type": "edge", "name": "edge", "material": "black", "edge_material": "white", "size": ["1 m", "1 m"]}
    place = {"position": ["0 mm", "0 mm", "0.2 m"], "look_at": ["0 mm", "0 mm", "0 mm"]}
    light = {"type": "ring", "name": "ring", "preset": "generic_ring_90mm_24led", **place}
    tables = {"camera": told, "materials": materials, "targets": [edge], "sources": [light]}
    return radwrap.scene_from_document(tables)


def paraxial() -> float:
    """Focal length [mm] by the paraxial height and slope of a ray that comes in parallel to the axis."""
    rows = np.genfromtxt(PRESCRIPTION, delimiter=",", comments="#", skip_header=3, filling_values=0.0)
    height, slope, before = 1.0, 0.0, 1.0  # slope times index
    for radius, thickness, index, _ in rows:
        slope -= height * (index - before) / radius if radius else 0.0
        height += thickness * slope / index
        before = index
    return -1 / slope


def test_its_focal_length_is_that_of_its_surfaces() -> None:
    told = parse_quantity(find("lenses", "double_gauss_12.5mm.f4", None, "x").values["focal_length"], LENGTH) * 1e3
    assert paraxial() == pytest.approx(12.58954, abs=1e-5)
    assert told == pytest.approx(paraxial(), rel=PROJECTED)


def test_stopped_down_it_dims_as_cos4_over_the_area_that_distortion_adds() -> None:
    """No rim cuts the beam at f/8."""
    values = find("lenses", "double_gauss_12.5mm.f8", None, "x").values
    focal = parse_quantity(values["focal_length"], LENGTH)
    k1, k2 = values["distortion"]["k1"], values["distortion"]["k2"]
    for told, share in values["relative_illumination"]:
        height = parse_quantity(told, LENGTH) / focal
        tangent = height
        for _ in range(50):
            tangent = height / (1 + k1 * tangent**2 + k2 * tangent**4)
        area = (1 + k1 * tangent**2 + k2 * tangent**4) * (1 + 3 * k1 * tangent**2 + 5 * k2 * tangent**4)
        assert share == pytest.approx(math.cos(math.atan(tangent)) ** 4 / area, rel=GROWN)


@pytest.mark.parametrize("f_number", ["2.5", "4", "8"])
def test_a_scene_takes_it_whole(f_number: str) -> None:
    camera = scene(f"double_gauss_12.5mm.f{f_number}").camera
    assert camera.lens is not None and camera.distortion is not None
    assert camera.aperture.diameter == pytest.approx(camera.focal_length / float(f_number))
    assert isinstance(camera.lens.glass, Wavefront) and camera.lens.glass.heights is not None
    assert camera.lens.glass.pupil_diameter == pytest.approx(12.58954e-3 / 2.5, rel=1e-4)
    assert camera.lens.relative_illumination is not None


@pytest.mark.parametrize(
    ("lens", "camera"), [({"f_number": 5.6}, {}), ({}, {"aperture": {"shape": "round", "diameter": "2 mm"}})]
)
def test_another_opening_needs_light_of_its_own(lens: dict[str, Any], camera: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="knows what light the corners get at f/4") as refused:
        scene("double_gauss_12.5mm.f4", lens, **camera)
    assert ("aperture.diameter" if camera else "lens.f_number") in str(refused.value)
    found = scene("double_gauss_12.5mm.f4", {**lens, "falloff": "cos4"}, **camera).camera
    assert found.lens is not None and found.lens.relative_illumination is None
