"""One way of sampling for many images that are compared: nothing that an image shows decides where its rays go.

A search by each image for itself (`planner`) samples bright images finer than dark ones, as its tolerance is absolute;
what coarser sampling does to a measurement then looks like an effect of the light. Here pilots say what each image
needs, the strictest decides, and every image gets as many rays in the same places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from radwrap.imaging.demand import (
    COARSEST_CELL,
    FEWEST,
    FINEST_CELL,
    MOST,
    REPLICATES,
    Demand,
    SamplingPlan,
)
from radwrap.imaging.methods.kernel import KernelPlan, plan_kernel
from radwrap.imaging.methods.rays import MEAN_GAIN, ORDER, RaysPlan, plan_rays
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.certificate import root
from radwrap.imaging.tolerance.planner import Outcome, Search, noise_quantile
from radwrap.imaging.tolerance.plans import MODEL_SHARE, NEGLIGIBLE_SHARE
from radwrap.imaging.tolerance.replicates import Replicates, Work, discretisation, trace_replicates
from radwrap.imaging.tolerance.survey import AIM_SHARE, Survey, met_by, middle_of, survey

# Mean squares of what noise and the cells' size add fall at least as the cube of the cells' size: see `kernel`.
_FALL: Final = 8.0
_PILOT_REPLICATES: Final = 2
# Where the model takes nearly all of the tolerance, noise gets so much of it, as in `planner`.
_LEAST_SHARE: Final = 0.3


@dataclass(frozen=True, slots=True)
class Pilot:
    """What one image needs to keep its tolerance.

    Attributes
    ----------
    cell : float or None
        Of the kernel [px]; None where its model does not hold.
    layered : bool
        Whether the kernel must tell depths apart.
    rays : int
        Of each pixel and replicate, by rays.
    pixels, covered : float
        Pixels of the image, and of what the kernel gathers from.
    wave_cell : float or None
        Cells by which diffraction is to be taken [px]; None where it need not.
    wave_far : float or None
        Share of the light that it may send farther than is looked at by cells, likewise.
    """

    cell: float | None
    layered: bool
    rays: int
    pixels: float
    covered: float
    wave_cell: float | None = None
    wave_far: float | None = None


def pilot(work: Work, demand: Demand) -> Pilot:
    """Look at an image by a survey and by two coarse replicates.

    Raises
    ------
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    view, found = work.view, survey(work.view, work.seed)
    sensor = view.camera.sensor
    layered = root(found.one_layer.upper) > NEGLIGIBLE_SHARE * demand.tolerance
    model = max((found.model if layered else found.one_layer).mean, 0.0)
    cell, covered = None, float(sensor.pixels)
    is_asked = demand.method != "rays" and math.isfinite(model)
    if is_asked and (demand.method == "kernel" or math.sqrt(model) <= MODEL_SHARE * demand.tolerance):
        usual = _even_kernel(view, found, layered=layered)
        replicates = trace_replicates(work, usual, _PILOT_REPLICATES)
        times = _times_too_large(view, replicates, model, demand)
        # Never coarser than usual: cells that do not resolve the blur do not show what they add either.
        halvings = max(0, math.ceil(math.log(times, _FALL))) if times > 0 else 0
        cell = max(math.ldexp(usual.grid.cell, -halvings), FINEST_CELL)
        covered = replicates.rays / _PILOT_REPLICATES * usual.grid.cell**2
    # The error of one replicate's mean, and of the mean of all.
    spread = MEAN_GAIN * math.sqrt(float((found.deviations**2).mean()) / REPLICATES)
    wanted = (spread / (AIM_SHARE * demand.tolerance)) ** (1 / ORDER)
    rays = 2 ** math.ceil(math.log2(min(max(wanted, FEWEST), MOST)))
    return Pilot(cell, layered, rays, float(sensor.pixels), covered)


def _times_too_large(view: View, two: Replicates, model: float, demand: Demand) -> float:
    """Mean square error that all replicates would have, over what may be left of it."""
    noise, errors = discretisation(view, two)
    one = (noise.mean - two.grid_square) * _PILOT_REPLICATES
    left = (AIM_SHARE * demand.tolerance) ** 2 - model
    times = (one / REPLICATES + two.grid_square) / max(left, (_LEAST_SHARE * AIM_SHARE * demand.tolerance) ** 2)
    if demand.max_error is not None:
        quantile = noise_quantile(errors, noise) / (AIM_SHARE * demand.max_error)
        times = max(times, quantile**2 * _PILOT_REPLICATES / REPLICATES)
    return times


def strictest(pilots: Sequence[Pilot], demand: Demand) -> SamplingPlan:
    """The plan by which each of one or more images is expected to keep its tolerance, as far as the budget goes."""
    cells = [one.cell for one in pilots if one.cell is not None]
    rays = max(one.rays for one in pilots)
    waves, far = (
        min((one for one in each if one is not None), default=None)
        for each in ([one.wave_cell for one in pilots], [one.wave_far for one in pilots])
    )
    by_rays = SamplingPlan("rays", rays=rays, wave_cell=waves, wave_far=far)
    if demand.method == "rays" or not cells or (len(cells) < len(pilots) and demand.method is None):
        return _affordable(by_rays, pilots, demand)
    layered = any(one.layered for one in pilots)
    by_kernel = SamplingPlan("kernel", cell=min(cells), layered=layered, wave_cell=waves, wave_far=far)
    cheaper = min((by_kernel, by_rays), key=lambda plan: _cost(plan, pilots))
    return _affordable(by_kernel if demand.method == "kernel" else cheaper, pilots, demand)


def _cost(plan: SamplingPlan, pilots: Sequence[Pilot]) -> float:
    """Rays of the dearest image."""
    if plan.cell is None:
        return plan.replicates * (plan.rays or 1) * max(one.pixels for one in pilots)
    return plan.replicates * max(one.covered for one in pilots) / plan.cell**2


def _affordable(plan: SamplingPlan, pilots: Sequence[Pilot], demand: Demand) -> SamplingPlan:
    while _cost(plan, pilots) > demand.budget.rays:
        if plan.cell is not None and plan.cell < COARSEST_CELL:
            plan = replace(plan, cell=2 * plan.cell)
        elif plan.rays is not None and plan.rays > FEWEST:
            plan = replace(plan, rays=plan.rays // 2)
        else:
            break
    return plan


def _even_kernel(view: View, found: Survey, *, layered: bool, cell: float | None = None) -> KernelPlan:
    """A kernel with a ray in each cell; of the usual size where none is said."""
    met = met_by(view, found.magnification)
    met = met if layered else middle_of(met)
    if cell is None:
        cell = plan_kernel(view, met, 1.0).grid.cell
    return plan_kernel(view, met, 0.0, even_cell=cell)


def even_plan(view: View, found: Survey, plan: SamplingPlan) -> KernelPlan | RaysPlan:
    """What is traced of one image by a plan of many."""
    if plan.method == "rays":
        return plan_rays(view, 0.0, even=plan.rays)
    return _even_kernel(view, found, layered=plan.layered, cell=plan.cell)


def render_by_plan(work: Work, demand: Demand, plan: SamplingPlan) -> Outcome:
    """Make the image by a plan, and say whether it keeps its tolerance; it is not tried again.

    Raises
    ------
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    search = Search(work, demand, relit=True)  # an even plan has a ray in each cell
    rays = even_plan(work.view, search.found, plan)
    outcome = search.made(rays, plan.replicates, "the plan of all images that are compared")
    return replace(outcome, record=search.recorded(outcome.record, sampling=plan))
