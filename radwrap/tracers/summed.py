"""Several tracers of one geometry, each in other light: their radiances add up."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.noise import with_noise
from radwrap.tracers.tracer import Tracer

Array = NDArray[np.float64]

# Blocks that are held until each tracer has answered them: 25 MiB of rays.
_HELD: Final = 64


@dataclass(frozen=True, slots=True)
class SummedTracer:
    """The sum of what several tracers answer; satisfies `Tracer`.

    Attributes
    ----------
    parts : tuple of Tracer
        One or more, of the same surfaces.
    """

    parts: tuple[Tracer, ...]

    def with_noise(self, halvings: int, *, alike: bool = False) -> SummedTracer:
        """The same with other noise; see `NoisyTracer`."""
        parts = tuple(with_noise(part, halvings, alike=alike) for part in self.parts)
        return self if all(new is old for new, old in zip(parts, self.parts, strict=True)) else SummedTracer(parts)

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        """Radiance along rays; see `Tracer.trace`."""
        for blocks in _held(rays):
            yield from _sums(part.trace(blocks) for part in self.parts)

    def trace_with_distances(self, rays: Iterable[Array]) -> Generator[tuple[Array, Array]]:
        """Radiance and distance along rays; see `Tracer`."""
        first, *others = self.parts
        for blocks in _held(rays):
            answers = list(first.trace_with_distances(blocks))
            rest = list(_sums(part.trace(blocks) for part in others)) if others else [np.zeros(1)] * len(answers)
            yield from ((value + more, distance) for (value, distance), more in zip(answers, rest, strict=True))

    def distances(self, rays: Iterable[Array]) -> Generator[Array]:
        """Distance to the first surface, whatever the light."""
        return self.parts[0].distances(rays)


def _held(rays: Iterable[Array]) -> Iterator[list[Array]]:
    remaining = iter(rays)
    while blocks := list(islice(remaining, _HELD)):
        yield blocks


def _sums(answers: Iterable[Iterable[Array]]) -> Iterator[Array]:
    """Sum over tracers of each block, one tracer after the other."""
    total: list[Array] = []
    for answer in answers:
        values = list(answer)
        total = [a + b for a, b in zip(total, values, strict=True)] if total else values
    return iter(total)
