"""``radwrap init DIR --example NAME``: scenes and designs that the documentation speaks of, from the package."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path, PurePosixPath
from typing import Final

from radwrap.errors import InputError
from radwrap.files import write_new
from radwrap.nearest import did_you_mean
from radwrap.reading import parse_toml

_TOML: Final = ".toml"
# Tests hold a scene against the first; the second is README's picture. The wheel has neither.
_LEFT_OUT: Final = ("scene.rad", "gray.png")
# What an example begins with, the first one that it has.
_FIRST: Final = ("design.toml", "dataset.toml", "scene.toml")
# A design of a study names a scene of another example.
_BESIDE: Final = re.compile(r'^scene = "\.\./([^"]+)/[^"/]+"', re.MULTILINE)


def names() -> dict[str, str]:
    """Names of all examples in order, each with its title."""
    return {name: _title(_files_of(folder)) for name, folder in sorted(_folders(_root()))}


def write_example(name: str, folder: Path) -> tuple[list[Path], str]:
    """Write the files of an example into a folder, over none.

    An example that names another one's scene stands beside it: each in a folder of its own name.

    Parameters
    ----------
    name : str
        As `names` has it.
    folder : path
        Is made where it is not there.

    Returns
    -------
    list of Path, str
        The TOML files, what the example begins with first, and the verb for that one.

    Raises
    ------
    InputError
        If there is no such example, or a file is there already.
    """
    found = _asked(name)
    write_new(folder, found)
    written = [path for path in found if path.endswith(_TOML)]
    return [folder / path for path in written], _verb(PurePosixPath(written[0]).name, found[written[0]])


def _verb(name: str, content: bytes) -> str:
    """What a TOML file of an example is for."""
    match name:
        case "design.toml":
            return "study run" if "design" in parse_toml(content.decode(), name) else "design run"
        case "dataset.toml":
            return "dataset run"
        case _:
            return "render"


def _root() -> Traversable:
    return files("radwrap") / "data" / "examples"


def _folders(folder: Traversable, above: str = "") -> Iterator[tuple[str, Traversable]]:
    """Folders with TOML files, by their paths."""
    for entry in folder.iterdir():
        if entry.is_dir():
            name = above + entry.name
            if any(one.name.endswith(_TOML) for one in entry.iterdir()):
                yield name, entry
            yield from _folders(entry, f"{name}/")


def _files_of(folder: Traversable) -> dict[str, bytes]:
    """Name and content of an example's files, what it begins with first."""
    found = {one.name: one.read_bytes() for one in folder.iterdir() if one.is_file() and one.name not in _LEFT_OUT}

    def rank(name: str) -> tuple[bool, int, str]:
        return not name.endswith(_TOML), _FIRST.index(name) if name in _FIRST else len(_FIRST), name

    return {name: found[name] for name in sorted(found, key=rank)}


def _title(content: Mapping[str, bytes]) -> str:
    """Title of what an example begins with; of all its scenes where it begins with none."""
    begins = [name for name in _FIRST if name in content][:1] or [name for name in content if name.endswith(_TOML)]
    return "; ".join(parse_toml(content[name].decode(), name)["title"] for name in begins)


def _asked(name: str) -> dict[str, bytes]:
    folders = dict(_folders(_root()))
    if name not in folders:
        raise InputError(
            f'no example "{name}"',
            where="--example",
            remedy=did_you_mean(name, folders) or "`radwrap init --list` names them all",
        )
    found = _files_of(folders[name])
    beside = sorted({other for content in found.values() for other in _scenes_beside(content)})
    if not beside:
        return found
    found = {f"{name}/{path}": content for path, content in found.items()}
    for other in beside:
        found |= {f"{other}/{path}": content for path, content in _files_of(folders[other]).items()}
    return found


def _scenes_beside(content: bytes) -> list[str]:
    return _BESIDE.findall(content.decode("utf-8", errors="ignore"))
