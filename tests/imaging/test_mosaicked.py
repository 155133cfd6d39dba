"""The raw image of a colour camera against three monochrome cameras, closed forms and EMVA 1288."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.images import read_gray
from radwrap.imaging.output.colour_picture import demosaiced, write_colour
from radwrap.imaging.output.run_manifest import read_run_manifest
from radwrap.scene.mosaic import COLOURS, Colour, Mosaic, Pattern
from radwrap.validate.closed_forms import sensor as closed
from tests.physics.conftest import Bench

# radiant_exposure.exr holds float32.
STORED = 1e-6
# Bounds are so many standard errors of what is measured: a false alarm in 1.7e6.
SURE = 5.0
QUICK: dict[str, Any] = {"method": "pinhole", "seed": 1, "tracer": "compiled"}

CURVES: dict[Colour, list[tuple[float, float]]] = {
    "red": [(380, 0.01), (580, 0.05), (620, 0.5), (780, 0.4)],
    "green": [(380, 0.02), (480, 0.1), (540, 0.6), (600, 0.1), (780, 0.05)],
    "blue": [(380, 0.3), (460, 0.45), (520, 0.06), (780, 0.02)],
}
SENSOR: dict[str, Any] = {
    "model": "linear",
    "rows": 31,
    "columns": 42,
    "pixel_width": "5 um",
    "pixel_height": "5 um",
    "bit_depth": 12,
    "rounding": False,
    "wavelength": "550 nm",
    "system_gain": "0.3 DN/e",
    "offset": 64,
    "full_well": "12 ke",
    "read_noise": "8 e",
}


def tables(colour: Colour) -> list[list[Any]]:
    return [[f"{nm} nm", share] for nm, share in CURVES[colour]]


def at_550(colour: Colour) -> float:
    return float(np.interp(550, *zip(*CURVES[colour], strict=True)))


FILTERS = {colour: {"quantum_efficiencies": tables(colour)} for colour in COLOURS}


def scene_with(
    sensor: dict[str, Any],
    folder: Path = Path(),
    *,
    light: dict[str, Any] | None = None,
    paint: str | None = None,
    level: float = 6.0,
    **camera: Any,
) -> radwrap.Scene:
    """A sheet that fills the image, under one lamp."""
    lamp = Bench.lamp((0.3, 0, 0.5), radiant_intensity=level)
    material: dict[str, Any] = {"type": "lambertian", "reflectance": 0.5}
    if light is not None:
        lamp["spectrum"] = light
    if paint is not None:
        (folder / "paint.csv").write_text(paint)
        material["spectrum"] = {"file": "paint.csv"}
    view = Bench.camera(focal_length=0.01) | {"sensor": SENSOR | sensor} | camera
    sheet = {"type": "sheet", "material": "white", "size": ["1 m", "1 m"]}
    document = {"camera": view, "sources": [lamp], "materials": {"white": material}, "targets": [sheet]}
    return radwrap.scene_from_document(document, folder=folder)


def colour_camera(pattern: Pattern = "RGGB", **changes: Any) -> dict[str, Any]:
    return {"mosaic": pattern, "filters": FILTERS, **changes}


PAINT = "wavelength [nm],reflectance\n380,0.1\n500,0.2\n560,0.9\n780,0.4\n"


@pytest.mark.parametrize("kind", ["broad light", "one line", "one wavelength"])
def test_a_raw_flat_field_is_three_monochrome_images(kind: str, tmp_path: Path) -> None:
    """Each pixel must be that of a monochrome camera with its own quantum efficiencies, which knows no mosaic."""
    how: dict[str, Any] = {
        "broad light": {"light": {"preset": "E"}, "paint": PAINT},
        "one line": {"light": {"line": "550 nm", "width": "4 nm"}},
        "one wavelength": {},
    }[kind]
    raw = radwrap.render(scene_with(colour_camera(), tmp_path, **how), tmp_path / "raw", **QUICK)
    mosaic = Mosaic("RGGB", (), (), ())
    for colour in COLOURS:
        alone = {"quantum_efficiencies": tables(colour)} if how else {"quantum_efficiency": at_550(colour)}
        gray = radwrap.render(scene_with(alone, tmp_path, **how), **QUICK).gray.values
        for place in mosaic.places(colour):
            assert raw.gray.values[place] == pytest.approx(gray[place], rel=STORED)
        assert gray.min() > 100 and gray.max() < 3000  # neither dark nor saturated
    assert raw.run.mosaic is not None
    renders = {plane.light_of for plane in raw.run.mosaic.colours.values()}
    assert len(renders) == (3 if kind == "broad light" else 1)
    assert sorted(path.name for path in (tmp_path / "raw" / "planes").iterdir()) == sorted(renders)


def test_gray_levels_of_each_colour_are_the_standards() -> None:
    """mu_y = offset + K eta mu_p with each colour's own eta."""
    scene = scene_with(colour_camera("GBRG"))
    raw = radwrap.render(scene, **QUICK)
    mono = radwrap.render(scene_with({"quantum_efficiency": 1.0}), **QUICK)
    photons = closed.photons(mono.radiant_exposure.values, 25e-12, 550e-9)
    for colour in COLOURS:
        expected = closed.transfer_mean(at_550(colour) * photons, gain=0.3, offset=64)
        for place in Mosaic("GBRG", (), (), ()).places(colour):
            assert raw.gray.values[place] == pytest.approx(expected[place], rel=STORED)
            assert raw.electrons[place] == pytest.approx(at_550(colour) * photons[place], rel=STORED)


