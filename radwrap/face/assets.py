"""The page's own files, read once: no name in a request ever becomes a path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}
INDEX: Final = "index.html"


@dataclass(frozen=True, slots=True)
class Asset:
    """A file of the page.

    Attributes
    ----------
    content : bytes
        All of it.
    media_type : str
        What it is.
    """

    content: bytes
    media_type: str


def assets() -> dict[str, Asset]:
    """Path of a request -> what it gets; the page itself is at "/"."""
    found = {f"/{name}": asset for name, asset in _below(files("radwrap") / "data" / "face", "")}
    return {"/": found.pop(f"/{INDEX}"), **found}


def _below(folder: Traversable, prefix: str) -> Iterator[tuple[str, Asset]]:
    for entry in sorted(folder.iterdir(), key=lambda one: one.name):
        name = f"{prefix}{entry.name}"
        if entry.is_dir():
            yield from _below(entry, f"{name}/")
            continue
        kind = _TYPES.get(f".{entry.name.rpartition('.')[2]}")
        if kind is not None:
            yield name, Asset(entry.read_bytes(), kind)
