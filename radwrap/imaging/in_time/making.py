"""The files and the manifest of a scene that changes in the course of its exposure."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder, sha256_of
from radwrap.images import ExposureImage
from radwrap.imaging.in_time.by_rows import StillRender, by_rows
from radwrap.imaging.in_time.moving import moving, tracer_of_many
from radwrap.imaging.output.composed_files import write_composed
from radwrap.imaging.output.folder import INSTANTS, is_whole, publish
from radwrap.imaging.output.identity import identity_of
from radwrap.imaging.output.image_files import ImageSummary
from radwrap.imaging.output.run_manifest import InTime, RunManifest, components_used, write_run_manifest
from radwrap.imaging.relight.basis import BASIS
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.response.noise import linear_of
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.run_files import LightFile, RowsFile, TimedBasisFile
from radwrap.imaging.time_steps import lights_of
from radwrap.imaging.timed_basis import write_timed_basis
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.uncertainty import Uncertainty, uncertainty
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import plain, read_manifest, sha256_of_value
from radwrap.process import Programs
from radwrap.scene.instants import averaged, held, is_even, keys_of_time, lit_by, row_levels
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.scene import Scene
from radwrap.scene.tolerances import Tolerances

Array = NDArray[np.float64]
_IDENTITY: Final = "identity"
_BASE: Final = "base"  # the folder of the one instant, as `moving` has it


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What the image is made of."""

    base: Rendered
    exposure: Array
    certificate: Certificate
    instants: int
    rays: int
    tracer_cpu_s: float
    rows: RowsFile | None
    lights: tuple[LightFile, ...]
    folder: Path


def refuse_for_time(scene: Scene, options: RenderOptions) -> None:
    """See that a scene that changes in the course of its exposure can be rendered as the options ask.

    Raises
    ------
    InputError
        If it cannot.
    """
    keys = keys_of_time(scene)
    if not keys:
        return
    asked = {
        "sampling": options.sampling is not None,
        "method": options.fixed_method is not None,
        "max_error": options.max_error is not None and bool(scene.motions),
        "budget_rays": options.budget_rays is not None,
        "budget_seconds": options.budget_seconds is not None,
    }
    for name, given in asked.items():
        if given:
            raise InputError(
                f"knows one instant only, and {keys[0]} makes the scene another one in the course of its exposure",
                where=name,
                remedy="leave one of them out",
            )
    if options.basis and scene.motions and scene.camera.sensor.mosaic is not None:
        raise InputError(
            f"is of one colour where something moves, and camera.sensor.mosaic is "
            f'"{scene.camera.sensor.mosaic.pattern}"',
            where="basis",
            remedy='look at one colour: with camera.sensor.mosaic = "green" all pixels have its filter',
        )
    if scene.tolerances is not None:
        raise InputError(
            f"know one instant only, and {keys[0]} makes the scene another one in the course of its exposure",
            where=f"{scene.origin}: tolerances",
            remedy="leave one of them out",
        )
    if scene.included and scene.strobes:
        raise InputError(
            "may hold light of its own, which no strobe switches",
            where=f"{scene.origin}: targets[{scene.targets.index(scene.included[0])}].rad",
            remedy="describe it by targets and sources, or leave out the strobes",
        )
    if not scene.camera.exposure_time:
        raise InputError(
            f"is 0, and {keys[0]} needs a time", where=f"{scene.origin}: camera.exposure_time", remedy="set it"
        )
    lights_of(scene)  # raises where it is dark
    if options.frames:
        linear_of(scene.camera.sensor)


def steady(scene: Scene, *, basis: bool) -> Scene | None:
    """The scene of one instant that gives the same image; None where there is none.

    Where nothing moves and each source lights all rows alike, a pulse is light of a lower level; a light basis must
    know that it is a pulse.
    """
    if not keys_of_time(scene):
        return scene
    if basis:
        return None
    levels = row_levels(scene)
    if scene.motions or not is_even(levels.values()):
        return None
    return lit_by(held(scene), {name: float(level[0]) for name, level in levels.items()})


def make_in_time(
    scene: Scene,
    out: Path,
    options: RenderOptions,
    *,
    work: Path,
    render_still: StillRender,
    programs: Programs,
) -> None:
    """Render the scene at its instants, and make its image, files and manifest of them, unless they lie there already.

    Parameters
    ----------
    scene : Scene
        That changes.
    out : Path
        Where to.
    options : RenderOptions
        How.
    work : Path
        Folder for what is not yet whole.
    render_still : callable
        Renders the scene of one instant into a folder.
    programs : Programs
        Owner of the processes, asked now and then whether the work is to end.
    """
    start, check = time.monotonic(), programs.check
    run_sha256 = _run_sha256(scene, options, programs, work / _IDENTITY)
    if is_whole(out, run_sha256):
        return
    folder = out / INSTANTS
    make_folder(folder)
    found = _found(scene, folder, options, render_still, check)
    check()
    sensor, known = scene.camera.sensor, _uncertainty(scene, found)
    sigma, truth_of = None if known is None else known.sigma, folder / _BASE
    images, files = write_composed(work, found.exposure, sensor, options, sigma=sigma, truth_of=truth_of, check=check)
    manifest = replace(_manifest(scene, found, images), run_sha256=run_sha256)
    if options.basis:
        files += _write_bases(work, scene, found, manifest.scene_sha256)
    hashes = {name: sha256_of(work / name) for name in files}
    timing = replace(manifest.timing, wall_s=time.monotonic() - start)
    summary = None if known is None else known.summary()
    write_run_manifest(work, replace(manifest, uncertainty=summary, files=hashes, timing=timing))
    check()
    publish(work, out, files)


