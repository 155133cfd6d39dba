"""How fast a tracer is: held against one whose speed is known."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from radwrap.imaging.forecast.speed import speed_of

_PERIOD = 0.01  # s
_TRIES = 20


class Sleeper:
    """Answers each block after a known time; satisfies `Tracer`."""

    def trace(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        for block in rays:
            time.sleep(_PERIOD)
            yield np.zeros(len(block))

    def trace_with_distances(
        self, rays: Iterable[NDArray[np.float64]]
    ) -> Generator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        raise NotImplementedError

    def distances(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        raise NotImplementedError


def test_the_speed_of_a_tracer_that_sleeps() -> None:
    # 100 rays in 10 ms; a busy machine may wake it late, never early, and not late every time.
    for _ in range(_TRIES):
        found = speed_of(Sleeper(), np.zeros((100, 6)))
        assert found <= 100 / _PERIOD
        if found == pytest.approx(100 / _PERIOD, rel=0.3):
            return
    pytest.fail(f"{found:.0f} rays in a second, never near {100 / _PERIOD:.0f}")
