"""A table of results as an analysis needs it: the response, and each factor's levels in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.manifest import read_manifest
from radwrap.reading import unusable
from radwrap.study.factors import in_si
from radwrap.study.study import PLAN
from radwrap.study.table import Table, bare, read_table, unit
from radwrap.written import read_back

# Columns of a table of results that are no factors.
_OTHERS: Final = ("run", "replicate", "seed", "image_error", "met", "warnings", "error")
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
        The lowest first; words as the study's design lists them, else by the alphabet: never as the rows happen to lie.
        Quantities that are equal, such as 100 ms and 0.1 s, are one level.
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
    analysis : str or None
        How the study's design says that effects are judged; None where it says nothing, or there is no study.
    """

    response: str
    unit: str
    values: NDArray[np.float64]
    errors: NDArray[np.float64]
    factors: tuple[FactorLevels, ...]
    codes: NDArray[np.intp]
    dropped: int
    analysis: str | None = None

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
        If a column is not there, a response is no number, a factor has one level only, or a label is of no factor.
    """
    table = read_table(path)
    plan = _plan(path.parent)
    try:
        column = table.column(response)
        names = [table.column(name) for name in factors] or _default_factors(table, column, plan)
    except InputError as error:
        raise InputError(error.what, where=str(path), remedy=error.remedy) from error
    if column in names:
        raise InputError("is the response", where="factors")
    rows = [row for row in table.rows if row[column]]
    if not rows or not names:
        what = "holds no response" if not rows else "has no column of a factor"
        raise InputError(what, where=f"{path}: {column}", remedy="name columns with `response` and `factors`")
    listed = {str(factor["name"]): factor for factor in plan.get("design", {}).get("factors", ())}
    _check_labels(labels or {}, names)
    told = {name: str(factor["label"]) for name, factor in listed.items()} | dict(labels or {})
    found, codes = [], []
    for name in names:
        order = [str(level["name"]) for level in listed.get(bare(name), {}).get("levels", ())]
        factor, code = _factor(name, [row[name] for row in rows], told.get(bare(name), name), order, path)
        found.append(factor)
        codes.append(code)
    return Data(
        response=bare(column),
        unit=unit(column),
        values=np.array([_number(row[column], path, column) for row in rows]),
        errors=np.array([_error(row, column, path) for row in rows]),
        factors=tuple(found),
        codes=np.array(codes, dtype=np.intp).T,
        dropped=len(table.rows) - len(rows),
        analysis=plan.get("design", {}).get("analysis"),
    )


def _check_labels(labels: Mapping[str, str], names: Sequence[str]) -> None:
    known = [bare(name) for name in names]
    for name in labels:
        if name not in known:
            raise InputError(f'no factor "{name}"', where="labels", remedy=f"factors are {', '.join(known)}")


@dataclass(frozen=True, slots=True)
class _Named:
    name: str


@dataclass(frozen=True, slots=True)
class _FactorPlan:
    name: str
    label: str
    levels: list[_Named]


@dataclass(frozen=True, slots=True)
class _DesignPlan:
    factors: list[_FactorPlan]
    analysis: Literal["lenth", "anova", "none"] | None


@dataclass(frozen=True, slots=True)
class _Plan:
    design: _DesignPlan


def _plan(folder: Path) -> Mapping[str, Any]:
    """What the study is whose table lies there; empty where it is none."""
    if not (folder / PLAN).is_file():
        return {}
    plan = read_manifest(folder / PLAN)
    read_back(plan, _Plan, str(folder / PLAN))
    return plan


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
    if why := unusable(value):
        raise InputError(
            f'"{text}" {"is not a finite number" if math.isnan(value) else why}', where=f"{path}: {column}"
        )
    return value


def _error(row: Mapping[str, str], column: str, path: Path) -> float:
    name = column.replace(bare(column), f"{bare(column)}_error", 1)
    return _number(row[name], path, name) if row.get(name) else 0.0


def _factor(
    name: str, cells: Sequence[str], label: str, design: Sequence[str], path: Path
) -> tuple[FactorLevels, list[int]]:
    """The levels of a column in their order, and the number of each cell's."""
    seen = list(dict.fromkeys(cells))
    if "" in seen:
        raise InputError("has an empty cell", where=f"{path}: {name}")
    numbers = {level: _value(level) for level in seen}
    known = sorted({number for number in numbers.values() if number is not None})
    if None not in numbers.values():
        first = {number: next(level for level in seen if numbers[level] == number) for number in known}
        factor = FactorLevels(name, label, tuple(first.values()), tuple(known))
        codes = [known.index(float(numbers[cell] or 0.0)) for cell in cells]
    else:
        order = _ordered(seen, design)
        factor = FactorLevels(name, label, tuple(order), None)
        codes = [order.index(cell) for cell in cells]
    if len(factor.levels) < 2:
        raise InputError(f'has one level only, "{seen[0]}"', where=f"{path}: {name}", remedy="leave it out")
    return factor, codes


def _ordered(words: Sequence[str], design: Sequence[str]) -> list[str]:
    """Words for low and high as they say, others as the design lists them, all else by the alphabet."""
    order = sorted(words, key=lambda word: (design.index(word) if word in design else len(design), word))
    if len(order) == 2 and order[0].lower() in _WORDS[1] and order[1].lower() in _WORDS[0]:
        order.reverse()
    return order


def _value(cell: str) -> float | None:
    """A level as a number in SI; None for words."""
    try:
        value = float(cell)
    except ValueError:
        try:
            value = in_si(cell) if " " in cell else None  # type: ignore[assignment]
        except InputError:
            return None
    return value if value is not None and unusable(value) is None else None
