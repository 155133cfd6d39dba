"""What a program left behind: descendants that went into the background, into sessions of their own.

A descendant inherits its ancestor's environment, whatever its session, group
or parent is. A word there, unlike any other, tells whose it is.
"""

from __future__ import annotations

import os
import secrets
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

_VARIABLE: Final = "RADWRAP_STARTED_BY"
_ROUNDS: Final = 5  # between two looks a process may have started another


def new_mark() -> str:
    """A mark that no other process has."""
    return f"{marks_of(os.getpid())}{secrets.token_hex(8)}"


def marks_of(process: int) -> str:
    """What all marks begin with that a process makes."""
    return f"{process}-"


def marked(mark: str) -> dict[str, str]:
    """What the environment of a program needs so that its descendants are known by the mark."""
    return {_VARIABLE: mark}


def end_marked(mark: str) -> None:
    """Kill each process whose mark begins with this one; only Linux can, and none that wiped its environment."""
    if sys.platform != "linux":
        return
    for _ in range(_ROUNDS):
        found = list(_marked(mark))
        for process in found:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        if not found:
            return


def _marked(mark: str) -> Iterator[int]:
    word = f"\0{_VARIABLE}={mark}".encode()
    for place in Path("/proc").iterdir():
        if place.name.isdecimal():
            # Others' processes cannot be read, and one that has ended has no environment.
            with suppress(OSError):
                if word in b"\0" + (place / "environ").read_bytes():
                    yield int(place.name)
