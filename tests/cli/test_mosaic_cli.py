"""A colour camera on the command line: colour.png, one colour measured, and what is refused by name."""

from __future__ import annotations

import json
import shutil
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from radwrap.cli.main import main

CHART = Path(__file__).parents[2] / "rad_scenes" / "colour_chart"
QUICK = ("--tolerance", "8", "--tracer", "compiled", "--set", "camera.diffraction=off")


class Done(NamedTuple):
    """What a command gave back."""

    returncode: int
    stdout: str
    stderr: str


def radwrap(*words: str | Path) -> Done:
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        code = main([str(word) for word in words])
    return Done(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def chart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The chart, rendered in a folder."""
    out = tmp_path_factory.mktemp("chart") / "out"
    made = radwrap("render", CHART / "scene.toml", "--out", out, "--demosaic", "--frames", "1", *QUICK)
    assert made.returncode == 0, made.stderr
    assert "raw mosaic RGGB: red below" in made.stdout
    return out


def test_colour_png_shows_the_paints(chart: Path) -> None:
    picture = cv2.imread(str(chart / "colour.png"))[:, :, ::-1].astype(float)
    assert picture.shape == (120, 160, 3)
    fields = {"red": (35, 35), "green": (35, 80), "blue": (35, 125)}  # row and column of their middles
    for n, (row, column) in enumerate(fields.values()):
        assert np.argmax(picture[row, column]) == n


def test_one_colour_is_measured_in_raw_pixels(chart: Path) -> None:
    """The left rim of the red field is where the scene has it, as near as every second pixel tells of a sharp edge."""
    words = ("measure", "edge", chart / "gray.png", "--dark", "4", "--gamma", "1", "--region", "4", "24", "24", "46")
    found = radwrap(*words, "--channel", "red", "--json")
    assert found.returncode == 0, found.stderr
    assert "the red of the raw mosaic RGGB, in raw pixels" in found.stderr
    # 37 mm off the axis at 500 mm; the image of a lens of 12 mm is at 12.295 mm.
    expected = 79.5 - 37 / (13.8e-3 * 500 / 12.295)
    assert json.loads(found.stdout)["centre"][0] == pytest.approx(expected, abs=1)


def test_the_manifest_says_the_mosaic(chart: Path, tmp_path: Path) -> None:
    green = radwrap("measure", "parts", chart / "gray.png")
    assert green.returncode == 0 and "the green of the raw mosaic RGGB" in green.stderr
    other = radwrap("measure", "parts", chart / "gray.png", "--mosaic", "BGGR")
    assert other.returncode == 2 and "--mosaic: is BGGR, but the manifest" in other.stderr
    shutil.copy(chart / "gray.png", tmp_path)
    lost = radwrap("measure", "parts", tmp_path / "gray.png", "--channel", "red")
    assert lost.returncode == 2 and "give --mosaic" in lost.stderr
    told = radwrap("measure", "parts", tmp_path / "gray.png", "--mosaic", "RGGB")
    assert told.stdout == green.stdout


def test_raw_images_are_compared_as_they_are_or_in_one_colour(chart: Path, tmp_path: Path) -> None:
    shutil.copy(chart / "frame_0000.png", tmp_path / "photo.png")
    words = ("compare", tmp_path / "photo.png", chart / "gray.png")
    assert radwrap(*words).returncode == 0
    mixed = radwrap(*words, "--register", "translation")
    assert mixed.returncode == 2 and "--register: would mix the colours of the raw mosaic RGGB" in mixed.stderr
    one = radwrap(*words, "--register", "translation", "--channel", "green")
    assert one.returncode == 0, one.stderr


REFUSED = {
    "region": ("measure", "region", "{chart}/gray.png"),
    "uniformity": ("measure", "uniformity", "{chart}/gray.png"),
    "photo-realistic": ("render", "{scene}", "--out", "{out}", "--photo-realistic"),
    "face": ("face", "{scene}", "--port", "0", "--no-browser"),
    "convert": ("convert", "{scene}", "{out}.rad"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_knows_one_colour_refuses_by_name(name: str, chart: Path, tmp_path: Path) -> None:
    places = {"chart": chart, "scene": CHART / "scene.toml", "out": tmp_path / "out"}
    done = radwrap(*(word.format(**places) for word in REFUSED[name]))
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "mosaic" in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_explain_looks_at_the_colour_with_most_light_or_the_one_that_is_asked_for() -> None:
    words = ("explain", CHART / "scene.toml", "--no-rays", "--json")
    green, red = (json.loads(radwrap(*words, *more).stdout) for more in ((), ("--channel", "red")))
    assert (green["mosaic"], green["channel"], red["channel"]) == ("RGGB", "green", "red")
    plane = json.loads(radwrap(*words, "--set", "camera.sensor.mosaic=red").stdout)
    assert red["in_sight"] == plane["in_sight"] != green["in_sight"] and "channel" not in plane
    assert "the green pixels of the raw mosaic RGGB" in radwrap("explain", CHART / "scene.toml", "--no-rays").stdout
    wrong = radwrap(*words, "--set", "camera.sensor.mosaic=red", "--channel", "red")
    assert wrong.returncode == 2 and "--channel: is a colour of a raw mosaic" in wrong.stderr


def test_the_plane_of_a_colour_is_not_measured_as_a_mosaic(chart: Path) -> None:
    """Its manifest says that all pixels have one filter, whatever the scene's file says."""
    plane = chart / "planes" / "red" / "gray.png"
    words = ("measure", "parts", plane)
    found = radwrap(*words, "--json")
    assert found.returncode == 0 and "raw mosaic" not in found.stderr
    for option in (("--mosaic", "RGGB"), ("--channel", "red")):
        wrong = radwrap(*words, *option)
        assert wrong.returncode == 2 and f"{option[0]}: is of a raw mosaic" in wrong.stderr, wrong.stderr


def test_demosaic_needs_a_mosaic(tmp_path: Path) -> None:
    scene = (CHART / "scene.toml", "--set", "camera.sensor.mosaic=green")
    done = radwrap("render", *scene, "--out", tmp_path / "out", "--demosaic")
    assert done.returncode == 2 and "--demosaic: needs a colour camera" in done.stderr


@pytest.mark.long
def test_a_dry_run_tells_each_plane() -> None:
    done = radwrap("render", CHART / "scene.toml", "--dry-run", *QUICK)
    assert done.returncode == 0, done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["green", "red", "blue"]


@pytest.mark.long
def test_a_tolerance_that_a_plane_misses_is_not_met(tmp_path: Path) -> None:
    done = radwrap(
        *("render", CHART / "scene.toml", "--out", tmp_path / "out", "--tolerance", "0.05", "--budget", "1e4"),
        *("--set", "camera.diffraction=off", "--roi", 20, 20, 59, 49),
    )
    assert done.returncode == 3, done.stderr
