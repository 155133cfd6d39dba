"""Diffraction of an image that is made: measured, and taken where the scene asks for it or it matters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radwrap.errors import InputError
from radwrap.imaging.forecast.effects import Effect, diffraction_left_out
from radwrap.imaging.forecast.wave_change import MOST_RAYS
from radwrap.imaging.mean_radiance import Made
from radwrap.imaging.optics.diffraction import wavelength_of
from radwrap.imaging.output.run_manifest import DiffractionTaken
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.wave_image import WaveImage, wave_image
from radwrap.scene.scene import Scene

# Rays that tell what diffraction would change, beside those of the image; fewer where they only decide whether it is
# taken; and the fewest that tell anything.
_SHARE: Final = 0.2
_DECIDING_SHARE: Final = 0.05
_FEWEST: Final = 1 << 13
_AIM: Final = 0.5  # of the tolerance, each of both replicates
_FINER: Final = 0.25  # of that aim, where it was too much
_LESS: Final = 0.8  # of the tolerance is left to the rays' own image, where both together break it


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
    """

    made: Made
    left_out: Effect | None
    taken: DiffractionTaken | None


def refuse_waves(scene: Scene, options: RenderOptions) -> None:
    """See that what is asked for beside diffraction goes with it.

    Raises
    ------
    InputError
        If it does not.
    """
    if scene.camera.diffraction != "on":
        return
    for key, asked in (("basis", options.basis), ("sampling", options.sampling is not None)):
        if asked:
            raise InputError(
                "knows no diffraction yet", where=key, remedy='leave it out, or `camera.diffraction = "off"`'
            )
    if options.method == "pinhole":
        raise InputError(
            "has no opening, and diffraction is asked for",
            where="method",
            remedy='take another method, or `camera.diffraction = "off"`',
        )


def with_waves(
    scene: Scene, options: RenderOptions, work: Work, made: Made, again: Callable[[float], Made]
) -> WithWaves:
    """Measure what diffraction changes, and take it.

    Rays for that are traced once the image is whole, so that they neither decide how it is traced nor keep it from
    being traced. In the dark none are: there is no light to be bent.

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
    """
    camera = scene.camera
    if camera.aperture.is_infinitesimal or not made.radiance.any():
        return WithWaves(made, None, None)
    work.programs.check()
    share = _SHARE if camera.diffraction is None else _DECIDING_SHARE
    rays = min(MOST_RAYS, max(_FEWEST, round(share * made.used.rays)))
    found = diffraction_left_out(scene, work.view, options.seed, options.gray_tolerance, rays)
    cannot = options.basis or options.sampling is not None or made.used.method == "pinhole"
    if camera.diffraction is None or cannot or (camera.diffraction == "auto" and not found.needed):
        return WithWaves(made, found, None)
    wavelength = wavelength_of(scene)[0]

    def waves(aim: float) -> WaveImage:
        work.progress.left(2 * camera.sensor.pixels)
        add, check = work.progress.add, work.programs.check
        return wave_image(work.view, wavelength, made.radiance, aim=aim, seed=options.seed, progress=add, check=check)

    aim = _AIM * options.gray_tolerance
    change = waves(aim)
    taken = found.rays + change.rays
    whole = _added(made, change, options, taken)
    if not _is_met(whole):
        change = waves(_FINER * aim)
        taken += change.rays
        whole = _added(made, change, options, taken)
    if not _is_met(whole) and _is_met(made):
        before, made = made.used.rays, again(_LESS * options.gray_tolerance)
        whole = _added(made, change, options, taken + before)
    return WithWaves(whole, None, DiffractionTaken(wavelength, found.rms_gray, change.rays))


def _is_met(made: Made) -> bool:
    return made.outcome is None or made.outcome.met


def _added(made: Made, change: WaveImage, options: RenderOptions, rays: int) -> Made:
    """The image with what waves add, and the certificate of both."""
    radiance = np.maximum(made.radiance + change.change, 0.0)
    certificate = made.certificate.with_waves(change.noise, change.cells, change.tails, change.quantile)
    used = replace(made.used, rays=made.used.rays + rays)
    outcome = made.outcome
    if outcome is not None:
        met = options.demand.is_met(certificate.rms_gray_upper95, certificate.p99_gray_upper95)
        record = replace(outcome.record, met=met)
        outcome = replace(outcome, radiance=radiance, certificate=certificate, met=met, record=record)
    return replace(made, radiance=radiance, certificate=certificate, used=used, outcome=outcome)
