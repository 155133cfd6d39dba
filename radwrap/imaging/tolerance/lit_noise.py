"""How noisy one frame is where there is light: what a tolerance of a linear camera is measured by."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from radwrap.imaging.methods.rays import sampled_radiance
from radwrap.imaging.optics.view import View
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.noise import noise_variance, without_pattern
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import places_of
from radwrap.random_streams import Rendering, generator
from radwrap.written import NotNegative, Rays

# Lit is what lies so far above dark, as a share of the brightest.
_LIT: Final = 0.1
# Pixels drawn at random, and rays of each: of a frame in which one pixel of a hundred is lit, ten are looked at.
_PIXELS: Final = 1024
_RAYS: Final = 4
# Equal scenes have equal tolerances, whatever the seed of their rays.
_SEED: Final = 0


@dataclass(frozen=True, slots=True)
class ToleranceAsked:
    """A tolerance as it was asked for, where that is no number of gray levels; the manifest's ``tolerance_asked``.

    Attributes
    ----------
    asked : str
        "default", or such as "0.2 %" and "0.5 noise".
    noise_rms_gray : float or None
        Temporal noise of one frame, rms over the lit pixels, where the tolerance hangs on it [gray level].
    rays : int
        What that took.
    """

    asked: str
    noise_rms_gray: NotNegative | None
    rays: Rays


def with_gray_tolerance(options: RenderOptions, view: View) -> tuple[RenderOptions, ToleranceAsked | None]:
    """The options with the tolerance in gray levels, and how that was asked for, where it was not so.

    Raises
    ------
    InputError
        If it is a share of a noise of which nothing is known.
    TracerError, EnvironmentFailure
        If the tracer fails.
    """
    asked, sensor = options.asked_tolerance, view.camera.sensor
    if asked.unit == "gray":
        return options, None
    noise, rays = None, 0
    if asked.needs_noise(sensor):
        noise, rays = lit_noise(view)
    elif asked.unit == "default":  # of a power law, as ever
        return replace(options, tolerance=asked.in_gray(sensor)), None
    return (
        replace(options, tolerance=asked.in_gray(sensor, noise or 0.0)),
        ToleranceAsked(str(asked), noise, rays),
    )


def lit_noise(view: View) -> tuple[float, int]:
    """Temporal noise of one frame, rms over the lit pixels [gray level], and the rays that it took.

    Lit is a pixel whose gray level lies above dark by more than a tenth of what the brightest does. Where nothing is
    lit, it is the noise of darkness. Of noisy rays too the mean square is right, as it is linear in the light.
    """
    sensor = view.camera.sensor
    number = min(sensor.pixels, _PIXELS)
    pixels = generator(_SEED, Rendering.LIT_PIXELS).choice(sensor.pixels, number, replace=False)
    random = generator(_SEED, Rendering.LIT_RAYS)
    radiance = sampled_radiance(view, *places_of(pixels, sensor.columns), _RAYS, random).mean(axis=1)
    exposure = radiance * view.exposure_of_radiance
    above = gray_levels(exposure, sensor) - sensor.dark_gray
    lit = above > _LIT * above.max()
    shown = exposure[lit] if lit.any() else exposure
    return math.sqrt(float(noise_variance(shown, without_pattern(sensor)).mean())), radiance.size * _RAYS
