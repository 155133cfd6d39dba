"""Interrupted: exit code 130, soon, nobody left behind, and the next run goes on."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.cli.conftest import (
    SLOWER,
    finished,
    here,
    inhabitants,
    run,
    side_by_side,
    start,
    traced,
    wait_for,
    write_scene,
)

PROMPT = 10.0  # s from the signal to the end, on a machine that has other work too
MANY = 600  # sub-viewpoints: enough for a minute
# Rays that fill several pipes.
LONG = {**SLOWER, "camera.sensor.rows": 240, "camera.sensor.columns": 288}


# Of the tests that look at the tracer's processes; the compiled tracer has none.
PROCESSES = ("--tracer", "radiance")


def _under_way(folder: Path, process: subprocess.Popen[str], *, compiled: bool = False) -> list[psutil.Process]:
    """The tracers of a run that has finished a sub-viewpoint or more and is at the next ones."""
    tracers: list[psutil.Process] = []

    def tracing() -> bool:
        tracers[:] = [child for child in psutil.Process(process.pid).children(recursive=True) if _is_tracer(child)]
        return (compiled or bool(tracers)) and bool(finished(folder))

    assert wait_for(tracing, process, look=0.03)  # a look at processes takes some milliseconds of its own
    return tracers


def _is_tracer(process: psutil.Process) -> bool:
    try:
        return process.name() == "rtrace"
    except psutil.NoSuchProcess:
        return False


def _gone(processes: list[psutil.Process], patience: float) -> bool:
    _, alive = psutil.wait_procs(processes, timeout=patience)
    return [process for process in alive if process.is_running() and process.status() != psutil.STATUS_ZOMBIE] == []


@pytest.mark.parametrize(
    ("signals", "tracer"),
    [
        pytest.param([signal.SIGTERM], "radiance", marks=pytest.mark.long),  # as while the octree is built
        ([signal.SIGINT] * 3, "radiance"),
        pytest.param([signal.SIGINT], "radiance", marks=pytest.mark.long),  # the first of three ends it
        pytest.param([signal.SIGINT], "compiled", marks=pytest.mark.long),
    ],
    ids=str,
)
def test_an_interrupted_run_ends_soon_and_goes_on_later(
    signals: list[signal.Signals], tracer: str, tmp_path: Path
) -> None:
    scene, out = write_scene(tmp_path, LONG), tmp_path / "out"
    argv = ["render", scene, "--out", out, "--viewpoints", MANY, "--keep-viewpoints", "--tracer", tracer]
    with start(argv) as process:
        tracers = _under_way(out, process, compiled=tracer == "compiled")
        begin = time.monotonic()
        for number in signals:
            process.send_signal(number)
            time.sleep(0.01)
        stdout, stderr = process.communicate(timeout=30)
        wall = time.monotonic() - begin
    assert process.returncode == 130, stderr
    assert wall < PROMPT
    assert stdout == ""
    assert stderr.startswith("radwrap: interrupted") and stderr.count("\n") == 1
    assert _gone(tracers, 0)
    assert inhabitants(tmp_path) == []
    assert not (out / "gray.png").exists() and not (out / "manifest.json").exists()
    assert not (out / ".work").exists()

    whole, log = finished(out), len(traced(out))
    assert 0 < len(whole) < MANY
    with start(argv) as process:
        assert wait_for(lambda: len(finished(out)) > len(whole), process, look=0.03)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert not set(traced(out)[log:]) & whole


def test_a_signal_that_meets_a_worker_thread_is_heeded(tmp_path: Path) -> None:
    """The system may give a signal to any thread; Python hears it when the main one wakes."""
    scene, out = write_scene(tmp_path, LONG), tmp_path / "out"
    with start(["render", scene, "--out", out, "--viewpoints", MANY, *PROCESSES]) as process:
        tracers = _under_way(out, process)
        others = {thread.id for thread in psutil.Process(process.pid).threads()} - {process.pid}
        begin = time.monotonic()
        os.kill(max(others), signal.SIGTERM)
        process.communicate(timeout=60)
        wall = time.monotonic() - begin
    assert process.returncode == 130
    assert wall < PROMPT
    assert _gone(tracers, 0)


@pytest.mark.long
def test_after_the_tracers_an_interrupted_run_is_completed(tmp_path: Path) -> None:
    """Whole and small: interrupted once, then the bytes of a run that was not."""
    scene, out, good = write_scene(tmp_path, SLOWER), tmp_path / "out", tmp_path / "good"
    argv = ["render", scene, "--viewpoints", 9, *PROCESSES, "--out"]
    with start([*argv, out]) as process:
        _under_way(out, process)
        process.terminate()
        process.communicate(timeout=30)
    assert process.returncode == 130
    assert all(done.code == 0 for done in side_by_side(lambda place: run(*argv, place), [out, good]))
    for name in ("gray.png", "radiant_exposure.exr"):
        assert (out / name).read_bytes() == (good / name).read_bytes()


def test_tracers_of_a_killed_run_end_by_themselves(tmp_path: Path) -> None:
    scene, out = write_scene(tmp_path, LONG), tmp_path / "out"
    with start(["render", scene, "--out", out, "--viewpoints", MANY, *PROCESSES]) as process:
        tracers = _under_way(out, process)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert _gone(tracers, PROMPT)
    assert inhabitants(tmp_path) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_octree_is_built(number: signal.Signals, tmp_path: Path) -> None:
    """The tracer's own start takes its time: an oconv that sleeps."""
    scene, out, fake = write_scene(tmp_path), tmp_path / "out", tmp_path / "fake"
    (fake / "bin").mkdir(parents=True)
    (fake / "lib").mkdir()
    (fake / "lib" / "rayinit.cal").touch()
    for name, text in {"oconv": "/bin/sleep 600 & /bin/sleep 601", "rtrace": "echo FAKE", "xform": "exit 1"}.items():
        (fake / "bin" / name).write_text(f"#!/bin/sh\n{text}\n", "ascii")
        (fake / "bin" / name).chmod(0o755)
    with start(["render", scene, "--out", out, "--radiance", fake]) as process:
        sleepers: list[psutil.Process] = []

        def asleep() -> bool:
            children = psutil.Process(process.pid).children(recursive=True)
            sleepers[:] = [child for child in children if child.is_running()]
            return len(sleepers) == 3

        assert wait_for(asleep, process, look=0.03)
        begin = time.monotonic()
        process.send_signal(number)
        _, stderr = process.communicate(timeout=30)
        wall = time.monotonic() - begin
    assert process.returncode == 130, stderr
    assert stderr.startswith("radwrap: interrupted") and stderr.count("\n") == 1
    assert wall < PROMPT
    assert _gone(sleepers, 0)


