"""Tolerances in the user's coin: shares of the range and of a frame's noise, and the default of a linear camera."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap import RenderOptions
from radwrap.errors import InputError
from radwrap.imaging.asked_tolerance import asked_tolerance
from radwrap.imaging.mean_radiance import how
from radwrap.imaging.render_options import RenderOptions as Options
from radwrap.imaging.tolerance.lit_noise import lit_noise
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.file.load import scene_from_document
from radwrap.validate.closed_forms import sensor as closed
from tests.physics.conftest import Bench

GAIN, READ, OFFSET, WELL = 0.25, 8.0, 100.0, 12000.0
EFFICIENCY, WAVELENGTH, PITCH, EXPOSURE, FOCAL = 0.6, 650e-9, 5e-6, 1e-3, 0.05
OPENING = 1e-7  # m; a point of the wall is blurred over a fiftieth of a pixel
COLUMNS, ROWS = 40, 20
# cos^4 over the field, which is .15 degrees wide, and the pixels that see a little of both panels.
NARROW = 5e-4


def panels(electrons: tuple[float, float], **sensor: Any) -> radwrap.Scene:
    """A camera that sees two panels shine, side by side, each of which fills half of its pixels."""
    table: dict[str, Any] = {
        "model": "linear",
        "rows": ROWS,
        "columns": COLUMNS,
        "pixel_width": f"{PITCH} m",
        "pixel_height": f"{PITCH} m",
        "bit_depth": 12,
        "wavelength": f"{WAVELENGTH} m",
        "quantum_efficiency": EFFICIENCY,
        "system_gain": f"{GAIN} DN/e",
        "offset": OFFSET,
        "full_well": f"{WELL} e",
        "read_noise": f"{READ} e",
        "dsnu": "30 e",  # the same in every frame: no temporal noise
        "prnu": 0.05,
    }
    table |= sensor
    # H = tau A/f^2 L, and mu_e = eta A_px lambda/(h c) H.
    opening = math.pi / 4 * OPENING**2
    of_radiance = EXPOSURE * opening / FOCAL**2 * EFFICIENCY * closed.photons(1.0, PITCH**2, WAVELENGTH)
    shining = [
        {
            "type": "rectangle",
            "name": name,
            "position": Bench.metres(x, 0, 0),
            "look_at": Bench.metres(x, 0, 1),
            "size": Bench.metres(0.1, 0.1),
            "radiance": f"{count / of_radiance!r} W/m^2/sr",
        }
        for name, x, count in (("bright", -0.05, electrons[0]), ("dim", 0.05, electrons[1]))
    ]
    view = Bench.camera(focal_length=FOCAL, aperture={"diameter": f"{OPENING} m"}) | {
        "exposure_time": f"{EXPOSURE} s",
        "sensor": table,
    }
    wall = {"type": "sheet", "material": "black", "size": ["1 m", "1 m"], "position": Bench.metres(0, 0, -0.1)}
    black = {"type": "lambertian", "reflectance": 0.0}
    document = {"camera": view, "sources": shining, "materials": {"black": black}, "targets": [wall | {"name": "wall"}]}
    return scene_from_document(document, origin="panels", folder=Path())


@pytest.mark.parametrize(
    ("asked", "gray"),
    [(0.3, 0.3), ("0.2 %", 6.0), (" 1e-1% ", 3.0), ("0.5 noise", 9.7), ("2 noise", 38.0), (None, 9.7)],
)
def test_what_is_asked_in_gray_levels(asked: float | str | None, gray: float) -> None:
    sensor = panels((6000, 0)).camera.sensor
    assert sensor.saturation_gray - sensor.dark_gray == GAIN * WELL
    assert asked_tolerance(asked).in_gray(sensor, noise=19.47) == gray


def test_the_default_is_at_least_what_half_a_level_is_of_eight_bits() -> None:
    sensor = panels((6000, 0)).camera.sensor
    assert asked_tolerance(None).in_gray(sensor, noise=1.0) == 8.0  # 4095 x 0.5/255 = 8.03
    eight = panels((6000, 0), bit_depth=8, system_gain="0.02 DN/e", offset=2).camera.sensor
    assert asked_tolerance(None).in_gray(eight, noise=0.6) == 0.5


@pytest.mark.parametrize(
    "bad", ["", "0.5", "1 mm", "-1 %", "nan %", "0 noise", "1e9 %", "% 1", "1 noise noise", "9" * 99]
)
def test_other_texts_are_refused(bad: str) -> None:
    with pytest.raises(InputError) as error:
        RenderOptions(tolerance=bad)
    assert error.value.where == "tolerance" and len(str(error.value)) < 250


@pytest.mark.parametrize("electrons", [(6000.0, 300.0), (10000.0, 5000.0), (300.0, 200.0)])
def test_noise_is_that_of_the_lit_pixels(electrons: tuple[float, float]) -> None:
    """A pixel at less than a tenth of the brightest is not lit; the others' variances are averaged."""
    lit = [count for count in electrons if count > electrons[0] / 10]
    expected = math.sqrt(sum(GAIN**2 * (count + READ**2) + 1 / 12 for count in lit) / len(lit))
    with traced_scene(panels(electrons), RenderOptions(tracer="radiance")) as view:
        noise, rays = lit_noise(view)
    assert noise == pytest.approx(expected, rel=NARROW)
    assert rays == ROWS * COLUMNS * 4


