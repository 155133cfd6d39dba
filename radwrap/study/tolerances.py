"""Bounds, tolerances, and what fresh renders say of them."""

from __future__ import annotations

from dataclasses import dataclass

from radwrap.study.factors import Factor
from radwrap.study.responses import Response


@dataclass(frozen=True, slots=True)
class Bound:
    """What a response may change by, in its unit."""

    response: Response
    relative: float | None
    absolute: float | None

    def at(self, nominal: float) -> float:
        """The largest change."""
        return self.absolute if self.absolute is not None else abs(nominal) * (self.relative or 0.0)


@dataclass(frozen=True, slots=True)
class Confirmed:
    """Change of the response at a deviation, by fresh renders: mean over seeds, and its standard error.

    The error is None where one seed tells none.
    """

    at: str
    change: float
    error: float | None


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What one factor alone may be off by.

    Attributes
    ----------
    factor : Factor
    kind : str
        "deviation" from a nominal value, or "scatter" about it.
    tolerance : float
        In `unit`; of a scatter a factor on its width.
    unit, nominal, direction : str
        Unit; nominal value; "+-", "+" or "-".
    by_model : float
        What the study's model said before fresh renders.
    limited : bool
        Whether the study's range ends there and the bound was not reached.
    confirmed : tuple of Confirmed
        At the tolerance; of a scatter each fresh system.
    met : bool
        Whether fresh renders keep the bound.
    halfway : tuple of Confirmed
        At half of the tolerance.
    """

    factor: Factor
    kind: str
    tolerance: float
    unit: str
    nominal: str
    direction: str
    by_model: float
    limited: bool
    confirmed: tuple[Confirmed, ...]
    met: bool
    halfway: tuple[Confirmed, ...] = ()


@dataclass(frozen=True, slots=True)
class Together:
    """All deviations at a time.

    Attributes
    ----------
    scale : float
        Factor on every tolerance.
    share : float
        Of systems within the bound, by the model.
    inside, systems : int
        Of fresh random ones.
    met : bool
        Whether so many inside go with the wanted share.
    """

    scale: float
    share: float
    inside: int
    systems: int
    met: bool


@dataclass(frozen=True, slots=True)
class Tolerances:
    """All that was found; `images_not_met` are those, of the study and fresh ones, that miss their tolerance."""

    response: Response
    nominal: float
    bound: float
    share: float
    found: tuple[Tolerance, ...]
    together: Together | None
    left_out: tuple[str, ...]
    notes: tuple[str, ...]
    images_not_met: int = 0

    @property
    def met(self) -> bool:
        """Whether fresh renders confirm everything."""
        return all(one.met for one in self.found) and (self.together is None or self.together.met)
