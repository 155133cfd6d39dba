"""Radiance scene files that a user's scene includes.

A Radiance scene file can run shell commands and open other files. Without
``--trust`` an included file is therefore parsed here, checked against an
allow-list and written again from the checked words; the files that it names
are checked and copied. Its raw text never reaches Radiance.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_bytes
from radwrap.tracers.rad_grammar import ILLUMINATING, Primitive, Source, primitives, shown

_INCLUDED: Final = FileKind("file for Radiance", 64 << 20)
_LARGEST_SUM: Final = 256 << 20
_FILE_NAME: Final = re.compile(r"[A-Za-z0-9_.+-]+(?:/[A-Za-z0-9_.+-]+)*")
# The name becomes part of the names of the function file's variables, which Radiance cuts at 127 characters.
_LONGEST_NAME: Final = 80
_OCTREES: Final = (".oct", ".rtm")
_NO_FUNCTION_FILE: Final = "."
_TRUST: Final = "or pass `trust=True` if you trust the file"

# Of Path.resolve: links in a circle (before Python 3.13), a NUL in the name.
_UNRESOLVED: Final = (RuntimeError, ValueError)


@dataclass(frozen=True, slots=True)
class IncludedScene:
    """An included scene file, made harmless.

    Attributes
    ----------
    text : str
        Radiance text made again from checked words; ends with a newline.
    files : Mapping[str, bytes]
        Relative name, such as "include1/wood.cal" -> content, to be laid beside the text.
    has_light : bool
        Whether it holds a light, spotlight, glow or illum that is not black.
    """

    text: str
    files: Mapping[str, bytes]
    has_light: bool


def read_included(path: Path, *, folder: Path, library: Path, prefix: str, where: str) -> IncludedScene:
    """Read a scene file that is not trusted, and make it again from what is permitted.

    Parameters
    ----------
    path : Path
        The file.
    folder : Path
        The scene's folder, inside which it must lie.
    library : Path
        Radiance's library folder; its files may be named.
    prefix : str
        Folder name under which the files that it names will lie.
    where : str
        What named the file, for messages.

    Returns
    -------
    IncludedScene
        Text and files without commands, and without names outside `prefix` and `library`.

    Raises
    ------
    InputError
        If it cannot be read, or holds anything that is not permitted.
    """
    source = Source(where, path)
    real = _real_path(path, source)
    if not real.is_relative_to(folder.resolve()):
        raise source.fault("lies outside the scene's folder", remedy=f"copy it there, {_TRUST}")
    beside = _NamedFiles(real.parent, library, prefix, source)
    pieces = []
    has_light = False
    for primitive in primitives(_scene_text(_read_regular(real, source), source), source):
        pieces.append(primitive.text(beside.laid(primitive)))
        has_light = has_light or primitive.shines
    if not pieces:
        raise source.fault("holds no Radiance primitive", remedy="name another file")
    return IncludedScene("".join(pieces), MappingProxyType(beside.files), has_light)


def _real_path(path: Path, source: Source) -> Path:
    try:
        return path.resolve(strict=True)
    except (OSError, *_UNRESOLVED) as error:
        raise source.fault("no such file", remedy="name a file beside the scene") from error


def _read_regular(path: Path, source: Source, line: int | None = None) -> bytes:
    """Content of a file that is neither a pipe, a device nor huge."""
    try:
        return read_bytes(path, _INCLUDED, follow=False)
    except InputError as error:
        what = f"{shown(path.name)} {error.what}"
        raise source.fault(what, line=line, remedy=error.remedy or "make it readable, or smaller") from error


def _scene_text(content: bytes, source: Source) -> str:
    """Decode a scene; refuse what no text holds, and what runs commands."""
    for byte, what in ((b"\0", "a NUL byte"), (b"!", 'a "!", which lets a scene run commands')):
        if (at := content.find(byte)) >= 0:
            line = content.count(b"\n", 0, at) + 1
            raise source.fault(f"holds {what}", line=line, remedy=f"remove it, {_TRUST}")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise source.fault("is not UTF-8 text", line=line, remedy="save it as ASCII or UTF-8") from error


class _NamedFiles:
    """The files that an included scene names: finds, checks and copies them."""

    def __init__(self, home: Path, library: Path, prefix: str, source: Source) -> None:
        self._home = home
        self._library = library
        self._prefix = prefix
        self._source = source
        self._laid: dict[str, str] = {}
        self._roles: dict[str, str] = {}
        self._dimensions: dict[str, int] = {}
        self._sum = 0
        self.files: dict[str, bytes] = {}

    def laid(self, primitive: Primitive) -> list[str]:
        """String arguments of a primitive, its files named as they will lie."""
        words = list(primitive.words)
        coordinates = len(words) - primitive.roles.find("f") - 1
        for index, role in enumerate(primitive.roles):
            if role in "dpf" and (role, words[index]) != ("f", _NO_FUNCTION_FILE):
                words[index] = self._checked(words[index], role, primitive.line)
            # Radiance does not count them for plasdata and its like, and reads beyond the last.
            if role == "d" and self._dimensions[words[index]] > coordinates:
                has = f"{shown(primitive.words[index])} has {self._dimensions[words[index]]} dimensions"
                raise self._source.fault(f"{has}, but {coordinates} coordinates are given", line=primitive.line)
        return words

    def _checked(self, name: str, role: str, line: int) -> str:
        """Name under which a file will lie, once its content is checked and kept."""
        own = "/".join(part for part in name.split("/") if part != ".")
        if not _FILE_NAME.fullmatch(name) or ".." in name.split("/") or not own:
            what = f"{shown(name)} may not be a file name"
            remedy = "name a file in this file's folder, with only letters, digits and _.+-"
            raise self._source.fault(what, line=line, remedy=remedy)
        if own.casefold().endswith(_OCTREES):
            what = f"{shown(name)} is a prebuilt octree or mesh, which may run commands"
            raise self._source.fault(what, line=line, remedy="name another file")
        if len(own) > _LONGEST_NAME:
            what = f"the file name {shown(name)} is longer than {_LONGEST_NAME} characters"
            raise self._source.fault(what, line=line, remedy="shorten it")
        # Radiance keeps data and pictures in one list by name, and would take one for the other.
        if self._roles.setdefault(own, role) != role:
            what = f"{shown(name)} serves as two kinds of file"
            raise self._source.fault(what, line=line, remedy="use a copy of another name")
        if own not in self._laid:
            self._laid[own] = self._kept(own, role, line)
        return self._laid[own]

    def _kept(self, own: str, role: str, line: int) -> str:
        """Check and keep the content of a file that is named for the first time; where it will lie."""
        laid = f"{self._prefix}/{own}"
        content = self._own_content(own, line)
        if content is None:
            laid, content = own, self._library_content(own, line)
        else:
            self._sum += len(content)
            if self._sum > _LARGEST_SUM:
                what = f"the files named are larger than {_LARGEST_SUM >> 20} MiB in all"
                raise self._source.fault(what, line=line, remedy="make them smaller")
            self.files[laid] = content
        try:
            if role == "d":
                self._dimensions[laid] = _data_dimensions(content)
            elif role == "p":
                _check_picture(content)
        except ValueError as error:
            what = f"{shown(own)} {error}"
            raise self._source.fault(what, line=line, remedy="correct that file") from error
        return laid

    def _own_content(self, own: str, line: int) -> bytes | None:
        """Content of a file in the included file's folder; None if it is not there."""
        try:
            real = (self._home / own).resolve(strict=True)
        except (OSError, *_UNRESOLVED):
            return None
        if not real.is_relative_to(self._home):
            what = f"{shown(own)} lies outside the folder of the included file"
            raise self._source.fault(what, line=line, remedy=f"copy it there, {_TRUST}")
        return _read_regular(real, self._source, line)

    def _library_content(self, own: str, line: int) -> bytes:
        path = self._library / own
        if "/" in own or not path.is_file():
            what = f"{shown(own)} is neither in the included file's folder nor in Radiance's library"
            raise self._source.fault(what, line=line, remedy="put it beside the included file")
        return _read_regular(path.resolve(), self._source, line)


