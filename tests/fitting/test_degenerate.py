"""Ten planted degeneracies: what captures cannot tell apart is named, and gets no interval."""

from __future__ import annotations

from copy import deepcopy
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.scene.scene import Scene
from tests.fitting.conftest import EXPOSURE, OPTIONS, tables

pytestmark = pytest.mark.long

SENSOR: Final = "camera.sensor"
# Keys, what is said of them, and which keys get no interval.
BY_LEVELS: Final[dict[str, tuple[list[str], list[str], int]]] = {
    "radiance and time": (["sources[0].radiance", EXPOSURE], ["only as a product"], 2),
    "efficiency and time": ([f"{SENSOR}.quantum_efficiency", EXPOSURE], ["only as a product"], 2),
    "wavelength and time": ([f"{SENSOR}.wavelength", EXPOSURE], ["only as a product"], 2),
    "three of one product": (
        ["sources[0].radiance", f"{SENSOR}.quantum_efficiency", EXPOSURE],
        ["only as a product", "only as a product"],
        3,
    ),
    "levels and their source": (
        ["sources[0].leds[*].radiance_factor", "sources[0].radiance"],
        ["only up to a factor"],
        4,
    ),
    "dark current and offset": ([f"{SENSOR}.dark_current", f"{SENSOR}.offset"], ["only together"], 2),
}
FLAT: Final = {
    "type": "sheet",
    "name": "sheet",
    "material": "white",
    "size": ["400 mm", "400 mm"],
}


def _told(scene: Scene, free: list[str], changes: dict[str, Any]) -> tuple[radwrap.Fit, list[str]]:
    there = scene
    for key, value in changes.items():
        there = radwrap.with_value(there, key, value)
    capture = radwrap.render(there, method="rays", tolerance=0.3, seed=7, workers=1).frames(1)
    found = radwrap.fit(scene, capture, free, options=OPTIONS)
    return found, list(found.undetermined)


@pytest.mark.parametrize("case", BY_LEVELS.values(), ids=BY_LEVELS.keys())
def test_what_levels_and_the_sensor_cannot_tell_apart(case: tuple[list[str], list[str], int]) -> None:
    free, words, lost = case
    # Dark current grows with the time too, and so would tell it.
    dark = f"{SENSOR}.dark_current" in free
    scene = radwrap.scene_from_document(tables(dark_current="100 e/s") if dark else tables())
    found, told = _told(scene, [*free], {f"{SENSOR}.offset": 5.5} if dark else {EXPOSURE: "110 ms"})
    assert len(told) == len(words)
    assert all(word in line for word, line in zip(words, told, strict=True)), told
    assert sum(key.interval is None for key in found.keys) == lost
    assert found.explained


@pytest.mark.parametrize(
    ("target", "free", "named"),
    [
        # A sheet of one reflectance all over the image: where it lies in its own plane does not show.
        (FLAT, ["pose:sheet"], {"tx", "ty", "rz"}),
        # A reflectance that all that is seen has is a factor on all light.
        (FLAT, ["materials.white.reflectance", "sources[0].radiance"], {"reflectance", "radiance"}),
        # An edge slides along itself.
        ({}, ["pose:edge"], {"ty"}),
        # Where nothing of a material is seen.
        (FLAT, ["materials.black.reflectance", EXPOSURE], {"black"}),
    ],
)
def test_what_the_place_of_a_target_does_not_show(target: dict[str, Any], free: list[str], named: set[str]) -> None:
    bench = deepcopy(tables())
    if target:
        bench["targets"] = [target]
    found, told = _told(radwrap.scene_from_document(bench), free, {})
    without = {key.key for key in found.keys if key.interval is None}
    assert all(any(name in key for key in without) for name in named), without
    assert all(any(name in line for line in told) for name in named), told
    assert np.isnan(found.covariance).any()
