"""One component of the catalog: keys as a scene has them, and where each of them comes from."""

from __future__ import annotations

import datetime
import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from radwrap.errors import InputError
from radwrap.reading import FileKind, check_tree, parse_toml, read_bytes, text_of

FORMAT: Final = 1
CATALOG: Final = "catalog"
# Folder of each class -> its name in words.
CLASSES: Final[Mapping[str, str]] = {
    "sensors": "sensor",
    "lenses": "lens",
    "leds": "LED",
    "lights": "light",
    "filters": "filter",
    "lamps": "lamp",
    "materials": "material",
    "sheetings": "sheeting",
}
Basis = Literal["measured", "derived", "assumed"]
BASES: Final = ("measured", "derived", "assumed")
# What a scene says of a kind is no number of a data sheet.
UNSOURCED: Final = ("type", "model")
_NAME: Final = re.compile(r"[a-z0-9](?:[a-z0-9_-]|\.(?!\.))*")
_DATE: Final = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}")
_LONGEST: Final = 100
_FILE: Final = FileKind("component of the catalog", 1 << 20)
_KNOWN: Final = frozenset(
    (
        *("format", "kind", "name", "revision", "from", "sources", "published", "note", "mount", "distance"),
        *("finish", "wavelength", "spread", "conversion"),
    )
)


@dataclass(frozen=True, slots=True)
class Entry:
    """Where a key's value comes from.

    Attributes
    ----------
    basis : str
        "measured", "derived" or "assumed".
    source : str
        Name of one of the file's sources; "" where it has none.
    where, note : str
        Place in the source; why the value was taken.
    range : tuple, optional
        Least and largest value that an assumed key may have, as a scene writes it.
    range_factor : tuple of float, optional
        The same as factors on the value.
    at : str
        Wavelength at which a table was measured; at others its values are assumed.
    """

    basis: Basis
    source: str = ""
    where: str = ""
    note: str = ""
    range: tuple[Any, Any] | None = None
    range_factor: tuple[float, float] | None = None
    at: str = ""


@dataclass(frozen=True, slots=True)
class Component:
    """A file of the catalog.

    Attributes
    ----------
    kind : str
        Its class, as the folder is called: "sensors".
    name : str
        As a scene names it.
    place : str
        Which of the places it lies in: "scene", "RADWRAP_CATALOG", "user" or "package".
    revision : str
        Date of the file, YYYY-MM-DD.
    sha256 : str
        Of the file.
    values : Mapping
        Keys as a scene has them.
    entries : Mapping[str, Entry]
        Key -> where its value comes from; of tables inside by a path with dots.
    catalog : Mapping
        The whole table [catalog].
    path : Path
        The file.
    """

    kind: str
    name: str
    place: str
    revision: str
    sha256: str
    values: Mapping[str, Any]
    entries: Mapping[str, Entry]
    catalog: Mapping[str, Any] = field(repr=False)
    path: Path = field(compare=False)

    @property
    def title(self) -> str:
        """What it is, in words."""
        return str(self.catalog.get("name", self.name))


def checked_name(name: object, where: str) -> str:
    """A component's name, which may have a revision: NAME or NAME@YYYY-MM-DD.

    Raises
    ------
    InputError
        If it is not made of a-z, 0-9, "." "_" "-", as file names are on all systems.
    """
    text = name if isinstance(name, str) else ""
    bare, at, date = text.partition("@")
    if len(text) > _LONGEST or not _NAME.fullmatch(bare) or (at and not _DATE.fullmatch(date)):
        raise InputError(
            f"{name!r} is not a name of the catalog",
            where=where,
            remedy="a name has a-z, 0-9, . _ -, and may end in @ and the date of a revision",
        )
    return text