_DATA_WORD: Final = re.compile(rb"#[^\n]*|([^ \t\n\v\f\r#]+)")
_DATA_NUMBER: Final = re.compile(rb"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_DATA_COUNT: Final = re.compile(rb"[0-9]{1,9}")


def _data_dimensions(content: bytes) -> int:
    """Number of dimensions of a data file, whose sizes its length must bear out.

    Radiance multiplies the sizes in 32 bits: sizes whose product overflows
    make it read memory that is not the file's.
    """
    words = (match[1] for match in _DATA_WORD.finditer(content) if match[1])
    dimensions = _data_count(words, 1, 6)
    values = 1
    for _ in range(dimensions):
        first, last = _data_number(words), _data_number(words)
        size = _data_count(words, 2, 999_999_999)
        values *= size
        # Radiance compares in float32. Equal limits announce that every coordinate follows.
        largest = max(abs(first), abs(last), 1e-24)
        if largest > 1e30 or 0 < abs(first - last) <= 1e-6 * largest:
            raise ValueError(f"has limits {first!r} and {last!r}, which Radiance cannot distinguish")
        if first == last:
            for _ in range(size):
                _data_number(words)
    if values > len(content) // 2:
        raise ValueError(f"announces {values} values, more than it holds")
    return dimensions


def _data_count(words: Iterator[bytes], least: int, most: int) -> int:
    word = next(words, b"nothing")
    if not _DATA_COUNT.fullmatch(word) or not least <= int(word) <= most:
        raise ValueError(f"is not a data file: found {shown(word.decode(errors='replace'))}, expected a size")
    return int(word)


def _data_number(words: Iterator[bytes]) -> float:
    word = next(words, b"nothing")
    if not _DATA_NUMBER.fullmatch(word):
        raise ValueError(f"is not a data file: found {shown(word.decode(errors='replace'))}, expected a number")
    return float(word)


_HEADER_LINE: Final = 2000
_RESOLUTION: Final = re.compile(rb"[+-]([XY]) +([0-9]{1,5}) [+-]([XY]) +([0-9]{1,5})\n")
_RESOLUTION_LINE: Final = 31
_MOST_PIXELS: Final = 1 << 26


def _check_picture(content: bytes) -> None:
    """Refuse a picture whose size Radiance would compute wrongly: it multiplies in 32 bits, then writes."""
    header, blank, rest = content.partition(b"\n\n")
    strange = b"\0" in header or b"\r" in header or max(map(len, header.split(b"\n"))) > _HEADER_LINE
    if not header.startswith(b"#?") or not blank or strange:
        raise ValueError("is not a Radiance picture")
    match = _RESOLUTION.match(rest[:_RESOLUTION_LINE])
    if match is None or match[1] == match[3]:
        raise ValueError("is not a Radiance picture: its size is missing")
    if not 0 < int(match[2]) * int(match[4]) <= _MOST_PIXELS:
        raise ValueError(f"has {match[2].decode()} x {match[4].decode()} pixels, more than {_MOST_PIXELS} or none")


_DEEPEST: Final = 32
# A command begins with "!" where a word may begin; what stands behind a "#" is a comment.
_COMMAND: Final = re.compile(r"(?:^|\s)(?:(#)|!(?!=)(.*))")
_SHELL_WORD: Final = re.compile(r"""[^\s;|&<>()"'`]+""")


def check_no_cycle(path: Path, *, where: str) -> None:
    """Look through a trusted file's commands for files that include themselves.

    Radiance would start shells without end. The scan is static: each word of a
    command that names a file is taken for an inclusion. As commands run in the
    folder of the outermost file, words are looked for there, then beside the
    file in which they stand.

    Parameters
    ----------
    path : Path
        The trusted file.
    where : str
        What named it, for messages.

    Raises
    ------
    InputError
        If a file includes itself, directly or through others, or files nest deeper than 32.
    """
    source = Source(where, path)
    top = _real_path(path, source)
    _nesting(top, (), top.parent, {}, source)


def _nesting(real: Path, above: tuple[Path, ...], top: Path, known: dict[Path, int], source: Source) -> int:
    """Number of levels of files below a file."""
    if real in above:
        chain = " -> ".join(file.name for file in (*above[above.index(real) :], real))
        raise source.fault(f"the file includes itself: {chain}", remedy="break the circle")
    if real not in known:
        levels = 0
        if len(above) <= _DEEPEST:
            for file in _commanded(real, top):
                levels = max(levels, 1 + _nesting(file, (*above, real), top, known, source))
        known[real] = levels
    if len(above) + known[real] > _DEEPEST:
        raise source.fault(f"files nest deeper than {_DEEPEST}", remedy="flatten them")
    return known[real]


def _commanded(real: Path, top: Path) -> list[Path]:
    """The files that a file's commands name."""
    try:
        content = _read_regular(real, Source("", real))
    except InputError:
        return []
    if b"!" not in content or b"\0" in content:
        return []
    found: dict[Path, None] = {}
    for line in content.decode(errors="replace").replace("\\\n", " ").splitlines():
        match = _COMMAND.search(line)
        if match is None or match[1]:
            continue
        for word in dict.fromkeys(_SHELL_WORD.findall(match[2])):
            file = _existing(word, (top, real.parent))
            if file is not None:
                found[file] = None
    return list(found)


def _existing(word: str, places: tuple[Path, ...]) -> Path | None:
    for place in places:
        try:
            real = (place / word).resolve(strict=True)
            if real.is_file():
                return real
        except (OSError, *_UNRESOLVED):
            continue
    return None


_BETWEEN: Final = re.compile(r"(?:[ \t\n\v\f\r]++|#[^\n]*+)*+")
# As Radiance joins them: quoted parts may hold blanks.
_LOOSE_WORD: Final = re.compile(r"""[ \t\n\v\f\r]*+((?:"[^"]*"|'[^']*'|[^ \t\n\v\f\r"'])++)""")
_OPAQUE: Final = frozenset({"instance", "mesh"})


def light_in(text: str) -> bool:
    """Whether a trusted scene text, its commands done, holds a light that is not black.

    Parameters
    ----------
    text : str
        Radiance text.

    Returns
    -------
    bool
        As `IncludedScene.has_light`. True also where the text cannot be read
        or opens an octree: then Radiance itself will tell.
    """
    at = 0
    try:
        while (between := _BETWEEN.match(text, at)) and between.end() < len(text):
            at, shines = _loose_primitive(text, between.end())
            if shines:
                return True
    except ValueError:
        return True
    return False


def _loose_primitive(text: str, at: int) -> tuple[int, bool]:
    """Where the next primitive ends, and whether it shines."""
    at, (modifier, kind, _) = _loose_words(text, at, 3)
    if modifier.startswith("!") or kind in _OPAQUE:
        raise ValueError("cannot be seen through")
    if kind == "alias":
        return _loose_words(text, at, 1)[0], False
    arguments: list[str] = []
    for _ in range(3):
        at, (count,) = _loose_words(text, at, 1)
        at, arguments = _loose_words(text, at, int(count))
    return at, kind in ILLUMINATING and max(map(float, arguments[:3])) > 0


def _loose_words(text: str, at: int, count: int) -> tuple[int, list[str]]:
    words = []
    for _ in range(count):
        match = _LOOSE_WORD.match(text, at)
        if match is None:
            raise ValueError("the text ends early")
        at = match.end()
        words.append(match[1].replace('"', "").replace("'", ""))
    return at, words
