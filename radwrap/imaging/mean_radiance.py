"""The ways to a finite aperture, each from a scene's tracer to mean radiance with its error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.asked_tolerance import USUAL
from radwrap.imaging.methods.viewpoints import ViewpointPlan, merge, trace_viewpoints
from radwrap.imaging.optics.aperture import Layout, central_viewpoint, sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan, PixelSampling
from radwrap.imaging.render_options import FixedMethod, Method, RenderOptions
from radwrap.imaging.tolerance.certificate import Certificate, certify_by_independent_rays
from radwrap.imaging.tolerance.planner import Outcome, Search, render_to_tolerance
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.sampling import render_by_plan
from radwrap.scene.scene import Scene
from radwrap.written import Count, NotNegative, Rays


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodUsed:
    """The way to the opening that was taken; in the manifest under these names.

    Attributes
    ----------
    method : str
        "pinhole", "viewpoints", "kernel" or "rays".
    layout, viewpoints, pixel_samples, pixel_sampling : str or int, optional
        Options of a method whose rays are fixed beforehand.
    rays_per_pixel : float
        Of the image, on average.
    rays : int
        In all.
    """

    method: Method
    layout: Layout | None = None
    viewpoints: Count | None = None
    pixel_samples: Count | None = None
    pixel_sampling: PixelSampling | None = None
    rays_per_pixel: NotNegative
    rays: Rays


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What a method made.

    Attributes
    ----------
    radiance : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
    used : MethodUsed
        How.
    certificate : Certificate
        Its error.
    reused : int
        Pieces that were found on the disk.
    outcome : Outcome or None
        How it came about, where a tolerance decided.
    """

    radiance: NDArray[np.float64]
    used: MethodUsed
    certificate: Certificate
    reused: int
    outcome: Outcome | None = None


def fixed_method(scene: Scene, options: RenderOptions) -> FixedMethod | None:
    """The method whose rays are fixed beforehand; None where a tolerance decides.

    Raises
    ------
    InputError
        If sub-viewpoints are asked for in an infinitesimal pinhole.
    """
    asked = options.fixed_method
    if asked != "viewpoints" or options.method is not None or not scene.camera.aperture.is_infinitesimal:
        return asked
    if options.viewpoints is not None:
        raise InputError(
            "there are no sub-viewpoints as the pinhole's diameter is 0", where="viewpoints", remedy="leave it out"
        )
    return "pinhole"


def how(scene: Scene, options: RenderOptions) -> dict[str, Any]:
    """All options that decide the pixels; not where they go, who traces them and how fast."""
    method = fixed_method(scene, options)
    if method is None:
        keys = ("max_error", "budget_rays", "budget_seconds", "seed")
        # A default that hangs on the light is known by its name; what was asked for in gray levels, by these.
        usual = "default" if scene.camera.sensor.linear else USUAL
        asked = {"method": options.method, "tolerance": usual if options.tolerance is None else options.tolerance}
        # Named only where it is asked for: what a run is known by stays as it was for all others.
        bounces = {"bounces": options.bounces} if options.bounces else {}
        sampling = {"sampling": options.sampling} if options.sampling else {}
        return asked | {key: getattr(options, key) for key in keys} | bounces | sampling
    pixels = {"samples": options.pixel_samples, "sampling": options.pixel_sampling}
    opening = {"viewpoints": options.viewpoint_number, "layout": options.layout} if method == "viewpoints" else {}
    return {"method": method, "seed": options.seed, **pixels, **opening}


def viewpoint_plan(scene: Scene, options: RenderOptions, method: FixedMethod, traced_sha256: str) -> ViewpointPlan:
    """What pinhole and viewpoints trace."""
    aperture = scene.camera.aperture
    finite = method == "viewpoints"
    return ViewpointPlan(
        camera=scene.camera,
        viewpoints=sub_viewpoints(aperture, options.viewpoint_number, options.layout)
        if finite
        else central_viewpoint(aperture),
        pixel_plan=PixelPlan(options.pixel_samples, options.pixel_sampling, options.seed),
        traced_sha256=traced_sha256,
    )


def make(
    scene: Scene,
    options: RenderOptions,
    work: Work,
    before: Callable[[Search | ViewpointPlan], None] | None = None,
    *,
    relit: bool = False,
) -> Made:
    """Trace what the options ask for; finished pieces in the folder are used again.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : RenderOptions
        How.
    work : Work
        Where and by whom.
    before : callable, optional
        Is told what will be traced, once that is known; not where a plan of many images decides.
    relit : bool
        Whether images in other light will be made of the same cells.

    Raises
    ------
    InputError
        If the method does not fit the scene.
    TracerError, EnvironmentFailure
        If the tracer or the disk fails.
    """
    method = fixed_method(scene, options)
    if method is None:
        return _to_tolerance(options, work, before, relit)
    plan = viewpoint_plan(scene, options, method, work.traced_sha256)
    if before is not None:
        before(plan)
    work.progress.expect(plan.rays)
    reused = trace_viewpoints(
        plan,
        work.view.tracer,
        work.folder,
        programs=work.programs,
        workers=work.view.workers,
        progress=work.progress,
    )
    radiance = merge(plan, work.folder)
    number = len(plan.viewpoints)
    used = MethodUsed(
        method=method,
        layout=options.layout if number > 1 else None,
        viewpoints=number,
        pixel_samples=options.pixel_samples,
        pixel_sampling=options.pixel_sampling,
        rays_per_pixel=number * plan.pixel_plan.rays,
        rays=plan.rays,
    )
    return Made(radiance, used, certify_by_independent_rays(work.view, radiance, options.seed), reused)


def _to_tolerance(options: RenderOptions, work: Work, before: Callable[[Search], None] | None, relit: bool) -> Made:
    if options.sampling is None:
        outcome = render_to_tolerance(work, options.demand, before, relit=relit)
    else:
        outcome = render_by_plan(work, options.demand, options.sampling)
    sensor = work.view.camera.sensor
    per_pixel = outcome.replicates.rays / sensor.pixels
    used = MethodUsed(method=outcome.method, rays_per_pixel=per_pixel, rays=outcome.record.rays)
    return Made(outcome.radiance, used, outcome.certificate, outcome.reused, outcome)
