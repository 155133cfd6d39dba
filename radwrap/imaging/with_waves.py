"""Diffraction of an image that is made: measured, and taken where the scene asks for it or it matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.demand import FINEST_CELL, REPLICATES
from radwrap.imaging.forecast.effects import Effect, diffraction_left_out
from radwrap.imaging.forecast.wave_change import MOST_RAYS
from radwrap.imaging.mean_radiance import Made, fixed_method
from radwrap.imaging.methods.kernel import TooDeep
from radwrap.imaging.methods.pieces import run_jobs
from radwrap.imaging.methods.smooth_blocks import with_known
from radwrap.imaging.optics.diffraction import Light, light_of_all, wavelength_of
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.output.run_manifest import DiffractionTaken
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.cells_in_common import own_change, smaller_cell
from radwrap.imaging.tolerance.pace import Pace
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.wave_far import OF_FAR, strata_for
from radwrap.imaging.tolerance.wave_image import WaveError, look, seen_rms, visible_gray, wave_error
from radwrap.imaging.tolerance.wave_parts import WaveParts, wave_parts
from radwrap.imaging.tolerance.wave_plan import WavePlan, by_diameter, plan_waves
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
_FAR_SHARE: Final = 0.3  # of the tolerance, what the law of far light may be off by
_FAR_NOISE: Final = 0.1  # of the tolerance, what noise of far light may be, were all light noise
_TWO: Final = 2  # replicates, where nothing is made of them but their mean
# Degrees of freedom by which noise is known: its bound is then 1.4 of it. Two replicates have one for each block over
# which errors hang together, and where a small image has few blocks more replicates are made.
_DEGREES: Final = 24
# Of the tolerance, what waves may add to the error of images that are compared; and cells by which a plan of them is
# tried first, at least, where waves change less than that.
_EVEN_SHARE: Final = 0.4
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


@dataclass(frozen=True, slots=True, eq=False)
class _Waves:
    """How waves of one image are traced."""

    scene: Scene
    options: RenderOptions
    work: Work
    lights: Sequence[Light]
    about_rms: float = 0.0  # what they change [gray level]
    seen_rms: float = 0.0  # of the light that is seen [gray level]

    @property
    def wavelength(self) -> float:
        """Of all light, for the choice of rays."""
        return wavelength_of(self.scene)[0]

    @property
    def by_bands(self) -> float:
        """What one wavelength that stands for several may change, rms [gray level]."""
        return self.about_rms * max(light.spread for light in self.lights)

    @property
    def even_cell(self) -> float | None:
        """Cells of a plan of many images, which no light decides."""
        return None if self.options.sampling is None else self.options.sampling.wave_cell

    @property
    def far(self) -> float:
        """Share of the light that may go farther than the guard band; of images that are compared no light decides."""
        if self.even_cell is not None or not self.seen_rms:
            return 1.0
        return min(1.0, _FAR_SHARE * self.options.gray_tolerance / (OF_FAR * self.seen_rms))

    def plan(self, aim: float, of_cells: float, most_cell: float = math.inf, *, again: bool = False) -> WavePlan:
        """Rays for errors of a replicate by their number, and by the size of their cells [gray level].

        The latter is a guess; where it was wrong, these are no larger than `most_cell` [px]. What is bright beside the
        sensor may need more rays for far light than what is seen on it lets expect: `again`.
        """
        share = of_cells / self.about_rms if self.about_rms > of_cells else 1.0
        planned = partial(plan_waves, self.work.view, self.wavelength, aim, self.options.seed)
        plan = planned(share=share, most_cell=most_cell, far=self.far, even_cell=self.even_cell)
        if self.even_cell is not None or not self.seen_rms or again:
            return plan
        return replace(plan, far_strata=strata_for(plan, self.seen_rms, _FAR_NOISE * self.options.gray_tolerance))

    def replicates(self, made: Made, plan: WavePlan) -> int:
        """As many as the image has, where each is kept; else so many that their noise is known."""
        if (self.options.basis or self.options.sampling is not None) and made.outcome is not None:
            return len(made.outcome.replicates.images)
        return self.fewest_replicates(plan)

    def fewest_replicates(self, plan: WavePlan) -> int:
        """So many that their noise is known."""
        sensor = self.scene.camera.sensor
        blocks = math.ceil(sensor.rows / plan.block) * math.ceil(sensor.columns / plan.block)
        return max(_TWO, 1 + math.ceil(_DEGREES / blocks))

    def kept_or_anew(self, parts: WaveParts, plan: WavePlan, made: Made) -> tuple[WaveParts, int]:
        """What waves add, in as many replicates as an image has that was made anew; and how many rays that took."""
        replicates = self.replicates(made, plan)
        if len(parts.change) == replicates:
            return parts, 0
        parts = self.parts(plan, replicates)
        return parts, parts.rays

    def parts(
        self, plan: WavePlan, replicates: int, told_by: Callable[[WavePlan], WavePlan] = lambda plan: plan
    ) -> WaveParts:
        work = self.work
        work.progress.left(replicates * len(self.lights) * self.scene.camera.sensor.pixels)
        plans = [(light.view, told_by(plan.at(light.wavelength))) for light in self.lights]
        run = partial(run_jobs, programs=work.programs, workers=work.view.workers)
        return wave_parts(work.view, plans, replicates, progress=work.progress.add, run=run)


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

    def added(self, plan: WavePlan, parts: WaveParts, waves: _Waves, rays: int) -> tuple[Made, WaveError]:
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


def foreseen_waves(scene: Scene, options: RenderOptions, work: Work, replicates: int) -> tuple[WavePlan, int] | None:
    """By which rays, and how many sets of them, waves are expected to be taken, of an image of so many replicates.

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
    waves = _Waves(scene, options, work, (light_of_all(scene, work.view),), found.rms_gray, seen)
    left = math.sqrt(1 - _USUAL**2) * options.gray_tolerance
    try:
        plan = waves.plan(_AIM * left, OF_CELLS * left)
    except TooDeep:
        return None
    each_is_kept = options.basis or options.sampling is not None
    return plan, replicates if each_is_kept else waves.fewest_replicates(plan)


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
    found = diffraction_left_out(scene, work.view, options.seed, options.gray_tolerance, rays)
    if not _is_taken(scene, options, made, found):
        return WithWaves(made, found, None)
    more_may_help = options.sampling is None
    image = _Image(made, found.rays, again)
    little = leaves(options.gray_tolerance, made) < LEAST_LEFT * options.gray_tolerance
    if more_may_help and _is_met(made) and little and not pace.is_spent():
        image.make_finer(LESS * options.gray_tolerance)  # whatever waves take then, it would have to be made anew
    smooth = None if image.made.outcome is None else image.made.outcome.smooth
    work = replace(work, view=replace(work.view, smooth=smooth))
    known = _with_smooth(lights(), smooth)
    waves = _Waves(scene, options, work, known, found.rms_gray, seen_rms(image.made.radiance, work.view))
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


