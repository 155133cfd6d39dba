"""The compiled tracer behind the waist."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import TracerError
from radwrap.tracers.compiled.along_curve import along_curve
from radwrap.tracers.compiled.arrays import Floats, Whole
from radwrap.tracers.compiled.hits import Hits, KeptHits
from radwrap.tracers.compiled.kernels import NOTHING_MET, meet, surfaces, trace
from radwrap.tracers.compiled.layout import CompiledScene
from radwrap.tracers.compiled.neighbours import LISTED, NEIGHBOURS
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.wide_beam import CUTS
from radwrap.tracers.compiled.wide_cells import CELLS, memory
from radwrap.tracers.compiled.wide_shine import POINTS_OF_A_LIGHT
from radwrap.tracers.compiled.wide_ways import WAYS

# Rays and sources that are computed before an interruption is heeded: some tenths of a second.
_WORK_AT_ONCE: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class CompiledTracer:
    """A scene's arrays and how to ask them; satisfies `Tracer`. Threads may share it.

    Attributes
    ----------
    scene : CompiledScene
        What is there.
    cancelled : callable, optional
        Whether tracing is to end now; it is asked some times a second.
    used : callable, optional
        Is told CPU time [s].
    kept : KeptHits, optional
        Where hits and radiances are looked up, and kept.
    memories : list of ndarray of int
        Of threads that trace no block now: what they know of the scene's places, see `wide_cells.memory`. Answers do
        not hang on it.
    """

    scene: CompiledScene
    cancelled: Callable[[], bool] = bool  # False
    used: Callable[[float], object] = float
    kept: KeptHits | None = None
    memories: list[Whole] = field(default_factory=list)

    def with_noise(self, halvings: int, *, alike: bool = False) -> CompiledTracer:
        """The same with other noise of wide lights; see `NoisyTracer`."""
        if not len(self.scene.wides) or (self.scene.halvings, self.scene.alike) == (halvings, alike):
            return self
        scene = replace(self.scene, halvings=halvings, alike=alike)
        return replace(self, scene=scene, kept=self.kept and self.kept.in_light_of(scene))

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Radiance along rays; see `Tracer.trace`."""
        for values, _ in self.trace_with_distances(rays):
            yield values

    def trace_with_distances(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats]]:
        """Radiance along rays, and the distance to the first surface; see `Tracer`."""
        for block in rays:
            values, distances = self._traced(block, self.scene.lights, 1)
            yield values[:, 0], distances

    def trace_by_source(self, rays: Iterable[Floats], column: Whole, groups: int) -> Generator[tuple[Floats, Floats]]:
        """Radiance along rays from each group of emitters, and the distance to the first surface [m].

        Parameters
        ----------
        rays : iterable of ndarray
            As `trace`.
        column : ndarray of int, shape (emitters,)
            Group of each emitter, from 0.
        groups : int
            How many there are.

        Yields
        ------
        radiance : ndarray, shape (n, groups + 1)
            [W m^-2 sr^-1]; the last column is that of the background.
        distance : ndarray, shape (n,)
            [m]
        """
        lights = self.scene.lights.copy()
        lights["column"] = column
        for block in rays:
            yield self._traced(block, lights, groups + 1)

    def lit(self, block: Floats) -> tuple[Floats, Hits]:
        """Radiance along rays [W m^-2 sr^-1], shape (n,), and what they met; nothing is kept of it."""
        values, hits = self._shaded(block, self.scene.lights, 1, None)
        return values[:, 0], hits

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Distance to the first surface [m]; see `Tracer`."""
        for block in rays:
            known = self.kept.hits(self.kept.key(block)) if self.kept else None
            yield self._met(block)[0] if known is None else known.lengths / self.scene.frame.units

    def surfaces(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats, Floats]]:
        """Radiance along rays, distance to the first surface [m], and its normal, shape (n, 3); 0 where nothing is."""
        for block in rays:
            values, distances = self._traced(block, self.scene.lights, 1)
            yield values[:, 0], distances, self._met(block)[1]

    def parts(self, rays: Iterable[Floats]) -> Generator[Whole]:
        """Number of the part whose front each ray meets first, see `CompiledScene.parts`; 0 of backs and of nothing."""
        for block in rays:
            _, normals, found = self._met(block)
            numbers = np.zeros(len(block), dtype=np.int64)
            target = found >= 0
            emitter = ~target & (found != NOTHING_MET)
            numbers[target] = self.scene.part_of_cover[found[target]]
            numbers[emitter] = self.scene.part_of_light[-1 - found[emitter]]
            numbers[(normals * block[:, 3:]).sum(axis=1) > 0] = 0
            yield numbers

    def _traced(self, block: Floats, lights: NDArray[np.void], columns: int) -> tuple[Floats, Floats]:
        if self.kept is None:
            values, hits = self._shaded(block, lights, columns, None)
            return values, hits.lengths / self.scene.frame.units
        key = self.kept.key(block)
        known = self.kept.hits(key)
        seen = self.kept.radiance(key) if columns == 1 and known is not None else None
        if seen is not None and known is not None:
            return seen, known.lengths / self.scene.frame.units
        values, hits = self._shaded(block, lights, columns, known)
        if known is None:
            self.kept.keep(key, hits)
        if columns == 1:
            self.kept.keep_radiance(key, values)
        return values, hits.lengths / self.scene.frame.units

    def _shaded(self, block: Floats, lights: NDArray[np.void], columns: int, known: Hits | None) -> tuple[Floats, Hits]:
        """Radiance along rays from each group of emitters, and what they meet, which may be known."""
        scene, count = self.scene, len(block)
        hits = known or Hits(np.empty(count), np.empty(count, dtype=np.int64))
        values = np.zeros((count, columns))
        known_places = self.memories.pop() if self.memories else memory()
        stack = np.empty(DEPTH, dtype=np.int64)
        # Else points ask for nothing together.
        is_asking = len(scene.clusters) > 0 and len(scene.targets.shapes) > 1 and lights["radiance"].any()
        for part in self._parts(
            len(block), len(lights) + (POINTS_OF_A_LIGHT << max(0, -scene.halvings)) * len(scene.wides)
        ):
            lengths, met = hits.lengths[part], hits.met[part]
            rays, (x0, y0, z0), units = block[part], scene.frame.origin, float(scene.frame.units)
            if known is None:
                _check(meet(*self._there, scene.tables, rays, x0, y0, z0, units, lengths, met, stack))
            order = np.arange(len(rays))
            if is_asking:
                order = along_curve(scene.targets.nodes, rays, x0, y0, z0, units, lengths, met)
            trace(
                *self._there,
                scene.covers,
                scene.decals,
                lights,
                scene.beside,
                scene.clusters,
                scene.parts_of_clusters,
                scene.wides,
                scene.cells,
                scene.pitch,
                scene.halvings,
                scene.alike,
                scene.background,
                scene.tables,
                rays,
                x0,
                y0,
                z0,
                units,
                values[part],
                lengths,
                met,
                order,
                np.empty(len(lights)),
                np.empty((NEIGHBOURS, 3)),
                np.empty(6),
                np.empty(len(lights) + len(scene.parts_of_clusters) + len(scene.clusters), dtype=np.int64),
                np.empty((len(lights) + len(scene.parts_of_clusters), LISTED), dtype=np.int64),
                np.empty((len(scene.parts_of_clusters), LISTED, 2)),
                known_places,
                np.empty(CELLS * CELLS, dtype=np.int64),
                np.empty(CUTS),
                np.empty(WAYS, dtype=np.int64),
                stack,
            )
        self.memories.append(known_places)
        # What is left of a wide light's half shadow is right in the mean, and of one ray perhaps below 0.
        if not np.isfinite(values.sum()) or (values.min(initial=0.0) < 0 and not len(scene.wides)):
            raise TracerError("answered NaN, infinity or a negative radiance", where="the compiled tracer")
        return values, hits

    @property
    def _there(self) -> tuple[NDArray[np.void], NDArray[np.void], NDArray[np.void], NDArray[np.void]]:
        """Shapes of targets and of emitters, each with its tree."""
        targets, emitters = self.scene.targets, self.scene.emitters
        return targets.shapes, targets.nodes, emitters.shapes, emitters.nodes

    def _met(self, block: Floats) -> tuple[Floats, Floats, Whole]:
        scene = self.scene
        distances, normals = np.empty(len(block)), np.empty((len(block), 3))
        found = np.empty(len(block), dtype=np.int64)
        for part in self._parts(len(block), 1):
            good = surfaces(
                *self._there,
                scene.decals,
                scene.tables,
                block[part],
                *scene.frame.origin,
                float(scene.frame.units),
                distances[part],
                normals[part],
                found[part],
                np.empty(DEPTH, dtype=np.int64),
            )
            _check(good)
        return distances, normals, found

    def _parts(self, rays: int, sources: int) -> Iterator[slice]:
        """Parts of a block, between which an interruption is heeded and time is counted."""
        step = max(1, _WORK_AT_ONCE // (sources + 1))
        for start in range(0, rays, step):
            if self.cancelled():
                raise TracerError("cancelled", where="the compiled tracer")
            before = time.thread_time()
            yield slice(start, start + step)
            self.used(time.thread_time() - before)


def _check(good: bool) -> None:
    if not good:
        raise ValueError("a ray holds NaN or infinity, or has no direction")
