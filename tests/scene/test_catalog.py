"""Components by name: which file counts, what is refused, and what a run remembers of them."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.output.run_manifest import components_used
from radwrap.scene.catalog.places import find, listed
from radwrap.scene.catalog.presets import with_presets
from radwrap.scene.file.load import scene_from_document, with_camera
from radwrap.scene.scene import Scene

SENSOR = "sony_imx900.framos_hcg"
FILE = (files("radwrap") / "data" / "sensors" / f"{SENSOR}.toml").read_text("utf-8")
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
    found = [find(kind, name, None, name) for kind in ("sensors", "lamps", "sheetings") for name, _, _ in listed(kind)]
    assert len(found) == 22 + 1 + 3
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
