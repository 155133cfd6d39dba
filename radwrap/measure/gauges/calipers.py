"""Calipers: where a gauge looks for what it measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from radwrap.errors import InputError

Side = Literal["bright", "dark"]

SMALLEST_RADIUS: Final = 2.0  # px; of a smaller one no straight piece is seen
SMALLEST_ARC: Final = math.radians(20)
SHORTEST: Final = 6.0  # px along an edge
_TURN: Final = 2 * math.pi


@dataclass(frozen=True, slots=True)
class Caliper:
    """Where to look for a circle.

    Attributes
    ----------
    centre : tuple of float
        (u, v) [px].
    radius : float
        In pixel widths [px].
    band : float
        The rim lies within so much of the radius [px].
    inside : str or None
        "bright" or "dark"; None for whichever step is stronger.
    arc : tuple of float or None
        First angle, from u towards v, and extent [rad]; None for all of it.
    """

    centre: tuple[float, float]
    radius: float
    band: float
    inside: Side | None = None
    arc: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.centre, self.radius, self.band, *(self.arc or ())))):
            raise InputError("must be finite numbers", where="at")
        if self.radius < SMALLEST_RADIUS:
            raise InputError(f"must be {SMALLEST_RADIUS:g} px or more, not {self.radius:g}", where="radius")
        if not 1 <= self.band < self.radius:
            raise InputError(f"must lie between 1 px and the radius, not {self.band:g}", where="band")
        if self.inside not in {None, "bright", "dark"}:
            raise InputError('must be "bright" or "dark"', where="inside")
        if self.arc is not None and not SMALLEST_ARC <= self.arc[1] <= _TURN:
            raise InputError(f"must extend over {math.degrees(SMALLEST_ARC):g} to 360 degrees", where="arc")


@dataclass(frozen=True, slots=True)
class StraightCaliper:
    """Where to look for straight edges.

    Attributes
    ----------
    centre : tuple of float
        (u, v) [px].
    angle : float
        Of the edges' normal, from u towards v [rad], to some degrees.
    length : float
        Along the edges [px].
    band : float
        The edges lie within so much of the centre, along the normal [px].
    """

    centre: tuple[float, float]
    angle: float
    length: float
    band: float

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.centre, self.angle, self.length, self.band))):
            raise InputError("must be finite numbers", where="at")
        if self.length < SHORTEST:
            raise InputError(f"must be {SHORTEST:g} px or more, not {self.length:g}", where="length")
        if self.band < 1:
            raise InputError(f"must be 1 px or more, not {self.band:g}", where="band")
