"""What diffraction would change of an image, against closed forms of an edge, and where it is reported."""

from __future__ import annotations

import json
import math
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.forecast import wave_change as measured
from radwrap.imaging.forecast.effects import effects
from radwrap.imaging.forecast.wave_change import wave_change
from radwrap.imaging.optics.diffraction import wavelength_of
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.camera import Aperture, ApertureShape, Camera, Lens
from radwrap.tracers.tracer import Tracer
from tests.imaging.planes import Array, Planes, camera
from tests.imaging.wave_edge import COLUMNS, PIXEL, WAVELENGTH
from tests.imaging.wave_edge import expected as step_and_waves

# Cells of a quarter of the wave's length and a ray in each: measured on edges in and out of focus, 1 to 3 %.
COARSE = 0.05
# Of pixels in strata, whose edge pixels are some hundred: of one draw, and of the mean square of four.
ONE_SPREAD, SPREAD = 0.45, 0.25
# Cells of four times the size: measured 13 %.
FEW = 0.2
BENCH = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"

CHART = BENCH.parents[1] / "colour_chart" / "scene.toml"
CHART_OF_80 = {
    "camera.sensor.mosaic": "green",
    **{"camera.sensor.rows": 60, "camera.sensor.columns": 80},
    **{"camera.sensor.pixel_width": "27.6 um", "camera.sensor.pixel_height": "27.6 um"},
}


def edge(x: Array, y: Array) -> Array:
    return np.where(x > 0, 1.0, 0.2)


def seen(aperture: Aperture, focus: float | None, rows: int = 64) -> View:
    """A step across the columns at 1 m, through a pinhole, or a lens focused somewhere."""
    plain = camera(aperture, rows=rows, columns=COLUMNS, pixel=(PIXEL, PIXEL))
    lens = None if focus is None else Lens(focus)
    tracer: Tracer = Planes(((1.0, edge),))  # type: ignore[assignment]
    return View(replace(plain, lens=lens), tracer)


def expected(of: Camera) -> float:
    """Rms over the columns of what waves change of the step behind a square opening [gray level]."""
    _, change = step_and_waves(of, 0.0)
    exposure = of.exposure_time * of.aperture.area / of.image_distance**2
    return of.sensor.gain * exposure * math.sqrt(float((change**2).mean()))


@pytest.mark.parametrize(
    ("side", "focus", "within"),
    [
        *((side, focus, COARSE) for side, focus in ((1e-4, None), (3e-4, None), (5e-4, 1.0), (1e-3, 0.6))),
        (2e-3, 1.0, ONE_SPREAD),
    ],
    ids=["pinhole of Fresnel number .5", "of 4", "focused", "out of focus", "finer than a pixel"],
)
def test_an_edge_changes_as_its_closed_form(side: float, focus: float | None, within: float) -> None:
    view = seen(Aperture("square", side), focus)
    square, rays = wave_change(view, WAVELENGTH, 1)
    known = expected(view.camera)
    assert math.sqrt(square.mean) == pytest.approx(known, rel=within)
    assert math.sqrt(square.upper) > known
    assert rays < 2 * measured.MOST_RAYS


@pytest.mark.parametrize(("side", "focus"), [(3e-4, None), (5e-4, 1.0)])
def test_pixels_in_strata_find_the_same(side: float, focus: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measured._Grid, "rays", lambda *_: measured.MOST_RAYS)  # as of a large image
    view = seen(Aperture("square", side), focus)
    found = [wave_change(view, WAVELENGTH, seed)[0] for seed in range(4)]
    known = expected(view.camera)
    assert math.sqrt(np.mean([one.mean for one in found])) == pytest.approx(known, rel=SPREAD)
    assert sum(math.sqrt(one.upper) > known for one in found) >= 3


@pytest.mark.long
def test_a_bound_holds_where_few_pixels_hold_nearly_all_that_changes() -> None:
    """One column of a chart's pixels lies along an edge: what they change is known from images with and without waves.

    With half as many pixels, of four times as many rays each, 4 of 16 bounds lay below it.
    """
    scene = radwrap.load_scene(CHART)
    for key, value in CHART_OF_80.items():
        scene = radwrap.with_value(scene, key, value)
    on, off = (
        radwrap.render(radwrap.with_value(scene, "camera.diffraction", word), tolerance=0.7, tracer="compiled")
        for word in ("on", "off")
    )
    levels = [gray_levels(one.radiant_exposure.values, scene.camera.sensor) for one in (on, off)]
    known = float(np.sqrt(np.mean((levels[0] - levels[1]) ** 2)))
    assert known == pytest.approx(1.74, abs=0.2)  # 1.73 to 1.75 at tolerances of 0.1 and 0.2
    lit = radwrap.with_value(scene, "camera.diffraction", "on")
    with traced_scene(lit, radwrap.RenderOptions(tracer="compiled", workers=1)) as view:
        found = [wave_change(view, wavelength_of(lit)[0], seed, 1 << 13)[0] for seed in range(16)]
    assert sum(math.sqrt(one.upper) > known for one in found) >= 15


