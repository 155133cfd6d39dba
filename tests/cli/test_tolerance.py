"""``render`` to a tolerance, as a user sees it."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from radwrap.cli.render import _why
from radwrap.errors import InputError
from tests.cli.conftest import SMALL, here, products, write_scene

ERROR = {
    "rms_gray",
    "rms_gray_upper95",
    "p99_gray_upper95",
    "model_rms_gray",
    "discretisation_rms_gray",
    "certificate_pixels",
    "certificate_rays",
    "method",
}


def test_the_default_is_a_tolerance_of_half_a_gray_level(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = here(["render", write_scene(tmp_path), "--out", tmp_path / "out"], capsys).success()
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_bytes())
    assert manifest["tolerance"] == 0.5 and manifest["method"] in {"kernel", "rays"} and manifest["plan"]["why"]
    assert set(manifest["error"]) == ERROR
    assert manifest["error"]["rms_gray_upper95"] <= 0.5 and manifest["error"]["p99_gray_upper95"] is None
    assert "95 %" in done.stdout and manifest["method"] in done.stdout
    assert not (tmp_path / "out" / "viewpoints").exists()


def test_a_tolerance_beyond_the_budget_ends_with_3_and_the_best_image(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    argv = ["render", write_scene(tmp_path), "--out", out, "--tolerance", 0.01, "--budget", "2e4"]
    done = here(argv, capsys)
    assert done.code == 3 and "tolerance was not met" in done.stderr
    manifest = json.loads((out / "manifest.json").read_bytes())
    assert not manifest["plan"]["met"] and manifest["error"]["rms_gray_upper95"] > 0.01
    assert {"gray.png", "radiant_exposure.exr"} <= set(products(out))
    # The finished run is not run again, and says the same.
    assert here(argv, capsys).code == 3


def test_what_no_more_rays_make_smaller_is_named() -> None:
    """Only where it is half of the squares that the error is made of."""

    def made(lasting: float | None, tolerance: float = 0.9) -> Any:
        taken = None if lasting is None else SimpleNamespace(lasting_gray=lasting)
        return SimpleNamespace(diffraction=taken, error=SimpleNamespace(rms_gray_upper95=1.0), tolerance=tolerance)

    assert _why(made(None)) == _why(made(0.69)) == ""
    assert _why(made(0.9, tolerance=1.1)) == ""  # a largest error was asked for, and missed
    assert _why(made(0.71)).startswith(": 0.71 gray of its error")


@pytest.mark.parametrize(
    "options",
    [
        ["--bounces", "some"],
        ["--budget", "much"],
        ["--budget", "nan"],
        ["--budget", "-1"],
        ["--budget", "5 parsec"],
        ["--tolerance", "0"],
        ["--tolerance", "nan"],
        ["--max-error", "-2"],
        ["--viewpoints", "7", "--tolerance", "0.1"],
        ["--pixel-samples", "2", "--tolerance", "0.1"],
        ["--method", "pinhole", "--max-error", "1"],
        ["--method", "viewpoints", "--budget", "1e6"],
        ["--method", "kernel", "--viewpoints", "7"],
    ],
    ids=" ".join,
)
def test_demands_that_make_no_sense_are_refused(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = here(["render", write_scene(tmp_path), "--out", tmp_path / "out", *options], capsys).refusal(2)
    assert options[-2] in line
    assert not (tmp_path / "out").exists()


def test_a_budget_of_time_is_marked_as_not_reproducible(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["render", write_scene(tmp_path), "--out", tmp_path / "out", "--budget", "60 s", "--json"]
    assert not here(argv, capsys).success().json["plan"]["reproducible"]


def test_any_number_of_workers_gives_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path)
    found = []
    for workers in (1, 3):
        out = tmp_path / f"out{workers}"
        here(["render", scene, "--out", out, "--workers", workers], capsys).success()
        found.append(products(out))
    assert found[0] == found[1]


@pytest.mark.parametrize("options", [["--basis"], ["--viewpoints", 3]], ids=str)
def test_files_of_others_in_the_folder_stay(
    options: list[object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    for folder in ("viewpoints", "basis"):
        (out / folder).mkdir(parents=True)
        (out / folder / "mine.txt").write_text("mine", "ascii")
    (out / "basis.json").write_text("{}", "ascii")
    here(["render", write_scene(tmp_path), "--out", out, *options], capsys).success()
    assert [(out / folder / "mine.txt").read_text("ascii") for folder in ("viewpoints", "basis")] == ["mine", "mine"]
    assert [path.name for path in (out / "viewpoints").iterdir()] == ["mine.txt"]


WALL = {"type": "sheet", "name": "wall", "material": "white", "size": ["200 mm", "200 mm"]}
CORNER = {
    "targets": [
        {"type": "sheet", "name": "floor", "material": "white", "size": ["300 mm", "300 mm"]},
        {**WALL, "position": ["-45 mm", "0 mm", "101 mm"], "rotation": ["0 deg", "90 deg", "0 deg"]},
    ],
    "camera.exposure_time": "20 ms",
}


def test_the_last_line_says_what_its_error_does_not_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rims, always; light between surfaces where it matters, and not where it is traced."""
    argv = ["render", write_scene(tmp_path, CORNER), "--tolerance", 2]
    last = here([*argv, "--out", tmp_path / "out"], capsys).success().stdout.splitlines()[-1]
    left_out = json.loads((tmp_path / "out" / "manifest.json").read_text())["left_out"]["bounces"]
    assert left_out["needed"] and left_out["rms_gray"] > 0.5
    assert "(pixels at rims: far more)" in last
    assert f"; left out: light between surfaces {left_out['rms_gray']:.2g} (at most " in last
    argv += ["--bounces", "all", "--out", tmp_path / "all"]
    assert "left out" not in here(argv, capsys).success().stdout


def test_what_hides_a_target_is_said_before_the_first_ray(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lamp = {**SMALL["sources"][0], "position": ["0 mm", "0 mm", "250 mm"], "diameter": "4 mm"}
    scene = write_scene(tmp_path, {"sources": [lamp]})
    argv = ["render", scene, "--tolerance", 8, "--out", tmp_path / "out"]
    told = here(argv, capsys).success().stderr
    line = 'the disc of "lamp" is between the camera and'
    assert told.count(line) == 1, "and once only"

    def nothing(*_: object, **__: object) -> None:
        raise InputError("no ray yet")

    monkeypatch.setattr("radwrap.cli.render.render", nothing)
    assert line in here(argv, capsys).stderr
