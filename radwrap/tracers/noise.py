"""Noise of rays that ask only some points of a light whether they are hidden: how much of it is worth its time."""

from __future__ import annotations

import math
from typing import Final, Protocol, runtime_checkable

from radwrap.tracers.tracer import Tracer

# A ray's noise falls as its points to the power -3/4, and that of a mean over n rays as n^(-1/2) besides: with
# n^(-2/3) of the points in each ray, their mean has the noise of a single ray with all of them.
_POINTS_BY_RAYS: Final = 2 / 3
FALL: Final = 1.5  # of a ray's variance with the number of its points: a power
MOST_DOUBLINGS: Final = 7


@runtime_checkable
class NoisyTracer(Tracer, Protocol):
    """A tracer whose noise is a matter of choice."""

    def with_noise(self, halvings: int, *, alike: bool = False) -> Tracer:
        """The same surfaces in the same light, by other points; the tracer itself where that changes nothing.

        Parameters
        ----------
        halvings : int
            How often the number of points is halved that each ray asks.
        alike : bool
            Whether all rays ask the same points: then neighbours differ by what they see, and not by noise.
        """
        ...


def with_noise(tracer: Tracer, halvings: int, *, alike: bool = False) -> Tracer:
    """A tracer by other points of wide lights; see `NoisyTracer`."""
    return tracer.with_noise(halvings, alike=alike) if isinstance(tracer, NoisyTracer) else tracer


def halvings_of(rays: float) -> int:
    """How often the points are halved where so many rays count together."""
    return max(0, round(_POINTS_BY_RAYS * math.log2(rays)))


def halvings_for(square: float, wanted: float) -> int | None:
    """How often points are halved for a variance, where they have another; None where they have none.

    Never above 0: where few places have all of the noise, what was measured may have missed them.
    """
    if not square > 0:
        return None
    return min(max(round(math.log2(wanted / square) / FALL), -MOST_DOUBLINGS), 0)
