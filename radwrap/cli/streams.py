"""Standard streams that a command can rely on: open, of any encoding, and with a voice that never fails."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from contextlib import suppress
from typing import Final

_ESCAPED: Final = "radwrap.escaped"


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
    elif isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors=_ESCAPED)
    else:  # None: closed by who started us
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", errors=_ESCAPED)
    encoding = sys.stderr.encoding if isinstance(sys.stderr, io.TextIOWrapper) else "utf-8"
    sys.stderr = _Voice(os.fdopen(2, "wb", closefd=False), encoding, _ESCAPED, line_buffering=True)


class _Closed(io.TextIOWrapper):
    """A stream for answers that nobody can get."""

    def write(self, _: str, /) -> int:
        raise OSError(errno.EBADF, "is closed", "standard output")


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
