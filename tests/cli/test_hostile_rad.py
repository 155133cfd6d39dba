"""Included Radiance files, through the whole command: no command runs, no foreign file is opened, without --trust."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import children, files_in, here, inhabitants, products, run, side_by_side, write_scene

GRAY = "void plastic paint 0 0 5 .5 .5 .5 0 0\n"
BALL = "paint sphere ball 0 0 4 0 0 0 .02\n"
FOREIGN = "words of a foreign file\n"
ROOM = {"targets.1": {"type": "rad", "name": "room", "rad": "room.rad"}}


def _lay(folder: Path, files: Mapping[str, str | bytes]) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def _argv(home: Path, *options: object) -> list[object]:
    return ["render", home / "scene.toml", "--out", home / "out", "--viewpoints", 7, *options]


def _nothing_happened(folder: Path, before: Mapping[str, bytes]) -> None:
    """No file but the folder's lock is new, none has changed, and nobody still works there."""
    after = {name: content for name, content in files_in(folder).items() if not name.endswith(".radwrap.lock")}
    assert after == before
    assert inhabitants(folder) == []


@dataclass(frozen=True, eq=False)
class Rad:
    """An included file that must be refused; `says` is in the message."""

    name: str
    room: str | bytes
    says: str
    files: Mapping[str, str | bytes] = field(default_factory=dict)


RADS = [
    Rad("command at line start", f"!touch touched\n{GRAY}{BALL}", "!"),
    Rad("command after blanks", f" \t !touch touched\n{GRAY}{BALL}", "!"),
    Rad("command in mid-line", f"{GRAY.strip()} !touch touched\n{BALL}", "!"),
    Rad("command within a primitive", "void plastic !touch touched\n", "!"),
    Rad("command after a carriage return", f"{GRAY.strip()}\r!touch touched\r{BALL}", "!"),
    Rad("command at the end without newline", f"{GRAY}{BALL}!touch touched", "!"),
    Rad("instance", f"{GRAY}void instance copy 1 copy.oct 0 0\n", "instance", {"copy.oct": b"#?RADIANCE\n"}),
    Rad("mesh", f"{GRAY}paint mesh copy 1 copy.rtm 0 0\n", "mesh", {"copy.rtm": b"#?RADIANCE\n"}),
    Rad("function file of another folder", "void brightfunc b 2 f ../secret.cal 0 0\n" + BALL, "../secret.cal"),
    Rad("function file with a whole path", "void brightfunc b 2 f /etc/passwd 0 0\n" + BALL, "/etc/passwd"),
    Rad("function file by a link", "void brightfunc b 2 f link.cal 0 0\n" + BALL, "link.cal"),
    Rad("function file by a variable", "void brightfunc b 2 f $HOME/x.cal 0 0\n" + BALL, "$HOME/x.cal"),
    Rad("picture by command", 'void colorpict p 7 red green blue "!touch touched" . u v 0 0\n' + BALL, "!"),
    Rad("empty file", "", "no Radiance primitive"),
    Rad("unknown primitive", "void gizmo g 0 0 0\n", "gizmo"),
    Rad("ends early", "void plastic paint 0 0 5 .5", "room.rad"),
    Rad("not finite", GRAY + "paint sphere ball 0 0 4 0 0 nan 1\n", "nan"),
    Rad("binary", b"\x00\x01\x02", "NUL"),
]


