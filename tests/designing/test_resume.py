"""A killed design goes on, renders nothing twice, and ends with the bytes of one that nobody disturbed."""

from __future__ import annotations

import signal
from pathlib import Path

import psutil
import pytest

from radwrap.files import sha256_of
from tests.cli.conftest import PATIENCE, start, wait_for
from tests.designing.conftest import Write

TEXT = """
budget = 16
batch = 4
seed = 2
[render]
tolerance = 4
[keys.time]
key = "camera.exposure_time"
low = "20 ms"
high = "400 ms"
[keys.opening]
key = "camera.aperture.diameter"
choices = ["0.1 mm", "0.2 mm", "0.3 mm"]
cost = [1, 2, 3]
[responses.mean]
measure = "mean_gray"
[[objectives]]
of = "mean"
aim = "maximise"
[[constraints]]
of = "peak_gray"
at_most = 200
[[constraints]]
of = "cost"
at_most = 2
"""


def contents(out: Path) -> dict[str, str]:
    return {name: sha256_of(out / name) for name in ("design.json", "trials.csv", "best.toml", "index.html")}


def whole(path: Path, out: Path, workers: int) -> None:
    with start(["design", "run", path, "--out", out, "--workers", workers]) as process:
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 0


def written(out: Path) -> dict[Path, int]:
    """Return when each whole record was written; one that is still being written has a dot before its name."""
    return {path: path.stat().st_mtime_ns for path in out.glob("records/[!.]*.json")}


def records(out: Path) -> int:
    return len(written(out))


def kill_after(path: Path, out: Path, more: int, number: signal.Signals) -> int:
    """Start the command, send it a signal once it has more records, and see that its workers end."""
    before = records(out)
    with start(["design", "run", path, "--out", out, "--workers", 2]) as process:
        assert wait_for(lambda: records(out) >= before + more or process.poll() is not None, process)
        children = [] if process.poll() is not None else psutil.Process(process.pid).children(recursive=True)
        process.send_signal(number)
        process.communicate(timeout=PATIENCE)
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert not alive
    return process.returncode


@pytest.mark.long  # starting processes takes as long as all else of this folder
@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)])
def test_kills_and_workers_change_no_byte(
    design_file: Write, tmp_path: Path, number: signal.Signals, code: int
) -> None:
    path, out = design_file(TEXT), tmp_path / "out"
    whole(path, tmp_path / "one", 1)
    expected, most = contents(tmp_path / "one"), records(tmp_path / "one")
    for _ in range(3):
        assert kill_after(path, out, 2, number) == code and records(out) < most
    finished = written(out)
    whole(path, out, 2)
    assert contents(out) == expected and records(out) == most
    assert written(out).items() >= finished.items()  # nothing is made twice
    assert not list(out.glob("records/.*"))  # what a kill left half written is gone
