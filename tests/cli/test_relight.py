"""``radwrap render --basis`` and ``radwrap relight`` as users run them."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.images import read_image
from radwrap.imaging.relight.basis import sealed
from radwrap.imaging.relighting import relight
from tests.cli.conftest import (
    SLOWER,
    SMALL,
    files_in,
    here,
    inhabitants,
    inside,
    products,
    start,
    wait_for,
    write_scene,
)

SECOND: Final = {**SMALL["sources"][0], "name": "second", "position": ["-60 mm", "-90 mm", "450 mm"]}
TWO: Final = {"sources.1": SECOND}
GOOD: Final = "name,second,lamp\nboth,1,1\nhalf, 0.5 ,0\n\noff,0,0e0\n"


@pytest.fixture(scope="module")
def basis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("relight")
    inside("render", write_scene(folder, TWO), "--basis", "--tolerance", 2, "--out", folder / "basis").success()
    return folder / "basis"


def _table(folder: Path, text: str) -> Path:
    path = folder / "levels.csv"
    path.write_bytes(text.encode())
    return path


def _argv(basis: Path, folder: Path, text: str, *more: object) -> list[object]:
    return ["relight", basis, "--levels", _table(folder, text), "--out", folder / "out", *more]


def test_relight_writes_an_image_for_each_row(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = here(_argv(basis, tmp_path, GOOD, "--json"), capsys).success()
    out = tmp_path / "out"
    assert done.json == json.loads((out / "relight.json").read_bytes())
    assert {path.name for path in out.iterdir()} == {
        ".radwrap.lock",
        "both.png",
        "gray_sigma",
        "half.png",
        "off.png",
        "relight.json",
    }
    images = done.json["images"]
    assert list(images) == ["both", "half", "off"]
    assert images["half"]["levels"] == {"lamp": 0.0, "second": 0.5}
    # With all factors 1 the picture is that of the render, byte by byte.
    assert (out / "both.png").read_bytes() == (basis / "gray.png").read_bytes()
    rendered = json.loads((basis / "manifest.json").read_bytes())
    assert done.json["left_out"] == rendered["left_out"] and "diffraction" in rendered["left_out"]
    assert set(images["both"]["error"]) == set(rendered["error"])
    assert images["both"]["gray"] == rendered["gray"]
    assert images["off"]["gray"] == {"min": 22.0, "max": 22.0, "mean": 22.0}
    assert images["half"]["gray"]["mean"] < images["both"]["gray"]["mean"]
    assert all(image["met"] for image in images.values())
    told = here(_argv(basis, tmp_path, GOOD), capsys).success().stdout
    assert "3 images" in told and "95 %" in told


def test_exposures_are_linear_in_the_factors(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "name,lamp,second\na,1,0\nb,0,1\nc,0.25,3\n"
    images = here(_argv(basis, tmp_path, text, "--exposure", "--json"), capsys).json["images"]
    a, b, c = (read_image(tmp_path / "out" / f"{name}.exr")[0].astype(float) for name in "abc")
    assert np.abs(0.25 * a + 3 * b - c).max() < 1e-6 * c.max()  # each is rounded to float32
    assert set(images["c"]["files"]) == {"c.png", "c.exr", "gray_sigma/c.exr"}


def _one(basis: Path, folder: Path, *more: object) -> list[object]:
    return ["relight", basis, *more, "--out", folder / "out"]


def test_one_image_by_its_levels(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here(_argv(basis, tmp_path, "name,lamp,second\na,0.25,1\n"), capsys).success()
    told = here(_one(basis, tmp_path, "--level", "lamp=3", "--level", "lamp=0.25", "--json"), capsys).success().json
    assert told["images"]["gray"]["levels"] == {"lamp": 0.25, "second": 1.0} and "changed" not in told
    assert (tmp_path / "out" / "gray.png").read_bytes() == (tmp_path / "out" / "a.png").read_bytes()
    sigma = read_image(tmp_path / "out" / "gray_sigma" / "gray.exr")[0].astype(float)
    assert np.sqrt((sigma**2).mean()) == pytest.approx(told["images"]["gray"]["uncertainty"]["sigma_rms_gray"])
    here(_one(basis, tmp_path), capsys).success()
    assert (tmp_path / "out" / "gray.png").read_bytes() == (basis / "gray.png").read_bytes()


def test_one_image_in_another_camera(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = ("--set", "camera.exposure_time=774 ms", "--set", "camera.sensor.dark_gray=5")
    told = here(_one(basis, tmp_path, *more, "--json"), capsys).json
    assert told["changed"] == {"camera.exposure_time": "774 ms", "camera.sensor.dark_gray": 5}
    here(_one(basis, tmp_path, "--level", "lamp=2", "--level", "second=2", *more[2:], "--json"), capsys)
    twice = json.loads((tmp_path / "out" / "relight.json").read_bytes())
    upper = [one["images"]["gray"]["error"]["rms_gray_upper95"] for one in (told, twice)]
    assert upper[0] == pytest.approx(upper[1], rel=1e-9)
    assert told["images"]["gray"]["gray"]["min"] == 5


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--level", "lump=1"), 'level "lump": unknown source "lump"; known are'),
        (("--level", "lamp"), '"lamp" is not NAME=FACTOR'),
        (("--level", "lamp=-1"), 'level lamp: "-1" is not a number of 0 or more'),
        (("--level", "lamp=1e999"), "is not a number of 0 or more"),
        (("--level", "lamp=1", "--levels", "levels.csv"), "--level: goes without --levels"),
        (("--set", "camera.position=[]"), "camera.position"),
        (("--set", "camera.focal_length=13 mm"), "camera.focal_length: changes which light a pixel gets"),
        (("--set", "sources.0.radiance=1 W/m^2/sr"), "is not a key of the camera"),
        (("--set", "camera.exposure_time=5"), "camera.exposure_time"),
        (("--set", "camera.exposure_time=1e300 s"), "must be at most 1e+09"),
        (("--set", "camera.sensor.data_sheet=x.toml", "--set", 'camera.sensor.model="linear"'), "x.toml"),
    ],
)
def test_bad_turns_are_refused(
    basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], says: str
) -> None:
    assert says in here(_one(basis, tmp_path, *more), capsys).refusal(2)
    assert not list(tmp_path.rglob("*.png"))


def test_a_data_sheet_is_found_in_the_scenes_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The manifest holds the scene as it was written; the sheet it names lies beside the scene file."""
    folder, sensor = tmp_path / "scene", SMALL["camera"]["sensor"]
    folder.mkdir()
    keys = ("gain", "gamma", "dark_gray", "saturation_gray")
    (folder / "sheet.toml").write_text("".join(f"{key} = {json.dumps(sensor[key])}\n" for key in keys))
    rest = {key: value for key, value in sensor.items() if key not in keys}
    linear = {**rest, "model": "linear", "data_sheet": "sheet.toml"}
    (folder / "sheet.toml").write_text(
        'wavelength = "525 nm"\nquantum_efficiency = 0.5\nsystem_gain = "0.01 DN/e"\noffset = 20\n'
        'full_well = "20000 e"\nread_noise = "5 e"\n'
    )
    scene = write_scene(folder, {**TWO, "camera.sensor": linear})
    basis = tmp_path / "basis"
    here(["render", scene, "--basis", "--tolerance", 20, "--out", basis], capsys).success()
    turn = ("--set", "camera.exposure_time=10 ms")
    assert "sheet.toml" in here(_one(basis, tmp_path, *turn), capsys).refusal(2)
    found = here(_one(basis, tmp_path, *turn, "--scene-folder", folder, "--json"), capsys).success().json
    assert "noise" in found["images"]["gray"]["uncertainty"]["parts_rms_gray"]


