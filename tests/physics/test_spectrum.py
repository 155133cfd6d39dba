"""Spectra against quadrature: three materials under two lamps, and how many bands a tolerance takes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.imaging.banding import banding
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.bands import bands_of, fewest_groups, gray_error, scaled
from radwrap.scene.file.spectral import flux_of_beam
from radwrap.scene.materials import GlassBeads, Mirror, PrintedSheeting
from radwrap.scene.sources import Beam, TableBeam
from radwrap.scene.spectrum import Curve, integral, line, lumens_per_watt, luminous_efficiency, normalised_power, preset

Array = np.ndarray
# Of a pixel's radiance: rtrace's float32 and its one sample of a source of 1 mm at 0.6 m.
QUADRATURE = 1e-4

NM = np.arange(300, 1000.001, 0.02)  # the test's own grid [nm]
RED = {300: 0.05, 560: 0.05, 620: 0.6, 1000: 0.7}
GREEN = {300: 0.08, 480: 0.1, 530: 0.5, 580: 0.12, 1000: 0.2}
GRAY = {300: 0.3, 1000: 0.32}
RESPONSE = {350: 0.1, 450: 0.5, 550: 1.0, 700: 0.8, 1000: 0.05}
FILTER = {300: 0.2, 500: 0.9, 1000: 0.7}
TABLES = {"red": RED, "green": GREEN, "gray": GRAY, "response": RESPONSE, "filter": FILTER}
PLACES = {"red": -0.1, "green": 0.0, "gray": 0.1}


def table(points: dict[int, float]) -> Array:
    return np.interp(NM, list(points), list(points.values()), left=0.0, right=0.0)


def lamp_a(nm: Array) -> Array:
    """CIE illuminant A by its formula."""
    power = (560 / nm) ** 5 * (math.exp(1.435e7 / (2848 * 560)) - 1) / (np.exp(1.435e7 / (2848 * nm)) - 1)
    return np.where((nm >= 300) & (nm <= 830), power, 0.0)


def gauss(nm: Array) -> Array:
    return np.exp(-4 * math.log(2) * ((nm - 650) / 20) ** 2)


def expected_pairs() -> dict[str, dict[str, float]]:
    """W of each lamp on each material, by the trapezoidal rule in steps of 0.02 nm."""
    path = table(RESPONSE) * table(FILTER)
    found: dict[str, dict[str, float]] = {}
    for lamp, power in (("led", gauss(NM)), ("bulb", lamp_a(NM))):
        whole = np.trapezoid(power, NM)
        found[lamp] = {name: float(np.trapezoid(power * path * table(TABLES[name]), NM) / whole) for name in PLACES}
        found[lamp]["white"] = float(np.trapezoid(power * path, NM) / whole)
    return found


def write_tables(folder: Path) -> None:
    for name, points in TABLES.items():
        lines = "".join(f"{nm},{value}\n" for nm, value in points.items())
        (folder / f"{name}.csv").write_text(f"wavelength [nm],{name}\n{lines}")


def document(**camera: Any) -> dict[str, Any]:
    """Three sheets side by side, a lamp on either side."""
    sources = [
        {
            "type": "lamp",
            "name": name,
            "position": [x, "0 m", "600 mm"],
            "look_at": ["0 m", "0 m", "0 m"],
            "diameter": "1 mm",
            "radiant_intensity": level,
            "beam": {"profile": "cone", "width": "40 deg", "width_definition": "half_angle"},
            "spectrum": spectrum,
        }
        for name, x, level, spectrum in (
            ("led", "-200 mm", "2 W/sr", {"line": "650 nm", "width": "20 nm"}),
            ("bulb", "250 mm", "3 W/sr", {"preset": "A"}),
        )
    ]
    return {
        "camera": {
            "position": ["0 m", "0 m", "500 mm"],
            "look_at": ["0 m", "0 m", "0 m"],
            "focal_length": "8 mm",
            "exposure_time": "6 s",
            "sensor": {"preset": "fivs", "rows": 12, "columns": 60, "pixel_width": "90 um", "pixel_height": "90 um"},
            "spectral_response": {"file": "response.csv"},
            "filter": {"file": "filter.csv"},
            **camera,
        },
        "sources": sources,
        "materials": {
            name: {"type": "lambertian", "reflectance": 1.0, "spectrum": {"file": f"{name}.csv"}} for name in PLACES
        },
        "targets": [
            {
                "type": "sheet",
                "name": name,
                "material": name,
                "size": ["90 mm", "90 mm"],
                "position": [f"{x!r} m", "0 m", "0 m"],
            }
            for name, x in PLACES.items()
        ],
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_tables(tmp_path)
    return tmp_path


def seen(scene: radwrap.Scene, tolerance: float) -> tuple[dict[str, float], int]:
    """Radiance of each sheet's middle as Radiance gives it, and the number of bands."""
    rays = np.array([[x, 0.0, 0.4, 0.0, 0.0, -1.0] for x in PLACES.values()])
    options = RenderOptions(tolerance=tolerance)
    with traced_scene(scene, options) as view:
        values = np.concatenate(list(view.tracer.trace([rays])))
    found = banding(scene, options).bands
    assert found is not None
    return dict(zip(PLACES, values.tolist(), strict=True)), len(found.bands)


