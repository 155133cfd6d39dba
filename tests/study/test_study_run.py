"""Studies as users run them: rows as they end, killed and gone on, workers that die, sub-work that is done once."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import psutil
import pytest

from radwrap.study.table import read_table
from tests.cli.conftest import Done, here, inhabitants, inside, start
from tests.cli.conftest import wait_for as wait
from tests.study.conftest import PATIENCE, TINY, TINY_SMALL, DesignWriter, OneThread, command, write_design

# Runs of a third of a second each, and how often each is done: long enough to be killed in between.
REPLICATES = {4: 1, 8: 2}


GRAY = '[responses.mean]\nmeasure = "mean_gray"\n[responses.contrast]\nmeasure = "contrast"\n'


def study(path: Path, out: Path, *options: object) -> Done:
    return command("study", "run", path, "--out", out, "--no-report", *options)


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> bool:
    """Wait until something is so; False if the study ended before."""
    return wait(condition, process, PATIENCE)


def rows_on_disk(out: Path) -> int:
    """Whole lines of the table of results, less its header."""
    table = out / "results.csv"
    return max(0, table.read_bytes().count(b"\n") - 1) if table.exists() else 0


def started(out: Path) -> Counter[int]:
    """How often each run was begun."""
    return Counter(int(line.split()[1]) for line in (out / "started.log").read_text().splitlines())


@pytest.fixture(scope="module", params=[4, pytest.param(8, marks=pytest.mark.long)])
def runs(request: pytest.FixtureRequest) -> int:
    """How many runs a study has."""
    number: int = request.param
    return number


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, runs: int) -> Path:
    """Results of the runs, with their report, by this process, which nobody disturbs."""
    folder = tmp_path_factory.mktemp("good")
    words = ("study", "run", several(folder, runs), "--out", folder / "out", "--workers", "1", "--json")
    with patch("radwrap.study.study.LocalPool", OneThread):
        done = inside(*words).success()
    assert done.json["runs"] == runs and done.json["failed"] == 0 and done.json["renders"] == runs
    return folder / "out"


@pytest.fixture(scope="module")
def good(undisturbed: Path) -> bytes:
    """The table of the runs."""
    return (undisturbed / "results.csv").read_bytes()


def several(folder: Path, runs: int) -> Path:
    return write_design(folder, TINY_SMALL.replace("seed = 5", f"seed = 5\nreplicates = {REPLICATES[runs]}"), GRAY)


def test_a_study_that_is_interrupted_and_killed_goes_on(tmp_path: Path, good: bytes, runs: int) -> None:
    """Of few runs once by Ctrl-C and once killed; of many three times killed, and Ctrl-C has a test of its own."""
    path, out = several(tmp_path, runs), tmp_path / "out"
    dice = random.Random(7)  # noqa: S311  (no secret)
    finished: set[str] = set()
    for due, ends in _ends(runs):
        before = started(out) if out.exists() else Counter[int]()
        with start(["study", "run", path, "--out", out, "--workers", "2", "--no-report"]) as process:
            assert wait_for(lambda due=due: rows_on_disk(out) >= due, process), "the study was too short for this test"
            time.sleep(dice.uniform(0, 0.3))
            process.send_signal(ends)
            process.communicate(timeout=PATIENCE)
        assert process.returncode == (130 if ends == signal.SIGINT else -signal.SIGKILL)
        assert _empty(out)
        again = started(out) - before
        assert not {str(number) for number in again} & finished, "a finished run was begun again"
        finished = {row["run"] for row in read_table(_whole_lines(out)).rows}
    with patch("radwrap.study.study.LocalPool", OneThread):
        done = inside("study", "run", path, "--out", out, "--no-report", "--workers", "1", "--json").success()
    assert done.json["timing"]["reused_runs"] == len(finished)
    assert (out / "results.csv").read_bytes() == good
    assert inhabitants(out) == []


def _ends(runs: int) -> list[tuple[int, signal.Signals]]:
    """After how many rows a study of so many runs is ended, and by what."""
    if runs == 4:
        return [(1, signal.SIGINT), (2, signal.SIGKILL)]
    return [(due, signal.SIGKILL) for due in (1, 3, 5)]


def _whole_lines(out: Path) -> Path:
    """A copy of the table without the line that a killed study did not end."""
    content = (out / "results.csv").read_bytes()
    copy = out.parent / "copy.csv"
    copy.write_bytes(content[: content.rfind(b"\n") + 1])
    return copy


def _empty(out: Path) -> bool:
    """Whether workers and tracers of a killed study end by themselves."""
    end = time.monotonic() + PATIENCE
    while inhabitants(out) or _orphans():
        if time.monotonic() > end:
            raise AssertionError([*inhabitants(out), *_orphans()])
        time.sleep(0.05)
    return True


def _orphans() -> list[str]:
    """Worker processes of a study that is no more: this file starts one study at a time, other suites their own."""
    found = [info["cmdline"] for one in psutil.process_iter(["cmdline", "ppid"]) if (info := one.info)["ppid"] == 1]
    ours = str(Path(sys.executable).parent)
    return [" ".join(words) for words in found if words and words[0].startswith(ours) and "spawn_main" in str(words)]


@pytest.mark.long
def test_a_killed_worker_costs_nothing_that_was_finished(tmp_path: Path, good: bytes, runs: int) -> None:
    path, out = several(tmp_path, runs), tmp_path / "out"
    with start(["study", "run", path, "--out", out, "--workers", "2", "--no-report", "--json"]) as process:
        assert wait_for(lambda: rows_on_disk(out) >= runs // 3, process), "the study was too short for this test"
        finished = {int(row["run"]) for row in read_table(_whole_lines(out)).rows}
        victim = next(child for child in psutil.Process(process.pid).children() if "spawn_main" in str(child.cmdline()))
        os.kill(victim.pid, signal.SIGKILL)
        stdout, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, stderr
    assert json.loads(stdout)["failed"] == 0
    begun = started(out)
    assert all(begun[number] == 1 for number in finished)
    assert (out / "results.csv").read_bytes() == good
    assert inhabitants(out) == []


@pytest.mark.long
def test_ctrl_c_ends_everything_and_the_study_goes_on(tmp_path: Path, good: bytes, runs: int) -> None:
    path, out = several(tmp_path, runs), tmp_path / "out"
    with start(
        ["study", "run", path, "--out", out, "--workers", "2", "--no-report"], start_new_session=True
    ) as process:
        assert wait_for(lambda: rows_on_disk(out) >= runs // 4, process), "the study was too short for this test"
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
        _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert "Traceback" not in stderr and stderr.endswith("the same command goes on from what was finished\n"), stderr
    assert _empty(out)
    study(path, out).success()
    assert (out / "results.csv").read_bytes() == good


_FINALISED = """
import os, signal, time
from radwrap.study.worker import ended_by_signal
class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0)
with ended_by_signal():
    Finalised()
    time.sleep(3600)
