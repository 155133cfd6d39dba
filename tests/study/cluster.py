"""A Dask cluster on this machine, for tests."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from tests.cli.conftest import clean_environment, wait_for
from tests.study.conftest import PATIENCE


@contextmanager
def _process(module: str, *words: object, path: Path | None = None) -> Iterator[subprocess.Popen[str]]:
    environment = clean_environment({} if path is None else {"PYTHONPATH": str(path)})
    argv = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}
    # Python looks for modules in the working folder first.
    process = subprocess.Popen(argv, env=environment, text=True, cwd=path or "/", **quiet)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A scheduler, and its address."""
    file = folder / "scheduler.json"
    words = ["--port", 0, "--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", file]
    with _process("dask_scheduler", *words) as process:
        assert wait_for(lambda: file.exists() and "address" in file.read_text(), process)
        yield process, file.read_text().split('"address": "')[1].split('"')[0]


def worker(address: str, folder: Path, path: Path | None = None) -> AbstractContextManager[subprocess.Popen[str]]:
    """A worker of one thread; `path` is where it finds radwrap, if not as this process does."""
    words = [address, "--nthreads", 1, "--no-nanny", "--no-dashboard", "--local-directory", folder]
    return _process("dask_worker", *words, path=path)


def wait_for_workers(address: str, number: int) -> None:
    """Until so many are there."""
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(number, timeout=PATIENCE)