def test_the_same_table_gives_the_same_bytes(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here(_argv(basis, tmp_path, GOOD, "--exposure"), capsys).success()
    first = files_in(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    here(_argv(basis, tmp_path, "\ufeff" + GOOD.replace("\n", "\r\n"), "--exposure"), capsys).success()
    assert files_in(tmp_path / "out") == first


def test_levels_too_bright_for_the_tolerance_end_with_three(
    basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(basis, tmp_path / "basis")
    told = json.loads((basis / "basis.json").read_bytes())
    (tmp_path / "basis" / "basis.json").write_text(json.dumps(sealed({**told, "tolerance": 1e-3})))
    done = here(_argv(tmp_path / "basis", tmp_path, GOOD, "--json"), capsys)
    assert done.code == 3
    assert "both and 1 more: the tolerance of the basis was not met" in done.stderr
    assert [image["met"] for image in done.json["images"].values()] == [False, False, True]


BAD: Final[dict[str, tuple[str, str]]] = {
    "missing column": ("name,lamp\na,1\n", 'line 1: the column "second" is missing'),
    "no name": ("lamp,second\n1,1\n", 'line 1: the column "name" is missing'),
    "unknown column": ("name,lamp,second,third\na,1,1,1\n", 'line 1: unknown column "third"'),
    "column twice": ("name,lamp,second,lamp\na,1,1,1\n", 'line 1: the column "lamp" comes twice'),
    "unnamed column": ("name,lamp,second,\na,1,1,\n", 'line 1: unknown column ""'),
    "empty file": ("", 'line 1: the column "name" is missing; begin the table with the line name,lamp,second'),
    "no rows": ("name,lamp,second\n", "holds no image"),
    "too few cells": ("name,lamp,second\na,1\n", "line 2: has 2 cells, the first line has 3"),
    "too many cells": ("name,lamp,second\na,1,1\nb,1,1,1\n", "line 3: has 4 cells"),
    "empty cell": ("name,lamp,second\na,1, \n", 'line 2, column "second": is empty'),
    "negative": ("name,lamp,second\na,-0.1,1\n", 'line 2, column "lamp": "-0.1" is not a number of 0 or more'),
    "nan": ("name,lamp,second\na,1,nan\n", 'line 2, column "second": "nan" is not a number'),
    "infinite": ("name,lamp,second\na,1,inf\n", 'column "second": "inf" is not a number'),
    "overflow": ("name,lamp,second\na,1,1e999\n", 'column "second": "1e999" is not a number'),
    "word": ("name,lamp,second\na,on,1\n", 'column "lamp": "on" is not a number'),
    "decimal comma": ('name,lamp,second\na,"1,5",1\n', 'column "lamp": "1,5" is not a number'),
    "underscore": ("name,lamp,second\na,1_0,1\n", 'column "lamp": "1_0" is not a number'),
    "foreign digits": ("name,lamp,second\na,٣,1\n", 'column "lamp":'),
    "name twice": ("name,lamp,second\na,1,1\nA,1,1\n", 'line 3, column "name": "A" is taken by line 2'),
    "path": ("name,lamp,second\n../a,1,1\n", 'line 2, column "name": "../a" cannot name a file'),
    "hidden": ("name,lamp,second\n.a,1,1\n", '".a" cannot name a file'),
    "device": ("name,lamp,second\nnul.x,1,1\n", '"nul.x" cannot name a file'),
    "no file name": ("name,lamp,second\n,1,1\n", '"" cannot name a file'),
    "open quote": ('name,lamp,second\n"a,1,1\n', "is not CSV"),
    "too bright": ("name,lamp,second\na,1,1\nb,1,1e300\n", "image 2 overflows"),
}


@pytest.mark.parametrize("fault", list(BAD))
def test_bad_tables_are_refused(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str) -> None:
    text, expected = BAD[fault]
    line = here(_argv(basis, tmp_path, text), capsys).refusal(2)
    assert expected in line
    assert fault == "too bright" or "levels.csv" in line
    assert not list(tmp_path.rglob("*.png"))


def test_what_is_no_basis_is_refused(basis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "basis.json" in here(_argv(tmp_path, tmp_path, GOOD), capsys).refusal(2)
    copy = tmp_path / "basis"
    shutil.copytree(basis, copy)
    (copy / "basis" / "lamp.0.exr").write_bytes((basis / "basis" / "lamp.1.exr").read_bytes())
    line = here(_argv(copy, tmp_path, GOOD), capsys).refusal(2)
    assert "lamp.0.exr: is not the file that the basis was made with" in line
    (copy / "basis" / "lamp.0.exr").unlink()
    assert "lamp.0.exr: cannot be read" in here(_argv(copy, tmp_path, GOOD), capsys).refusal(2)
    (copy / "basis" / "lamp.0.exr").write_bytes((basis / "basis" / "lamp.0.exr").read_bytes())
    here(_argv(copy, tmp_path, GOOD), capsys).success()
    told: dict[str, Any] = json.loads((copy / "basis.json").read_bytes())
    for key in ("sources", "block", "files", "camera"):
        (copy / "basis.json").write_text(json.dumps(sealed({name: told[name] for name in told if name != key})))
        assert f"basis.json: {key}: field required" in here(_argv(copy, tmp_path, GOOD), capsys).refusal(2), key
    for changed in ({**told, "exposure_of_radiance": 2 * told["exposure_of_radiance"]}, {**told, "replicates": -1}):
        (copy / "basis.json").write_text(json.dumps(changed))
        assert "basis.json: is not as it was made" in here(_argv(copy, tmp_path, GOOD), capsys).refusal(2)
    same = ["relight", basis, "--levels", _table(tmp_path, GOOD), "--out", basis]
    assert "--out: is the folder of the basis" in here(same, capsys).refusal(2)
    assert "--out: is the folder of the basis" in here([*same[:-1], basis / "basis"], capsys).refusal(2)
    line = here(["relight", basis, "--levels", tmp_path / "no.csv", "--out", tmp_path], capsys).refusal(2)
    assert "no.csv: no such CSV file" in line


def test_a_file_in_the_way_of_the_basis_is_told_before_tracing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "basis").touch()
    argv = ["render", write_scene(tmp_path, TWO), "--basis", "--tolerance", 5, "--out", tmp_path / "out"]
    assert "a file is where a folder is needed" in here(argv, capsys).refusal(2)
    assert not list((tmp_path / "out").rglob("*.exr"))


def test_a_dark_source_has_no_factor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, {"sources.1": {**SECOND, "radiance": "0 W/m^2/sr"}})
    here(["render", scene, "--basis", "--tolerance", 5, "--out", tmp_path / "basis"], capsys).success()
    line = here(_argv(tmp_path / "basis", tmp_path, "name,lamp,second\na,1,1\n"), capsys).refusal(2)
    assert 'the source "second" is dark in the scene' in line


@pytest.mark.long
def test_a_killed_basis_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, {**SLOWER, **TWO})
    how = ["--basis", "--method", "kernel", "--tolerance", 0.5, "--workers", 1]
    argv = ["render", scene, *how, "--out", tmp_path / "out"]
    pieces = tmp_path / "out" / "viewpoints" / "basis"
    with start(argv) as process:
        assert wait_for(lambda: len(list(pieces.glob("tile_*.exr"))) > 0, process), "the run was too short"
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert not (tmp_path / "out" / "manifest.json").exists()
    kept = {path.name: path.read_bytes() for path in pieces.glob("tile_*.exr")}
    here(argv, capsys).success()
    here([*argv[:-1], tmp_path / "good"], capsys).success()
    assert kept
    assert products(tmp_path / "out") == products(tmp_path / "good")
    assert files_in(tmp_path / "out" / "basis") == files_in(tmp_path / "good" / "basis")
    assert not (tmp_path / "out" / "viewpoints").exists()
    assert inhabitants(tmp_path) == []


def test_relit_images_have_an_interval_where_the_scene_states_tolerances(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Behind a lens out of focus, so that the opening's tolerance needs what the basis keeps for it."""
    stated = {"source_radiance": 0.03, "each_source_radiance": 0.1, "aperture_diameter": "10 um", "dark_gray": 1.0}
    scene = write_scene(tmp_path, TWO | {"camera.lens": {"focus_distance": "300 mm"}, "tolerances": stated})
    here(["render", scene, "--basis", "--tolerance", 5, "--out", tmp_path / "basis"], capsys).success()
    told = here(_argv(tmp_path / "basis", tmp_path, GOOD, "--json", "--exposure"), capsys).json["images"]
    out, rendered = tmp_path / "out", json.loads((tmp_path / "basis" / "manifest.json").read_bytes())["uncertainty"]
    assert "gray_sigma/half.exr" in told["half"]["files"]
    # All as it is in the scene: what no share of a source is in is that of the render.
    both, expected = told["both"]["uncertainty"]["parts_rms_gray"], rendered["parts_rms_gray"]
    assert set(both) == set(expected)
    for name, value in expected.items():
        # Central rays there, the whole opening here; of the rest a basis keeps float32, and few pixels see an edge.
        assert both[name] == pytest.approx(value, rel=0.05 if name == "each_source_radiance" else 1e-3)
    assert both["aperture_diameter"] > 0.1
    # Of one source alone the shares are 1: 0.1 of each is 0.1 of all, but for the bend of the response.
    half = told["half"]["uncertainty"]["parts_rms_gray"]
    assert half["each_source_radiance"] == pytest.approx(half["source_radiance"] * 0.1 / 0.03, rel=0.01)
    assert both["each_source_radiance"] < 0.95 * both["source_radiance"] * 0.1 / 0.03
    # Without light the dark level, 1 gray in 95 of 100, and rounding are left; of rays there are none.
    off = read_image(out / "gray_sigma" / "off.exr")[0]
    assert off == pytest.approx(np.full(off.shape, np.sqrt(1 / 1.959964**2 + 1 / 12)), rel=1e-5)


def test_a_linear_cameras_relit_images_have_their_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Read noise of 9 e at 0.5 DN/e, and rounding, where no light is; without tolerances nothing else."""
    linear = {"model": "linear", "rows": 20, "columns": 24, "pixel_width": "0.1 mm", "pixel_height": "0.1 mm"}
    linear |= {"offset": 20, "wavelength": "650 nm", "quantum_efficiency": 0.5, "system_gain": "0.5 DN/e"}
    linear |= {"full_well": "20 ke", "read_noise": "9 e"}
    scene = write_scene(tmp_path, TWO | {"camera.sensor": linear, "camera.exposure_time": "1 us"})
    here(["render", scene, "--basis", "--tolerance", 5, "--out", tmp_path / "basis"], capsys).success()
    here(_argv(tmp_path / "basis", tmp_path, GOOD), capsys).success()
    sigmas = [read_image(tmp_path / "out" / "gray_sigma" / f"{name}.exr")[0] for name in ("off", "both")]
    assert sigmas[0] == pytest.approx(np.full((20, 24), np.sqrt(4.5**2 + 1 / 12)), rel=1e-6)
    assert sigmas[1] == pytest.approx(read_image(tmp_path / "basis" / "gray_sigma.exr")[0], rel=1e-5)


@pytest.mark.parametrize("levels", [{"ring": None}, {"ring": True}, "ring", None])
def test_levels_that_are_no_numbers_are_named_in_python(levels: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError) as failure:
        relight(tmp_path, levels)
    assert failure.value.where is not None
    if isinstance(levels, str) or levels is None:
        assert failure.value.where == "levels"