def read_component(path: Path, folder: Path, kind: str, place: str, where: str) -> Component:
    """Read a file of the catalog.

    Parameters
    ----------
    path, folder : Path
        The file, and the folder that it must not lead out of by a link.
    kind : str
        Class that it is to be of; "" where the file says it.
    place : str
        As `Component.place`.
    where : str
        Place for messages.

    Raises
    ------
    InputError
        If it is no file of the catalog.
    """
    return component_of(content_of(path, folder, where), path, kind, place, where)


def content_of(path: Path, folder: Path, where: str) -> bytes:
    """Content of a file of the catalog; arguments and errors as `read_component`."""
    try:
        real = path.resolve()
        inside = real.is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:
        raise InputError(f'"{path.name}" cannot be read', where=where) from error
    if not inside:
        raise InputError(f'"{path.name}" is a link out of its folder', where=where, remedy="copy the file there")
    return read_bytes(real, _FILE, where, follow=False)


def component_of(content: bytes, path: Path, kind: str, place: str, where: str) -> Component:
    """The component that a file's bytes are; arguments and errors as `read_component`."""
    tables = parse_toml(text_of(content, _FILE, where), where)
    check_tree(tables, where, finite=True)
    catalog = tables.pop(CATALOG, None)
    if not isinstance(catalog, dict) or catalog.get("format") != FORMAT:
        raise InputError(f"has no table [catalog] of format {FORMAT}", where=where, remedy="see docs/catalog.md")
    told = catalog.get("kind", kind)
    if told not in CLASSES or (kind and told != kind):
        known = f'"{kind}", as its folder says' if kind else ", ".join(CLASSES)
        raise InputError(f"is {told!r}, and must be {known}", where=f"{where}: catalog.kind")
    for key in catalog:
        if key not in _KNOWN:
            raise InputError("unknown key", where=f"{where}: catalog.{key}", remedy=f"known: {', '.join(_KNOWN)}")
    revision = catalog.get("revision")
    if type(revision) is not datetime.date:
        raise InputError("must be a date, such as 2026-11-25", where=f"{where}: catalog.revision")
    for key, value in leaves(tables):
        if not isinstance(value, str | int | float | bool):
            raise InputError("is not a value of a scene", where=f"{where}: {key}")
    return Component(
        kind=told,
        name=path.name.removesuffix(".toml"),
        place=place,
        revision=revision.isoformat(),
        sha256=hashlib.sha256(content).hexdigest(),
        values=tables,
        entries={key: _entry(value, f"{where}: catalog.from.{key}") for key, value in _from(catalog, where)},
        catalog=catalog,
        path=path,
    )


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Key path and value of all that is no table; arrays count by their entries."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from leaves(item, f"{key}[{number}]")
    else:
        yield key, value


def _from(catalog: Mapping[str, Any], where: str) -> Iterator[tuple[str, Any]]:
    told = catalog.get("from")
    if not isinstance(told, dict):
        raise InputError("is missing", where=f"{where}: catalog.from", remedy="state where each key comes from")
    yield from told.items()


def _entry(told: Any, where: str) -> Entry:
    if not isinstance(told, dict) or told.get("basis") not in BASES:
        raise InputError(f"needs a basis, one of {', '.join(BASES)}", where=where)
    for key in told:
        if key not in Entry.__dataclass_fields__:
            raise InputError("unknown key", where=f"{where}.{key}")
    for key in ("source", "where", "note", "at"):
        if not isinstance(told.get(key, ""), str):
            raise InputError("must be a string", where=f"{where}.{key}")
    for key in ("range", "range_factor"):
        if key in told and not (isinstance(told[key], list) and len(told[key]) == 2):
            raise InputError("must be an array of two values", where=f"{where}.{key}")
    factors = told.get("range_factor")
    if factors is not None and not all(isinstance(one, int | float) and one >= 0 for one in factors):
        raise InputError("must be two numbers of 0 or more", where=f"{where}.range_factor")
    if "range" in told and "range_factor" in told:
        raise InputError("needs one of range and range_factor, not both", where=where)
    pairs = {key: tuple(told[key]) for key in ("range", "range_factor") if key in told}
    return Entry(**{**told, **pairs})
