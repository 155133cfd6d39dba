"""A belt under a ring of LEDs, seen in blocks from above."""

from __future__ import annotations

from typing import Any

import numpy as np

import radwrap
from radwrap.imaging.optics.smooth import BLOCK, corners_around, corners_of
from radwrap.imaging.optics.view import central_rays
from radwrap.scene.scene import Scene
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.smooth import smooth_blocks
from radwrap.tracers.engine import BlockLight
from radwrap.tracers.text_frame import TextFrame

ROWS, COLUMNS = 96, 120
PIXEL_MM = 0.2  # on the belt
FLAT: dict[str, Any] = {
    "camera": {
        "position": ["0 mm", "0 mm", "400 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "up": [0, 1, 0],
        "focal_length": "20 mm",
        "exposure_time": "10 ms",
        "aperture": {"diameter": "0.01 mm"},
        "diffraction": "off",
        "sensor": {
            "rows": ROWS,
            "columns": COLUMNS,
            "pixel_width": "10 um",
            "pixel_height": "10 um",
            "gain": "1e5 (J/m^2)^-1",
            "gamma": 1.0,
            "dark_gray": 0,
            "saturation_gray": 255,
        },
    },
    "sources": [
        {
            "type": "ring",
            "name": "ring",
            "count": 12,
            "diameter": "120 mm",
            "position": ["0 mm", "0 mm", "300 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "led_diameter": "3 mm",
            "radiant_intensity": "0.2 W/sr",
            "beam": {"profile": "gaussian", "width": "60 deg", "width_definition": "fwhm"},
        }
    ],
    "materials": {
        "belt": {"type": "lambertian", "reflectance": 0.3},
        "dark": {"type": "lambertian", "reflectance": 0.05},
        "shiny": {
            "type": "specular",
            "diffuse_reflectance": 0.1,
            "specular_reflectance": 0.1,
            "roughness": 0.1,
        },
        "polished": {
            "type": "specular",
            "diffuse_reflectance": 0.1,
            "specular_reflectance": 0.1,
            "roughness": 0.04,
        },
    },
    "targets": [{"type": "sheet", "name": "belt", "material": "belt", "size": ["100 mm", "100 mm"]}],
}


def at(x: float, y: float, z: float) -> list[str]:
    return [f"{value} mm" for value in (x, y, z)]


def scene_of(*more: dict[str, Any], **changes: Any) -> Scene:
    return radwrap.scene_from_document({**FLAT, **changes, "targets": [*FLAT["targets"], *more]})


def lattice(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    corners = corners_of((0, 0), (ROWS // BLOCK, COLUMNS // BLOCK))
    middles = tuple(places[:-1, :-1] + BLOCK / 2 for places in corners)
    return central_rays(scene.camera, *corners), central_rays(scene.camera, *middles)


def proved(scene: Scene) -> np.ndarray:
    return light_in(scene, np.ones((ROWS // BLOCK, COLUMNS // BLOCK), dtype=np.bool_)) == BlockLight.PROVED


def light_in(scene: Scene, blocks: np.ndarray) -> np.ndarray:
    """The `BlockLight` of some blocks, laid out as these are."""
    corners, middles = lattice(scene)
    needed, around = corners_around(blocks)
    light = np.full(blocks.shape, BlockLight.UNKNOWN, dtype=np.int8)
    light[blocks] = smooth_blocks(compiled_scene(scene, TextFrame()), corners[needed], middles[blocks], around)
    return light


def block_of(x: float, y: float) -> tuple[int, int]:
    """Row and column of the block that sees a place on the belt [mm]."""
    return int((ROWS / 2 - y / PIXEL_MM) // BLOCK), int((COLUMNS / 2 + x / PIXEL_MM) // BLOCK)
