"""The one door to other programs: argv lists, bytes in and out, no shell.

Every program runs in a folder and an environment that the caller names, in a
process group of its own, and is killed with that group when it stalls, when
its caller fails, or when the user interrupts.
"""

from __future__ import annotations

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
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from radwrap.errors import EnvironmentFailure, TracerError

if sys.platform != "win32":
    import fcntl
    import termios

_PIPE_BYTES = 1 << 20
_STDERR_BYTES_KEPT = 1 << 16
_TICK = 0.5  # s between looks at the clock while a program is silent
_NAP = 4  # ms between looks at a pipe that is more than half full
_LOOK = 0.1  # s between looks at what matters beside a program


@dataclass(frozen=True, slots=True)
class Limits:
    """What a program may use.

    Attributes
    ----------
    silence : float
        Longest time without a byte in or out [s]; then it counts as hung.
    memory : int
        Address space [byte].
    """

    silence: float = 600.0
    memory: int = 16 << 30


class Programs:
    """The programs that run on behalf of one command; leaving the block ends them all.

    Use as ``with Programs() as programs:``. Several threads may run programs
    through one object; `cancel` ends them from any thread.
    """

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._guard = threading.Lock()
        self._cancelled = False

    def __enter__(self) -> Programs:
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel()

    def cancel(self) -> None:
        """End every running program, and refuse new ones."""
        with self._guard:
            self._cancelled = True
            for program in self._running:
                _kill(program)

    @property
    def cancelled(self) -> bool:
        """Whether the programs were told to end."""
        return self._cancelled

    def _start(
        self, argv: Sequence[str], folder: Path, environment: Mapping[str, str], said: IO[bytes] | None = None
    ) -> subprocess.Popen[bytes]:
        # In a thread: an interrupt is raised in the main thread, and must not come between a program's start and
        # its entry into the list of those that are ended.
        with ThreadPoolExecutor(1) as starter:
            return starter.submit(self._enter, argv, folder, environment, said).result()

    def _enter(
        self, argv: Sequence[str], folder: Path, environment: Mapping[str, str], said: IO[bytes] | None
    ) -> subprocess.Popen[bytes]:
        quiet = said is not None
        with self._guard:
            if self._cancelled:
                raise TracerError("cancelled", where=Path(argv[0]).name)
            try:
                program = subprocess.Popen(
                    list(argv),
                    cwd=folder,
                    env=dict(environment),
                    stdin=subprocess.DEVNULL if quiet else subprocess.PIPE,
                    stdout=subprocess.DEVNULL if quiet else subprocess.PIPE,
                    stderr=said if quiet else subprocess.PIPE,
                    bufsize=0,
                    # A group of its own: Ctrl-C in the terminal reaches us alone, and we end the whole group.
                    start_new_session=True,
                )
            except OSError as error:
                raise EnvironmentFailure(f"cannot start: {error.strerror or error}", where=argv[0]) from error
            self._running.add(program)
        _widen_pipes(program)
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
        output = b"".join(
            self.stream(argv, folder=folder, environment=environment, stdin=stdin, limits=limits, said=said)
        )
        return output, said[0]

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
        name = Path(argv[0]).name
        feeder = _Feeder(program, stdin)
        listener = _Listener(program)
        try:
            _limit(program, limits)
            feeder.start()
            listener.start()
            yield from _output(program, feeder, limits.silence, name)
            _wait(program, limits.silence, name)
            feeder.join()
            listener.join()
            if self._cancelled:
                raise TracerError("cancelled", where=name)
            if feeder.error is not None:
                raise feeder.error
            if program.returncode != 0:
                raise TracerError(
                    f"ended with exit code {program.returncode}: {listener.text or 'no message'}", where=name
                )
            said.append(listener.text)
        finally:
            _kill(program)
            program.wait()
            feeder.stop()
            for thread in (feeder, listener):
                if thread.ident is not None:
                    thread.join()
            for pipe in (program.stdin, program.stdout, program.stderr):
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
        longest: float = 600.0,
    ) -> None:
        """Run a program whose output nobody needs until it ends, whatever it leaves running behind it.

        Parameters
        ----------
        argv, folder, environment
            As in `run`.
        look : callable
            Asked again and again meanwhile; what it raises ends the program.
        longest : float
            After that it counts as hung [s].

        Raises
        ------
        EnvironmentFailure
            If it cannot be started.
        TracerError
            If it fails, hangs or is cancelled.
        """
        name = Path(argv[0]).name
        # A file and no pipe: a pipe would end only with the last process that inherited it.
        with tempfile.TemporaryFile() as said:
            program = self._start(argv, folder, environment, said)
            end = time.monotonic() + longest
            try:
                while not _ended(program):
                    look()
                    if time.monotonic() > end:
                        raise TracerError(f"did not end within {longest:g} s and was ended", where=name)
            finally:
                _kill(program)
                program.wait()
                with self._guard:
                    self._running.discard(program)
            if self._cancelled:
                raise TracerError("cancelled", where=name)
            if program.returncode != 0:
                said.seek(max(said.seek(0, os.SEEK_END) - _STDERR_BYTES_KEPT, 0))
                told = said.read().decode(errors="replace").strip()
                raise TracerError(f"ended with exit code {program.returncode}: {told or 'no message'}", where=name)


