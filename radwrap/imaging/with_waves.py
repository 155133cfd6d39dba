"""Diffraction of an image that is made: measured, and taken where the scene asks for it or it matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.demand import FINEST_CELL, REPLICATES
from radwrap.imaging.forecast.effects import Effect, diffraction_left_out
from radwrap.imaging.forecast.wave_change import MOST_RAYS
from radwrap.imaging.forecast.wave_rehearsal import ForeseenWaves
from radwrap.imaging.mean_radiance import Made, fixed_method
from radwrap.imaging.methods.kernel import TooDeep
from radwrap.imaging.methods.smooth_blocks import with_known
from radwrap.imaging.optics.diffraction import Light, light_of_all
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.output.run_manifest import DiffractionTaken
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.cells_in_common import own_change, smaller_cell
from radwrap.imaging.tolerance.pace import Pace
from radwrap.imaging.tolerance.replicates import Plan, Work
from radwrap.imaging.tolerance.wave_image import WaveError, look, seen_rms, visible_gray, wave_error
from radwrap.imaging.tolerance.wave_parts import WaveParts
from radwrap.imaging.tolerance.wave_plan import WavePlan, by_diameter, plan_waves
from radwrap.imaging.wave_rays import TWO, Asked, Waves, far_share
from radwrap.imaging.wave_shares import (
    FINER,
    LEAST_LEFT,
    LESS,
    OF_CELLS,
    beside_waves,
    finer,
    leaves,
    left_to_image,
    left_to_waves,
)
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]

# Rays that tell what diffraction would change, beside those of the image; fewer where they only decide whether it is
# taken; and the fewest that tell anything.
_SHARE: Final = 0.2
_DECIDING_SHARE: Final = 0.05
_FEWEST: Final = 1 << 13
_AIM: Final = 0.7  # of what the image leaves of the tolerance, each of both replicates: their mean has half of it
_USUAL: Final = 0.7  # of the tolerance, about what an image takes of it
_TRIES: Final = 3  # plans of waves
# Of the tolerance, what no rays make smaller may leave to the image and to rays and cells of waves: each gets .42 of it
# then. With .55 left, rad_scenes/cells/backlight.toml took five times as long for .52 in place of .66, with .5 asked.
_LEAST_LEFT_TO_ALL: Final = 0.6
# Of the tolerance, what waves may add to the error of images that are compared; and cells by which a plan of them is
# tried first, at least, where waves change less than that.
_EVEN_SHARE: Final = 0.4
_EVEN_FAR_SHARE: Final = 0.4  # and what the law of light may add that they send far
_COARSEST_EVEN: Final = 0.5  # px


@dataclass(frozen=True, slots=True, eq=False)
class WithWaves:
    """An image with diffraction, or without it.

    Attributes
    ----------
    made : Made
        The image and its certificate.
    left_out : Effect, optional
        What leaving it out costs, where it was and there may be any.
    taken : DiffractionTaken, optional
        Where it was taken.
    plan : WavePlan, optional
        Likewise: by which rays.
    lights : tuple of Light
        Likewise: of which wavelengths.
    blur_slope : ndarray, shape (rows, columns), optional
        See `uncertainty_squares`; of an image with waves whose opening is not sure.
    """

    made: Made
    left_out: Effect | None
    taken: DiffractionTaken | None
    plan: WavePlan | None = None
    lights: tuple[Light, ...] = ()
    blur_slope: Array | None = None


@dataclass(slots=True, eq=False)
class _Image:
    """The image that waves are added to: it is made anew, finer, once at most."""

    made: Made
    taken: int  # rays beside its own
    again: Callable[[float], Made]
    may_be_finer: bool = True

    def make_finer(self, tolerance: float) -> None:
        """Make it to a tolerance of its own [gray level], where it does not keep that; a budget may end it too soon."""
        self.may_be_finer, known = False, self.made
        if tolerance < known.certificate.rms_gray_upper95:
            both = sorted((self.again(tolerance), known), key=lambda made: made.certificate.rms_gray_upper95)
            self.made, self.taken = both[0], self.taken + both[1].used.rays

    def added(self, plan: WavePlan, parts: WaveParts, waves: Waves, rays: int) -> tuple[Made, WaveError]:
        """The image with what waves add, which took so many rays more."""
        self.taken += rays
        return _added(self.made, plan, parts, waves, self.taken)


@dataclass(frozen=True, slots=True, eq=False)
class _Added:
    """An image with waves, how far it is off by them, and by which rays, of which noise of a replicate [gray level]."""

    whole: Made
    off: WaveError
    plan: WavePlan
    parts: WaveParts
    aim: float


def refuse_waves(scene: Scene, options: RenderOptions) -> None:
    """See that what is asked for beside diffraction goes with it.

    Raises
    ------
    InputError
        If it does not.
    """
    if scene.camera.diffraction is None:
        return
    if options.basis and scene.tolerances is not None and scene.tolerances.aperture_diameter:
        raise InputError(
            "is not known of a light basis with diffraction",
            where="tolerances.aperture_diameter",
            remedy='leave it out, or set `camera.diffraction = "off"`',
        )
    if scene.camera.diffraction != "on":
        return
    remedy = 'take another method, or `camera.diffraction = "off"`'
    if fixed_method(scene, options) == "pinhole":
        raise InputError("has no opening, and diffraction is asked for", where="method", remedy=remedy)
    if options.sampling is not None and options.sampling.wave_cell is None:
        raise InputError("is missing, and diffraction is asked for", where="sampling.wave_cell")


def rays_that_tell(scene: Scene, rays: float) -> int:
    """How many rays tell what diffraction would change of an image that takes so many."""
    share = _SHARE if scene.camera.diffraction is None else _DECIDING_SHARE
    return min(MOST_RAYS, max(_FEWEST, round(share * rays)))


def foreseen_waves(
    scene: Scene, options: RenderOptions, work: Work, image: Plan | None, replicates: int
) -> ForeseenWaves | None:
    """By which rays waves are expected to be taken, of an image by a plan in so many replicates.

    None where they are not, or cannot be.
    """
    asked = scene.camera.diffraction
    if asked is None or scene.camera.aperture.is_infinitesimal or fixed_method(scene, options) is not None:
        return None
    found = diffraction_left_out(scene, work.view, options.seed, options.gray_tolerance, _FEWEST)
    if asked == "auto" and not found.needed:
        return None
    seen = (
        0.0 if options.sampling is not None else seen_rms(look(work.view), work.view)
    )  # it decides nothing of such images
    waves = Waves(scene, options, work, (light_of_all(scene, work.view),), found.rms_gray, seen)
    left = math.sqrt(1 - _USUAL**2) * options.gray_tolerance
    try:
        plan = waves.plan(Asked(_AIM * left, OF_CELLS * left))
    except TooDeep:
        return None
    by_own_rays = waves.suffice(image, replicates, plan)
    each_is_kept = options.basis or options.sampling is not None or by_own_rays
    return ForeseenWaves(plan, replicates if each_is_kept else waves.fewest_replicates(plan), by_own_rays)


def with_waves(
    scene: Scene,
    options: RenderOptions,
    work: Work,
    made: Made,
    again: Callable[[float], Made],
    *,
    lights: Callable[[], tuple[Light, ...]],
    pace: Pace,
) -> WithWaves:
    """Measure what diffraction changes, and take it.

    Rays for that are traced once the image is whole, so that they neither decide how it is traced nor keep it from
    being traced. In the dark none are: there is no light to be bent. Of images that are compared a plan of all decides.

    Parameters
    ----------
    scene : Scene
        For the wavelength, and whether waves are asked for.
    options : RenderOptions
        How.
    work : Work
        By whom the image was traced.
    made : Made
        It.
    again : callable
        Makes the image by rays to another tolerance [gray level].
    lights : callable
        Makes views of the light of each wavelength.
    pace : Pace
        How long the image took: waves are added once at least, and made finer as time allows.

    Raises
    ------
    InputError
        If waves are asked for, and the scene is too deep for them.
    """
    camera = scene.camera
    if camera.aperture.is_infinitesimal or not (made.radiance.any() or options.sampling is not None):
        return WithWaves(made, None, None)
    work.programs.check()
    rays = rays_that_tell(scene, made.used.rays)
    asked = options.gray_tolerance
    found = diffraction_left_out(scene, work.view, options.seed, asked, rays, image=made.radiance)
    if not _is_taken(scene, options, made, found):
        if work.seen is not None:
            work.seen.clear()
        return WithWaves(made, found, None)
    more_may_help = options.sampling is None
    image = _Image(made, found.rays, again)
    little = leaves(options.gray_tolerance, made) < LEAST_LEFT * options.gray_tolerance
    if more_may_help and _is_met(made) and little and not pace.is_spent():
        image.make_finer(LESS * options.gray_tolerance)  # whatever waves take then, it would have to be made anew
    smooth = None if image.made.outcome is None else image.made.outcome.smooth
    work = replace(work, view=replace(work.view, smooth=smooth))
    known = _with_smooth(lights(), smooth)
    waves = Waves(scene, options, work, known, found.rms_gray, seen_rms(image.made.radiance, work.view))
    try:
        added = _to_tolerance(image, waves, pace)
    except TooDeep as error:
        if camera.diffraction == "auto" and more_may_help:
            return WithWaves(image.made, found, None)
        raise _too_deep() from error
    unsure = scene.tolerances is not None and scene.tolerances.aperture_diameter
    slope = _blur_slope(waves, added) if unsure else None
    told = DiffractionTaken(
        waves.wavelength, found.rms_gray, added.parts.rays, _told_wavelengths(waves.lights), _lasting(added.off)
    )
    return WithWaves(added.whole, None, told, added.plan, tuple(waves.lights), slope)


def _with_smooth(lights: tuple[Light, ...], smooth: SmoothField | None) -> tuple[Light, ...]:
    """Lights whose views know which blocks are smooth, each as it sees them."""
    if smooth is None or len(lights) == 1:  # one is the light of all
        return tuple(replace(light, view=replace(light.view, smooth=smooth)) for light in lights)
    return tuple(with_known(light, smooth) for light in lights)


def _to_tolerance(image: _Image, waves: Waves, pace: Pace) -> _Added:
    """Add waves, by more rays and smaller cells where these keep the whole from its tolerance, or to a finer image.

    Raises
    ------
    TooDeep
        If the scene is too deep for them.
    """
    tolerance, more_may_help = waves.options.gray_tolerance, waves.options.sampling is None
    left = left_to_waves(tolerance, image.made)
    asked = Asked(_AIM * left, OF_CELLS * left)
    for tries_left in reversed(range(_TRIES if more_may_help else 1)):
        pace.begin()
        plan, parts = waves.planned(image.made, asked)
        whole, off = image.added(plan, parts, waves, parts.rays)
        pace.end()
        if _is_met(whole) or not _is_met(image.made) or not more_may_help or pace.is_spent():
            break
        if (left_to_all := _square_left(tolerance, waves, off)) <= (_LEAST_LEFT_TO_ALL * tolerance) ** 2:
            break  # no rays make smaller what takes the rest
        if image.may_be_finer and (not tries_left or not _more_rays_may_do(image.made, waves, off, LEAST_LEFT)):
            image.make_finer(min(LESS * tolerance, left_to_image(left_to_all, off)))
            known = parts
            plan, parts = waves.kept_or_anew(plan, known, image.made, asked)
            whole, off = image.added(plan, parts, waves, 0 if parts is known else parts.rays)
        if _is_met(whole) or not _more_rays_may_do(image.made, waves, off):
            break
        least = LESS if tries_left > 1 else FINER  # the last one is to do
        of_noise, of_size = finer(tolerance, image.made, off, least=least)
        asked = replace(asked, aim=of_noise * asked.aim, of_cells=of_size * asked.of_cells, again=True)
        if of_size < 1 and image.made.outcome is not None:
            asked = replace(asked, most_cell=smaller_cell(image.made.outcome, plan))
    return _Added(whole, off, replace(plan, sampling=parts.sampling), parts, asked.aim)


def _blur_slope(waves: Waves, added: _Added) -> Array:
    """Relative change of the light with the logarithm of the opening's diameter, by what waves do."""
    work, light = waves.work, added.whole.radiance
    usual = plan_waves(work.view, waves.wavelength, added.aim, waves.options.seed)
    changed = waves.parts(usual, TWO, by_diameter).change.mean(axis=0)
    return np.where(light > 0, changed / np.where(light > 0, light, 1.0), 0.0)


