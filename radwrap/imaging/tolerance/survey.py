"""What a few thousand rays tell of a scene before an image is made: depths, the kernel's model, the spread of rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.methods.kernel import plan_kernel
from radwrap.imaging.methods.rays import (
    GAIN_OF_WALKS,
    ORDER,
    ORDER_OF_WALKS,
    PILOT,
    gray_deviation,
    plan_rays,
    sampled_radiance,
)
from radwrap.imaging.methods.smooth_blocks import smooth_field
from radwrap.imaging.optics.guard_band import least_guard
from radwrap.imaging.optics.smooth import BLOCK
from radwrap.imaging.optics.view import View, magnifications_at
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded, stratified_mean
from radwrap.imaging.tolerance.certificate import PixelSample, model_errors, places_of
from radwrap.imaging.tolerance.replicates import replicates_needed
from radwrap.imaging.tolerance.sampled_blocks import with_sampled_blocks
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Sensor

_SURVEY_SIDE: Final = 128  # rows and columns of the survey's grid of central rays, which are told distances alone
_SURVEY_PIXELS: Final = 192
_SURVEY_PAIRS: Final = 4
# Share of the tolerance that the predicted error takes: the bound lies above the error by 10 to 30 %.
AIM_SHARE: Final = 0.75
# Of fewer blocks most would lie at the image's edge, or at one of a part.
_FEWEST_BLOCKS: Final = 100


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a few thousand rays tell beforehand.

    Attributes
    ----------
    magnification : ndarray, shape (rows, columns)
        m of what a grid of central rays met, `Camera.shear` where nothing.
    model : Bounded
        Mean square error of the kernel's model [gray level^2].
    one_layer : Bounded
        The same for a kernel of one magnification, the median: what the spread of depths costs.
    deviations : ndarray
        Standard deviation of one ray at pixels drawn at random [gray level].
    pixels : ndarray of int
        Their numbers, row by row.
    lacks : ndarray
        Squares of what the kernel's model lacks at each of them, as two independent values tell it [gray level^2].
    rays : int
        What it took.
    """

    magnification: NDArray[np.float64]
    model: Bounded
    one_layer: Bounded
    deviations: NDArray[np.float64]
    pixels: NDArray[np.intp]
    lacks: NDArray[np.float64]
    rays: int


def survey(view: View, seed: int) -> Survey:
    """Look at depths, at the kernel's model and at the spread of rays at a few pixels."""
    sensor = view.camera.sensor
    shape = tuple(min(size, _SURVEY_SIDE) for size in (sensor.rows, sensor.columns))
    magnification = magnifications_at(view, *surveyed_places(sensor)).reshape(shape)
    drawn = generator(seed, Rendering.SURVEYED_PIXELS).choice(
        sensor.pixels, min(sensor.pixels, _SURVEY_PIXELS), replace=False
    )
    pilot = sampled_radiance(view, *places_of(drawn, sensor.columns), PILOT, generator(seed, Rendering.SURVEYED_RAYS))
    deviations = gray_deviation(pilot, plan_rays(view, 1.0))
    rays = magnification.size + pilot.size
    model = one_layer = NOTHING
    lacks = np.zeros(len(drawn))
    if not view.camera.aperture.is_infinitesimal:
        every = np.zeros(len(drawn), dtype=np.intp)
        sample = PixelSample(drawn, every, np.ones(1), every + _SURVEY_PAIRS)

        def error_of(layers: tuple[float, ...]) -> Bounded:
            nonlocal rays, lacks
            errors = model_errors(view, layers, sample, pilot.mean(axis=1), seed=(seed, Rendering.SURVEYED_MODEL))
            rays += errors.rays
            lacks = errors.first * errors.second
            # What so few pairs see decides what is tried, not what is certified.
            return stratified_mean(lacks, sample.stratum, sample.shares, (seed, Rendering.SURVEYED_RESAMPLES))

        met = met_by(view, magnification)
        model = one_layer = error_of(plan_kernel(view, middle_of(met), 1.0).layers)
        try:
            layers = plan_kernel(view, met, 1.0).layers
            model = error_of(layers) if len(layers) > 1 else one_layer
        except InputError:  # too deep for layers
            model = Bounded(math.inf, math.inf)
    return Survey(magnification, model, one_layer, deviations, drawn, lacks, rays)


def surveyed_places(sensor: Sensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows of the survey's grid on the sensor [px], row by row."""
    rows, columns = (
        (np.arange(n) + 0.5) / n * size - 0.5
        for size, n in (
            (sensor.rows, min(sensor.rows, _SURVEY_SIDE)),
            (sensor.columns, min(sensor.columns, _SURVEY_SIDE)),
        )
    )
    u, v = np.meshgrid(columns, rows)
    return u.ravel(), v.ravel()


def with_smooth_blocks(view: View, found: Survey, tolerance: float, seed: int, *, sampled: bool = True) -> View:
    """The view with what is known of its smooth blocks, where a kernel's cells would be smaller than these.

    Those that are not proved to be smooth count where they may be `sampled`: see `with_sampled_blocks`.
    """
    if not math.isfinite(found.model.mean) or view.camera.sensor.pixels < _FEWEST_BLOCKS * BLOCK**2:
        return view
    plan = plan_kernel(view, met_by(view, found.magnification), AIM_SHARE * tolerance)
    if plan.grid.base >= BLOCK:
        return view
    reach = max(plan.reach_px)
    if view.camera.diffraction is not None:  # what waves look at is known then too
        reach += least_guard(view.camera.sensor)
    field = smooth_field(view, reach, tolerance)
    if field is not None and sampled:
        field = with_sampled_blocks(view, field, tolerance, seed)
    return replace(view, smooth=field)


def met_by(view: View, magnification: NDArray[np.float64]) -> NDArray[np.float64]:
    """Magnifications of what was met."""
    return magnification[magnification > view.camera.shear]


def middle_of(magnification: NDArray[np.float64]) -> NDArray[np.float64]:
    """Their median alone, where there are any."""
    return np.median(magnification, keepdims=True) if magnification.size else magnification


def predicted_rays(view: View, found: Survey, tolerance: float, finer: int = 0) -> tuple[float, float]:
    """Rays that `rays` and `kernel` are expected to take for an rms error: a model, good to a factor of about two.

    `finer` is how often the kernel's cells are halved.
    """
    sensor = view.camera.sensor
    aim = AIM_SHARE * tolerance * math.sqrt(2)
    gain, order = (GAIN_OF_WALKS, ORDER_OF_WALKS) if view.walks else (1.0, ORDER)
    numbers = np.clip((gain * found.deviations / aim) ** (1 / order), 4, 1 << 14)
    rays = 2 * sensor.pixels * (PILOT + float(numbers.mean()))
    if not math.isfinite(found.model.mean):
        return rays, math.inf
    plan = plan_kernel(view, met_by(view, found.magnification), aim, finer)
    reach = plan.reach_px
    covered = (sensor.columns + 2 * reach[0]) * (sensor.rows + 2 * reach[1])
    # About as many again where cells are cut; and none where all is known.
    known, rest = (0, 1.0) if view.smooth is None else (view.smooth.rays, 1 - view.smooth.share)
    kernel = known + 2 * replicates_needed(plan) * covered / plan.grid.base**2 * rest
    return rays, kernel
