"""The belt of rad_scenes: what the commands say of motion, and who refuses it by name."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from radwrap.imaging.in_time.moving import planned_instants
from radwrap.scene.file.load import load_scene
from tests.cli.conftest import here

BELT = Path(__file__).parents[2] / "rad_scenes" / "moving_belt" / "scene.toml"


def test_explain_says_how_fast_the_belt_may_run(capsys: pytest.CaptureFixture[str]) -> None:
    lines = here(["explain", BELT, "--no-rays"], capsys).success().stdout.splitlines()
    assert any(
        line.startswith("belt: half a pixel of smear at ") and "light comes in for 2 ms" in line for line in lines
    )
    assert any(line.startswith("key: it moves by ") for line in lines)
    dark = ["--set", 'sources[1].strobe={ delay = "1.5 ms", width = "0.3 ms" }']
    found = json.loads(here(["explain", BELT, "--no-rays", "--json", *dark], capsys).success().stdout)
    belt = next(one for one in found["motion"] if one["target"] == "belt")
    assert belt["light_time"] == pytest.approx(0.3e-3)
    # 20.7 um behind 16 mm focused at 300 mm: 0.3675 mm on the belt.
    assert belt["half_pixel_speed"] == pytest.approx(0.3675e-3 / 2 / 0.3e-3, rel=1e-3)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["render", BELT, "--photo-realistic", "point", "--out"], "--photo-realistic"),
        (["face", BELT, "--no-browser", "--out"], "the page"),
    ],
)
def test_what_knows_one_instant_is_refused(
    words: list[str], what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = here([*words, tmp_path / "out"], capsys).refusal(2)
    assert what in told and "camera.sensor.shutter" in told


@pytest.mark.long
def test_a_dry_run_tells_the_instants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As many as the render of the example makes; none where nothing moves."""
    words = ["--dry-run", "--tolerance", "8"]
    told = here(["render", BELT, *words, "--json"], capsys).success().json
    assert told["instants"] == planned_instants(load_scene(BELT), 0) == 26 and told["rays"] > 0
    assert "26 more instants at least" in here(["render", BELT, *words], capsys).success().stdout
    still = tmp_path / "still.toml"
    still.write_text("\n".join(line for line in BELT.read_text().splitlines() if "velocity" not in line))
    assert "instants" not in here(["render", still, *words, "--json"], capsys).success().json


def test_convert_says_that_files_know_one_instant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = here(["convert", BELT, tmp_path / "belt.rad"], capsys).success()
    assert "targets[2].velocity: files know one instant" in told.stderr