@dataclass(frozen=True, slots=True)
class EvenWaves:
    """What waves of one image need of a plan of many.

    Attributes
    ----------
    wave_cell : float
        Cells by which they are taken [px].
    wave_far : float
        Share of the light that they may send farther than is looked at by cells.
    """

    wave_cell: float
    wave_far: float


def even_waves(scene: Scene, work: Work, options: RenderOptions) -> EvenWaves | None:
    """What waves of one image need of a plan of many; None where it needs no waves.

    Raises
    ------
    InputError
        If waves are asked for, and the scene is too deep for them.
    """
    camera, tolerance = scene.camera, options.gray_tolerance
    if camera.diffraction is None or camera.aperture.is_infinitesimal:
        return None
    found = diffraction_left_out(scene, work.view, options.seed, tolerance)
    if camera.diffraction == "auto" and not found.needed:
        return None
    lights = (light_of_all(scene, work.view),)
    waves = Waves(scene, replace(options, sampling=None), work, lights, found.rms_gray)
    aim = _EVEN_SHARE * tolerance
    try:
        cell = waves.plan(Asked(aim, aim)).kernel.grid.cell
        if found.rms_gray <= aim:  # cells of any size show waves to within about what they change
            cell = max(cell, _COARSEST_EVEN)
        while cell > FINEST_CELL and not _do_even_cells(waves, cell, aim):
            cell /= 2
    except TooDeep as error:
        raise _too_deep() from error
    return EvenWaves(cell, far_share(seen_rms(look(work.view), work.view), _EVEN_FAR_SHARE * tolerance))


