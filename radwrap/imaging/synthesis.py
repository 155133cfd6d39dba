"""The main job: a scene becomes the gray image its camera would give.

A run owns its folder. Finished sub-viewpoints stay in it until the images are
whole, so that a killed run goes on; the files of an older run stay until every
new one is whole, and the manifest appears last.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import EllipsisType
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import TEMPORARY_SUFFIX, check_result, disk_failure, make_folder, sha256_of, sole_owner
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.forecast.cost import check_size
from radwrap.imaging.forecast.effects import Effect, bounces, bounces_beyond
from radwrap.imaging.forecasting import Announcement, cores, usual_rays
from radwrap.imaging.in_time.making import make_in_time, refuse_for_time, steady
from radwrap.imaging.mean_radiance import Made, fixed_method, make, viewpoint_plan
from radwrap.imaging.methods.pieces import Pieces, remove_log, remove_pieces
from radwrap.imaging.methods.viewpoints import missing_viewpoints
from radwrap.imaging.mosaicked import make_mosaic, refuse_for_mosaic
from radwrap.imaging.optics.aperture import Layout
from radwrap.imaging.optics.diffraction import light_of_all
from radwrap.imaging.optics.view import PixelSampling, View
from radwrap.imaging.output.assumed_values import level_shares
from radwrap.imaging.output.folder import ALWAYS, is_whole, publish
from radwrap.imaging.output.frame_files import write_frames
from radwrap.imaging.output.identity import Identity, identity_of
from radwrap.imaging.output.image_files import write_images
from radwrap.imaging.output.run_manifest import Bounces, Timing, write_run_manifest
from radwrap.imaging.output.sigma_file import write_sigma
from radwrap.imaging.output.traced_run import TracedRun, magnification_of
from radwrap.imaging.output.truth_files import write_truth
from radwrap.imaging.relight.basis import shining, write_basis
from radwrap.imaging.relight.basis_files import FOLDER
from radwrap.imaging.render_options import Method, RenderOptions, TracerName
from radwrap.imaging.rendered import Rendered, load_result
from radwrap.imaging.tolerance.kept_replicates import kept, write_replicates
from radwrap.imaging.tolerance.lit_noise import with_gray_tolerance
from radwrap.imaging.tolerance.pace import Pace
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.uncertainty import share_spread
from radwrap.imaging.tracing import LaidOutScene
from radwrap.imaging.wave_rays import tiles_for_waves
from radwrap.imaging.with_waves import WithWaves, refuse_waves, with_waves
from radwrap.kept import Kept
from radwrap.manifest import plain, sha256_of_value
from radwrap.process import Programs, children_cpu_time
from radwrap.progress import Progress, Progressed
from radwrap.scene.scene import Scene
from radwrap.watched import watched

_T = TypeVar("_T")
_VIEWPOINTS: Final = "viewpoints"
_WORK: Final = ".work"
_MADE: Final = "made"
# Pixels of an image whose pieces a warm scene holds in memory while it is made: 64 of them take 256 MiB at most.
_MOST_IN_MEMORY: Final = 1 << 20


def render(
    scene: Scene,
    out: str | Path | None = None,
    options: RenderOptions | None = None,
    *,
    cancelled: Callable[[], bool] | None = None,
    progress: bool | Callable[[Progressed], object] | None = None,
    method: Method | EllipsisType | None = ...,
    tolerance: float | str | EllipsisType | None = ...,
    max_error: float | EllipsisType | None = ...,
    budget_rays: float | EllipsisType | None = ...,
    budget_seconds: float | EllipsisType | None = ...,
    viewpoints: int | EllipsisType | None = ...,
    layout: Layout | EllipsisType = ...,
    pixel_samples: int | EllipsisType = ...,
    pixel_sampling: PixelSampling | EllipsisType = ...,
    seed: int | EllipsisType = ...,
    workers: int | EllipsisType | None = ...,
    keep_viewpoints: bool | EllipsisType = ...,
    truth: bool | EllipsisType = ...,
    bounces: int | Literal["all", "auto"] | EllipsisType = ...,
    basis: bool | EllipsisType = ...,
    sampling: SamplingPlan | EllipsisType | None = ...,
    frames: int | EllipsisType = ...,
    trust: bool | EllipsisType = ...,
    tracer: TracerName | EllipsisType = ...,
    radiance: str | EllipsisType | None = ...,
    max_pixels: int | EllipsisType = ...,
    tracer_timeout: float | EllipsisType = ...,
) -> Rendered:
    """Predict the gray image of a scene.

    Parameters
    ----------
    scene : Scene
        What is there, see `load_scene`.
    out : str or Path, optional
        Folder for images and manifest; without it nothing stays on the disk.
    options : RenderOptions, optional
        How.
    cancelled : callable, optional
        Whether the render is to end, such as ``is_set`` of a `threading.Event`; asked some twenty times a second, in
        the caller's thread.
    progress : bool or callable, optional
        True shows progress on stderr, as the option does; a callable is told how far the render is, as `Progressed`,
        in the caller's thread. What it raises ends the render, and is raised here.
    method, tolerance, max_error
        How, and how exactly. As in `RenderOptions`; an ellipsis leaves it as `options` has it.
    budget_rays, budget_seconds
        What it may cost. As in `RenderOptions`; an ellipsis leaves it as `options` has it.
    viewpoints, layout, pixel_samples, pixel_sampling, keep_viewpoints
        Of the paper's method. As in `RenderOptions`; an ellipsis leaves it as `options` has it.
    bounces
        Light from surface to surface. As in `RenderOptions`; an ellipsis leaves it as `options` has it.
    sampling, seed
        What is drawn. As in `RenderOptions`; an ellipsis leaves it as `options` has it.
    truth, basis, frames
        What is made besides. As in `RenderOptions`; an ellipsis leaves it as `options` has it.
    workers, trust, tracer, radiance, max_pixels, tracer_timeout
        By whom, and within which limits. As in `RenderOptions`; an ellipsis leaves it as `options` has it.

    Returns
    -------
    Rendered
        Images and manifest.

    Raises
    ------
    InputError
        If scene or options are wrong.
    EnvironmentFailure
        If Radiance or the disk fails, or another run owns the folder.
    Cancelled
        If `cancelled` said so before the files were whole: half a second later there is no process and no new result,
        and an older one in the folder is as it was. Only the compiler of the tracer is waited for.

    Examples
    --------
    >>> import radwrap
    >>> scene = radwrap.load_scene("scene.toml")
    >>> result = radwrap.render(scene, tolerance=8, seed=1)
    >>> bool(result.error.rms_gray_upper95 < 8), result.gray.values.shape
    (True, (165, 192))
    """
    given = {
        "method": method,
        "tolerance": tolerance,
        "max_error": max_error,
        "budget_rays": budget_rays,
        "budget_seconds": budget_seconds,
        "viewpoints": viewpoints,
        "layout": layout,
        "pixel_samples": pixel_samples,
        "pixel_sampling": pixel_sampling,
        "seed": seed,
        "workers": workers,
        "keep_viewpoints": keep_viewpoints,
        "truth": truth,
        "bounces": bounces,
        "basis": basis,
        "sampling": sampling,
        "frames": frames,
        "trust": trust,
        "tracer": tracer,
        "radiance": radiance,
        "max_pixels": max_pixels,
        "tracer_timeout": tracer_timeout,
    }
    changes = {name: value for name, value in given.items() if value is not ...}
    options = options or RenderOptions()
    return rendered(scene, out, options, load_result, changes=changes, cancelled=cancelled, progress=progress)


@dataclass(frozen=True, slots=True)
class Warmth:
    """What a warm scene lends to each of its renders.

    Attributes
    ----------
    kept : Kept
        What they have in common.
    folder : Path
        For results that nobody wants in a folder.
    brief : bool
        See `WarmScene.leave`.
    """

    kept: Kept
    folder: Path
    brief: bool = False


def rendered(
    scene: Scene,
    out: str | Path | None,
    options: RenderOptions,
    then: Callable[[Scene, Path], _T],
    *,
    changes: Mapping[str, Any],
    cancelled: Callable[[], bool] | None,
    progress: bool | Callable[[Progressed], object] | None,
    warmth: Warmth | None = None,
) -> _T:
    """As `render`, of a cold scene or a warm one: the result is the same, and what is `then` read of its folder."""
    told = progress if callable(progress) else None
    if progress is not None and told is None:
        changes = {**changes, "progress": progress}
    options = replace(options, **changes)
    options.asked_tolerance.needs_noise(scene.camera.sensor)
    refuse_waves(scene, options)
    refuse_for_mosaic(scene, options)
    refuse_for_time(scene, options)
    rays, replicates = usual_rays(scene, options), 0 if options.sampling is None else options.sampling.replicates
    check_size(scene, options.max_pixels, rays, cores(options), replicates=replicates)
    if out is None:
        for name in ("frames", "basis", "keep_viewpoints"):
            if getattr(options, name):
                raise InputError(
                    "its files would be lost with a temporary folder",
                    where=name,
                    remedy="name the folder: out",
                )
    with Programs() as programs:
        count = Progress("tracing", 1, shown=options.progress)
        make = partial(_render, scene, out, options, then, programs=programs, progress=count, warmth=warmth)
        if cancelled is None and told is None:
            return make()
        return watched(make, programs, count, cancelled, told)


def _render(
    scene: Scene,
    out: str | Path | None,
    options: RenderOptions,
    then: Callable[[Scene, Path], _T],
    *,
    programs: Programs,
    progress: Progress,
    warmth: Warmth | None,
) -> _T:
    nowhere = partial(tempfile.TemporaryDirectory, prefix="radwrap-", dir=warmth.folder if warmth else None)
    with nowhere() if out is None else nullcontext(out) as folder:
        make_folder(Path(folder))
        _render_into(scene, Path(folder), options, programs=programs, progress=progress, warmth=warmth)
        return then(scene, Path(folder))


def _render_into(
    scene: Scene, out: Path, options: RenderOptions, *, programs: Programs, progress: Progress, warmth: Warmth | None
) -> None:
    start, cpu = time.monotonic(), children_cpu_time()
    with sole_owner(out):
        for name in ALWAYS:
            check_result(out / name)
        work = out / _WORK
        plane = partial(_plane_into, programs=programs, progress=progress, warmth=warmth)
        shutil.rmtree(work, ignore_errors=True)
        for leftover in out.glob(f".*{TEMPORARY_SUFFIX}.*"):  # of a killed run
            leftover.unlink(missing_ok=True)
        make_folder(work)
        try:
            if scene.camera.sensor.mosaic is not None:
                make_mosaic(scene, out, options, work=work / _MADE, render_plane=plane, check=programs.check)
                return
            if (still := steady(scene, basis=options.basis)) is None:
                make_in_time(scene, out, options, work=work / _MADE, render_still=plane, programs=programs)
                return
            kept = None if warmth is None else warmth.kept
            for meanwhile in (warmth is not None, False):
                traced = LaidOutScene(still, options, programs, work, kept=kept, compared_meanwhile=meanwhile)
                with closing(traced), suppress(_TracersDiffer):
                    known_by = identity_of(still, options, traced)
                    run = _Run(still, options, programs, progress, traced, known_by, out, work / _MADE, warmth)
                    if not _is_finished(run):
                        _carry_out(run, start, cpu)
                    _clean_up(run)
                    break
        except OSError as error:
            raise disk_failure(Path(error.filename or out), error) from error
        finally:
            shutil.rmtree(work, ignore_errors=True)


def _plane_into(
    scene: Scene,
    out: Path,
    options: RenderOptions,
    *,
    instants_left: int | None = None,
    programs: Programs,
    progress: Progress,
    warmth: Warmth | None,
) -> Rendered:
    """One colour of a mosaic, or one instant of a scene that moves; of instants it is known how many are left."""
    make_folder(out)
    progress.restart() if instants_left is None else progress.begin_part(instants_left)
    _render_into(scene, out, options, programs=programs, progress=progress, warmth=warmth)
    return load_result(scene, out)


class _TracersDiffer(Exception):
    """What was traced before the tracers were compared must not stand: Radiance traces it again."""


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """What is decided before anything is traced, and where it goes: to `made`, and once all is whole to `out`."""

    scene: Scene
    options: RenderOptions
    programs: Programs
    progress: Progress
    traced: LaidOutScene
    identity: Identity
    out: Path
    made: Path
    warmth: Warmth | None

    @property
    def pieces(self) -> Path:
        """Folder of what is finished, sub-viewpoints and others."""
        return self.out / _VIEWPOINTS

    @property
    def pictures(self) -> Path | None:
        """Folder of the images, where there are to be any."""
        return None if self.warmth is not None and self.warmth.brief else self.made


def _is_finished(run: _Run) -> bool:
    """Whether the folder already holds this very result, every file of it."""
    method = fixed_method(run.scene, run.options)
    if run.options.keep_viewpoints and method is not None:
        plan = viewpoint_plan(run.scene, run.options, method, run.identity.traced_sha256)
        if missing_viewpoints(plan, run.pieces):
            return False
    return is_whole(run.out, run.identity.run_sha256)


def _carry_out(run: _Run, start: float, cpu: float) -> None:
    """Trace, merge, expose, and write; the manifest last."""
    make_folder(run.pieces)
    make_folder(run.made)
    if run.identity.sources:
        make_folder(run.out / FOLDER)  # a file of that name is told before hours of tracing
    found, basis = _trace(run)
    if not run.traced.tracers_agree():
        raise _TracersDiffer
    found = replace(found, tracer=run.traced.tracer_used)
    run.programs.check()
    images, files = write_images(run.pictures, found.made.radiance, run.scene.camera, run.programs.check)
    files += basis
    if found.made.outcome is not None and run.options.sampling is not None:
        files += write_replicates(run.made, kept(found.made.outcome.replicates, found.exposure_of_radiance))
    uncertainty, more = write_sigma(run.pictures, found)
    files += more
    files += write_frames(run.made, run.scene.camera.sensor, run.options.frames, run.options.seed)
    if run.options.truth:
        files += write_truth(run.made, run.scene, run.traced.prepared.parts, run.traced.numbered_tracer())
    timing = Timing(
        wall_s=time.monotonic() - start,
        tracer_cpu_s=children_cpu_time() - cpu + run.traced.tracer_cpu_s,
        workers=cores(run.options),
        reused_viewpoints=found.made.reused,
        forecast=found.foretold,
    )
    hashes = {name: sha256_of(run.made / name) for name in files}
    write_run_manifest(run.made, found.manifest(images, uncertainty, hashes, timing))
    run.programs.check()
    publish(run.made, run.out, files)


def _trace(run: _Run) -> tuple[TracedRun, list[str]]:
    """What tracing finds, and the files of the light basis, each of which is written once it is traced."""
    scene, traced = run.scene, run.traced
    view = traced.view()
    try:
        seen = traced.view_with_bounces(run.options.bounces) if run.options.bounces else view
        options, asked = with_gray_tolerance(run.options, seen)
        run = replace(run, options=options)
        left_out = bounces(scene, view, options.seed, options.gray_tolerance, traced=traced)
        orders = _orders(options.bounces, left_out)
        work, tracing = _with_bounces(run, view, orders)
        beyond = None
        if isinstance(orders, int) and orders:
            beyond = bounces_beyond(traced, orders, options.seed, options.gray_tolerance)
        announcement = Announcement(traced, options, run.made.parent / "rehearsal", run.programs, asked)
        before = partial(announcement.before, work.view) if options.progress else None
        left = traced.banding.left(tracing)
        relit = bool(run.identity.sources)
        pace = Pace(options.budget_seconds)
        rays = make(scene, left, work, before, relit=relit)
        pace.end()
        # The bands' share of a tolerance is left out of another one likewise.
        finer = partial(_made_to, scene, left, work, relit=relit)
        # Light that walks from surface to surface is not told apart.
        lights = (lambda: (light_of_all(scene, work.view),)) if orders else traced.lights
        waves = with_waves(scene, left, work, rays, finer, lights=lights, pace=pace)
        spread, magnification = _spread(run), magnification_of(scene, view)
        shares = level_shares(scene, traced.view_of, options.seed, complete=not traced.prepared.shining_files)
        basis = _write_basis(run, work, magnification, waves)
    finally:
        run.progress.close()
    return TracedRun(
        scene=traced.scene,
        options=options,
        identity=run.identity,
        made=waves.made,
        banding=traced.banding,
        tracer=traced.tracer_used,
        orders=orders,
        left_out=left_out,
        beyond=beyond,
        waves=waves.left_out,
        diffraction=waves.taken,
        exposure_of_radiance=view.exposure_of_radiance,
        spread=spread,
        magnification=magnification,
        blur_slope=waves.blur_slope,
        foretold=announcement.foretold,
        tolerance_asked=asked,
        level_shares=shares,
    ), basis


def _with_bounces(run: _Run, view: View, orders: Bounces) -> tuple[Work, RenderOptions]:
    """Who traces what: walks of light from surface to surface where they are asked for."""
    options, known_by = run.options, run.identity.traced_sha256
    if orders:
        view = run.traced.bouncing_view(None if isinstance(orders, str) else orders)
        options = replace(options, method="rays")
        known_by = sha256_of_value({"scene": known_by, "bounces": orders})
    in_memory = run.warmth is not None and run.scene.camera.sensor.pixels <= _MOST_IN_MEMORY
    pieces = Pieces(run.pieces, in_memory=True) if in_memory else None
    known = run.warmth.kept if run.warmth else None, tiles_for_waves(run.scene, options)
    return Work(view, run.pieces, run.programs, run.progress, known_by, options.seed, pieces, *known), options


def _made_to(scene: Scene, options: RenderOptions, work: Work, tolerance: float, *, relit: bool) -> Made:
    """The image by rays, to another tolerance [gray level]."""
    return make(scene, replace(options, tolerance=tolerance), work, relit=relit)


def _write_basis(run: _Run, work: Work, magnification: NDArray[np.float64] | None, waves: WithWaves) -> list[str]:
    scene, identity, sources, outcome = run.scene, run.identity, run.identity.sources, waves.made.outcome
    if not sources or outcome is None:
        return []
    views = run.traced.views_of(sources)
    told = {
        "scene_sha256": identity.scene_sha256,
        "run_sha256": identity.run_sha256,
        "tolerance": run.options.gray_tolerance,
        "max_error": run.options.max_error,
        "seed": run.options.seed,
        "dark": sorted({emitter.source for emitter in scene.emitters} - set(sources)),
        "versions": identity.versions,
        **({} if scene.tolerances is None else {"tolerances": plain(scene.tolerances)}),
    }
    write = partial(write_basis, run.made, work, views, outcome, told, waves=waves.plan, lights=waves.lights)
    return write(magnification=magnification, in_one=run.pictures is None)


def _spread(run: _Run) -> NDArray[np.float64] | None:
    """How the light of each pixel is shared among the sources, where each has a tolerance of its own."""
    tolerances = run.scene.tolerances
    if tolerances is None or not tolerances.each_source_radiance:
        return None
    names = run.identity.sources or shining(run.scene, run.traced.prepared, "tolerances.each_source_radiance")
    return share_spread([run.traced.view_of(name) for name in names])


def _clean_up(run: _Run) -> None:
    """Remove the log of the pieces, and the pieces, unless they are sub-viewpoints and wanted."""
    remove_log(run.pieces)
    if not run.options.keep_viewpoints or fixed_method(run.scene, run.options) is None:
        remove_pieces(run.pieces)


def _orders(asked: Bounces | Literal["auto"], left_out: Effect) -> Bounces:
    """How often light may go from surface to surface, once it is known what leaving that out would cost."""
    if asked == "auto":
        return "all" if left_out.needed else 0
    return asked
