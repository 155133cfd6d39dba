"""The numbers of a luminaire file (IES LM-63): ies2rad believes them all, so they are looked at before it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

_TYPES: Final = {1: "C", 2: "B", 3: "A"}
_UNITS: Final = (1, 2)  # feet, metres
_MOST_ANGLES: Final = 10_000
# Far beyond any lamp [cd].
_BRIGHTEST: Final = 1e12


def fault_of_numbers(text: str, *, tilted: bool) -> str | None:
    """What is wrong with the numbers below the TILT line, or None.

    Parameters
    ----------
    text : str
        All that stands below it; commas are blanks there.
    tilted : bool
        Whether the tilt's own table comes first.
    """
    try:
        numbers = iter([_number(word) for word in text.replace(",", " ").split()])
        _check(numbers, tilted=tilted)
    except StopIteration:
        return "it ends too early"
    except ValueError as error:
        return str(error)
    left = sum(1 for _ in numbers)
    return f"{left} numbers follow its last candela value" if left else None


def _number(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f'"{word[:40]}" is not a number')
    return value


def _check(numbers: Iterator[float], *, tilted: bool) -> None:
    if tilted:
        next(numbers)  # how the lamp lies in the luminaire
        number = _count(next(numbers), "tilt angles")
        _check_angles(_taken(numbers, number), 180, "tilt angles")
        if min(_taken(numbers, number)) < 0:
            raise ValueError("a tilt's factor is negative")
    _, _, multiplier, vertical, horizontal, kind, unit, *_ = _taken(numbers, 10)
    ballast, future, _ = _taken(numbers, 3)
    number, columns = _count(vertical, "vertical angles"), _count(horizontal, "horizontal angles")
    if kind != 1:
        raise ValueError(f"its photometry is of type {_TYPES.get(int(kind), 'unknown')}; only type C is read")
    if unit not in _UNITS:
        raise ValueError(f"its unit of length is {unit:g}, neither 1 (feet) nor 2 (metres)")
    if min(multiplier, ballast, future) <= 0:
        raise ValueError("a multiplier is not above 0")
    _check_angles(_taken(numbers, number), 180, "vertical angles")
    _check_angles(_taken(numbers, columns), 360, "horizontal angles")
    candela = _taken(numbers, number * columns)
    if min(candela) < 0 or max(candela) * multiplier * ballast * future > _BRIGHTEST:
        raise ValueError(f"candela values must lie between 0 and {_BRIGHTEST:g}")


def _taken(numbers: Iterator[float], number: int) -> list[float]:
    return [next(numbers) for _ in range(number)]


def _count(value: float, what: str) -> int:
    if not 1 <= value <= _MOST_ANGLES or value != int(value):
        raise ValueError(f"the number of {what} must lie between 1 and {_MOST_ANGLES}, not {value:g}")
    return int(value)


def _check_angles(angles: list[float], largest: float, what: str) -> None:
    if not all(before < after for before, after in pairwise(angles)) or angles[0] < 0 or angles[-1] > largest:
        raise ValueError(f"{what} must increase from 0 or more to at most {largest:g}")
