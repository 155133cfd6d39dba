"""Scenes to start from: each renders as it is, shows what it says, and is bright enough and not too bright."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from radwrap.cli.start import TEMPLATES
from radwrap.images import read_image
from radwrap.scene.file.load import load_scene
from tests.cli.conftest import here

WHOLE = [
    pytest.param(
        name,
        marks=[pytest.mark.long]
        if name in ("ring", "dome", "backlight", "coaxial", "darkfield", "calibration")
        else [],
    )
    for name in TEMPLATES
]


@pytest.mark.parametrize("name", WHOLE)
def test_a_template_renders_as_it_is(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "my scene"
    told = here(["init", folder, "--template", name], capsys).success().stdout
    path = folder / "scene.toml"
    assert f"radwrap render {path}" in told
    scale = [] if name == "retro" else ["--scale", "1/8"]
    here(["render", path, *scale, "--out", folder / "out"], capsys).success()
    scene = load_scene(path)
    assert (scene.camera.sensor.linear is None) == (scene.camera.lens is None) == (name == "retro")
    if name == "retro":
        return
    gray = read_image(folder / "out" / "gray.png")[0].astype(float)
    full = scene.camera.sensor.saturation_gray
    # A thousandth of the pixels may be brighter: highlights on a ball, all that a dark field has bright.
    assert 0.6 * full < (gray.max() if name == "darkfield" else np.percentile(gray, 99.9))
    assert np.percentile(gray, 99.9) < 0.9 * full
    assert gray.max() < full


@pytest.mark.long
@pytest.mark.parametrize(("name", "inside"), [("ring", "bright"), ("backlight", "dark")])
def test_its_part_can_be_measured(name: str, inside: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here(["init", tmp_path / "it", "--template", name], capsys).success()
    path, out = tmp_path / "it" / "scene.toml", tmp_path / "out"
    # Of 4095 levels: the rim of a washer is known far better than by one pixel's gray.
    how = ["--scale", "1/8", "--tracer", "compiled", "--tolerance", "32"]
    here(["render", path, *how, "--out", out], capsys).success()
    words = ["measure", "circle", out / "gray.png", "--scene", path, "--scale", "1/8", "--truth", "washer", "--json"]
    found = json.loads(here(words, capsys).success().stdout)
    assert found["outer"]["inside"] == inside
    # In the plane of the washer's top; a backlight shows the widest of a thick part there and at its lower face.
    assert found["outer"]["diameter"] == pytest.approx(24, abs=0.1)


def test_without_a_template_it_is_the_papers_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, words in (("a", []), ("b", ["--template", "retro"])):
        here(["init", tmp_path / name, *words], capsys).success()
    files = [sorted(path.name for path in (tmp_path / name).iterdir()) for name in "ab"]
    assert files == [["scene.toml"], ["scene.toml"]]
    assert (tmp_path / "a" / "scene.toml").read_bytes() == (tmp_path / "b" / "scene.toml").read_bytes()


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "washer.obj").write_text("mine")
    done = here(["init", tmp_path, "--template", "ring"], capsys)
    assert done.code == 2 and "washer.obj" in done.stderr and "is there already" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["washer.obj"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("camera.exposure=1", 'camera.exposure: unknown key; did you mean "exposure_time"?'),
        ("camera.sensor.ful_well=1", 'did you mean "full_well"?'),
        ("sources[0].beam.widht=1", 'did you mean "width"?'),
        ("sources[0].type=rign", 'did you mean "ring"?'),
        ("targets[1].material=paint", 'no material "paint"; did you mean "painted"?'),
        ("materials.belt.colour=1", "known are spectrum, type, reflectance"),
    ],
)
def test_what_is_misspelled_is_guessed(
    change: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here(["init", tmp_path, "--template", "ring"], capsys).success()
    done = here(["explain", tmp_path / "scene.toml", "--set", change], capsys)
    assert done.code == 2 and message in done.stderr, done.stderr


def test_options_take_each_path_that_a_study_takes() -> None:
    path = Path("rad_scenes/bench_board/scene.toml").absolute()
    one = load_scene(path, {"sources[0].leds[3].radiance_factor": 0.5})
    each = load_scene(path, {"sources[0].leds[*].radiance_factor": 0.5})
    plain = load_scene(path)
    shares = [[a.radiance / b.radiance for a, b in zip(s.emitters, plain.emitters, strict=True)] for s in (one, each)]
    assert shares[0] == pytest.approx([1, 1, 1, 0.5] + [1] * 8)
    assert shares[1] == pytest.approx([0.5] * 12)
