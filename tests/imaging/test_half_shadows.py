"""Wide lights behind an edge, seen in a narrow lobe: few rays may be below no light by chance, and images are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import radwrap

SCENE = """
title = "A square light, half of it behind a sheet, in the highlight of a plate"
[camera]
position = ["0 mm", "-200 mm", "150 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
up = [0.0, 0.0, 1.0]
focal_length = "12 mm"
exposure_time = "10 ms"
aperture = { diameter = "0 mm", exposure_diameter = "0.5 mm" }
[camera.sensor]
rows = 16
columns = 16
pixel_width = "28 um"
pixel_height = "28 um"
gain = "8e6 (J/m^2)^-1"
gamma = 1.0
dark_gray = 5
saturation_gray = 255
[materials.black]
type = "lambertian"
reflectance = 0.0
[materials.paint]
type = "specular"
diffuse_reflectance = 0.2
specular_reflectance = 0.1
roughness = 0.03
[[targets]]
type = "sheet"
name = "plate"
size = ["600 mm", "600 mm"]
material = "paint"
[[targets]]
type = "sheet"
name = "shade"
size = ["99.5 mm", "180 mm"]
position = ["50.25 mm", "110 mm", "60 mm"]
material = "black"
[[sources]]
type = "rectangle"
name = "light"
position = ["0 mm", "200 mm", "150 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
radiance = "300 W/m^2/sr"
size = ["60 mm", "60 mm"]
"""


@pytest.mark.parametrize(("gamma", "gain"), [(1.0, "8e6 (J/m^2)^-1"), (0.85, "8e5 (J/m^2)^-0.85")])
def test_an_image_in_half_shadow_has_no_light_below_none(tmp_path: Path, gamma: float, gain: str) -> None:
    text = SCENE.replace('"8e6 (J/m^2)^-1"', f'"{gain}"').replace("gamma = 1.0", f"gamma = {gamma}")
    (tmp_path / "scene.toml").write_text(text)
    made = radwrap.render(radwrap.load_scene(tmp_path / "scene.toml"), seed=0, method="pinhole")
    # The plate's far left sees the whole light: there is light in the image; none of its pixels is below none.
    assert made.radiant_exposure.values.min() >= 0 and np.ptp(made.gray.values) > 100
    assert np.isfinite(made.run.error.rms_gray_upper95)