def _found(
    scene: Scene, folder: Path, options: RenderOptions, render_still: StillRender, check: Callable[[], None]
) -> _Found:
    # A basis knows no light from surface to surface.
    if scene.motions or options.bounces:
        made = moving(scene, folder, options, render_still, check)
        runs = (made.base.run, *made.runs)
        cpu = math.fsum(run.timing.tracer_cpu_s for run in runs)
        return _Found(
            made.base, made.exposure, made.certificate, made.instants, made.rays, cpu, None, made.lights, made.folder
        )
    rows = by_rows(scene, folder / _BASE, options, render_still)
    run = rows.base.run
    certificate = rows.image.certificate
    if run.error.bands_gray is not None:
        certificate = certificate.with_bands(run.error.bands_gray)
    exposure = rows.image.radiant_exposure.values
    base = replace(rows.base, run=replace(run, tolerance=rows.tolerance))
    return _Found(base, exposure, certificate, 1, rows.rays, rows.tracer_cpu_s, rows.rows, (), folder)


def _write_bases(work: Path, scene: Scene, found: _Found, scene_sha256: str) -> list[str]:
    """Copy the light bases of the instants, or of the rows, and tell of them; returns the files' names."""
    told = TimedBasisFile(
        scene_sha256=scene_sha256,
        camera=replace(scene.camera, distortion=None),
        tolerance=found.base.run.tolerance or 0.0,
        rows=found.rows,
        lights=found.lights,
    )
    bases = [found.rows.basis] if found.rows else [one.basis for light in found.lights for one in light.instants]
    files = []
    for basis in dict.fromkeys(bases):
        made = found.folder / Path(basis).name
        for name in (BASIS, *read_manifest(made / BASIS)["files"]):
            make_folder((work / basis / name).parent)
            shutil.copyfile(made / name, work / basis / name)
            files.append(f"{basis}/{name}")
    return [*files, write_timed_basis(work, told)]


def _uncertainty(scene: Scene, found: _Found) -> Uncertainty | None:
    """What a captured frame scatters by; None where the sensor's noise is not known."""
    if scene.camera.sensor.linear is None:
        return None
    return uncertainty(ExposureImage(found.exposure), scene.camera, Tolerances(), found.certificate.rms_gray)


def _run_sha256(scene: Scene, options: RenderOptions, programs: Programs, folder: Path) -> str:
    """Hash of all that decides any file: what is at the middle of the first exposure, and what changes."""
    if scene.motions:
        options = replace(options, tracer=tracer_of_many(scene, options.tracer))
    still = averaged(scene)
    make_folder(folder)
    traced = LaidOutScene(still, options, programs, folder)
    decided = {
        "still": identity_of(still, options, traced).run_sha256,
        "camera": scene.camera,
        "motions": scene.motions,
        "strobes": scene.strobes,
    }
    return sha256_of_value(decided)


def _manifest(scene: Scene, found: _Found, images: ImageSummary) -> RunManifest:
    """That of the scene at one instant, its files too, with what is of the whole exposure."""
    base, sensor = found.base.run, scene.camera.sensor
    still = gray_levels(found.base.radiant_exposure.values, sensor)
    change = float(np.sqrt(np.mean((gray_levels(found.exposure, sensor) - still) ** 2)))
    known_by = {
        "camera": scene.camera,
        "motions": scene.motions,
        "strobes": scene.strobes,
        "base": base.scene_sha256,
    }
    return replace(
        base,
        scene_sha256=sha256_of_value(known_by),
        rays=found.rays,
        rays_per_pixel=found.rays / sensor.pixels,
        assumed=dict(sorted(scene.assumed.items())),
        components=components_used(scene),
        camera=plain(scene.camera),
        scene=scene.document,
        warnings=tuple(dict.fromkeys((*base.warnings, *warnings_of(scene)))),
        radiant_exposure=images.radiant_exposure,
        gray=images.gray,
        saturated_fraction=images.saturated_fraction,
        dark_fraction=images.dark_fraction,
        error=found.certificate,
        in_time=InTime(instants=found.instants, about_rms_gray=change),
        timing=replace(base.timing, tracer_cpu_s=found.tracer_cpu_s),
    )
