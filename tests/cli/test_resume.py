"""A killed run goes on where it was, and ends with the bytes of a run that nobody disturbed."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import pytest

from tests.cli.conftest import (
    PATIENCE,
    SLOWER,
    clean_environment,
    files_in,
    finished,
    here,
    inhabitants,
    made_since,
    products,
    run,
    stamps,
    start,
    traced,
    wait_for,
    write_scene,
)

KEPT: Final = "--keep-viewpoints"


def _argv(scene: Path, out: Path, *options: object, number: int = 7) -> list[object]:
    how: list[object] = [] if "--method" in options else ["--viewpoints", number]
    return ["render", scene, "--out", out, *how, *options]


def _again_is_the_same(out: Path, good: dict[str, Any]) -> None:
    assert products(out) == good
    assert inhabitants(out) == []


# ------------------------------------------------------------------------------------------------ Killed at any moment


def _is_on_its_way(out: Path, due: int, begun: int) -> bool:
    return len(finished(out)) > due and len(traced(out)) > begun


@pytest.mark.long
@pytest.mark.parametrize("kills", [10])
def test_kills_at_random_change_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str], kills: int) -> None:
    """Moments between those of the next test, which kills at each rename there is."""
    number = 37
    scene, out = write_scene(tmp_path, SLOWER), tmp_path / "out"
    argv = _argv(scene, out, KEPT, number=number)
    here(_argv(scene, tmp_path / "good", KEPT, number=number), capsys).success()
    good = products(tmp_path / "good")
    dice = random.Random(20)  # noqa: S311  (no secret)
    known: set[int] = set()
    log: list[int] = []
    for due in sorted(dice.sample(range(number - 3), kills)):
        with start(argv) as process:
            wait_for(partial(_is_on_its_way, out, due, len(log)), process)
            time.sleep(dice.uniform(0, 0.02))
            process.kill()
        assert process.returncode == -signal.SIGKILL, "the run was too short for this test"
        assert not (out / "manifest.json").exists()
        # What was whole when the run before was killed, this one did not trace.
        begun, log = len(log), traced(out)
        assert set(log[begun:]).isdisjoint(known)
        assert known <= finished(out)
        known = finished(out)
    before = stamps(out)
    done = here([*argv, "--json"], capsys).success()
    assert done.json["timing"]["reused_viewpoints"] == len(known)
    assert made_since(out, before) == set(range(number)) - known
    _again_is_the_same(out, good)
    assert files_in(out / "viewpoints") == files_in(tmp_path / "good" / "viewpoints")


# A process that kills itself: the command's own code, forked for each moment, so that libraries are loaded once.
DRIVER: Final = """
import json, os, pathlib, signal, sys
import radwrap.files, radwrap.imaging.mean_radiance, radwrap.imaging.methods.pieces, radwrap.imaging.synthesis
from radwrap.cli.main import main

argv, moments, cores = json.loads(sys.stdin.read())
die = lambda: os.kill(os.getpid(), signal.SIGKILL)

