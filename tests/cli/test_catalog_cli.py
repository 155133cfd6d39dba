"""`radwrap catalog`: what there is, whether it can be relied on, and one's own."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.cli.main import main
from tests.cli.conftest import here

DATA = files("radwrap") / "data" / "sensors"
TWIN = "sony_imx287.allied_alvium_1800_c"


@pytest.fixture(autouse=True)
def own_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "user"))
    monkeypatch.delenv("RADWRAP_CATALOG", raising=False)


def told(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = main(["catalog", *words, "--json"])
    return code, json.loads(capsys.readouterr().out)


def written(folder: Path, old: str = "", new: str = "") -> Path:
    text = (DATA / f"{TWIN}.toml").read_text("utf-8")
    assert old in text
    path = folder / f"{TWIN}.toml"
    path.write_text(text.replace(old, new) if old else text)
    return path


def test_every_component_of_the_package_can_be_relied_on(capsys: pytest.CaptureFixture[str]) -> None:
    """Each key has source or reason, a scene takes all of them, and totals are within rounding and 1 dB."""
    code, found = told(capsys, "check")
    assert (code, found["problems"]) == (0, [])
    totals = [total for one in found["components"] for total in one["totals"]]
    assert len(totals) == 44 and all(total["agrees"] for total in totals)
    kinds = [one["class"] for one in found["components"]]
    assert {kind: kinds.count(kind) for kind in kinds} == {
        **{"sensors": 24, "lenses": 9, "leds": 9, "lights": 14, "filters": 10},
        **{"lamps": 1, "materials": 14, "sheetings": 3},
    }


def test_the_full_well_that_a_vendor_printed_ten_times_too_high_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sheet says 74 dB, which 208000 e would make 94.3 dB with the sheet's threshold of 4 e."""
    path = written(tmp_path, 'full_well = "20800 e"', 'full_well = "208000 e"')
    code, found = told(capsys, "check", str(path))
    assert code == 1
    (problem,) = found["problems"]
    assert "dynamic_range" in problem and TWIN in problem and "-20" in problem


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('full_well = { basis = "measured", source = "allied" }', "", "full_well: nothing in catalog.from"),
        ('full_well = { basis = "measured", source = "allied" }', 'full_well = { basis = "measured" }', "its source"),
        ('full_well = "20800 e"', 'full_well = "20800 V"', "full_well"),
        ('full_well = "20800 e"', 'ful_well = "20800 e"', "unknown key"),
        ('dynamic_range = "74 dB"', 'dynamic_range = "74"', "in dB"),
        ('dynamic_range = "74 dB"', 'width = "74 dB"', "is not a known total"),
    ],
)
def test_what_is_wrong_is_said(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = told(capsys, "check", str(written(tmp_path, old, new)))
    assert code == 1 and any(message in problem for problem in found["problems"])


def test_ones_own_component_hides_that_of_the_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, 'read_noise = "3.2 e"', 'read_noise = "3.3 e"')
    assert told(capsys, "add", str(path))[0] == 0
    _, found = told(capsys, "show", TWIN)
    (one,) = found["components"]
    assert (one["place"], one["values"]["read_noise"]) == ("user", "3.3 e")
    written(tmp_path, 'read_noise = "3.2 e"', 'read_noise = "3.4 e"')
    assert main(["catalog", "add", str(path)]) == 2
    assert "other values" in capsys.readouterr().err
    path.write_text(path.read_text().replace("2026-11-25", "2026-11-26"))
    assert told(capsys, "add", str(path))[0] == 0
    values = [told(capsys, "show", name)[1]["components"][0]["values"] for name in (TWIN, f"{TWIN}@2026-11-25")]
    assert [one["read_noise"] for one in values] == ["3.4 e", "3.3 e"]


def test_names_that_there_are_not(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["catalog", "show", "sony_imx287"]) == 2
    assert "no sensor" in capsys.readouterr().err
    assert main(["catalog", "show", "lenses/generic_26mm"]) == 2
    assert "generic_25mm" in capsys.readouterr().err


XML = """<?xml version="1.0"?>
<results>
  <sensitivity>
    <K><short>System gain</short><value>0.37</value></K>
    <QE><value>63,4</value></QE>
    <sigma_d><value>2.44</value></sigma_d>
    <u_e_sat><value>10970</value></u_e_sat>
    <DR_dB><value>71.45</value></DR_dB>
  </sensitivity>
  <spatial><PRNU1288><value>0.7</value></PRNU1288><DSNU1288><value>nan</value></DSNU1288></spatial>
  <dark_current><u_I_mean><value>-0.2</value></u_I_mean></dark_current>
</results>
"""
SIZE = ["--rows", "2048", "--columns", "2448", "--pixel-width", "3.45 um", "--pixel-height", "3.45 um"]
REST = ["--wavelength", "525 nm", "--bit-depth", "12", "--revision", "2026-11-25"]


