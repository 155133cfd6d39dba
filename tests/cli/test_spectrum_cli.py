"""Spectra as users write them: what is refused with its key, what is told, and what other verbs do with colours."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.cli.main import main
from radwrap.errors import InputError
from radwrap.images import read_image
from radwrap.scene.look.checks import warnings_of
from tests.physics.test_linear_sensor import TABLE as LINEAR
from tests.physics.test_spectrum import document, write_tables


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene of two colours of light, with its tables."""
    write_tables(tmp_path)
    (tmp_path / "scene.toml").write_text(toml(document()))
    return tmp_path


def toml(tables: dict[str, Any]) -> str:
    """A scene file: JSON values are TOML values, but for the sign between key and value."""

    def value(item: Any) -> str:
        if isinstance(item, dict):
            return "{ " + ", ".join(f"{key} = {value(part)}" for key, part in item.items()) + " }"
        if isinstance(item, list):
            return "[" + ", ".join(map(value, item)) + "]"
        return json.dumps(item)

    return "\n".join(f"{key} = {value(item)}" for key, item in tables.items()) + "\n"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"sources[0].spectrum": {"line": "650 nm"}}, "line and width"),
        ({"sources[0].spectrum": {"line": "650 nm", "width": "300 nm"}}, "below a quarter"),
        ({"sources[0].spectrum": {"line": "650", "width": "20 nm"}}, "sources[0].spectrum.line"),
        ({"sources[0].spectrum": {"preset": "A", "file": "red.csv"}}, "needs exactly one of line and preset and file"),
        ({"sources[0].spectrum": {"preset": "F11"}}, "sources[0].spectrum.preset"),
        ({"sources[0].spectrum": {"file": "none.csv"}}, "none.csv"),
        ({"sources[0].spectrum": {"file": "/etc/passwd"}}, "lies outside the scene's folder"),
        ({"sources[0].spectrum": {"file": "dark.csv"}}, "dark everywhere"),
        (
            {"materials.red.spectrum.file": "short.csv"},
            "materials.red.spectrum: its table, 600 to 700 nm, does not cover",
        ),
        ({"sources[0].luminous_intensity": "1 cd"}, "needs exactly one of radiance, radiant_intensity and luminous"),
        ({"camera.filter.file": "short.csv"}, "camera.filter: its table, 600 to 700 nm, does not cover"),
        ({"camera.filter.file": "large.csv"}, "above 1"),
        ({"camera.spectral_response.file": "blue.csv"}, "the sensor sees nothing of the light"),
        ({"camera.spectral_response.file": "headless.csv"}, "its first cell"),
        ({"camera.spectral_response.file": "unordered.csv"}, "line 3: wavelengths must increase"),
        ({"camera.spectral_response.file": "cell.csv"}, "is not CSV: field larger than field limit"),
        ({"camera.spectral_response.file": "pipe"}, 'camera.spectral_response: "pipe": is not a regular file'),
        ({"camera.spectral_response.file": "microns.csv"}, "line 2: wavelength [um] 600 lies outside 0.1 to 20 um; if"),
        (
            {"camera.filter.file": "black.csv"},
            "camera.filter: the sensor sees nothing of the light: sources[0].spectrum",
        ),
        ({"camera.filter.file": "black.csv"}, "camera.filter is 0 everywhere"),
        ({"camera.spectral_response.file": "words.csv"}, "line 2: is not a pair of numbers"),
        ({"materials.red.spectrum.file": "large.csv"}, "materials.red.spectrum"),
        ({"camera.sensor.channel": "red"}, "camera.sensor.channel"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(changes: dict[str, Any], told: str, folder: Path) -> None:
    tables = {
        "dark": "400,0\n800,0\n",
        "short": "600,0.5\n700,0.5\n",
        "large": "300,0.5\n1000,1.5\n",
        "blue": "100,1\n200,1\n",
        "black": "300,0\n1000,0\n",
        "unordered": "500,1\n400,1\n",
        "words": "a,b\n",
        "cell": "4" * 200_000 + ",1\n",
    }
    for name, rows in tables.items():
        (folder / f"{name}.csv").write_text(f"wavelength [nm],x\n{rows}")
    os.mkfifo(folder / "pipe")  # nobody writes to it: who opens it waits for ever
    (folder / "microns.csv").write_text("wavelength [um],x\n600,1\n700,1\n")
    (folder / "headless.csv").write_text("400,1\n700,1\n")
    given = document()
    if "camera.spectral_response.file" in changes and "blue" in str(changes):
        del given["camera"]["filter"]
    with pytest.raises(InputError) as caught:
        radwrap.scene_from_document(given, changes, folder=folder)
    assert told in str(caught.value)


def test_a_table_need_not_cover_what_is_no_light(folder: Path) -> None:
    """Zeros at the ends of a spectrum, and a source that is dark."""
    for name, rows in {
        "ends": "300,0\n600,0\n650,1\n700,0\n1000,0\n",
        "short": "600,0.5\n700,0.5\n",
        "long": "300,0.5\n1000,0.5\n",
    }.items():
        (folder / f"{name}.csv").write_text(f"wavelength [nm],x\n{rows}")
    given = document(filter={"file": "short.csv"})
    given["sources"][0]["spectrum"] = {"file": "ends.csv"}
    given["sources"][1]["radiant_intensity"] = "0 W/sr"
    short, whole = (
        radwrap.scene_from_document(given, {"camera.filter.file": name}, folder=folder)
        for name in ("short.csv", "long.csv")
    )
    assert short.spectral is not None and whole.spectral is not None
    assert short.spectral.counts[0] == pytest.approx(whole.spectral.counts[0], rel=1e-12)


@pytest.mark.parametrize(
    ("wavelength", "off"), [("650 nm", None), ("644 nm", None), ("450 nm", "-30.8%"), ("700 nm", "+7.7%")]
)
def test_a_linear_camera_of_another_wavelength_is_told(wavelength: str, off: str | None, folder: Path) -> None:
    """Photons of a joule go with lambda: 450/650 - 1 = -30.8 %, 700/650 - 1 = 7.7 %."""
    given = document()
    del given["sources"][1], given["camera"]["filter"], given["camera"]["spectral_response"]
    sensor = {key: value for key, value in LINEAR.items() if key not in ("rows", "columns")} | {"rows": 6, "columns": 6}
    given["camera"]["sensor"] = sensor | {"wavelength": wavelength}
    told = [line for line in warnings_of(radwrap.scene_from_document(given, folder=folder)) if "photons" in line]
    assert len(told) == (off is not None)
    if off is not None:
        assert f"650 nm, camera.sensor.wavelength {wavelength}: photons are off by {off}" in told[0]
        assert 'write wavelength = "650 nm"' in told[0]


def test_a_table_of_quantum_efficiencies_counts_with_the_spectra(folder: Path) -> None:
    """Electrons of a line of 1 nm are those of a sensor told at that wavelength, whatever its own wavelength is."""
    given = document()
    del given["sources"][1], given["camera"]["filter"], given["camera"]["spectral_response"]
    given["sources"][0]["spectrum"] = {"line": "650 nm", "width": "1 nm"}
    plain = {key: value for key, value in LINEAR.items() if key not in ("rows", "columns", "quantum_efficiency")}
    table = [["500 nm", 0.6], ["600 nm", 0.5], ["700 nm", 0.2]]

    def electrons(wavelength: str, places: list[list[object]] = table) -> tuple[radwrap.Scene, float]:
        sensor = {"rows": 6, "columns": 6, "wavelength": wavelength, "quantum_efficiencies": places}
        given["camera"]["sensor"] = plain | sensor
        scene = radwrap.scene_from_document(given, folder=folder)
        assert scene.spectral is not None and scene.camera.sensor.linear is not None
        linear = scene.camera.sensor.linear
        # Electrons of a joule go with efficiency and wavelength.
        return scene, scene.spectral.counts[0] * linear.quantum_efficiency * linear.wavelength

    here_ = electrons("650 nm")[1]
    assert here_ == pytest.approx(0.35 * 650e-9, rel=1e-5)
    assert electrons("510 nm")[1] == pytest.approx(here_, rel=1e-12)
    assert not [line for line in warnings_of(electrons("510 nm")[0]) if "photons" in line]
    with pytest.raises(radwrap.InputError, match=r"500 to 649 nm, does not cover the light"):
        electrons("510 nm", [["500 nm", 0.6], ["649 nm", 0.5]])


def test_candelas_without_a_spectrum_are_refused(folder: Path) -> None:
    """Never taken for watts."""
    given = document()
    for source in given["sources"]:
        del source["spectrum"]
    given["sources"][0]["luminous_intensity"] = "1 cd"
    del given["sources"][0]["radiant_intensity"], given["camera"]["filter"], given["camera"]["spectral_response"]
    with pytest.raises(InputError, match=r"sources\[0\].*luminous_intensity needs spectrum"):
        radwrap.scene_from_document(given, folder=folder)


def test_a_source_without_spectrum_beside_others_is_refused(folder: Path) -> None:
    given = document()
    del given["sources"][1]["spectrum"]
    with pytest.raises(InputError, match=r"sources\[1\].spectrum: is missing"):
        radwrap.scene_from_document(given, folder=folder)


def test_explain_tells_what_counts_and_how_many_bands(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = str(folder / "scene.toml")
    assert main(["explain", scene, "--no-rays", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {error: len(groups) for error, groups in found["spectrum"]["bands"].items()}["0.0001"] == 2
    assert 0 < found["spectrum"]["counts"]["bulb"] < found["spectrum"]["counts"]["led"] < 1
    assert not found["diffraction"]["wavelength_assumed"]
    assert main(["explain", scene]) == 0
    told = capsys.readouterr().out
    assert "bands for a relative error: 2 to 0.0001" in told
    assert "effect bands: needed" in told and "one band for the light of all sources" in told


def test_what_knows_one_band_refuses_two_by_name(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = str(folder / "scene.toml")
    words = [["convert", scene, str(folder / "out.rad")]]
    if shutil.which("povray"):
        words.append(["crosscheck", scene, "--out", str(folder / "out"), "--viewpoints", "1"])
    for argv in words:
        assert main(argv) == 2
        assert "sources: the scene's colours need 2 bands" in capsys.readouterr().err
    given = document()
    del given["sources"][0]
    (folder / "one.toml").write_text(toml(given))
    assert main(["convert", str(folder / "one.toml"), str(folder / "out.rad")]) == 0
    assert (folder / "out.rad").exists()


@pytest.mark.long
def test_a_basis_of_colours_relights_as_a_render_does(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each source keeps its own reflectances: half of one lamp, none of the other."""
    scene, out, relit = str(folder / "scene.toml"), folder / "run", folder / "relit"
    assert main(["render", scene, "--tolerance", "0.5", "--basis", "--out", str(out)]) == 0
    (folder / "levels.csv").write_text("name,led,bulb\nboth,1,1\nled,0.5,0\n")
    assert main(["relight", str(out), "--levels", str(folder / "levels.csv"), "--out", str(relit)]) in (0, 3)
    alone = document()
    alone["sources"][0]["radiant_intensity"] = "1 W/sr"
    del alone["sources"][1]
    wanted = {
        "both": read_image(out / "gray.png")[0],
        "led": radwrap.render(radwrap.scene_from_document(alone, folder=folder), tolerance=0.5).gray.values,
    }
    for name, image in wanted.items():
        off = read_image(relit / f"{name}.png")[0].astype(float) - image.astype(float)
        assert np.sqrt((off**2).mean()) < 1.0  # two errors of 0.5 at most, and rounding


def test_a_dark_source_needs_no_band(folder: Path) -> None:
    scene = radwrap.load_scene(folder / "scene.toml", {"sources[0].radiant_intensity": "0 W/sr"})
    found = radwrap.render(scene, method="pinhole")
    assert found.manifest["bands"]["sources"] == [["bulb"]]
    with pytest.raises(InputError, match=r"there is no light|the sensor sees nothing"):
        radwrap.with_value(scene, "sources[1].radiant_intensity", "0 W/sr")


@pytest.mark.long
def test_same_spectra_same_bytes_whatever_the_workers(folder: Path) -> None:
    scene = radwrap.load_scene(folder / "scene.toml")
    images = [radwrap.render(scene, tolerance=1.0, workers=workers).radiant_exposure.values for workers in (1, 3)]
    assert (images[0] == images[1]).all()
