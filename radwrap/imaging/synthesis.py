"""The main job: a scene becomes the gray image its camera would give.

A run owns its folder. Finished sub-viewpoints stay in it until the images are
whole, so that a killed run goes on; the files of an older run stay until every
new one is whole, and the manifest appears last.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import (
    TEMPORARY_SUFFIX,
    check_result,
    disk_failure,
    make_folder,
    move_files,
    sha256_of,
    sole_owner,
)
from radwrap.images import ExposureImage, GrayImage, RadianceImage, png_bytes, read_image, write_exr, write_png
from radwrap.imaging.forecast import photo_realistic
from radwrap.imaging.forecast.cost import Cost, check_size, estimate, seconds_per_ray
from radwrap.imaging.forecast.effects import Effect, bounces, bounces_beyond
from radwrap.imaging.mean_radiance import Made, fixed_method, how, make, viewpoint_plan
from radwrap.imaging.methods.pieces import remove_pieces
from radwrap.imaging.methods.viewpoints import missing_viewpoints
from radwrap.imaging.optics.diffraction import diffraction, diffraction_warning
from radwrap.imaging.optics.view import View
from radwrap.imaging.relight.basis import BASIS, FOLDER, shining, write_basis
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.imaging.response.noise import fixed_pattern, frame_file, frames_in, linear_of, noisy_frame
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.imaging.run_files import RunManifest
from radwrap.imaging.tolerance.kept_replicates import REPLICATES, kept, write_replicates
from radwrap.imaging.tolerance.planner import choose
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.survey import survey
from radwrap.imaging.tolerance.uncertainty import seen_magnifications, share_spread, uncertainty
from radwrap.imaging.tracing import TracedScene, laid_out, scene_sha256
from radwrap.imaging.truth import central_maps, geometry
from radwrap.manifest import SCHEMA_VERSION, plain, read_manifest, sha256_of_value, versions, write_manifest
from radwrap.process import Programs, available_cores, children_cpu_time
from radwrap.progress import Progress
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.scene import Scene
from radwrap.scene.tolerances import Tolerances
from radwrap.written import read_back

MANIFEST: Final = "manifest.json"
EXPOSURE: Final = "radiant_exposure.exr"
GRAY: Final = "gray.png"
UNROUNDED: Final = "gray.exr"
DEPTH: Final = "depth.exr"
PARTS: Final = "mask.png"
TRUTH: Final = "truth.json"
SIGMA: Final = "gray_sigma.exr"
_OPTIONAL: Final = (UNROUNDED, SIGMA, DEPTH, PARTS, TRUTH, REPLICATES, *photo_realistic.FILES)
_VIEWPOINTS: Final = "viewpoints"
_WORK: Final = ".work"
_MADE: Final = "made"
# Rays a pixel that a tolerance takes, where only a rough number is needed.
_USUAL_RAYS: Final = 8

Bounces = int | Literal["all"]


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """What a run made; a notebook shows its picture.

    Attributes
    ----------
    radiant_exposure : ExposureImage
        H [J m^-2].
    gray : GrayImage
        What the camera gives.
    manifest : Mapping
        What was made, of what, with what.
    truth : Mapping, optional
        With ``truth=True``: ``depth`` along the axis, 0 where nothing is seen,
        float32, shape (rows, columns) [m]; ``mask``, the number of the part
        that each pixel's centre sees, uint16, of that shape; and what
        truth.json holds: ``parts`` (name -> number), ``targets`` (poses, dots,
        edges), ``pixel_convention``.
    """

    radiant_exposure: ExposureImage
    gray: GrayImage
    manifest: Mapping[str, Any]
    truth: Mapping[str, Any] | None = None

    def _repr_png_(self) -> bytes:
        return png_bytes(self.gray.codes)


def render(
    scene: Scene, out: str | Path | None = None, options: RenderOptions | None = None, **changes: Any
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
    **changes
        Single options, such as ``viewpoints=61``.

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
    """
    options = replace(options or RenderOptions(), **changes)
    check_size(scene, options.max_pixels, _usual_rays(scene, options), options.workers or available_cores())
    if out is None:
        for name in ("frames", "basis", "keep_viewpoints"):
            if getattr(options, name):
                raise InputError(
                    "its files would be lost with a temporary folder",
                    where=f"--{name.replace('_', '-')}",
                    remedy="name the folder: out",
                )
        with tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
            return _render_into(scene, Path(folder), options)
    make_folder(Path(out))
    return _render_into(scene, Path(out), options)