def imported(folder: Path, text: str, *more: str) -> int:
    (folder / "emva.xml").write_text(text)
    words = [str(folder / "emva.xml"), *SIZE, *REST, "--write", str(folder / "own.toml")]
    return main(["catalog", "import", *words, *more])


def test_results_of_the_reference_program_become_a_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert imported(tmp_path, XML) == 0
    capsys.readouterr()
    code, found = told(capsys, "check", str(tmp_path / "own.toml"))
    assert (code, found["problems"]) == (0, [])
    values = found["components"][0]["values"]
    assert (values["quantum_efficiency"], values["system_gain"], values["prnu"]) == (0.634, "0.37 DN/e", 0.007)
    assert found["components"][0]["from"]["offset"]["basis"] == "assumed"
    assert "dsnu" not in values and "dark_current" not in values


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<results>", '<!DOCTYPE r [<!ENTITY a "b">]><results>', "declares a DTD or an entity"),
        ("<K>", "<G>", "is not XML"),
        ("0.37", "1e999", "not a finite number"),
        ("10970", "109700", "dynamic_range"),
        ("sigma_d>", "sigma>", "sigma_d: is missing"),
    ],
)
def test_results_that_cannot_be_relied_on_are_refused(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(tmp_path, XML.replace(old, new)) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "own.toml").exists()


def test_a_file_that_is_there_is_not_replaced_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert imported(tmp_path, XML) == 0
    first = (tmp_path / "own.toml").read_bytes()
    assert imported(tmp_path, XML) == 0, "the same again is not a loss"
    assert imported(tmp_path, XML.replace("2.44", "2.43")) == 2
    assert "own.toml: exists and has other content" in capsys.readouterr().err
    assert (tmp_path / "own.toml").read_bytes() == first
    assert imported(tmp_path, XML.replace("2.44", "2.43"), "--replace") == 0
    assert (tmp_path / "own.toml").read_bytes() != first


def test_a_broken_file_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sensors").mkdir()
    (tmp_path / "sensors" / "broken.toml").write_text("x = [")
    monkeypatch.setenv("RADWRAP_CATALOG", str(tmp_path))
    for verb in ("list", "check"):
        done = here(["catalog", verb, "--json"], capsys)
        assert done.code == 1
        told = json.loads(done.stdout)
        assert len(told["components"]) > 50
        assert len(told["problems"]) == 1 and "broken.toml" in told["problems"][0]


@pytest.mark.parametrize(
    ("told", "what"),
    [
        ('["a", "b"]', "must be a number"),
        ("[300, 240]", "does not lie between"),
        ("[100, 240]", "does not lie between"),
        ("[0, 240]", None),
    ],
)
def test_ends_of_a_range_are_values_of_the_key(
    told: str, what: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = Path(radwrap.__file__).parent / "data" / "sensors" / "sony_imx250.flir_bfs_u3_51s5m.toml"
    text = source.read_text()
    assert text.count("range = [0, 240]") == 1
    (tmp_path / "one.toml").write_text(text.replace("range = [0, 240]", f"range = {told}"))
    done = here(["catalog", "check", tmp_path / "one.toml"], capsys)
    assert done.code == (0 if what is None else 1)
    assert what is None or (what in done.stdout and "catalog.from.offset.range" in done.stdout)


@pytest.mark.parametrize("name", ["Große Kamera.toml", "camera.txt"])
def test_only_names_of_the_catalog_are_added(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = Path(radwrap.__file__).parent / "data" / "sensors" / "sony_imx250.flir_bfs_u3_51s5m.toml"
    (tmp_path / name).write_bytes(source.read_bytes())
    done = here(["catalog", "add", tmp_path / name], capsys)
    assert done.code == 2 and name in done.stderr


def test_folders_that_are_none_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = here(["catalog", "list", "--folder", tmp_path / "nowhere"], capsys)
    assert done.code == 2 and "--folder" in done.stderr
    monkeypatch.setenv("RADWRAP_CATALOG", str(tmp_path / "nowhere"))
    done = here(["catalog", "list"], capsys)
    assert done.code == 2 and "RADWRAP_CATALOG" in done.stderr
