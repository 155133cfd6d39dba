"""Where the jobs of a study are done: processes of this machine, or workers of a Dask cluster.

Both are a `concurrent.futures.Executor`. What is added here: a process pool that broke is made anew, and its
processes end with this one, however it ends.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from radwrap.errors import INTERRUPTED, EnvironmentFailure, InputError

# A worker that was told to end gets so long for its tracers [s].
_GRACE: Final = 10.0


class Pool(Protocol):
    """Something that does jobs.

    Attributes
    ----------
    workers : int
        How many at a time.
    """

    workers: int

    def submit(self, work: Callable[[Any], Any], job: Any) -> Future[Any]:
        """Have a job done."""

    def is_broken(self, error: BaseException) -> bool:
        """Whether an error of a job means that its worker ended, and not that the job failed."""

    def rebuild(self) -> None:
        """Make the workers anew, after some of them ended."""

    def close(self) -> None:
        """End all workers and what they started."""


class LocalPool:
    """Processes on this machine."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._start()

    def _start(self) -> None:
        # The writing end lives in this process alone: when this ends, by whatever way, every worker reads the end of
        # the file and ends too.
        context = multiprocessing.get_context("spawn")
        reader, self._alive = context.Pipe(duplex=False)
        self._executor: Executor = ProcessPoolExecutor(self.workers, context, _begin, (reader,))
        self._reader = reader

    def submit(self, work: Callable[[Any], Any], job: Any) -> Future[Any]:
        """Have a job done."""
        with _without_interrupts():  # workers that start here inherit that Ctrl-C is not for them
            return self._executor.submit(work, job)

    def is_broken(self, error: BaseException) -> bool:
        """Whether a process of the pool ended."""
        return isinstance(error, BrokenProcessPool)

    def rebuild(self) -> None:
        """End what is left of the pool, and start another."""
        self.close()
        self._start()

    def close(self) -> None:
        """End the processes: what they do is given up, their tracers end with them."""
        with suppress(OSError):
            self._alive.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        with suppress(OSError):
            self._reader.close()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(alive: Connection) -> None:
    """In a new worker: Ctrl-C is for the study, which then ends its workers; so does its own end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: os._exit(INTERRUPTED))  # between jobs there is nothing to end
    threading.Thread(target=_watch, args=(alive,), daemon=True).start()


def _watch(alive: Connection) -> None:
    with suppress(EOFError, OSError):
        alive.recv_bytes()
    # The main thread ends its tracers, if it has any; see worker.carry_out.
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(_GRACE)
    os._exit(INTERRUPTED)


class DaskPool:
    """Workers of a Dask cluster; they must see the study's folder under the same name.

    Raises
    ------
    InputError
        If no scheduler answers at the address.
    EnvironmentFailure
        If Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise EnvironmentFailure(
                "Dask is not installed", where="--dask", remedy="pip install radwrap[cluster]"
            ) from error
        _check_scheduler(address)
        try:
            self._client = Client(address, timeout="10 s", set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"no scheduler at {address}", where="--dask", remedy="start one: dask scheduler"
            ) from error
        self.workers = max(1, sum(self._client.ncores().values()))
        # Equal jobs of another time are not the same jobs.
        self._executor: Executor = self._client.get_executor(pure=False)

    def submit(self, work: Callable[[Any], Any], job: Any) -> Future[Any]:
        """Have a job done."""
        future: Future[Any] = self._executor.submit(work, job)
        return future

    def is_broken(self, error: BaseException) -> bool:
        """Whether Dask gave up a job because its workers ended one after the other."""
        return type(error).__name__ in ("KilledWorker", "CommClosedError", "FutureCancelledError")

    def rebuild(self) -> None:
        """Nothing: the scheduler looks after its workers."""

    def close(self) -> None:
        """Give up what is not begun; a worker ends the run it is at."""
        self._executor.shutdown(wait=False)
        self._client.close()


def _check_scheduler(address: str) -> None:
    """Refuse an address where nobody listens, before Dask tries for long and speaks of it in many lines."""
    try:
        place = urlsplit(address)
        host, port = place.hostname, place.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise InputError(f'"{address}" is no address', where="--dask", remedy='write "tcp://HOST:8786"')
    try:
        socket.create_connection((host, port), _GRACE).close()
    except OSError as error:
        raise InputError(f"no scheduler at {address}", where="--dask", remedy="start one: dask scheduler") from error