def test_nothing_changes_without_an_opening_or_an_edge() -> None:
    assert wave_change(seen(Aperture("round", 0.0), None), WAVELENGTH, 1)[0].upper == 0
    view = seen(Aperture("round", 1e-4), None)
    even: Tracer = Planes(((1.0, lambda x, y: np.ones_like(x)),))  # type: ignore[assignment]
    for most in (measured.MOST_RAYS, 1 << 12):
        square, _ = wave_change(replace(view, tracer=even), WAVELENGTH, 1, most)
        assert math.sqrt(square.upper) < 0.1, most  # of 100 gray; cos^4 bends the field a little


@pytest.mark.parametrize("diameter", [2e-6, 2e-5])
def test_an_opening_of_some_wavelengths_is_no_great_work(diameter: float) -> None:
    square, rays = wave_change(seen(Aperture("round", diameter), None), WAVELENGTH, 1)
    assert square.mean > 1 and rays < 2 * measured.MOST_RAYS


@pytest.mark.parametrize("shape", ["round", "square", "annular", "half_disc"])
def test_an_opening_of_thousands_of_fringes_is_no_great_work(shape: ApertureShape) -> None:
    """A blur of 14 000 wave's lengths, as of a pinhole of 10 mm: rays do, and little memory and time show that."""
    inner = {"inner_diameter": 3e-3} if shape == "annular" else {}
    start = time.process_time()
    square, rays = wave_change(seen(Aperture(shape, 1e-2, **inner), None, rows=8), WAVELENGTH, 1)
    assert math.sqrt(square.mean if square.mean > 0 else 0.0) < 0.1 and rays < 2 * measured.MOST_RAYS
    assert time.process_time() - start < 10


def test_few_rays_find_about_the_same() -> None:
    view = seen(Aperture("square", 1e-4), None)
    square, rays = wave_change(view, WAVELENGTH, 1, 1 << 13)
    assert math.sqrt(square.mean) == pytest.approx(expected(view.camera), rel=FEW)
    assert math.sqrt(square.upper) > expected(view.camera) and rays < 1 << 13


def scene_of(**camera_values: object) -> radwrap.Scene:
    document = tomllib.loads(BENCH.read_text())
    document["camera"] |= {"diffraction": "off", **camera_values}
    return radwrap.scene_from_document(document)


def test_a_render_says_what_waves_would_change_beside_its_error() -> None:
    """The known numbers of this scene, by a finer central image: 4.3, 5.1 and 6.2 gray rms, good to .3."""
    result = radwrap.render(scene_of(), tolerance=2)
    left = result.left_out["diffraction"]
    assert left.rms_gray == pytest.approx(5.1, abs=0.3) and left.needed and left.rms_gray_upper95 > 5.1
    assert result.manifest["left_out"]["diffraction"]["rms_gray"] == left.rms_gray
    assert any("diffraction" in line for line in result.run.warnings)
    assert f"leaves out (gray rms): diffraction {left.rms_gray:.2g} (at most" in repr(result)
    assert result.scene.assumed["camera.wavelength"] == "550 nm"
    # Of half the light, to the power of the sensor's gamma, there is less to change, and its warning says so.
    made = result.with_exposure("193.5 ms")
    less = made.left_out["diffraction"].rms_gray
    assert less == pytest.approx(0.5**result.scene.camera.sensor.gamma * left.rms_gray)
    assert [line for line in made.run.warnings if f"about {less:.2g} gray" in line]
    assert not [line for line in made.run.warnings if f"about {left.rms_gray:.2g} gray" in line]


@pytest.mark.parametrize(("wavelength", "known"), [("450 nm", 4.3), ("650 nm", 6.2)])
def test_the_wavelength_that_a_camera_tells_counts(wavelength: str, known: float) -> None:
    scene = scene_of(wavelength=wavelength)
    assert "camera.wavelength" not in scene.assumed
    found = {one["name"]: one for one in effects(scene, radwrap.RenderOptions(tolerance=2))["effects"]}
    assert found["diffraction"]["rms_gray"] == pytest.approx(known, abs=0.3)
    assert radwrap.explain(scene)["diffraction"]["wavelength"] == pytest.approx(float(wavelength[:3]) * 1e-9)


def test_a_wavelength_is_told_once() -> None:
    linear = json.loads(json.dumps(tomllib.loads(BENCH.read_text())))
    linear["camera"]["sensor"] = {
        **{"model": "linear", "rows": 8, "columns": 8, "pixel_width": "5 um", "pixel_height": "5 um"},
        **{"wavelength": "630 nm", "quantum_efficiency": 0.5, "system_gain": "0.1 DN/e", "offset": 0},
        **{"full_well": "10000 e", "read_noise": "3 e"},
    }
    assert "camera.wavelength" not in radwrap.scene_from_document(linear).assumed
    linear["camera"]["wavelength"] = "630 nm"
    with pytest.raises(InputError, match=r"sensor\.wavelength gives it already"):
        radwrap.scene_from_document(linear)
    spectra = tomllib.loads(BENCH.read_text())
    spectra["sources"][0]["spectrum"] = {"line": "630 nm", "width": "20 nm"}
    assert "camera.wavelength" not in radwrap.scene_from_document(spectra).assumed
    spectra["camera"]["wavelength"] = "630 nm"
    with pytest.raises(InputError, match=r"spectra give the wavelength already"):
        radwrap.scene_from_document(spectra)
    pinhole = tomllib.loads(BENCH.read_text())
    pinhole["camera"]["aperture"] = {"diameter": "0 mm"}
    assert "camera.wavelength" not in radwrap.scene_from_document(pinhole).assumed
