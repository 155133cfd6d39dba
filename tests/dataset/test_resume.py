"""A killed dataset goes on, ends with the bytes of one that nobody disturbed, and leaves no process."""

from __future__ import annotations

import random
import signal
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from radwrap.dataset import run
from radwrap.dataset.document import read_dataset
from tests.cli.conftest import PATIENCE, start, wait_for
from tests.dataset.conftest import Write, contents
from tests.study.conftest import OneThread


def records(out: Path) -> int:
    return len(list(out.glob("train/*/records/[!.]*.json")))


def kill_after(path: Path, out: Path, workers: int, more: int, number: signal.Signals = signal.SIGKILL) -> int:
    """Start the command, send it a signal once it has made more images, and see that its workers end."""
    before = records(out)
    with start(["dataset", "run", path, "--out", out, "--workers", workers]) as process:
        assert wait_for(lambda: records(out) >= before + more or process.poll() is not None, process)
        children = [] if process.poll() is not None else psutil.Process(process.pid).children(recursive=True)
        process.send_signal(number)
        process.communicate(timeout=PATIENCE)
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert not alive
    return process.returncode


@pytest.mark.long  # starting processes takes as long as all else of this folder
def test_a_killed_dataset_goes_on_to_the_same_bytes(
    dataset_file: Write, tmp_path: Path, good: Callable[[int], dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected, out = good(3), tmp_path / "out"
    path = tmp_path / "dataset.toml"
    assert kill_after(path, out, 1, 1) == -signal.SIGKILL
    assert 1 <= records(out) < 3
    monkeypatch.setattr(run, "LocalPool", OneThread)
    run.run_dataset(read_dataset(path), out, run.RunOptions())
    assert contents(out) == expected


@pytest.mark.long
@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)])
def test_ten_kills_change_no_byte(
    tmp_path: Path, good: Callable[[int], dict[str, str]], number: signal.Signals, code: int
) -> None:
    expected, out, chance = good(26), tmp_path / "out", random.Random(5)  # noqa: S311  (moments of kills)
    path = tmp_path / "dataset.toml"
    for _ in range(10):
        assert kill_after(path, out, 2, chance.randint(1, 2), number) == code
        assert records(out) < 26
    with start(["dataset", "run", path, "--out", out, "--workers", 2]) as process:
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 0 and contents(out) == expected