def closed(pairs: dict[str, dict[str, float]]) -> dict[str, float]:
    """E of each lamp by I cos/d^2, times W/pi."""
    lamps = {"led": (-0.2, 2.0), "bulb": (0.25, 3.0)}
    return {
        name: sum(
            intensity * 0.6 / ((x - place) ** 2 + 0.36) ** 1.5 * pairs[lamp][name] / math.pi
            for lamp, (place, intensity) in lamps.items()
        )
        for name, x in PLACES.items()
    }


def test_three_materials_under_two_lamps_are_those_of_quadrature(folder: Path) -> None:
    """Must hold to 1e-4 with as few bands as a fine tolerance needs, and within the stated error with fewer."""
    scene = radwrap.scene_from_document(document(), folder=folder)
    expected = closed(expected_pairs())
    values, bands = seen(scene, 0.01)
    off = {name: values[name] / expected[name] - 1 for name in PLACES}
    print(f"{bands} bands, off by {', '.join(f'{name} {value:.1e}' for name, value in off.items())}")
    assert bands == 2 and max(map(abs, off.values())) < QUADRATURE
    assert scene.spectral is not None
    whole = bands_of(scene.spectral, math.inf)
    assert len(whole.bands) == 1 and whole.error > 0.1  # one band would show red as the lamps' mean


def through_pane(cosine: float, transmittance: float, index: float = 1.52) -> float:
    """Of a pane with both faces and all light that goes to and fro in it, by Fresnel, mean of both polarisations."""
    inside = math.sqrt(1 - (1 - cosine**2) / index**2)
    faces = ((cosine - index * inside) / (cosine + index * inside)) ** 2
    other = ((index * cosine - inside) / (index * cosine + inside)) ** 2
    upright = ((index - 1) / (index + 1)) ** 2
    # What the glass itself lets through at right angles, from (1 - r)^2 t/(1 - r^2 t^2) = transmittance.
    half = (1 - upright) ** 2 / (2 * upright**2 * transmittance)
    way = (math.sqrt(half**2 + 1 / upright**2) - half) ** (1 / inside)
    return sum((1 - r) ** 2 * way / (1 - (r * way) ** 2) for r in (faces, other)) / 2


