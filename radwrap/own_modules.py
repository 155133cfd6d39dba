"""Our own modules as programs beside this one."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from radwrap.errors import TracerError
from radwrap.process import Child, Limits, Programs, start_child


def start_module(name: str, *arguments: str, keep_open: Sequence[int] = ()) -> Child:
    """Start one of our modules as a helper program; arguments and errors as `start_child`."""
    return start_child(
        _argv(name, arguments), folder=Path(tempfile.gettempdir()), environment=os.environ, keep_open=keep_open
    )


def run_module(
    programs: Programs,
    name: str,
    *arguments: str,
    stdin: bytes | memoryview,
    limits: Limits,
    environment: Mapping[str, str],
    most: int,
) -> bytes:
    """Run one of our modules to its end.

    Parameters
    ----------
    programs : Programs
        Among which it runs.
    name : str
        Of the module.
    *arguments
        Of its command line.
    stdin : bytes
        What it reads.
    limits : Limits
        What it may use.
    environment : Mapping[str, str]
        All of its environment.
    most : int
        So many bytes it may write.

    Returns
    -------
    bytes
        What it wrote.

    Raises
    ------
    EnvironmentFailure, TracerError
        As `Programs.run`; the second also if it writes more.
    """
    folder, said = Path(tempfile.gettempdir()), list[str]()
    found = bytearray()
    answer = programs.stream(
        _argv(name, arguments), folder=folder, environment=environment, stdin=(stdin,), said=said, limits=limits
    )
    for block in answer:
        found += block
        if len(found) > most:
            raise TracerError(f"wrote more than {most} bytes", where=name)
    return bytes(found)


def _argv(name: str, arguments: Sequence[str]) -> list[str]:
    # -P: no module of the folder it happens to work in.
    return [sys.executable, "-P", "-m", name, *arguments]
