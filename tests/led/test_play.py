"""A play that goes on believes its own record, and no other."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, Final

import pytest

from radwrap.errors import InputError
from radwrap.led.calibration import scaled
from radwrap.led.from_study import rows_of
from radwrap.led.play import Planned, plan, play
from radwrap.led.ring import LedRing
from radwrap.scene.file.load import load_scene
from radwrap.scene.file.ring_calibration import RingCalibration
from radwrap.study.design import read_design
from tests.cli.conftest import scene_text, scene_with
from tests.led.benches import FakeBench
from tests.led.conformance import COUNT, FIRST, there
from tests.led.test_calibration import RING
from tests.led.test_ring import DRIVE

NOMINAL: Final = {f"led{number}": 0.02 for number in range(COUNT)}
CALIBRATION: Final = RingCalibration(
    leds=scaled([0.05] * COUNT, [0.0] * COUNT, [1.0] * COUNT),
    serial=FIRST,
    date="2026-01-01",
    temperature=None,
    current=DRIVE.drive_current,
    emulated=True,
    source="a test",
)


def played(out: Path) -> list[str]:
    """Names of the frames that a play in a folder shows, on a ring of its own."""
    shown: list[str] = []

    def trigger(_: int, frame: Planned) -> None:
        shown.append(frame.name)

    bench = FakeBench("mcp2221a_pca9685")
    with LedRing(bench.open(there(bench)), DRIVE, CALIBRATION) as ring:
        frames = plan(ring, tuple(NOMINAL.values()), None, alone=True)
        play(ring, frames, out, nominal=NOMINAL, trigger=trigger, settle=0.0)
    return shown


def without(*path: str) -> Callable[[Any], Any]:
    """What takes a key away."""

    def change(told: Any) -> None:
        for key in path[:-1]:
            told = told[key]
        del told[path[-1]]

    return change


def with_other(value: object, *path: str) -> Callable[[Any], Any]:
    """What gives a key another value."""

    def change(told: Any) -> None:
        for key in path[:-1]:
            told = told[key]
        told[path[-1]] = value

    return change


CHANGES: Final = {
    "no timing": without("timing"),
    "no frames": without("frames"),
    "nothing held": without("frames", "led01", "held"),
    "no moment": without("timing", "begin", "led01"),
    "moments are a number": with_other(3, "timing", "begin"),
    "a moment is none": with_other([1], "timing", "begin", "led01"),
    "a frame is a number": with_other(3, "frames", "led01"),
    "frames are a number": with_other(3, "frames"),
    "other light": with_other([0.9] * COUNT, "frames", "led01", "held"),
    "other steps": with_other([1] * COUNT, "frames", "led01", "steps"),
    "not verified": with_other(False, "frames", "led01", "verified"),
    "a foreign frame": lambda told: (told["frames"].update(x=1), told["timing"]["begin"].update(x="now")),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("a play")
    assert played(out) == ["dark", *(f"led{number:02d}" for number in range(COUNT))]
    return out


@pytest.mark.parametrize("what", list(CHANGES))
def test_a_record_that_was_changed_is_not_believed(whole: Path, tmp_path: Path, what: str) -> None:
    told = json.loads((whole / "play.json").read_text())
    CHANGES[what](told)
    (tmp_path / "play.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match=r"play\.json: is not a complete record of this play"):
        played(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["play.json"]


def test_a_record_of_some_frames_is_gone_on_with(whole: Path, tmp_path: Path) -> None:
    told = json.loads((whole / "play.json").read_text())
    for name in ("led04", "led11"):
        without("frames", name)(told)
        without("timing", "begin", name)(told)
    (tmp_path / "play.json").write_text(json.dumps({**told, "complete": False}))
    assert played(tmp_path) == ["led04", "led11"]
    assert (tmp_path / "played.csv").read_bytes() == (whole / "played.csv").read_bytes()
    assert played(whole) == []


DESIGN: Final = """
scene = "scene.toml"
[design]
kind = "full"
[factors.A]
key = "{key}"
levels = {levels}
[factors.B]
key = "sources[0].leds[3].radiance_factor"
levels = [1.2, 0.8, 1.0]
[responses.mean]
measure = "mean_gray"
"""


def study_rows(folder: Path, key: str, levels: str) -> tuple[tuple[str, ...], list[list[float]]]:
    (folder / "scene.toml").write_text(scene_text(scene_with({"sources": [RING]})))
    (folder / "design.toml").write_text(DESIGN.format(key=key, levels=levels))
    rows = rows_of(read_design(folder / "design.toml"), load_scene(folder / "scene.toml"))
    return rows.names, rows.factors.tolist()


def test_the_runs_of_a_study_are_rows(tmp_path: Path) -> None:
    names, factors = study_rows(tmp_path, "sources[0].leds[0].radiance_factor", "[0.0, 0.5]")
    assert names == tuple(f"run{number:04d}" for number in range(1, 7))
    for row, (first, fourth) in zip(factors, product((0.0, 0.5), (1.2, 0.8, 1.0)), strict=True):
        assert row == pytest.approx([first, 1, 1, fourth, *[1] * 8], rel=1e-12)
    _, factors = study_rows(tmp_path, "sources[0].radiant_intensity", '["50 mW/sr", "25 mW/sr"]')
    assert factors[3] == pytest.approx([0.5, 0.5, 0.5, 0.6, *[0.5] * 8], rel=1e-12)


@pytest.mark.parametrize(
    ("key", "levels"),
    [
        ("camera.exposure_time", '["100 ms", "200 ms"]'),
        ("targets[0].pitch", '["40 mm", "41 mm"]'),
        ("sources[0].diameter", '["25 mm", "26 mm"]'),
    ],
)
def test_a_study_that_changes_the_bench_is_not_played(tmp_path: Path, key: str, levels: str) -> None:
    with pytest.raises(InputError, match=r"design\.toml: run \d: differs from scene\.toml in more than the light"):
        study_rows(tmp_path, key, levels)
