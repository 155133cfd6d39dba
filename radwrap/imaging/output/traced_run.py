"""What tracing found: a frozen value from which a run's files and its manifest are written."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.banding import Banding
from radwrap.imaging.forecast.cost import Foretold
from radwrap.imaging.forecast.effects import Effect, warnings_of_left_out
from radwrap.imaging.mean_radiance import Made
from radwrap.imaging.optics.view import View
from radwrap.imaging.output.assumed_values import Assumptions, effects_by_shares, warnings_of_assumed
from radwrap.imaging.output.identity import Identity
from radwrap.imaging.output.image_files import ImageSummary
from radwrap.imaging.output.run_manifest import (
    Bounces,
    BouncesTraced,
    DiffractionTaken,
    RunManifest,
    Timing,
    components_used,
)
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.lit_noise import ToleranceAsked
from radwrap.imaging.tolerance.uncertainty import UncertaintySummary, seen_magnifications
from radwrap.imaging.tracer_choice import TracerUsed
from radwrap.manifest import plain
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class TracedRun:
    """What tracing found.

    Attributes
    ----------
    scene, options, identity
        What was traced, how, and what it is known by.
    made : Made
        Mean radiance, with its error.
    banding : Banding
        Bands of the light.
    tracer : TracerUsed
        Which tracer, and why.
    orders : int or "all"
        How often light went from surface to surface at most.
    left_out, beyond : Effect
        What leaving that out costs, and what leaving out more of it does where `orders` is a number above 0.
    waves : Effect, optional
        What leaving diffraction out costs, where it was and there may be any.
    diffraction : DiffractionTaken, optional
        Where it was taken.
    exposure_of_radiance : float
        Radiant exposure over mean radiance [s sr].
    spread : ndarray, shape (sources, rows, columns), optional
        How the light of each pixel is shared among sources, where each has a tolerance of its own.
    magnification : ndarray, shape (rows, columns), optional
        How much a wider opening blurs each pixel, where a lens has one that is not sure.
    foretold : Foretold, optional
        What was said of the run's time before it was carried out, where that is long.
    tolerance_asked : ToleranceAsked, optional
        The tolerance as it was asked for, where that is not in gray levels.
    level_shares : Mapping of str to ndarray
        Share of the light of each of several sources whose level is assumed; see `assumed_values`.
    """

    scene: Scene
    options: RenderOptions
    identity: Identity
    made: Made
    banding: Banding
    tracer: TracerUsed
    orders: Bounces
    left_out: Effect
    beyond: Effect | None
    waves: Effect | None
    diffraction: DiffractionTaken | None
    exposure_of_radiance: float
    spread: NDArray[np.float64] | None
    magnification: NDArray[np.float64] | None
    blur_slope: NDArray[np.float64] | None = None
    foretold: Foretold | None = None
    tolerance_asked: ToleranceAsked | None = None
    level_shares: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know, whatever the image looks like."""
        effects = itertools.chain.from_iterable(map(warnings_of_left_out, self._left_out().values()))
        return (*warnings_of(self.scene, self.tracer.whole or ()), *effects)

    def manifest(
        self,
        images: ImageSummary,
        uncertainty: UncertaintySummary | None,
        files: Mapping[str, str],
        timing: Timing,
    ) -> RunManifest:
        """All that is known, with the hashes of the files that were written."""
        used, options = self.made.used, self.options
        outcome, certificate = self.made.outcome, self.made.certificate
        exposure = self.made.radiance * self.exposure_of_radiance
        effects = effects_by_shares(Assumptions.of(self.scene), exposure, self.level_shares)
        return RunManifest(
            scene_sha256=self.identity.scene_sha256,
            run_sha256=self.identity.run_sha256,
            method=used.method,
            layout=used.layout,
            viewpoints=used.viewpoints,
            pixel_samples=used.pixel_samples,
            pixel_sampling=used.pixel_sampling,
            tolerance=options.gray_tolerance if outcome else None,
            tolerance_asked=self.tolerance_asked if outcome else None,
            max_error=options.max_error if outcome else None,
            rays_per_pixel=used.rays_per_pixel,
            rays=used.rays,
            plan=outcome.record if outcome else None,
            seed=options.seed,
            trust=options.trust,
            tracer=self.tracer,
            versions=self.identity.versions,
            assumed=dict(sorted(self.scene.assumed.items())),
            components=components_used(self.scene),
            camera=plain(self.scene.camera),
            scene=self.scene.document,
            assumed_effects=effects or None,
            warnings=(*self.warnings, *warnings_of_assumed(effects)),
            radiant_exposure=images.radiant_exposure,
            gray=images.gray,
            saturated_fraction=images.saturated_fraction,
            dark_fraction=images.dark_fraction,
            error=certificate if self.banding.bands is None else certificate.with_bands(self.banding.gray),
            uncertainty=uncertainty,
            bands=self.banding.summary(),
            left_out=self._left_out(),
            bounces=BouncesTraced(self.orders, self.left_out.rms_gray) if self.orders else None,
            diffraction=self.diffraction,
            files=dict(files),
            timing=timing,
        )

    def _left_out(self) -> dict[str, Effect]:
        light = self.beyond if self.orders else self.left_out
        return {left.name: left for left in (light, self.waves) if left is not None}


def magnification_of(scene: Scene, view: View) -> NDArray[np.float64] | None:
    """How much a wider opening blurs each pixel, where a lens has one that is not sure."""
    tolerances = scene.tolerances
    if scene.camera.lens is None or tolerances is None or not tolerances.aperture_diameter:
        return None
    return seen_magnifications(view)