def _do_even_cells(waves: Waves, cell: float, aim: float) -> bool:
    """Whether waves by even cells [px] are off by less than an aim in the mean of all replicates, rms [gray level]."""
    work = waves.work
    plan = plan_waves(work.view, waves.wavelength, 0.0, waves.options.seed, even_cell=cell)
    parts = waves.parts(plan, TWO)
    found = _error(plan, parts, np.maximum(look(work.view, whole=True) + parts.change.mean(axis=0), 0.0), work)
    return found.noise.mean * TWO / REPLICATES + found.cells <= aim**2


def _told_wavelengths(lights: Sequence[Light]) -> tuple[float, ...] | None:
    return tuple(light.wavelength for light in lights) if len(lights) > 1 else None


def _too_deep() -> InputError:
    return InputError(
        "knows no waves of so deep a scene", where="camera.diffraction", remedy='set it "off", or bring targets nearer'
    )


def _is_taken(scene: Scene, options: RenderOptions, made: Made, found: Effect) -> bool:
    """Whether the image has waves: as the scene says, or where they matter to it or to one it is compared with."""
    asked = scene.camera.diffraction
    if asked is None or made.used.method == "pinhole":
        return False
    if asked == "on":
        return True
    return found.needed if options.sampling is None else options.sampling.wave_cell is not None


