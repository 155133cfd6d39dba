"""Light that goes from surface to surface, by the compiled tracer: it satisfies `Tracer`."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radwrap.errors import TracerError
from radwrap.scene.materials import Lambertian, Specular
from radwrap.tracers.bouncing import ENDLESS, MOST_LIKELY, Reflecting
from radwrap.tracers.compiled.arrays import Floats
from radwrap.tracers.compiled.layout import CompiledScene
from radwrap.tracers.compiled.tracer import CompiledTracer, checked, sources_of
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.walks import BAD_RAY, ENDLESS_WALK, walk
from radwrap.tracers.compiled.wide_cells import CELLS, memory

# Steps that walks take after those that are sure, where they lose as little light as they may.
_UNSURE_STEPS: Final = round(1 / (1 - MOST_LIKELY))


@dataclass(frozen=True, slots=True, eq=False)
class WalkingTracer:
    """A tracer that adds what surfaces reflect to each other; satisfies `Tracer`. Threads may share it.

    A ray has the walk that `bouncing.BouncingTracer` gives it.

    Attributes
    ----------
    tracer : CompiledTracer
        Of direct light.
    reflecting : ndarray, shape (covers, 3)
        See `walks.walk`.
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
        for block in rays:
            values, lengths = self._walked(block)
            yield values, lengths / self.tracer.scene.frame.units

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Distance to the first surface alone [m]; see `Tracer`."""
        return self.tracer.distances(rays)

    def _walked(self, block: Floats) -> tuple[Floats, Floats]:
        scene, count = self.tracer.scene, len(block)
        values, lengths, met = np.zeros((count, 1)), np.empty(count), np.empty(count, dtype=np.int64)
        steps = 1 + (self.sure_steps + _UNSURE_STEPS if self.orders is None else self.orders)
        for part in self.tracer.portions(count, steps * (1 + sources_of(scene))):
            came = walk(
                scene.targets.shapes,
                scene.targets.nodes,
                scene.emitters.shapes,
                scene.emitters.nodes,
                scene.covers,
                scene.decals,
                scene.lights,
                scene.beside,
                scene.clusters,
                scene.parts_of_clusters,
                scene.wides,
                scene.cells,
                scene.pitch,
                scene.background,
                scene.tables,
                block[part],
                *scene.frame.origin,
                float(scene.frame.units),
                values[part],
                lengths[part],
                met[part],
                np.empty(len(scene.lights)),
                memory(),
                np.empty(CELLS * CELLS, dtype=np.int64),
                np.empty(DEPTH, dtype=np.int64),
                self.reflecting,
                -1 if self.orders is None else self.orders,
                self.sure_steps,
                np.empty((1, 6)),
                np.empty((1, 1)),
                np.empty(1),
                np.empty(1, dtype=np.int64),
            )
            if came == ENDLESS_WALK:
                raise TracerError(ENDLESS, where="bounces")
            checked(values[part], is_good=came != BAD_RAY)
        return values[:, 0], lengths


def reflecting_of(scene: CompiledScene, materials: Sequence[Reflecting | None]) -> Floats:
    """What each cover of a scene reflects, see `walks.walk`.

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
