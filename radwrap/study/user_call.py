"""Calls of a user's function: in a process of its own, with limits, ended with all that it started."""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError, TracerError, one_line
from radwrap.images import GrayImage
from radwrap.process import Limits, Programs
from radwrap.study.user_function import UserFunction, check_unchanged

_CHILD: Final = Path(__file__).with_name("user_process.py")
_LONGEST_TEXT: Final = 300  # of what goes wrong in somebody else's code


@dataclass(frozen=True, slots=True)
class Called:
    """What a function gave for an image.

    Attributes
    ----------
    values : Mapping of str to (float, float)
        Key -> value and its own standard uncertainty.
    faults : Mapping of str to str
        Key -> what is wrong with it.
    fault : str
        What is wrong with all of it; empty where nothing is.
    """

    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    fault: str = ""

    def of(self, key: str) -> tuple[float, float]:
        """Value and standard uncertainty of a key.

        Raises
        ------
        InputError
            If the function gave none.
        """
        if self.fault or key not in self.values:
            raise InputError(self.fault or self.faults.get(key, "is not among what the function gives"))
        return self.values[key]


def call_user_function(
    function: UserFunction,
    home: Path,
    images: Iterable[GrayImage],
    *,
    rounded: bool,
    manifest: Mapping[str, Any],
    truth: Mapping[str, Any],
) -> list[Called]:
    """Call a function on images, one after the other in one process.

    Parameters
    ----------
    function : UserFunction
        Which.
    home : Path
        Folder of the design.
    images : iterable of GrayImage
        The images.
    rounded : bool
        Whether it gets whole numbers, uint8 up to 8 bits, else uint16; if not, float64.
    manifest, truth : Mapping
        What it is told besides.

    Returns
    -------
    list of Called
        In the order of the images; an image during which the process ended, and those behind it, have a fault.

    Raises
    ------
    InputError
        If the code is not what the study was planned with.
    """
    check_unchanged(function, home)
    with tempfile.TemporaryDirectory(prefix="radwrap-user-") as name:
        paths = []
        for number, image in enumerate(images):
            paths.append(str(Path(name) / f"{number}.npy"))
            np.save(paths[-1], image.codes if rounded else image.values)
        asked = {
            "folder": str(home.resolve()),
            "file": function.file,
            "function": function.function,
            "keys": function.keys,
            "known": [file for file, _ in function.sha256],
            "images": paths,
            "manifest": manifest,
            "truth": truth,
        }
        lines, fault = _answers(function, home, json.dumps(asked).encode())
    found = [_called(line) for line in lines[: len(paths)]]
    # One line may stand for all: where the file could not be loaded.
    fault = fault or (found[-1].fault if found else "") or "gave no answer"
    return found + [Called(fault=fault)] * (len(paths) - len(found))


def _answers(function: UserFunction, home: Path, asked: bytes) -> tuple[list[bytes], str]:
    """Lines of the process, and why it ended early."""
    said: list[str] = []
    limits = Limits(
        silence=function.time_limit, total=math.inf, memory=function.memory_limit, remedy="raise `time_limit`"
    )
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    blocks: list[bytes] = []
    fault = ""
    with Programs() as programs:
        try:
            for block in programs.stream(
                [sys.executable, "-P", str(_CHILD)],
                folder=home,
                environment=environment,
                stdin=[asked],
                said=said,
                limits=limits,
            ):
                blocks.append(block)
        except TracerError as error:
            fault = one_line(f"{function.name} {error.what}")[:_LONGEST_TEXT]
    text = b"".join(blocks)
    return text[: text.rfind(b"\n") + 1].splitlines(), fault


def _called(line: bytes) -> Called:
    try:
        told = json.loads(line)
    except ValueError:  # the user's code wrote where answers go
        return Called(fault="gave no answer that can be read")
    if "error" in told:
        return Called(fault=one_line(str(told["error"]))[:_LONGEST_TEXT])
    values = {key: (pair[0], pair[1]) for key, pair in told["values"].items() if isinstance(pair, list)}
    return Called(values, {key: what for key, what in told["values"].items() if isinstance(what, str)})
