"""Studies on many machines: who may work at them, and what is told where nobody can."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import pytest

import radwrap
from radwrap.errors import EnvironmentFailure, FolderTaken
from radwrap.files import sole_owner
from radwrap.study import pool
from radwrap.study.design import read_design
from radwrap.study.seal import Unfit, break_seal, check_fit, seal_of, why_unfit
from radwrap.study.study import StudyOptions, run_study
from tests.cli.conftest import scene_text, start, wait_for
from tests.study.cluster import scheduler, wait_for_workers, worker
from tests.study.conftest import EDGE, PATIENCE, TINY_SMALL, command

GRAY = '[responses.mean]\nmeasure = "mean_gray"\n'


def test_a_seal_is_for_what_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clone and a wheel of one state work together, though a clone has more files among the examples."""
    package = tmp_path / "radwrap"
    (package / "examples" / "one").mkdir(parents=True)
    (package / "module.py").write_text("x = 1")
    monkeypatch.setattr("radwrap.study.seal.files", lambda _: package)
    first = seal_of(tmp_path, None)
    (package / "examples" / "one" / "scene.rad").write_text("void plastic x")
    assert seal_of(tmp_path, None).programs == first.programs
    (package / "module.py").write_text("x = 2")
    assert seal_of(tmp_path, None).programs != first.programs


