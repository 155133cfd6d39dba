"""A scene of one instant and one colour, laid out once: settings in memory, without the work that all share."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder
from radwrap.imaging.demand import Budget, Demand
from radwrap.imaging.optics.aperture import Viewpoints, central_viewpoint, sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan, View, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tolerance.planner import render_to_tolerance
from radwrap.imaging.tolerance.plans import Plans
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.survey import predicted_rays, survey, with_smooth_blocks
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import sha256_of_value, versions
from radwrap.process import Programs, children_cpu_time
from radwrap.progress import Progress
from radwrap.random_streams import generator
from radwrap.scene.scene import Scene
from radwrap.study.paper_method import summed_viewpoints
from radwrap.study.reference import Reference, distance, take_reference
from radwrap.study.trade_rows import CERTIFIED, Row, Setting, TooLong, TradeOptions

# A method that misses its tolerance tries again; after so many times the rays that were expected, or the longest time,
# it has shown enough.
_PATIENCE: Final = 8
_TIMED_RAYS: Final = 1 << 15


class LaidOutBench:
    """Settings on one laid-out scene; see `trade.Bench`."""

    takes_fixed = True

    def __init__(self, scene: Scene, work: Path, options: TradeOptions, programs: Programs) -> None:
        self.scene, self.work, self.options, self.programs = scene, work, options, programs
        traced = LaidOutScene(scene, options.render, programs, work, exact_bands=True)
        self.view = traced.view()
        self.tolerance = with_gray_tolerance(options.render, self.view)[0].gray_tolerance
        self.traced_sha256 = traced.sha256()
        self.sha256 = sha256_of_value(
            {
                "traced": self.traced_sha256,
                "camera": scene.camera,
                "reference": [options.reference_pixels, options.reference_rays],
                "seed": options.render.seed,
                "versions": {**versions(), "radiance": traced.version},
            }
        )

    def take_reference(self, progress: Callable[[int], None]) -> Reference:
        """What errors are taken against."""
        options = self.options
        return take_reference(
            self.view,
            pixels=options.reference_pixels,
            rays=options.reference_rays,
            seed=options.render.seed,
            progress=progress,
        )

    def get_ready(self) -> None:
        """Look at the scene as much as forecasts need."""
        self.seconds_per_ray = _seconds_per_ray(self.view)
        self.survey = survey(self.view, self.options.render.seed)

    def is_affordable(self, rays_per_pixel: int) -> bool:
        """Whether so many rays take no longer than a setting may."""
        rays = rays_per_pixel * self.scene.camera.sensor.pixels
        return rays * self.seconds_per_ray <= self.options.longest

    def measured(self, setting: Setting, reference: Reference) -> Row:
        """What a setting costs, and how good it is.

        Raises
        ------
        InputError
            If the scene cannot be rendered so.
        TooLong
            If it is expected to take longer than a setting may.
        """
        expected = self._expected_rays(setting)
        if not math.isfinite(expected):
            raise InputError("the scene is too deep for one central image")
        if expected * self.seconds_per_ray > self.options.longest:
            raise TooLong(f"expected to take longer than {self.options.longest:g} s, by {expected:.3g} rays")
        viewpoints = self._points(setting)
        start, cpu = time.monotonic(), time.process_time() + children_cpu_time()
        if setting.tolerance is None:
            plan = PixelPlan(setting.pixel_samples, setting.pixel_sampling, self.options.render.seed)
            radiance = summed_viewpoints(self.view, viewpoints, plan, self.programs)
            rays, met, certified = round(expected), None, None
        else:
            radiance, rays, met, certified = self._to_tolerance(setting, expected)
        wall, cpu = time.monotonic() - start, time.process_time() + children_cpu_time() - cpu
        seen = radiance.ravel()[reference.sample.pixels] * self.view.exposure_of_radiance
        error = distance(reference, gray_levels(seen, self.scene.camera.sensor))
        return Row(setting, rays, met, certified, error, wall, cpu)

    def _expected_rays(self, setting: Setting) -> float:
        if setting.tolerance is not None:
            view = with_smooth_blocks(self.view, self.survey, setting.tolerance, self.options.render.seed)
            if setting.method == "hybrid":
                return Plans(view, self.survey, Demand(setting.tolerance), self.options.render.seed).hybrid_rays()
            rays, kernel = predicted_rays(view, self.survey, setting.tolerance)
            return kernel if setting.method == "kernel" else rays
        return (setting.viewpoints or 1) * setting.pixel_samples**2 * self.scene.camera.sensor.pixels

    def _points(self, setting: Setting) -> Viewpoints:
        aperture = self.scene.camera.aperture
        if setting.viewpoints is None or setting.layout is None:
            return central_viewpoint(aperture)
        return sub_viewpoints(aperture, setting.viewpoints, setting.layout)

    def _to_tolerance(self, setting: Setting, expected: float) -> tuple[NDArray[np.float64], int, bool, float]:
        assert setting.tolerance is not None  # noqa: S101  (a certified method has one)
        method = next(method for method in CERTIFIED if method == setting.method)
        folder = self.work / setting.name
        make_folder(folder)
        quiet = Progress("", 1, shown=False)
        outcome = render_to_tolerance(
            Work(self.view, folder, self.programs, quiet, self.traced_sha256, self.options.render.seed),
            Demand(setting.tolerance, method=method, budget=Budget(rays=self._patience(expected))),
        )
        shutil.rmtree(folder, ignore_errors=True)
        return outcome.radiance, outcome.record.rays, outcome.met, outcome.certificate.rms_gray_upper95

    def _patience(self, expected: float) -> float:
        return min(_PATIENCE * expected, self.options.longest / self.seconds_per_ray)


def _seconds_per_ray(view: View) -> float:
    """Wall time of a ray with all workers busy [s]."""
    sensor = view.camera.sensor
    u, v = generator(0).random((2, _TIMED_RAYS)) * [[sensor.columns], [sensor.rows]] - 0.5
    start = time.monotonic()
    trace_rays(view, None, u, v)
    return (time.monotonic() - start) / _TIMED_RAYS