class _Feeder(threading.Thread):
    """Writes the input, so that a program with full pipes cannot block us."""

    def __init__(self, program: subprocess.Popen[bytes], chunks: Iterable[bytes | memoryview]) -> None:
        super().__init__(daemon=True)
        self._program = program
        self._chunks = chunks
        self._stopped = False
        self.last_progress = time.monotonic()
        self.error: BaseException | None = None

    def stop(self) -> None:
        self._stopped = True

    def run(self) -> None:
        pipe = self._program.stdin
        assert pipe is not None  # noqa: S101  (stdin=PIPE above)
        try:
            for chunk in self._chunks:
                view = memoryview(chunk).cast("B")
                while view and not self._stopped:
                    self._wait_for_room(pipe)
                    written = pipe.write(view[: _PIPE_BYTES // 2])
                    view = view[written:]
                    self.last_progress = time.monotonic()
                if self._stopped:
                    break
        except (BrokenPipeError, ConnectionResetError):
            pass  # the program ended early; its exit code and output tell
        except BaseException as error:  # noqa: BLE001  (raised again in the caller's thread)
            self.error = error
            _kill(self._program)
        finally:
            with suppress(OSError):
                pipe.close()

    def _wait_for_room(self, pipe: IO[bytes]) -> None:
        """Wait until half of the pipe is free: each 4 KiB that are read from a full one would wake us."""
        if sys.platform != "linux":
            return
        with suppress(OSError):  # who cannot ask writes on
            if fcntl.fcntl(pipe, fcntl.F_GETPIPE_SZ) < _PIPE_BYTES:
                return
            reader = select.poll()
            reader.register(pipe, 0)  # of its end alone
            before = 0
            while (held := _held(pipe)) > _PIPE_BYTES // 2 and not self._stopped and not reader.poll(_NAP):
                if held != before:
                    self.last_progress = time.monotonic()
                before = held


class _Listener(threading.Thread):
    """Reads stderr to its end and keeps the last part."""

    def __init__(self, program: subprocess.Popen[bytes]) -> None:
        super().__init__(daemon=True)
        self._pipe = program.stderr
        self.text = ""

    def run(self) -> None:
        kept = b""
        assert self._pipe is not None  # noqa: S101  (stderr=PIPE above)
        # An interrupt may close the pipe while it is read.
        with suppress(OSError, ValueError):
            while block := self._pipe.read(4096):
                kept = (kept + block)[-_STDERR_BYTES_KEPT:]
        self.text = kept.decode(errors="replace").strip()


def _output(program: subprocess.Popen[bytes], feeder: _Feeder, silence: float, name: str) -> Iterator[bytes]:
    pipe = program.stdout
    assert pipe is not None  # noqa: S101  (stdout=PIPE above)
    last_read = time.monotonic()
    while True:
        if sys.platform != "win32":  # select() knows no pipes there; Windows goes without the hang watch
            while not select.select([pipe], [], [], _TICK)[0]:
                if time.monotonic() - max(last_read, feeder.last_progress) > silence:
                    raise TracerError(
                        f"was silent for {silence:g} s and was ended",
                        where=name,
                        remedy="raise --tracer-timeout if the scene needs longer",
                    )
        block = pipe.read(_PIPE_BYTES)
        if not block:
            return
        yield block
        last_read = time.monotonic()


def _wait(program: subprocess.Popen[bytes], silence: float, name: str) -> None:
    try:
        program.wait(silence)
    except subprocess.TimeoutExpired as error:
        raise TracerError(f"closed its output but did not end within {silence:g} s", where=name) from error


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


def _widen_pipes(program: subprocess.Popen[bytes]) -> None:
    """Let the pipes hold more than 64 KiB where Linux permits it: fewer changes between the two processes."""
    if sys.platform != "linux":
        return
    for pipe in (program.stdin, program.stdout):
        if pipe is not None:
            with suppress(OSError):
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)


def _held(pipe: IO[bytes]) -> int:
    """Bytes that are in a pipe."""
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


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

    It has a session of its own, so that Ctrl-C in the terminal is for us
    alone, and learns that we are gone, however we went, by the end of its
    stdin.
    """

    def __init__(self, program: subprocess.Popen[bytes]) -> None:
        self._program = program

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
        end, line = time.monotonic() + patience, b""
        while select.select([pipe], [], [], max(0.0, end - time.monotonic()))[0]:
            byte = pipe.read(1)
            if not byte or byte == b"\n":
                return line.decode(errors="replace") if byte or line else None
            line += byte
        return None

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


def available_cores() -> int:
    """Number of cores this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def children_cpu_time() -> float:
    """CPU time that ended child processes have used so far [s]."""
    times = os.times()
    return times.children_user + times.children_system
