"""The whole of what is there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from radwrap.scene.camera import Camera
from radwrap.scene.catalog.presets import Taken
from radwrap.scene.materials import Material
from radwrap.scene.motion import Motion
from radwrap.scene.shutter import Strobe
from radwrap.scene.sources import Emitter, Source, WideSource, emitters
from radwrap.scene.spectrum import Spectral
from radwrap.scene.targets import RadFile, Surface, Target, surfaces
from radwrap.scene.tolerances import Tolerances


@dataclass(frozen=True, slots=True)
class Scene:
    """A camera, what it sees, and what lights it; all in SI units.

    Attributes
    ----------
    camera : Camera
        The one camera.
    sources : tuple of Source
        Light sources.
    materials : Mapping[str, Material]
        Name -> material.
    targets : tuple of Target
        What can be seen.
    tolerances : Tolerances, optional
        How far what goes in may be off.
    assumed : Mapping[str, str]
        Key of the scene file -> value that was taken because the file is silent.
    origin : str
        File the scene was read from, for messages.
    folder : Path
        Folder against which file names in the scene are resolved.
    document : str
        The scene file's content as JSON, with overrides, as the user wrote it.
    spectral : Spectral, optional
        Where spectra are told: what they come to. Radiances of sources are then what counts of them.
    components : tuple of Taken
        What it takes from the catalog.
    motions : Mapping[str, Motion]
        Name of a target -> how it moves; those that stand still are not in it.
    strobes : Mapping[str, Strobe]
        Name of a source -> when it shines; those that always do are not in it.
    """

    camera: Camera
    sources: tuple[Source, ...]
    materials: Mapping[str, Material]
    targets: tuple[Target, ...]
    tolerances: Tolerances | None = None
    assumed: Mapping[str, str] = field(default_factory=dict)
    origin: str = field(default="scene", compare=False)
    folder: Path = field(default=Path(), compare=False)
    document: str = field(default="{}", compare=False, repr=False)
    spectral: Spectral | None = None
    components: tuple[Taken, ...] = field(default=(), compare=False, repr=False)
    motions: Mapping[str, Motion] = field(default_factory=dict)
    strobes: Mapping[str, Strobe] = field(default_factory=dict)

    @property
    def emitters(self) -> tuple[Emitter, ...]:
        """All shining discs, dark ones included."""
        return tuple(emitter for source in self.sources for emitter in emitters(source))

    @property
    def surrounds(self) -> tuple[WideSource, ...]:
        """Sources that shine from all sides, and are seen where nothing else is."""
        return tuple(s for s in self.sources if isinstance(s, WideSource) and s.kind == "surround")

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """All surfaces that are known here; those of Radiance files are not."""
        return tuple(surface for target in self.targets for surface in surfaces(target))

    @property
    def included(self) -> tuple[RadFile, ...]:
        """The Radiance files that the scene includes."""
        return tuple(target for target in self.targets if isinstance(target, RadFile))
