"""How far the gray values of an image may be off, by measurement."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.aperture import sub_viewpoints
from radwrap.imaging.exposure import radiant_exposure
from radwrap.imaging.sensor import gray_levels
from radwrap.imaging.view import PixelPlan, pixel_means, ray_blocks, traced
from radwrap.imaging.viewpoints import Merged, ViewpointPlan
from radwrap.tracers.tracer import Tracer

_PROBED_PIXELS: Final = 512
_PROBE_VIEWPOINTS: Final = 61
_PROBE_SAMPLES: Final = 5


def error_of_viewpoints(plan: ViewpointPlan, merged: Merged) -> dict[str, Any]:
    """Error of a merged image from its two halves.

    The halves are images of their own, each from half of the sub-viewpoints.
    Half their difference estimates the error of the whole image, on the safe
    side: on rad_scenes/bench_board it is 1.4 to 1.6 times the true error for
    7 to 127 sub-viewpoints. It does not see what both halves share, such as
    the sampling inside the pixels.

    Parameters
    ----------
    plan : ViewpointPlan
        What was traced.
    merged : Merged
        With its halves.

    Returns
    -------
    dict
        rms_gray and max_gray [gray level], how they were measured.
    """
    if not merged.halves:
        return {"rms_gray": None, "max_gray": None, "method": "none", "note": "one sub-viewpoint has no halves"}
    first, second = (_gray(plan, half) for half in merged.halves)
    return {
        **_statistics((first - second) / 2),
        "method": "halves",
        "note": "half the difference of two images from every second sub-viewpoint; an estimate, not a bound",
    }


def error_of_pinhole(plan: ViewpointPlan, tracer: Tracer, merged: Merged) -> dict[str, Any]:
    """Error of an infinitesimal-pinhole image against the finite pinhole, or the finite pixel, at some pixels.

    Returns
    -------
    dict
        As `error_of_viewpoints`; the pixels are drawn with the plan's seed.
    """
    camera = plan.camera
    number = camera.sensor.pixels
    rng = np.random.default_rng([plan.pixel_plan.seed, 1])
    pixels = np.sort(rng.choice(number, min(_PROBED_PIXELS, number), replace=False))
    if camera.aperture.is_infinitesimal:
        positions, weights = plan.viewpoints.positions, plan.viewpoints.weights
        pixel_plan = PixelPlan(_PROBE_SAMPLES * plan.pixel_plan.samples)
        against = f"{pixel_plan.rays} rays over each pixel"
    else:
        finite = sub_viewpoints(camera.aperture, _PROBE_VIEWPOINTS)
        positions, weights = finite.positions, finite.weights
        pixel_plan = plan.pixel_plan
        against = f"{_PROBE_VIEWPOINTS} sub-viewpoints over the pinhole"
    reference = np.zeros(len(pixels))
    for index, (position, weight) in enumerate(zip(positions.tolist(), weights, strict=True)):
        blocks = ray_blocks(camera, (position[0], position[1]), pixel_plan, index, pixels)
        means = [pixel_means(block, radiance) for block, radiance in traced(tracer.trace, blocks)]
        reference += weight * np.concatenate(means)
    difference = _gray(plan, merged.mean.ravel()[pixels][np.newaxis]) - _gray(plan, reference[np.newaxis])
    return {
        **_statistics(difference),
        "method": "probe",
        "note": f"difference to {against}, at {len(pixels)} pixels drawn at random; an estimate, not a bound",
    }


def _gray(plan: ViewpointPlan, mean_radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    exposure = radiant_exposure(mean_radiance, plan.camera, plan.viewpoints.area, {})
    return gray_levels(exposure.values, plan.camera.sensor)


def _statistics(difference: NDArray[np.float64]) -> dict[str, float]:
    return {"rms_gray": float(np.sqrt(np.mean(difference**2))), "max_gray": float(np.abs(difference).max())}
