"""The one door to other programs: argv lists, bytes in and out, no shell.

Every program runs in a folder and an environment that the caller names, in a
process group of its own, and is ended with that group when it stalls, when
its caller fails, or when the user interrupts. It has ended when its own process
has: what it leaves running, also in a session of its own, is ended too.
"""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Final

from radwrap.descendants import end_marked, marked, marks_of, new_mark
from radwrap.errors import EnvironmentFailure, TracerError
from radwrap.pipes import PIPE_BYTES, Feeder, Listener, is_readable, widen

_STDERR_BYTES_KEPT = 1 << 16
_TICK = 0.5  # s between looks at the clock while a program is silent
_LOOK = 0.1  # s between looks at what matters beside a program
_GRACE = 1.0  # s for a pipe to end once nobody should hold it any more


@dataclass(frozen=True, slots=True)
class Limits:
    """What a program may use.

    Attributes
    ----------
    silence : float
        Longest time without a byte in or out [s]; then it counts as hung.
    total : float
        Longest time until its output ends [s]; where its answer is waited for as a whole, no longer than `silence`.
    memory : int
        Address space [byte].
    remedy : str
        What helps one that needs longer.
    """

    silence: float = 600.0
    total: float = math.inf
    memory: int = 16 << 30
    remedy: str = "raise `tracer_timeout` if the scene needs longer"


class Programs:
    """The programs that run on behalf of one command; leaving the block ends them all.

    Use as ``with Programs() as programs:``. Several threads may run programs
    through one object; `cancel` ends them from any thread.
    """

    def __init__(self) -> None:
        self._mark = new_mark()
        self._started = 0
        self._running: set[_Program] = set()
        self._guard = threading.Lock()
        self._cancelled = False

    def __enter__(self) -> Programs:
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel()

    def cancel(self) -> None:
        """End every running program and what any of them left behind, and refuse new ones."""
        with self._guard:
            self._cancelled = True
            for program in self._running:
                program.end_group()
            if self._started:
                end_marked(f"{self._mark}.")

    @property
    def cancelled(self) -> bool:
        """Whether the programs were told to end."""
        return self._cancelled

    def check(self) -> None:
        """Go on, unless the programs were told to end.

        Raises
        ------
        TracerError
            If they were.
        """
        if self._cancelled:
            raise TracerError("cancelled", where="programs")

    def _start(
        self, argv: Sequence[str], folder: Path, environment: Mapping[str, str], said: IO[bytes] | None = None
    ) -> _Program:
        # In a thread: an interrupt is raised in the main thread, and must not come between a program's start and
        # its entry into the list of those that are ended.
        with ThreadPoolExecutor(1) as starter:
            return starter.submit(self._enter, argv, folder, environment, said).result()

    def _enter(
        self, argv: Sequence[str], folder: Path, environment: Mapping[str, str], said: IO[bytes] | None
    ) -> _Program:
        quiet = said is not None
        with self._guard:
            if self._cancelled:
                raise TracerError("cancelled", where=Path(argv[0]).name)
            self._started += 1
            mark = f"{self._mark}.{self._started}."
            try:
                process = subprocess.Popen(
                    list(argv),
                    cwd=folder,
                    env={**environment, **marked(mark)},
                    stdin=subprocess.DEVNULL if quiet else subprocess.PIPE,
                    stdout=subprocess.DEVNULL if quiet else subprocess.PIPE,
                    stderr=said if quiet else subprocess.PIPE,
                    bufsize=0,
                    # A group of its own: Ctrl-C in the terminal reaches us alone, and we end the whole group.
                    start_new_session=True,
                )
            except OSError as error:
                raise EnvironmentFailure(f"cannot start: {error.strerror or error}", where=argv[0]) from error
            program = _Program(process, Path(argv[0]).name, mark)
            self._running.add(program)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                widen(pipe)
        return program

    def run(
        self,
        argv: Sequence[str],
        *,
        folder: Path,
        environment: Mapping[str, str],
        stdin: Iterable[bytes | memoryview] = (),
        limits: Limits = Limits(),
    ) -> tuple[bytes, str]:
        """Run a program to its end.

        Returns
        -------
        stdout : bytes
            What it wrote.
        stderr : str
            What it said (the last 64 KiB); the caller must judge it.

        Raises
        ------
        EnvironmentFailure
            If it cannot be started.
        TracerError
            If it fails, hangs or is cancelled.
        """
        said: list[str] = []
        limits = replace(limits, total=min(limits.total, limits.silence))
        answer = self.stream(argv, folder=folder, environment=environment, stdin=stdin, limits=limits, said=said)
        return b"".join(answer), said[0]

    def stream(
        self,
        argv: Sequence[str],
        *,
        folder: Path,
        environment: Mapping[str, str],
        stdin: Iterable[bytes | memoryview],
        said: list[str],
        limits: Limits = Limits(),
    ) -> Generator[bytes]:
        """Run a program and yield its output as it comes.

        `said` receives its stderr once it has ended; the caller must judge it.
        Raises as :meth:`run`.
        """
        program = self._start(argv, folder, environment)
        process = program.process
        assert process.stdin is not None and process.stderr is not None  # noqa: S101  (both are PIPE above)
        feeder = Feeder(process.stdin, stdin, program.end_group)
        listener = Listener(process.stderr)
        try:
            _limit(process, limits)
            feeder.start()
            listener.start()
            yield from _output(program, feeder, limits)
            _wait(program, limits)
            feeder.stop()
            feeder.join()
            program.end_group()
            _hear_out(listener, program)
            if self._cancelled:
                raise TracerError("cancelled", where=program.name)
            if feeder.error is not None:
                raise feeder.error
            program.check(listener.text)
            said.append(listener.text)
        except BaseException:
            end_marked(program.mark)  # before our threads are waited for: it may hold their pipes
            raise
        finally:
            program.end_group()
            process.wait()
            for thread in (feeder, listener):
                thread.stop()
                if thread.ident is not None:
                    thread.join()
            self._forget(program)

    def _forget(self, program: _Program) -> None:
        for pipe in (program.process.stdin, program.process.stdout, program.process.stderr):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        with self._guard:
            self._running.discard(program)

    def attend(
        self,
        argv: Sequence[str],
        *,
        folder: Path,
        environment: Mapping[str, str],
        look: Callable[[], None],
        longest: float,
        remedy: str = "",
    ) -> None:
        """Run a program whose output nobody needs until it ends; what it leaves running is ended.

        Parameters
        ----------
        argv, folder, environment
            As in `run`.
        look : callable
            Asked again and again meanwhile; what it raises ends the program.
        longest : float
            After that it counts as hung [s].
        remedy : str
            What helps one that needs longer.

        Raises
        ------
        EnvironmentFailure
            If it cannot be started.
        TracerError
            If it fails, hangs or is cancelled.
        """
        # A file and no pipe: a pipe would end only with the last process that inherited it.
        with tempfile.TemporaryFile() as said:
            program = self._start(argv, folder, environment, said)
            end = time.monotonic() + longest
            try:
                while not _ended(program.process):
                    look()
                    if time.monotonic() > end:
                        raise TracerError(
                            f"did not end within {longest:g} s and was ended", where=program.name, remedy=remedy
                        )
            finally:
                program.end_group()
                program.process.wait()
                end_marked(program.mark)
                self._forget(program)
            if self._cancelled:
                raise TracerError("cancelled", where=program.name)
            said.seek(max(said.seek(0, os.SEEK_END) - _STDERR_BYTES_KEPT, 0))
            program.check(said.read().decode(errors="replace").strip())


