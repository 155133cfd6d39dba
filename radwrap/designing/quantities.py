"""What a design makes small or large, or keeps within limits: responses, and what a scene tells without a ray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.scene.scene import Scene
from radwrap.study.responses import Response
from radwrap.study.seen import Answer
from radwrap.units import DIMENSIONS, TIME, parse_quantity

PEAK: Final = "peak_gray"
TIME_OF_EXPOSURE: Final = "exposure_time"
LEDS: Final = "leds"
COST: Final = "cost"
SCENES_OWN: Final = (TIME_OF_EXPOSURE, LEDS, COST)  # known of a scene, and of choices, without a ray

# Combined standard errors by which two values differ where they are no tie: half way to four, so that values that are
# equal and values that differ by four are taken for the other alike rarely, in 2.3 % of the cases.
TIE: Final = 2.0
_WRITTEN: Final = 1e-8  # of a value: scenes hold nine digits


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number that every trial has.

    Attributes
    ----------
    name : str
        Of a response, or one of `SCENES_OWN`.
    unit : str
        In which it is told; empty for a bare number.
    scale : float
        Size of the unit in SI.
    dimension : str
        Name of its limits' dimension; empty of a bare number, and of what the user's own code gives.
    """

    name: str
    unit: str = ""
    scale: float = 1.0
    dimension: str = ""

    def told(self, value: float) -> str:
        """A value for people."""
        return f"{value / self.scale:.6g} {self.unit}".strip()


@dataclass(frozen=True, slots=True)
class Objective:
    """A quantity that is to become small, or large."""

    quantity: Quantity
    is_maximised: bool

    @property
    def sign(self) -> float:
        """Factor that makes small what is wanted."""
        return -1.0 if self.is_maximised else 1.0


@dataclass(frozen=True, slots=True)
class Constraint:
    """Limits of a quantity, in SI; infinite where there is none."""

    quantity: Quantity
    low: float = -math.inf
    high: float = math.inf

    def excess(self, value: float) -> float:
        """How far a value lies outside, in SI; 0 within, and beyond by no more than the digits of a scene explain."""
        beyond = max(0.0, self.low - value, value - self.high)
        return beyond if beyond > _WRITTEN * abs(self.low if value < self.low else self.high) else 0.0

    def violation(self, value: float) -> float:
        """The same, as a share of the limit that it breaks; what a search compares."""
        excess = self.excess(value)
        limit = abs(self.low if value < self.low else self.high)
        return excess / limit if excess and limit else excess

    def told(self) -> str:
        """For people."""
        low, high = self.quantity.told(self.low), self.quantity.told(self.high)
        if math.isinf(self.high):
            return f"{self.quantity.name} at least {low}"
        return (
            f"{self.quantity.name} at most {high}" if math.isinf(self.low) else f"{self.quantity.name} {low} to {high}"
        )


def quantity_of(name: str, responses: Sequence[Response], where: str = "") -> Quantity:
    """The quantity of a name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name == TIME_OF_EXPOSURE:
        return Quantity(name, "ms", TIME.units["ms"], TIME.name)
    if name in SCENES_OWN:
        return Quantity(name)
    found = next((one for one in responses if one.name == name), None)
    if found is None:
        known = [*(one.name for one in responses), PEAK, *SCENES_OWN]
        raise InputError(
            f'"{name}" is not a response of this file',
            where=where,
            remedy=did_you_mean(name, known) or f"known are {', '.join(known)}",
        )
    return Quantity(name, found.unit, found.scale, found.dimension.name if found.dimension else "")


def limits_of(quantity: Quantity, low: Any, high: Any, where: str) -> tuple[float, float]:
    """Limits as the design file writes them, in SI.

    Raises
    ------
    InputError
        If one is not a number of that kind, or they cross.
    """
    least = -math.inf if low is None else _limit(quantity, low, f"{where}.at_least")
    most = math.inf if high is None else _limit(quantity, high, f"{where}.at_most")
    if least > most:
        raise InputError("at_least lies above at_most", where=where)
    return least, most


def _limit(quantity: Quantity, value: Any, where: str) -> float:
    dimension = next((one for one in DIMENSIONS if one.name == quantity.dimension), None)
    if dimension is not None:
        try:
            return parse_quantity(value, dimension)
        except InputError as error:
            raise InputError(error.what, where=where, remedy=error.remedy) from error
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"must be a number, not {value!r}", where=where)
    return float(value)


def scenes_own(scene: Scene, cost: float) -> dict[str, Answer]:
    """What is known of a scene without a ray; it has no error."""
    shining = {one.source for one in scene.emitters if one.radiance > 0}  # patches of a wide source are one
    return {
        TIME_OF_EXPOSURE: Answer(scene.camera.exposure_time, 0.0),
        LEDS: Answer(float(len(shining)), 0.0),
        COST: Answer(cost, 0.0),
    }


def combined(first: Answer, second: Answer) -> float:
    """Standard error of a difference, the errors taken as independent."""
    return math.hypot(first.error, second.error)


def is_tie(first: Answer, second: Answer) -> bool:
    """Whether two values differ by no more than their errors may explain."""
    return abs(first.value - second.value) <= TIE * combined(first, second)
