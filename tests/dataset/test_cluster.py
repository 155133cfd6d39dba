"""Datasets on many machines: the same bytes, and a worker who comes too late changes none."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from radwrap.cli.main import main
from radwrap.dataset import one_image, run
from radwrap.dataset.document import read_dataset
from radwrap.dataset.one_image import ImageJob, make_image
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.imaging import tracer_choice
from radwrap.imaging.render_options import RenderOptions
from tests.cli.conftest import start, wait_for
from tests.dataset.conftest import TEXT, Write, contents
from tests.dataset.test_resume import records
from tests.study.cluster import scheduler, wait_for_workers, worker
from tests.study.conftest import PATIENCE


def test_an_address_of_nobody_is_refused(
    dataset_file: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = dataset_file(TEXT.format(images=2))
    words = ["dataset", "run", str(path), "--out", str(tmp_path / "out"), "--dask", "tcp://127.0.0.1:1"]
    assert main(words) == 4
    assert "--dask tcp://127.0.0.1:1: no scheduler is there" in capsys.readouterr().err
    assert main([*words[:-1], "nonsense"]) == 2
    with pytest.raises(InputError, match="the cluster has its own workers"):
        run.RunOptions(workers=2, dask="tcp://127.0.0.1:1")


def test_a_worker_whose_run_was_given_up_writes_nothing(
    dataset_file: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While it renders, another run takes the folder over."""
    monkeypatch.setattr(tracer_choice, "WORTH_COMPILED", 1)
    dataset, out = read_dataset(dataset_file(TEXT.format(images=1))), tmp_path / "out"
    (out / one_image.WORK).mkdir(parents=True)
    render = one_image.render

    def taken_over(*words: Any, **more: Any) -> Any:
        made = render(*words, **more)
        run._remove_work(out)
        (out / one_image.WORK).mkdir()
        return made

    monkeypatch.setattr(one_image, "render", taken_over)
    with pytest.raises(EnvironmentFailure):
        make_image(ImageJob(dataset, 0, str(out), RenderOptions(tolerance=8, workers=1)))
    assert not (out / "train").exists() and not any((out / one_image.WORK).iterdir())


@pytest.mark.long
def test_a_cluster_makes_the_same_bytes(
    dataset_file: Write, tmp_path: Path, good: Callable[[int], dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of two workers is killed at work, and the run itself; both go on."""
    expected, out, path = good(8), tmp_path / "out", tmp_path / "dataset.toml"
    with ExitStack() as stack:
        _, address = stack.enter_context(scheduler(tmp_path))
        first = stack.enter_context(worker(address, tmp_path / "w1"))
        stack.enter_context(worker(address, tmp_path / "w2"))
        wait_for_workers(address, 2)
        words = ["dataset", "run", path, "--out", out, "--dask", address]
        with start(words) as process:
            assert wait_for(lambda: records(out) >= 1, process, PATIENCE)
            first.kill()
            assert wait_for(lambda: records(out) >= 3, process, PATIENCE)
            process.kill()
        with start(words) as process:
            _, told = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, told
    assert {name: sha for name, sha in contents(out).items() if name != ".radwrap.cluster"} == expected
