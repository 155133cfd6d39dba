"""Which effects a scene needs: the error in gray levels of leaving each out, measured by a few thousand rays.

Each effect is measured at some pixels by two independent sets of rays, traced
with and without it along the same paths. What is lacking goes through Eq. 5,
and the product of the two sets has the mean square of the error as its mean,
free of what so few rays add.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.forecast.explain import unsaturated
from radwrap.imaging.forecast.time_effects import time_changes
from radwrap.imaging.forecast.wave_change import MOST_RAYS, wave_change
from radwrap.imaging.methods.rays import rays_over
from radwrap.imaging.optics.diffraction import wavelength_of
from radwrap.imaging.optics.view import View, rays_through, trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded
from radwrap.imaging.tolerance.certificate import PixelSample, lacks_in_gray, places_of, root
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tolerance.plans import NEGLIGIBLE_SHARE, Plans, choose
from radwrap.imaging.tolerance.survey import Survey, survey, with_smooth_blocks
from radwrap.imaging.tracing import LaidOutScene, laid_out, of_channel, with_bounces
from radwrap.manifest import plain
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import ColourChannel
from radwrap.scene.instants import averaged
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter, Ring, SingleSource, Source, emitters
from radwrap.scene.targets import Flat, Solid
from radwrap.tracers.bouncing import SURE_STEPS

_PIXELS: Final = 256
_RAYS: Final = 8  # of each pixel in each of the two sets
_CHANNELS: Final[tuple[ColourChannel, ...]] = ("red", "green", "blue")
# Light that has gone so often from one surface to another is what is measured: at a reflectance of 0.5 on all sides
# of a closed box, 7/8 of all that there is.
_BOUNCES: Final = 3
_BEYOND: Final = "bounces_beyond_"
# A path of the tracer's own interreflection asks hundreds of times for each of them, a walk three times.
_MANY_EMITTERS: Final = 100
# The one source that stands for a ring is so small beside its LEDs that it hides nearly nothing.
_SHRUNK: Final = 0.1


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect, and what leaving it out costs.

    Attributes
    ----------
    name : str
        "finite_aperture", "cos4", "depth_spread", "diffraction", "aberrations", "bounces", "bounces_beyond_3", "bands",
        "leds", "led_differences", "motion" or "shutter".
    left_out : str
        What the image would be without it.
    rms_gray, rms_gray_upper95 : float
        Error of leaving it out, and its bound [gray level].
    needed : bool
        Whether that bound takes more than a small share of the tolerance.
    rays : int
        What measuring it took; 0 where the scene alone tells.
    """

    name: str
    left_out: str
    rms_gray: float
    rms_gray_upper95: float
    needed: bool
    rays: int

    def grown(self, growth: float, tolerance: float | None) -> Effect:
        """The same effect where errors of gray levels are larger by a factor; without a tolerance needed as before."""
        upper = growth * self.rms_gray_upper95
        needed = self.needed if tolerance is None else upper > NEGLIGIBLE_SHARE * tolerance
        return replace(self, rms_gray=growth * self.rms_gray, rms_gray_upper95=upper, needed=needed)

    def as_manifest(self) -> dict[str, Any]:
        """Its values by name."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Probe:
    """Paths through some pixels and the opening, two sets of equal size, and what they see.

    Attributes
    ----------
    view : View
        Whose rays.
    seed : int
        Of all that is drawn.
    sample : PixelSample
        The pixels.
    opening, u, v : ndarray
        Points of the opening [m] and places on the sensor [px] of all rays, set by set.
    values : ndarray, shape (2 * pixels * rays,)
        L cos^4(theta) of each ray [W m^-2 sr^-1].
    """

    view: View
    seed: int
    sample: PixelSample
    opening: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    values: NDArray[np.float64]

    @classmethod
    def of(cls, view: View, seed: int) -> Probe:
        """Draw paths and trace them."""
        sensor = view.camera.sensor
        random = generator(seed, Rendering.EFFECT_PATHS)
        pixels = random.choice(sensor.pixels, min(sensor.pixels, _PIXELS), replace=False)
        places = places_of(pixels, sensor.columns)
        paths = [rays_over(view.camera, *places, _RAYS, random) for _ in range(2)]
        opening, u, v = (np.concatenate(parts) for parts in zip(*paths, strict=True))
        sample = PixelSample(pixels, np.zeros(len(pixels), dtype=np.intp), np.ones(1))
        values, _ = trace_rays(view, opening, u, v)
        return cls(view, seed, sample, opening, u, v, values)

    @property
    def seen(self) -> NDArray[np.float64]:
        """Mean of L cos^4(theta) over each pixel's rays of each set [W m^-2 sr^-1], shape (2, pixels)."""
        return _by_set(self.values)

    def traced(self, view: View) -> NDArray[np.float64]:
        """What the same paths see in another view, shape (2, pixels)."""
        return _by_set(trace_rays(view, self.opening, self.u, self.v)[0])

    def through_centre(self) -> NDArray[np.float64]:
        """What rays through the same places on the sensor and the opening's centre see."""
        return _by_set(trace_rays(self.view, None, self.u, self.v)[0])

    def without_cos4(self) -> NDArray[np.float64]:
        """L in place of L cos^4."""
        _, cos4 = rays_through(self.view.camera, self.opening, self.u, self.v)
        return _by_set(self.values / cos4)

    def mean_square(self, other: NDArray[np.float64]) -> Bounded:
        """Mean square over the image of the gray levels' change to other radiances, shape (2, pixels)."""
        scale, sensor = self.view.exposure_of_radiance, self.view.camera.sensor
        seen = self.seen
        errors = lacks_in_gray(seen.mean(axis=0), other - seen, len(self.u), scale, sensor)
        return errors.mean_square(self.sample, (self.seed, Rendering.EFFECT_RESAMPLES))