def test_signals_are_ours_before_anything_is_loaded() -> None:
    """Before that an interrupt is Python's own, with a traceback."""
    usual = "contextlib, enum, signal, sys, types"  # small, and all that they load themselves
    code = f"import {usual}; before = set(sys.modules); import radwrap.cli.program; print(*set(sys.modules) - before)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60).stdout
    ours = {"__future__", "radwrap", "radwrap.cli", "radwrap.cli.program", "radwrap.cli.interrupts", "radwrap.errors"}
    assert set(loaded.split()) <= ours


_INTERRUPTED = """
import gc, os, signal, sys
class Sender:
    def find_spec(self, name, path=None, target=None):
        if name == {at!r}:
            sys.meta_path.remove(self)
            {how}
class Lost:
    def __del__(self): os.kill(os.getpid(), signal.{number})
sys.meta_path.insert(0, Sender())
from radwrap.cli.program import program
program()
"""
_AT = ["radwrap.cli.streams", "argparse", "radwrap.cli.render", "numpy", "pydantic_core", "radwrap.imaging.synthesis"]
_HOW = {"raised": "os.kill(os.getpid(), signal.{number})", "lost": "Lost()"}


@pytest.mark.parametrize(
    "chosen", [slice(None, None, 2), pytest.param(slice(1, None, 2), marks=pytest.mark.long)], ids=str
)
@pytest.mark.parametrize("how", _HOW)
def test_a_signal_while_modules_are_loaded(how: str, chosen: slice, tmp_path: Path) -> None:
    """In the first tenths of a second as at any other time, also where Python loses an error."""
    scene = write_scene(tmp_path)

    def interrupted(case: tuple[str, str]) -> subprocess.CompletedProcess[str]:
        at, number = case
        code = _INTERRUPTED.format(at=at, how=_HOW[how].format(number=number), number=number)
        words = [sys.executable, "-c", code, "render", str(scene), "--out", str(tmp_path / f"{at}.{number}")]
        return subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)

    cases = [
        (at, number)
        for at, number in zip(_AT, ["SIGINT", "SIGINT", "SIGTERM", "SIGTERM", "SIGINT", "SIGTERM"], strict=True)
    ][chosen]
    for case, done in zip(cases, side_by_side(interrupted, cases), strict=True):
        assert (case, done.returncode, done.stdout) == (case, 130, "")
        assert done.stderr == "radwrap: interrupted; the same command goes on from what was finished\n"


