"""A scene traced by Radiance and by POV-Ray, merged and exposed by the same code, and compared pixel by pixel.

POV-Ray shares no line of code with Radiance, so an error of either, or of how
either is asked, shows. It knows no Gaussian beam: in both tracers each one is
replaced by a power of the cosine with the same curvature on the axis, and the
result says how far that is from the beam asked for.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder, sole_owner
from radwrap.images import RadianceImage
from radwrap.imaging.forecast.cost import check_size
from radwrap.imaging.mean_radiance import viewpoint_plan
from radwrap.imaging.methods.viewpoints import ViewpointPlan, merge, trace_viewpoints
from radwrap.imaging.render_options import FixedMethod, RenderOptions
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tracing import LaidOutScene
from radwrap.imaging.truth import central_maps
from radwrap.manifest import sha256_of_value
from radwrap.process import Limits, Programs, available_cores
from radwrap.progress import Progress
from radwrap.scene.bands import one_band
from radwrap.scene.instants import held, keys_of_time
from radwrap.scene.look.wide_sources import divided
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Beam, Ring, SingleSource, Source, WideSource
from radwrap.study.crosscheck_terms import Seen, sees
from radwrap.tracers.povray import PovrayTracer, find_povray
from radwrap.tracers.povray_text import povray_scene
from radwrap.tracers.tracer import Tracer

Array = NDArray[np.float64]

_WORK: Final = ".work"
# POV-Ray sleeps for most of a second in each small picture; so many at a time keep two cores busy.
_PICTURES_AT_ONCE: Final = 8
_LARGEST_GRID: Final = 64


@dataclass(frozen=True, slots=True)
class CrosscheckOptions:
    """How two tracers are compared.

    Attributes
    ----------
    render : RenderOptions
        Sub-viewpoints, rays a pixel, and how Radiance is used.
    area_samples : int
        0: POV-Ray's sources shine from their centres, as Radiance's; n: from n x n points of their discs.
    tolerance : float
        Largest relative difference that counts as agreement, rms.
    povray : str, optional
        The program, default the one on PATH.
    """

    render: RenderOptions
    area_samples: int = 0
    tolerance: float = 0.005
    povray: str | None = None

    def __post_init__(self) -> None:
        if not 1e-4 <= self.tolerance <= 1:
            raise InputError("must lie between 1e-4 and 1", where="tolerance")
        if self.area_samples != 0 and not 2 <= self.area_samples <= _LARGEST_GRID:
            raise InputError(f"must be 0, or lie between 2 and {_LARGEST_GRID}", where="area_samples")
        if self.render.pixel_sampling != "centre":
            raise InputError("POV-Ray samples the centres of pixels' strata", where="pixel_sampling")


@dataclass(frozen=True, slots=True, eq=False)
class Crosscheck:
    """Both images, and what each pixel shows.

    Attributes
    ----------
    scene : Scene
        As both tracers got it.
    options : CrosscheckOptions
        How.
    radiance, povray : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
    gray : tuple of ndarray
        Gray levels of both before rounding, Radiance's first.
    seen : Seen
        What each pixel shows, and what closed forms expect there.
    beams : tuple of dict
        Gaussian beams that were replaced.
    viewpoints : int
        Number of sub-viewpoints.
    versions : dict
        Of both tracers.
    wall_s : dict
        Time that each took [s].
    changing : tuple of str
        Keys by which the scene changes in the course of its exposure: what is compared is its first middle.
    """

    scene: Scene
    options: CrosscheckOptions
    radiance: Array
    povray: Array
    gray: tuple[Array, Array]
    seen: Seen
    beams: tuple[dict[str, Any], ...]
    viewpoints: int
    versions: dict[str, str]
    wall_s: dict[str, float]
    changing: tuple[str, ...] = ()


def crosscheck(scene: Scene, out: Path, options: CrosscheckOptions) -> Crosscheck:
    """Trace a scene by both and compare.

    Parameters
    ----------
    scene : Scene
        What is there.
    out : Path
        A folder; finished sub-viewpoints stay in it until both images are whole.
    options : CrosscheckOptions
        How.

    Raises
    ------
    InputError
        If the scene holds what POV-Ray cannot express, or there is nothing to compare.
    EnvironmentFailure
        If a tracer is missing, of another version, fails, or gives an image that is not whole.
    """
    with ExitStack() as owned, tempfile.TemporaryDirectory(prefix="radwrap-") as folder, Programs() as programs:
        installation = find_povray(programs, options.povray)
        beams = gaussian_beams(scene)
        changing = keys_of_time(scene)
        scene = divided(without_gaussian_beams(one_band(held(scene), "sources")))
        method: FixedMethod = "pinhole" if scene.camera.aperture.is_infinitesimal else "viewpoints"
        number = 1 if method == "pinhole" else options.render.viewpoint_number
        workers = options.render.workers or available_cores()
        check_size(scene, options.render.max_pixels, number * options.render.pixel_samples**2, workers)
        traced = LaidOutScene(scene, options.render, programs, Path(folder))
        frame = traced.prepared.scene.frame
        text = povray_scene(scene, traced.prepared.included, frame, area_samples=options.area_samples)
        plan = viewpoint_plan(scene, options.render, method, traced.sha256())
        progress = Progress("tracing twice", 2 * plan.rays, shown=options.render.progress)
        runs = _Runs(out / _WORK, programs, progress)
        make_folder(out)  # not before: what is refused leaves none
        owned.enter_context(sole_owner(out))
        try:
            depth, parts = central_maps(scene.camera, traced.numbered_tracer())
            radiance = runs.image("radiance", plan, traced.view().tracer, workers)
            _check_seen(scene, bool(parts.any() or radiance.any()), "nothing is in view")
            witness = PovrayTracer(
                installation,
                programs,
                Path(folder) / "povray",
                text,
                frame=frame,
                camera=scene.camera,
                samples=plan.pixel_plan.samples,
                expected_peak=float(radiance.max()) or 1.0,
                limits=Limits(silence=options.render.tracer_timeout),
            )
            told = sha256_of_value({"text": text, "povray": installation.sha256})
            povray = runs.image("povray", replace(plan, traced_sha256=told), witness, _PICTURES_AT_ONCE)
        finally:
            progress.close()
        seen = sees(scene, options.area_samples, radiance, (depth, parts), traced.prepared)
        shutil.rmtree(out / _WORK, ignore_errors=True)
        _check_seen(scene, bool(radiance.any() or povray.any()), "both images are black")
    versions = {"radiance": traced.version, "povray": installation.version}
    gray = (_gray(scene, radiance), _gray(scene, povray))
    return Crosscheck(scene, options, radiance, povray, gray, seen, beams, number, versions, runs.wall_s, changing)


def _check_seen(scene: Scene, seen: bool, what: str) -> None:
    """Two tracers that see nothing agree on nothing."""
    if not seen:
        raise InputError(
            f"{what}: there is nothing to compare", where=scene.origin, remedy="look at the camera and the sources"
        )


class _Runs:
    """Images by several tracers, each with its pieces in a folder of its own."""

    def __init__(self, folder: Path, programs: Programs, progress: Progress) -> None:
        self._folder = folder
        self._programs = programs
        self._progress = progress
        self.wall_s: dict[str, float] = {}

    def image(self, name: str, plan: ViewpointPlan, tracer: Tracer, workers: int) -> Array:
        folder = self._folder / name
        make_folder(folder)
        start = time.monotonic()
        trace_viewpoints(plan, tracer, folder, programs=self._programs, workers=workers, progress=self._progress)
        self.wall_s[name] = time.monotonic() - start
        return merge(plan, folder)


def _gray(scene: Scene, radiance: Array) -> Array:
    exposure = radiant_exposure(RadianceImage(radiance), scene.camera)
    return gray_levels(exposure.values, scene.camera.sensor)


def without_gaussian_beams(scene: Scene) -> Scene:
    """The same scene with each Gaussian beam as the power of the cosine that meets it on the axis."""
    return replace(scene, sources=tuple(map(_cosine_source, scene.sources)))


def _cosine_source(source: Source) -> Source:
    if isinstance(source, WideSource):
        patches = tuple(replace(patch, beam=_cosine(patch.beam)) for patch in source.patches)
        return replace(source, beam=_cosine(source.beam), patches=patches)
    if isinstance(source, Ring):
        return replace(source, beam=_cosine(source.beam))
    return replace(source, emitter=replace(source.emitter, beam=_cosine(source.emitter.beam)))


def _cosine(beam: Beam) -> Beam:
    return replace(beam, profile="cosine_power") if beam.profile == "gaussian" else beam


def gaussian_beams(scene: Scene) -> tuple[dict[str, Any], ...]:
    """The Gaussian beams of a scene, and how far each is from the power of the cosine that stands for it.

    cos^n(theta) with n = 1/s^2 is exp(-theta^2/(2 s^2)) (1 - theta^4/(12 s^2) - ...). With x = theta^2/(2 s^2) the
    difference is exp(-x) s^2 x^2/3, which is largest, 4 exp(-2)/3 s^2 = 0.18 s^2 of the beam's peak, at x = 2.
    """
    found = []
    for source in scene.sources:
        beam = source.emitter.beam if isinstance(source, SingleSource) else source.beam
        if beam.profile == "gaussian":
            theta = np.linspace(0, min(8 * beam.spread, math.pi / 2), 4001)
            apart = np.abs(beam.relative_intensity(theta) - _cosine(beam).relative_intensity(theta))
            found.append(
                {
                    "source": source.name,
                    "standard_deviation_deg": math.degrees(beam.spread),
                    "cosine_power": beam.spread**-2,
                    "largest_difference_of_peak": float(apart.max()),
                    "closed_form": 4 * math.exp(-2) / 3 * beam.spread**2,
                }
            )
    return tuple(found)