def _by_set(values: NDArray[np.float64]) -> NDArray[np.float64]:
    means: NDArray[np.float64] = values.reshape(2, -1, _RAYS).mean(axis=2)
    return means


def effects(scene: Scene, options: RenderOptions | None = None) -> dict[str, Any]:
    """Measure what each effect of a scene is worth, and which method the planner would take.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : RenderOptions, optional
        For the tolerance that decides what is needed, the seed, and how Radiance is used.

    Returns
    -------
    dict
        ``effects_exposure_time``: at which all was measured [s]; the scene's, unless that saturates, then that which
        brings the peak to 80 %; ``tolerance`` [gray level]; ``tolerance_asked``, where that was not in gray levels, see
        `ToleranceAsked`;
        ``tracer``: which traces, and why, see `TracerUsed`; ``effects``: a list of `Effect`
        as dicts;
        ``planner``: ``method``, ``why``, ``expected_rays`` of each method, ``expected_model_rms_gray``.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As `render`.

    Examples
    --------
    >>> import radwrap
    >>> found = radwrap.effects(radwrap.load_scene("scene.toml"), radwrap.RenderOptions(tolerance=8))
    >>> found["planner"]["method"]
    'kernel'
    """
    options = options or RenderOptions()
    # Pulses are as long in any exposure time.
    changing = scene if scene.strobes else unsaturated(scene)
    scene = averaged(changing)
    with laid_out(scene, options) as traced:
        view = traced.view()
        options, asked = with_gray_tolerance(options, view)
        tolerance = options.gray_tolerance
        found = survey(view, options.seed)
        choice = choose(
            Plans(with_smooth_blocks(view, found, tolerance, options.seed), found, options.demand, options.seed)
        )
        measured = [*_measured(traced, view, found, tolerance, options.seed)]
        changes = time_changes(changing, options)
        measured += [_effect(one.name, one.left_out, one.square, one.rays, tolerance) for one in changes]
        each = [effect.as_manifest() for effect in measured]
    planner = {"method": choice.method, "why": choice.why, **choice.as_manifest()}
    tracer = plain(traced.tracer_used, named=False)
    told = {} if asked is None else {"tolerance_asked": plain(asked, named=False)}
    exposure = {"effects_exposure_time": scene.camera.exposure_time}
    return {"tolerance": tolerance, **told, **exposure, "tracer": tracer, "effects": each, "planner": planner}


