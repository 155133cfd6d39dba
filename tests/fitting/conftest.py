"""A small bench with a linear camera: an edge in the light of three LEDs, on 24 x 20 pixels."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import Any, Final

import numpy as np
import pytest

from radwrap.fitting.captured import Captured, captured
from radwrap.fitting.free_keys import FreeScene, free_scene
from radwrap.fitting.places import Places
from radwrap.fitting.prediction import Prediction
from radwrap.images import GrayImage
from radwrap.imaging.relight.relit import Basis, read_basis
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.synthesis import render
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from tests.study.conftest import EDGE

# Coarse: what hangs on weights and algebra hangs on no ray.
OPTIONS: Final = RenderOptions(tolerance=1.0, workers=1)
LEVELS: Final = "sources[0].leds[*].radiance_factor"
EXPOSURE: Final = "camera.exposure_time"


def tables(**sensor: Any) -> dict[str, Any]:
    """The bench with a linear camera whose light, read-out and pattern are all of some noise."""
    bench = deepcopy(EDGE)
    shape = {"rows": 20, "columns": 24, "pixel_width": "50 um", "pixel_height": "50 um"}
    linear = {
        "model": "linear",
        "wavelength": "550 nm",
        "quantum_efficiency": 0.5,
        "system_gain": "0.02 DN/e",
        "offset": 5.0,
        "full_well": "20 ke",
        "read_noise": "20 e",
        "bit_depth": 8,
    }
    bench["camera"]["sensor"] = {**shape, **linear, **sensor}
    bench["sources"][0]["radiance"] = "2500 W/m^2/sr"
    return bench


def changed(scene: Scene, changes: dict[str, Any]) -> Scene:
    """The scene with other values of keys."""
    return scene_from_document(json.loads(scene.document), changes, origin=scene.origin, folder=scene.folder)


@pytest.fixture(scope="session")
def bench() -> Scene:
    """The scene where fits begin."""
    return scene_from_document(tables())


@pytest.fixture(scope="session")
def basis(bench: Scene, tmp_path_factory: pytest.TempPathFactory) -> Basis:
    """Its light, source by source."""
    folder = tmp_path_factory.mktemp("basis")
    render(bench, folder, OPTIONS, basis=True)
    return read_basis(folder)


def begun(bench: Scene, basis: Basis, free: list[str]) -> tuple[FreeScene, Prediction]:
    """A fit's beginning."""
    keys = free_scene(bench, free)
    return keys, Prediction([(keys, Places(keys, (), lambda _: basis))])


def taken(gray: np.ndarray[Any, np.dtype[np.float64]], scene: Scene) -> Captured:
    """One capture."""
    sensor = scene.camera.sensor
    return captured([GrayImage(gray, sensor.bit_depth)], ["capture"], sensor, None)