def _is_met(made: Made) -> bool:
    return made.outcome is None or made.outcome.met


def _more_rays_may_do(made: Made, waves: Waves, off: WaveError, share: float = 0.0) -> bool:
    """Whether the image and what its waves are off by anyway would leave a share of what is asked to rays and cells."""
    known, demand = beside_waves(made), waves.options.demand
    parts = known.rms_gray_upper95, math.sqrt(off.lasting), off.tails, share * waves.options.gray_tolerance
    lasting = math.hypot(*parts) + waves.by_bands
    return demand is not None and demand.is_met(lasting, known.p99_gray_upper95)


def _lasting(off: WaveError) -> float:
    """What waves are off by whatever rays are taken, rms [gray level]."""
    return math.hypot(math.sqrt(off.lasting), off.tails)


def _square_left(tolerance: float, waves: Waves, off: WaveError) -> float:
    """Mean square that what no rays make smaller leaves to the image, and to rays and cells of its waves [gray^2]."""
    return max(tolerance - waves.by_bands, 0.0) ** 2 - off.tails**2 - off.lasting


def _error(
    plan: WavePlan,
    parts: WaveParts,
    made: Array,
    work: Work,
    own: tuple[Array, Array] | None = None,
    *,
    images: NDArray[np.float32] | None = None,
) -> WaveError:
    gray = visible_gray(work.view.exposure_of_radiance, work.view.camera.sensor)
    return wave_error(parts, made, gray, plan.block, own, images=images)


def _added(made: Made, plan: WavePlan, parts: WaveParts, waves: Waves, rays: int) -> tuple[Made, WaveError]:
    """The image with what waves add and the certificate of both, and how far it may be off by them."""
    radiance = np.maximum(made.radiance + parts.change.mean(axis=0), 0.0)
    outcome, options, own = made.outcome, waves.options, None
    # Images that are compared, and a basis in other light, have what their cells change by itself.
    if outcome is not None and options.sampling is None and not options.basis:
        own = own_change(outcome, plan, [light.wavelength for light in waves.lights])
    images = outcome.replicates.images if outcome is not None and parts.by_own_rays else None
    found = _error(plan, parts, radiance, waves.work, own, images=images)
    known, bands = (found.noise, found.cells, found.tails, found.quantile + waves.by_bands), waves.by_bands
    certificate = made.certificate.with_waves(*known, bands=bands, parts=outcome.parts if outcome else ())
    used = replace(made.used, rays=made.used.rays + rays)
    if outcome is not None and (demand := options.demand) is not None:
        met = demand.is_met(certificate.rms_gray_upper95, certificate.p99_gray_upper95)
        record = replace(outcome.record, met=met)
        outcome = replace(outcome, radiance=radiance, certificate=certificate, met=met, record=record)
        if options.sampling is not None:
            outcome = replace(outcome, replicates=outcome.replicates.with_waves(parts.change, parts.cells))
    return replace(made, radiance=radiance, certificate=certificate, used=used, outcome=outcome), found
