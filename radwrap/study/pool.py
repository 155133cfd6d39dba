"""Where the jobs of a study are done: processes of this machine, or workers of a Dask cluster.

Both are a `concurrent.futures.Executor`. What is added here: a process pool that broke is made anew, and its
processes end with this one, however it ends.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from radwrap.errors import INTERRUPTED, EnvironmentFailure, InputError, one_line
from radwrap.extras import require
from radwrap.manifest import STUDY_PACKAGES
from radwrap.process import MOST_WORKERS
from radwrap.progress import note
from radwrap.study.seal import Seal, break_seal, check_fit, seal_of, why_unfit

# A worker that was told to end gets so long for its tracers [s].
_GRACE: Final = 10.0
# So long a cluster may have no worker [s]: one that was killed is back by then; whoever queues for hours says so.
WORKER_TIMEOUT: Final = 60.0
_LONGEST: Final = 1e9  # s that a limit of time may be, as in `RenderOptions`


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

    def look(self) -> None:
        """Look after the workers: some may have come or gone."""

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

    def look(self) -> None:
        """Nothing: a process that ends tells."""

    def close(self) -> None:
        """End the processes: what they do is given up, their tracers end with them."""
        with suppress(OSError):
            self._alive.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        with suppress(OSError):
            self._reader.close()


def check_workers(workers: int | None, dask: str | None, worker_timeout: float | None) -> None:
    """See that what is said of workers goes together.

    Raises
    ------
    InputError
        If a number is out of range, or is for the other kind of pool.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"must lie between 1 and {MOST_WORKERS}, not {workers}", where="workers")
    if workers is not None and dask is not None:
        raise InputError("the cluster has its own workers", where="workers", remedy="leave it out with `dask`")
    if worker_timeout is not None and dask is None:
        raise InputError("only a cluster can be without workers", where="worker_timeout", remedy="give `dask` too")
    if worker_timeout is not None and not 0 < worker_timeout <= _LONGEST:
        raise InputError(f"must lie between 0 and {_LONGEST:g} s", where="worker_timeout")


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
    """Workers of a Dask cluster; they must have the same programs, and see the study's folder under the same name.

    Parameters
    ----------
    address : str
        Of the scheduler.
    folder : Path
        Of the study.
    radiance : str or None
        Folder of the Radiance that is asked for.
    worker_timeout : float
        How long there may be no worker [s].
    packages : sequence of str
        Whose versions must be the same on each worker, besides radwrap's own needs.

    Raises
    ------
    InputError
        If the address is none.
    EnvironmentFailure
        If Dask is not installed, nobody listens at the address, whoever listens is no scheduler, or no worker is fit.
    """

    def __init__(
        self,
        address: str,
        folder: Path,
        radiance: str | None,
        worker_timeout: float = WORKER_TIMEOUT,
        packages: Sequence[str] = STUDY_PACKAGES,
    ) -> None:
        require("cluster", f"dask={address}")
        from distributed import Client

        _silence_dask()
        _check_scheduler(address)
        try:
            self._client = Client(address, timeout="10 s", set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise _nobody(address) from error
        self._address = address
        self._seal = seal_of(folder, radiance, packages)
        self._executors: list[Executor] = []
        self._cores: dict[str, int] = {}
        self._unfit: dict[str, str] = {}
        self.workers = 0
        self._told = ""
        self._patience, self._last_seen = worker_timeout, time.monotonic()
        try:
            self.look()
        except BaseException:
            self.close()
            raise

    def submit(self, work: Callable[[Any], Any], job: Any) -> Future[Any]:
        """Have a job done."""
        future: Future[Any] = self._executors[-1].submit(_sealed, self._seal, work, job)
        return future

    def is_broken(self, error: BaseException) -> bool:
        """Whether a worker ended or was not fit; Dask gives up a job where several ended one after the other."""
        return type(error).__name__ in ("KilledWorker", "CommClosedError", "FutureCancelledError", "Unfit")

    def rebuild(self) -> None:
        """Look at each worker again; the scheduler starts them."""
        self._cores.clear()
        self.look()

    def look(self) -> None:
        """Take on workers that came, once they are seen to be fit, and give up those that went.

        Raises
        ------
        EnvironmentFailure
            If the scheduler is gone, all workers that are there are unfit, or there was none for too long.
        """
        try:
            if self._client.status != "running":
                raise OSError
            there = self._client.ncores()
            new = [name for name in there if name not in self._cores and name not in self._unfit]
            found = self._client.run(why_unfit, self._seal, workers=new, on_error="return") if new else {}
        except (OSError, TimeoutError) as error:
            raise self._gone() from error
        self._unfit = {name: why for name, why in self._unfit.items() if name in there}
        self._unfit |= {name: str(why) for name, why in found.items() if why}
        fit = {name: cores for name, cores in there.items() if name not in self._unfit}
        if fit.keys() != self._cores.keys() and fit:
            self._executors.append(self._executor_of(fit))
        self._cores = fit
        self.workers = sum(fit.values())
        if self._unfit and not fit:
            name, why = next(iter(self._unfit.items()))
            raise EnvironmentFailure(f"no worker is fit: {why}", where=name, remedy="see docs/study.md, Many machines")
        if fit:
            self._last_seen = time.monotonic()
            self._tell(self._left_out() if self._unfit else "")
            return
        if time.monotonic() - self._last_seen > self._patience:
            raise EnvironmentFailure(
                f"no worker for {self._patience:g} s",
                where=self._address,
                remedy="start one: dask worker; the same command then continues; or raise `worker_timeout`",
            )
        self._tell(f"no worker is available; waiting {self._patience:g} s for one at {self._address}")

    def _executor_of(self, fit: Collection[str]) -> Executor:
        """Of equal jobs each is done. Those who came since may refuse one, and are then known to be unfit."""
        # Dask keeps a job for ever that is for named workers who have all ended, whoever comes: so none are named while
        # all are fit. Where some are not, they are used only where no other is left, and then refuse.
        named = {"workers": list(fit), "allow_other_workers": True} if self._unfit else {}
        made: Executor = self._client.get_executor(pure=False, **named)
        return made

    def _left_out(self) -> str:
        return f"{len(self._unfit)} workers are left out: {next(iter(self._unfit.values()))}"

    def _gone(self) -> EnvironmentFailure:
        return EnvironmentFailure(
            "the scheduler is gone", where=self._address, remedy="start it again; the same command then continues"
        )

    def _tell(self, what: str) -> None:
        if what and what != self._told:
            note(what)
        self._told = what

    def close(self) -> None:
        """Give up what is not begun; a worker ends the run it is at."""
        break_seal(self._seal)
        for executor in self._executors:
            with suppress(OSError, RuntimeError):
                executor.shutdown(wait=False)
        with suppress(OSError, TimeoutError, RuntimeError):
            self._client.close(timeout=_GRACE / 2)


def _silence_dask() -> None:
    """What matters is told by us, in one line; its log tells of one lost connection in dozens of them."""
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _sealed(seal: Seal, work: Callable[[Any], Any], job: Any) -> Any:
    """On a worker: do a job, if that is the same here as anywhere."""
    check_fit(seal)
    return work(job)


def _nobody(address: str) -> EnvironmentFailure:
    return EnvironmentFailure("no scheduler is there", where=f"dask={address}", remedy="start one: dask scheduler")


def _check_scheduler(address: str) -> None:
    """Refuse an address where nobody listens or answers, before Dask tries for long and speaks of it in many lines."""
    import asyncio  # takes 0.06 s, and other pools need none of it

    try:
        place = urlsplit(address)
        host, port = place.hostname, place.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise InputError(f'"{address}" is not an address', where="dask", remedy='write "tcp://HOST:8786"')
    silence = EnvironmentFailure(
        f"no answer from {address} within {_GRACE:g} s", where=f"dask={address}", remedy="see whether it is a scheduler"
    )
    try:
        socket.create_connection((host, port), _GRACE).close()
    except TimeoutError as error:
        raise silence from error
    except OSError as error:
        raise _nobody(address) from error
    try:
        kind = asyncio.run(asyncio.wait_for(_kind_of(address), _GRACE))
    except TimeoutError as error:
        raise silence from error
    except Exception as error:  # another kind of server may say anything, and Dask trips over it anyhow
        raise EnvironmentFailure(
            f"no Dask scheduler answers at {address}: {one_line(str(error))}",
            where=f"dask={address}",
            remedy="see whether it is a scheduler",
        ) from error
    if kind != "Scheduler":
        raise EnvironmentFailure(f"a {kind} answers at {address}", where="dask", remedy="name the scheduler's address")


async def _kind_of(address: str) -> str:
    """What a server of Dask says it is. Dask's own client waits without end for one that says something else."""
    import distributed

    untyped: Any = distributed
    words = untyped.Security().get_connection_args("client")
    comm = await untyped.comm.connect(address, timeout=_GRACE, **words)
    try:
        await comm.write({"op": "identity", "reply": True})
        return str((await comm.read())["type"])
    finally:
        comm.abort()
