"""The scenes of factories' cells, and the parts that lie in them."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import radwrap
from radwrap.scene.targets import MeshPart

CELLS = Path(__file__).parents[2] / "rad_scenes" / "cells"
NAMES = ("ring", "area_ring", "two_bars", "dome", "backlight", "coaxial")


def test_parts_are_what_the_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(CELLS.parents[1] / "scripts"))
    from cell_parts import parts

    assert {path.name: path.read_text() for path in CELLS.glob("*.obj")} == parts()
    sys.modules.pop("cell_parts")


@pytest.mark.parametrize(
    ("name", "area"),
    [
        ("plate", 72 * 24 - math.pi * (3**2 + 5**2 + 7**2)),
        ("nut", 17**2 * math.sqrt(3) / 2 - math.pi * 5**2),
        ("washer", math.pi * (12**2 - 6.5**2)),
    ],
)
def test_parts_are_closed_and_as_large_as_they_say(name: str, area: float) -> None:
    mesh = trimesh.load_mesh(CELLS / f"{name}.obj")
    assert mesh.is_watertight and mesh.is_winding_consistent
    height = float(np.ptp(mesh.vertices[:, 2]))
    # A circle of 96 sides has 7e-4 less area.
    assert mesh.volume == pytest.approx(area * height, rel=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_each_cell_is_a_scene_of_five_megapixels_in_focus(name: str) -> None:
    scene = radwrap.load_scene(
        CELLS / f"{name}.toml", {f"camera.sensor.{key}": value for key, value in SMALL_SENSOR.items()}
    )
    assert sum(isinstance(target, MeshPart) for target in scene.targets) == 3
    assert scene.camera.lens is not None
    assert scene.camera.aperture.diameter == pytest.approx(25e-3 / 8)
    # All heights of the parts, 0 to 8 mm, are sharp to two thirds of a pixel of 3.45 um.
    depths = np.array([0.392, 0.4])
    blur = np.abs(scene.camera.magnification(depths)) * scene.camera.aperture.diameter
    assert 2e-6 < blur.max() < 2 / 3 * 3.45e-6


# The same field on fewer pixels: as quick as it can be.
SMALL_SENSOR = {"rows": 32, "columns": 38, "pixel_width": "222 um", "pixel_height": "222 um"}
