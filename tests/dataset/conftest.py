"""A small scene with one mesh part, and dataset files beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

SCENE: Final = """
[camera]
position = ["0 mm", "0 mm", "300 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
focal_length = "12.5 mm"
exposure_time = "100 ms"
diffraction = "off"

[camera.aperture]
diameter = "0.2 mm"

[camera.sensor]
rows = 40
columns = 48
pixel_width = "60 um"
pixel_height = "60 um"
gain = "1e5 (J/m^2)^-1"
gamma = 1.0
dark_gray = 20
saturation_gray = 255

[[sources]]
type = "ring"
name = "ring"
position = ["0 mm", "0 mm", "300 mm"]
look_at = ["0 mm", "0 mm", "0 mm"]
count = 4
diameter = "40 mm"
radiance = "200 kW/m^2/sr"
beam = { profile = "gaussian", width = "30 deg", width_definition = "fwhm" }

[materials.grey]
type = "lambertian"
reflectance = 0.5

[[targets]]
type = "sheet"
name = "table"
material = "grey"
size = ["200 mm", "200 mm"]
position = ["0 mm", "0 mm", "-40 mm"]

[[targets]]
name = "block"
part = "block.obj"
length_unit = "1 mm"
material = "grey"
"""

# A box of 12 x 8 x 6 mm about the origin; its sides are turned outwards.
_CORNERS: Final = [(x, y, z) for x in (-6, 6) for y in (-4, 4) for z in (-3, 3)]
_SIDES: Final = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
BLOCK: Final = "".join(f"v {x} {y} {z}\n" for x, y, z in _CORNERS) + "".join(
    f"f {' '.join(map(str, side))}\n" for side in _SIDES
)

Write = Callable[[str], Path]


@pytest.fixture
def dataset_file(tmp_path: Path) -> Write:
    """A function that writes a dataset's file beside the scene."""
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "block.obj").write_text(BLOCK)

    def write(text: str) -> Path:
        path = tmp_path / "dataset.toml"
        path.write_text(f'scene = "scene.toml"\n{text}')
        return path

    return write
