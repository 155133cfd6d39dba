"""Light that goes from surface to surface, by the compiled tracer: it satisfies `Tracer`."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import TracerError
from radwrap.scene.materials import Lambertian, Specular
from radwrap.tracers.bouncing import ENDLESS, LONGEST_WALK, Reflecting, keys_of
from radwrap.tracers.compiled.arrays import Floats, Whole
from radwrap.tracers.compiled.hits import Hits
from radwrap.tracers.compiled.layout import CompiledScene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.compiled.walks import go_on

# Blocks whose walks take their steps together: the last steps have few.
_BLOCKS_TOGETHER: Final = 16


@dataclass(frozen=True, slots=True, eq=False)
class WalkingTracer:
    """A tracer that adds what surfaces reflect to each other; satisfies `Tracer`. Threads may share it.

    A ray has the walk that `bouncing.BouncingTracer` gives it.

    Attributes
    ----------
    tracer : CompiledTracer
        Of direct light.
    reflecting : ndarray, shape (covers, 3)
        See `walks.go_on`.
    orders : int or None
        How often light is reflected at most before it reaches what a ray sees; None for no limit.
    sure_steps : int
        Steps of a walk without limit that do not end it by chance.
    """

    tracer: CompiledTracer
    reflecting: Floats
    orders: int | None
    sure_steps: int

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Radiance along rays, random with the right mean; see `Tracer.trace`."""
        for values, _ in self.trace_with_distances(rays):
            yield values

    def trace_with_distances(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats]]:
        """Radiance and distance along rays; see `Tracer`."""
        blocks = iter(rays)
        while together := list(islice(blocks, _BLOCKS_TOGETHER)):
            values, distances = self._walked(np.concatenate(together))
            ends = np.cumsum([len(block) for block in together])[:-1]
            yield from zip(np.split(values, ends), np.split(distances, ends), strict=True)

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Distance to the first surface alone [m]; see `Tracer`."""
        return self.tracer.distances(rays)

    def _walked(self, rays: Floats) -> tuple[Floats, Floats]:
        found, hits = self.tracer.lit(rays)
        distances = hits.lengths / self.tracer.scene.frame.units
        numbers, keys, shares = np.arange(len(rays)), keys_of(rays), np.ones(len(rays))
        for step in range(1, self.sure_steps + LONGEST_WALK if self.orders is None else self.orders + 1):
            count = self._go_on(step, rays, hits, numbers, keys, shares)
            if not count:
                return found, distances
            rays, numbers, keys, shares = rays[:count], numbers[:count], keys[:count], shares[:count]
            values, hits = self.tracer.lit(rays)
            # A lamp shines straight on what the walk came from, and was counted there.
            met = hits.met >= 0
            found[numbers[met]] += shares[met] * values[met]
        if self.orders is None:
            raise TracerError(ENDLESS, where="bounces")
        return found, distances

    def _go_on(
        self, step: int, rays: Floats, hits: Hits, numbers: Whole, keys: NDArray[np.uint64], shares: Floats
    ) -> int:
        """See `walks.go_on`."""
        scene, before = self.tracer.scene, time.thread_time()
        count = go_on(
            scene.targets.shapes,
            scene.decals,
            scene.tables,
            *scene.frame.origin,
            float(scene.frame.units),
            rays,
            hits.lengths,
            hits.met,
            self.reflecting,
            step,
            self.orders is None and step > self.sure_steps,
            numbers,
            keys,
            shares,
        )
        self.tracer.used(time.thread_time() - before)
        return count


def reflecting_of(scene: CompiledScene, materials: Sequence[Reflecting | None]) -> Floats:
    """What each cover of a scene reflects, see `walks.go_on`.

    Parameters
    ----------
    scene : CompiledScene
        Whose covers.
    materials : sequence of Lambertian, Specular or None
        Of the parts with a number, from 1; None of what reflects nothing.
    """
    found = np.zeros((len(scene.part_of_cover), 3))
    for cover, part in enumerate(scene.part_of_cover.tolist()):
        match materials[part - 1]:
            case Lambertian(reflectance):
                found[cover, 0] = reflectance
            case Specular(diffuse, specular, roughness):
                found[cover] = diffuse, specular, roughness
    return found
