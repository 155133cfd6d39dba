"""[camera.sensor] mosaic and filters: what is taken, and what is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.colour_planes import shares_of_light
from radwrap.scene.mosaic import COLOURS, Mosaic

CHART = Path(__file__).parents[2] / "rad_scenes" / "colour_chart" / "scene.toml"
FILTERS = {"red": {"quantum_efficiency": 0.1}, "green": {"quantum_efficiency": 0.5}, "blue": {"quantum_efficiency": 0}}


def document(**sensor: Any) -> dict[str, Any]:
    """The colour chart without spectra, in light of 550 nm."""
    tables: dict[str, Any] = json.loads(radwrap.load_scene(CHART).document)
    del tables["camera"]["filter"]
    for table in (*tables["sources"], *tables["materials"].values()):
        table.pop("spectrum", None)
    tables["camera"]["sensor"] |= {"filters": FILTERS} | sensor
    tables["camera"]["sensor"] = {key: value for key, value in tables["camera"]["sensor"].items() if value is not None}
    return tables


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_each_pixel_has_the_colour_of_the_pattern(pattern: Any) -> None:
    mosaic = Mosaic(pattern, (), (), ())
    letters = np.full((5, 4), "?")
    for colour in COLOURS:
        for place in mosaic.places(colour):
            assert (letters[place] == "?").all()
            letters[place] = colour[0].upper()
    assert "".join(letters[:2, :2].ravel()) == "".join(letters[2:4, 2:].ravel()) == pattern
    part = mosaic.moved(1, 2)
    assert "".join(letters[2:4, 1:3].ravel()) == part.pattern


def test_a_part_that_is_read_out_begins_with_its_own_colour() -> None:
    scene = radwrap.scene_from_document(document(roi=[3, 2, 40, 31]))
    assert scene.camera.sensor.mosaic is not None
    assert scene.camera.sensor.mosaic.pattern == "GRBG"


def test_light_of_one_wavelength_is_one_image() -> None:
    scene = radwrap.scene_from_document(document())
    assert shares_of_light(scene) == {"red": 0.2, "green": 1.0, "blue": 0.0}
    assert scene.camera.sensor.linear is not None and scene.camera.sensor.linear.quantum_efficiency == 0.5


def test_broad_light_is_another_image_for_each_colour() -> None:
    shares = shares_of_light(radwrap.load_scene(CHART))
    assert shares == {"red": None, "green": 1.0, "blue": None}


def test_broad_light_on_gray_is_one_image() -> None:
    """What filters take of a white lamp is one number where nothing has a colour: that of the quadrature."""
    tables = json.loads(radwrap.load_scene(CHART).document)
    tables["camera"]["diffraction"] = "off"
    for material in tables["materials"].values():
        material.pop("spectrum", None)
    shares = shares_of_light(radwrap.scene_from_document(tables, folder=CHART.parent))
    nm = np.arange(400, 720.001, 0.02)
    power = np.interp(nm, [400, 430, 450, 470, 490, 520, 560, 600, 650, 700, 720], LED)
    glass = np.interp(nm, [380, 400, 640, 680, 720], [0, 0.9, 0.9, 0, 0])
    counts = {
        colour: float(np.trapezoid(power * glass * nm * efficiencies(tables, colour, nm), nm)) for colour in COLOURS
    }
    expected = {colour: count / max(counts.values()) for colour, count in counts.items()}
    assert shares == pytest.approx(expected, rel=1e-6)


LED = [0, 0.1, 1, 0.3, 0.15, 0.4, 0.62, 0.55, 0.25, 0.05, 0]


def efficiencies(tables: dict[str, Any], colour: str, nm: Any) -> Any:
    pairs = tables["camera"]["sensor"]["filters"][colour]["quantum_efficiencies"]
    return np.interp(nm, [float(place.split()[0]) for place, _ in pairs], [value for _, value in pairs], 0, 0)


@pytest.mark.parametrize("name", ["tables of 2", "power law", "narrow"])
def test_filters_of_each_kind_are_taken(name: str, tmp_path: Path) -> None:
    if name == "power law":
        (tmp_path / "any.csv").write_text("wavelength [nm],response\n300,1\n1000,1\n")
        sensor = {"preset": "fivs", "mosaic": "BGGR", "rows": 8, "columns": 8}
        tables = document()
        tables["camera"]["sensor"] = sensor | {
            "filters": {colour: {"spectral_response": {"file": "any.csv"}} for colour in COLOURS}
        }
        for source in tables["sources"]:
            source["spectrum"] = {"line": "600 nm", "width": "20 nm"}
        scene = radwrap.scene_from_document(tables, folder=tmp_path)
        assert shares_of_light(scene) == {"red": 1.0, "green": 1.0, "blue": 1.0}
        return
    ends = ("500 nm", "600 nm") if name == "tables of 2" else ("549 nm", "551 nm")
    filters = {
        colour: {"quantum_efficiencies": [[ends[0], share], [ends[1], share]]}
        for colour, share in (("red", 0.25), ("green", 0.5), ("blue", 0.125))
    }
    shares = shares_of_light(radwrap.scene_from_document(document(filters=filters)))
    assert shares == pytest.approx({"red": 0.5, "green": 1.0, "blue": 0.25}, rel=1e-12)


REFUSED = {
    "no filter": ({"filters": {"red": FILTERS["red"], "green": FILTERS["green"]}}, "filters.blue"),
    "no filters": ({"filters": None, "quantum_efficiency": 0.5}, "filters.red, filters.green and filters.blue"),
    "no mosaic": ({"mosaic": None}, "mosaic"),
    "another order": ({"mosaic": "RGBG"}, "camera.sensor.mosaic"),
    "channel": ({"channel": "red"}, "channel: the filters of the mosaic"),
    "own efficiency": ({"quantum_efficiency": 0.5}, "needs one of filters and quantum_efficiency"),
    "scale": ({"scale": "1/2"}, "scale: pixels of a mosaic"),
    "one row": ({"rows": 1}, "two rows and two columns"),
    "more than all": ({"filters": FILTERS | {"red": {"quantum_efficiency": 1.2}}}, "filters.red.quantum_efficiency"),
    "empty": ({"filters": FILTERS | {"red": {}}}, "exactly one of quantum_efficiency"),
    "two": (
        {"filters": FILTERS | {"red": {"quantum_efficiency": 0.2, "spectral_response": {"file": "a.csv"}}}},
        "exactly one of quantum_efficiency",
    ),
    "response": (
        {"filters": FILTERS | {"red": {"spectral_response": {"file": "a.csv"}}}},
        "filters.red.spectral_response: is for the power law",
    ),
    "backwards": (
        {"filters": FILTERS | {"red": {"quantum_efficiencies": [["600 nm", 0.1], ["500 nm", 0.2]]}}},
        "wavelengths must increase",
    ),
    "elsewhere": (
        {"filters": FILTERS | {"red": {"quantum_efficiencies": [["600 nm", 0.1], ["700 nm", 0.2]]}}},
        "filters.red.quantum_efficiencies: reach from 600 to 700 nm, the wavelength is 550 nm",
    ),
    "dark": ({"filters": {key: {"quantum_efficiency": 0} for key in COLOURS}}, "no filter lets anything through"),
    "one dark": ({"mosaic": "blue"}, "the blue filter lets nothing through at 550 nm"),
    "no number": ({"filters": FILTERS | {"red": {"quantum_efficiency": float("nan")}}}, "filters.red"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_go_together_is_refused_with_its_key(name: str) -> None:
    changes, words = REFUSED[name]
    with pytest.raises(InputError) as caught:
        radwrap.scene_from_document(document(**changes))
    assert words in str(caught.value), str(caught.value)


def test_the_power_law_takes_no_quantum_efficiencies() -> None:
    tables = document()
    tables["camera"]["sensor"] = {"preset": "fivs", "mosaic": "RGGB", "filters": FILTERS}
    with pytest.raises(InputError, match="the power law needs spectral_response"):
        radwrap.scene_from_document(tables)


def test_spectra_need_a_table_of_each_filter() -> None:
    tables = json.loads(radwrap.load_scene(CHART).document)
    tables["camera"]["sensor"]["filters"]["blue"] = {"quantum_efficiency": 0.1}
    with pytest.raises(InputError, match=r"filters\.blue\.quantum_efficiencies: is missing"):
        radwrap.scene_from_document(tables, folder=CHART.parent)


def test_a_table_that_ends_where_there_is_light_is_refused() -> None:
    tables = json.loads(radwrap.load_scene(CHART).document)
    tables["camera"]["sensor"]["filters"]["red"]["quantum_efficiencies"] = [["500 nm", 0.1], ["600 nm", 0.4]]
    with pytest.raises(InputError, match=r"filters\.red\.quantum_efficiencies: its table, 500 to 600 nm"):
        radwrap.scene_from_document(tables, folder=CHART.parent)


def test_a_colour_that_sees_nothing_is_dark() -> None:
    tables = json.loads(radwrap.load_scene(CHART).document)
    table = tables["camera"]["sensor"]["filters"]["blue"]
    table["quantum_efficiencies"] = [["300 nm", 0.3], ["390 nm", 0.0], ["720 nm", 0.0]]
    shares = shares_of_light(radwrap.scene_from_document(tables, folder=CHART.parent))
    assert shares["blue"] == 0.0