@dataclass(frozen=True, slots=True, eq=False)
class _Program:
    """A program that was started, and the mark by which its descendants are known."""

    process: subprocess.Popen[bytes]
    name: str
    mark: str

    def end_group(self) -> None:
        """End it and everything in its group."""
        _kill(self.process)

    def check(self, said: str) -> None:
        """Whether it ended as it should."""
        code = self.process.returncode
        if code != 0:
            raise TracerError(f"ended with exit code {code}: {said or 'no message'}", where=self.name)


def _output(program: _Program, feeder: Feeder, limits: Limits) -> Iterator[bytes]:
    """What a program writes, until its pipe ends; a pipe that outlives its program is held by somebody else."""
    pipe = program.process.stdout
    assert pipe is not None  # noqa: S101  (stdout=PIPE above)
    last_read = start = time.monotonic()
    ended = False
    while True:
        while not is_readable(pipe, _TICK):
            now = time.monotonic()
            if ended:
                raise TracerError(
                    "ended, but continued in the background with its output open; that was ended too",
                    where=program.name,
                )
            ended = program.process.poll() is not None
            if now - start > limits.total:
                raise _too_long(program, limits)
            if now - max(last_read, feeder.last_progress) > limits.silence:
                raise TracerError(
                    f"was silent for {limits.silence:g} s and was ended", where=program.name, remedy=limits.remedy
                )
        block = pipe.read(PIPE_BYTES)
        if not block:
            return
        yield block
        last_read = time.monotonic()
        if last_read - start > limits.total:
            raise _too_long(program, limits)


def _too_long(program: _Program, limits: Limits) -> TracerError:
    what = f"did not end within {limits.total:g} s and was ended"
    return TracerError(what, where=program.name, remedy=limits.remedy)