def test_a_seal_is_for_the_same_programs_and_the_same_folder(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    seal = seal_of(here, None)
    assert why_unfit(seal) == ""
    check_fit(seal)
    there.mkdir()
    shutil.copytree(here, there, dirs_exist_ok=True)
    seal_of(here, None)  # another study began there
    assert why_unfit(seal) == f"does not see {here}"
    for name in ("radwrap", "radwrap's files", "numpy", "numba", "llvmlite", "radiance", "statsmodels"):
        assert f"another {name}" in why_unfit(replace(seal, programs={**seal.programs, name: "0.1"}))
    break_seal(seal)
    with pytest.raises(Unfit, match="does not see"):
        check_fit(seal)
    assert "does not hold a complete Radiance" in why_unfit(replace(seal, radiance=str(tmp_path)))


def test_a_folder_with_an_owner_is_told_from_a_broken_one(tmp_path: Path) -> None:
    """A worker waits for what an interrupted study still renders elsewhere."""
    with sole_owner(tmp_path), pytest.raises(FolderTaken), sole_owner(tmp_path):
        pass


def _other_radwrap(folder: Path) -> Path:
    """A copy whose mean gray is wrong by 1000."""
    package = Path(radwrap.__file__).parent
    shutil.copytree(package, folder / "radwrap", ignore=shutil.ignore_patterns("__pycache__"))
    responses = folder / "radwrap" / "study" / "responses.py"
    text = responses.read_text()
    assert text.count(".mean()") >= 1
    responses.write_text(text.replace(".mean()", ".mean() + 1000"))
    return folder


@pytest.mark.long
@pytest.mark.usefixtures("one_process")
def test_workers_may_come_late_and_go_early(tmp_path: Path) -> None:
    """The last one is killed at work; another goes on, and the table is the one of this process."""
    design, out = _laid(tmp_path), tmp_path / "late"
    with ExitStack() as stack:
        _, address = stack.enter_context(scheduler(tmp_path))
        with start([*_words(design, address), out]) as study:
            mark = out / ".radwrap.cluster"
            assert wait_for(mark.exists, study, PATIENCE)
            time.sleep(1.5)
            first = stack.enter_context(worker(address, tmp_path / "w1"))
            assert wait_for(lambda: (out / "results.csv").read_bytes().count(b"\n") > 1, study, PATIENCE)
            first.kill()
            stack.enter_context(worker(address, tmp_path / "w2"))
            _, told = study.communicate(timeout=PATIENCE)
        assert study.returncode == 0 and "no worker is available" in told, told
        assert not mark.exists()
    run_study(read_design(design), tmp_path / "here", StudyOptions())
    assert (out / "results.csv").read_bytes() == (tmp_path / "here" / "results.csv").read_bytes()


@pytest.mark.long
def test_workers_that_would_answer_otherwise_are_left_out(tmp_path: Path) -> None:
    """Those that are fit do the study; a scheduler that is gone is told.

    Long: who is fit, and what is said of a scheduler that is not there, the tests of seals and servers see.
    """
    design = _laid(tmp_path)
    with ExitStack() as stack:
        server, address = stack.enter_context(scheduler(tmp_path))
        stack.enter_context(worker(address, tmp_path / "w1"))
        stack.enter_context(worker(address, tmp_path / "w2", _other_radwrap(tmp_path / "other")))
        wait_for_workers(address, 2)
        with start([*_words(design, address), tmp_path / "lost"]) as study:
            assert wait_for((tmp_path / "lost" / "started.log").exists, study, PATIENCE)
            os.kill(server.pid, signal.SIGKILL)
            _, told = study.communicate(timeout=PATIENCE)
        assert study.returncode == 4
        left_out, gone = told.splitlines()
        assert "left out" in left_out and "radwrap's files" in left_out
        assert "the scheduler is gone" in gone


def _laid(folder: Path) -> Path:
    """A study in a folder."""
    (folder / "scene.toml").write_text(scene_text(EDGE))
    design = folder / "design.toml"
    design.write_text(f'scene = "scene.toml"\n{TINY_SMALL}\n{GRAY}')
    return design


def _words(design: Path, address: str) -> list[object]:
    """The command but for the place of its results."""
    return ["study", "run", design, "--no-report", "--dask", address, "--out"]


@pytest.mark.long
def test_a_study_for_which_no_worker_is_fit_is_not_begun(tmp_path: Path) -> None:
    """Long: that a worker is not fit is found above."""
    (tmp_path / "scene.toml").write_text(scene_text(EDGE))
    design, out = tmp_path / "design.toml", tmp_path / "out"
    design.write_text(f'scene = "scene.toml"\n{TINY_SMALL}\n{GRAY}')
    with ExitStack() as stack:
        _, address = stack.enter_context(scheduler(tmp_path))
        stack.enter_context(worker(address, tmp_path / "w", _other_radwrap(tmp_path / "other")))
        wait_for_workers(address, 1)
        done = command("study", "run", design, "--out", out, "--no-report", "--dask", address)
        assert done.code == 4 and "no worker is fit: another radwrap's files" in done.stderr
        assert not (out / "started.log").exists()
        assert (out / "results.csv").read_text().count("\n") == 1, "no run is finished"


@pytest.mark.long
def test_a_study_without_workers_ends(tmp_path: Path) -> None:
    """It says once that it waits; then it gives up."""
    design = _laid(tmp_path)
    with scheduler(tmp_path) as (_, address):
        with start([*_words(design, address), tmp_path / "none", "--worker-timeout", "2 s"]) as study:
            _, told = study.communicate(timeout=PATIENCE)
        assert study.returncode == 4
        _says_once_that_it_waits(told, address, 2)


@pytest.mark.long
def test_a_study_whose_last_worker_is_killed_ends(tmp_path: Path) -> None:
    """Long: what it does without a worker is seen above."""
    design = _laid(tmp_path)
    with scheduler(tmp_path) as (_, address), worker(address, tmp_path / "w") as last:
        wait_for_workers(address, 1)
        with start([*_words(design, address), tmp_path / "killed", "--worker-timeout", "3 s"]) as study:
            assert wait_for((tmp_path / "killed" / "started.log").exists, study, PATIENCE)
            last.kill()
            _, told = study.communicate(timeout=PATIENCE)
        assert study.returncode == 4
        _says_once_that_it_waits(told, address, 3)


def _says_once_that_it_waits(told: str, address: str, seconds: int) -> None:
    waits, ends = told.splitlines()
    assert waits == f"radwrap: no worker is available; waiting {seconds} s for one at {address}"
    assert ends.startswith(f"radwrap: {address}: no worker for {seconds} s; start one") and "--worker-timeout" in ends


# What a server of another kind says to whoever comes: to Dask these are lengths of a message, and a message of nothing.
@pytest.mark.parametrize(
    "greeting", [b"", b"SSH-2.0-OpenSSH_9.6\r\n", b"HTTP/1.0 400 Bad Request\r\n\r\n", bytes(4096)]
)
def test_a_server_of_another_kind_is_no_scheduler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, greeting: bytes
) -> None:
    monkeypatch.setattr(pool, "_GRACE", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        held: list[socket.socket] = []
        threading.Thread(target=_greet, args=(server, greeting, held), daemon=True).start()
        with pytest.raises(EnvironmentFailure, match=rf"no (answer from|Dask scheduler answers at) {address}"):
            pool.DaskPool(address, tmp_path, None)
    for connection in held:
        connection.close()


def _greet(server: socket.socket, greeting: bytes, held: list[socket.socket]) -> None:
    with suppress(OSError):
        while True:
            connection, _ = server.accept()
            held.append(connection)  # first, as the client may be gone before the greeting: it is closed all the same
            connection.sendall(greeting)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes a certificate")
def test_a_server_of_encrypted_words_that_says_nothing_is_no_scheduler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with tcp: the client's own limit is for the connection, not for what comes before the first word."""
    import dask

    monkeypatch.setattr(pool, "_GRACE", 0.5)
    key = tmp_path / "key.pem"
    argv = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=here"]
    subprocess.run([*argv, "-keyout", key, "-out", tmp_path / "cert.pem"], check=True, capture_output=True)
    told = {"ca-file": tmp_path / "cert.pem", "client.key": key, "client.cert": tmp_path / "cert.pem"}
    settings = {f"distributed.comm.tls.{name}": str(path) for name, path in told.items()}
    with socket.create_server(("127.0.0.1", 0)) as silent, dask.config.set(settings):
        address = f"tls://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(EnvironmentFailure, match=rf"no answer from {address} within 0\.5 s"):
            pool.DaskPool(address, tmp_path, None)