def _to_tolerance(image: _Image, waves: _Waves, pace: Pace) -> _Added:
    """Add waves, by more rays and smaller cells where these keep the whole from its tolerance, or to a finer image.

    Raises
    ------
    TooDeep
        If the scene is too deep for them.
    """
    tolerance, more_may_help = waves.options.gray_tolerance, waves.options.sampling is None
    left = left_to_waves(tolerance, image.made)
    aim, of_cells, most_cell, again = _AIM * left, OF_CELLS * left, math.inf, False
    for tries_left in reversed(range(_TRIES if more_may_help else 1)):
        pace.begin()
        plan = waves.plan(aim, of_cells, most_cell, again=again)
        parts = waves.parts(plan, waves.replicates(image.made, plan))
        whole, off = image.added(plan, parts, waves, parts.rays)
        pace.end()
        if _is_met(whole) or not _is_met(image.made) or not more_may_help or pace.is_spent():
            break
        if (left_to_all := _square_left(tolerance, waves, off)) <= (FINER * tolerance) ** 2:
            break  # no rays make smaller what takes the rest
        if image.may_be_finer and (not tries_left or not _more_rays_may_do(image.made, waves, off, LEAST_LEFT)):
            image.make_finer(min(LESS * tolerance, left_to_image(left_to_all, off)))
            parts, rays = waves.kept_or_anew(parts, plan, image.made)
            whole, off = image.added(plan, parts, waves, rays)
        if _is_met(whole) or not _more_rays_may_do(image.made, waves, off):
            break
        least = LESS if tries_left > 1 else FINER  # the last one is to do
        of_noise, of_size = finer(tolerance, image.made, off, least=least)
        aim, of_cells, again = of_noise * aim, of_size * of_cells, True
        if of_size < 1 and image.made.outcome is not None:
            most_cell = smaller_cell(image.made.outcome, plan)
    return _Added(whole, off, replace(plan, sampling=parts.sampling), parts, aim)


