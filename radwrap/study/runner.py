"""The loop of a study: which job next, which row is finished, and what is done after a worker died.

A finished run is a line of results.csv, on the disk before the next thing
happens; a study that goes on reads them and does the others.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Final, Protocol

from radwrap.errors import EnvironmentFailure, InputError, RadwrapError, TracerError
from radwrap.progress import Progress
from radwrap.study.pool import Pool
from radwrap.study.worker import Job, Outcome, carry_out, failed
from radwrap.waiting import Finished

# After so many deaths of a worker while a job was under way, it is done alone, and blamed if it happens again.
_SUSPECT: Final = 2
_LOOK: Final = 1.0  # s between looks at the workers while none has ended a job
_AHEAD: Final = 2  # jobs in the pool's hands for each worker


@dataclass(frozen=True, slots=True)
class Step:
    """A job, and the job that must come before it."""

    job: Job
    after: str | None = None


class Sink(Protocol):
    """Where finished runs go."""

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Keep rows for ever."""


class _NoSink:
    """For jobs that leave files, and no rows."""

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Nothing is kept."""


NO_SINK: Final[Sink] = _NoSink()


class Scheduler:
    """Carries out steps with a pool.

    Parameters
    ----------
    steps : iterable of Step
        What is to be done; a step that others wait for comes before them.
    sink : Sink
        Gets the outcomes.
    pool : Pool
        Does the jobs; it stays open, and is to be closed also where this fails.
    progress : Progress
        Counts runs.
    work : callable
        How a worker does a job; a function of a module, so that other processes find it.
    """

    def __init__(
        self,
        steps: Iterable[Step],
        sink: Sink,
        pool: Pool,
        progress: Progress,
        work: Callable[[Any], list[Outcome]] = carry_out,
    ) -> None:
        self._work = work
        self._sink = sink
        self._pool = pool
        self._progress = progress
        self._ready: deque[Job] = deque()
        self._waiting: dict[str, list[Job]] = {}
        self._deaths: dict[str, int] = {}
        self._running: dict[Future[Any], Job] = {}
        self._finished: Finished[Any] = Finished()
        self._failures: dict[str, RadwrapError] = {}
        due = list(steps)
        names = {step.job.name for step in due}
        for step in due:
            if step.after in names:
                self._waiting.setdefault(str(step.after), []).append(step.job)
            else:
                self._ready.append(step.job)

    def run(self) -> Mapping[str, RadwrapError]:
        """Do everything.

        Returns
        -------
        Mapping of str to RadwrapError
            Jobs that failed -> why.

        Raises
        ------
        EnvironmentFailure
            If a worker says that nothing can be done on its machine.
        """
        while self._ready or self._running:
            self._submit()
            if not self._running:
                time.sleep(_LOOK)
            done = {
                future for future in self._finished.within(_LOOK if self._running else 0) if future in self._running
            }
            if not done:
                self._pool.look()
            if broken := self._collect(done):
                self._after_death(broken)
        return self._failures

    def _submit(self) -> None:
        while self._ready and len(self._running) < _AHEAD * self._pool.workers:
            suspect = self._deaths.get(self._ready[0].name, 0) >= _SUSPECT
            alone = any(self._deaths.get(job.name, 0) >= _SUSPECT for job in self._running.values())
            if alone or (suspect and self._running):
                return
            job = self._ready.popleft()
            try:
                self._running[self._finished.watch(self._pool.submit(self._work, job))] = job
            except RuntimeError as error:
                if not self._pool.is_broken(error):
                    raise
                # It broke between two looks; those that were under way tell in a moment.
                self._ready.appendleft(job)
                if not self._running:
                    self._pool.rebuild()
                return

    def _collect(self, done: set[Future[Any]]) -> list[Future[Any]]:
        """Keep what jobs brought, and empty the set; those whose workers died are returned.

        A future is let go before its rows are saved: a cluster does a job again whose worker ends while its future is
        held.
        """
        broken = []
        while done:
            future = done.pop()
            if future.cancelled():
                self._pool.look()  # which may know why
                raise EnvironmentFailure("its work was cancelled by somebody else", remedy="the same command continues")
            error = future.exception()
            if error is not None and self._pool.is_broken(error):
                broken.append(future)
                continue
            job, brought = self._running.pop(future), None if error else future.result()
            del future
            self._keep(job, brought, error)
        return broken

    def _keep(self, job: Job, brought: list[Outcome] | None, error: BaseException | None) -> None:
        if error is None:
            self._finish(job, brought or [])
        elif isinstance(error, InputError | TracerError):
            self._fail(job, error)
        elif isinstance(error, EnvironmentFailure):
            raise error
        else:
            self._fail(job, EnvironmentFailure(f"{type(error).__name__}: {error}"))

    def _finish(self, job: Job, outcomes: list[Outcome]) -> None:
        if outcomes:
            self._sink.save(outcomes)
            self._progress.add(len(outcomes))
        self._ready.extendleft(reversed(self._waiting.pop(job.name, [])))

    def _fail(self, job: Job, why: RadwrapError) -> None:
        """A job that brings nothing: rows that say so, of those too that would have used what it makes."""
        self._failures[job.name] = why
        start = time.monotonic()
        rows = [failed(run.run, str(why), time.monotonic() - start) for run in job.runs]
        if rows:
            self._sink.save(rows)
            self._progress.add(len(rows))
        followers = self._waiting.pop(job.name, [])
        if job.runs:
            # Only its measurement failed; each other one finds out for itself.
            self._ready.extend(followers)
            return
        for other in followers:
            self._fail(other, why)

    def _after_death(self, broken: Sequence[Future[Any]]) -> None:
        """A worker died, and with it the pool: go on with a new one; nobody knows whose fault it was."""
        # The others of a broken pool come to an end too, some of them with a result; of a cluster, if it has workers.
        while not all(future.done() for future in self._running):
            if not self._finished.within(_LOOK):
                self._pool.look()
        lost = [self._running.pop(future) for future in broken]
        lost += [self._running.pop(future) for future in self._collect(set(self._running))]
        self._pool.rebuild()
        alone = len(lost) == 1
        for job in reversed(lost):
            deaths = self._deaths[job.name] = self._deaths.get(job.name, 0) + 1
            if deaths > _SUSPECT and alone:
                self._fail(job, EnvironmentFailure(f"its worker died {deaths} times"))
            else:
                self._ready.appendleft(job)


def chunks(items: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    """Consecutive parts of at most `size`."""
    for first in range(0, len(items), size):
        yield items[first : first + size]
