"""Rays by which it is told what waves add to one image: its own, or others."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from radwrap.imaging.mean_radiance import Made
from radwrap.imaging.methods.pieces import run_jobs
from radwrap.imaging.optics.diffraction import Light, wavelength_of
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.own_rays import OwnRays, suffice
from radwrap.imaging.tolerance.plans import kernel_of
from radwrap.imaging.tolerance.replicates import Plan, Work
from radwrap.imaging.tolerance.seen_tiles import SeenTiles
from radwrap.imaging.tolerance.wave_far import OF_FAR, strata_for
from radwrap.imaging.tolerance.wave_parts import WaveParts, wave_parts
from radwrap.imaging.tolerance.wave_plan import WavePlan, plan_waves
from radwrap.scene.scene import Scene

_FAR_SHARE: Final = 0.3  # of the tolerance, what the law of far light may be off by
_FAR_NOISE: Final = 0.1  # of the tolerance, what noise of far light may be, were all light noise
TWO: Final = 2  # replicates, where nothing is made of them but their mean
# Degrees of freedom by which noise is known: its bound is then 1.4 of it. Two replicates have one for each block over
# which errors hang together, and where a small image has few blocks more replicates are made.
_DEGREES: Final = 24
_FEW_CELLS: Final = 1 << 22  # a second or two for what waves do to their light


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked of the rays of waves.

    Attributes
    ----------
    aim : float
        Error of a replicate by the number of rays [gray level].
    of_cells : float
        Error by the size of their cells [gray level]; a guess leads from it to a size,
    most_cell : float
        which is no larger than this [px], where it was wrong.
    again : bool
        Whether what was tried did not do. What is bright beside the sensor may need more rays for far light than what
        is seen on it lets expect.
    """

    aim: float
    of_cells: float
    most_cell: float = math.inf
    again: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
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
        """What a footprint or two that stand for all wavelengths may change, rms [gray level]."""
        return self.about_rms * max(light.spread for light in self.lights)

    @property
    def even_cell(self) -> float | None:
        """Cells of a plan of many images, which no light decides."""
        return None if self.options.sampling is None else self.options.sampling.wave_cell

    @property
    def far(self) -> float:
        """Share of the light that may go farther than the guard band; of images that are compared no light decides."""
        sampling = self.options.sampling
        if sampling is not None:
            return sampling.wave_far or 1.0
        return far_share(self.seen_rms, _FAR_SHARE * self.options.gray_tolerance)

    def plan(self, asked: Asked) -> WavePlan:
        """Rays for what is asked of waves."""
        share = asked.of_cells / self.about_rms if self.about_rms > asked.of_cells else 1.0
        planned = partial(plan_waves, self.work.view, self.wavelength, asked.aim, self.options.seed)
        plan = planned(share=share, most_cell=asked.most_cell, far=self.far, even_cell=self.even_cell)
        if self.even_cell is not None or not self.seen_rms or asked.again:
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
        return max(TWO, 1 + math.ceil(_DEGREES / blocks))

    def planned(self, made: Made, asked: Asked) -> tuple[WavePlan, WaveParts]:
        """What waves add, by the image's own rays where these may do, and by which plan."""
        plan, own = self.plan(asked), None if asked.again else self.own_rays(made)
        if own is not None and self.suffice(own.plan, own.replicates, plan):
            plan = self._as_fine(own, plan, asked)
            parts = self.parts(plan, own.replicates, own=own)
            own.seen.clear()
            return plan, parts
        if self.work.seen is not None:
            self.work.seen.clear()
        return plan, self.parts(plan, self.replicates(made, plan))

    def _as_fine(self, own: OwnRays, plan: WavePlan, asked: Asked) -> WavePlan:
        """A plan of cells as small as those that are kept, where these are few: what is seen of them costs no ray."""
        sensor = self.scene.camera.sensor
        if own.cell >= plan.kernel.grid.cell or own.replicates * sensor.pixels > _FEW_CELLS * own.cell**2:
            return plan
        finer = self.plan(replace(asked, most_cell=own.cell))
        return finer if self.suffice(own.plan, own.replicates, finer) else plan

    def kept_or_anew(self, plan: WavePlan, parts: WaveParts, made: Made, asked: Asked) -> tuple[WavePlan, WaveParts]:
        """What waves add to an image that was made anew, in as many replicates as it has."""
        if parts.by_own_rays:
            return self.planned(made, asked)
        replicates = self.replicates(made, plan)
        return plan, parts if len(parts.change) == replicates else self.parts(plan, replicates)

    def own_rays(self, made: Made) -> OwnRays | None:
        """Rays of the image, where a kernel made it and they were to be kept."""
        outcome = made.outcome
        kernel = None if outcome is None else kernel_of(outcome.ray_plan)
        return (
            None if outcome is None or kernel is None else OwnRays.of(self.work, kernel, len(outcome.replicates.images))
        )

    def suffice(self, image: Plan | None, replicates: int, waves: WavePlan) -> bool:
        """Whether so many replicates of an image tell a plan of waves; not where sources are to be told apart."""
        kernel = None if image is None else kernel_of(image)
        if kernel is None or not may_be_told(self.scene, self.options):
            return False
        return suffice(kernel, replicates, waves) and self.fewest_replicates(waves) <= replicates

    def parts(
        self,
        plan: WavePlan,
        replicates: int,
        told_by: Callable[[WavePlan], WavePlan] = lambda plan: plan,
        *,
        own: OwnRays | None = None,
    ) -> WaveParts:
        """What waves add by a plan, or by what it makes of itself for each light; see `wave_parts`."""
        work = self.work
        work.progress.left(replicates * len(self.lights) * self.scene.camera.sensor.pixels)
        plans = [(light.view, told_by(plan.at(light.wavelength, light.deviation))) for light in self.lights]
        run = partial(run_jobs, programs=work.programs, workers=work.view.workers)
        return wave_parts(work.view, plans, replicates, progress=work.progress.add, run=run, own=own)


def far_share(seen_rms: float, off: float) -> float:
    """Share of the light that may go farther than the guard band, where its law may be off by so much.

    Parameters
    ----------
    seen_rms : float
        Of the light that is seen, as `seen_rms` finds it [gray level].
    off : float
        Rms of what the law may be off by [gray level].
    """
    return min(1.0, off / (OF_FAR * seen_rms)) if seen_rms else 1.0


def may_be_told(scene: Scene, options: RenderOptions) -> bool:
    """Whether the rays of an image may tell what waves add to it: of its light as a whole."""
    camera = scene.camera
    by_kernel = options.method in (None, "kernel", "hybrid") and not options.basis and options.sampling is None
    as_one = scene.spectral is None or len(scene.spectral.wavelength_groups()) < 2
    return by_kernel and as_one and camera.diffraction is not None and not camera.aperture.is_infinitesimal


def tiles_for_waves(scene: Scene, options: RenderOptions) -> SeenTiles | None:
    """Room for what the rays of an image see, where they may tell waves."""
    return SeenTiles() if may_be_told(scene, options) else None
