"""Tables of source levels: which image, which factor on each source."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.reading import CSV, csv_rows, read_text, shortened

NAME: Final = "name"
# Becomes a file name on any system: no separator, no dot at either end, nothing that a shell reads.
_SAFE: Final = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9._-]{0,98}[A-Za-z0-9_-])?")
_RESERVED: Final = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE)
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """What is to be relit.

    Attributes
    ----------
    names : tuple of str
        Of the images, each once.
    factors : ndarray, shape (images, sources)
        On the radiance of each source as it is in the basis' scene.
    """

    names: tuple[str, ...]
    factors: NDArray[np.float64]

    def over(self, given: Sequence[str], sources: Sequence[str]) -> Levels:
        """The same for more sources; those that are not given are off."""
        factors = np.zeros((len(self.names), len(sources)))
        factors[:, [sources.index(name) for name in given]] = self.factors
        return Levels(self.names, factors)


def read_levels(path: Path, sources: Sequence[str], dark: Sequence[str] = ()) -> Levels:
    """Read a table of levels.

    Parameters
    ----------
    path : Path
        CSV file with the columns name and one for each source, in any order.
    sources : sequence of str
        Names of the sources of the basis; the factors come in their order.
    dark : sequence of str
        Sources of the scene that are dark in it, for messages.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, unknown or twice, a cell is empty or no number from 0 on, or
        a name cannot be a file's or comes twice; the error names line and column.
    """
    rows = csv_rows(read_text(path, CSV), str(path))
    names: dict[str, int] = {}
    factors = []
    header = [cell.strip() for cell in next(rows, (1, []))[1]]
    _check_header(header, sources, dark, f"{path}: line 1")
    order = [header.index(source) for source in sources]
    for line, row in rows:
        where = f"{path}: line {line}"
        if len(row) != len(header):
            raise InputError(f"has {len(row)} cells, the first line has {len(header)}", where=where)
        name = _image_name(row[header.index(NAME)].strip(), names, where)
        names[name.lower()] = line
        factors.append((name, [_factor(row[column], f'{where}, column "{header[column]}"') for column in order]))
    if not factors:
        raise InputError("holds no image", where=str(path), remedy="write a row for each image below the first line")
    return Levels(tuple(name for name, _ in factors), np.array([row for _, row in factors], dtype=np.float64))


def levels_of(given: Sequence[str], sources: Sequence[str], dark: Sequence[str] = ()) -> tuple[float, ...]:
    """A factor for each source, from texts such as ``"lamp=0.5"``; one that none names stays as it is.

    Parameters
    ----------
    given : sequence of str
        NAME=FACTOR; a ring's name stands for all its LEDs, and what comes later replaces what came before.
    sources, dark : sequence of str
        As of `read_levels`.

    Raises
    ------
    InputError
        If a name is unknown or dark, or a factor is no number from 0 on.
    """
    factors = dict.fromkeys(sources, 1.0)
    for text in given:
        name, equals, cell = text.rpartition("=")
        if not equals:
            raise InputError(f'"{shortened(text)}" is not NAME=FACTOR', where="level")
        named = [source for source in sources if name in (source, source.rpartition(".")[0])]
        if not named:
            _check_name(name, sources, dark, f'level "{shortened(name)}"', "source")
        factors.update(dict.fromkeys(named, _factor(cell, f"level {name}")))
    return tuple(factors.values())


def _check_header(header: Sequence[str], sources: Sequence[str], dark: Sequence[str], where: str) -> None:
    wanted = (NAME, *sources)
    for column in header:
        _check_name(column, wanted, dark, where, "column")
        if header.count(column) > 1:
            raise InputError(f'the column "{column}" comes twice', where=where)
    for column in wanted:
        if column not in header:
            line = ",".join(wanted[:3]) + (",..." if len(wanted) > 3 else "")
            remedy = f"begin the table with the line {line}" if column == NAME else "1 leaves a source as it is"
            raise InputError(f'the column "{column}" is missing', where=where, remedy=remedy)


def _check_name(name: str, known: Sequence[str], dark: Sequence[str], where: str, what: str) -> None:
    if name in dark:
        raise InputError(
            f'the source "{name}" is dark in the scene, no factor changes that',
            where=where,
            remedy="give it a radiance in the scene, make the basis again",
        )
    if name not in known:
        raise InputError(f'unknown {what} "{shortened(name)}"', where=where, remedy=f"known are {', '.join(known)}")


def _image_name(name: str, known: dict[str, int], where: str) -> str:
    place = f'{where}, column "{NAME}"'
    if not _SAFE.fullmatch(name) or _RESERVED.fullmatch(name):
        raise InputError(
            f'"{shortened(name)}" cannot name a file',
            where=place,
            remedy="use up to 100 letters, digits, and _ . - between them",
        )
    if name.lower() in known:
        raise InputError(f'"{name}" is taken by line {known[name.lower()]}', where=place)
    return name


def _factor(cell: str, where: str) -> float:
    text = cell.strip()
    if not text:
        raise InputError("is empty", where=where, remedy="write 0 for a source that is off")
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not (math.isfinite(value) and value >= 0):
        raise InputError(f'"{shortened(text)}" is not a number of 0 or more', where=where)
    return value
