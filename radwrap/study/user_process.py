"""A user's function in a process of its own: reads what to call it on from stdin, writes a line of JSON for each image.

It is run as a file and imports nothing of radwrap: what the user's code does to this process ends with it.
"""

from __future__ import annotations

import copy
import importlib.util
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np


def main() -> None:
    """Call the function on each image."""
    # What the user's code prints is no answer; it goes where errors go.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    asked = json.load(sys.stdin)
    try:
        function = _loaded(Path(asked["folder"]), asked["file"], asked["function"])
    except BaseException as error:  # noqa: BLE001  (somebody else's code is read here, and may raise anything)
        _say(answers, {"error": f"cannot be loaded: {_told(error)}"})
        return
    known = {asked["file"], *asked["known"]}
    for path in asked["images"]:
        try:
            gray = np.load(path)
            gray.flags.writeable = False
            found = function(gray, copy.deepcopy(asked["manifest"]), copy.deepcopy(asked["truth"]))
            _say(answers, _checked(found, asked["keys"], _strangers(Path(asked["folder"]), known)))
        except BaseException as error:  # noqa: BLE001  (likewise)
            _say(answers, {"error": _told(error)})


def _say(answers: IO[str], line: dict[str, Any]) -> None:
    print(json.dumps(line), file=answers, flush=True)


def _told(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def _loaded(folder: Path, file: str, name: str) -> Callable[..., Any]:
    sys.path.insert(0, str((folder / file).parent))
    sys.path.insert(1, str(folder))
    spec = importlib.util.spec_from_file_location(Path(file).stem, folder / file)
    assert spec is not None and spec.loader is not None  # noqa: S101  (a .py file has both)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    function: Callable[..., Any] = getattr(module, name)
    return function


def _strangers(folder: Path, known: set[str]) -> str:
    """A module of the design's folder that was imported and is not known; empty where there is none."""
    root = folder.resolve()
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if not file or not Path(file).resolve().is_relative_to(root) or Path(file).resolve() == Path(__file__):
            continue
        place = Path(file).resolve().relative_to(root)
        # An environment may lie in the folder; what was installed there is known by the study's versions.
        if place.as_posix() not in known and "site-packages" not in place.parts:
            return place.as_posix()
    return ""


def _checked(found: Any, keys: list[str], stranger: str) -> dict[str, Any]:
    if stranger:
        return {"error": f"imports {stranger} in a way that is not seen beforehand: write a plain import statement"}
    if not isinstance(found, dict):
        return {"error": f"gives a {type(found).__name__}, not a dict"}
    others = sorted(set(map(str, found)) - set(keys))
    if others:
        return {"error": f'gives "{others[0]}", which is not among its keys'}
    return {"values": {key: _value(found[key]) for key in keys if key in found}}


def _value(given: Any) -> list[float] | str:
    """Value and standard uncertainty, or what is wrong with them."""
    pair = given if isinstance(given, tuple) else (given, 0.0)
    try:
        if len(pair) != 2 or any(isinstance(number, bool | str) for number in pair):
            raise TypeError
        value, sigma = (float(number) for number in pair)
    except (TypeError, ValueError):
        return f"is {type(given).__name__}, neither a number nor (number, sigma)"
    if not (np.isfinite(value) and np.isfinite(sigma)):
        return "is not finite"
    return [value, sigma] if sigma >= 0 else "has a negative sigma"


if __name__ == "__main__":
    main()
