"""The one door for files that a user names: regular, not too large, text where text is due, not nested too deep.

Whatever a file holds, its reader gets values that plain code can work with, or
an `InputError` that names the file and, where there is one, the line or key.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError

_MEBI: Final = 1 << 20
# Nobody nests by hand so deep; Python's own limit, and those of libraries in C, are some hundred levels beyond.
_DEEPEST: Final = 64
_LARGEST_INTEGER: Final = 2**63  # as TOML says; larger ones do not become a float
# A FIFO without a writer is opened at once, so that it can be refused.
_OPEN_FLAGS: Final = (
    os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
)
_NO_FOLLOW: Final = getattr(os, "O_NOFOLLOW", 0)
_TOML_STRING: Final = re.compile(
    r'"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*+"|\'[^\'\n]*+\'|(#[^\n]*+)', re.DOTALL
)
_DIGITS: Final = re.compile(r"[0-9]{1,18}", re.ASCII)
_LARGEST: Final = 1e30  # of a measured number, in whatever unit
_LONG_KEY: Final = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{_DEEPEST}}}")


@dataclass(frozen=True, slots=True)
class FileKind:
    """What a file is to be, for limits and messages.

    Attributes
    ----------
    name : str
        Such as "scene file".
    largest : int
        More bytes than these are refused.
    remedy : str
        What to do where there is no such file.
    """

    name: str
    largest: int
    remedy: str = ""


CSV: Final = FileKind("CSV file", 64 * _MEBI, "give a CSV file in UTF-8")
JSON: Final = FileKind("JSON file", 64 * _MEBI)


def check_regular(path: Path, kind: FileKind, where: str = "") -> None:
    """Refuse what is no file of its kind, for libraries that open it themselves; raises as `read_bytes`."""
    os.close(_opened(path, kind, where or str(path)))


def read_bytes(path: Path, kind: FileKind, where: str = "", *, follow: bool = True) -> bytes:
    """Content of a file that a user named.

    Parameters
    ----------
    path : Path
        The file.
    kind : FileKind
        What it is to be.
    where : str
        Place for messages; default the path.
    follow : bool
        Whether a link is followed; not where the path was checked, and a link might have replaced it since.

    Raises
    ------
    InputError
        If it is not there, is a folder, a device or a pipe, cannot be read, or is too large.
    """
    where = where or str(path)
    try:
        with os.fdopen(_opened(path, kind, where, follow=follow), "rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            content = stream.read(size + 1)  # room is made for as much as is asked for: not for the limit of its kind
            if len(content) > size:  # it grows, or is of a kind that does not know its size
                content += stream.read(kind.largest + 1 - size)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=where) from error
    if len(content) > kind.largest:
        raise _too_large(kind, where)
    return content


def _opened(path: Path, kind: FileKind, where: str, *, follow: bool = True) -> int:
    """Descriptor of a regular file that is not too large."""
    try:
        descriptor = os.open(path, _OPEN_FLAGS | (0 if follow else _NO_FOLLOW))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"no such {kind.name}", where=where, remedy=kind.remedy) from error
    except (OSError, ValueError) as error:  # ValueError: NUL in a name, or a name that is not text
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot be read: {why}", where=where, remedy=kind.remedy) from error
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode) or found.st_size > kind.largest:
        os.close(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise InputError("is not a regular file", where=where, remedy=kind.remedy or "name another file")
        raise _too_large(kind, where)
    return descriptor


def _too_large(kind: FileKind, where: str) -> InputError:
    size = f"{kind.largest // _MEBI} MiB" if kind.largest >= _MEBI else f"{kind.largest >> 10} KiB"
    return InputError(f"is larger than {size}, the limit for a {kind.name}", where=where)


def read_text(path: Path, kind: FileKind, where: str = "") -> str:
    """Text of a file that a user named, without a byte order mark; arguments and errors as `read_bytes`."""
    where = where or str(path)
    return text_of(read_bytes(path, kind, where), kind, where)


def text_of(content: bytes, kind: FileKind, where: str) -> str:
    """Text of a file's content, without a byte order mark.

    Raises
    ------
    InputError
        If it is not UTF-8, or holds a NUL byte.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"is not UTF-8 text (line {line})", where=where, remedy=f"save the {kind.name} as UTF-8"
        ) from (error)
    if "\0" in text:
        raise InputError("is not text: it holds a NUL byte", where=where, remedy=kind.remedy)
    return text


