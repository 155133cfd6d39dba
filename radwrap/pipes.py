"""Both ends of a program's pipes: threads that write its input and read its messages, and can be stopped."""

from __future__ import annotations

import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import IO, Final

if sys.platform != "win32":
    import fcntl
    import termios

PIPE_BYTES: Final = 1 << 20
_STDERR_BYTES_KEPT: Final = 1 << 16
_NAP: Final = 4  # ms between looks at a pipe that is more than half full
_TICK: Final = 100  # ms between looks at whether we are to stop


def widen(pipe: IO[bytes]) -> None:
    """Let a pipe hold more than 64 KiB where Linux permits it: fewer changes between the two processes."""
    if sys.platform == "linux":
        with suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)


def is_readable(pipe: IO[bytes], patience: float) -> bool:
    """Whether a pipe has something to read, or its end, within so many seconds; select() knows none on Windows."""
    return sys.platform == "win32" or bool(select.select([pipe], [], [], patience)[0])


class Feeder(threading.Thread):
    """Writes the input, so that a program with full pipes cannot block us.

    Parameters
    ----------
    pipe : IO[bytes]
        The program's stdin; it is closed at the end.
    chunks : iterable of bytes or memoryview
        What is written.
    give_up : callable
        Called where the chunks fail, to end the program.
    """

    def __init__(self, pipe: IO[bytes], chunks: Iterable[bytes | memoryview], give_up: Callable[[], None]) -> None:
        super().__init__(daemon=True)
        self._pipe = pipe
        self._chunks = chunks
        self._give_up = give_up
        self._stopped = False
        self.last_progress = time.monotonic()
        self.error: BaseException | None = None

    def stop(self) -> None:
        """Write no more."""
        self._stopped = True

    def run(self) -> None:
        """Write everything."""
        try:
            if sys.platform != "win32":
                os.set_blocking(self._pipe.fileno(), False)
            for chunk in self._chunks:
                view = memoryview(chunk).cast("B")
                while view and not self._stopped:
                    self._wait_for_room()
                    written = self._pipe.write(view[: PIPE_BYTES // 2])
                    if written:
                        view = view[written:]
                        self.last_progress = time.monotonic()
                if self._stopped:
                    break
        except (BrokenPipeError, ConnectionResetError):
            pass  # the program ended early; its exit code and output tell
        except BaseException as error:  # noqa: BLE001  (raised again in the caller's thread)
            self.error = error
            self._give_up()
        finally:
            with suppress(OSError):
                self._pipe.close()

    def _wait_for_room(self) -> None:
        """Wait until half of the pipe is free: each 4 KiB that are read from a full one would wake us."""
        if sys.platform == "win32":
            return
        self._wait_for_half()
        writer = select.poll()
        writer.register(self._pipe, select.POLLOUT)
        while not self._stopped and not writer.poll(_TICK):
            pass

    def _wait_for_half(self) -> None:
        if sys.platform != "linux":
            return
        with suppress(OSError):  # who cannot ask writes on
            if fcntl.fcntl(self._pipe, fcntl.F_GETPIPE_SZ) < PIPE_BYTES:
                return
            reader = select.poll()
            reader.register(self._pipe, 0)  # of its end alone
            before = 0
            while (held := _held(self._pipe)) > PIPE_BYTES // 2 and not self._stopped and not reader.poll(_NAP):
                if held != before:
                    self.last_progress = time.monotonic()
                before = held


class Listener(threading.Thread):
    """Reads stderr to its end and keeps the last part."""

    def __init__(self, pipe: IO[bytes]) -> None:
        super().__init__(daemon=True)
        self._pipe = pipe
        self._stopped = False
        self.text = ""

    def stop(self) -> None:
        """Read no more."""
        self._stopped = True

    def run(self) -> None:
        """Read everything."""
        kept = b""
        # An interrupt may close the pipe while it is read.
        with suppress(OSError, ValueError):
            while not self._stopped:
                if is_readable(self._pipe, _TICK / 1000):
                    block = self._pipe.read(4096)
                    if not block:
                        break
                    kept = (kept + block)[-_STDERR_BYTES_KEPT:]
        self.text = kept.decode(errors="replace").strip()


def _held(pipe: IO[bytes]) -> int:
    """Bytes that are in a pipe."""
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)