@pytest.mark.long
def test_darkness_has_the_noise_of_darkness() -> None:
    with traced_scene(panels((1e-9, 1e-9))) as view:
        noise, _ = lit_noise(view)
    assert noise == pytest.approx(math.sqrt(GAIN**2 * READ**2 + 1 / 12), rel=1e-3)  # cut below 0 by nothing here


def test_a_linear_camera_is_rendered_to_half_of_its_noise() -> None:
    scene = panels((6000.0, 300.0))
    noise = math.sqrt(GAIN**2 * (6000 + READ**2) + 1 / 12)
    run = radwrap.render(scene).run
    assert run.tolerance == 9.7
    assert run.tolerance_asked is not None
    assert (run.tolerance_asked.asked, run.tolerance_asked.rays) == ("default", ROWS * COLUMNS * 4)
    assert run.tolerance_asked.noise_rms_gray == pytest.approx(noise, rel=NARROW)
    assert run.error.rms_gray_upper95 <= run.tolerance
    # Neither workers nor the seed of the rays decide it.
    assert radwrap.render(scene, seed=7, workers=1).run.tolerance == 9.7
    share = radwrap.render(scene, tolerance="0.2 %").run
    assert share.tolerance == 6.0 and share.tolerance_asked is not None and share.tolerance_asked.noise_rms_gray is None
    gray = radwrap.render(scene, tolerance=9.7)
    assert "tolerance_asked" not in gray.manifest
    assert (gray.gray.codes == radwrap.render(scene).gray.codes).all()


def test_the_noise_of_a_power_law_is_not_known() -> None:
    law = {"preset": "fivs", "rows": ROWS, "columns": COLUMNS, "pixel_width": "5 um", "pixel_height": "5 um"}
    scene = panels((6000.0, 300.0))
    document = json.loads(scene.document)
    scene = scene_from_document(
        {**document, "camera": {**document["camera"], "sensor": law}}, origin="panels", folder=Path()
    )
    with pytest.raises(InputError, match="no noise") as error:
        radwrap.render(scene, tolerance="0.5 noise")
    assert error.value.where == "tolerance"
    run = radwrap.render(scene).run
    assert run.tolerance == 0.5 and run.tolerance_asked is None
    # As ever: what a run is known by stays as it was, so that what was begun goes on.
    assert how(scene, Options()) == how(scene, Options(tolerance=0.5))


def test_gray_levels_are_known_by_what_they_ever_were() -> None:
    known = {
        "method": None,
        "tolerance": 0.5,
        "max_error": None,
        "budget_rays": None,
        "budget_seconds": None,
        "seed": 0,
    }
    scene = panels((6000.0, 300.0))
    assert how(scene, Options(tolerance=0.5)) == known
    assert how(scene, Options()) == known | {"tolerance": "default"}
