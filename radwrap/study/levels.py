"""A table of results as an analysis needs it: the response, and each factor's levels in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.manifest import read_manifest
from radwrap.study.factors import in_si
from radwrap.study.study import PLAN
from radwrap.study.table import Table, bare, read_table, unit

# Columns of a table of results that are no factors.
_OTHERS: Final = ("run", "replicate", "seed", "image_error", "met", "error")
# Words for low and high, in any case.
_WORDS: Final = ({"l", "low", "-", "-1", "off", "no"}, {"h", "high", "+", "+1", "on", "yes"})


@dataclass(frozen=True, slots=True)
class FactorLevels:
    """A column of levels.

    Attributes
    ----------
    name, label : str
        Heading, and what it is.
    levels : tuple of str
        The lowest first; words that have no order in that of their appearance.
    numbers : tuple of float, optional
        Their values in SI, where they are numbers or quantities.
    """

    name: str
    label: str
    levels: tuple[str, ...]
    numbers: tuple[float, ...] | None


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """What an analysis works on.

    Attributes
    ----------
    response, unit : str
        Name and unit of the column.
    values, errors : ndarray, shape (n,)
        Response, and its error by the image (0 where the table has none), in that unit.
    factors : tuple of FactorLevels
    codes : ndarray of int, shape (n, factors)
        Number of the level.
    dropped : int
        Rows without a response.
    """

    response: str
    unit: str
    values: NDArray[np.float64]
    errors: NDArray[np.float64]
    factors: tuple[FactorLevels, ...]
    codes: NDArray[np.intp]
    dropped: int

    @property
    def is_two_level(self) -> bool:
        """Whether each factor has two levels."""
        return all(len(factor.levels) == 2 for factor in self.factors)

    @property
    def signs(self) -> NDArray[np.float64]:
        """-1 and 1 for the levels of two-level factors."""
        signs: NDArray[np.float64] = (2 * self.codes - 1).astype(np.float64)
        return signs


def read_data(path: Path, response: str, factors: Sequence[str] = (), labels: Mapping[str, str] | None = None) -> Data:
    """Read a table of results.

    Parameters
    ----------
    path : Path
        CSV file with a header.
    response : str
        Column of the response, with or without its unit.
    factors : sequence of str
        Columns of the factors; default those of the study whose table it is, else all to the left of the response.
    labels : Mapping, optional
        Factor -> what it is, in place of what the study says.

    Raises
    ------
    InputError
        If a column is not there, a response is no number, or a factor has one level only.
    """
    table = read_table(path)
    try:
        column = table.column(response)
        plan = _plan(path.parent)
        names = [table.column(name) for name in factors] or _default_factors(table, column, plan)
    except InputError as error:
        raise InputError(error.what, where=str(path), remedy=error.remedy) from error
    if column in names:
        raise InputError("is the response", where="--factors")
    rows = [row for row in table.rows if row[column]]
    if not rows or not names:
        what = "holds no response" if not rows else "has no column of a factor"
        raise InputError(what, where=f"{path}: {column}", remedy="name columns with --response and --factors")
    known = {factor["name"]: factor["label"] for factor in plan.get("design", {}).get("factors", ())} | dict(
        labels or {}
    )
    found = [_factor(name, [row[name] for row in rows], known.get(bare(name), name), path) for name in names]
    codes = np.array([[factor.levels.index(row[factor.name]) for factor in found] for row in rows], dtype=np.intp)
    return Data(
        response=bare(column),
        unit=unit(column),
        values=np.array([_number(row[column], path, column) for row in rows]),
        errors=np.array([_error(row, column, path) for row in rows]),
        factors=tuple(found),
        codes=codes,
        dropped=len(table.rows) - len(rows),
    )


def _plan(folder: Path) -> Mapping[str, Any]:
    """What the study is whose table lies there; empty where it is none."""
    if not (folder / PLAN).is_file():
        return {}
    return read_manifest(folder / PLAN)


def _default_factors(table: Table, column: str, plan: Mapping[str, Any]) -> list[str]:
    names = [str(factor["name"]) for factor in plan.get("design", {}).get("factors", ())]
    if names and set(names) <= set(table.columns):
        return names
    before = table.columns[: table.columns.index(column)]
    return [name for name in before if name not in _OTHERS and not bare(name).endswith("_error")]


def _number(text: str, path: Path, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f'"{text}" is no finite number', where=f"{path}: {column}")
    return value


def _error(row: Mapping[str, str], column: str, path: Path) -> float:
    name = column.replace(bare(column), f"{bare(column)}_error", 1)
    return _number(row[name], path, name) if row.get(name) else 0.0


def _factor(name: str, cells: Sequence[str], label: str, path: Path) -> FactorLevels:
    levels = list(dict.fromkeys(cells))
    if "" in levels:
        raise InputError("has an empty cell", where=f"{path}: {name}")
    if len(levels) < 2:
        raise InputError(f'has one level only, "{levels[0]}"', where=f"{path}: {name}", remedy="leave it out")
    numbers = [_value(level) for level in levels]
    known = [number for number in numbers if number is not None]
    if len(known) == len(levels):
        order = sorted(range(len(levels)), key=lambda i: known[i])
        return FactorLevels(name, label, tuple(levels[i] for i in order), tuple(known[i] for i in order))
    if len(levels) == 2 and levels[0].lower() in _WORDS[1] and levels[1].lower() in _WORDS[0]:
        levels.reverse()
    return FactorLevels(name, label, tuple(levels), None)


def _value(cell: str) -> float | None:
    """A level as a number in SI; None for words."""
    try:
        value = float(cell)
    except ValueError:
        try:
            value = in_si(cell) if " " in cell else None  # type: ignore[assignment]
        except InputError:
            return None
    return value if value is not None and math.isfinite(value) else None
