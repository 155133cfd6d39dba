"""Which files a scene depends on: what was made from it is of no use once one of them is another."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.reading import FileKind, read_bytes

# Longer words name no file on any system.
_LONGEST_NAME: Final = 1024
# Radiance files name others, whatever their own extension, and these others again. These kinds hold numbers alone, and
# so many that looking for names among them would take long.
_NAMELESS: Final = frozenset(
    ".stl .ply .obj .off .glb .gltf .3mf .dat .csv .ies .hdr .pic .exr .png .jpg .jpeg .tif .tiff .npy .oct".split()
)
_LARGEST_TEXT: Final = 64 << 20  # byte; nobody writes a Radiance file of that size for others to include
_NAMED: Final = FileKind("file that a scene names", _LARGEST_TEXT)
_NUMBER: Final = re.compile(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")


def named_files(document: Mapping[str, Any], folder: Path, *, trust: bool = False) -> tuple[Path, ...]:
    """Files that the strings of a scene's tables name, and those that Radiance files among them name in turn.

    A word that happens to be the name of a file counts: one file too many does no harm, one too few would.

    Parameters
    ----------
    document : Mapping
        Tables of a scene, or of anything that holds one.
    folder : Path
        Where the scene lies; names are relative to it.
    trust : bool
        Whether the scene may name files outside of its folder; else these are not so much as opened.

    Returns
    -------
    tuple of Path
        Each once, in the order of their names.

    Raises
    ------
    InputError
        If one of them cannot be read.
    """
    inside = None if trust else folder.resolve()
    found: set[Path] = set()
    due = [path for word in set(_strings(document)) if (path := _file(folder, word, inside))]
    while due:
        path = due.pop()
        if path in found:
            continue
        found.add(path)
        words = _words(path) if path.suffix.lower() not in _NAMELESS else ()
        due += [other for word in words for place in (path.parent, folder) if (other := _file(place, word, inside))]
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


def _words(path: Path) -> set[str]:
    """What may be names in a text; nothing where it is none."""
    if path.stat().st_size > _LARGEST_TEXT:
        return set()
    content = read_bytes(path, _NAMED)
    if b"\0" in content:
        return set()
    words = {word.strip("'\"") for word in content.decode("latin-1").split()}
    return {word for word in words if not _NUMBER.fullmatch(word)}


def _file(folder: Path, word: str, inside: Path | None) -> Path | None:
    """The regular file that a word names, if any; None also where it lies outside of a folder not to be left."""
    if not 0 < len(word) <= _LONGEST_NAME or "\0" in word:
        return None
    try:
        path = (folder / word).resolve()
        if inside is not None and not path.is_relative_to(inside):
            return None
        return path if path.is_file() else None
    except (OSError, RuntimeError, UnicodeError):
        return None