def read_toml(path: Path, kind: FileKind, where: str = "") -> dict[str, Any]:
    """Tables of a TOML file that a user named; arguments as `read_bytes`, errors too, and those of `parse_toml`."""
    where = where or str(path)
    return parse_toml(read_text(path, kind, where), where)


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Tables of a text.

    Raises
    ------
    InputError
        If it is not TOML, is nested too deep, or holds an integer beyond 64 bits.
    """
    # The parser's time and memory go with the square of a key's length: such keys are found before it runs.
    if _LONG_KEY.search(_TOML_STRING.sub(lambda found: "" if found[1] else "_", text)):
        raise _too_deep(where)
    try:
        tree = tomllib.loads(text)
    except RecursionError as error:
        raise _too_deep(where) from error
    except ValueError as error:
        raise _no_text_of("TOML", error, where) from error
    check_tree(tree, where, finite=False)
    return tree


def read_json(path: Path, kind: FileKind = JSON, where: str = "") -> Any:
    """Value of a JSON file that a user named; arguments as `read_bytes`, errors too, and those of `parse_json`."""
    where = where or str(path)
    return parse_json(read_text(path, kind, where), where)


def parse_json(text: str, where: str) -> Any:
    """Value of a text.

    Raises
    ------
    InputError
        If it is not JSON, is nested too deep, or holds NaN, infinity or an integer beyond 64 bits.
    """
    try:
        tree = json.loads(text)
    except RecursionError as error:
        raise _too_deep(where) from error
    except ValueError as error:
        raise _no_text_of("JSON", error, where) from error
    check_tree(tree, where, finite=True)
    return tree


def _no_text_of(language: str, error: ValueError, where: str) -> InputError:
    if "set_int_max_str_digits" in str(error):  # its remedy is for programmers
        return InputError("holds an integer of more than 64 bits", where=where)
    return InputError(f"is not {language}: {error}", where=where)


def check_tree(tree: Any, where: str, *, finite: bool) -> None:
    """Refuse values that plain code cannot go through.

    Parameters
    ----------
    tree : Any
        Of dict, list and plain values.
    where : str
        File, for messages.
    finite : bool
        Whether NaN and infinity are refused too.

    Raises
    ------
    InputError
        If tables and arrays are nested too deep, or a number is not as it has to be; with the key.
    """
    level = [("", tree)]
    for _ in range(_DEEPEST):
        inner: list[tuple[str, Any]] = []
        for key, value in level:
            if isinstance(value, dict):
                inner += [(f"{key}.{name}" if key else str(name), item) for name, item in value.items()]
            elif isinstance(value, list | tuple):
                inner += [(f"{key}[{number}]", item) for number, item in enumerate(value)]
            elif finite and isinstance(value, float) and not math.isfinite(value):
                raise InputError("is not a finite number", where=f"{where}: {key}")
            elif isinstance(value, int) and not -_LARGEST_INTEGER <= value < _LARGEST_INTEGER:
                raise InputError("is an integer of more than 64 bits", where=f"{where}: {key}")
        if not inner:
            return
        level = inner
    raise _too_deep(where)


def _too_deep(where: str) -> InputError:
    return InputError(f"is nested more than {_DEEPEST} levels deep", where=where, remedy="make it flatter")


def csv_rows(text: str, where: str, *, initial_space: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Rows of a CSV text that hold anything, each with its line from 1.

    Parameters
    ----------
    text : str
        Content.
    where : str
        File, for messages.
    initial_space : bool
        Whether blanks before a cell do not count.

    Raises
    ------
    InputError
        If it is no CSV, with the line; a cell is at most 131072 characters long.
    """
    rows = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=initial_space)
    try:
        for row in rows:
            if row:
                yield rows.line_num, row
    except csv.Error as error:
        raise InputError(f"is not CSV: {error}", where=f"{where}: line {rows.line_num}") from error


def unusable(value: float) -> str | None:
    """Why nothing can be computed from a number of a table; None where it can.

    Its squares and products of a few stay far below the largest double.
    """
    if not math.isfinite(value):
        return "is not a finite number"
    return f"is beyond {_LARGEST:g}" if abs(value) > _LARGEST else None


def whole_number(text: str) -> int | None:
    """A whole number from 0 on in at most 18 ASCII digits; None for any other text."""
    return int(text) if _DIGITS.fullmatch(text) else None


def shortened(text: str, most: int = 40) -> str:
    """Text for a message: its beginning where it is long."""
    text = text.strip()
    return text if len(text) <= most else f"{text[:most]}..."
