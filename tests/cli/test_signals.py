"""Interrupted: exit code 130, soon, nobody left behind, and the next run goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.cli.conftest import SLOWER, finished, inhabitants, run, side_by_side, start, traced, wait_for, write_scene

PROMPT = 10.0  # s from the signal to the end, on a machine that has other work too
MANY = 600  # sub-viewpoints: enough for a minute
# Rays that fill several pipes.
LONG = {**SLOWER, "camera.sensor.rows": 240, "camera.sensor.columns": 288}


def _under_way(folder: Path, process: subprocess.Popen[str]) -> list[psutil.Process]:
    """The tracers of a run that has finished a sub-viewpoint or more and is at the next ones."""
    tracers: list[psutil.Process] = []

    def tracing() -> bool:
        tracers[:] = [child for child in psutil.Process(process.pid).children(recursive=True) if _is_tracer(child)]
        return bool(tracers) and bool(finished(folder))

    assert wait_for(tracing, process)
    return tracers


def _is_tracer(process: psutil.Process) -> bool:
    try:
        return process.name() == "rtrace"
    except psutil.NoSuchProcess:
        return False


def _gone(processes: list[psutil.Process], patience: float) -> bool:
    _, alive = psutil.wait_procs(processes, timeout=patience)
    return [process for process in alive if process.is_running() and process.status() != psutil.STATUS_ZOMBIE] == []


@pytest.mark.parametrize("signals", [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT] * 3], ids=str)
def test_an_interrupted_run_ends_soon_and_goes_on_later(signals: list[signal.Signals], tmp_path: Path) -> None:
    scene, out = write_scene(tmp_path, LONG), tmp_path / "out"
    argv = ["render", scene, "--out", out, "--viewpoints", MANY, "--keep-viewpoints"]
    with start(argv) as process:
        tracers = _under_way(out, process)
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
        assert wait_for(lambda: len(finished(out)) > len(whole), process)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert not set(traced(out)[log:]) & whole


def test_a_signal_that_meets_a_worker_thread_is_heeded(tmp_path: Path) -> None:
    """The system may give a signal to any thread; Python hears it when the main one wakes."""
    scene, out = write_scene(tmp_path, LONG), tmp_path / "out"
    with start(["render", scene, "--out", out, "--viewpoints", MANY]) as process:
        tracers = _under_way(out, process)
        others = {thread.id for thread in psutil.Process(process.pid).threads()} - {process.pid}
        begin = time.monotonic()
        os.kill(max(others), signal.SIGTERM)
        process.communicate(timeout=60)
        wall = time.monotonic() - begin
    assert process.returncode == 130
    assert wall < PROMPT
    assert _gone(tracers, 0)


def test_after_the_tracers_an_interrupted_run_is_completed(tmp_path: Path) -> None:
    """Whole and small: interrupted once, then the bytes of a run that was not."""
    scene, out, good = write_scene(tmp_path, SLOWER), tmp_path / "out", tmp_path / "good"
    argv = ["render", scene, "--viewpoints", 19, "--out"]
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
    with start(["render", scene, "--out", out, "--viewpoints", MANY]) as process:
        tracers = _under_way(out, process)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert _gone(tracers, 5)
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

        assert wait_for(asleep, process)
        begin = time.monotonic()
        process.send_signal(number)
        _, stderr = process.communicate(timeout=30)
        wall = time.monotonic() - begin
    assert process.returncode == 130, stderr
    assert stderr.startswith("radwrap: interrupted") and stderr.count("\n") == 1
    assert wall < PROMPT
    assert _gone(sleepers, 0)


def test_libraries_are_loaded_where_an_interrupt_is_caught() -> None:
    """Ctrl-C in the first tenths of a second is no reason for a traceback: what takes long to load comes later."""
    heavy = {"numpy", "pydantic", "OpenImageIO"}
    words = [sys.executable, "-c", "import sys, radwrap.cli.main; print(*sys.modules)"]
    loaded = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout.split()
    assert heavy & set(loaded) == set()


_PROGRAM = "import sys; {}; from radwrap.cli.main import program; program()"


@pytest.mark.parametrize("closed", ["sys.stdout = None", "sys.stderr = None", "sys.stdout = sys.stderr = None"])
@pytest.mark.parametrize(("words", "code"), [(["schema"], 0), (["render", "none.toml", "--out", "none"], 2)])
def test_closed_streams_change_no_exit_code(closed: str, words: list[str], code: int) -> None:
    """As Python leaves them where whoever starts it has closed them."""
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM.format(closed), *words], capture_output=True, check=False, timeout=60
    )
    assert done.returncode == code
    assert b"Traceback" not in done.stderr
    assert b"radwrap:" not in done.stdout


def test_a_message_that_nobody_can_read_changes_no_exit_code() -> None:
    with Path("/dev/full").open("wb") as full:
        words = [sys.executable, "-c", _PROGRAM.format("pass"), "render", "none.toml", "--out", "none"]
        assert subprocess.run(words, stderr=full, check=False, timeout=60).returncode == 2


def test_a_program_ends_with_its_code_and_with_what_others_left_for_the_end() -> None:
    code = _PROGRAM.format("import atexit; atexit.register(print, 'bye')")
    words = [sys.executable, "-c", code, "render", "none.toml", "--out", "none"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (2, "bye\n")
    assert done.stderr.startswith("radwrap: none.toml: ") and done.stderr.count("\n") == 1
