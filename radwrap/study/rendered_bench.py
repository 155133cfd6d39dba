"""A scene that is rendered in parts, of colours or of instants: each setting is a render of it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from radwrap.files import make_folder
from radwrap.imaging.in_time.moving import tracer_of_many
from radwrap.imaging.mosaicked import brightest_colour, plane_of
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import sha256_of_value, versions
from radwrap.process import Programs, children_cpu_time
from radwrap.scene.instants import averaged, keys_of_time
from radwrap.scene.scene import Scene
from radwrap.study.composed_reference import take_composed_reference
from radwrap.study.reference import Reference, distance, drawn_sample
from radwrap.study.trade_rows import Row, Setting, TooLong, TradeOptions

_MIDDLE: Final = "middle"
_INSTANT: Final = "instant"
_RENDER: Final = "render"


class RenderedBench:
    """Settings as renders of the scene, without diffraction; see `trade.Bench`.

    What is wanted, and which pixels are looked at, is of the middle of the first exposure and of the colour with most
    light.
    """

    def __init__(self, scene: Scene, work: Path, options: TradeOptions, programs: Programs) -> None:
        # Rays know no waves; and the scene's tolerances are those of what is captured.
        self.scene = replace(scene, camera=replace(scene.camera, diffraction=None), tolerances=None)
        self.takes_fixed = not keys_of_time(scene)
        self.work, self.options, self.programs = work, options, programs
        self.render = options.render
        if not self.takes_fixed:
            self.render = replace(options.render, tracer=tracer_of_many(scene, options.render.tracer))
        one = self.scene if scene.camera.sensor.mosaic is None else plane_of(self.scene, brightest_colour(self.scene))
        make_folder(work / _MIDDLE)
        traced = LaidOutScene(averaged(one), self.render, programs, work / _MIDDLE, exact_bands=True)
        self.view = traced.view()
        self.tolerance = with_gray_tolerance(self.render, self.view)[0].gray_tolerance
        self.sha256 = sha256_of_value(
            {
                "traced": traced.sha256(),
                "camera": self.scene.camera,
                "spectral": self.scene.spectral,
                "motions": self.scene.motions,
                "strobes": self.scene.strobes,
                "reference": [options.reference_pixels, options.reference_rays],
                "seed": self.render.seed,
                "versions": {**versions(), "radiance": traced.version},
            }
        )
        self.seconds: dict[str, tuple[float, float]] = {}  # method -> tolerance and wall time of its last setting
        self.seconds_per_ray = 0.0  # of each pixel, likewise

    def take_reference(self, progress: Callable[[int], None]) -> Reference:
        """What errors are taken against."""
        options = self.options
        sample, spent = drawn_sample(self.view, options.reference_pixels, self.render.seed)
        return take_composed_reference(
            self.scene,
            sample,
            spent,
            self.work / _INSTANT,
            rays=options.reference_rays,
            options=self.render,
            programs=self.programs,
            progress=progress,
        )

    def get_ready(self) -> None:
        """Nothing is needed: a setting takes at least as long as the coarser one before it."""

    def is_affordable(self, rays_per_pixel: int) -> bool:
        """Whether so many rays take no longer than a setting may, as the setting before took them."""
        return self.seconds_per_ray * rays_per_pixel <= self.options.longest

    def measured(self, setting: Setting, reference: Reference) -> Row:
        """What a setting costs, and how good it is.

        Raises
        ------
        InputError
            If the scene cannot be rendered so.
        TooLong
            If it is expected to take longer than a setting may, by what the one before it took.
        """
        self._foresee(setting)
        folder, keeps_tolerance = self.work / _RENDER, setting.tolerance is not None
        start, cpu = time.monotonic(), time.process_time() + children_cpu_time()
        result = render(self.scene, folder, replace(self.render, progress=False), **_options_of(setting))
        wall, cpu = time.monotonic() - start, time.process_time() + children_cpu_time() - cpu
        shutil.rmtree(folder, ignore_errors=True)
        if setting.tolerance is None:
            self.seconds_per_ray = wall / _rays_per_pixel(setting)
        else:
            self.seconds[setting.method] = setting.tolerance, wall
        seen = result.radiant_exposure.values.ravel()[reference.sample.pixels]
        error = distance(reference, gray_levels(seen, self.scene.camera.sensor))
        met = result.met if keeps_tolerance else None
        certified = result.error.rms_gray_upper95 if keeps_tolerance else None
        return Row(setting, result.run.rays, met, certified, error, wall, cpu)

    def _foresee(self, setting: Setting) -> None:
        longest = self.options.longest
        if setting.tolerance is not None:
            coarser, seconds = self.seconds.get(setting.method, (setting.tolerance, 0.0))
            if seconds > longest:
                raise TooLong(f"a tolerance of {coarser:g} took {seconds:.3g} s, longer than {longest:g} s")
        elif not self.is_affordable(rays := _rays_per_pixel(setting)):
            raise TooLong(f"expected to take longer than {longest:g} s: {self.seconds_per_ray * rays:.3g} s")


def _rays_per_pixel(setting: Setting) -> int:
    """Of methods that have a fixed number."""
    return (setting.viewpoints or 1) * setting.pixel_samples**2


def _options_of(setting: Setting) -> dict[str, Any]:
    """The setting as options of a render."""
    found: dict[str, Any] = {"method": setting.method}
    if setting.tolerance is not None:
        return {**found, "tolerance": setting.tolerance}
    if setting.viewpoints is not None:
        found |= {"viewpoints": setting.viewpoints, "layout": setting.layout}
    return {**found, "pixel_samples": setting.pixel_samples, "pixel_sampling": setting.pixel_sampling}
