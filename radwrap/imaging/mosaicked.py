"""The raw image of a colour camera: of three monochrome images each pixel is taken from that of its own filter.

Where the light of one colour is that of another but for a factor, as it is of one wavelength, one image is rendered
and scaled. The bound of a colour is that of its whole image, of which its pixels are a regular sample.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import make_folder, sha256_of
from radwrap.images import ExposureImage, read_image
from radwrap.imaging.other_camera import growth_of, scaled
from radwrap.imaging.output.composed_files import write_composed
from radwrap.imaging.output.folder import PLANES, publish
from radwrap.imaging.output.image_files import ImageSummary
from radwrap.imaging.output.run_manifest import (
    Extent,
    MosaicMade,
    PlaneMade,
    RunManifest,
    components_used,
    write_run_manifest,
)
from radwrap.imaging.output.sigma_file import SIGMA
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.response.noise import linear_of
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.raw_error import error_of_all, uncertainty_of_all, without_error
from radwrap.imaging.tolerance.uncertainty import Uncertainty, UncertaintySummary, uncertainty
from radwrap.manifest import plain, sha256_of_value
from radwrap.scene.colour_planes import mosaic_of, shares_of_light
from radwrap.scene.file.load import with_value
from radwrap.scene.mosaic import COLOURS, Colour, Mosaic, composed
from radwrap.scene.scene import Scene
from radwrap.scene.tolerances import Tolerances

Array = NDArray[np.float64]
PlaneRender = Callable[[Scene, Path, RenderOptions], Rendered]


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    """One colour, as if all pixels had its filter.

    Attributes
    ----------
    exposure : ndarray, shape (rows, columns)
        As the mosaic's sensor counts it [J m^-2].
    certificate : Certificate
        How far its gray levels may be off.
    sigma : ndarray, shape (rows, columns), optional
        Standard deviation of a captured frame's gray levels, where it is known.
    sigma_parts : Mapping[str, float]
        What each cause adds to it.
    light_of : str
        Colour whose render it is made of.
    share : float
        Its exposure over that render's.
    run : RunManifest
        Of that render.
    """

    exposure: Array
    certificate: Certificate
    sigma: Array | None
    sigma_parts: Mapping[str, float]
    light_of: Colour
    share: float
    run: RunManifest


def refuse_for_mosaic(scene: Scene, options: RenderOptions) -> None:
    """See that a mosaic can be rendered as the options ask.

    Raises
    ------
    InputError
        If it cannot, or frames are asked for of a sensor without noise.
    """
    mosaic = scene.camera.sensor.mosaic
    if mosaic is None:
        return
    if options.sampling is not None:
        raise InputError(
            f'is of one colour at a time, and camera.sensor.mosaic is "{mosaic.pattern}"',
            where="sampling",
            remedy='render the colours one by one: set camera.sensor.mosaic to "red", "green" or "blue"',
        )
    if options.frames:
        linear_of(scene.camera.sensor)


def plane_of(scene: Scene, colour: Colour) -> Scene:
    """The scene as a monochrome camera sees it behind the filter of one colour, diffraction as the scene has it."""
    plane = with_value(scene, "camera.sensor.mosaic", colour)
    return replace(plane, camera=replace(plane.camera, diffraction=scene.camera.diffraction))


def relative_exposure(scene: Scene, colour: Colour) -> float:
    """A colour's radiant exposure as the mosaic's sensor counts it, over that of its plane.

    Without spectra a plane counts electrons by its own efficiency, the mosaic by the largest of three.
    """
    if scene.spectral is not None or (shares := mosaic_of(scene).relative) is None:
        return 1.0
    return shares[COLOURS.index(colour)]


def rendered_colours(scene: Scene, options: RenderOptions) -> tuple[Colour, ...]:
    """Colours that need a render of their own, that with most light first; saturated pixels may need more."""
    return _rendered(_shares(scene, options))


def brightest_colour(scene: Scene) -> Colour:
    """The colour whose pixels get most light; the first of them to saturate."""
    return _rendered(shares_of_light(scene))[0]


def make_mosaic(
    scene: Scene, out: Path, options: RenderOptions, *, work: Path, render_plane: PlaneRender, check: Callable[[], None]
) -> None:
    """Render the colours, and make the raw image, its files and its manifest of them.

    Parameters
    ----------
    scene : Scene
        With a mosaic.
    out : Path
        Where to.
    options : RenderOptions
        How.
    work : Path
        Folder for what is not yet whole.
    render_plane : callable
        Renders one colour's scene into a folder.
    check : callable
        Asked now and then; it raises to end the work.
    """
    start = time.monotonic()
    mosaic, sensor = mosaic_of(scene), scene.camera.sensor
    planes = _planes(scene, out / PLANES, replace(options, frames=0), render_plane)
    check()
    exposure = composed(mosaic.pattern, {colour: plane.exposure for colour, plane in planes.items()})
    known = _uncertainty(mosaic, planes)
    used = tuple(dict.fromkeys(plane.light_of for plane in planes.values()))
    sigma, truth_of = None if known is None else known.sigma, out / PLANES / used[0]
    images, files = write_composed(work, exposure, sensor, options, sigma=sigma, truth_of=truth_of, check=check)
    made = MosaicMade(
        pattern=mosaic.pattern,
        filters_sha256=sha256_of_value({colour: getattr(mosaic, colour) for colour in COLOURS}),
        colours={colour: _plane_made(planes[colour], mosaic, colour, exposure, scene) for colour in COLOURS},
    )
    told = _Told(scene, options, made, [plane.run for plane in planes.values()], planes[used[0]].run)
    hashes = {name: sha256_of(work / name) for name in files}
    write_run_manifest(
        work, told.manifest(images, None if known is None else known.summary(), hashes, time.monotonic() - start)
    )
    check()
    publish(work, out, files, used)


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """What the manifest is made of: the scene, how it was rendered, the colours, their runs, and the first of these."""

    scene: Scene
    options: RenderOptions
    made: MosaicMade
    of_planes: Sequence[RunManifest]
    first: RunManifest

    def manifest(
        self, images: ImageSummary, uncertainty: UncertaintySummary | None, files: dict[str, str], wall_s: float
    ) -> RunManifest:
        """The manifest: that of a colour that missed the tolerance, or of the first one, with what is of all."""
        scene, options = self.scene, self.options
        runs = list({run.run_sha256: run for run in self.of_planes}.values())
        base = next((run for run in runs if not run.met), self.first)
        decided = {
            "camera": scene.camera,
            "document": scene.document,
            "planes": [run.run_sha256 for run in runs],
            "frames": options.frames,
            "truth": options.truth,
        }
        timing = replace(
            base.timing,
            wall_s=wall_s,
            tracer_cpu_s=math.fsum(run.timing.tracer_cpu_s for run in runs),
            reused_viewpoints=sum(run.timing.reused_viewpoints for run in runs),
        )
        return replace(
            base,
            scene_sha256=sha256_of_value({"camera": scene.camera, "planes": [run.scene_sha256 for run in runs]}),
            run_sha256=sha256_of_value(decided),
            rays=sum(run.rays for run in runs),
            rays_per_pixel=math.fsum(run.rays_per_pixel for run in runs),
            assumed=dict(sorted(scene.assumed.items())),
            components=components_used(scene),
            camera=plain(scene.camera),
            scene=scene.document,
            warnings=tuple(dict.fromkeys(line for run in runs for line in run.warnings)),
            radiant_exposure=images.radiant_exposure,
            gray=images.gray,
            saturated_fraction=images.saturated_fraction,
            dark_fraction=images.dark_fraction,
            error=_error_of_all(self.made.colours),
            uncertainty=uncertainty,
            left_out=_left_out(runs),
            mosaic=self.made,
            files=files,
            timing=timing,
        )


def _shares(scene: Scene, options: RenderOptions) -> Mapping[Colour, float | None]:
    """As `shares_of_light`.

    Each colour is rendered where inputs have tolerances, as its slopes are its own, and for a basis of its own.
    """
    shares = shares_of_light(scene)
    if scene.tolerances is None and not options.basis:
        return shares
    brightest, *_ = _rendered(shares)
    return {colour: share if colour == brightest or share == 0 else None for colour, share in shares.items()}


def _rendered(shares: Mapping[Colour, float | None]) -> tuple[Colour, ...]:
    """The colour with most light, and those whose light is not a share of it."""
    brightest = max(COLOURS, key=lambda colour: shares[colour] or 0.0)
    return (brightest, *(colour for colour in COLOURS if shares[colour] is None))


def _planes(scene: Scene, folder: Path, options: RenderOptions, render: PlaneRender) -> dict[Colour, _Plane]:
    shares = _shares(scene, options)
    brightest, *others = _rendered(shares)
    # A budget is that of all planes; pixels that saturate may need more.
    parts = 1 + len(others)
    rays, seconds = options.budget_rays, options.budget_seconds
    options = replace(
        options,
        budget_rays=None if rays is None else max(rays / parts, 1.0),
        budget_seconds=None if seconds is None else max(seconds / parts, 1e-3),
    )
    make_folder(folder)
    first = _rendered_plane(scene, brightest, folder, options, render)
    found = {brightest: first}
    for colour in COLOURS:
        share = shares[colour]
        if colour == brightest:
            continue
        made = None if share is None else _scaled_plane(scene, first, share)
        found[colour] = made or _rendered_plane(scene, colour, folder, replace(options, truth=False), render)
    return found


def _rendered_plane(scene: Scene, colour: Colour, folder: Path, options: RenderOptions, render: PlaneRender) -> _Plane:
    result = render(plane_of(scene, colour), folder / colour, options)
    run = result.run
    sigma = read_image(folder / colour / SIGMA)[0].astype(np.float64) if SIGMA in run.files else None
    parts = {} if run.uncertainty is None else run.uncertainty.parts_rms_gray
    exposure = result.radiant_exposure.values * relative_exposure(scene, colour)
    return _Plane(exposure, run.error, sigma, parts, colour, 1.0, run)


def _scaled_plane(scene: Scene, first: _Plane, share: float) -> _Plane | None:
    """A colour whose light is a share of the first one's; None where that one is saturated and bounds nothing."""
    camera = replace(scene.camera, sensor=replace(scene.camera.sensor, mosaic=None))
    bound = first.certificate.rms_gray_upper95
    if share > 0:
        growth = growth_of(camera.sensor, camera.sensor, share, first.exposure, bound)
        if not math.isfinite(growth):
            return None
        certificate = scaled(first.certificate, growth)
    else:
        certificate = without_error(first.certificate)
    exposure = first.exposure * share
    sigma, parts = None, {}
    if camera.sensor.linear is not None:
        found = uncertainty(ExposureImage(exposure), camera, Tolerances(), certificate.rms_gray)
        sigma, parts = found.sigma, dict(found.parts)
    return _Plane(exposure, certificate, sigma, parts, first.light_of, share, first.run)


