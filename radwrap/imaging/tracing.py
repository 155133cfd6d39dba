"""A scene laid out for the tracer: what every verb that traces begins with."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder
from radwrap.imaging.banding import banding
from radwrap.imaging.optics.diffraction import Light, light_of_all
from radwrap.imaging.optics.view import LitView, View
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracer_choice import (
    TracerUsed,
    candidate,
    compared,
    geometry_of,
    probe_rays,
    probed,
    walks_probed,
)
from radwrap.kept import Kept, of_kept
from radwrap.manifest import sha256_of_value
from radwrap.process import Limits, Programs, available_cores
from radwrap.progress import note
from radwrap.scene.camera import ColourChannel
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.instants import refuse_time
from radwrap.scene.look.wide_sources import divided
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Source, WideSource, emitters
from radwrap.tracers.agreement import Agreement
from radwrap.tracers.bouncing import SURE_STEPS, reflecting_parts
from radwrap.tracers.engine import Engine
from radwrap.tracers.installation import find_radiance, version
from radwrap.tracers.radiance import PreparedScene, RadianceOptions, RadianceTracer, prepare
from radwrap.tracers.radiance_engine import RadianceEngine
from radwrap.tracers.summed import SummedTracer
from radwrap.tracers.tracer import Tracer

if TYPE_CHECKING:
    from radwrap.tracers.compiled.engine import CompiledEngine


# Folder of Radiance's files where it traces after all what was first laid out for a comparison.
_PATCHES: Final = "patches"
# Sources whose light is traced at a time: a tile of each is held, some 10 MiB.
_TOGETHER: Final = 16
_SMALL: Final = 1 << 10  # byte; what a few numbers take at most

# What a comparison of direct light shows, and one of walks from surface to surface.
_Agreements = tuple[Agreement, Agreement | None]


class LaidOutScene:
    """A scene's text and files, and the tracers that are built from them in a working folder.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : RenderOptions
        How it is rendered.
    programs : Programs
        Owner of the processes.
    work : Path
        The working folder.
    exact_bands : bool
        Whether spectra get as many bands as they have.
    kept : Kept, optional
        Where hits, meshes and comparisons of the tracers are looked up, and kept.
    compared_meanwhile : bool
        Whether tracing may begin before the tracers are compared; `tracers_agree` then says whether it may stand, and
        `close` is to be called.

    Raises
    ------
    InputError
        If an included file breaks the trust rule, or nothing shines.
    EnvironmentFailure
        If there is no Radiance, or it does not accept the scene.
    """

    def __init__(
        self,
        scene: Scene,
        options: RenderOptions,
        programs: Programs,
        work: Path,
        *,
        exact_bands: bool = False,
        kept: Kept | None = None,
        compared_meanwhile: bool = False,
    ) -> None:
        refuse_mosaic(scene)
        refuse_time(scene, "what is asked")
        self._kept = kept
        self._options = options
        self._programs = programs
        self._work = work
        limits = Limits(silence=options.tracer_timeout)
        self._radiance = RadianceOptions(find_radiance(options.radiance), options.trust, limits)
        self.version = of_kept(
            kept,
            lambda: ("version", self._radiance.installation),
            lambda: version(self._radiance.installation, programs),
            len,
        )
        self.banding = banding(scene, options, exact=exact_bands)
        self._engine: Engine
        self.tracer_used = candidate(scene, options)
        self._trace_by_radiance(scene if self.tracer_used.name == "compiled" else divided(scene), work)
        self._comparison: Future[_Agreements] | None = None
        self._whole: tuple[str, ...] | None = None
        if self.tracer_used.name == "compiled":
            compiled = self._compiled_engine(scene)
            self._whole = compiled.whole or None
            compare = partial(self._compared, compiled, self._name_of_comparison(compiled))
            if compared_meanwhile:
                pool = ThreadPoolExecutor(1)
                self._comparison = pool.submit(compare)
                pool.shutdown(wait=False)  # `close` waits
                self._engine = compiled
                return
            self.tracer_used = self._judged(*compare())
            if self.tracer_used.name == "compiled":
                self._engine = compiled
            elif (fine := divided(scene)) is not scene:
                make_folder(work / _PATCHES)
                self._trace_by_radiance(fine, work / _PATCHES)

    def _trace_by_radiance(self, scene: Scene, folder: Path) -> None:
        """Make Radiance the tracer, of a scene that may have more patches for its wide sources."""
        self.scene = scene
        if self.tracer_used.name == "radiance":
            wide = (source for source in scene.sources if isinstance(source, WideSource) and source.radiance > 0)
            self.tracer_used = replace(self.tracer_used, in_patches=tuple(source.name for source in wide) or None)
        self._reference = self._radiance_engine(scene, folder)
        self.prepared = self._reference.prepared
        self._engine = self._reference

    def _name_of_comparison(self, compiled: CompiledEngine) -> Hashable:
        """All that a comparison hangs on, where anything is kept."""
        if self._kept is None:
            return None
        camera = sha256_of_value(geometry_of(self.scene.camera))
        versions = compiled.versions["compiled"], self._radiance.installation
        return "probe", self.sha256(), *versions, camera, self._options.bounces

    def _compared(self, compiled: CompiledEngine, name: Hashable) -> _Agreements:
        """What a comparison of the compiled tracer with Radiance shows."""
        return of_kept(self._kept, lambda: name, lambda: self._probed(compiled.in_patches()), lambda _: _SMALL)

    def _probed(self, patches: CompiledEngine) -> _Agreements:
        reference, rays = self._reference.tracer(self.scene, name="reference"), self._probe_rays(patches)
        walks = None
        if self._options.bounces:
            with suppress(InputError):  # whoever comes to trace such walks reports it
                materials = reflecting_parts(self.scene, self.prepared.parts)
                walks = walks_probed((self._reference, patches), self.scene, materials, self._options, rays)
        return probed(reference, patches, self.scene, rays), walks

    def _probe_rays(self, compiled: CompiledEngine) -> NDArray[np.float64]:
        """Rays of a comparison: they hang on the camera and on which part is where."""
        files = self.prepared.scene.files
        return of_kept(
            self._kept,
            lambda: ("probe rays", self.prepared.identity, tuple(files.items()), geometry_of(self.scene.camera)),
            lambda: probe_rays(self.scene.camera, compiled.numbered()),
            lambda rays: rays.nbytes + len(self.prepared.identity) + sum(map(len, files.values())),
        )

    def _judged(self, found: Agreement, walks: Agreement | None) -> TracerUsed:
        used = compared(self.tracer_used, self._options, found, walks)
        return replace(used, whole=self._whole) if used.name == "compiled" else used

    def tracers_agree(self) -> bool:
        """Whether whoever traces may, once the tracers are compared; else the scene is to be laid out again.

        Raises
        ------
        EnvironmentFailure
            If they do not agree, and the compiled tracer was asked for.
        """
        if self._comparison is not None and self.tracer_used.probe is None:
            self.tracer_used = self._judged(*self._comparison.result())
        return self.tracer_used.name == self._engine.name

    def close(self) -> None:
        """End a comparison that nobody has waited for, with all programs: what it was for has failed."""
        if self._comparison is not None and not self._comparison.done():
            self._programs.cancel()
            with suppress(CancelledError):
                self._comparison.exception()

    def _radiance_engine(self, scene: Scene, folder: Path) -> RadianceEngine:
        prepared = prepare(scene, self._radiance, self._programs, folder, with_outlines=True, kept=self._kept)
        # A trusted file may name files beside itself, and Radiance looks for them where it runs.
        search = {(scene.folder / target.file).parent.absolute() for target in scene.included}
        trusted = tuple(sorted(search)) if self._options.trust else ()
        channel = scene.camera.sensor.channel
        return RadianceEngine(prepared, self._radiance, self._programs, folder, channel, trusted)

    def _compiled_engine(self, scene: Scene) -> CompiledEngine:
        # Its compiler takes a third of a second to load.
        from radwrap.tracers.compiled.engine import CompiledEngine
        from radwrap.tracers.compiled.warm import is_warm

        if self._options.progress and not is_warm():
            note("compiling the tracer, which takes about 30 s, once on this machine")
        return CompiledEngine.of(scene, self.prepared.scene.frame, lambda: self._programs.cancelled, self._kept)

    @property
    def tracer_versions(self) -> Mapping[str, str]:
        """Versions of what traces."""
        return {"radiance": self.version, **self._engine.versions}

    @property
    def is_compiled(self) -> bool:
        """Whether the compiled tracer traces."""
        return self._engine.name == "compiled"

    @property
    def whole(self) -> tuple[str, ...]:
        """Names of wide sources that shine as a whole, while Radiance has patches for them."""
        return self._whole or () if self.is_compiled else ()

    @property
    def tracer_cpu_s(self) -> float:
        """CPU time of this process in which rays were traced; that of programs comes besides [s]."""
        return self._engine.cpu_s

    def sha256(self) -> str:
        """Hash of the scene as the tracer gets it, and of the tracer."""
        text = self.prepared.scene
        files = {name: content.hex() for name, content in text.files.items()}
        told = {"text": text.text, "files": files, **self.tracer_versions}
        return sha256_of_value(told if self.banding.bands is None else {**told, "bands": self.banding.bands})

    def view(self) -> View:
        """The camera, with a tracer for the scene."""
        return self._view(self._lit(self._engine, self.scene, "scene"))

    def radiance_view(self) -> View:
        """The camera, with Radiance as the tracer, whatever else traces the scene."""
        return replace(self._view(self._lit(self._reference, self.scene, "radiance")), prover=None)

    def one_band_view(self) -> View:
        """The camera, with a tracer for the scene in one band, whatever its spectra need."""
        return self._view(self._engine.tracer(self.scene, name="one_band"))

    def view_of(self, source: str) -> View:
        """The camera, with a tracer for the scene in the light of one source or LED; the others are black."""
        names = next((_switched(one) for one in self.scene.sources if one.name == source), {source})
        return self._view(self._engine.tracer(self._in_band_of(source), names, name=f"source.{source}"))

    def lights(self) -> tuple[Light, ...]:
        """The camera in the light of all sources of about one wavelength, for each such wavelength."""
        groups = () if self.scene.spectral is None else self.scene.spectral.wavelength_groups()
        if len(groups) < 2:
            return (light_of_all(self.scene, self.view()),)
        found = []
        for number, group in enumerate(groups):
            names = frozenset(
                name for source in self.scene.sources if source.name in group.sources for name in _switched(source)
            )
            view = self._view(self._lit(self._engine, self.scene, f"light{number}", names))
            found.append(Light(view, group.wavelength, group.spread, names, group.deviation))
        return tuple(found)

    def views_of(self, sources: Sequence[str]) -> tuple[LitView, ...]:
        """The camera in the light of each of some sources or LEDs alone: one view for all of them, or one for each."""
        found = []
        for start in range(0, len(sources), _TOGETHER):
            names = tuple(sources[start : start + _TOGETHER])
            together = None if self.banding.bands is not None else self._engine.by_source(names)
            if together is not None:
                found.append(LitView(names, self._view(together)))
            else:
                found += [LitView((name,), self.view_of(name)) for name in names]
        return tuple(found)

    def view_lit_by(self, sources: tuple[Source, ...]) -> View:
        """The camera, with a tracer for the same targets in other light."""
        scene = replace(self.scene, sources=sources)
        if self._engine is not self._reference:
            return self._view(self._lit(self._compiled_engine(scene), scene, "other"))
        folder = self._work / "other"
        make_folder(folder)
        return self._view(self._lit(self._radiance_engine(scene, folder), scene, "scene"))

    def _view(self, tracer: Tracer) -> View:
        workers = self._options.workers or available_cores()
        return View(self.scene.camera, tracer, workers, self._engine.smooth_blocks)

    def _lit(self, engine: Engine, scene: Scene, name: str, only: Collection[str] | None = None) -> Tracer:
        """A tracer for a scene in the light of all, or of some, or one for each band of that light: their sum."""
        if self.banding.bands is None:
            return engine.tracer(scene, only, name=name)
        tracers = []
        for number, band in enumerate(self.banding.bands.bands):
            coloured = replace(scene, materials={**scene.materials, **band.materials})
            lit = {name for source in scene.sources if source.name in band.sources for name in _switched(source)}
            if only is not None and not (lit := lit.intersection(only)):
                continue
            tracers.append(engine.tracer(coloured, lit, name=f"{name}.band{number}"))
        return tracers[0] if len(tracers) == 1 else SummedTracer(tuple(tracers))

    def _in_band_of(self, lit: str) -> Scene:
        """The scene with the materials as they look in the band of a source or LED."""
        for band in self.banding.bands.bands if self.banding.bands else ():
            if any(lit in _switched(source) for source in self.scene.sources if source.name in band.sources):
                return replace(self.scene, materials={**self.scene.materials, **band.materials})
        return self.scene

    def bouncing_view(self, orders: int | None, sure_steps: int = SURE_STEPS) -> View:
        """The camera, with a tracer that adds what surfaces reflect to each other.

        Parameters
        ----------
        orders : int or None
            How often light is reflected at most on its way; None for no limit.
        sure_steps : int
            So far no walk ends by chance.

        Raises
        ------
        InputError
            If a material reflects light from all sides in a way that nobody knows, or in colours.
        """
        tracer = self._engine.bouncing(
            self.scene, reflecting_parts(self.scene, self.prepared.parts), orders, sure_steps
        )
        # Plans of Radiance's walks stay as they were, so that their images do.
        return replace(self._view(tracer), prover=None, walks=self.is_compiled)

    def view_with_bounces(self, bounces: int | Literal["all", "auto"]) -> View:
        """The camera with what is asked for of light between surfaces; "auto" is all of it, and none is `view`.

        Materials that bounces do not know are no matter to "auto" before it is known that they count.
        """
        try:
            return self.bouncing_view(bounces if isinstance(bounces, int) else None)
        except InputError:
            if bounces != "auto":
                raise
            return self.view()

    def numbered_tracer(self) -> Tracer:
        """A tracer for the same geometry, in which each part glows with its number."""
        return self._engine.numbered()


def _switched(source: Source) -> set[str]:
    """Names by which the light of a source is switched: its own and, of a ring, those of the LEDs."""
    return {source.name, *(emitter.source for emitter in emitters(source))}


def scene_sha256(scene: Scene, prepared: PreparedScene) -> str:
    """Hash of a scene: its values in SI, and the files that it includes."""
    return sha256_of_value(
        {
            "camera": scene.camera,
            "sources": scene.sources,
            "materials": scene.materials,
            "targets": scene.targets,
            "files": {name: content.hex() for name, content in prepared.scene.files.items()},
            "included": prepared.identity if scene.included else "",
            "text": prepared.scene.text if scene.included else "",
            **({"spectral": scene.spectral} if scene.spectral else {}),
        }
    )


@contextmanager
def laid_out(scene: Scene, options: RenderOptions) -> Iterator[LaidOutScene]:
    """A scene laid out for probes; its files and programs are gone at the end of the block."""
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder, Programs() as programs:
        yield LaidOutScene(scene, options, programs, Path(folder))


@contextmanager
def traced_scene(scene: Scene, options: RenderOptions | None = None) -> Iterator[View]:
    """A view of a scene for probes, as `laid_out`."""
    with laid_out(scene, options or RenderOptions()) as traced:
        yield traced.view()


def with_bounces(view: View, bounces: int) -> View:
    """The view with surfaces that light each other; one process, so that its random draws come in one order."""
    if isinstance(view.tracer, SummedTracer):
        parts = [with_bounces(replace(view, tracer=part), bounces).tracer for part in view.tracer.parts]
        return replace(view, tracer=SummedTracer(tuple(parts)), workers=1)
    return replace(view, tracer=replace(_radiance(view), bounces=bounces), workers=1)


def of_channel(view: View, channel: ColourChannel) -> View:
    """The view as one of the tracer's channels shows it."""
    return replace(view, tracer=replace(_radiance(view), channel=channel))


def _radiance(view: View) -> RadianceTracer:
    if not isinstance(view.tracer, RadianceTracer):
        raise TypeError("only Radiance does that")
    return view.tracer
