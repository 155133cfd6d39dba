"""A design on a Dask cluster, one of whose workers is killed at work."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.cli.conftest import start, wait_for
from tests.designing.conftest import Write
from tests.designing.test_resume import TEXT, contents, records, whole, written
from tests.study.cluster import scheduler, worker
from tests.study.conftest import PATIENCE


@pytest.mark.long  # starting processes takes as long as all else of this folder
def test_a_lost_worker_changes_no_byte_and_nothing_is_computed_twice(design_file: Write, tmp_path: Path) -> None:
    path, out = design_file(TEXT.replace("budget = 16", "budget = 8")), tmp_path / "out"
    whole(path, tmp_path / "one", 1)
    with ExitStack() as stack:
        _, address = stack.enter_context(scheduler(tmp_path))
        first = stack.enter_context(worker(address, tmp_path / "w1"))
        with start(["design", "run", path, "--out", out, "--dask", address]) as process:
            assert wait_for(lambda: records(out) >= 2, process, PATIENCE)
            finished = written(out)
            first.kill()
            stack.enter_context(worker(address, tmp_path / "w2"))
            _, told = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, told
    assert contents(out) == contents(tmp_path / "one")
    assert records(out) == records(tmp_path / "one")
    assert written(out).items() >= finished.items()