def _blur_slope(waves: _Waves, added: _Added) -> Array:
    """Relative change of the light with the logarithm of the opening's diameter, by what waves do."""
    work, light = waves.work, added.whole.radiance
    usual = plan_waves(work.view, waves.wavelength, added.aim, waves.options.seed)
    changed = waves.parts(usual, _TWO, by_diameter).change.mean(axis=0)
    return np.where(light > 0, changed / np.where(light > 0, light, 1.0), 0.0)


def even_wave_cell(scene: Scene, work: Work, options: RenderOptions) -> float | None:
    """Cells that waves of one image need of a plan of many [px]; None where it needs no waves.

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
    waves = _Waves(scene, replace(options, sampling=None), work, lights, found.rms_gray)
    aim = _EVEN_SHARE * tolerance
    try:
        cell = waves.plan(aim, aim).kernel.grid.cell
        if found.rms_gray <= aim:  # cells of any size show waves to within about what they change
            cell = max(cell, _COARSEST_EVEN)
        while cell > FINEST_CELL and not _do_even_cells(waves, cell, aim):
            cell /= 2
    except TooDeep as error:
        raise _too_deep() from error
    return cell


def _do_even_cells(waves: _Waves, cell: float, aim: float) -> bool:
    """Whether waves by even cells [px] are off by less than an aim in the mean of all replicates, rms [gray level]."""
    work = waves.work
    plan = plan_waves(work.view, waves.wavelength, 0.0, waves.options.seed, even_cell=cell)
    parts = waves.parts(plan, _TWO)
    found = _error(plan, parts, np.maximum(look(work.view, whole=True) + parts.change.mean(axis=0), 0.0), work)
    return found.noise.mean * _TWO / REPLICATES + found.cells <= aim**2


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


def _more_rays_may_do(made: Made, waves: _Waves, off: WaveError, share: float = 0.0) -> bool:
    """Whether the image and what its waves are off by anyway would leave a share of what is asked to rays and cells."""
    known, demand = beside_waves(made), waves.options.demand
    parts = known.rms_gray_upper95, math.sqrt(off.lasting), off.tails, share * waves.options.gray_tolerance
    lasting = math.hypot(*parts) + waves.by_bands
    return demand is not None and demand.is_met(lasting, known.p99_gray_upper95)


def _lasting(off: WaveError) -> float:
    """What waves are off by whatever rays are taken, rms [gray level]."""
    return math.hypot(math.sqrt(off.lasting), off.tails)


def _square_left(tolerance: float, waves: _Waves, off: WaveError) -> float:
    """Mean square that what no rays make smaller leaves to the image, and to rays and cells of its waves [gray^2]."""
    return max(tolerance - waves.by_bands, 0.0) ** 2 - off.tails**2 - off.lasting


def _error(
    plan: WavePlan, parts: WaveParts, made: Array, work: Work, own: tuple[Array, Array] | None = None
) -> WaveError:
    view = work.view
    return wave_error(parts, made, visible_gray(view.exposure_of_radiance, view.camera.sensor), plan.block, own)


def _added(made: Made, plan: WavePlan, parts: WaveParts, waves: _Waves, rays: int) -> tuple[Made, WaveError]:
    """The image with what waves add and the certificate of both, and how far it may be off by them."""
    radiance = np.maximum(made.radiance + parts.change.mean(axis=0), 0.0)
    outcome, options, own = made.outcome, waves.options, None
    # Images that are compared, and a basis in other light, have what their cells change by itself.
    if outcome is not None and options.sampling is None and not options.basis:
        own = own_change(outcome, plan, [light.wavelength for light in waves.lights])
    found = _error(plan, parts, radiance, waves.work, own)
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