def arm(kind, number):
    count = 0
    def at_last(*kinds):
        nonlocal count
        count += kind in kinds
        return kind in kinds and count == number
    rename, read = pathlib.Path.replace, radwrap.imaging.methods.pieces.read_image
    whole = radwrap.imaging.synthesis.remove_pieces
    merge, unlink = radwrap.imaging.mean_radiance.merge, pathlib.Path.unlink
    def replace(self, target):
        last = at_last("before rename", "half written", "after rename")
        if last and kind == "before rename":
            die()
        if last and kind == "half written":
            os.truncate(self, os.path.getsize(self) // 2)
            die()
        answer = rename(self, target)
        if last and kind == "after rename":
            die()
        return answer
    def merging(*arguments):
        def reading(path):
            if at_last("merge"):
                die()
            return read(path)
        radwrap.imaging.methods.pieces.read_image = reading
        return merge(*arguments)
    def unlinking(self, missing_ok=False):
        unlink(self, missing_ok=missing_ok)
        if kind == "old manifest removed" and self.name == "manifest.json":
            die()
    def removing(folder):
        if kind == "clean-up" and os.path.basename(folder) == "viewpoints":
            for name in sorted(os.listdir(folder))[:number]:
                os.unlink(os.path.join(folder, name))
            die()
        return whole(folder)
    pathlib.Path.replace, pathlib.Path.unlink = replace, unlinking
    radwrap.imaging.synthesis.remove_pieces = removing
    radwrap.imaging.mean_radiance.merge = merging

sys.stdout.flush()
status = {}
children = {}
for name, kind, number in [*moments, *[(None, None, 0)] * cores]:
    if len(children) == cores or (name is None and children):
        child, ended = os.wait()
        status[children.pop(child)] = ended
    if name is None:
        continue
    child = os.fork()
    if child == 0:
        arm(kind, number)
        os._exit(main([word.replace("{}", name) for word in argv]))
    children[child] = name
print(json.dumps([status[name] for name, _, _ in moments]))
"""


def _carry_out(argv: Sequence[object], moments: Sequence[tuple[str, str, int]]) -> list[int]:
    """Status of each process that was to kill itself; "{}" in `argv` is the moment's name."""
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        input=json.dumps([[str(word) for word in argv], list(moments), len(os.sched_getaffinity(0))]),
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    status: list[int] = json.loads(done.stdout.splitlines()[-1])
    return status


# Sub-viewpoints, then each file of the run as it is made, and as it takes an older run's place.
MADE: Final = ("exposure", "gray", "depth", "mask", "truth", "manifest")
RENAMES: Final = ("viewpoint 0", "1", "2", *MADE, *MADE)
MOMENTS: Final = [
    *(("after rename", number) for number in range(1, len(RENAMES) + 1)),
    *(("before rename", number) for number in (1, 9, len(RENAMES))),
    *(("half written", number) for number in (1, 4, 5, 9)),
    *(("merge", number) for number in (1, 3)),
    ("clean-up", 2),
]
# One of each kind of moment, and after the renames a state of the folder: with some pieces, with some of the new run's
# files, with all.
SOME: Final = [
    *(("after rename", number) for number in (3, 9, len(RENAMES))),
    *(("half written", 1), ("merge", 1), ("clean-up", 2)),
]


@pytest.mark.parametrize("chosen", [SOME, pytest.param(MOMENTS, marks=pytest.mark.long)], ids=["some", "all"])
def test_killed_at_every_rename_and_while_merging(tmp_path: Path, chosen: list[tuple[str, int]]) -> None:
    scene, good = write_scene(tmp_path), tmp_path / "good"
    argv = _argv(scene, tmp_path / "{}", "--truth", "--workers", 1, number=3)
    # The folders hold another scene's result first, which must neither be taken for this one's nor mixed with it.
    moments = [(f"{kind} {number}", kind, number) for kind, number in chosen]
    everywhere = [(name, "never", 0) for name, _, _ in moments]
    assert _carry_out(argv, moments) == [signal.SIGKILL] * len(moments)
    left = {name: finished(tmp_path / name) for name, _, _ in moments}
    logs = {name: traced(tmp_path / name) for name, _, _ in moments}
    for name, kind, number in moments:
        manifest = tmp_path / name / "manifest.json"
        assert manifest.exists() == ((kind, number) in (("after rename", len(RENAMES)), ("clean-up", 2)))
        if kind != "clean-up":
            assert len(left[name]) == min(number - (kind != "after rename"), 3) or kind == "merge"
        assert logs[name] == list(range(len(logs[name])))
    assert left["merge 1"] == {0, 1, 2}
    before = {name: stamps(tmp_path / name) for name, _, _ in moments}

    again = [*argv, KEPT]
    assert _carry_out(again, [("good", "never", 0), *everywhere]) == [0] * (len(moments) + 1)
    expected = products(good)
    assert set(expected) == {"gray.png", "radiant_exposure.exr", "depth.exr", "mask.png", "truth.json", "manifest.json"}
    wrong = [name for name, _, _ in moments if products(tmp_path / name) != expected]
    assert wrong == []
    for name, kind, _ in moments:
        if kind == "clean-up":
            continue  # a run that asks for the files has them, see below
        assert made_since(tmp_path / name, before[name]) == {0, 1, 2} - left[name], name
        assert files_in(tmp_path / name / "viewpoints") == files_in(good / "viewpoints"), name
    assert [name for name in files_in(tmp_path) if ".part" in name or "/.work/" in name] == []


@pytest.mark.long
@pytest.mark.parametrize(("removed", "renamed"), [((), (7, 11)), ((1,), (7, 10, 11, 12, 13))])
def test_killed_while_replacing_another_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], removed: tuple[int, ...], renamed: tuple[int, ...]
) -> None:
    """From the first new image on there is no manifest, and so nobody takes old and new for one result."""
    old, scene = write_scene(tmp_path / "old", {"targets.0.rotation": REST}), write_scene(tmp_path / "new")
    here(_argv(scene, tmp_path / "good"), capsys).success()
    kinds = [
        *(("old manifest removed", number) for number in removed),
        *(("after rename", number) for number in renamed),
    ]
    moments = [(f"{kind} {number}", kind, number) for kind, number in kinds]
    for name, _, _ in moments:
        here(_argv(old, tmp_path / name), capsys).success()
    before = products(tmp_path / moments[0][0])
    argv = _argv(scene, tmp_path / "{}", "--workers", 1)
    assert _carry_out(argv, moments) == [signal.SIGKILL] * len(moments)
    for name, _, number in moments:
        left = products(tmp_path / name)
        if number in (7, 10):  # the last sub-viewpoint, the new manifest beside: the old result stands, all of it
            assert left == before
        elif number == 13:
            assert left == products(tmp_path / "good")
        else:
            assert "manifest.json" not in left
    assert _carry_out(argv, [(name, "never", 0) for name, _, _ in moments]) == [0] * len(moments)
    for name, _, _ in moments:
        _again_is_the_same(tmp_path / name, products(tmp_path / "good"))


