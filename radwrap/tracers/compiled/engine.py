"""The compiled tracer as an engine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from radwrap.kept import Kept
from radwrap.scene.scene import Scene
from radwrap.tracers.bouncing import SURE_STEPS, Reflecting
from radwrap.tracers.compiled.arrays import Floats, Whole
from radwrap.tracers.compiled.compiler import SOURCES, VERSIONS
from radwrap.tracers.compiled.hits import KeptHits
from radwrap.tracers.compiled.layout import CompiledScene, compiled_scene
from radwrap.tracers.compiled.smooth import smooth_blocks
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.compiled.walker import WalkingTracer, reflecting_of
from radwrap.tracers.engine import Prover
from radwrap.tracers.text_frame import TextFrame


class Meter:
    """CPU time of all threads that trace [s]."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._seconds = 0.0

    def add(self, seconds: float) -> None:
        """Count time; any thread may call."""
        with self._guard:
            self._seconds += seconds

    @property
    def seconds(self) -> float:
        """What was counted."""
        return self._seconds


@dataclass(frozen=True, slots=True, eq=False)
class CompiledEngine:
    """A scene as arrays; satisfies `Engine`.

    Attributes
    ----------
    scene : Scene
        What was laid out.
    arrays : CompiledScene
        The same as arrays.
    cancelled : callable
        Whether tracing is to end now.
    meter : Meter
        What its tracers have used.
    kept : Kept, optional
        Where hits and radiances are looked up, and kept.
    """

    scene: Scene
    arrays: CompiledScene
    cancelled: Callable[[], bool]
    meter: Meter = field(default_factory=Meter)
    kept: Kept | None = None

    @classmethod
    def of(
        cls, scene: Scene, frame: TextFrame, cancelled: Callable[[], bool], kept: Kept | None = None
    ) -> CompiledEngine:
        """Lay a scene out, in the frame of its Radiance text; it must be expressible."""
        return cls(scene, compiled_scene(scene, frame, whole=True), cancelled, kept=kept)

    @property
    def whole(self) -> tuple[str, ...]:
        """Names of wide lights that shine as a whole, not from the middles of their patches."""
        return self.arrays.whole

    def in_patches(self) -> CompiledEngine:
        """The same with all wide lights in patches, as Radiance has them."""
        return replace(self, arrays=compiled_scene(self.scene, self.arrays.frame)) if self.whole else self

    @property
    def name(self) -> Literal["compiled"]:
        """Which ray tracer."""
        return "compiled"

    @property
    def versions(self) -> Mapping[str, str]:
        """Of its own sources, and of the compiler."""
        return {"compiled": SOURCES, **VERSIONS}

    @property
    def cpu_s(self) -> float:
        """CPU time that its tracers have used so far [s]."""
        return self.meter.seconds

    def tracer(self, scene: Scene, lit: Collection[str] | None = None, *, name: str = "scene") -> CompiledTracer:
        """A tracer of the scene; see `Engine.tracer`."""
        del name  # it needs no folder
        arrays = self.arrays
        if scene.materials is not self.scene.materials:
            arrays = compiled_scene(scene, arrays.frame, whole=bool(self.whole))
        return self._of(arrays if lit is None else arrays.in_light(lit))

    def by_source(self, names: Sequence[str]) -> SourcesTracer | None:
        """A tracer that tells sources or LEDs apart, see `Engine.by_source`; None where discs of several are one."""
        members = [{name for name, _ in group} for group in self.arrays.members]
        if any(len(group) > 1 for group in members):
            return None
        place = {name: number for number, name in enumerate(names)}
        column = np.array([place.get(name, len(names)) for group in members for name in group], dtype=np.int64)
        return SourcesTracer(self._of(self.arrays.in_light(names)), column, tuple(names))

    def bouncing(
        self,
        scene: Scene,
        materials: tuple[Reflecting | None, ...],
        orders: int | None,
        sure_steps: int = SURE_STEPS,
    ) -> WalkingTracer:
        """A tracer that adds what surfaces reflect to each other; see `Engine.bouncing`."""
        lit = self.tracer(scene)
        return WalkingTracer(lit, reflecting_of(lit.scene, materials), orders, sure_steps)

    def _of(self, arrays: CompiledScene) -> CompiledTracer:
        kept = None if self.kept is None else KeptHits.of(self.kept, arrays)
        return CompiledTracer(arrays, self.cancelled, self.meter.add, kept)

    @property
    def smooth_blocks(self) -> Prover:
        """Who proves that light changes smoothly; see `Engine.smooth_blocks`."""
        return partial(smooth_blocks, self.arrays)

    def numbered(self) -> NumberedTracer:
        """A tracer of part numbers; see `Engine.numbered`."""
        return NumberedTracer(self._of(self.arrays))


@dataclass(frozen=True, slots=True, eq=False)
class SourcesTracer:
    """Radiances of several sources, shape (sources, n), in one pass; as `Tracer`.

    Attributes
    ----------
    tracer : CompiledTracer
        In the light of all of them.
    column : ndarray of int, shape (emitters,)
        Place of each emitter's source.
    names : tuple of str
        The sources.
    """

    tracer: CompiledTracer
    column: Whole
    names: tuple[str, ...]

    def with_noise(self, halvings: int, *, alike: bool = False) -> SourcesTracer:
        """The same with other noise of wide lights; see `NoisyTracer`."""
        tracer = self.tracer.with_noise(halvings, alike=alike)
        return self if tracer is self.tracer else replace(self, tracer=tracer)

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Radiance along rays from each source."""
        for values, _ in self.trace_with_distances(rays):
            yield values

    def trace_with_distances(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats]]:
        """Radiance along rays from each source, and the distance to the first surface [m]."""
        for values, distances in self.tracer.trace_by_source(rays, self.column, len(self.names)):
            each = np.ascontiguousarray(values[:, :-1].T)
            for name, level in self.tracer.scene.skies:  # the last column holds what is seen of all of them
                if level > 0 and name in self.names:
                    each[self.names.index(name)] += values[:, -1] * (level / self.tracer.scene.background)
            yield each, distances

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Distance to the first surface [m]."""
        return self.tracer.distances(rays)


@dataclass(frozen=True, slots=True)
class NumberedTracer:
    """Part numbers in place of radiances; satisfies `Tracer`."""

    tracer: CompiledTracer

    def trace(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Number of the part whose front each ray meets first; 0 of backs and of nothing."""
        for numbers in self.tracer.parts(rays):
            yield numbers.astype(np.float64)

    def trace_with_distances(self, rays: Iterable[Floats]) -> Generator[tuple[Floats, Floats]]:
        """The numbers, and the distance to the first surface [m]."""
        for block in rays:
            yield next(self.trace([block])), next(self.distances([block]))

    def distances(self, rays: Iterable[Floats]) -> Generator[Floats]:
        """Distance to the first surface [m]."""
        return self.tracer.distances(rays)