"""


def test_a_worker_ends_although_its_end_came_where_python_cannot_raise() -> None:
    """In a finaliser, say: without a word, and soon."""
    done = subprocess.run([sys.executable, "-c", _FINALISED], capture_output=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (130, b"")


@pytest.mark.usefixtures("one_process")
def test_a_run_that_fails_is_a_row_with_its_error(design: DesignWriter, capsys: pytest.CaptureFixture[str]) -> None:
    """At 100 s everything is saturated and shows no edge; the mean is measured all the same, and the study goes on."""
    path = design(
        f"""
analysis = "none"
{TINY}
[design]
kind = "full"
[factors.t]
key = "camera.exposure_time"
levels = ["100 ms", "100 s", "90 ms"]
"""
    )
    out = path.parent / "out"
    words = ["study", "run", path, "--out", out, "--no-report"]
    done = here([*words, "--json"], capsys)
    assert done.code == 1 and done.json["failed"] == 1
    assert "1 of 3 runs failed, first run 2: u: the image" in done.stderr and "results.csv" in done.stderr
    bad, *others = sorted(read_table(out / "results.csv").rows, key=lambda row: row["t"] != "100 s")
    assert bad["u [px]"] == "" and "u: the image" in bad["error"] and float(bad["mean"]) > 200
    assert all(row["error"] == "" and row["u [px]"] for row in others)
    # It is not tried again, unless it is asked for.
    again = started(out)
    assert here(words, capsys).code == 1
    assert started(out) == again
    assert here([*words, "--retry-failed"], capsys).code == 1
    assert started(out) - again == Counter({2: 1})


@pytest.mark.long
@pytest.mark.usefixtures("one_process")
def test_many_levels_of_leds_cost_one_render(design: DesignWriter, capsys: pytest.CaptureFixture[str]) -> None:
    """64 runs of three LEDs by a light basis, each the very image that a render of its own has, to its error."""
    factors = "".join(
        f'[factors.L{n}]\nkey = "sources[0].leds[{n}].radiance_factor"\nlevels = [0.2, 0.4, 0.6, 1.0]\n'
        for n in range(3)
    )
    path = design(
        f'analysis = "none"\n{TINY}[design]\nkind = "full"\n{factors}', '[responses.mean]\nmeasure = "mean_gray"\n'
    )
    out = path.parent / "out"
    words = ["study", "run", path, "--out", out, "--no-report"]
    told = here([*words, "--json"], capsys).success().json
    assert told["renders"] == 1 and told["light_bases"] == 1 and told["relit"] == 64
    rows = read_table(out / "results.csv").rows
    # Gray is linear in the levels here: G = 20 + sum of what each LED alone gives.
    values = [float(row["mean"]) - 20 for row in rows]
    levels = [[float(row[f"L{n}"]) for n in range(3)] for row in rows]
    solution, *_ = np.linalg.lstsq(np.array(levels), np.array(values), rcond=None)
    assert np.abs(np.array(levels) @ solution - values).max() < 1e-4  # float32 of basis and image
    # A killed chunk gives the same bytes when it is made again, whatever else it is made with.
    table = (out / "results.csv").read_bytes()
    lines = table.splitlines(keepends=True)
    (out / "results.csv").write_bytes(b"".join([lines[0], *lines[5:20], *lines[40:]]))
    here(words, capsys).success()
    assert (out / "results.csv").read_bytes() == table


def test_the_report_holds_every_run(undisturbed: Path, runs: int) -> None:
    text = (undisturbed / "index.html").read_text()
    assert text.count('alt="run ') == runs and "place of the edge" in text and "exposure_time" in text
    assert "targets[0].edge_position" in text and "built-in" not in text
    assert "http" not in text.replace("http://www.w3.org", ""), "it must need nothing else"


@pytest.mark.long
def test_dask_gives_the_same_table(tmp_path: Path, good: bytes, runs: int) -> None:
    """On a LocalCluster of two worker processes, one of which is killed.

    Long: that Dask gives the table of this process, and that a worker is killed, test_cluster sees; what is done
    again after a death is the same for all pools, and is seen above.
    """
    from distributed import LocalCluster

    path, out = several(tmp_path, runs), tmp_path / "out"
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",  # any free port: other tests' schedulers run beside this one
        local_directory=str(tmp_path / "d"),
    ) as cluster:
        with start(
            ["study", "run", path, "--out", out, "--dask", cluster.scheduler_address, "--no-report", "--json"]
        ) as process:
            assert wait_for(lambda: rows_on_disk(out) >= runs // 3, process)
            finished = {int(row["run"]) for row in read_table(_whole_lines(out)).rows}
            worker = next(iter(cluster.workers.values()))
            os.kill(worker.pid, signal.SIGKILL)
            stdout, stderr = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, stderr
    assert json.loads(stdout)["failed"] == 0
    begun = started(out)
    assert all(begun[number] == 1 for number in finished)
    assert (out / "results.csv").read_bytes() == good
