"""Radiance as an engine: an octree for each tracer."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from radwrap.files import make_folder
from radwrap.process import Programs
from radwrap.scene.camera import ColourChannel
from radwrap.scene.scene import Scene
from radwrap.tracers.bouncing import SURE_STEPS, BouncingTracer, Reflecting
from radwrap.tracers.radiance import NO_LIGHT, PreparedScene, RadianceOptions, RadianceTracer, build
from radwrap.tracers.radiance_text import RadianceScene


@dataclass(frozen=True, slots=True)
class RadianceEngine:
    """Texts of a scene, from which octrees are frozen; satisfies `Engine`.

    Attributes
    ----------
    prepared : PreparedScene
        The texts.
    options : RadianceOptions
        Which Radiance, and its limits.
    programs : Programs
        Owner of the processes.
    folder : Path
        Working folder, in which each tracer gets one of its own.
    channel : str
        Which of the tracer's channels the sensor sees.
    search : tuple of Path
        Folders for files that a trusted scene names.
    """

    prepared: PreparedScene
    options: RadianceOptions
    programs: Programs
    folder: Path
    channel: ColourChannel
    search: tuple[Path, ...] = ()

    @property
    def name(self) -> Literal["radiance"]:
        """Which ray tracer."""
        return "radiance"

    @property
    def versions(self) -> Mapping[str, str]:
        """Nothing besides Radiance."""
        return {}

    @property
    def cpu_s(self) -> float:
        """None of this process: rtrace is one of its own."""
        return 0.0

    def tracer(self, scene: Scene, lit: Collection[str] | None = None, *, name: str = "scene") -> RadianceTracer:
        """A tracer of the scene; see `Engine.tracer`."""
        text = self.prepared.scene if lit is None else self.prepared.in_light(scene, lit)
        return self._built(text, name, self.channel)

    def by_source(self, names: Sequence[str]) -> None:
        """There is none."""
        return None

    @property
    def smooth_blocks(self) -> None:
        """Nobody: Radiance answers rays."""
        return None

    def bouncing(
        self,
        scene: Scene,
        materials: tuple[Reflecting | None, ...],
        orders: int | None,
        sure_steps: int = SURE_STEPS,
    ) -> BouncingTracer:
        """A tracer that adds what surfaces reflect to each other; see `Engine.bouncing`."""
        lit = self.tracer(scene, name="radiance")
        return BouncingTracer(lit, self.numbered(), materials, orders, sure_steps)

    def numbered(self) -> RadianceTracer:
        """A tracer for the same geometry, in which each part glows with its number."""
        text = self.prepared.scene
        identity = replace(text, text=self.prepared.identity, frame=replace(text.frame, radiance=1.0))
        return self._built(identity, "identity", "equal", (NO_LIGHT,))

    def _built(
        self, text: RadianceScene, name: str, channel: ColourChannel, harmless: tuple[str, ...] = ()
    ) -> RadianceTracer:
        folder = self.folder / name
        make_folder(folder)
        build(text.text, text.files, folder, self.options, self.programs, search=self.search, harmless=harmless)
        return RadianceTracer(self.options, self.programs, folder, text, self.search, channel, harmless)