@pytest.mark.parametrize("rad", [pytest.param(rad, id=rad.name) for rad in RADS])
def test_a_hostile_file_is_refused(rad: Rad, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "home"
    write_scene(home, ROOM)
    _lay(tmp_path, {"secret.cal": FOREIGN})
    _lay(home, {"room.rad": rad.room, **rad.files})
    (home / "link.cal").symlink_to("../secret.cal")
    before = files_in(tmp_path)
    line = here(_argv(home), capsys).refusal(2)
    assert line.startswith("radwrap: scene.toml: targets[1].rad: ")
    assert rad.says in line
    assert FOREIGN.strip() not in line and "root:" not in line
    _nothing_happened(tmp_path, before)
    assert children() == []


@pytest.mark.parametrize(
    "name", ["../secret.cal", "/etc/passwd", "link.rad", "missing.rad", ".", "pipe", "a\nb", "~/x"]
)
def test_a_name_that_leaves_the_folder_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "home"
    write_scene(home, {"targets.1": {"type": "rad", "rad": name}})
    _lay(tmp_path, {"secret.cal": FOREIGN})
    (home / "link.rad").symlink_to("../secret.cal")
    os.mkfifo(home / "pipe")
    before = files_in(tmp_path)
    line = here(_argv(home), capsys).refusal(2)
    assert line.startswith("radwrap: scene.toml: targets[1].rad: ")
    assert FOREIGN.strip() not in line and "root:" not in line
    _nothing_happened(tmp_path, before)


def _radiance(folder: Path, *argv: str, at: Path, stdin: bytes = b"") -> bytes:
    environment = {"PATH": str(folder / "bin"), "RAYPATH": f".:{folder / 'lib'}"}
    words = [str(folder / "bin" / argv[0]), *argv[1:]]
    done = subprocess.run(words, cwd=at, env=environment, input=stdin, capture_output=True, check=False, timeout=30)
    return done.stdout


def test_a_prebuilt_octree_never_runs_its_commands(
    tmp_path: Path, radiance: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Behind an `instance`, even in a frozen octree, an unfrozen one runs what it was built from."""
    home, mark = tmp_path / "home", tmp_path / "touched"
    names = {
        "instance": "copy.oct",
        "mesh": "copy.oct",
        "instance in another folder": "../copy.oct",
        "link": "link.oct",
    }
    _lay(home, {"bomb.rad": f"!/bin/touch {mark}\n{GRAY}{BALL}", "parent.rad": "void instance copy 1 copy.oct 0 0\n"})
    (home / "copy.oct").write_bytes(_radiance(radiance, "oconv", "bomb.rad", at=home))
    (tmp_path / "copy.oct").write_bytes((home / "copy.oct").read_bytes())
    (home / "link.oct").symlink_to("copy.oct")

    # The bomb is live: a frozen parent sets it off.
    mark.unlink()
    (home / "parent.oct").write_bytes(_radiance(radiance, "oconv", "-f", "parent.rad", at=home))
    _radiance(radiance, "rtrace", "-h", "parent.oct", at=home, stdin=b"0 0 1 0 0 -1\n")
    assert mark.exists()
    mark.unlink()

    for number, (kind, name) in enumerate(names.items()):
        word = "mesh" if kind == "mesh" else "instance"
        _lay(home, {f"room{number}.rad": f"{GRAY}paint {word} copy 1 {name} 0 0\n"})
        write_scene(home, {"targets.1": {"type": "rad", "rad": f"room{number}.rad"}}, f"scene{number}.toml")
    # Commands and files alike, by the command itself.
    _lay(home, {"room.rad": f"{GRAY}!/bin/touch {mark}\n"})
    write_scene(home, ROOM)
    scenes = [home / f"scene{number}.toml" for number in range(len(names))] + [home / "scene.toml"]
    before = files_in(tmp_path)

    argv = [["render", scene, "--out", home / "out" / scene.stem, "--viewpoints", 1] for scene in scenes]
    lines = [here(words, capsys).refusal(2) for words in argv]
    assert side_by_side(lambda words: run(*words, cwd=home).refusal(2), argv[::4]) == lines[::4]
    words = ["instance", "mesh", "instance", "instance", "!"]
    assert [word for word, line in zip(words, lines, strict=True) if word not in line] == [], lines
    assert not mark.exists()
    _nothing_happened(tmp_path, before)


def test_a_trusted_file_may_do_what_it_likes_but_not_turn_in_circles(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "home"
    write_scene(home, ROOM)
    files = {
        "room.rad": f"{GRAY}!xform second.rad\n",
        "second.rad": f"{BALL}!xform -t 0 0 .01 third.rad\n",
        "third.rad": BALL,
    }
    _lay(home, files)
    here(_argv(home, "--trust"), capsys).success()
    whole = products(home / "out")
    # Each command in turn leads back to the first file.
    for name in ("second.rad", "third.rad", "room.rad"):
        _lay(home, {**files, name: f"{GRAY}{BALL}!xform -n 1 room.rad\n"})
        line = here(_argv(home, "--trust"), capsys).refusal(2)
        assert line.startswith("radwrap: scene.toml: targets[1].rad: ")
        assert "includes itself" in line
        assert products(home / "out") == whole, "what stands there is from the last run that went well, all of it"
    assert inhabitants(tmp_path) == []


def test_a_trusted_files_commands_find_the_systems_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the user's PATH is; Radiance's own come first."""
    monkeypatch.setenv("PATH", "/nowhere")
    write_scene(tmp_path, ROOM)
    _lay(tmp_path, {"room.rad": f"{GRAY}!echo | awk '{{ print \"paint sphere ball 0 0 4 0 0 0 .02\" }}'\n"})
    here(_argv(tmp_path, "--trust", "--truth"), capsys).success()
    whole = products(tmp_path / "out")
    _lay(tmp_path, {"room.rad": GRAY + BALL})
    here(_argv(tmp_path, "--trust", "--truth"), capsys).success()
    assert products(tmp_path / "out")["mask.png"] == whole["mask.png"]
    _lay(tmp_path, {"room.rad": f"{GRAY}!no-such-program\n"})
    line = here(_argv(tmp_path, "--trust"), capsys).refusal(4)
    assert line.startswith("radwrap: scene.toml: targets[1].rad: xform: ") and "no-such-program" in line


def test_a_coloured_scene_asks_for_the_channel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = {}
    _lay(tmp_path, {"room.rad": f"void plastic paint 0 0 5 .8 .4 .2 0 0\n{BALL}"})
    scene = write_scene(tmp_path, ROOM)
    argv: list[Any] = ["render", scene, "--viewpoints", 1]
    line = here([*argv, "--out", tmp_path / "out"], capsys).refusal(2)
    assert "camera.sensor.channel" in line and "red" in line
    assert set(files_in(tmp_path)) & {"out/gray.png", "out/manifest.json", "out/radiant_exposure.exr"} == set()
    for channel in ("red", "green", "blue"):
        out = tmp_path / channel
        done = here([*argv, "--out", out, "--set", f"camera.sensor.channel={channel}", "--json"], capsys).success()
        images[channel] = done.json["radiant_exposure"]["mean"]
    assert images["red"] > images["green"] > images["blue"]


def test_light_may_come_from_the_included_file_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lamp = "void light shine 0 0 3 1e5 1e5 1e5\nshine sphere lamp 0 0 4 .1 .1 .3 .005\n"
    scene = write_scene(tmp_path, {**ROOM, "sources": []})
    for text in (GRAY + BALL, lamp.replace("1e5", "0")):
        _lay(tmp_path, {"room.rad": text})
        line = here(["render", scene, "--out", tmp_path / "out"], capsys).refusal(2)
        assert "there is no light" in line and "scene.toml" in line
    # The name of a file says what kind of target it is.
    write_scene(tmp_path, {"targets.1": {"rad": "room.rad"}, "sources": []})
    _lay(tmp_path, {"room.rad": lamp})
    done = here(["render", scene, "--out", tmp_path / "out", "--viewpoints", 1, "--json"], capsys).success()
    assert done.json["gray"]["max"] > 30
