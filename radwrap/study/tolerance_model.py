"""What a study's runs say of small changes: a polynomial of each factor, and how far each may go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.random_streams import Studying, generator
from radwrap.scene.file.keys import found
from radwrap.scene.file.load import scene_from_document
from radwrap.study.design import Design
from radwrap.study.factors import Factor, Level, in_si, number_and_unit, written

Array = NDArray[np.float64]

_STEPS: Final = 4000  # in which the range is searched for the first place beyond the bounds
_DRAWS: Final = 20_000


@dataclass(frozen=True, slots=True)
class Deviation:
    """A factor that may lie off its nominal value.

    Attributes
    ----------
    factor : Factor
    unit : str
        In which its first key is written.
    nominal, low, high : float
        Nominal value, and the range that the study looked at, in `unit`.
    from_scene : bool
        Whether the nominal value is the base scene's; else it is the first level's, or the middle of the range.
    """

    factor: Factor
    unit: str
    nominal: float
    low: float
    high: float
    from_scene: bool = True

    @property
    def sides(self) -> tuple[float, ...]:
        """Directions in which it may be off: both, or the one that the study looked at."""
        return tuple(
            side for side, reach in ((-1.0, self.nominal - self.low), (1.0, self.high - self.nominal)) if reach > 0
        )

    @property
    def reach(self) -> float:
        """How far the study looked from the nominal value, the nearer side."""
        return min(abs(end - self.nominal) for end in (self.low, self.high) if end != self.nominal)

    @property
    def half(self) -> float:
        """Half of the range: the unit of the model's variable."""
        return (self.high - self.low) / 2

    def level(self, value: float) -> Level:
        """The factor at a value of its first key; its other keys go along in proportion."""
        first = written(value, self.unit)
        if self.factor.span is not None:
            return Level(str(first), (first,) * len(self.factor.keys))
        a, b = self.factor.levels[0], self.factor.levels[-1]
        start, end = _numbers(a.values[0])[0], _numbers(b.values[0])[0]
        share = (value - start) / (end - start)
        others = [_between(x, y, share) for x, y in zip(a.values[1:], b.values[1:], strict=True)]
        return Level(str(first), (first, *others))


def _numbers(value: Any) -> tuple[float, str]:
    known = number_and_unit(value)
    if known is None:
        raise InputError(f"{value!r} is not a number")
    return known


def _between(first: Any, second: Any, share: float) -> Any:
    (a, unit), (b, _) = _numbers(first), _numbers(second)
    return written(a + share * (b - a), unit)


def deviation_of(design: Design, factor: Factor) -> Deviation | None:
    """The factor as something that may be off; None where it has words, draws, or options of a measurement.

    Raises
    ------
    InputError
        If the base scene's value lies outside of what the study looks at.
    """
    if factor.span is not None:
        ends, unit = list(factor.span), factor.unit
    else:
        values = [[_known(value) for value in level.values] for level in factor.levels]
        units = [{None if value is None else value[1] for value in column} for column in zip(*values, strict=True)]
        if any(len(unit) != 1 or None in unit for unit in units):
            return None
        first = [column[0] for column in values]
        ends, unit = [value[0] for value in first if value is not None], str(next(iter(units[0])))
        if len(set(ends)) < len(ends):
            return None
    if factor.keys[0].startswith(("render.", "responses.")):
        return None
    low, high = min(ends), max(ends)
    nominal = _nominal(design, factor, unit)
    if nominal is None:
        return Deviation(factor, unit, ends[0] if factor.levels else (low + high) / 2, low, high, from_scene=False)
    if not low <= nominal <= high:
        written_range = f"{written(low, unit)} to {written(high, unit)}"
        raise InputError(
            f"the base scene's {written(nominal, unit)} lies outside of what the study looks at, {written_range}",
            where=f"{design.origin}: factors.{factor.name}",
            remedy="tolerances are about the base scene: widen the factor, or set another value in [set]",
        )
    return Deviation(factor, unit, nominal, low, high)


def _known(value: Any) -> tuple[float, str] | None:
    try:
        return number_and_unit(value)
    except InputError:
        return None


def _nominal(design: Design, factor: Factor, unit: str) -> float | None:
    """The base scene's value of the first key, in a unit; None where the scene says nothing."""
    key = factor.keys[0].replace("[*]", "[0]")
    given = found(design.document, key)
    if given is None:
        scene = scene_from_document(design.document, origin=design.scene_origin, folder=design.folder)
        given = dict(scene.assumed).get(key)
    value, size = _si(given), in_si(f"1 {unit}" if unit else 1.0)
    return None if value is None or not size else float(f"{value / size:.12g}")