def test_noise_of_each_colour_is_the_standards() -> None:
    """sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 with each colour's own mu_e, over 40 frames."""
    raw = radwrap.render(scene_with(colour_camera(rounding=True)), **QUICK)
    frames = np.stack([frame.values for frame in raw.frames(40)])
    variances = {}
    for colour in COLOURS:
        places = raw.scene.camera.sensor.mosaic.places(colour)  # type: ignore[union-attr]
        variance = np.concatenate([frames[:, *place].var(axis=0, ddof=1).ravel() for place in places])
        electrons = np.concatenate([raw.electrons[place].ravel() for place in places])
        sigma = np.concatenate([raw.sigma[place].ravel() for place in places])
        expected = closed.transfer_variance(electrons, gain=0.3, read_noise=8.0)
        error = expected.mean() * math.sqrt(2 / (39 * variance.size))
        assert abs(variance.mean() - expected.mean()) < SURE * error
        assert sigma.mean() ** 2 == pytest.approx(expected.mean(), rel=0.01)  # the rays' own error is small
        variances[colour] = expected.mean()
    assert variances["green"] > 2 * variances["red"]  # the colours differ, or nothing was tested


def test_a_colour_saturates_at_its_own_light() -> None:
    raw = radwrap.render(scene_with(colour_camera(), level=60.0), **QUICK)
    mosaic = Mosaic("RGGB", (), (), ())
    full = raw.scene.camera.sensor.saturation_gray
    green = np.concatenate([raw.gray.values[place].ravel() for place in mosaic.places("green")])
    (blue,) = mosaic.places("blue")
    assert (green == full).all() and (raw.gray.values[blue] < full).all()
    assert raw.run.mosaic is not None and math.isfinite(raw.error.rms_gray_upper95)
    # Saturated light bounds nothing, so the others have renders of their own.
    assert {colour: plane.light_of for colour, plane in raw.run.mosaic.colours.items()} == {c: c for c in COLOURS}


def test_the_error_is_told_of_each_colour(tmp_path: Path) -> None:
    scene = scene_with(colour_camera(), tmp_path, light={"preset": "E"}, paint=PAINT)
    made = radwrap.render(scene, tmp_path / "out", tolerance=2, seed=1)
    known = read_run_manifest(tmp_path / "out")
    assert known.mosaic is not None and known.mosaic.pattern == "RGGB" and len(known.mosaic.filters_sha256) == 64
    planes = known.mosaic.colours
    whole = sum(plane.pixels for plane in planes.values())
    assert whole == 31 * 42 and planes["green"].pixels == 31 * 42 // 2
    mean = sum(plane.pixels * plane.error.rms_gray_upper95**2 for plane in planes.values()) / whole
    assert made.error.rms_gray_upper95 == pytest.approx(math.sqrt(mean))
    assert made.error.rms_gray_upper95 < 2
    for colour in COLOURS:
        own = read_run_manifest(tmp_path / "out" / "planes" / colour)
        assert planes[colour].error == own.error and planes[colour].run_sha256 == own.run_sha256


def test_a_raw_image_has_the_same_bytes_again(tmp_path: Path) -> None:
    scene = scene_with(colour_camera(), tmp_path, light={"preset": "E"}, paint=PAINT)
    for name, workers in (("one", 1), ("two", 2)):
        radwrap.render(scene, tmp_path / name, tolerance=8, frames=1, truth=True, workers=workers)
    runs = [read_run_manifest(tmp_path / name) for name in ("one", "two")]
    assert runs[0].files == runs[1].files and runs[0].run_sha256 == runs[1].run_sha256
    assert {"gray.png", "frame_0000.png", "truth.json", "gray_sigma.exr"} <= set(runs[0].files)


