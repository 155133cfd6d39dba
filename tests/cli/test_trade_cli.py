"""``radwrap trade`` as users run it: what it writes, that it goes on, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from matplotlib.image import imread

from tests.cli.conftest import files_in, here, write_scene

# No setting of these may be left out for its time, however busy the machine is.
QUICK: Final = ("--reference-pixels", 100, "--reference-rays", 64, "--longest", "1e6 s")
COLUMNS: Final = {"options", "rays", "rms_gray", "rms_gray_upper", "p99_gray", "max_gray", "wall_s", "cpu_s", "pareto"}


@pytest.fixture(autouse=True)
def _few_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that take long are left to users."""
    monkeypatch.setattr("radwrap.study.trade._NUMBERS", (7, 19))
    monkeypatch.setattr("radwrap.study.trade._SHARES", (4.0, 2.0))


def _argv(scene: Path, out: Path, *more: object) -> list[object]:
    return ["trade", scene, "--out", out, *QUICK, *more]


def _rows(numbers: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in numbers["settings"]}


@pytest.mark.long
def test_a_trade_writes_all_it_promises_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_scene(tmp_path), tmp_path / "out"
    done = here(_argv(scene, out, "--json"), capsys).success()
    numbers = done.json
    assert json.loads((out / "trade.json").read_bytes()) == numbers
    rows = _rows(numbers)
    assert {"pinhole", "kernel_tolerance-2", "hybrid_tolerance-2"} <= set(rows)
    assert rows["hybrid_tolerance-2"]["rms_gray_upper"] < rows["pinhole"]["rms_gray"]
    assert any(name.startswith("viewpoints-7") for name in rows)
    assert rows["pinhole"]["rms_gray"] > 5 * rows["kernel_tolerance-2"]["rms_gray"]
    assert rows["kernel_tolerance-2"]["certified_rms_gray_upper95"] <= 2
    table = list(csv.DictReader((out / "trade.csv").read_text("utf-8").splitlines()))
    assert [row["name"] for row in table] == list(rows) and set(table[0]) >= COLUMNS
    assert [row["name"] for row in table if row["pareto"] == "1"] and float(table[0]["rms_gray"]) > 0
    assert {row["name"] for row in table if row["pareto"] == "1"} == set(numbers["timing"]["pareto_front"])
    picture = imread(out / "trade.png")
    assert len(np.unique(picture)) > 50  # curves, text and grid, not an empty sheet
    assert numbers["timing"]["recommendation"].endswith(".")

    # Started again, what is finished stays as it is, what was lost is made again, and what is broken too.
    kept, lost, broken = (out / "settings" / f"{name}.json" for name in ("pinhole", "kernel_tolerance-2", "reference"))
    marked = json.loads(kept.read_bytes())
    marked["content"]["wall_s"] = 1234.5
    kept.write_text(json.dumps(marked))
    lost.unlink()
    broken.write_text(broken.read_text()[:-100])
    again = here(_argv(scene, out, "--json"), capsys).success().json
    assert again["timing"]["settings"]["pinhole"]["wall_s"] == 1234.5
    common = set(rows) & set(_rows(again))
    assert "kernel_tolerance-2" in common
    assert {name: _rows(again)[name] for name in common} == {name: rows[name] for name in common}
    assert again["reference"] == numbers["reference"]


@pytest.mark.long
def test_other_seeds_do_not_use_what_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An infinitesimal pinhole has no sub-viewpoints; another seed draws other rays; people read lines."""
    scene = write_scene(tmp_path, {"camera.aperture.diameter": "0 mm", "camera.aperture.exposure_diameter": "0.4 mm"})
    first = here(_argv(scene, tmp_path / "out"), capsys).success()
    rows = (tmp_path / "out" / "settings").iterdir
    before = {path.name: json.loads(path.read_bytes())["run_sha256"] for path in rows()}
    assert "pinhole_pixel-samples-4.json" in before and not any(
        name.startswith(("viewpoints", "hybrid")) for name in before
    )
    last = first.stdout.splitlines()[-1]
    assert last.endswith(".") and "gray" in last
    here(_argv(scene, tmp_path / "out", "--seed", 1), capsys).success()
    after = {path.name: json.loads(path.read_bytes())["run_sha256"] for path in rows()}
    assert after["pinhole.json"] != before["pinhole.json"]
    assert not [name for name in files_in(tmp_path / "out") if ".part" in name or ".work" in name]


def test_what_takes_too_long_is_left_out_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    numbers = here(_argv(write_scene(tmp_path), out, "--longest", "1 ms", "--json"), capsys).success().json
    # 40 000 rays in a millisecond are beyond any tracer here.
    left = {entry["name"]: entry["why"] for entry in numbers["left_out"]}
    assert "expected to take longer than 0.001 s" in left["rays_tolerance-2"]
    assert "rays_tolerance-2" not in _rows(numbers)
    assert not (out / "settings" / "rays_tolerance-2.json").exists()
    assert set(left).isdisjoint(_rows(numbers)) and (out / "trade.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("options", "where"),
    [
        (("--longest", "0 s"), "--longest"),
        (("--longest", "60"), "--longest"),
        (("--reference-rays", 1), "--reference-rays"),
        (("--reference-pixels", 0), "--reference-pixels"),
        (("--workers", 0), "--workers"),
        (("--seed", -1), "--seed"),
    ],
)
def test_bad_options_are_refused(
    options: tuple[object, ...], where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert where in here(["trade", write_scene(tmp_path), "--out", out, *options], capsys).refusal(2)
    assert not out.exists()


def test_a_folder_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--out: is missing" in here(["trade", write_scene(tmp_path)], capsys).refusal(2)