def _si(given: Any) -> float | None:
    """A value as the scene holds it, or as its list of what it assumed shows it, in SI."""
    if isinstance(given, str) and " " not in given:
        try:
            return float(given)
        except ValueError:
            return None
    return in_si(given)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A polynomial of second degree at most in the deviations, the other factors as they are nominally.

    Attributes
    ----------
    deviations : tuple of Deviation
    powers : tuple of tuple of int
        Of each term: the exponent of each deviation's variable, (value - nominal)/half.
    coefficients : ndarray
        Of each term, in the response's unit.
    """

    deviations: tuple[Deviation, ...]
    powers: tuple[tuple[int, ...], ...]
    coefficients: Array

    def change(self, x: Array) -> Array:
        """Change of the response from its nominal value at variables of the shape (n, deviations)."""
        terms = [
            coefficient * np.prod(x ** np.array(power), axis=1)
            for power, coefficient in zip(self.powers, self.coefficients, strict=True)
            if any(power)
        ]
        total: Array = np.sum(terms, axis=0) if terms else np.zeros(len(x))
        return total

    def reach(self, number: int, bound: float) -> float:
        """Largest deviation of one factor alone, in its unit, up to which the change stays within the bound."""
        deviation = self.deviations[number]
        sizes = np.linspace(0, deviation.reach / deviation.half, _STEPS + 1)
        worst = np.zeros(len(sizes))
        for side in deviation.sides:
            x = np.zeros((len(sizes), len(self.deviations)))
            x[:, number] = side * sizes
            worst = np.maximum(worst, np.abs(self.change(x)))
        if (worst <= bound).all():
            return deviation.reach
        out = int(np.argmax(worst > bound))
        # Between two steps it is as good as straight; at size 0 there is no change.
        share = (bound - worst[out - 1]) / (worst[out] - worst[out - 1])
        return float((sizes[out - 1] + share * (sizes[out] - sizes[out - 1])) * deviation.half)

    def share_inside(self, tolerances: Sequence[float], bound: float) -> float:
        """Share of systems within the bound, each deviation drawn evenly within its tolerance."""
        random = generator(Studying.TOLERANCE_MODEL)
        x = np.empty((_DRAWS, len(self.deviations)))
        for number, (deviation, tolerance) in enumerate(zip(self.deviations, tolerances, strict=True)):
            low = -tolerance if -1.0 in deviation.sides else 0.0
            high = tolerance if 1.0 in deviation.sides else 0.0
            x[:, number] = random.uniform(low, high, _DRAWS) / deviation.half
        return float((np.abs(self.change(x)) <= bound).mean())


def _power(count: int, *numbers: int) -> tuple[int, ...]:
    return tuple(numbers.count(k) for k in range(count))


def fit(design: Design, deviations: tuple[Deviation, ...], rows: Sequence[Mapping[str, str]], column: str) -> Model:
    """Fit the model to the rows of a study.

    Raises
    ------
    InputError
        If the rows cannot tell the factors apart.
    """
    good = [row for row in rows if row[column]]
    if not good:
        raise InputError("no run of the study has this response", where=column)
    x = np.array([[_variable(d, row) for d in deviations] for row in good])
    y = np.array([float(row[column]) for row in good])
    count = len(deviations)
    powers = [_power(count)] + [_power(count, k) for k in range(count)]
    others = _others(design, deviations, good)
    squares = [_power(count, k, k) for k in range(count) if len(np.unique(x[:, k])) > 2]
    products = [_power(count, a, b) for a, b in combinations(range(count), 2)]
    for more in (*squares, *products):
        if np.linalg.matrix_rank(_terms(x, [*powers, more], others)) == len(powers) + 1 + others.shape[1]:
            powers.append(more)
    design_matrix = _terms(x, powers, others)
    if np.linalg.matrix_rank(design_matrix) < design_matrix.shape[1]:
        raise InputError("the runs of the study cannot separate the factors", where=design.origin)
    solution = np.linalg.lstsq(design_matrix, y, rcond=None)[0]
    return Model(deviations, tuple(powers), solution[: len(powers)])


def _terms(x: Array, powers: Sequence[tuple[int, ...]], others: Array) -> Array:
    return np.column_stack([*(np.prod(x ** np.array(power), axis=1) for power in powers), others])


def _variable(deviation: Deviation, row: Mapping[str, str]) -> float:
    name = row[deviation.factor.name]
    level = next((level for level in deviation.factor.levels if level.name == name), None)
    value = _numbers(name if level is None else level.values[0])[0] if level or " " in name else float(name)
    return (value - deviation.nominal) / deviation.half


def _others(design: Design, deviations: tuple[Deviation, ...], rows: Sequence[Mapping[str, str]]) -> Array:
    """A column for each level but the first of each other factor."""
    known = {deviation.factor.name for deviation in deviations}
    columns = [
        [float(row[factor.name] == level.name) for row in rows]
        for factor in design.factors
        if factor.name not in known
        for level in factor.levels[1:]
    ]
    return np.array(columns).reshape(len(columns), len(rows)).T
