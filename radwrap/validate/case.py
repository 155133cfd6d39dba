"""One line of the score card."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.manifest import finite
from radwrap.validate.bench import Bench

Array = NDArray[np.float64]
Measure = Literal["relative", "absolute", "below", "at least"]
_TINY: Final = 1e-300


@dataclass(frozen=True, slots=True)
class Case:
    """What was expected, what came out, and whether that will do.

    Attributes
    ----------
    name : str
        Unique on the card.
    source : str
        Where the reference comes from.
    reference, ours : float or None
        Expected and found value; None where nothing was found.
    limit : float
        Of the error, as validation asks for; for "at least" the smallest value.
    measure : str
        What the error is: "relative" |ours/reference - 1|, "absolute" |ours - reference|, "below" and "at least" the
        value itself.
    note : str
        What a reader should know, or why there is no value.
    """

    name: str
    source: str
    reference: float | None
    ours: float | None
    limit: float
    measure: Measure = "relative"
    note: str = ""

    @property
    def error(self) -> float | None:
        """Error as `measure` says; None where there is no value."""
        if self.ours is None or self.reference is None or not math.isfinite(self.ours):
            return None
        match self.measure:
            case "relative":
                return float(abs(self.ours - self.reference) / max(abs(self.reference), _TINY))
            case "absolute":
                return float(abs(self.ours - self.reference))
        return float(self.ours)

    @property
    def passed(self) -> bool:
        """Whether the error keeps the limit; what has no value does not."""
        error = self.error
        if error is None:
            return False
        return bool(error >= self.limit if self.measure == "at least" else error <= self.limit)

    def as_json(self) -> dict[str, Any]:
        """Its values by name."""
        return {
            "name": self.name,
            "source": self.source,
            "reference": self.reference,
            "ours": None if self.ours is None else finite(float(self.ours)),
            "error": self.error,
            "limit": self.limit,
            "pass": self.passed,
            "measure": self.measure,
            **({"note": self.note} if self.note else {}),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Curves for the report.

    Attributes
    ----------
    title, x_label, y_label : str
        What is shown.
    curves : Mapping[str, tuple of ndarray]
        Label -> x and y; a label that begins with "limit" or "reference" is drawn as a line.
    log : str
        Axes that are logarithmic: "", "x", "y" or "xy".
    """

    title: str
    x_label: str
    y_label: str
    curves: Mapping[str, tuple[Array, Array]]
    log: str = ""


Finding = Case | Plot


@dataclass(frozen=True, slots=True)
class Check:
    """Some cases that are found together.

    Attributes
    ----------
    name : str
        Such as "4.uniform_field"; its cases' names begin with it.
    cases : tuple of str
        Names of all its cases: one that does not come out is a miss.
    run : callable
        From a bench to cases and plots.
    """

    name: str
    cases: tuple[str, ...]
    run: Callable[[Bench], Iterator[Finding]]


class Missing(Exception):
    """A case needs what this radwrap cannot do."""