_PROGRAM = "import sys; {}; from radwrap.cli.program import program; program()"


@pytest.mark.parametrize(
    "closed",
    [
        "sys.stdout = sys.stderr = None",
        *(pytest.param(f"sys.{stream} = None", marks=pytest.mark.long) for stream in ("stdout", "stderr")),
    ],
)
@pytest.mark.parametrize(("words", "code"), [(["schema"], 0), (["render", "none.toml", "--out", "none"], 2)])
def test_closed_streams_change_no_exit_code(closed: str, words: list[str], code: int) -> None:
    """As Python leaves them where whoever starts it has closed them."""
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM.format(closed), *words], capture_output=True, check=False, timeout=60
    )
    assert done.returncode == code
    assert b"Traceback" not in done.stderr
    assert b"radwrap:" not in done.stdout


@pytest.mark.parametrize("words", [["schema"], ["led", "list", "--json"]])
def test_an_answer_to_a_closed_stdout_is_an_error(words: list[str]) -> None:
    argv = shlex.join([sys.executable, "-c", _PROGRAM.format("pass"), *words])
    done = subprocess.run(["/bin/sh", "-c", f"{argv} >&-"], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (4, "radwrap: standard output: is closed\n")


def test_a_message_that_nobody_can_read_changes_no_exit_code() -> None:
    with Path("/dev/full").open("wb") as full:
        words = [sys.executable, "-c", _PROGRAM.format("pass"), "render", "none.toml", "--out", "none"]
        assert subprocess.run(words, stderr=full, check=False, timeout=60).returncode == 2


FULL = "No space left on device"


@pytest.mark.parametrize(
    "words",
    [
        *(["--help"], ["--version"], ["schema"]),
        *(pytest.param(words, marks=pytest.mark.long) for words in (["render", "--help"], ["doctor", "--json"])),
    ],
)
def test_an_answer_that_cannot_be_written_is_told(words: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = run(*words, stdout=full)
    assert done.code == 4
    assert done.stderr == f"radwrap: standard output: {FULL}\n"


def test_messages_that_cannot_be_written_do_not_end_the_work(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    with Path("/dev/full").open("wb") as full:
        assert run("render", scene, "--out", tmp_path / "out", "--method", "pinhole", stderr=full).code == 0
    assert (tmp_path / "out" / "manifest.json").exists()


@pytest.mark.long
def test_names_that_an_encoding_lacks_are_escaped(tmp_path: Path) -> None:
    """As JSON escapes them, so that JSON stays JSON."""
    scene = write_scene(tmp_path / "\u00e4\u6c34\U0001d11e")
    words = ["convert", scene, scene.with_suffix(".rad")]
    ascii_only = {"PYTHONIOENCODING": "ascii"}
    told = run(*words, environment=ascii_only).success().stdout
    assert "\\u00e4\\u6c34\\ud834\\udd1e" in told and told.isascii()
    found = run(*words, "--json", environment=ascii_only).success().stdout
    assert found.isascii() and "\u00e4\u6c34\U0001d11e" in str(json.loads(found))
    refused = run("explain", scene.with_name("none.toml"), environment=ascii_only).refusal(2)
    assert "\\u00e4" in refused


def test_what_is_asked_before_a_verb_loads_none() -> None:
    code = "import sys; from radwrap.cli.main import main; main(sys.argv[1:]); print(*sys.modules)"
    for words in (["--version"], ["--help"], ["rendre"], []):
        done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
        loaded = set(done.stdout.splitlines()[-1].split())
        assert "radwrap.cli.main" in loaded
        assert not {"numpy", "pydantic", "radwrap.scene"} & loaded


def test_options_are_taken_by_their_whole_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An abbreviation may mean another option tomorrow."""
    argv = ["render", write_scene(tmp_path), "--out", tmp_path / "out", "--toler", 8]
    assert "--toler" in here(argv, capsys).refusal(2)
    assert "--js" in here(["study", "analyse", "none.csv", "--response", "x", "--js"], capsys).refusal(2)


def test_a_program_ends_with_its_code_and_with_what_others_left_for_the_end() -> None:
    code = _PROGRAM.format("import atexit; atexit.register(print, 'bye')")
    words = [sys.executable, "-c", code, "render", "none.toml", "--out", "none"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (2, "bye\n")
    assert done.stderr.startswith("radwrap: none.toml: ") and done.stderr.count("\n") == 1