def diffraction_left_out(
    scene: Scene,
    view: View,
    seed: int,
    tolerance: float,
    most_rays: int = MOST_RAYS,
    *,
    image: NDArray[np.float64] | None = None,
) -> Effect:
    """What diffraction at the opening would change of an image that is made by rays, which know no waves.

    Parameters
    ----------
    scene : Scene
        For the wavelength, see `wavelength_of`.
    view : View
        Whose rays; of the same light as the image.
    seed, tolerance
        As of `bounces`.
    most_rays, image
        As of `wave_change`.
    """
    square, rays = wave_change(view, wavelength_of(scene)[0], seed, most_rays, image=image)
    left_out = "light is rays, and the opening sends no waves"
    if _has_glass(scene):
        left_out += ", so that the lens has no aberrations either"
    return _effect("diffraction", left_out, square, rays, tolerance)


def _aberrations(scene: Scene, view: View, seed: int, tolerance: float) -> Effect:
    """What the lens's aberrations are worth; parameters as of `diffraction_left_out`."""
    square, rays = wave_change(view, wavelength_of(scene)[0], seed, of_glass=True)
    return _effect("aberrations", "waves behind a perfect lens", square, rays, tolerance)


def _has_glass(scene: Scene) -> bool:
    return scene.camera.lens is not None and scene.camera.lens.glass is not None


def bounces(
    scene: Scene,
    view: View,
    seed: int,
    tolerance: float,
    probe: Probe | None = None,
    *,
    traced: LaidOutScene | None = None,
) -> Effect:
    """What light that goes from one surface to another adds; no ray is traced where a scene cannot have any.

    Parameters
    ----------
    scene : Scene
        What the view shows.
    view : View
        Whose rays.
    seed : int
        Of all that is drawn.
    tolerance : float
        That decides what is needed [gray level].
    probe : Probe, optional
        Of that view and seed, where it is there already.
    traced : LaidOutScene, optional
        Of that view: walks are compiled, and with many sources Radiance's walks take an eighth of the time of its own
        interreflection.
    """
    square, rays = NOTHING, 0
    if not _is_convex(scene):
        bouncing = None
        if traced is not None and (traced.is_compiled or len(scene.emitters) > _MANY_EMITTERS):
            with suppress(InputError):  # of sheeting and the like walks know nothing
                bouncing = traced.bouncing_view(_BOUNCES)
        if bouncing is None:
            bouncing = with_bounces(traced.radiance_view() if traced else view, _BOUNCES)
            if traced is not None and traced.whole:
                # Radiance bounces the light of patches: what these are off by is no bounce.
                probe = Probe.of(traced.radiance_view(), seed)
        probe = probe or Probe.of(view, seed)
        square = probe.mean_square(probe.traced(bouncing))
        rays = 2 * len(probe.u)
    return _effect("bounces", "surfaces do not light each other", square, rays, tolerance)


def bounces_beyond(traced: LaidOutScene, orders: int, seed: int, tolerance: float) -> Effect:
    """What light adds that was reflected more often than a number of times before it reached what is seen.

    The same walks with and without that limit: up to it they are alike, and what they have in common adds no noise.

    Raises
    ------
    InputError
        As `LaidOutScene.bouncing_view`.
    """
    probe = Probe.of(traced.bouncing_view(orders), seed)
    square = probe.mean_square(probe.traced(traced.bouncing_view(None, max(SURE_STEPS, orders))))
    left_out = f"light ends after {orders} reflection{'s' if orders > 1 else ''} before what is seen"
    return _effect(f"{_BEYOND}{orders}", left_out, square, 2 * len(probe.u), tolerance)


