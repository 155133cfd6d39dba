"""What an image hangs on that nobody published: known changes of mean and noise."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any

import numpy as np
import pytest

from radwrap.imaging.output.assumed_values import AssumedEffect, assumed_effects, warnings_of_assumed
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene

START = tomllib.loads((files("radwrap") / "data" / "init" / "scene.toml").read_text("utf-8"))
SENSOR = "sony_imx250.lucid_atlas"  # 0.370 DN/e, offset 64 in 0 to 240, DSNU 1.3 e in 0 to 3.7 e, PRNU 0 to 1.4 %
SHAPE = (40, 50)


def scene_with(**sensor: Any) -> Scene:
    camera = START["camera"] | {"sensor": {"preset": SENSOR, **sensor}, "focal_length": "25 mm"}
    return scene_from_document(START | {"camera": camera})


def effects_of(scene: Scene, electrons: float) -> dict[str, AssumedEffect]:
    linear = scene.camera.sensor.linear
    assert linear is not None
    exposure = np.full(SHAPE, electrons / linear.electrons_of_exposure(scene.camera.sensor.pixel_area))
    return {effect.key: effect for effect in assumed_effects(scene, exposure)}


def test_an_offset_moves_all_gray_levels() -> None:
    found = effects_of(scene_with(), 3000)["camera.sensor.offset"]
    assert found.mean_gray == pytest.approx((-64, 176), abs=1e-9)
    assert (found.low, found.high, found.notable) == ("0", "240", True)


def test_prnu_is_noise_in_bright_images() -> None:
    """sigma^2 = K^2 (mu + sigma_d^2 + DSNU^2 + PRNU^2 mu^2) + 1/12, dark signal aside."""
    scene = scene_with(dark_current="0 e/s")
    linear = scene.camera.sensor.linear
    assert linear is not None
    found = effects_of(scene, 8000)["camera.sensor.prnu"]
    assert found.noise is not None

    def noise(prnu: float) -> float:
        electrons = 8000 + linear.read_noise**2 + linear.dsnu**2 + (prnu * 8000) ** 2
        return float(np.sqrt(linear.system_gain**2 * electrons + 1 / 12))

    expected = [noise(prnu) / noise(linear.prnu) - 1 for prnu in (0.0, 0.014)]
    assert found.noise == pytest.approx(expected, abs=2e-3)  # slopes are taken over a standard deviation
    assert found.mean_gray == pytest.approx((0, 0), abs=1e-9) and found.notable


def test_what_the_user_says_is_not_assumed() -> None:
    found = effects_of(scene_with(offset=64, prnu=0.007, dsnu="1 e"), 3000)
    assert set(found) == {"camera.sensor.dark_current"}
    assert not found["camera.sensor.dark_current"].notable
    assert list(warnings_of_assumed(tuple(found.values()))) == []


def test_one_line_names_what_counts() -> None:
    (line,) = warnings_of_assumed(tuple(effects_of(scene_with(), 8000).values()))
    assert "camera.sensor.offset from 0 to 240: mean gray -64 to +176; " in line
    assert "camera.sensor.prnu from 0 to 0.014: noise -" in line and "dark_current" not in line


def test_a_quantum_efficiency_at_another_wavelength_may_be_another() -> None:
    key = "camera.sensor.quantum_efficiencies"
    assert key not in effects_of(scene_with(), 3000)
    found = effects_of(scene_with(wavelength="630 nm"), 3000)[key]
    assert found.mean_gray == pytest.approx((-0.26 * 3000 * 0.37, 0.36 * 3000 * 0.37), rel=1e-6)


def under_a_line(name: str, wavelength: str) -> Scene:
    camera = START["camera"] | {"sensor": {"preset": name, "wavelength": wavelength}, "focal_length": "25 mm"}
    sources = [one | {"spectrum": {"line": wavelength, "width": "20 nm"}} for one in START["sources"]]
    return scene_from_document(START | {"camera": camera, "sources": sources})


def test_what_comes_after_the_electrons_counts_under_spectra_too() -> None:
    found = effects_of(under_a_line(SENSOR, "550 nm"), 3000)
    assert found["camera.sensor.offset"].mean_gray == pytest.approx((-64, 176), abs=1e-9)
    plain = effects_of(scene_with(), 3000)
    assert set(found) == set(plain)
    assert found["camera.sensor.prnu"].noise == pytest.approx(plain["camera.sensor.prnu"].noise)


def test_a_factor_on_a_curve_is_one_on_the_electrons_of_spectra() -> None:
    found = effects_of(under_a_line(SENSOR, "630 nm"), 3000)["camera.sensor.quantum_efficiencies"]
    assert found.mean_gray == pytest.approx((-0.26 * 3000 * 0.37, 0.36 * 3000 * 0.37), rel=1e-6)


def test_a_curve_ends_at_one_electron_for_each_photon() -> None:
    """The curve of IMX900 has .8858 at most: 1.36 times as much stops at 1."""
    found = effects_of(under_a_line("sony_imx900.framos_hcg", "630 nm"), 300)["camera.sensor.quantum_efficiencies"]
    assert found.mean_gray == pytest.approx((-0.26 * 300 * 1.673, (1 / 0.8858 - 1) * 300 * 1.673), rel=1e-6)