def _wait(program: _Program, limits: Limits) -> None:
    try:
        program.process.wait(limits.silence)
    except subprocess.TimeoutExpired as error:
        raise TracerError(
            f"closed its output but did not end within {limits.silence:g} s", where=program.name
        ) from error


def _hear_out(listener: Listener, program: _Program) -> None:
    """Wait for a program's last word, which may be kept open by what it left behind."""
    listener.join(_TICK)
    if listener.is_alive():
        end_marked(program.mark)
        listener.join(_GRACE)
    listener.stop()
    listener.join()


def _ended(program: subprocess.Popen[bytes]) -> bool:
    """Whether it has ended, after a short wait for that."""
    try:
        program.wait(_LOOK)
    except subprocess.TimeoutExpired:
        return False
    return True


def _kill(program: subprocess.Popen[bytes]) -> None:
    """End a program and everything in its group."""
    if sys.platform == "win32":
        program.kill()
        return
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(program.pid, signal.SIGKILL)


def _limit(program: subprocess.Popen[bytes], limits: Limits) -> None:
    """Limit memory and core files from outside; only Linux can."""
    if sys.platform != "linux":
        return
    import resource

    with suppress(ProcessLookupError):
        # The user's own limits may be lower, and may not be raised.
        soft, hard = resource.prlimit(program.pid, resource.RLIMIT_AS)
        least = min(limit for limit in (soft, hard, limits.memory) if limit != resource.RLIM_INFINITY)
        resource.prlimit(program.pid, resource.RLIMIT_AS, (least, least))
        resource.prlimit(program.pid, resource.RLIMIT_CORE, (0, 0))


class Child:
    """A helper program that lives beside this one and talks in lines.

    It has a session of its own, so that Ctrl-C in the terminal is for us alone, and learns that we are gone, however we
    went, by the end of its stdin.
    """

    def __init__(self, program: subprocess.Popen[bytes]) -> None:
        self._program = program
        self._begun = b""  # of a line whose end has not come yet: its writer may be interrupted anywhere

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._program.poll() is not None

    def tell(self, line: str) -> bool:
        """Send it a line; False where it no longer listens."""
        assert self._program.stdin is not None  # noqa: S101  (stdin=PIPE in start_child)
        try:
            # Never waits: a full pipe takes nothing, since a line is shorter than what a pipe takes at once.
            return self._program.stdin.write(f"{line}\n".encode()) is not None
        except (OSError, ValueError):  # it has ended, or we closed the pipe
            return False

    def hear(self, patience: float) -> str | None:
        """Wait for its next line for `patience` seconds; None where none comes."""
        pipe = self._program.stdout
        assert pipe is not None  # noqa: S101  (stdout=PIPE in start_child)
        end = time.monotonic() + patience
        while select.select([pipe], [], [], max(0.0, end - time.monotonic()))[0]:
            byte = pipe.read(1)
            if not byte or byte == b"\n":
                line, self._begun = self._begun, b""
                return line.decode(errors="replace") if byte or line else None
            self._begun += byte
        return None

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._program.pid

    def kill(self) -> None:
        """End it at once, before it hears that we have gone, with all that it has started through `Programs`."""
        if not self.ended:
            _kill(self._program)
        self.close(_GRACE)
        end_marked(marks_of(self._program.pid))

    def close(self, patience: float) -> None:
        """End its stdin, wait for its end for `patience` seconds, then kill it."""
        for pipe in (self._program.stdin, self._program.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        try:
            self._program.wait(patience)
        except subprocess.TimeoutExpired:
            _kill(self._program)
            self._program.wait()


def start_child(
    argv: Sequence[str], *, folder: Path, environment: Mapping[str, str], keep_open: Sequence[int] = ()
) -> Child:
    """Start a helper program whose stderr is ours.

    Parameters
    ----------
    argv : sequence of str
        Program and arguments.
    folder : Path
        Where it works.
    environment : Mapping[str, str]
        All of its environment.
    keep_open : sequence of int
        File descriptors that it shares with us.

    Raises
    ------
    EnvironmentFailure
        If it cannot be started.
    """
    try:
        program = subprocess.Popen(
            list(argv),
            cwd=folder,
            env=dict(environment),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
            pass_fds=tuple(keep_open),
        )
    except OSError as error:
        raise EnvironmentFailure(f"cannot start: {error.strerror or error}", where=argv[0]) from error
    if sys.platform != "win32" and program.stdin is not None:
        os.set_blocking(program.stdin.fileno(), False)
    return Child(program)


MOST_WORKERS: Final = 1024  # at a time; each takes a process and a thread or more


def available_cores() -> int:
    """Number of cores this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def children_cpu_time() -> float:
    """CPU time that ended child processes have used so far [s]."""
    times = os.times()
    return times.children_user + times.children_system
