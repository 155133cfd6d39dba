"""A command as a process, with its time, its processor time and its memory, ended where it takes too long."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import psutil

_LOOK: Final = 0.1  # s between looks at the memory
_GRACE: Final = 10.0  # s that a process has to end itself


@dataclass(frozen=True, slots=True)
class Measured:
    """What a command took.

    Attributes
    ----------
    ended : bool
        Whether it ended by itself; its code is else None.
    code : int or None
        Exit code.
    wall_s, cpu_s : float
        Time, and processor time of it and all its children [s].
    peak_memory : int
        Largest sum of the resident memory of it and all its children [byte].
    output, errors : str
        Its stdout and stderr.
    """

    ended: bool
    code: int | None
    wall_s: float
    cpu_s: float
    peak_memory: int
    output: str
    errors: str

    @property
    def failure(self) -> str | None:
        """Why there is no result; None where there is one."""
        if not self.ended:
            return f"did not end in {self.wall_s:.0f} s"
        if self.code == 0:
            return None
        last = self.errors.strip().splitlines()
        how = f"ended by signal {-self.code}" if self.code is not None and self.code < 0 else f"exit code {self.code}"
        return f"{how}: {last[-1]}" if last else how


def measured(argv: list[str], limit: float, environment: Mapping[str, str] | None = None) -> Measured:
    """Run a command to its end, or to the limit [s]."""
    before, start = _children_cpu(), time.perf_counter()
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = psutil.Popen(argv, stdin=subprocess.DEVNULL, stdout=output, stderr=errors, env=environment)
        try:
            ended, peak = _watched(process, start + limit)
        finally:
            _end(process)
        wall = time.perf_counter() - start
        texts = []
        for file in (output, errors):
            file.seek(0)
            texts.append(file.read().decode(errors="replace"))
    code = process.returncode if ended else None
    wall = wall if ended else limit
    return Measured(ended, code, wall, _children_cpu() - before, peak, *texts)


def _watched(process: psutil.Popen, until: float) -> tuple[bool, int]:
    """Whether it ended in time, and its largest memory."""
    peak = 0
    while time.perf_counter() < until:
        with suppress(subprocess.TimeoutExpired, psutil.TimeoutExpired):
            process.wait(min(_LOOK, max(0.0, until - time.perf_counter())))
        if process.poll() is not None:
            return True, peak
        total = 0
        with suppress(psutil.Error):
            for one in [process, *process.children(recursive=True)]:
                with suppress(psutil.Error):
                    total += one.memory_info().rss
        peak = max(peak, total)
    return process.poll() is not None, peak


def _end(process: psutil.Popen) -> None:
    """End a process with its children; it may first end them itself."""
    if process.poll() is not None:
        return
    family = [process]
    with suppress(psutil.Error):
        family += process.children(recursive=True)
    process.terminate()
    with suppress(subprocess.TimeoutExpired, psutil.TimeoutExpired):
        process.wait(_GRACE)
    for one in family:
        with suppress(psutil.Error):
            if one.is_running():
                one.kill()
    process.wait()
    psutil.wait_procs(family[1:], timeout=1)


def _children_cpu() -> float:
    """Processor time of the children that have ended, with theirs [s]."""
    times = os.times()
    return times.children_user + times.children_system
