"""What a number, a switch or a choice among names may be where a caller in Python gives it.

NumPy's numbers are as good as Python's, and become those: a manifest holds
them as JSON.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError

_TOLD: Final = 10**30  # nobody reads longer numbers, and Python refuses to write those of thousands of digits


def number_of(value: Any, where: str, low: float, high: float, *, whole: bool) -> int | float:
    """A number between two limits.

    Raises
    ------
    InputError
        If it is none, or lies beyond.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise InputError(f"must be a number, not {value!r}", where=where)
    found = int(value) if isinstance(value, Integral) else float(value)
    if not low <= found <= high:
        told = f", not {value}" if abs(found) < _TOLD else ""
        raise InputError(f"must lie between {low:g} and {high:g}{told}", where=where)
    if isinstance(found, int):
        return found
    if not whole:
        return found
    if math.floor(found) != found:
        raise InputError(f"must be a whole number, not {value}", where=where)
    return int(found)


def choice_of(value: Any, where: str, choices: Sequence[str], *, otherwise: str = "") -> str:
    """One of some names; `otherwise` is what else the message says that it may be.

    Raises
    ------
    InputError
        If it is none of them.
    """
    if not isinstance(value, str) or value not in choices:
        known = ", ".join(f'"{name}"' for name in choices)
        raise InputError(f"must be one of {known}{otherwise}, not {value!r}", where=where)
    return value


def switch_of(value: Any, where: str) -> bool:
    """True or False.

    Raises
    ------
    InputError
        If it is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"must be True or False, not {value!r}", where=where)
    return bool(value)