def _usual_rays(scene: Scene, options: RenderOptions) -> int:
    """Rays that each pixel gets, as far as that is known before a ray is traced."""
    method = fixed_method(scene, options)
    if method is None:
        return _USUAL_RAYS
    return (1 if method == "pinhole" else options.viewpoint_number) * options.pixel_samples**2


def forecast(scene: Scene, options: RenderOptions) -> Cost:
    """What a run would cost; the time of a ray is measured on a few pixels of the scene.

    Raises
    ------
    InputError, EnvironmentFailure
        As `render`.
    """
    if options.frames:
        linear_of(scene.camera.sensor)
    workers = options.workers or available_cores()
    rays = _usual_rays(scene, options)
    check_size(scene, options.max_pixels, rays, workers)
    with laid_out(scene, options) as traced:
        # Whether "auto" means all is not known before rays are traced: what it costs at most is told.
        orders = options.bounces if isinstance(options.bounces, int) else None
        view = traced.view() if orders == 0 else traced.bouncing_view(orders)
        expected: float = rays * scene.camera.sensor.pixels
        if fixed_method(scene, options) is None:
            demand = options.demand if orders == 0 else replace(options.demand, method="rays")
            choice = choose(view, survey(view, options.seed), demand)
            expected = choice.expected_rays[choice.method] or expected
        return estimate(scene, expected, workers, lambda: seconds_per_ray(view))


def _render_into(scene: Scene, out: Path, options: RenderOptions) -> Rendered:
    start, cpu = time.monotonic(), children_cpu_time()
    with sole_owner(out), Programs() as programs:
        for name in (EXPOSURE, GRAY, MANIFEST):
            check_result(out / name)
        work = out / _WORK
        shutil.rmtree(work, ignore_errors=True)
        for leftover in out.glob(f".*{TEMPORARY_SUFFIX}.*"):  # of a killed run
            leftover.unlink(missing_ok=True)
        make_folder(work)
        try:
            run = _Run(scene, out, work, options, programs)
            if not run.is_finished():
                run.carry_out(start, cpu)
            run.clean_up()
        except OSError as error:
            raise disk_failure(Path(error.filename or out), error) from error
        finally:
            shutil.rmtree(work, ignore_errors=True)
        return load_result(scene, out)


def load_result(scene: Scene, out: Path) -> Rendered:
    """Read back what a run left in its folder."""
    manifest = read_manifest(out / MANIFEST)
    exposure = ExposureImage(read_image(out / EXPOSURE)[0].astype(np.float64), manifest)
    # A sensor that does not round leaves its gray levels in an own file, the PNG holds them rounded.
    file = out / (GRAY if scene.camera.sensor.rounding else UNROUNDED)
    gray = GrayImage(read_image(file)[0].astype(np.float64), scene.camera.sensor.bit_depth, manifest)
    return Rendered(exposure, gray, manifest, _read_truth(out) if TRUTH in manifest["files"] else None)


def _read_truth(out: Path) -> dict[str, Any]:
    return {
        **read_manifest(out / TRUTH),
        "depth": read_image(out / DEPTH)[0],
        "mask": read_image(out / PARTS)[0],
    }