def test_colours_of_an_older_run_do_not_stay(tmp_path: Path) -> None:
    out = tmp_path / "out"
    radwrap.render(scene_with(colour_camera(), tmp_path, light={"preset": "E"}, paint=PAINT), out, **QUICK)
    assert len(list((out / "planes").iterdir())) == 3
    radwrap.render(scene_with(colour_camera()), out, **QUICK)
    assert [path.name for path in (out / "planes").iterdir()] == ["green"]
    radwrap.render(scene_with({"quantum_efficiency": 0.5}), out, **QUICK)
    assert not (out / "planes").exists()


def test_stated_tolerances_have_slopes_of_each_colour(tmp_path: Path) -> None:
    document = json.loads(scene_with(colour_camera()).document) | {"tolerances": {"source_radiance": 0.1}}
    made = radwrap.render(radwrap.scene_from_document(document), tmp_path, **QUICK)
    assert made.run.mosaic is not None
    assert all(plane.light_of == colour for colour, plane in made.run.mosaic.colours.items())
    signal = made.gray.values - 64
    part = signal * 0.1 / 1.96  # a tolerance holds 95 %
    noise = 0.3**2 * (64 + signal / 0.3)
    assert made.sigma == pytest.approx(np.sqrt(part**2 + noise), rel=0.02)


def test_another_exposure_needs_no_ray_and_other_filters_do() -> None:
    made = radwrap.render(scene_with(colour_camera()), **QUICK)
    half = made.with_exposure("500 ms")
    assert half.gray.values - 64 == pytest.approx((made.gray.values - 64) / 2, rel=STORED)
    assert half.error.rms_gray_upper95 == pytest.approx(made.error.rms_gray_upper95 / 2) and half.run.mosaic is None
    for change in ({"mosaic": "BGGR"}, {"filters": FILTERS | {"red": {"quantum_efficiency": 0.3}}}):
        with pytest.raises(InputError, match="mosaic"):
            made.with_sensor(**change)
    with pytest.raises(InputError, match="mosaic"):
        made.with_sensor(wavelength="600 nm")


def test_one_colour_for_all_pixels_is_a_monochrome_camera(tmp_path: Path) -> None:
    scene = scene_with(colour_camera() | {"mosaic": "blue"})
    assert scene.camera.sensor.mosaic is None
    gray = radwrap.render(scene, **QUICK).gray.values
    assert gray == pytest.approx(
        radwrap.render(scene_with({"quantum_efficiency": at_550("blue")}), **QUICK).gray.values
    )


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_opencv_gives_back_known_colours(pattern: Pattern, tmp_path: Path) -> None:
    """Of an even picture of red 200, green 90, blue 30: its names of patterns begin in the second row."""
    levels: dict[Colour, int] = {"red": 200, "green": 90, "blue": 30}
    raw = np.zeros((9, 12), dtype=np.uint8)
    for colour, level in levels.items():
        for place in Mosaic(pattern, (), (), ()).places(colour):
            raw[place] = level
    assert (demosaiced(raw, pattern) == np.array([200, 90, 30])).all()
    write_colour(tmp_path, raw, pattern)
    assert (cv2.imread(str(tmp_path / "colour.png"))[4, 4] == [30, 90, 200]).all()  # blue first
    with pytest.raises(InputError, match="too small"):
        demosaiced(raw[:2], pattern)


def test_more_bits_stay_as_they_are() -> None:
    raw = np.full((6, 6), 3000, dtype=np.uint16)
    assert demosaiced(raw, "RGGB").dtype == np.uint16 and (demosaiced(raw, "RGGB") == 3000).all()


def test_what_knows_one_filter_refuses_a_mosaic_by_name() -> None:
    with pytest.raises(InputError) as caught:
        radwrap.warm(scene_with(colour_camera()))
    assert "mosaic" in str(caught.value) and '"red", "green" or "blue"' in str(caught.value)


def test_the_raw_image_is_what_the_file_holds(tmp_path: Path) -> None:
    made = radwrap.render(scene_with(colour_camera(rounding=True)), tmp_path, **QUICK)
    assert (read_gray(tmp_path / "gray.png").values == made.gray.values).all()