def test_colours_behind_glass(folder: Path) -> None:
    """The pane is alike in all bands: each lamp loses what its own angle says, and what is seen once more."""
    made = document()
    made["materials"]["pane"] = {"type": "glass", "transmittance": 0.8}
    pane = {"type": "sheet", "name": "pane", "material": "pane", "size": ["900 mm", "400 mm"]}
    made["targets"].append({**pane, "position": ["0 m", "0 m", "300 mm"]})
    scene = radwrap.scene_from_document(made, folder=folder)
    values, bands = seen(scene, 0.01)
    assert bands == 2
    assert scene.spectral is not None and all(scene.spectral.reflectance[i][-1] == 1.0 for i in (0, 1))
    pairs = expected_pairs()
    for name, x in PLACES.items():
        expected = 0.0
        for lamp, (place, intensity) in {"led": (-0.2, 2.0), "bulb": (0.25, 3.0)}.items():
            square = (x - place) ** 2 + 0.36
            lost = through_pane(0.6 / math.sqrt(square), 0.8) * through_pane(1.0, 0.8)
            expected += intensity * 0.6 / square**1.5 * pairs[lamp][name] / math.pi * lost
        assert values[name] == pytest.approx(expected, rel=QUADRATURE)


def test_a_wide_source_has_its_own_colour_on_each_material(folder: Path) -> None:
    made = document()
    made["sources"][1] = {
        "type": "rectangle",
        "name": "bulb",
        "position": ["250 mm", "0 m", "600 mm"],
        "look_at": ["0 m", "0 m", "0 m"],
        "size": ["60 mm", "200 mm"],
        "radiance": "100 W/m^2/sr",
        "irradiance_error": 0.05,
        "spectrum": {"preset": "A"},
    }
    found, bands = seen(radwrap.scene_from_document(made, folder=folder), 0.1)
    assert bands == 2
    pairs = expected_pairs()
    expected = dict.fromkeys(PLACES, 0.0)
    rays = np.array([[x, 0.0, 0.4, 0.0, 0.0, -1.0] for x in PLACES.values()])
    for source in made["sources"]:
        # The same light without colours, on white: what a pair of source and material multiplies.
        plain = document()
        for key in ("spectral_response", "filter"):
            del plain["camera"][key]
        plain["sources"] = [{key: value for key, value in source.items() if key != "spectrum"}]
        plain["materials"] = {name: {"type": "lambertian", "reflectance": 1.0} for name in PLACES}
        with traced_scene(radwrap.scene_from_document(plain)) as view:
            white = np.concatenate(list(view.tracer.trace([rays])))
        for name, value in zip(PLACES, white.tolist(), strict=True):
            expected[name] += value * pairs[source["name"]][name]
    assert found == pytest.approx(expected, rel=QUADRATURE)


def test_bands_against_the_asked_error(folder: Path) -> None:
    """Four lamps, two of nearly the same light: 4, 3, 2, 1 bands as the error grows, each within what it states."""
    given = document()
    for name, spectrum in (("second", {"line": "648 nm", "width": "20 nm"}), ("day", {"preset": "D65"})):
        given["sources"].append({**given["sources"][0], "name": name, "spectrum": spectrum})
    scene = radwrap.scene_from_document(given, {"camera.filter": {"file": "filter.csv"}}, folder=folder)
    assert scene.spectral is not None
    numbers = []
    for allowed in (1e-6, 1e-4, 1e-3, 1e-2, 0.1, 0.2, 0.3, 1.0):
        found = bands_of(scene.spectral, allowed)
        numbers.append(len(found.bands))
        assert found.error <= allowed
        print(f"allowed {allowed:g}: {numbers[-1]} bands, error {found.error:.2e}")
    assert set(numbers) == {1, 2, 3, 4} and numbers == sorted(numbers, reverse=True)


def test_a_narrow_led_needs_one_band(folder: Path) -> None:
    given = document()
    del given["sources"][1]
    scene = radwrap.scene_from_document(given, folder=folder)
    pairs = expected_pairs()["led"]
    values, bands = seen(scene, 0.01)
    assert bands == 1
    for name, x in PLACES.items():
        assert values[name] == pytest.approx(
            2.0 * 0.6 / ((x + 0.2) ** 2 + 0.36) ** 1.5 * pairs[name] / math.pi, rel=1e-4
        )
    assert scene.spectral is not None and scene.spectral.wavelength == pytest.approx(650e-9, rel=2e-3)


