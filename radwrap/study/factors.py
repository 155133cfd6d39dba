"""What a study varies: factors, their levels, and what a level writes into scene, render or measurement.

A level is a value as the scene file would hold it, a list of values where the factor has several keys, or a draw::

    { uniform = ["0.1 deg", "1.9 deg"] }        between two values
    { normal = ["7.6 deg", "0.2 deg"] }         mean and standard deviation

A key may hold ``[*]`` for every entry of a list; a draw is then made for each entry.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.random_streams import generator
from radwrap.scene.file.keys import expanded
from radwrap.units import dimension_of, parse_gain, parse_quantity

_DRAWS: Final = ("uniform", "normal")
_GAIN: Final = " (J/m^2)^-"  # in the unit of a sensor's gain, which holds gamma
_DIGITS: Final = 9  # of drawn and interpolated values, so that a table shows what was rendered


@dataclass(frozen=True, slots=True)
class Draw:
    """A value that is drawn anew.

    Attributes
    ----------
    distribution : str
        "uniform": between `first` and `second`; "normal": mean and standard deviation.
    first, second : float
        In `unit`.
    unit : str
        Empty for a bare number.
    """

    distribution: str
    first: float
    second: float
    unit: str

    def value(self, random: np.random.Generator) -> Any:
        """One value, as the scene file would hold it."""
        drawn = random.uniform if self.distribution == "uniform" else random.normal
        return written(float(drawn(self.first, self.second)), self.unit)

    @property
    def mean(self) -> Any:
        """Its mean, as the scene file would hold it."""
        return written((self.first + self.second) / 2 if self.distribution == "uniform" else self.first, self.unit)

    @property
    def ends(self) -> tuple[Any, Any]:
        """Two values it may take, to be checked beforehand: the limits, or one standard deviation off the mean."""
        low, high = self.first, self.second
        if self.distribution == "normal":
            low, high = self.first - self.second, self.first + self.second
        return written(low, self.unit), written(high, self.unit)

    def __str__(self) -> str:
        return f"{self.distribution}({written(self.first, self.unit)}, {written(self.second, self.unit)})"


@dataclass(frozen=True, slots=True)
class Level:
    """What a factor may be set to.

    Attributes
    ----------
    name : str
        As tables show it.
    values : tuple
        A scene's value or a `Draw` for each key of the factor.
    """

    name: str
    values: tuple[Any, ...]

    @property
    def is_random(self) -> bool:
        """Whether it draws."""
        return any(isinstance(value, Draw) for value in self.values)


@dataclass(frozen=True, slots=True)
class Factor:
    """One thing that a study varies.

    Attributes
    ----------
    name : str
        Short, such as "A".
    label : str
        What it is, for people.
    keys : tuple of str
        What it sets: keys of the scene, ``render.OPTION`` or ``responses.NAME.OPTION``.
    levels : tuple of Level
        What it may be; empty where it has a range.
    span : tuple of float, optional
        Lowest and highest value of a Latin hypercube, in `unit`.
    unit : str
        Of the span.
    draw_once : bool
        Whether all runs of a replicate share what is drawn; else each draws its own.
    """

    name: str
    label: str
    keys: tuple[str, ...]
    levels: tuple[Level, ...]
    span: tuple[float, float] | None = None
    unit: str = ""
    draw_once: bool = False

    def level_at(self, share: float) -> Level:
        """The level at a share of the span, 0 its lowest value."""
        assert self.span is not None  # noqa: S101  (only asked of a factor with a range)
        low, high = self.span
        value = written(low + share * (high - low), self.unit)
        return Level(str(value), (value,) * len(self.keys))

    def random(self, seed: int, replicate: int, row: int) -> np.random.Generator:
        """Where its draws for a run come from; the same whatever else the study varies."""
        name = zlib.crc32(self.name.encode())
        return generator(seed, replicate, name, *(() if self.draw_once else (row,)))


def written(value: float, unit: str) -> Any:
    """A number as the scene file would hold it."""
    rounded = float(f"{value:.{_DIGITS}g}")
    return f"{rounded!r} {unit}" if unit else rounded


def number_and_unit(value: Any) -> tuple[float, str] | None:
    """Number and unit of a scene's value, None where it is neither a number nor a quantity.

    Raises
    ------
    InputError
        If it is a number beyond those that a computer holds, or not finite.
    """
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return _number(value), ""
    if isinstance(value, str) and _GAIN in value:
        parse_gain(value)
    else:
        dimension = dimension_of(value)
        if dimension is None:
            return None
        parse_quantity(value, dimension)  # so that "1e999 mm" is none
    number, _, unit = str(value).partition(" ")
    return float(number), unit


def quantity(value: Any, where: str) -> tuple[float, str] | None:
    """As `number_and_unit`; errors name the place."""
    try:
        return number_and_unit(value)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def _number(value: float) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError("is not a number that a computer holds")
    return number


def in_si(value: Any) -> float | None:
    """A number, or a quantity in SI; None for all else."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return _number(value)
    if isinstance(value, str) and _GAIN in value:
        return parse_gain(value)[0]
    dimension = dimension_of(value)
    return None if dimension is None else parse_quantity(value, dimension)


def read_draw(table: Mapping[str, Any], where: str) -> Draw:
    """A draw as the design file writes it.

    Raises
    ------
    InputError
        If it is none.
    """
    if len(table) != 1 or next(iter(table)) not in _DRAWS:
        raise InputError(
            "is not a draw", where=where, remedy='write { uniform = ["1 deg", "2 deg"] } or { normal = ... }'
        )
    ((kind, pair),) = table.items()
    if not isinstance(pair, list) or len(pair) != 2:
        raise InputError(f"{kind} needs two values", where=where)
    low, high = (quantity(end, where) for end in pair)
    if low is None or high is None or low[1] != high[1]:
        raise InputError(f"{kind} needs two numbers, or two quantities of the same unit", where=where)
    (first, unit), (second, _) = low, high
    if kind == "uniform" and not first < second:
        raise InputError("uniform needs the lower value first", where=where)
    if kind == "normal" and second <= 0:
        raise InputError("normal needs a standard deviation above zero", where=where)
    return Draw(kind, first, second, unit)


def settings(
    factor: Factor, level: Level, document: Mapping[str, Any], random: np.random.Generator
) -> Iterator[tuple[str, Any]]:
    """Key path and value of everything that a level sets; draws are made in the order of the list's entries."""
    places = [expanded(key, document) for key in factor.keys]
    counts = {len(paths) for paths in places} - {1}
    if len(counts) > 1:
        raise InputError("its keys name lists of different length", where=f"factors.{factor.name}")
    for entry in range(max(counts, default=1)):
        for paths, value in zip(places, level.values, strict=True):
            if entry < len(paths):
                yield paths[entry], value.value(random) if isinstance(value, Draw) else value