REST: Final = ["0 deg", "0 deg", "0 deg"]


# --------------------------------------------------------------------------------------------------- Files that are bad


def _truncate(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _cut_one_byte(path: Path) -> None:
    os.truncate(path, path.stat().st_size - 1)


def _empty(path: Path) -> None:
    os.truncate(path, 0)


def _text(path: Path) -> None:
    path.write_text("no image", "ascii")


def _remove(path: Path) -> None:
    path.unlink()


def _folder_instead(path: Path) -> None:
    path.unlink()
    path.mkdir()


def test_a_bad_file_is_noticed_and_traced_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_scene(tmp_path), tmp_path / "out"
    argv = _argv(scene, out, KEPT, number=19)
    here(argv, capsys).success()
    good = products(out)
    folder = out / "viewpoints"
    foreign, plan = tmp_path / "foreign", tmp_path / "plan"
    other = write_scene(tmp_path / "other", {"targets.0.rotation": REST})
    here(_argv(other, foreign, KEPT, number=19), capsys).success()
    here(_argv(scene, plan, KEPT, "--pixel-samples", 2, number=19), capsys).success()

    def from_another(place: Path, index: int) -> Callable[[Path], None]:
        name = f"viewpoint_{index:05d}.exr"
        return lambda path: path.write_bytes((place / "viewpoints" / name).read_bytes()) and None

    damages: dict[int, Callable[[Path], None]] = {
        1: _truncate,
        2: _cut_one_byte,
        3: _empty,
        5: _text,
        6: _remove,
        8: from_another(foreign, 8),
        10: from_another(plan, 10),
        11: from_another(out, 12),
    }
    for index, damage in damages.items():
        damage(folder / f"viewpoint_{index:05d}.exr")
    (folder / "viewpoint_00019.exr").write_bytes((folder / "viewpoint_00000.exr").read_bytes())
    (folder / ".viewpoint_00004.part.exr").write_bytes(b"half")
    (out / "manifest.json").unlink()
    before = stamps(out)
    here(argv, capsys).success()
    assert made_since(out, before) == set(damages)
    _again_is_the_same(out, good)
    assert finished(out) == set(range(19))
    assert not list(folder.glob(".*"))


@pytest.mark.long
def test_a_flipped_bit_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One bit in each of 61 files: where it changes a pixel the file is traced again, so the images stay."""
    number = 61
    scene, out = write_scene(tmp_path), tmp_path / "out"
    argv = _argv(scene, out, KEPT, number=number)
    here(argv, capsys).success()
    good = products(out)
    dice = random.Random(5)  # noqa: S311  (no secret)
    sizes = []
    for index in range(number):
        path = out / "viewpoints" / f"viewpoint_{index:05d}.exr"
        content = bytearray(path.read_bytes())
        # Evenly over the whole file: header, metadata, pixels.
        place = min(int(len(content) * (index + dice.random()) / number), len(content) - 1)
        content[place] ^= 1 << dice.randrange(8)
        path.write_bytes(content)
        sizes.append(len(content))
    (out / "manifest.json").unlink()
    # In a process of its own: a decoder that crashes must not take the tests along.
    before = stamps(out)
    run(*argv).success()
    assert len(made_since(out, before)) > number / 2
    _again_is_the_same(out, good)


@pytest.mark.long
def test_a_final_image_that_was_changed_is_made_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_scene(tmp_path), tmp_path / "out"
    argv = _argv(scene, out, KEPT, "--truth")
    here(argv, capsys).success()
    good, before = products(out), stamps(out)
    for name, damage in {
        "gray.png": _truncate,
        "radiant_exposure.exr": _remove,
        "truth.json": _empty,
        "manifest.json": _truncate,
        "mask.png": _text,
    }.items():
        damage(out / name)
        here(argv, capsys).success()
        _again_is_the_same(out, good)
    assert stamps(out) == before, "the sub-viewpoints were whole"


# ------------------------------------------------------------------------------------------------- The folder's history


@pytest.mark.parametrize(
    "chosen",
    [
        ("first", "moved", "exposed", "truth", "kernel", "first again"),
        pytest.param(None, marks=pytest.mark.long),
    ],
    ids=["some", "all"],
)
def test_a_changed_scene_in_the_same_folder_gives_its_own_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], chosen: tuple[str, ...] | None
) -> None:
    scene = write_scene(tmp_path)
    out = tmp_path / "out"
    steps: list[tuple[str, list[object]]] = [
        ("first", []),
        ("moved", ["--set", "targets[0].rotation[0]=25 deg"]),
        ("exposed", ["--set", "camera.exposure_time=100 ms"]),
        ("lit", ["--set", "sources[0].radiance=150 kW/m^2/sr"]),
        ("wider", ["--set", "camera.aperture.diameter=0.3 mm"]),
        ("larger", ["--set", "camera.sensor.columns=26"]),
        ("truth", ["--truth"]),
        ("unrounded", ["--set", "camera.sensor.rounding=false"]),
        ("layout", ["--layout", "sunflower"]),
        ("pinhole", ["--method", "pinhole"]),
        ("kernel", ["--method", "kernel"]),
        ("rays", ["--method", "rays", "--tolerance", 4]),
        ("samples", ["--pixel-samples", 2]),
        ("first again", []),
    ]
    results = []
    for name, options in [step for step in steps if chosen is None or step[0] in chosen]:
        for folder in (out, tmp_path / name):
            here(_argv(scene, folder, KEPT, *options), capsys).success()
        results.append(products(out))
        # What an earlier run left under a final name does not belong to this one.
        assert results[-1] == products(tmp_path / name), name
        assert finished(out) == finished(tmp_path / name)
    assert results[0] == results[-1]
    # A change that no ray sees reuses every ray.
    assert len({str(result["gray.png"]) for result in results}) > len(results) - 4


def test_exposure_and_response_need_no_new_rays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_scene(tmp_path), tmp_path / "out"
    here(_argv(scene, out, KEPT), capsys).success()
    before = stamps(out)
    for key, value in {"exposure_time": "100 ms", "sensor.dark_gray": 30, "sensor.saturation_gray": 100}.items():
        here(_argv(scene, out, KEPT, "--set", f"camera.{key}={value}"), capsys).success()
    assert set(before) == set(range(7)) and stamps(out) == before


def test_a_finished_run_is_not_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_scene(tmp_path), tmp_path / "out"
    argv = _argv(scene, out, KEPT)
    first = here([*argv, "--json"], capsys).success().json
    before, good = stamps(out), files_in(out)
    times = {path: path.stat().st_mtime_ns for path in out.iterdir() if path.suffix}
    second = here([*argv, "--json"], capsys).success().json
    assert first == second, "even its timing is the first run's"
    assert stamps(out) == before and files_in(out) == good
    assert {path: path.stat().st_mtime_ns for path in times} == times
    # Without the wish to keep them the files go, the result stays.
    here(_argv(scene, out), capsys).success()
    assert not (out / "viewpoints").exists()
    assert {name: content for name, content in files_in(out).items() if name in good} == {
        name: content for name, content in good.items() if not name.startswith("viewpoints/")
    }
    # Who wants them again has them made again.
    here(argv, capsys).success()
    assert finished(out) == set(range(7))


def test_who_asks_for_the_sub_viewpoints_gets_all_of_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As after a run that was killed while it cleaned up."""
    scene, out = write_scene(tmp_path), tmp_path / "out"
    argv = _argv(scene, out, KEPT)
    here(argv, capsys).success()
    good = products(out)
    _remove(out / "viewpoints" / "viewpoint_00003.exr")
    _truncate(out / "viewpoints" / "viewpoint_00005.exr")
    before = stamps(out)
    here(argv, capsys).success()
    assert finished(out) == set(range(7))
    assert made_since(out, before) == {3, 5}
    assert products(out) == good


def test_a_second_run_in_the_same_folder_is_refused_at_once(
    tmp_path: Path, radiance: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first one's tracer waits until it may go on."""
    scene, out, gated, gate = write_scene(tmp_path), tmp_path / "out", tmp_path / "gated", tmp_path / "gate"
    shutil.copytree(radiance / "lib", gated / "lib", ignore=shutil.ignore_patterns("[!r]*"))
    (gated / "bin").mkdir()
    for name in ("oconv", "xform"):
        (gated / "bin" / name).symlink_to(radiance / "bin" / name)
    waiting = f'case "$1" in -h) while [ ! -e "{gate}" ]; do /bin/sleep .02; done;; esac'
    (gated / "bin" / "rtrace").write_text(f'#!/bin/sh\n{waiting}\nexec "{radiance}/bin/rtrace" "$@"\n', "utf-8")
    (gated / "bin" / "rtrace").chmod(0o755)
    argv = _argv(scene, out, "--radiance", gated)
    with start(argv) as first:
        assert wait_for(lambda: len(traced(out)) > 0, first)
        for words in (argv, _argv(scene, tmp_path / "." / "out", "--viewpoints", 3, KEPT)):
            second = here(words, capsys)
            line = second.refusal(4)
            assert str(out) in line and "another run" in line
            assert second.wall < PATIENCE / 2  # the first one ends when it is let
        assert first.poll() is None
        gate.touch()
        _, said = first.communicate()
    assert first.returncode == 0, said
    here(_argv(scene, tmp_path / "good"), capsys).success()
    _again_is_the_same(out, products(tmp_path / "good"))
