"""A tracer that gives up when its time is over."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable
from contextlib import closing
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.noise import with_noise
from radwrap.tracers.tracer import Tracer

_T = TypeVar("_T")


class OutOfTime(Exception):
    """The time is over."""


class TimedTracer:
    """Another tracer, but only until a deadline; for its methods see `Tracer`.

    Parameters
    ----------
    tracer : Tracer
        Who traces.
    deadline : float
        On the clock `time.monotonic` [s]; the first block of rays that is answered later raises `OutOfTime`.
    """

    def __init__(self, tracer: Tracer, deadline: float) -> None:
        self._tracer, self._deadline = tracer, deadline

    def with_noise(self, halvings: int, *, alike: bool = False) -> TimedTracer:
        """The same by other points of wide lights; see `NoisyTracer`."""
        tracer = with_noise(self._tracer, halvings, alike=alike)
        return self if tracer is self._tracer else TimedTracer(tracer, self._deadline)

    def trace(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """Radiance along rays."""
        return self._in_time(self._tracer.trace(rays))

    def trace_with_distances(
        self, rays: Iterable[NDArray[np.float64]]
    ) -> Generator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Radiance along rays, and the distance to the first surface [m]."""
        return self._in_time(self._tracer.trace_with_distances(rays))

    def distances(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """Distance to the first surface alone [m]."""
        return self._in_time(self._tracer.distances(rays))

    def _in_time(self, answers: Generator[_T]) -> Generator[_T]:
        with closing(answers):
            for answer in answers:
                if time.monotonic() > self._deadline:
                    raise OutOfTime
                yield answer
