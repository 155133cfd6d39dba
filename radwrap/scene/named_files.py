"""Which files a scene depends on: what was made from it is of no use once one of them is another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

# Longer words name no file on any system.
_LONGEST_NAME: Final = 1024
# Radiance files name others, and these others again; meshes and pictures are not read for names.
_NAMING: Final = {".rad", ".mat"}


def named_files(document: Mapping[str, Any], folder: Path) -> tuple[Path, ...]:
    """Files that the strings of a scene's tables name, and those that Radiance files among them name in turn.

    A word that happens to be the name of a file counts: one file too many does no harm, one too few would.

    Parameters
    ----------
    document : Mapping
        Tables of a scene, or of anything that holds one.
    folder : Path
        Where the scene lies; names are relative to it.

    Returns
    -------
    tuple of Path
        Each once, in the order of their names.
    """
    found: set[Path] = set()
    due = [path for word in set(_strings(document)) if (path := _file(folder, word))]
    while due:
        path = due.pop()
        if path in found:
            continue
        found.add(path)
        if path.suffix.lower() in _NAMING:
            words = set(path.read_text(encoding="latin-1").split())
            due += [other for word in words for place in (path.parent, folder) if (other := _file(place, word))]
    return tuple(sorted(found))


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _strings(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _strings(item)


def _file(folder: Path, word: str) -> Path | None:
    if not 0 < len(word) <= _LONGEST_NAME or "\0" in word:
        return None
    try:
        path = (folder / word).resolve()
        return path if path.is_file() else None
    except (OSError, RuntimeError, UnicodeError):
        return None
