"""What a run will take, told before it is carried out; and what would make it cheaper.

What a run does before its first tile is done, and timed: the scene is laid out, light between surfaces is measured, a
survey is made. What comes then is rehearsed. So a forecast is a sum of parts, each measured on this machine.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.files import make_folder
from radwrap.imaging.forecast.basis_rehearsal import rehearsed_basis
from radwrap.imaging.forecast.cost import USUAL_RAYS, Cheaper, Cost, Foretold, check_size, estimate
from radwrap.imaging.forecast.effects import bounces, diffraction_left_out
from radwrap.imaging.forecast.rehearsal import (
    LONGEST_TILE,
    Rehearsed,
    Stopwatch,
    comparison_seconds,
    look_at_model,
    rehearsed,
    rehearsed_viewpoints,
    seconds_per_ray,
    timed,
)
from radwrap.imaging.forecast.wave_rehearsal import ForeseenWaves, rehearsed_waves
from radwrap.imaging.mean_radiance import fixed_method, viewpoint_plan
from radwrap.imaging.methods.kernel import KernelPlan
from radwrap.imaging.methods.smooth_blocks import with_known
from radwrap.imaging.methods.viewpoints import ViewpointPlan
from radwrap.imaging.optics.view import View
from radwrap.imaging.output.image_files import write_images
from radwrap.imaging.relight.basis import shining
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.noise import linear_of
from radwrap.imaging.tolerance.lit_noise import ToleranceAsked, with_gray_tolerance
from radwrap.imaging.tolerance.planner import Search
from radwrap.imaging.tolerance.replicates import Plan, Work
from radwrap.imaging.tolerance.sampling import even_plan
from radwrap.imaging.tracing import LaidOutScene
from radwrap.imaging.with_waves import foreseen_waves, rays_that_tell
from radwrap.process import Programs, available_cores
from radwrap.progress import Progress, note
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Camera
from radwrap.scene.scene import Scene
from radwrap.scene.sources import WideSource

# What is told before it begins takes so long at least; and so many rays times sources, or so much of their time: below
# these not even the rehearsal is worth while.
_LONG: Final = 60.0  # s
_MANY: Final = 2e7
_PERHAPS_LONG: Final = 25.0  # s
# What is expected to take less in one thread is rehearsed as a whole: one image is often followed by finer ones, until
# one keeps the tolerance, and what lights are alike over few pixels says little of it beforehand.
_SHORT_SEARCH: Final = 1.5  # s
# What is told to be cheaper takes this share at most.
_CHEAPER: Final = 0.8
_STRIP: Final = 1 << 16  # px
# Files are read back, and their hashes taken, in this share of the time in which they are written: 0.35 at 5 MP.
_READ_BACK: Final = 0.4
_CERTIFIED_RAYS: Final = 2 * 64 * 512  # of a method whose rays are fixed, see `certify_by_independent_rays`
_THINNED: Final = 4
_SHORT: Final = 0.3  # s; as `LONGEST_TILE`, where only ratios count
_WHOLE: Final = "image and certificate"
_OF_IMAGE: Final = {"image", "certificate", "where the kernel fails", _WHOLE}
_HALF: Final = "half as many columns and rows of pixels"


@dataclass(frozen=True, slots=True)
class _Foreseen:
    """An image that is to come, as far as its rehearsal tells.

    Attributes
    ----------
    parts : Mapping[str, float]
        Of the time that it takes [s].
    rays : float
        How many, without those of its certificate.
    plan : KernelPlan, RaysPlan, HybridPlan or None
        By which rays the image is made in the end; None of viewpoints.
    replicates : int
        How many sets of them.
    """

    parts: dict[str, float]
    rays: float
    plan: Plan | None = None
    replicates: int = 0


@dataclass(slots=True)
class Stage:
    """What a rehearsal needs: a scene that is laid out, and a folder of its own.

    Attributes
    ----------
    traced : LaidOutScene
        Who traces.
    options : RenderOptions
        How.
    work : Work
        Where, and by whom; its view is that of the run.
    longest : float
        How long a tile may take in one thread [s], see `rehearsed`.
    """

    traced: LaidOutScene
    options: RenderOptions
    work: Work
    longest: float = LONGEST_TILE

    def to_come(self, what: Search | ViewpointPlan) -> tuple[dict[str, float], float]:
        """Parts of the time that is to come [s], and rays."""
        image = self._image(what)
        parts, rays = dict(image.parts), image.rays
        if isinstance(what, Search):
            # All that follows has the blocks that the search found smooth.
            work = replace(self.work, view=what.view)
            parts["what is left out"] = self._telling(work.view, image.rays)
            waves = foreseen_waves(self.traced.scene, self.options, work, image.plan, image.replicates)
            if waves is not None:
                number = 1 if self.options.bounces else len(self.traced.lights())
                found = rehearsed_waves(what.view, waves, number)
                parts["diffraction"] = found.seconds
                rays += found.rays
            if self.options.basis and image.plan is not None:
                parts["basis"] = self._basis(work, image.plan, image.replicates, waves)
        if self.options.truth:
            sensor, numbered = (
                self.work.view.camera.sensor,
                replace(self.work.view, tracer=self.traced.numbered_tracer()),
            )
            parts["truth"] = seconds_per_ray(numbered) * sensor.pixels
        parts["files"] = _file_seconds(self.work.folder, self.work.view.camera) * (1 + self.options.frames)
        return parts, rays

    def _telling(self, view: View, rays: float) -> float:
        """Time in which a run finds out what diffraction changes of an image of so many rays [s]."""
        scene, options = self.traced.scene, self.options
        telling = rays_that_tell(scene, rays)
        return timed(lambda: diffraction_left_out(scene, view, options.seed, options.gray_tolerance, telling))

    def _image(self, what: Search | ViewpointPlan) -> _Foreseen:
        if isinstance(what, ViewpointPlan):
            image = rehearsed_viewpoints(self.work.view, what)
            rays = _CERTIFIED_RAYS * seconds_per_ray(self.work.view) / self.work.view.workers
            return _Foreseen({"image": image.seconds, "certificate": rays}, image.rays)
        work, sampling = replace(self.work, view=what.view), self.options.sampling
        if sampling is not None:
            plan, number = even_plan(self.work.view, what.found, sampling), sampling.replicates
            image = rehearsed(
                work, plan, number, round(sampling.rays_per_pixel * plan.camera.sensor.pixels), self.longest
            )
            return self._certified(work, what, image, plan, number)
        found = self._searched(work, what)
        if sum(found.parts.values()) * work.view.workers > _SHORT_SEARCH:
            return found
        # In a folder of its own, where it finds nothing that was rehearsed.
        alone = replace(self.work, folder=self.work.folder / "whole")
        make_folder(alone.folder)
        search, clock = Search(alone, what.demand, relit=self.options.basis), Stopwatch(work.view.workers)
        outcome = search.run()
        number = len(outcome.replicates.images)
        return _Foreseen({_WHOLE: clock.lap()}, outcome.record.rays, outcome.ray_plan, number)

    def _searched(self, work: Work, search: Search) -> _Foreseen:
        """The image that a search tries first, and the one that comes after a kernel which fails."""
        plan, number = search.first_plan()
        expected = search.choice.expected_rays[search.choice.method] or USUAL_RAYS * plan.camera.sensor.pixels
        return self._certified(work, search, rehearsed(work, plan, number, expected, self.longest), plan, number)

    def _certified(self, work: Work, search: Search, image: Rehearsed, plan: Plan, number: int) -> _Foreseen:
        parts = {"image": image.seconds, "certificate": comparison_seconds(work, plan, number)}
        rays = image.rays
        if isinstance(plan, KernelPlan):
            look = look_at_model(work, search, plan)
            parts["certificate"] += look.seconds
            if self.options.sampling is None and search.demand.method is None and not look.holds:
                further = self._further(work, search, image)
                parts["where the kernel fails"] = further.seconds
                rays += further.rays
        return _Foreseen(parts, rays, plan, number)

    def _further(self, work: Work, search: Search, first: Rehearsed) -> Rehearsed:
        """What comes after a kernel that does not hold: one that tells depths apart, then rays, or corrections."""
        if not search.plans.one_layer or math.isinf(search.found.model.mean):
            return self._instead(work, search)
        layered = copy(search)
        layered.plans = copy(search.plans)
        layered.plans.one_layer = False
        plan, _ = layered.first_plan("kernel")
        if isinstance(plan, KernelPlan) and look_at_model(work, layered, plan).holds:
            return first
        found = self._instead(work, layered)
        return Rehearsed(first.seconds + found.seconds, first.rays + found.rays)

    def _instead(self, work: Work, search: Search) -> Rehearsed:
        method, aim, _ = search.instead_of_kernel()
        plan, number = search.plans.planned(method, aim)
        expected = search.plans.forecast(method, aim) or USUAL_RAYS * plan.camera.sensor.pixels
        return rehearsed(work, plan, number, expected, self.longest)

    def _basis(self, work: Work, plan: Plan, replicates: int, waves: ForeseenWaves | None) -> float:
        """The same rays in the light of each source: one view for some of them, or one for each."""
        names = shining(self.traced.scene, self.traced.prepared, "basis")
        first = self.traced.views_of(names)[0]
        if (smooth := work.view.smooth) is not None:
            first = with_known(first, smooth)
        seconds = rehearsed_basis(work, plan, replicates, first)
        if waves is not None:
            seconds += rehearsed_waves(work.view, waves, 1, lit=first).seconds
        return seconds * len(names) / len(first.names)

    def cheaper(self, what: Search | ViewpointPlan, parts: Mapping[str, float]) -> tuple[Cheaper, ...]:
        """What would take less time: each change by its own rehearsal."""
        whole = sum(parts.values())
        found = [Cheaper(change, seconds) for change, seconds in self._changes(what, parts)]
        return tuple(sorted((one for one in found if one.wall_s <= _CHEAPER * whole), key=lambda one: one.wall_s))

    def _changes(self, what: Search | ViewpointPlan, parts: Mapping[str, float]) -> Iterator[tuple[str, float]]:
        files = parts["files"]
        if isinstance(what, ViewpointPlan):
            image, number = parts["image"], len(what.viewpoints)
            rest = sum(parts.values()) - image
            if number > 1:
                yield f"{-(-number // 2)} viewpoints in place of {number}", rest + image / 2
            yield _HALF, rest - 0.75 * files + image / 4
            return
        image = sum(seconds for part, seconds in parts.items() if part in _OF_IMAGE)
        rest = sum(parts.values()) - image
        if self.options.sampling is None:
            # All three by the same short rehearsal, so that what it leaves out is left out of all.
            short, demand = replace(self, longest=_SHORT), what.demand
            now = short._seconds(what)
            # Blocks that are found once are smooth at twice the tolerance too, and in pixels of twice the size.
            looser = Search(self.work, replace(demand, tolerance=2 * demand.tolerance), smooth=what.view.smooth)
            smaller = replace(self.work, view=replace(self.work.view, camera=_halved(self.work.view.camera)))
            coarser = None if what.view.smooth is None else what.view.smooth.in_doubled_pixels
            yield (
                f"a tolerance of {2 * demand.tolerance:g} gray in place of {demand.tolerance:g}",
                rest + image * short._seconds(looser) / now,
            )
            coarse = replace(short, work=smaller)._seconds(Search(smaller, demand, smooth=coarser))
            yield _HALF, rest - 0.75 * files + image * coarse / now
        yield from self._with_fewer_patches(rest, image)

    def _seconds(self, what: Search) -> float:
        return sum(self._image(what).parts.values())

    def _with_fewer_patches(self, rest: float, image: float) -> Iterator[tuple[str, float]]:
        """Light of the same places by a part of the patches, of which only the time counts."""
        scene = self.traced.scene
        cut = [each for each in scene.sources if isinstance(each, WideSource) and each.name not in self.traced.whole]
        patches = [len(source.patches) for source in cut]
        if self.options.bounces or max(patches, default=0) < _THINNED**2:
            return
        thinned = tuple(
            replace(source, patches=source.patches[::_THINNED]) if source in cut else source for source in scene.sources
        )
        share = seconds_per_ray(self.traced.view_lit_by(thinned)) / seconds_per_ray(self.work.view)
        wide = sum(patches)
        yield (
            f"{-(-wide // _THINNED)} patches of wide sources in place of {wide} (irradiance_error)",
            rest + image * share,
        )


def _halved(camera: Camera) -> Camera:
    """The same view with pixels of twice the width and height."""
    sensor = camera.sensor
    u, v = camera.principal_point
    return replace(
        camera,
        principal_point=((u + 0.5) / 2 - 0.5, (v + 0.5) / 2 - 0.5),
        sensor=replace(
            sensor,
            rows=max(1, sensor.rows // 2),
            columns=max(1, sensor.columns // 2),
            pixel_width=2 * sensor.pixel_width,
            pixel_height=2 * sensor.pixel_height,
        ),
    )


def _file_seconds(folder: Path, camera: Camera) -> float:
    """Time in which an image is written and read back [s], by a strip of one."""
    sensor = camera.sensor
    rows = min(sensor.rows, max(1, _STRIP // sensor.columns))
    strip = replace(camera, sensor=replace(sensor, rows=rows))
    gray = np.linspace(0.2, 0.8, rows * sensor.columns).reshape(rows, -1)
    # As noisy as an image by rays.
    gray += generator(0, Rendering.REHEARSED_TILES).normal(0, 0.002, gray.shape)
    place = folder / "files"
    make_folder(place)
    span = ((sensor.saturation_gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma)
    write_images(place, gray * span, strip)  # what is done once
    seconds = timed(lambda: write_images(place, gray * span, strip))
    return seconds * sensor.rows / rows * (1 + _READ_BACK)


@contextmanager
def _stage(scene: Scene, options: RenderOptions) -> Iterator[Stage]:
    with tempfile.TemporaryDirectory(prefix="radwrap-") as name, Programs() as programs:
        traced = LaidOutScene(scene, options, programs, Path(name))
        yield Stage(traced, options, _rehearsing(traced.view(), Path(name) / "rehearsal", programs, options))


def _rehearsing(view: View, folder: Path, programs: Programs, options: RenderOptions) -> Work:
    make_folder(folder)
    return Work(view, folder, programs, Progress("rehearsing", 1, shown=False), "rehearsal", options.seed)


def forecast(scene: Scene, options: RenderOptions, *, started: float = 0.0) -> Cost:
    """What a run would cost; measured by doing what comes before the first tile, and by making some tiles.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : RenderOptions
        How it would be rendered.
    started : float
        What the program took before [s].

    Raises
    ------
    InputError, EnvironmentFailure
        As `render`.
    """
    if options.frames:
        linear_of(scene.camera.sensor)
    replicates = 0 if options.sampling is None else options.sampling.replicates
    check_size(scene, options.max_pixels, usual_rays(scene, options), cores(options), replicates=replicates)
    clock = Stopwatch()
    with _stage(scene, options) as stage:
        parts = {"start": started, "layout": clock.lap()}
        seen = stage.traced.view_with_bounces(options.bounces) if options.bounces else stage.work.view
        options, _ = with_gray_tolerance(options, seen)
        stage.options = options
        bounces(scene, stage.work.view, options.seed, options.gray_tolerance, traced=stage.traced)
        parts["light between surfaces"] = clock.lap()
        what = _prepared(scene, options, stage)
        parts["survey"] = clock.lap()
        to_come, rays = stage.to_come(what)
        whole = sum(parts.values()) + sum(to_come.values())
        cheaper: tuple[Cheaper, ...] = ()
        if whole >= _LONG:
            cheaper = stage.cheaper(what, parts | to_come)
    memory = estimate(scene, rays, cores(options), replicates=replicates).memory_bytes
    return Cost(round(rays), memory, parts | to_come, cheaper)


def _prepared(scene: Scene, options: RenderOptions, stage: Stage) -> Search | ViewpointPlan:
    """What will be traced; the stage's view is then the one that traces it."""
    method = fixed_method(scene, options)
    if options.bounces:
        # Whether "auto" means all is not known before rays are traced: what it costs at most is told.
        stage.work = replace(stage.work, view=stage.traced.view_with_bounces(options.bounces))
    if method is not None:
        return viewpoint_plan(scene, options, method, "rehearsal")
    demand = replace(options.demand, method="rays") if options.bounces else options.demand
    return Search(stage.work, demand)


