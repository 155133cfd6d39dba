"""Same input and seed, same bytes: whatever the number of workers, whatever the folders are called."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import here, products, run, side_by_side, write_scene

RING = {
    "type": "ring",
    "name": "ring",
    "position": ["0 mm", "0 mm", "500 mm"],
    "look_at": ["0 mm", "0 mm", "0 mm"],
    "count": 3,
    "diameter": "25 mm",
    "led_diameter": "5 mm",
    "radiance": "100 kW/m^2/sr",
    "beam": {"profile": "gaussian", "width": "20 deg"},
}
SHEETING = {"type": "retroreflective", "model": "perturbed_normal", "reflectance": 0.6, "roughness": 0.02}
SHADED = """void brightfunc shade
2 s shade.cal
0 0
shade plastic paint 0 0 5 .5 .5 .5 0 0
paint sphere ball 0 0 4 0 0 0 .01
"""
CHANGES: dict[str, Any] = {"sources.1": RING, "materials.white": SHEETING}


@pytest.mark.parametrize("workers", [[1, 5], pytest.param([1, 2, 5, 2], marks=pytest.mark.long)], ids=len)
def test_any_number_of_workers_gives_the_same_bytes(tmp_path: Path, workers: list[int]) -> None:
    """Truth and jitter included; each by a process of its own."""
    scene = write_scene(tmp_path, CHANGES)
    options = ["--viewpoints", 19, "--pixel-samples", 2, "--pixel-sampling", "jitter", "--seed", 7, "--truth"]
    outs = [tmp_path / f"out{index}" for index in range(len(workers))]
    argv = [["render", scene, "--out", out, *options, "--workers", w] for out, w in zip(outs, workers, strict=True)]
    assert [done.code for done in side_by_side(lambda words: run(*words), argv)] == [0] * len(workers)
    found = [products(out) for out in outs]
    names = {"gray.png", "radiant_exposure.exr", "depth.exr", "mask.png", "truth.json", "manifest.json"}
    assert set(found[0]) == names
    assert [other == found[0] for other in found] == [True] * len(workers)


@pytest.mark.long
def test_the_seed_decides_the_jitter_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, CHANGES)

    def images(name: str, *options: object) -> tuple[bytes, bytes]:
        out = tmp_path / name
        here(["render", scene, "--out", out, "--viewpoints", 7, *options], capsys).success()
        found = products(out)
        return found["gray.png"], found["radiant_exposure.exr"]

    jitter = ["--pixel-sampling", "jitter", "--seed"]
    first, second, again = images("a", *jitter, 1), images("b", *jitter, 2), images("c", *jitter, 1)
    assert first == again
    assert first[1] != second[1]
    assert images("d", "--seed", 1) == images("e", "--seed", 2)
    assert images("f", *jitter, 2**63 - 1)[1] != first[1]


@pytest.mark.parametrize(
    "place",
    [
        pytest.param("with a blank", marks=pytest.mark.long),
        "-rf/größe µ 日本/$HOME; !touch touched; {x} %d * ? [a] ~",
        pytest.param("quote ' and \" and `", marks=pytest.mark.long),
        pytest.param("colon:and,comma", marks=pytest.mark.long),
        pytest.param("a.b/.hidden/..name", marks=pytest.mark.long),
    ],
)
def test_folders_may_be_called_anything(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scene, included files and results in a folder of that name, against plain names; paths relative and absolute."""
    plain, odd = tmp_path / "plain", tmp_path / "odd" / place
    changes = {**CHANGES, "targets.1": {"type": "rad", "name": "room", "rad": "sub/room.rad"}}
    for home in (plain, odd):
        write_scene(home, changes)
        (home / "sub").mkdir()
        (home / "sub" / "room.rad").write_text(SHADED, "ascii")
        (home / "sub" / "shade.cal").write_text("s = .5;\n", "ascii")
    options = ["--viewpoints", 3, "--truth"]
    here(["render", plain / "scene.toml", "--out", plain / "out", *options], capsys).success()
    here(["render", odd / "scene.toml", "--out", odd / "out", *options], capsys).success()
    assert products(odd / "out") == products(plain / "out")
    monkeypatch.chdir(odd)
    here(["render", "scene.toml", "--out", "again", *options], capsys).success()
    assert products(odd / "again") == products(plain / "out")
    here(["convert", "scene.toml", "converted/room.rad"], capsys).success()
    assert (odd / "converted" / "room.rad").is_file()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["odd", "plain"]
    assert not list(tmp_path.rglob("touched"))


def test_a_trusted_file_may_lie_in_an_odd_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], radiance: Path
) -> None:
    odd = tmp_path / "größe 'µ' $x"
    scene = write_scene(odd, {"targets.1": {"type": "rad", "rad": "räum 1.rad"}})
    (odd / "räum 1.rad").write_text("!xform -n 1 'b c.rad'\n", "utf-8")
    (odd / "b c.rad").write_text(SHADED, "ascii")
    (odd / "shade.cal").write_text("s = .5;\n", "ascii")
    (odd / "Radiance ä 1").symlink_to(radiance, target_is_directory=True)
    options = ["--viewpoints", 1, "--trust", "--radiance", odd / "Radiance ä 1"]
    here(["render", scene, "--out", odd / "out", *options], capsys).success()
    here(["render", scene, "--out", odd / "out", "--viewpoints", 1], capsys).refusal(2)


def test_the_place_of_the_results_does_not_matter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moved, copied, or reached by another way: the result is known again."""
    scene = write_scene(tmp_path)
    argv = ["render", scene, "--viewpoints", 7, "--keep-viewpoints", "--json"]
    first = here([*argv, "--out", tmp_path / "out"], capsys).success().json
    shutil.copytree(tmp_path / "out", tmp_path / "deep" / "er" / "copy")
    assert here([*argv, "--out", tmp_path / "deep" / "er" / "copy"], capsys).success().json == first
    (tmp_path / "link").symlink_to(tmp_path / "out", target_is_directory=True)
    assert here([*argv, "--out", tmp_path / "link"], capsys).success().json == first
    monkeypatch.chdir(tmp_path / "deep")
    assert here([*argv, "--out", "../out/"], capsys).success().json == first
    assert here([*argv, "--out", "."], capsys).success().json["scene_sha256"] == first["scene_sha256"]
    assert str(tmp_path) not in (tmp_path / "out" / "manifest.json").read_text("utf-8")