class _Run:
    """One run in its folder: what is decided once, and the steps that need it."""

    def __init__(self, scene: Scene, out: Path, work: Path, options: RenderOptions, programs: Programs) -> None:
        self.scene = scene
        self.out = out
        self.made = work / _MADE
        self.options = options
        self.programs = programs
        self.traced = TracedScene(scene, options, programs, work)
        self.versions = {**versions(), "radiance": self.traced.version}
        self.traced_sha256 = self.traced.sha256()
        if options.frames:
            linear_of(scene.camera.sensor)
        self.sources = shining(scene, self.traced.prepared) if options.basis else ()
        self.sha256 = sha256_of_value(
            {
                "traced": self.traced_sha256,
                "camera": scene.camera,
                "how": how(scene, options),
                "truth": options.truth,
                "basis": self.sources,
                **({"frames": options.frames} if options.frames else {}),
                "document": scene.document,
                "versions": self.versions,
            }
        )

    @property
    def folder(self) -> Path:
        """Where the sub-viewpoints' files are."""
        return self.out / _VIEWPOINTS

    def is_finished(self) -> bool:
        """Whether the folder already holds this very result, every file of it."""
        method = fixed_method(self.scene, self.options)
        if self.options.keep_viewpoints and method is not None:
            plan = viewpoint_plan(self.scene, self.options, method, self.traced_sha256)
            if missing_viewpoints(plan, self.folder):
                return False
        try:
            known: RunManifest = read_back(read_manifest(self.out / MANIFEST), RunManifest, MANIFEST)
            files = known.files.items()
            return known.run_sha256 == self.sha256 and all(sha256_of(self.out / name) == sha for name, sha in files)
        except (InputError, OSError, KeyError):
            return False

    def carry_out(self, start: float, cpu: float) -> None:
        """Trace, merge, expose, and write; the manifest last."""
        make_folder(self.folder)
        make_folder(self.made)
        if self.sources:
            make_folder(self.out / FOLDER)  # a file of that name is told before hours of tracing
        progress = Progress("tracing", 1, shown=self.options.progress)
        view = self.traced.view()
        try:
            banding = self.traced.banding
            left_out = bounces(self.scene, view, self.options.seed, self.options.tolerance, traced=self.traced)
            orders = _orders(self.options.bounces, left_out)
            work, options = self._with_bounces(view, orders, progress)
            beyond = None
            if isinstance(orders, int) and orders:
                beyond = bounces_beyond(self.traced, orders, self.options.seed, self.options.tolerance)
            made = make(self.scene, banding.left(options), work)
            spread, magnification = self._spread(), self._magnification(view)
            basis = self._write_basis(work, made, magnification)
        finally:
            progress.close()
        summary, files = self._write_images(made.radiance)
        files += basis
        if made.outcome is not None and self.options.sampling is not None:
            files += write_replicates(self.made, kept(made.outcome.replicates, view.exposure_of_radiance))
        told, more = self._write_uncertainty(made.error["rms_gray"], spread, magnification)
        files += [*more, *self._write_frames()]
        if self.options.truth:
            files += self._write_truth()
        timing = {
            "wall_s": time.monotonic() - start,
            "tracer_cpu_s": children_cpu_time() - cpu,
            "workers": self.options.workers or available_cores(),
            "reused_viewpoints": made.reused,
        }
        manifest = {
            **self._description(made),
            "warnings": [
                *warnings_of(self.scene),
                *_lens_warnings(self.scene),
                *(() if orders else _warnings_of(left_out, "goes from one surface to another")),
                *(_warnings_of(beyond, f"is reflected more than {orders} times on its way") if beyond else ()),
            ],
            **summary,
            "error": banding.raised(made.error),
            **told,
            **banding.as_manifest(),
            **_told(orders, left_out, beyond),
            "files": {name: sha256_of(self.made / name) for name in files},
            "timing": timing,
        }
        write_manifest(self.made / MANIFEST, manifest)
        self._publish(files)

    def _with_bounces(self, view: View, orders: Bounces, progress: Progress) -> tuple[Work, RenderOptions]:
        """Who traces what: walks of light from surface to surface where they are asked for."""
        options, known_by = self.options, self.traced_sha256
        if orders:
            view = self.traced.bouncing_view(None if isinstance(orders, str) else orders)
            options = replace(options, method="rays")
            known_by = sha256_of_value({"scene": known_by, "bounces": orders})
        return Work(view, self.folder, self.programs, progress, known_by, self.options.seed), options

    def clean_up(self) -> None:
        """Remove the pieces, unless they are sub-viewpoints and wanted."""
        if not self.options.keep_viewpoints or fixed_method(self.scene, self.options) is None:
            remove_pieces(self.folder)

    def _write_images(self, radiance: NDArray[np.float64]) -> tuple[dict[str, Any], list[str]]:
        camera = self.scene.camera
        sensor = camera.sensor
        exact = radiant_exposure(RadianceImage(radiance), camera)
        # The gray image is Eq. 5 of the exposure as the file holds it, so that anybody can compute it again.
        stored = exact.values.astype(np.float32)
        unit = {"radwrap:unit": "J m^-2"}
        exposure = ExposureImage(stored.astype(np.float64))
        with ThreadPoolExecutor() as pool:  # one file is compressed while the other one's levels are computed
            exr = pool.submit(write_exr, self.made / EXPOSURE, stored, channel="radiant_exposure", metadata=unit)
            levels = gray_levels(exposure.values, sensor)
            gray = image_of_levels(levels, sensor, exposure.provenance)
            write_png(self.made / GRAY, gray.codes)
            exr.result()
        files = [EXPOSURE, GRAY]
        if not sensor.rounding:
            write_exr(self.made / UNROUNDED, gray.values.astype(np.float32), channel="gray")
            files.append(UNROUNDED)
        summary = {
            "radiant_exposure": _range(exposure.values),
            "gray": _range(gray.values),
            "saturated_fraction": float(np.mean(levels >= sensor.saturation_gray)),
            "dark_fraction": float(np.mean(levels < sensor.dark_gray + 0.5)),
        }
        return summary, files

    def _publish(self, files: Sequence[str]) -> None:
        """Put whole files in place of an older run's, which stood until now: a disk that fills loses none."""
        self._remove_old()
        move_files(self.made, self.out, files)
        move_files(self.made, self.out, [MANIFEST])

    def _remove_old(self) -> None:
        """From here on an old manifest no longer fits the files, and what only an older run wrote fits nothing."""
        if (self.out / BASIS).exists():
            remove_pieces(self.out / FOLDER)
        for name in (MANIFEST, BASIS, *_OPTIONAL, *frames_in(self.out)):
            (self.out / name).unlink(missing_ok=True)

    def _write_basis(self, work: Work, made: Made, magnification: NDArray[np.float64] | None) -> list[str]:
        if not self.sources or made.outcome is None:
            return []
        views = {name: self.traced.view_of(name) for name in self.sources}
        told = {
            "scene_sha256": scene_sha256(self.scene, self.traced.prepared),
            "run_sha256": self.sha256,
            "tolerance": self.options.tolerance,
            "max_error": self.options.max_error,
            "seed": self.options.seed,
            "dark": sorted({emitter.source for emitter in self.scene.emitters} - set(self.sources)),
            "versions": self.versions,
            **({} if self.scene.tolerances is None else {"tolerances": plain(self.scene.tolerances)}),
        }
        return write_basis(self.made, work, views, made.outcome, told, magnification=magnification)

    def _spread(self) -> NDArray[np.float64] | None:
        """How the light of each pixel is shared among the sources, where each has a tolerance of its own."""
        tolerances = self.scene.tolerances
        if tolerances is None or not tolerances.each_source_radiance:
            return None
        names = self.sources or shining(self.scene, self.traced.prepared, "tolerances.each_source_radiance")
        return share_spread([self.traced.view_of(name) for name in names])

    def _magnification(self, view: View) -> NDArray[np.float64] | None:
        """How much a wider opening blurs each pixel, where a lens has one that is not sure."""
        camera, tolerances = self.scene.camera, self.scene.tolerances
        if camera.lens is None or tolerances is None or not tolerances.aperture_diameter:
            return None
        return seen_magnifications(view)

    def _write_uncertainty(
        self, ray_error: float, spread: NDArray[np.float64] | None, magnification: NDArray[np.float64] | None
    ) -> tuple[dict[str, Any], list[str]]:
        """Standard deviation of the gray levels, where the scene states tolerances or noise."""
        camera, tolerances = self.scene.camera, self.scene.tolerances
        if tolerances is None and camera.sensor.linear is None:
            return {}, []
        exposure = ExposureImage(read_image(self.made / EXPOSURE)[0].astype(np.float64))
        found = uncertainty(
            exposure, camera, tolerances or Tolerances(), ray_error, spread, magnification=magnification
        )
        write_exr(self.made / SIGMA, found.sigma.astype(np.float32), channel="gray_sigma")
        return {"uncertainty": found.as_manifest()}, [SIGMA]

    def _write_frames(self) -> list[str]:
        """Frames with noise, of the exposure as its file holds it."""
        sensor, number = self.scene.camera.sensor, self.options.frames
        if not number:
            return []
        exposure = ExposureImage(read_image(self.made / EXPOSURE)[0].astype(np.float64))
        pattern = fixed_pattern(sensor)
        names = [frame_file(k) for k in range(number)]
        for k, name in enumerate(names):
            write_png(self.made / name, noisy_frame(exposure, sensor, pattern, self.options.seed, k).codes)
        return names

    def _write_truth(self) -> list[str]:
        depth, parts = central_maps(self.scene.camera, self.traced.identity_tracer())
        write_exr(self.made / DEPTH, depth, channel="depth", metadata={"radwrap:unit": "m"})
        write_png(self.made / PARTS, parts)
        write_manifest(
            self.made / TRUTH,
            {"schema_version": SCHEMA_VERSION, **geometry(self.scene, self.traced.prepared.parts)},
        )
        return [DEPTH, PARTS, TRUTH]

    def _description(self, made: Made) -> dict[str, Any]:
        options = self.options
        return {
            "schema_version": SCHEMA_VERSION,
            "scene_sha256": scene_sha256(self.scene, self.traced.prepared),
            "run_sha256": self.sha256,
            **made.description,
            **({"tolerance": options.tolerance, "max_error": options.max_error} if "plan" in made.description else {}),
            "seed": options.seed,
            "trust": options.trust,
            "versions": self.versions,
            "assumed": dict(sorted(self.scene.assumed.items())),
            "camera": plain(self.scene.camera),
            "scene": self.scene.document,
        }


def _lens_warnings(scene: Scene) -> tuple[str, ...]:
    return tuple(diffraction_warning(diffraction(scene))) if scene.camera.lens else ()


def _orders(asked: Bounces | Literal["auto"], left_out: Effect) -> Bounces:
    """How often light may go from surface to surface, once it is known what leaving that out would cost."""
    if asked == "auto":
        return "all" if left_out.needed else 0
    return asked


def _told(orders: Bounces, left_out: Effect, beyond: Effect | None) -> dict[str, Any]:
    """What the manifest says of light that goes from surface to surface."""
    if not orders:
        return {"left_out": {left_out.name: left_out.as_manifest()}}
    rest = {} if beyond is None else {beyond.name: beyond.as_manifest()}
    return {"left_out": rest, "bounces": {"orders": orders, "about_rms_gray": left_out.rms_gray}}


def _warnings_of(left_out: Effect, how: str) -> tuple[str, ...]:
    if not left_out.needed:
        return ()
    return (
        f"light that {how} is left out: it would change the image by about "
        f"{left_out.rms_gray:.2g} gray rms (at most {left_out.rms_gray_upper95:.2g})",
    )


def _range(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    return {"min": float(values.min()), "max": float(values.max()), "mean": float(values.mean())}
