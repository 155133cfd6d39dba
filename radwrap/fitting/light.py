"""The light of a scene in a fit: bases by the same rays for each change of it, and by others for their error."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.imaging.demand import FEWEST, SamplingPlan
from radwrap.imaging.demand import REPLICATES as TOLD_BY
from radwrap.imaging.methods.rays import ORDER
from radwrap.imaging.relight.relit import Basis, read_basis
from radwrap.imaging.relight.source_images import AimedRays, SourceImages, source_images, suffice
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tolerance.sampling import Pilot, strictest
from radwrap.imaging.tolerance.survey import AIM_SHARE
from radwrap.imaging.tracing import traced_scene
from radwrap.manifest import sha256_of_value
from radwrap.scene.scene import Scene
from radwrap.study.pilots import read_pilot, write_pilot

REPLICATES: Final = 4  # of each basis of a fit with renders
FEW: Final = 2  # of each by which the way is sought
AGAIN: Final = 3  # of an unbiased one that are traced again nearby
_LOOK: Final = "look"
_SEED_STEP: Final = 1_000_003  # between seeds: none is that of a neighbouring fit


class Light:
    """Who traces for a fit; tracer, method and places of rays are decided once, by the scene where it begins.

    Parameters
    ----------
    scene : Scene
        There.
    options : RenderOptions
        How it is rendered.
    work : Path
        Folder for what is traced.
    is_even : bool
        Whether other scenes are traced too, by the same rays: then nothing that an image shows may decide where they
        go. Else only unbiased rays are.
    """

    def __init__(self, scene: Scene, options: RenderOptions, work: Path, *, is_even: bool) -> None:
        self._work, self._count = work, 0
        self._scene, self._is_even = scene, is_even
        self.rays, self.left_out = 0, ""
        self.settled: SamplingPlan | AimedRays | None = None
        self._pilot: Pilot | None = None
        self._is_known = False  # who traces, and what is left out
        with traced_scene(scene, options) as view:
            options, _ = with_gray_tolerance(options, view)
        self._options = replace(options, basis=True, frames=0, truth=False)
        self._options = self._planned(scene, self._options) if is_even else replace(self._options, method="rays")

    def held(self) -> dict[str, Any]:
        """What was decided."""
        told = self._options
        plan, settled = (None if one is None else one.as_json() for one in (told.sampling, self.settled))
        return {
            "method": told.method,
            "tracer": told.tracer,
            "sampling": plan,
            "tolerance": told.tolerance,
            "settled": settled,
        }

    @property
    def tolerance(self) -> float:
        """Of each image [gray level]."""
        return self._options.demand.tolerance

    @property
    def aimed(self) -> AimedRays:
        """Of the unbiased image that the answer is told by."""
        return AimedRays(AIM_SHARE * self.tolerance, TOLD_BY)

    def roughly(self, scene: Scene, times: float, replicates: int) -> Basis | SourceImages:
        """The same by few rays: by cells so many times as large, and no larger than a pixel unless they were."""
        known = self._options.sampling
        if known is None:
            raise TypeError("only what is traced by an even plan has a rough one")
        if known.cell is not None:
            plan = replace(known, cell=min(times * known.cell, max(known.cell, 1.0)), replicates=replicates)
        else:
            plan = replace(known, rays=max(FEWEST, int((known.rays or 1) / times**2)), replicates=replicates)
        return self._basis(scene, replace(self._options, sampling=plan))

    def at(self, scene: Scene, replicates: int = REPLICATES) -> Basis | SourceImages:
        """The basis of another scene, by the same rays, or some replicates of them."""
        known = self._options.sampling
        plan = None if known is None else replace(known, replicates=replicates)
        return self._basis(scene, replace(self._options, sampling=plan))

    def unbiased(
        self,
        scene: Scene,
        share: int = 1,
        near: Basis | SourceImages | None = None,
        needed: NDArray[np.intp] | None = None,
    ) -> Basis | SourceImages:
        """The basis of a scene by other rays, over pixel and opening: no cell and no model of a kernel is in it.

        Parameters
        ----------
        scene : Scene
            What is there.
        share : int
            It keeps the tolerance, or is by one of so many rays of what that takes.
        near : Basis or SourceImages, optional
            The same of another scene nearly there: it is enough to trace some of its rays again.
        needed : ndarray of int, shape (rows, columns), optional
            Rays of each pixel, where that is known.
        """
        if self._pilot is None:
            self._pilot = self._looked_at(scene, self._options)
        demand = replace(self._options.demand, method="rays")
        plan = strictest([self._pilot], demand)
        fewer = replace(plan, rays=max(FEWEST, (plan.rays or 1) // share))
        options = replace(self._options, method="rays", sampling=fewer)
        # Rays of few say how many a pixel needs: none of them is among these.
        options = replace(options, seed=(options.seed + share * _SEED_STEP) % 2**63)
        # Its rays are compared with those of no other plan: where nothing but rays is asked for, they are aimed.
        aimed = self.aimed if share == 1 else replace(self.aimed, replicates=REPLICATES)
        rms = aimed.rms * share**ORDER
        numbers = near.numbers if isinstance(near, SourceImages) else needed
        if isinstance(near, SourceImages) and numbers is not None:
            some = self._basis(scene, options, AimedRays(rms, AGAIN, numbers))
            if isinstance(some, SourceImages) and (carried := near.carried(some)) is not None:
                return carried
        made = self._basis(scene, options, replace(aimed, rms=rms, numbers=numbers))
        self.settled = aimed if isinstance(made, SourceImages) else plan
        return made

    def _planned(self, scene: Scene, options: RenderOptions) -> RenderOptions:
        self._pilot = self._looked_at(scene, options)
        plan: SamplingPlan = strictest([self._pilot], self._demand(options))
        return replace(options, sampling=replace(plan, replicates=REPLICATES))

    def _looked_at(self, scene: Scene, options: RenderOptions) -> Pilot:
        """What an image needs."""
        options = replace(options, basis=False, sampling=None)
        path = self._work / f"pilot_{sha256_of_value([scene, replace(options, workers=None)])}.json"
        if (known := read_pilot(path)) is not None:
            return known
        write_pilot(path, scene, options)
        if (found := read_pilot(path)) is None:
            raise EnvironmentFailure("the pilot was lost", where=str(path))
        return found

    @staticmethod
    def _demand(options: RenderOptions) -> Any:
        """What the plan of so few replicates is to keep: plans are made for more."""
        planned = SamplingPlan("rays", rays=1024).replicates
        return replace(options.demand, tolerance=options.demand.tolerance * math.sqrt(REPLICATES / planned))

    def _basis(self, scene: Scene, options: RenderOptions, aimed: AimedRays | None = None) -> Basis | SourceImages:
        folder = self._work / str(self._count)
        self._count += 1
        if not self._is_known and suffice(scene, options):
            self._look(scene)
        options = replace(options, tracer=self._options.tracer)
        if self._is_known and options.tracer == "compiled" and options.sampling and suffice(scene, options):
            lit = source_images(scene, folder, options, aimed or options.sampling)
            self.rays += lit.rays
            return lit
        self._rendered(scene, folder, options)
        return read_basis(folder)

    def _look(self, scene: Scene) -> None:
        """Learn by few rays who traces, and what is left out."""
        few = SamplingPlan("rays", rays=FEWEST, replicates=2)
        self._rendered(scene, self._work / _LOOK, replace(self._options, basis=False, method="rays", sampling=few))

    def _rendered(self, scene: Scene, folder: Path, options: RenderOptions) -> None:
        made = self._traced(scene, folder, options)
        self._is_known = True
        self.rays += made.run.rays
        self.left_out = self.left_out or made.run.missing
        if self._options.method is None and options.basis and made.run.method in ("kernel", "rays", "hybrid"):
            self._options = replace(self._options, method=made.run.method)

    def _traced(self, scene: Scene, folder: Path, options: RenderOptions) -> Rendered:
        """By the tracer that is held; where nobody asked for one, by our own, which starts no process for an image."""
        if options.tracer != "auto":
            return render(scene, folder, options)
        try:
            made = render(scene, folder, replace(options, tracer="compiled"))
            self._options = replace(self._options, tracer="compiled")
        except (InputError, EnvironmentFailure):  # it cannot show the scene, or differs there
            self._options = replace(self._options, tracer="radiance")
            made = render(scene, folder, replace(options, tracer="radiance"))
        return made
