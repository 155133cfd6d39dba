"""Keys of a scene that a design may change: between bounds, in steps, or by choice.

A search knows a value by its code: the number itself between bounds, else the number of the step or the choice.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Final

from radwrap.designing.tables import KeyModel
from radwrap.errors import InputError
from radwrap.study.factors import quantity, written

Code = float | int

_MOST_STEPS: Final = 100_000
_WHOLE_STEPS: Final = 1e-6  # of a step: so near the upper bound a step counts as being on it
_COST: Final = 1e12
# What only scales the light of a source; its sum over sources is linear.
_LEVEL: Final = re.compile(
    r"sources\[(\d{1,9}|\*)\]\.(radiance|radiant_intensity|leds\[(?:\d{1,9}|\*)\]\.radiance_factor)"
)


@dataclass(frozen=True, slots=True)
class Span:
    """All values between two bounds.

    Attributes
    ----------
    low, high : float
        In `unit`.
    unit : str
        As the scene's file has it; empty for a bare number.
    is_log : bool
        Whether equal ratios count as equal steps.
    """

    low: float
    high: float
    unit: str
    is_log: bool = False

    @property
    def is_whole(self) -> bool:
        """Whether both bounds are whole numbers without a unit."""
        return not self.unit and self.low.is_integer() and self.high.is_integer()

    def written(self, code: Code) -> Any:
        """The value as the scene's file would hold it."""
        return written(float(code), self.unit)


@dataclass(frozen=True, slots=True)
class SearchKey:
    """Something that a design changes.

    Attributes
    ----------
    name : str
        Column of the table.
    keys : tuple of str
        Key paths of the scene that it sets; all entries of ``[*]`` are set alike.
    span : Span, optional
        Where any value between two bounds may be taken.
    choices : tuple of tuple
        Else the values for `keys`, of each choice or step.
    costs : tuple of float
        Of each choice; empty where they cost nothing.
    labels : tuple of str
        Of each choice or step, for people.
    is_ordered : bool
        Whether choices are steps, whose neighbours are alike.
    """

    name: str
    keys: tuple[str, ...]
    span: Span | None = None
    choices: tuple[tuple[Any, ...], ...] = ()
    costs: tuple[float, ...] = ()
    labels: tuple[str, ...] = ()
    is_ordered: bool = False

    @property
    def names_leds(self) -> bool:
        """Whether it sets something of single LEDs: their number must be known before."""
        return any(".leds[" in key for key in self.keys)

    @property
    def is_level(self) -> bool:
        """Whether it only scales the light of sources, and may take any value between two bounds."""
        return self.span is not None and all(_LEVEL.fullmatch(key) for key in self.keys)

    def values(self, code: Code) -> tuple[Any, ...]:
        """A value for each of `keys`, as the scene's file would hold it."""
        if self.span is not None:
            return (self.span.written(code),) * len(self.keys)
        return self.choices[int(code)]

    def label(self, code: Code) -> str:
        """The value for people."""
        return str(self.span.written(code)) if self.span is not None else self.labels[int(code)]

    def cost(self, code: Code) -> float:
        """What the choice costs."""
        return self.costs[int(code)] if self.costs else 0.0

    def ends(self) -> tuple[Code, ...]:
        """Codes to be held against the scene before the first ray: bounds, or every choice; of levels the high bound.

        A scene in which no source shines is refused, and levels may fall to 0.
        """
        if self.span is None:
            last = len(self.choices) - 1
            return (0, last) if self.is_ordered else tuple(range(last + 1))
        return (self.span.high,) if self.is_level else (self.span.low, self.span.high)


# Of two objectives, levels are solved for one within a limit of the other: so far that limit goes from where the first
# objective alone leads to the best of the other.
STEPS_OF_BALANCE: Final = 9
BALANCE: Final = SearchKey(
    "balance",
    (),
    choices=((),) * STEPS_OF_BALANCE,
    labels=tuple(f"{100 * step / (STEPS_OF_BALANCE - 1):g} %" for step in range(STEPS_OF_BALANCE)),
    is_ordered=True,
)


def read_key(name: str, told: KeyModel, where: str) -> SearchKey:
    """A key as the design file writes it.

    Raises
    ------
    InputError
        If bounds, steps or choices make no sense.
    """
    if not name.isidentifier():
        raise InputError("cannot name a column", where=where, remedy="use letters, digits and _")
    keys = (told.key,) if told.key is not None else told.keys or ()
    if told.choices is not None:
        return _chosen(name, keys, told, where)
    low, high = _bound(told.low, f"{where}.low"), _bound(told.high, f"{where}.high")
    if low[1] != high[1]:
        raise InputError(
            f"low and high have different units, {_unit(low)} and {_unit(high)}",
            where=where,
            remedy="write both in the unit that the scene's file has",
        )
    if not low[0] < high[0]:
        raise InputError("low must lie below high", where=where)
    if told.scale == "log" and low[0] <= 0:
        raise InputError("a logarithm needs bounds above zero", where=f"{where}.scale")
    span = Span(low[0], high[0], low[1], told.scale == "log")
    return SearchKey(name, keys, span) if told.step is None else _stepped(name, keys, span, told.step, where)


def _bound(value: Any, where: str) -> tuple[float, str]:
    """Number and unit."""
    found = quantity(value, where)
    if found is None:
        raise InputError("must be a number, or a number with a unit", where=where, remedy='such as 3 or "3 mm"')
    return found


def _unit(bound: tuple[float, str]) -> str:
    return bound[1] or "none"


def _chosen(name: str, keys: tuple[str, ...], told: KeyModel, where: str) -> SearchKey:
    choices = []
    for number, given in enumerate(told.choices or ()):
        values = given if told.keys is not None else [given]
        if not isinstance(values, list) or len(values) != len(keys):
            raise InputError(f"needs a value for each of the {len(keys)} keys", where=f"{where}.choices[{number}]")
        choices.append(tuple(values))
    labels = tuple(", ".join(map(str, values)) for values in choices)
    if len(set(labels)) < len(labels):
        raise InputError("names a choice twice", where=f"{where}.choices")
    costs: tuple[float, ...] = ()
    if told.cost is not None:
        if len(told.cost) != len(choices) or not all(_is_cost(one) for one in told.cost):
            raise InputError(f"must be {len(choices)} numbers of 0 or more, one for each choice", where=f"{where}.cost")
        costs = tuple(map(float, told.cost))
    return SearchKey(name, keys, None, tuple(choices), costs, labels)


def _is_cost(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= _COST


def _stepped(name: str, keys: tuple[str, ...], span: Span, step: Any, where: str) -> SearchKey:
    found = quantity(step, f"{where}.step")
    if found is None or found[1] != span.unit or not found[0] > 0:
        raise InputError("must be above zero, in the unit of low and high", where=f"{where}.step")
    count = math.floor((span.high - span.low) / found[0] + _WHOLE_STEPS) + 1
    if not 2 <= count <= _MOST_STEPS:
        raise InputError(f"gives {count} values between low and high", where=f"{where}.step", remedy="change the step")
    # Whole numbers stay whole: a number of LEDs is 12 and not 12.0.
    are_whole = not span.unit and all(float(one).is_integer() for one in (span.low, found[0]))
    numbers = [span.low + number * found[0] for number in range(count)]
    values = [int(one) if are_whole else written(one, span.unit) for one in numbers]
    return SearchKey(name, keys, None, tuple((one,) for one in values), (), tuple(map(str, values)), True)
