"""Tutorials whose code runs as it stands: read, run, and shown with what came out.

A tutorial is MyST text. Of its fenced blocks

* ``python`` is run, block after block in one namespace, and what it prints is shown below it;
* ``console`` holds commands after ``$``, which are run, and what they print is shown below each;
* a ``{code-block}`` with a caption is a file that the reader saves under that name.

``{value}`expression` `` in the text is replaced by the value, and lines ``% assert ...`` are checked where they stand;
a reader sees no line that begins with ``%``. All runs in one folder, which is empty at first;
pictures of the text lie there.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

Kind = Literal["text", "python", "console", "file", "check"]

_FENCE: Final = re.compile(r"^```(\S+)(?: +(\S.*))?$")
_CAPTION: Final = re.compile(r"^:caption: *(\S+)$")
_VALUE: Final = re.compile(r"\{value\}`([^`]+)`")
_PICTURE: Final = re.compile(r"!\[([^\]]*)\]\(([\w.-]+\.png)\)")
_CHECK: Final = "% "
_PROMPT: Final = "$ "
_MINUTES: Final = 600  # s that a command may take: it hangs


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a tutorial.

    Attributes
    ----------
    kind : {"text", "python", "console", "file", "check"}
        What it is.
    text : str
        As it stands; without the fence. Of a run lesson with its values filled in.
    line : int
        Where it begins, from 1 on.
    name : str
        Of a file; its language before a colon.
    output : str
        What it printed, of a run lesson.
    """

    kind: Kind
    text: str
    line: int
    name: str = ""
    output: str = ""


class LessonFailed(Exception):
    """A part of a tutorial does not do what it says."""


def parts(text: str) -> Iterator[Part]:
    """The parts of a tutorial, in order."""
    lines, start = text.splitlines(), 0
    place = 0
    while place < len(lines):
        fence = _FENCE.match(lines[place])
        check = lines[place].startswith(_CHECK)
        if fence is None and not check:
            place += 1
            continue
        if place > start:
            yield Part("text", "\n".join(lines[start:place]), start + 1)
        if fence is None:
            yield Part("check", lines[place].removeprefix(_CHECK), place + 1)
            place += 1
        else:
            end = lines.index("```", place)
            yield _block(fence, lines[place : end + 1], place + 1)
            place = end + 1
        start = place
    if start < len(lines):
        yield Part("text", "\n".join(lines[start:]), start + 1)


def _block(fence: re.Match[str], lines: list[str], line: int) -> Part:
    inside = lines[1:-1]
    caption = _CAPTION.match(inside[0]) if inside else None
    if fence[1] == "{code-block}" and caption:
        return Part("file", "\n".join(inside[1:]).strip("\n"), line, f"{fence[2]}:{caption[1]}")
    if fence[1] in ("python", "console"):
        return Part("python" if fence[1] == "python" else "console", "\n".join(inside), line)
    return Part("text", "\n".join(lines), line)


def run(text: str, folder: Path, name: str) -> list[Part]:
    """Run a tutorial in an empty folder; its parts with what they printed and the values filled in.

    Parameters
    ----------
    text : str
        The tutorial.
    folder : path
        Where it runs.
    name : str
        Of the tutorial, for messages.

    Raises
    ------
    LessonFailed
        If code raises, a command fails or a check does not hold; with file and line.
    """
    space: dict[str, Any] = {"__name__": "__main__"}
    done = []
    for part in parts(text):
        try:
            done.append(_done(part, space, folder))
        except Exception as error:  # whatever is wrong with a tutorial is located
            raise LessonFailed(f"{name}:{part.line}: {type(error).__name__}: {error}") from error
    return done


def _done(part: Part, space: dict[str, Any], folder: Path) -> Part:
    # To run the text is what a tutorial is for: it is our own, from the repository.
    match part.kind:
        case "text":
            return replace(part, text=_VALUE.sub(lambda found: str(eval(found[1], space)), part.text))  # noqa: S307
        case "file":
            (folder / part.name.split(":")[1]).write_text(part.text + "\n")
            return part
        case "console":
            return replace(part, output="\n".join(_asked(part.text, folder)))
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        exec(compile(part.text, f"line {part.line}", "exec"), space)  # noqa: S102
    return replace(part, output=printed.getvalue().rstrip("\n"))


def _asked(text: str, folder: Path) -> Iterator[str]:
    """Each command and what it prints, but for its progress."""
    for command in text.splitlines():
        words = shlex.split(command.removeprefix(_PROMPT))
        if words[0] != "radwrap":
            raise LessonFailed(f"{words[0]} is not a command of ours")
        argv = [sys.executable, "-m", *words]
        done = subprocess.run(argv, cwd=folder, capture_output=True, text=True, timeout=_MINUTES, check=False)
        if done.returncode != 0:
            raise LessonFailed(f"{command}: exit code {done.returncode}: {done.stderr}")
        said = [line for line in done.stderr.splitlines() if line.startswith("radwrap: ")]
        yield "\n".join([command, *done.stdout.splitlines(), *said])


def page(done: list[Part], pictures: str, notebook: str) -> str:
    """MyST text of a run tutorial.

    Parameters
    ----------
    done : list of Part
        As `run` returns them.
    pictures : str
        Path of the folder that holds its pictures, as the page names it.
    notebook : str
        Path of the notebook, as the page names it.
    """
    found = []
    for part in done:
        match part.kind:
            case "text":
                found.append(_PICTURE.sub(lambda one: f"![{one[1]}]({pictures}/{one[2]})", part.text))
            case "python":
                found.append(_fenced("python", part.text))
                if part.output:
                    found.append(_fenced("{code-block} text", part.output, ":class: output"))
            case "console":
                found.append(_fenced("console", part.output))
            case "file":
                language, caption = part.name.split(":")
                found.append(_fenced(f"{{code-block}} {language}", part.text, f":caption: {caption}"))
    title, _, rest = "\n\n".join(found).partition("\n")
    return f"{title}\n\n{{download}}`This page as a notebook <{notebook}>`\n{rest}\n"


def _fenced(language: str, text: str, *options: str) -> str:
    return "\n".join([f"```{language}", *options, text, "```"])


def as_notebook(done: list[Part]) -> str:
    """The tutorial as a Jupyter notebook (nbformat 4.5), without what its cells print."""
    cells: list[Mapping[str, Any]] = []
    for number, part in enumerate(part for part in done if part.kind != "check" and part.text.strip()):
        source = {
            "python": part.text,
            "file": f"%%writefile {part.name.split(':')[-1]}\n{part.text}",
            "console": "\n".join("!" + line.removeprefix(_PROMPT) for line in part.text.splitlines()),
        }.get(part.kind)
        cell = {"id": f"part-{number}", "metadata": {}, "source": part.text if source is None else source}
        more = (
            {"cell_type": "markdown"}
            if source is None
            else {"cell_type": "code", "execution_count": None, "outputs": []}
        )
        cells.append({**cell, **more})
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return json.dumps({"nbformat": 4, "nbformat_minor": 5, "metadata": kernel, "cells": cells}, indent=1) + "\n"
