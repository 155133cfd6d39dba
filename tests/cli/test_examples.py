"""Examples of the documentation come from the package, whole, and over nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from radwrap.cli.init_examples import names
from radwrap.scene.file.load import load_scene
from tests.cli.conftest import here

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "rad_scenes"
# Files that describe something beside a scene.
NO_SCENES = {"design.toml", "dataset.toml", "captures.toml", "rw192.toml"}


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_folder_of_scenes_is_an_example() -> None:
    assert set(names()) == {path.parent.relative_to(SCENES).as_posix() for path in SCENES.glob("*/**/*.toml")}
    assert all(names().values()), "each has a title"


@pytest.mark.parametrize("name", names())
def test_an_example_is_whole(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It has the bytes of the repository, and its scenes load where it was written."""
    folder = tmp_path / "an example"
    done = here(["init", folder, "--example", name], capsys).success()
    written = _files(folder)
    source = SCENES if f"{name}/design.toml" in written else SCENES / name
    assert written == {path: (source / path).read_bytes() for path in written}
    own = {path for path in _files(SCENES / name) if "/" not in path} - {"scene.rad", "gray.png"}
    assert {Path(path).name for path in written} >= own
    scenes = [folder / path for path in written if path.endswith(".toml") and Path(path).name not in NO_SCENES]
    for path in scenes:
        load_scene(path)
    assert scenes
    first = done.stdout.splitlines()[0]
    assert Path(first).is_file() and f" {first} --out {folder / 'out'}" in done.stdout


@pytest.mark.parametrize(
    ("name", "verb", "path"),
    [
        ("bench_board", "render", "scene.toml"),
        ("cells", "render", "area_ring.toml"),
        ("dataset_parts", "dataset run", "dataset.toml"),
        ("design_field", "design run", "design.toml"),
        ("study_ring", "study run", "study_ring/design.toml"),
    ],
)
def test_the_command_to_begin_with_is_named(
    name: str, verb: str, path: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "it"
    told = here(["init", folder, "--example", name], capsys).success().stdout
    assert told.splitlines()[-1] == f"begin with: radwrap {verb} {folder / path} --out {folder / 'out'}"


def test_a_design_stands_beside_the_scene_that_it_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here(["init", tmp_path, "--example", "study_ring"], capsys).success()
    assert set(_files(tmp_path)) == {"study_ring/design.toml", "bench_board/scene.toml"}


def test_the_list_names_all(capsys: pytest.CaptureFixture[str]) -> None:
    told = here(["init", "--list"], capsys).success().stdout
    assert "  darkfield\n" in told and "  crosscheck/solids " in told and "Bench: oriented calibration board" in told
    assert len(told.splitlines()) == 2 + 7 + len(names())


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "long.png").write_text("mine")
    told = here(["init", tmp_path, "--example", "twin"], capsys).refusal(2)
    assert "long.png" in told and "is there already" in told
    assert _files(tmp_path) == {"long.png": b"mine"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["DIR", "--example", "benchboard"], '--example: no example "benchboard"; did you mean "bench_board"?'),
        (["DIR", "--example", "../data"], '--example: no example "../data"; `radwrap init --list` names them all'),
        (["DIR", "--example", ""], '--example: no example ""; `radwrap init --list`'),
        (["DIR", "--example", "twin", "--template", "ring"], "--example: goes without --template"),
        (["DIR", "--example", "twin", "--camera", "fivs"], "--camera: goes without --example"),
        (["DIR", "--list"], "--list: goes without DIR"),
        (["--example", "twin"], "DIR: has no name; name a folder"),
    ],
)
def test_what_is_wrong_is_named(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new"
    told = here(["init", *(folder if word == "DIR" else word for word in words)], capsys).refusal(2)
    assert message in told
    assert not folder.exists()