def test_wavelengths_are_as_far_apart_as_their_lines(folder: Path) -> None:
    """Two narrow lines of equal light, 500 and 600 nm: 50/550 from their mean, and half of that squared."""
    given = document()
    for key in ("spectral_response", "filter"):
        given["camera"].pop(key, None)
    for material in given["materials"].values():
        material.pop("spectrum", None)
    given["sources"][1] = {**given["sources"][0], "name": "other"}
    for source, mean in zip(given["sources"], ("500 nm", "600 nm"), strict=True):
        source["spectrum"] = {"line": mean, "width": "2 nm"}
    scene = radwrap.scene_from_document(given, folder=folder)
    apart = 50 / 550
    assert scene.spectral is not None and scene.spectral.wavelength == pytest.approx(550e-9, rel=1e-5)
    assert scene.spectral.wavelength_spread == pytest.approx(apart + apart**2 / 2, rel=1e-3)
    assert scene.spectral.wavelengths == pytest.approx([500e-9, 600e-9], rel=1e-6)
    sigma = 2 / math.sqrt(8 * math.log(2))
    assert scene.spectral.wavelength_spreads == pytest.approx([(sigma / w) ** 2 / 2 for w in (500, 600)], rel=2e-3)


def test_fewest_groups_are_the_fewest() -> None:
    """A chain of neighbours that fit pair by pair: pairs of neighbours, not what comes first."""
    rows = [[1.0], [1.2], [0.83], [1.45]]  # sorted: .83 1 1.2 1.45, each 20 % above the one before
    assert sorted(map(sorted, fewest_groups(rows, 0.1))) == [[0, 2], [1, 3]]
    assert fewest_groups([[1.0, 0.0], [1.0, 0.5]], 10.0) == [[0], [1]]  # nothing stands for zero but zero
    assert fewest_groups([], 0.1) == []


def test_the_image_keeps_its_bound_with_fewer_bands(folder: Path) -> None:
    """At a coarse tolerance lamps of like light share a band: the bound is raised by what that may change."""
    given = document()
    given["sources"][1] = {**given["sources"][1], "spectrum": {"line": "646 nm", "width": "20 nm"}}
    scene = radwrap.scene_from_document(given, folder=folder)
    fine, coarse = (radwrap.render(scene, method="pinhole", tolerance=tolerance) for tolerance in (0.001, 20.0))
    assert len(fine.manifest["bands"]["sources"]) == 2 and len(coarse.manifest["bands"]["sources"]) == 1
    told = coarse.manifest["error"]["bands_gray"]
    assert 0 < told == pytest.approx(gray_error(scene.camera.sensor, coarse.manifest["bands"]["relative_error"]))
    both = fine.radiant_exposure.values, coarse.radiant_exposure.values
    off = np.abs(both[1] / np.where(both[0] > 0, both[0], 1.0) - 1)[both[0] > 0].max()
    assert 1e-4 < off <= coarse.manifest["bands"]["relative_error"] + 1e-6
    assert coarse.manifest["error"]["rms_gray_upper95"] >= told


def test_curves_integrate_as_polynomials_do() -> None:
    rising, falling = Curve((1.0, 3.0), (0.0, 2.0)), Curve((0.0, 2.0, 4.0), (4.0, 2.0, 0.0))
    assert integral(rising, falling) == pytest.approx(22 / 3 - 4, rel=1e-12)  # (x - 1)(4 - x) from 1 to 3
    assert integral(rising, Curve((5.0, 6.0), (1.0, 1.0))) == 0.0
    assert integral(line(650e-9, 20e-9)) == pytest.approx(20e-9 * math.sqrt(math.pi / math.log(2)) / 2, rel=1e-5)
    assert integral(luminous_efficiency()) == pytest.approx(106.857e-9, rel=2e-5)  # the CIE's sum in nm