def usual_rays(scene: Scene, options: RenderOptions) -> float:
    """Rays that each pixel gets, as far as that is known before a ray is traced."""
    method = fixed_method(scene, options)
    if method is None:
        return USUAL_RAYS if options.sampling is None else options.sampling.rays_per_pixel
    return (1 if method == "pinhole" else options.viewpoint_number) * options.pixel_samples**2


def cores(options: RenderOptions) -> int:
    """Workers of a run."""
    return options.workers or available_cores()


@dataclass(slots=True)
class Announcement:
    """Says what a run will take, once it has laid its scene out and made its survey, where that is long.

    Attributes
    ----------
    traced : LaidOutScene
        Who traces.
    options : RenderOptions
        How.
    folder : Path
        For what is rehearsed; goes with the run's other temporary files.
    programs : Programs
        Ended with the run.
    tolerance_asked : ToleranceAsked or None
        The tolerance as it was asked for, where that is not in gray levels.
    foretold : Foretold or None
        What was said of the time that was to come.
    """

    traced: LaidOutScene
    options: RenderOptions
    folder: Path
    programs: Programs
    tolerance_asked: ToleranceAsked | None
    foretold: Foretold | None = field(default=None, init=False)

    def before(self, view: View, what: Search | ViewpointPlan) -> None:
        """Say what a tolerance means that is not in gray levels, and what will be traced where that takes long."""
        if isinstance(what, Search) and self.tolerance_asked is not None:
            note(_meaning(self.tolerance_asked, what))
        expected = what.rays if isinstance(what, ViewpointPlan) else what.choice.expected_rays[what.choice.method] or 0
        scene = self.traced.scene
        if expected * max(len(scene.emitters), 1) < _MANY:
            return
        if expected * seconds_per_ray(view) / view.workers < _PERHAPS_LONG:
            return
        stage = Stage(self.traced, self.options, _rehearsing(view, self.folder, self.programs, self.options))
        parts, rays = stage.to_come(what)
        if sum(parts.values()) < _LONG:
            return
        memory = estimate(scene, rays, view.workers).memory_bytes
        cost = Cost(round(rays), memory, parts, stage.cheaper(what, parts))
        self.foretold = cost.foretold
        note(f"this will take about {cost}")
        for one in cost.cheaper:
            note(str(one))


def _meaning(asked: ToleranceAsked, what: Search) -> str:
    """What a tolerance is in gray levels, and about what half and twice as much would take."""
    noise = "" if asked.noise_rms_gray is None else f", where one frame's noise is {asked.noise_rms_gray:.3g} gray"
    finer, coarser = what.times_as_many(0.5), what.times_as_many(2.0)
    return (
        f"tolerance {what.demand.tolerance:g} gray rms ({asked.asked}{noise}): half as much takes about {finer:.2g} "
        f"times as many rays, twice as much down to {coarser:.2g} times"
    )
