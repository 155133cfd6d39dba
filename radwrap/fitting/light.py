"""The light of a scene in a fit: bases by the same rays for each change of it, and by others for their error."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.relight.relit import Basis, read_basis
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.synthesis import render
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tolerance.sampling import strictest
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.scene import Scene
from radwrap.study.pilots import read_pilot, write_pilot

REPLICATES: Final = 4  # of each basis of a fit with renders, and further bases by other seeds of any fit
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
        go.
    """

    def __init__(self, scene: Scene, options: RenderOptions, work: Path, *, is_even: bool) -> None:
        self._work, self._count = work, 0
        self._scene, self._is_even = scene, is_even
        self.rays, self.left_out = 0, ""
        self._options = replace(options, basis=True, frames=0, truth=False)
        if is_even:
            self._options = self._planned(scene, self._options)

    def held(self) -> dict[str, Any]:
        """What was decided."""
        told = self._options
        plan = None if told.sampling is None else told.sampling.as_json()
        return {"method": told.method, "tracer": told.tracer, "sampling": plan, "tolerance": told.tolerance}

    @property
    def tolerance(self) -> float:
        """Of each image [gray level]."""
        return self._options.demand.tolerance

    def coarser(self, times: float, work: Path) -> Light:
        """The same at a tolerance that is so many times larger, with a folder of its own."""
        options = replace(self._options, tolerance=times * self.tolerance, sampling=None)
        return Light(self._scene, options, work, is_even=self._is_even)

    def at(self, scene: Scene) -> Basis:
        """The basis of another scene, by the same rays."""
        return self._basis(scene, self._options.seed)

    def further(self, scene: Scene) -> tuple[Basis, ...]:
        """Bases by other seeds."""
        seeds = [(self._options.seed + number * _SEED_STEP) % 2**63 for number in range(1, REPLICATES + 1)]
        return tuple(self._basis(scene, seed) for seed in seeds)

    def _planned(self, scene: Scene, options: RenderOptions) -> RenderOptions:
        with traced_scene(scene, options) as view:
            options, _ = with_gray_tolerance(options, view)
        path = self._work / "pilot.json"
        write_pilot(path, scene, replace(options, basis=False))
        found = read_pilot(path)
        if found is None:
            raise EnvironmentFailure("the pilot was lost", where=str(path))
        plan: SamplingPlan = strictest([found], self._demand(options))
        return replace(options, sampling=replace(plan, replicates=REPLICATES))

    @staticmethod
    def _demand(options: RenderOptions) -> Any:
        """What the plan of so few replicates is to keep: plans are made for more."""
        planned = SamplingPlan("rays", rays=1024).replicates
        return replace(options.demand, tolerance=options.demand.tolerance * math.sqrt(REPLICATES / planned))

    def _basis(self, scene: Scene, seed: int) -> Basis:
        folder = self._work / str(self._count)
        self._count += 1
        made = self._rendered(scene, folder, seed)
        self.rays += made.run.rays
        self.left_out = self.left_out or made.run.missing
        if self._options.method is None and made.run.method in ("kernel", "rays", "hybrid"):
            self._options = replace(self._options, method=made.run.method)
        return read_basis(folder)

    def _rendered(self, scene: Scene, folder: Path, seed: int) -> Rendered:
        """By the tracer that is held; where nobody asked for one, by our own, which starts no process for an image."""
        options = replace(self._options, seed=seed)
        if options.tracer != "auto":
            return render(scene, folder, options)
        try:
            made = render(scene, folder, replace(options, tracer="compiled"))
            self._options = replace(self._options, tracer="compiled")
        except (InputError, EnvironmentFailure):  # it cannot show the scene, or differs there
            self._options = replace(self._options, tracer="radiance")
            made = render(scene, folder, replace(options, tracer="radiance"))
        return made
