"""A response that the user computes: which file and function, and what its answers hang on.

``measure = "python:FILE.py:FUNCTION"`` names a file below the design's folder. Its hash, and those of the modules
beside it that it imports, belong to the study: with other code it is another one.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_bytes
from radwrap.units import TIME, parse_quantity

PREFIX: Final = "python:"
_PYTHON_FILE: Final = FileKind("Python file", 4 << 20, "name a file below the design's folder")
_SHORTEST, _LONGEST = 0.1, 1e6  # s that one image may take
_MEMORY: Final = re.compile(r"([0-9]{1,6}) (MiB|GiB)")
_MEMORY_UNITS: Final = {"MiB": 1 << 20, "GiB": 1 << 30}
_LEAST_MEMORY: Final = 256 << 20  # byte; numpy by itself takes a part of that
_MOST_KEYS: Final = 100


@dataclass(frozen=True, slots=True)
class UserFunction:
    """Code that measures an image.

    Attributes
    ----------
    file : str
        Below the design's folder, with slashes.
    function : str
        Its name there.
    keys : tuple of str
        Names of its answers.
    sha256 : tuple of (str, str)
        File -> hash, of the file and of each module below the folder that it imports.
    time_limit : float
        Longest time for one image [s].
    memory_limit : int
        Of its process [byte].
    """

    file: str
    function: str
    keys: tuple[str, ...]
    sha256: tuple[tuple[str, str], ...]
    time_limit: float
    memory_limit: int

    @property
    def name(self) -> str:
        """As the design names it."""
        return f"{PREFIX}{self.file}:{self.function}"


def read_user_function(measure: str, table: Mapping[str, Any], home: Path, where: str) -> UserFunction:
    """What a response's table says of the user's code.

    Parameters
    ----------
    measure : str
        "python:FILE.py:FUNCTION".
    table : Mapping
        ``keys``, ``time_limit``, ``memory_limit``.
    home : Path
        Folder of the design.
    where : str
        The table, for messages.

    Raises
    ------
    InputError
        If the file is not there, lies elsewhere, or is no Python; if a key or a limit is missing or wrong.
    """
    unknown = sorted(set(table) - {"keys", "time_limit", "memory_limit"})
    if unknown:
        raise InputError(
            "unknown option of a Python function",
            where=f"{where}.{unknown[0]}",
            remedy="known are keys, time_limit, memory_limit, unit, frames",
        )
    file, _, function = measure.removeprefix(PREFIX).rpartition(":")
    place = f"{where}.measure"
    if not file.endswith(".py") or not function.isidentifier():
        raise InputError(f'"{measure}" names no function', where=place, remedy='write "python:FILE.py:FUNCTION"')
    _checked_place(file, home, place)
    sources = dict(_sources(PurePosixPath(file).as_posix(), home, place))
    if function not in _functions(sources[PurePosixPath(file).as_posix()], file, place):
        raise InputError(f'{file} has no function "{function}"', where=place, remedy="define it at the file's top")
    hashes = tuple(sorted((name, hashlib.sha256(text).hexdigest()) for name, text in sources.items()))
    return UserFunction(
        PurePosixPath(file).as_posix(),
        function,
        _keys(table.get("keys"), f"{where}.keys"),
        hashes,
        _time(table.get("time_limit", "60 s"), f"{where}.time_limit"),
        _memory(table.get("memory_limit", "4 GiB"), f"{where}.memory_limit"),
    )


def check_unchanged(function: UserFunction, home: Path) -> None:
    """Refuse code that is not what the study was planned with.

    Raises
    ------
    InputError
        Naming the file.
    """
    for name, known in function.sha256:
        if hashlib.sha256(read_bytes(home / name, _PYTHON_FILE)).hexdigest() != known:
            raise InputError("was changed since the study began", where=name, remedy="choose another `out`")


# ------------------------------------------------------------------------------------------------------------- options


def _keys(given: Any, where: str) -> tuple[str, ...]:
    remedy = 'name what the function gives: keys = ["diameter"]'
    if not isinstance(given, list) or not 1 <= len(given) <= _MOST_KEYS:
        raise InputError("must be an array of names", where=where, remedy=remedy)
    if not all(isinstance(key, str) and key.isidentifier() for key in given) or len(set(given)) < len(given):
        raise InputError("must be different names of letters, digits and _", where=where, remedy=remedy)
    return tuple(given)


def _time(given: Any, where: str) -> float:
    try:
        seconds = parse_quantity(given, TIME)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error
    if not _SHORTEST <= seconds <= _LONGEST:
        raise InputError(f"must lie between {_SHORTEST:g} and {_LONGEST:g} s", where=where)
    return seconds


def _memory(given: Any, where: str) -> int:
    found = _MEMORY.fullmatch(given) if isinstance(given, str) else None
    if found is None:
        raise InputError(f"{given!r} is not an amount of memory", where=where, remedy='write "4 GiB" or "512 MiB"')
    size = int(found[1]) * _MEMORY_UNITS[found[2]]
    if size < _LEAST_MEMORY:
        raise InputError(f"must be {_LEAST_MEMORY >> 20} MiB at least", where=where)
    return size


# --------------------------------------------------------------------------------------------------------------- files


def _checked_place(file: str, home: Path, where: str) -> None:
    if "\0" in file or Path(file).is_absolute() or not (home / file).resolve().is_relative_to(home.resolve()):
        raise InputError(f"{file} lies outside of the design's folder", where=where, remedy="put it beside the design")


def _sources(file: str, home: Path, where: str) -> Iterator[tuple[str, bytes]]:
    """Name and content of a file, and of every module below the folder that it imports, and these in turn."""
    due, seen = [file], {file}
    while due:
        name = due.pop()
        content = read_bytes(home / name, _PYTHON_FILE, where if name == file else name)
        yield name, content
        for other in _imported(_tree(content, name, where), name, PurePosixPath(file).parent, home):
            if other not in seen:
                seen.add(other)
                due.append(other)


def _tree(content: bytes, name: str, where: str) -> ast.Module:
    try:
        return ast.parse(content, name)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" in line {error.lineno}" if isinstance(error, SyntaxError) and error.lineno else ""
        raise InputError(f"{name} is not Python{line}: {getattr(error, 'msg', error)}", where=where) from error


def _functions(content: bytes, name: str, where: str) -> set[str]:
    """What a file defines, assigns or imports at its top."""
    found: set[str] = set()
    for node in _tree(content, name, where).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
    return found


def _imported(tree: ast.Module, name: str, beside: PurePosixPath, home: Path) -> Iterator[str]:
    """Files below the folder that a module's import statements may mean: one too many does no harm."""
    own = PurePosixPath(name).parent
    for node in ast.walk(tree):
        modules: list[str] = []
        roots = [beside, PurePosixPath(".")]
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            modules = [base, *(f"{base}.{alias.name}".lstrip(".") for alias in node.names)]
            if node.level:
                roots = [own.parents[node.level - 2] if node.level > 1 and len(own.parents) >= node.level - 1 else own]
        for module in filter(None, modules):
            yield from _files_of(module, roots, home)


def _files_of(module: str, roots: list[PurePosixPath], home: Path) -> Iterator[str]:
    """The file of a module and those of the packages that hold it, wherever one of the roots has it."""
    steps = module.split(".")
    for root in roots:
        for length in range(1, len(steps) + 1):
            stem = root.joinpath(*steps[:length])
            for candidate in (stem.with_suffix(".py"), stem / "__init__.py"):
                if (home / candidate).is_file() and (home / candidate).resolve().is_relative_to(home.resolve()):
                    yield candidate.as_posix()
