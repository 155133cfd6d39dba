"""Raw images of a colour camera for other levels of its lights: each pixel by the basis of its own colour."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.images import read_gray, read_image
from radwrap.scene.mosaic import COLOURS, composed, pixels_of
from tests.cli.conftest import here
from tests.imaging.test_mosaicked import PAINT, SENSOR, colour_camera, scene_with
from tests.physics.conftest import Bench

STORED: Final = 3e-6  # float32 of three sums
LIGHTS: Final[dict[str, dict[str, Any]]] = {
    "day": {"preset": "E"},
    "deep": {"line": "660 nm", "width": "10 nm"},
}


def lit(folder: Path, *, levels: dict[str, float], tolerance: float = 2.0, **sensor: Any) -> radwrap.Scene:
    """A painted sheet under a lamp of broad light from the right and a red one from the left."""
    (folder / "paint.csv").write_text(PAINT)
    sources = []
    for side, (name, spectrum) in zip((1, -1), LIGHTS.items(), strict=True):
        lamp = Bench.lamp((0.3 * side, 0, 0.5), radiant_intensity=levels[name])
        sources.append(lamp | {"name": name, "spectrum": spectrum})
    material = {"type": "lambertian", "reflectance": 0.5, "spectrum": {"file": "paint.csv"}}
    view = Bench.camera(focal_length=0.01) | {"sensor": SENSOR | colour_camera() | sensor}
    sheet = {"type": "sheet", "material": "white", "size": ["1 m", "1 m"]}
    document = {"camera": view, "sources": sources, "materials": {"white": material}, "targets": [sheet]}
    return radwrap.scene_from_document(document, folder=folder)


ALL: Final = {"day": 4.0, "deep": 2.0}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw")
    radwrap.render(lit(folder, levels=ALL), folder / "basis", tolerance=2, seed=1, basis=True)
    return folder


def test_the_raw_image_of_all_lights_is_that_of_the_render(made: Path) -> None:
    image = radwrap.relight(made / "basis")
    stored = read_image(made / "basis" / "radiant_exposure.exr")[0]
    assert image.radiant_exposure.values == pytest.approx(stored, rel=STORED)
    assert np.abs(image.gray.values - read_gray(made / "basis" / "gray.png").values).max() <= 0.5 + 1e-3  # rounded
    run = json.loads((made / "basis" / "manifest.json").read_text())
    assert image.certificate.rms_gray_upper95 == pytest.approx(run["error"]["rms_gray_upper95"], rel=0.2)
    assert {path.name for path in (made / "basis" / "planes").iterdir()} == set(COLOURS)


@pytest.mark.long
def test_other_levels_are_a_fresh_render_within_both_certificates(made: Path, tmp_path: Path) -> None:
    image = radwrap.relight(made / "basis", {"deep": 3.0, "day": 0.25})
    fresh = radwrap.render(lit(tmp_path, levels={"day": 1.0, "deep": 6.0}), tolerance=2, seed=7)
    off = image.gray.values - fresh.gray.values
    bound = math.hypot(image.certificate.rms_gray_upper95, fresh.error.rms_gray_upper95)
    assert math.sqrt((off**2).mean()) < bound < 8
    before = read_gray(made / "basis" / "gray.png").values
    assert math.sqrt(((image.gray.values - before) ** 2).mean()) > 20 * bound, "or nothing was changed"


def test_levels_are_linear_in_each_colour(made: Path) -> None:
    """Each source alone adds up to both; the deep red one is seen by the red pixels most."""
    one, other = (radwrap.relight(made / "basis", {dark: 0.0}).gray.values - 64 for dark in ALL)
    both = radwrap.relight(made / "basis").gray.values - 64
    assert one + other == pytest.approx(both, rel=STORED, abs=1e-3)
    red, blue = (
        composed("RGGB", {colour: np.full(one.shape, float(colour == name)) for colour in COLOURS}) > 0
        for name in ("red", "blue")
    )
    assert one[red].mean() > 5 * one[blue].mean()


def test_the_error_is_that_of_the_colours(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    argv = ["relight", made / "basis", "--level", "deep=0.5", "--out", out, "--exposure", "--json"]
    told = here(argv, capsys).success().json["images"]["gray"]
    pixels = {colour: pixels_of("RGGB", colour, (31, 42)) for colour in COLOURS}
    assert sum(pixels.values()) == 31 * 42
    mean = sum(pixels[c] * told["error_of_colours"][c]["rms_gray_upper95"] ** 2 for c in COLOURS) / (31 * 42)
    assert told["error"]["rms_gray_upper95"] == pytest.approx(math.sqrt(mean))
    sigma = read_image(out / "gray_sigma" / "gray.exr")[0]
    image = radwrap.relight(made / "basis", {"deep": 0.5})
    # EMVA 1288 by each pixel's own electrons, and the rays' error, which is small.
    noise = 0.3 * (image.gray.values - 64) + (0.3 * 8.0) ** 2
    assert sigma**2 == pytest.approx(noise, rel=0.05)
    assert read_image(out / "gray.exr")[0] == pytest.approx(image.radiant_exposure.values, rel=1e-6)


def test_another_exposure_needs_no_ray_and_other_filters_do(made: Path) -> None:
    image = radwrap.relight(made / "basis")
    half = radwrap.relight(made / "basis", {}, {"camera.exposure_time": "500 ms"}, scene_folder=made)
    assert half.gray.values - 64 == pytest.approx((image.gray.values - 64) / 2, rel=STORED)
    assert half.certificate.rms_gray_upper95 == pytest.approx(image.certificate.rms_gray_upper95 / 2)
    for key in ("camera.sensor.mosaic", "camera.sensor.filters.red.quantum_efficiency"):
        with pytest.raises(InputError, match="which light a pixel gets"):
            radwrap.relight(made / "basis", {}, {key: "BGGR" if key.endswith("mosaic") else 0.5}, scene_folder=made)


def test_a_basis_of_another_run_is_refused(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "basis", tmp_path / "basis")
    shutil.rmtree(tmp_path / "basis" / "planes" / "red")
    shutil.copytree(made / "basis" / "planes" / "green", tmp_path / "basis" / "planes" / "red")
    with pytest.raises(InputError, match="is of another run"):
        radwrap.relight(tmp_path / "basis")


def test_colours_without_bases_are_refused(tmp_path: Path) -> None:
    radwrap.render(lit(tmp_path, levels=ALL), tmp_path / "plain", tolerance=8, seed=1)
    with pytest.raises(InputError, match="holds no light basis"):
        radwrap.relight(tmp_path / "plain")


def test_without_spectra_all_colours_count_by_the_largest_efficiency(tmp_path: Path) -> None:
    """A plane counts by its own quantum efficiency; the raw image has one scale, as the render's has."""
    radwrap.render(scene_with(colour_camera()), tmp_path / "basis", tolerance=8, seed=1, basis=True)
    stored = read_image(tmp_path / "basis" / "radiant_exposure.exr")[0]
    assert radwrap.relight(tmp_path / "basis").radiant_exposure.values == pytest.approx(stored, rel=STORED)