def _plane_made(plane: _Plane, mosaic: Mosaic, colour: Colour, exposure: Array, scene: Scene) -> PlaneMade:
    values = np.concatenate([exposure[place].ravel() for place in mosaic.places(colour)])
    levels = gray_levels(values, scene.camera.sensor)
    return PlaneMade(
        pixels=values.size,
        light_of=plane.light_of,
        share=plane.share,
        run_sha256=plane.run.run_sha256,
        scene_sha256=plane.run.scene_sha256,
        tolerance=plane.run.tolerance,
        gray=Extent.of(levels),
        error=plane.certificate,
    )


def _error_of_all(colours: Mapping[Colour, PlaneMade]) -> Certificate:
    """How far the raw image may be off."""
    pixels = {colour: plane.pixels for colour, plane in colours.items()}
    own = {plane.light_of: plane.error for plane in colours.values()}
    return error_of_all(pixels, {colour: plane.error for colour, plane in colours.items()}, own.values())


def _left_out(runs: Sequence[RunManifest]) -> dict[str, Any]:
    """Of each effect that any colour lacks, the one of the colour that it changes most."""
    names = dict.fromkeys(name for run in runs for name in run.left_out)
    return {
        name: max(
            (run.left_out[name] for run in runs if name in run.left_out), key=lambda effect: effect.rms_gray_upper95
        )
        for name in names
    }


def _uncertainty(mosaic: Mosaic, planes: Mapping[Colour, _Plane]) -> Uncertainty | None:
    """The planes' standard deviations, each at its own pixels; None where they are not known."""
    known = {c: Uncertainty(plane.sigma, plane.sigma_parts) for c, plane in planes.items() if plane.sigma is not None}
    return uncertainty_of_all(mosaic.pattern, known) if len(known) == len(planes) else None