def test_presets_have_the_efficacies_that_their_tables_say() -> None:
    """By the trapezoidal rule on the nodes of 10 nm, as CIE 15 sums; monochromatic 555 nm has 683 lm/W."""
    for name, at_560, at_450 in (("D65", 100.0, 117.008), ("A", 100.0, 33.0859)):
        curve = preset(name)
        assert curve.at(np.array([560e-9, 450e-9])) == pytest.approx([at_560, at_450], rel=1e-5)
    assert lumens_per_watt(normalised_power(line(555e-9, 0.1e-9), "")) == pytest.approx(683, rel=1e-3)
    assert lumens_per_watt(normalised_power(line(650e-9, 0.1e-9), "")) == pytest.approx(683 * 0.107, rel=2e-3)


def test_beams_have_the_flux_of_their_closed_forms() -> None:
    assert flux_of_beam(Beam("lambertian")) == pytest.approx(math.pi, rel=1e-9)
    assert flux_of_beam(Beam("cone", 0.3)) == pytest.approx(2 * math.pi * (1 - math.cos(0.3)), rel=1e-9)
    n = 1 / 0.2**2
    assert flux_of_beam(Beam("cosine_power", 0.2)) == pytest.approx(2 * math.pi / (n + 1), rel=1e-9)
    assert flux_of_beam(Beam("gaussian", 0.01)) == pytest.approx(2 * math.pi * 1e-4 * (1 - 1e-4 / 3), rel=1e-7)


@pytest.mark.parametrize("end", [0.05, 0.5, 10.0, 89.9])
def test_a_beam_table_has_the_flux_of_its_straight_pieces(end: float) -> None:
    """Even light up to an edge, which falls to nothing in one step: the integral by hand."""
    step = math.radians(0.05)
    inner = math.radians(end)
    values = tuple(1.0 if angle <= end + 1e-6 else 0.0 for angle in np.linspace(0, 90, 1801))
    # 1 to the edge; then (outer - theta)/step.
    outer = inner + step
    slope = math.cos(inner) - (math.sin(outer) - math.sin(inner)) / step
    assert flux_of_beam(TableBeam("table", 1.0, values=values)) == pytest.approx(
        2 * math.pi * (1 - math.cos(inner) + slope), rel=1e-6
    )


def test_what_no_spectrum_colours_stays_as_it_is(folder: Path) -> None:
    """Mirrors beside spectra; a print over sheeting is dimmed in both of its parts."""
    plain = document()
    plain["materials"]["gray"] = {"type": "mirror", "reflectance": 0.8}
    scene = radwrap.scene_from_document(plain, folder=folder)
    assert scene.spectral is not None
    for band in bands_of(scene.spectral, 0.0).bands:
        assert band.materials["gray"] == Mirror(0.8)
    printed = PrintedSheeting(GlassBeads(100.0), 0.9, 0.2)
    assert scaled(printed, 0.5) == PrintedSheeting(GlassBeads(50.0), 0.9, 0.1)


@pytest.mark.parametrize(
    ("key", "unit", "watts"),
    [
        ("luminance", "cd/m^2", lambda area, flux: area),
        ("luminous_intensity", "cd", lambda area, flux: 1.0),
        ("luminous_flux", "lm", lambda area, flux: 1 / flux),
    ],
)
def test_photometric_levels_are_those_of_the_same_light_in_watts(key: str, unit: str, watts: Any, folder: Path) -> None:
    given = document()
    source = given["sources"][1]
    radiant = radwrap.scene_from_document(given, folder=folder)
    del source["radiant_intensity"]
    power = lamp_a(NM)
    curve = luminous_efficiency()
    efficacy = 683 * np.trapezoid(power * np.interp(NM, np.array(curve.wavelengths) * 1e9, curve.values, 0, 0), NM)
    efficacy /= np.trapezoid(power, NM)
    area, flux = math.pi * 1e-6 / 4, 2 * math.pi * (1 - math.cos(math.radians(40)))
    source[key] = f"{float(3 * efficacy / watts(area, flux))!r} {unit}"
    photometric = radwrap.scene_from_document(given, folder=folder)
    assert photometric.emitters[1].radiance == pytest.approx(radiant.emitters[1].radiance, rel=QUADRATURE)