def _measured(traced: LaidOutScene, view: View, found: Survey, tolerance: float, seed: int) -> Iterator[Effect]:
    scene = traced.scene
    probe = Probe.of(view, seed)
    rays = len(probe.u)
    finite = not scene.camera.aperture.is_infinitesimal
    yield _effect(
        "finite_aperture",
        "an infinitesimal pinhole that lets through as much light",
        probe.mean_square(probe.through_centre()) if finite else NOTHING,
        2 * rays if finite else 0,
        tolerance,
    )
    yield _effect("cos4", "no falloff towards the corners", probe.mean_square(probe.without_cos4()), rays, tolerance)
    yield _effect(
        "depth_spread",
        "the blur of the middle depth everywhere",
        found.one_layer,
        found.rays if finite else 0,
        tolerance,
    )
    yield diffraction_left_out(scene, view, seed, tolerance)
    if _has_glass(scene):
        yield _aberrations(scene, view, seed, tolerance)
    yield (first := bounces(scene, view, seed, tolerance, probe, traced=traced))
    if first.needed:
        # What was measured ends there; of sheeting and the like nobody knows more.
        with suppress(InputError):
            yield bounces_beyond(traced, _BOUNCES, seed, tolerance)
    yield _bands(traced, probe, tolerance)
    rings = any(isinstance(source, Ring) for source in scene.sources)
    if rings:
        alone = traced.view_lit_by(tuple(map(_one_source, scene.sources)))
        square = probe.mean_square(probe.traced(alone))
        yield _effect("leds", "each ring as one source in its centre", square, 2 * rays, tolerance)
    if any(isinstance(source, Ring) and source.changes for source in scene.sources):
        alike = traced.view_lit_by(tuple(map(_all_alike, scene.sources)))
        square = probe.mean_square(probe.traced(alike))
        yield _effect("led_differences", "each ring with LEDs that are all alike", square, 2 * rays, tolerance)


def _bands(traced: LaidOutScene, probe: Probe, tolerance: float) -> Effect:
    """What colours are worth: of spectra, one band for all light; of an included file, the mean of its channels."""
    rays, view = len(probe.u), probe.view
    left_out = "the mean of the three channels"
    if traced.banding.bands is not None:
        several = len(traced.banding.bands.bands) > 1
        square = probe.mean_square(probe.traced(traced.one_band_view())) if several else NOTHING
        return _effect("bands", "one band for the light of all sources", square, 2 * rays * several, tolerance)
    if not (traced.scene.included and traced.scene.camera.sensor.channel != "equal"):
        return _effect("bands", left_out, NOTHING, 0, tolerance)
    mean = np.mean([probe.traced(of_channel(view, one)) for one in _CHANNELS], axis=0)
    return _effect("bands", left_out, probe.mean_square(mean), 4 * rays, tolerance)


def warnings_of_left_out(effect: Effect) -> Iterator[str]:
    """What a user should know of light that an image lacks, where it matters: bounces or diffraction."""
    if not effect.needed:
        return
    what = "light that goes from one surface to another"
    if effect.name == "diffraction":
        what = "diffraction at the opening"
    elif effect.name.startswith(_BEYOND):
        what = f"light that is reflected more than {effect.name.removeprefix(_BEYOND)} times on its way"
    yield (
        f"{what} is left out: it would change the image by about "
        f"{effect.rms_gray:.2g} gray rms (at most {effect.rms_gray_upper95:.2g})"
    )


def _effect(name: str, left_out: str, square: Bounded, rays: int, tolerance: float) -> Effect:
    upper = root(square.upper)
    return Effect(name, left_out, root(square.mean), upper, upper > NEGLIGIBLE_SHARE * tolerance, rays)


def _is_convex(scene: Scene) -> bool:
    """Whether no point of a surface can see another: one target, flat or convex."""
    return len(scene.targets) == 1 and isinstance(scene.targets[0], Flat | Solid)


def _one_source(source: Source) -> Source:
    """A ring as one source in its centre, of the same radiant intensity."""
    if not isinstance(source, Ring):
        return source
    pose = source.turned_pose
    radiance = math.fsum(emitter.radiance for emitter in emitters(source)) / _SHRUNK**2
    axis = (pose.rotation[0][2], pose.rotation[1][2], pose.rotation[2][2])
    radius = source.led_radius * _SHRUNK
    return SingleSource("led", Emitter(source.name, pose.position, axis, radius, radiance, source.beam))


def _all_alike(source: Source) -> Source:
    """A ring without differences, of the same mean radiance."""
    if not isinstance(source, Ring):
        return source
    mean = math.fsum(emitter.radiance for emitter in emitters(source)) / source.count
    return replace(source, radiance=mean, changes=())
