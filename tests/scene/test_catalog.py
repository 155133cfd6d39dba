"""Components by name: which file counts, what is refused, and what a run remembers of them."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.output.run_manifest import components_used
from radwrap.scene.catalog.places import find, listed
from radwrap.scene.catalog.presets import with_presets
from radwrap.scene.file.input_hashes import input_hashes
from radwrap.scene.file.load import scene_from_document, with_camera
from radwrap.scene.scene import Scene

SENSOR = "sony_imx900.framos_hcg"
FILE = (files("radwrap") / "data" / "sensors" / f"{SENSOR}.toml").read_text("utf-8")
KINDS = ("sensors", "lamps", "sheetings", "filters")
START = tomllib.loads((files("radwrap") / "data" / "init" / "scene.toml").read_text("utf-8"))


@pytest.fixture(autouse=True)
def own_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "user"))
    (tmp_path / "named").mkdir()
    monkeypatch.setenv("RADWRAP_CATALOG", str(tmp_path / "named"))


def scene_with(folder: Path, name: str = SENSOR, **more: Any) -> Scene:
    camera = START["camera"] | {"sensor": {"preset": name, **more}, "focal_length": "25 mm"}
    return scene_from_document(START | {"camera": camera}, origin="scene.toml", folder=folder)


def put(folder: Path, name: str = SENSOR, text: str = FILE) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.toml"
    path.write_text(text)
    return path


def test_the_first_place_that_has_it_counts(tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    assert find("sensors", SENSOR, scene, "x").place == "package"
    put(tmp_path / "user" / "radwrap" / "catalog" / "sensors")
    assert find("sensors", SENSOR, scene, "x").place == "user"
    put(tmp_path / "named" / "sensors")
    assert find("sensors", SENSOR, scene, "x").place == "RADWRAP_CATALOG"
    put(scene)
    assert find("sensors", SENSOR, scene, "x").place == "scene"


def test_a_revision_is_asked_for_by_its_date(tmp_path: Path) -> None:
    put(tmp_path / "sensors", f"{SENSOR}@2020-01-02", FILE.replace("revision = 2026-11-25", "revision = 2020-01-02"))
    assert find("sensors", SENSOR, tmp_path, "x").revision == "2026-11-25"
    assert find("sensors", f"{SENSOR}@2020-01-02", tmp_path, "x").revision == "2020-01-02"
    assert find("sensors", f"{SENSOR}@2026-11-25", tmp_path, "x").place == "package"
    with pytest.raises(InputError, match="no sensor"):
        find("sensors", f"{SENSOR}@2019-01-02", tmp_path, "x")


@pytest.mark.parametrize("name", ["../x", "A", "a/b", "", "a..b", ".a", "a@x", "a\0", 3])
def test_other_names_are_refused(name: object, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a name of the catalog"):
        find("sensors", name, tmp_path, "x")


def test_files_that_are_no_components_are_refused(tmp_path: Path) -> None:
    outside = put(tmp_path / "outside")
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / f"{SENSOR}.toml").symlink_to(outside)
    with pytest.raises(InputError, match="link out of its folder"):
        find("sensors", SENSOR, scene, "x")
    (scene / f"{SENSOR}.toml").unlink()
    for text, message in (
        (FILE.replace("0.008", "nan"), "is not a finite number"),
        (FILE + "#" * (1 << 20), "larger than 1 MiB"),
        (FILE.replace("format = 1", "format = 2"), "format 1"),
        (FILE.replace('kind = "sensors"', 'kind = "lights"'), 'must be "sensors"'),
    ):
        put(scene, text=text)
        with pytest.raises(InputError, match=message) as refused:
            find("sensors", SENSOR, scene, "scene.toml: camera.sensor.preset")
        assert "scene.toml: camera.sensor.preset" in str(refused.value)


def test_a_linear_sensor_by_its_name(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, read_noise="3 e")
    sensor = scene.camera.sensor
    assert sensor.linear is not None
    assert (sensor.linear.system_gain, sensor.linear.read_noise, sensor.rows) == (1.673, 3.0, 1552)
    told = components_used(scene)
    assert told is not None
    (one,) = told
    assert (one.key, one.place, one.revision) == ("camera.sensor.preset", "package", "2026-11-25")
    assert one.values["system_gain"] == "1.673 DN/e" and len(one.sha256) == 64
    assert "read_noise" not in one.used and "system_gain" in one.used


def test_what_nobody_published_is_assumed(tmp_path: Path) -> None:
    assumed = scene_with(tmp_path, "sony_imx250.lucid_atlas").assumed
    assert "nobody measured" in assumed["camera.sensor.dsnu"]
    assert "camera.sensor.read_noise" not in assumed
    assert "camera.sensor.quantum_efficiencies" not in assumed
    red = scene_with(tmp_path, "sony_imx250.lucid_atlas", wavelength="630 nm").assumed
    assert red["camera.sensor.quantum_efficiencies"].startswith("measured at 550 nm")


def test_another_camera_has_its_own_component(tmp_path: Path) -> None:
    scene = scene_with(tmp_path)
    other = with_camera(scene, {"camera.sensor.preset": "sony_imx900.framos_lcg"})
    assert [one.component.name for one in other.components] == ["sony_imx900.framos_lcg"]


def test_an_error_in_a_component_names_its_file(tmp_path: Path) -> None:
    path = put(tmp_path, text=FILE.replace("prnu = 0.008", "prnu = 8.0"))
    with pytest.raises(InputError) as refused:
        scene_with(tmp_path)
    assert str(path) in str(refused.value) and "camera.sensor.preset" in str(refused.value)


def test_all_files_of_the_package_are_components() -> None:
    found = [find(kind, name, None, name) for kind in KINDS for name, _, _ in listed(kind)]
    assert len(found) == 24 + 1 + 3 + 10
    for one in found:
        assert set(one.entries) == {key for key in one.values if key not in ("type", "model")}, one.name
        assert all(entry.basis == "assumed" or entry.source or entry.note for entry in one.entries.values())
        assert {entry.source for entry in one.entries.values() if entry.source} <= set(one.catalog.get("sources", {}))


@pytest.mark.parametrize("name", [3, ["fivs"], {"name": "fivs"}])
def test_a_name_that_is_no_text_is_refused_where_it_stands(name: object) -> None:
    with pytest.raises(InputError, match="is not a name of the catalog") as told:
        radwrap.scene_from_document({"camera": {"sensor": {"preset": name}}})
    assert "camera.sensor.preset" in (told.value.where or "")


@pytest.mark.parametrize("kind", ["led", "lamp"])
def test_another_level_stands_for_that_of_a_preset(kind: str) -> None:
    """Of an LED too: it was told to have two."""
    name = {"led": "osram_w5sn_470nm", "lamp": "metal_halide_400w"}[kind]
    whole, (taken,) = with_presets({"sources": [{"type": kind, "preset": name, "radiant_flux": "5 mW"}]}, "x", None)
    (source,) = whole["sources"]
    assert source["radiant_flux"] == "5 mW" and "radiant_intensity" not in source
    assert "radiant_intensity" not in taken.used


def lit_by_a_line(folder: Path, camera: dict[str, Any], centre: float, width: float) -> Scene:
    line = {"spectrum": {"line": f"{centre} nm", "width": f"{width} nm"}}
    sources = [source | line for source in START["sources"]]
    tables = START | {"camera": START["camera"] | camera, "sources": sources}
    return scene_from_document(tables, origin="scene.toml", folder=folder)


def share_of_a_line(centre: float, width: float, *factors: list[tuple[float, float]]) -> float:
    """Mean of some curves over a Gaussian line, by a sum over steps of 0.01 nm [all in nm]."""
    steps = np.arange(centre - 6 * width, centre + 6 * width, 0.01)
    power = np.exp(-4 * np.log(2) * ((steps - centre) / width) ** 2)
    passed = power.copy()
    for curve in factors:
        passed *= np.interp(steps, *zip(*curve, strict=True))
    return float(passed.sum() / power.sum())


def table_of(values: list[list[Any]]) -> list[tuple[float, float]]:
    return [(float(wavelength.removesuffix(" nm")), share) for wavelength, share in values]


@pytest.mark.parametrize(("name", "centre", "width"), [("midopt_bp635", 660, 20), ("midopt_lp610", 610, 30)])
def test_a_filter_by_its_name_passes_its_share_of_a_line(
    name: str, centre: float, width: float, tmp_path: Path
) -> None:
    scene = lit_by_a_line(tmp_path, {"filter": {"preset": name}}, centre, width)
    curve = table_of(
        tomllib.loads((files("radwrap") / "data" / "filters" / f"{name}.toml").read_text())["transmissions"]
    )
    assert scene.spectral is not None
    expected = share_of_a_line(centre, width, curve)
    assert 0.3 < expected < 0.7
    assert scene.spectral.counts[0] == pytest.approx(expected, rel=1e-3)  # a line's nodes are straight between
    (used,) = [one for one in components_used(scene) or () if one.kind == "filters"]
    assert (used.key, used.used) == ("camera.filter.preset", ("transmissions",))


def test_the_same_filter_by_a_table_of_the_scene(tmp_path: Path) -> None:
    values = [["600 nm", 0.0], ["650 nm", 0.8], ["700 nm", 0.8]]
    scene = lit_by_a_line(tmp_path, {"filter": {"transmissions": values}}, 650, 10)
    assert scene.spectral is not None
    assert scene.spectral.counts[0] == pytest.approx(share_of_a_line(650, 10, table_of(values)), rel=1e-3)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"preset": "midopt_bp635", "file": "x.csv"}, "camera.filter: needs exactly one of file and transmissions"),
        ({}, "camera.filter: needs exactly one of file and transmissions"),
        # The wrong entry is the one fault: without it the table is too short, which says nothing more.
        ({"transmissions": [["400 nm", 50], ["500 nm", 0.5]]}, r"transmissions\[0\]\[1\]: must be at most 1, not 50$"),
        ({"transmissions": [["650 nm", 0.1], ["640 nm", 0.2]]}, "camera.filter: transmissions: wavelengths must"),
        ({"transmissions": [["600 nm", 0.1], ["700 nm", 1.2]]}, "must be at most 1"),
        ({"preset": "midopt_bp636"}, 'camera.filter.preset: no filter "midopt_bp636"; did you mean'),
        ({"transmissions": [["648 nm", 0.1], ["652 nm", 0.2]]}, "648 to 652 nm, does not cover the light"),
    ],
)
def test_what_is_no_filter_is_refused(table: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        lit_by_a_line(tmp_path, {"filter": table}, 650, 10)


def test_what_a_scene_hangs_on_includes_its_filter(tmp_path: Path) -> None:
    """Else a study would go on with the images of another filter."""
    document = {"camera": {"filter": {"preset": "midopt_bp470"}}}
    assert "catalog: filters/midopt_bp470" in input_hashes([document], "x", tmp_path, trust=False)


def test_a_colour_camera_by_its_name(tmp_path: Path) -> None:
    """A red line is seen behind each colour as the sheet's curve says, photon by photon, through the filter."""
    camera = {"sensor": {"preset": "ams_cmv12000.colour"}, "filter": {"preset": "midopt_sp675"}}
    scene = lit_by_a_line(tmp_path, camera | {"focal_length": "25 mm"}, 620, 20)
    mosaic, spectral = scene.camera.sensor.mosaic, scene.spectral
    assert mosaic is not None and mosaic.pattern == "RGGB" and spectral is not None
    values = find("sensors", "ams_cmv12000.colour", None, "x").values["filters"]
    glass = table_of(find("filters", "midopt_sp675", None, "x").values["transmissions"])
    photons = [(300.0, 300 / 555), (1100.0, 1100 / 555)]
    expected = {
        colour: share_of_a_line(620, 20, glass, photons, table_of(values[colour]["quantum_efficiencies"]))
        for colour in ("red", "green", "blue")
    }
    assert expected["red"] > 4 * expected["green"]
    largest = max(
        float(np.interp(555, *zip(*table_of(values[c]["quantum_efficiencies"]), strict=True))) for c in expected
    )
    for colour, share in expected.items():
        assert spectral.planes[colour].counts[0] == pytest.approx(share / largest, rel=1e-3)
