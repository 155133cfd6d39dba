"""Standard streams that a command can rely on: open, of any encoding, and with a voice that never fails."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

_ESCAPED: Final = "radwrap.escaped"
_STDOUT: Final = "standard output"


def prepare_streams() -> None:
    r"""Make the process's standard streams fit for every answer and message.

    /dev/null takes the place of a closed one, so that no other file gets its number
    and no program inherits that; an answer to it is an error all the same. Characters that an encoding lacks become
    \uXXXX, which JSON reads back. What stderr does not take is lost.
    """
    closed = set()
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:  # the lowest free number is taken: this one
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            closed.add(descriptor)
    codecs.register_error(_ESCAPED, _escaped)
    if 1 in closed:
        sys.stdout = _Closed(os.fdopen(1, "wb", closefd=False), "utf-8", _ESCAPED)
    else:
        encoding = (
            sys.stdout.encoding if isinstance(sys.stdout, io.TextIOWrapper) else "utf-8"
        )  # None: closed before us
        sys.stdout = _Answers(os.fdopen(1, "wb", closefd=False), encoding, _ESCAPED, line_buffering=os.isatty(1))
    encoding = sys.stderr.encoding if isinstance(sys.stderr, io.TextIOWrapper) else "utf-8"
    sys.stderr = _Voice(os.fdopen(2, "wb", closefd=False), encoding, _ESCAPED, line_buffering=True)


class _Answers(io.TextIOWrapper):
    """A stream for answers, whose errors name it as those of a file do."""

    def write(self, text: str, /) -> int:
        with _named():
            return super().write(text)

    def flush(self) -> None:
        with _named():
            super().flush()


@contextmanager
def _named() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        error.filename = error.filename or _STDOUT
        raise


class _Closed(io.TextIOWrapper):
    """A stream for answers that nobody can get."""

    def write(self, _: str, /) -> int:
        raise OSError(errno.EBADF, "is closed", _STDOUT)


class _Voice(io.TextIOWrapper):
    """A stream for messages: where nobody can be told, the work goes on and the exit code is right."""

    def write(self, text: str, /) -> int:
        with suppress(OSError):
            return super().write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


def _escaped(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")
    pairs = (units[k : k + 2].hex() for k in range(0, len(units), 2))
    return "".join(f"\\u{unit}" for unit in pairs), error.end
