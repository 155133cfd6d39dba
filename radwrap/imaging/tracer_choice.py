"""Which tracer a scene is traced by: decided by what it holds, by counts and by a comparison, never by a clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.extras import installing
from radwrap.imaging.demand import FEWEST
from radwrap.imaging.optics.view import rays_through
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.scene import Scene
from radwrap.scene.sources import WideSource
from radwrap.tracers.agreement import Agreement, agreement
from radwrap.tracers.bouncing import SURE_STEPS, Reflecting
from radwrap.tracers.engine import Engine, EngineName
from radwrap.tracers.expressible import compiler_lacks, inexpressible
from radwrap.tracers.text_frame import users_frame
from radwrap.tracers.tracer import Tracer

# Rays times sources that Radiance traces in about the time that the compiled tracer takes to be loaded, .3 s.
WORTH_COMPILED: Final = 500_000
# What the light of one source of a basis takes Radiance besides: it begins programs for each of its pieces, and
# follows all primary rays anew. The compiled tracer tells sources apart in one pass, and is faster from five on.
_BASIS_SOURCE: Final = 100_000
# Rays that certify an image at least: of 512 pixels, four pairs each, twice, for one layer of depth.
_CERTIFIED_PIXELS: Final = 512
_CERTIFYING: Final = 16
# Rays that tell what waves change, where a scene does not leave them out; an image that has them takes as many again.
WAVE_RAYS: Final = 1 << 16
# Rays of a pixel whose walks are the fewest that tell their noise: two replicates, each with a pilot of twice as many.
_WALKS: Final = 2 * 3 * FEWEST
# What each step of a walk asks Radiance besides a ray to each source: where the surface is, and whose.
_ASKED_BESIDES: Final = 2
_PROBE: Final = 512
# Half of the probe lies in pairs around where one part ends and another begins: found to within this [px], and then
# moved apart by half of that. Radiance loses grazing light to a body's rim, and a polygon of it is larger by 1e-6
# square units over the length of a side. No image shows either, and a ray that comes too near to a rim does.
_NEAR: Final = 0.03
# What float32 may lose of the light of sources that the text's unit of radiance is chosen for.
_LOST: Final = 1e-30
_LOOKED_AT: Final = 4096
_REMEDY: Final = f"{installing('fast')}, or trace by Radiance"


@dataclass(frozen=True, slots=True)
class TracerUsed:
    """Which tracer a run used; the manifest's ``tracer``.

    Attributes
    ----------
    name : str
        "radiance" or "compiled".
    reason : str
        Why.
    probe : Agreement, optional
        What a comparison of both showed.
    walks : Agreement, optional
        The same of walks of light from surface to surface, over `SURE_STEPS` steps, where they are asked for.
    whole : tuple of str, optional
        Wide lights that shine as a whole, not from the middles of their patches.
    in_patches : tuple of str, optional
        Wide lights that shine from their patches: their half shadows come in steps.
    """

    name: EngineName
    reason: str
    probe: Agreement | None = field(default=None, metadata=ONLY_WHERE_USED)
    walks: Agreement | None = field(default=None, metadata=ONLY_WHERE_USED)
    whole: tuple[str, ...] | None = field(default=None, metadata=ONLY_WHERE_USED)
    in_patches: tuple[str, ...] | None = field(default=None, metadata=ONLY_WHERE_USED)


def candidate(scene: Scene, options: RenderOptions) -> TracerUsed:
    """The tracer that a scene and options ask for, before a comparison.

    Raises
    ------
    InputError
        If the compiled tracer is asked for, and cannot show the scene.
    EnvironmentFailure
        If it is asked for, and its compiler is not installed.
    """
    if options.tracer == "radiance":
        return TracerUsed("radiance", "asked for")
    cannot = inexpressible(scene)
    lacks = compiler_lacks()
    if options.tracer == "compiled":
        if cannot:
            raise InputError(
                f"the compiled tracer cannot show this scene: {cannot}",
                where="tracer",
                remedy="leave it out, or trace by Radiance",
            )
        if lacks:
            raise EnvironmentFailure(f"the compiled tracer cannot run: {lacks}", where="tracer", remedy=_REMEDY)
        return TracerUsed("compiled", "asked for")
    if cannot:
        return TracerUsed("radiance", cannot)
    sources, sensor = max(len(scene.emitters), 1), scene.camera.sensor
    walked = sensor.pixels * _walked(sources, sensor, options)
    work = walked or sources * (_fewest_rays(scene.camera, options) + options.basis * _BASIS_SOURCE)
    told = f"about {work} rays of walks times sources" if walked else f"{work} rays times sources at least"
    if options.basis:
        told = f"a basis of {sources} sources: as much as {work} rays times sources"
    whole = [source.name for source in scene.sources if isinstance(source, WideSource) and source.is_outline]
    if whole:  # to cut them takes longer than to load the compiled tracer, and each ray then asks hundreds of patches
        told = f"wide lights shine as a whole: {', '.join(whole)}"
    elif work < WORTH_COMPILED:
        return TracerUsed("radiance", f"{told}, below {WORTH_COMPILED}")
    if lacks:
        return TracerUsed("radiance", lacks)
    return TracerUsed("compiled", told)


def _walked(sources: int, sensor: Sensor, options: RenderOptions) -> int:
    """Rays times sources that walks of a pixel take about; 0 where there are none.

    A walk of a closed white room is off by 1.5 times what it is the mean of, here a third of the sensor's range.
    """
    if options.bounces in (0, "auto"):  # of which it is known only once light was traced
        return 0
    off = (sensor.saturation_gray - sensor.dark_gray) / 2
    walks = max(_WALKS, math.ceil((off / options.asked_tolerance.in_gray(sensor)) ** 2))
    return walks * (1 + _steps_of(options)) * (sources + _ASKED_BESIDES)


def _steps_of(options: RenderOptions) -> int:
    """Steps of a walk that is compared."""
    return min(options.bounces, SURE_STEPS) if isinstance(options.bounces, int) else SURE_STEPS


def _fewest_rays(camera: Camera, options: RenderOptions) -> int:
    """Rays that an image takes at least; of a small one its certificate takes most."""
    pixels, samples = camera.sensor.pixels, options.pixel_samples**2
    if options.fixed_method == "viewpoints":
        return pixels * samples * options.viewpoint_number
    if options.fixed_method is not None or camera.aperture.is_infinitesimal:
        return pixels * samples
    waves = WAVE_RAYS if camera.diffraction else 0
    return pixels * samples + _CERTIFYING * min(pixels, _CERTIFIED_PIXELS) + waves


def probed(reference: Tracer, other: Engine, scene: Scene, rays: NDArray[np.float64]) -> Agreement:
    """A comparison of a tracer with Radiance along the rays of a probe."""
    return agreement(reference, other.tracer(scene), rays, nothing=_nothing(scene))


def walks_probed(
    engines: tuple[Engine, Engine],
    scene: Scene,
    materials: tuple[Reflecting | None, ...],
    options: RenderOptions,
    rays: NDArray[np.float64],
) -> Agreement:
    """A comparison of walks by Radiance with those by another tracer, which have the same draws."""
    steps = _steps_of(options)
    reference, other = (engine.bouncing(scene, materials, steps) for engine in engines)
    return agreement(reference, other, rays, places=1 + steps, nothing=_nothing(scene))


def _nothing(scene: Scene) -> float:
    """Radiance that Radiance may take for none [W m^-2 sr^-1]."""
    return _LOST * users_frame(scene).radiance


def geometry_of(camera: Camera) -> Camera:
    """The camera but for what decides no ray: exposure time, and how its sensor responds to light."""
    sensor = replace(camera.sensor, gain=1.0, gamma=1.0, dark_gray=0.0, saturation_gray=1.0, rounding=True, linear=None)
    return replace(camera, exposure_time=1.0, sensor=replace(sensor, bit_depth=8))


def compared(used: TracerUsed, options: RenderOptions, found: Agreement, walks: Agreement | None = None) -> TracerUsed:
    """The tracer after a comparison of the compiled one with Radiance, and perhaps of their walks.

    Both have wide lights in the same patches.

    Raises
    ------
    EnvironmentFailure
        If the compiled tracer was asked for, and they do not agree.
    """
    differing = [
        f"{one.differing} of {one.rays} {what}"
        for one, what in ((found, "rays"), (walks, "walks"))
        if one is not None and not one.agree
    ]
    if not differing:
        return replace(used, probe=found, walks=walks)
    told = f"the compiled tracer and Radiance differ on {' and '.join(differing)}"
    if options.tracer == "compiled":
        raise EnvironmentFailure(told, where="tracer", remedy="trace by Radiance, and report the scene")
    return TracerUsed("radiance", told, found, walks)


def probe_rays(camera: Camera, numbered: Tracer) -> NDArray[np.float64]:
    """Rays through the opening: half of them anywhere, half through places where central rays see parts end."""
    random = generator(0, Rendering.TRACER_PROBE)
    sensor = camera.sensor
    size = np.array([sensor.columns, sensor.rows])
    places = random.random((_LOOKED_AT, 2)) * size - 0.5
    ends = random.permutation(_steps(places, size, lambda uv: _parts(camera, numbered, uv)))[: _PROBE // 2]
    places = np.concatenate([ends, places])[:_PROBE]
    radius, turn = np.sqrt(random.random(_PROBE)), 2 * np.pi * random.random(_PROBE)
    opening = camera.aperture.diameter / 2 * np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    # Through the centre where a part ends: those rays lie as near to it as they were found to.
    opening[: len(ends)] = 0.0
    central, _ = rays_through(camera.without_lens, (0.0, 0.0), *places[: len(ends)].T)
    others, _ = rays_through(camera, opening[len(ends) :], *places[len(ends) :].T)
    return np.concatenate([central, others])


def _parts(camera: Camera, numbered: Tracer, places: NDArray[np.float64]) -> NDArray[np.float64]:
    rays, _ = rays_through(camera.without_lens, (0.0, 0.0), *places.T)
    return next(numbered.trace([rays]))


def _steps(
    places: NDArray[np.float64],
    size: NDArray[np.intp],
    parts: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Places beside where parts end, on both sides, shape (n, 2); found by halving between places that differ."""
    one, other = places, np.roll(places, 1, axis=0)
    first, second = parts(one), parts(other)
    differ = first != second
    one, other, first = one[differ][:_PROBE], other[differ][:_PROBE], first[differ][:_PROBE]
    for _ in range(max(1, int(np.ceil(np.log2(float(np.linalg.norm(size)) / _NEAR))))):
        middle = (one + other) / 2
        same = (parts(middle) == first)[:, np.newaxis]
        one, other = np.where(same, middle, one), np.where(same, other, middle)
    aside = (other - one) / 2
    return np.concatenate([one - aside, other + aside])
