"""The main job: a scene becomes the gray image its camera would give.

A run owns its folder. Finished sub-viewpoints stay in it until the images are
whole, so that a killed run goes on; the manifest appears last, and only when
every file that it names is whole.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from radwrap.errors import InputError
from radwrap.files import TEMPORARY_SUFFIX, disk_failure, make_folder, sha256_of, sole_owner
from radwrap.images import ExposureImage, GrayImage, png_bytes, read_image, write_exr, write_png
from radwrap.imaging.aperture import Layout, Viewpoints, central_viewpoint, sub_viewpoints
from radwrap.imaging.cost import Cost, check_size, estimate
from radwrap.imaging.exposure import radiant_exposure
from radwrap.imaging.quality import error_of_pinhole, error_of_viewpoints
from radwrap.imaging.sensor import gray_image, gray_levels
from radwrap.imaging.truth import central_maps, geometry
from radwrap.imaging.view import PixelPlan, PixelSampling, ray_blocks, traced
from radwrap.imaging.viewpoints import Merged, ViewpointPlan, merge, missing_viewpoints, trace_viewpoints
from radwrap.manifest import SCHEMA_VERSION, plain, read_manifest, sha256_of_value, versions, write_manifest
from radwrap.process import Limits, Programs, available_cores, children_cpu_time
from radwrap.progress import Progress
from radwrap.scene.checks import warnings_of
from radwrap.scene.scene import Scene
from radwrap.tracers.installation import find_radiance, version
from radwrap.tracers.radiance import (
    NO_LIGHT,
    PreparedScene,
    RadianceOptions,
    RadianceTracer,
    build,
    prepare,
)
from radwrap.tracers.radiance_text import RadianceScene

Method = Literal["pinhole", "viewpoints"]
METHODS: Final[tuple[Method, ...]] = ("pinhole", "viewpoints")

MANIFEST: Final = "manifest.json"
EXPOSURE: Final = "radiant_exposure.exr"
GRAY: Final = "gray.png"
UNROUNDED: Final = "gray.exr"
DEPTH: Final = "depth.exr"
PARTS: Final = "mask.png"
TRUTH: Final = "truth.json"
_OPTIONAL: Final = (UNROUNDED, DEPTH, PARTS, TRUTH)
_VIEWPOINTS: Final = "viewpoints"
_WORK: Final = ".work"
_TIMED_PIXELS: Final = 20_000


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """How a scene is rendered.

    Attributes
    ----------
    method : str, optional
        "pinhole" (infinitesimal) or "viewpoints" (the paper's finite pinhole);
        default "viewpoints" where the opening is finite.
    viewpoints : int
        Number of sub-viewpoints.
    layout : str
        How they lie, see `sub_viewpoints`.
    pixel_samples : int
        k; k x k rays a pixel for each sub-viewpoint.
    pixel_sampling : str
        "centre" of each stratum, or seeded "jitter".
    seed : int
        Seed of all that is drawn.
    workers : int, optional
        Tracer processes at a time; default one a core.
    keep_viewpoints : bool
        Keep the sub-viewpoints' files.
    truth : bool
        Write depth, parts and true positions too.
    trust : bool
        Let included Radiance files run commands and name any file.
    radiance : str, optional
        Folder of a Radiance other than the wheel's.
    max_pixels : int
        Largest sensor.
    tracer_timeout : float
        Longest silence of a tracer [s].
    progress : bool
        Show progress on stderr.
    """

    method: Method | None = None
    viewpoints: int = 37
    layout: Layout = "rings"
    pixel_samples: int = 1
    pixel_sampling: PixelSampling = "centre"
    seed: int = 0
    workers: int | None = None
    keep_viewpoints: bool = False
    truth: bool = False
    trust: bool = False
    radiance: str | None = None
    max_pixels: int = 64_000_000
    tracer_timeout: float = 600.0
    progress: bool = False

    def __post_init__(self) -> None:
        limits = {
            "viewpoints": (self.viewpoints, 1, 100_000),
            "pixel-samples": (self.pixel_samples, 1, 100),
            "workers": (1 if self.workers is None else self.workers, 1, 4096),
            "seed": (self.seed, 0, 2**63 - 1),
            "max-pixels": (self.max_pixels, 1, 10**12),
            "tracer-timeout": (self.tracer_timeout, 1e-3, 1e9),
        }
        for name, (value, low, high) in limits.items():
            if not low <= value <= high:
                raise InputError(f"must lie between {low:g} and {high:g}, not {value}", where=f"--{name}")


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
    check_size(scene, options.max_pixels, rays_per_pixel(scene, options), options.workers or available_cores())
    if out is None:
        with tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
            return _render_into(scene, Path(folder), options)
    make_folder(Path(out))
    return _render_into(scene, Path(out), options)


def method_of(scene: Scene, options: RenderOptions) -> Method:
    """The method that is asked for, or fits the opening."""
    return options.method or ("pinhole" if scene.camera.aperture.is_infinitesimal else "viewpoints")


def _viewpoints(scene: Scene, options: RenderOptions) -> Viewpoints:
    if method_of(scene, options) == "pinhole":
        return central_viewpoint(scene.camera.aperture)
    return sub_viewpoints(scene.camera.aperture, options.viewpoints, options.layout)


def rays_per_pixel(scene: Scene, options: RenderOptions) -> int:
    """Rays that each pixel gets, over all sub-viewpoints."""
    number = 1 if method_of(scene, options) == "pinhole" else options.viewpoints
    return number * options.pixel_samples**2


def forecast(scene: Scene, options: RenderOptions) -> Cost:
    """What a run would cost; the time of a ray is measured on a few pixels of the scene.

    Raises
    ------
    InputError, EnvironmentFailure
        As `render`.
    """
    workers = options.workers or available_cores()
    check_size(scene, options.max_pixels, rays_per_pixel(scene, options), workers)
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder, Programs() as programs:
        run = _Run(scene, Path(folder), Path(folder), options, programs)
        return estimate(scene, rays_per_pixel(scene, options), workers, run.seconds_per_ray)


def _render_into(scene: Scene, out: Path, options: RenderOptions) -> Rendered:
    start, cpu = time.monotonic(), children_cpu_time()
    with sole_owner(out), Programs() as programs:
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
        self.work = work
        self.options = options
        self.programs = programs
        limits = Limits(silence=options.tracer_timeout)
        self.radiance = RadianceOptions(find_radiance(options.radiance), options.trust, limits)
        self.prepared: PreparedScene = prepare(scene, self.radiance, programs, work)
        self.versions = {**versions(), "radiance": version(self.radiance.installation, programs)}
        self.plan = ViewpointPlan(
            camera=scene.camera,
            viewpoints=_viewpoints(scene, options),
            pixel_plan=PixelPlan(options.pixel_samples, options.pixel_sampling, options.seed),
            scene_sha256=sha256_of_value(
                {
                    "text": self.prepared.scene.text,
                    "files": {name: content.hex() for name, content in self.prepared.scene.files.items()},
                    "radiance": self.versions["radiance"],
                }
            ),
        )
        self.sha256 = sha256_of_value(
            {
                "plan": self.plan.sha256(),
                "camera": scene.camera,
                "method": method_of(scene, options),
                "layout": options.layout,
                "truth": options.truth,
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
        if self.options.keep_viewpoints and missing_viewpoints(self.plan, self.folder):
            return False
        try:
            manifest = read_manifest(self.out / MANIFEST)
            files = manifest["files"]
            return manifest["run_sha256"] == self.sha256 and all(
                sha256_of(self.out / name) == known for name, known in files.items()
            )
        except (InputError, OSError, KeyError):
            return False

    def carry_out(self, start: float, cpu: float) -> None:
        """Trace, merge, expose, and write; the manifest last."""
        make_folder(self.folder)
        tracer = self._tracer(self.prepared.scene, self.work / "scene")
        progress = Progress("tracing", self.plan.rays, shown=self.options.progress)
        try:
            reused = trace_viewpoints(
                self.plan,
                tracer,
                self.folder,
                programs=self.programs,
                workers=self.options.workers or available_cores(),
                progress=progress,
            )
        finally:
            progress.close()
        merged = merge(self.plan, self.folder)
        if method_of(self.scene, self.options) == "pinhole":
            error = error_of_pinhole(self.plan, tracer, merged)
        else:
            error = error_of_viewpoints(self.plan, merged)
        # From here on the old manifest no longer fits the files, and what only an older run wrote fits nothing.
        for name in (MANIFEST, *_OPTIONAL):
            (self.out / name).unlink(missing_ok=True)
        summary, files = self._write_images(merged)
        if self.options.truth:
            files += self._write_truth()
        timing = {
            "wall_s": time.monotonic() - start,
            "tracer_cpu_s": children_cpu_time() - cpu,
            "workers": self.options.workers or available_cores(),
            "reused_viewpoints": reused,
        }
        manifest = {
            **self._description(),
            **summary,
            "error": error,
            "files": {name: sha256_of(self.out / name) for name in files},
            "timing": timing,
        }
        write_manifest(self.out / MANIFEST, manifest)

    def seconds_per_ray(self) -> float:
        """Time a ray takes on one core [s], from pixels spread over the sensor."""
        tracer = self._tracer(self.prepared.scene, self.work / "scene")
        number = self.scene.camera.sensor.pixels
        pixels = np.unique(np.linspace(0, number - 1, min(_TIMED_PIXELS, number)).astype(np.intp))
        start = time.monotonic()
        for _ in traced(tracer.trace, ray_blocks(self.scene.camera, (0.0, 0.0), PixelPlan(), 0, pixels)):
            pass
        return (time.monotonic() - start) / len(pixels)

    def clean_up(self) -> None:
        """Remove the sub-viewpoints' files, unless they are wanted."""
        if not self.options.keep_viewpoints:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _tracer(self, scene: RadianceScene, folder: Path, harmless: tuple[str, ...] = ()) -> RadianceTracer:
        make_folder(folder)
        # A trusted file may name files beside itself, and Radiance looks for them where it runs.
        search = tuple({(self.scene.folder / target.file).parent.absolute() for target in self.scene.included})
        search = tuple(sorted(search)) if self.options.trust else ()
        build(scene.text, scene.files, folder, self.radiance, self.programs, search=search, harmless=harmless)
        channel = self.scene.camera.sensor.channel
        return RadianceTracer(self.radiance, self.programs, folder, scene, search, channel, harmless)

    def _write_images(self, merged: Merged) -> tuple[dict[str, Any], list[str]]:
        camera = self.scene.camera
        sensor = camera.sensor
        exact = radiant_exposure(merged.mean, camera, self.plan.viewpoints.area, {})
        # The gray image is Eq. 5 of the exposure as the file holds it, so that anybody can compute it again.
        stored = exact.values.astype(np.float32)
        exposure = ExposureImage(stored.astype(np.float64))
        gray = gray_image(exposure, sensor)
        write_exr(self.out / EXPOSURE, stored, channel="radiant_exposure", metadata={"radwrap:unit": "J m^-2"})
        write_png(self.out / GRAY, gray.codes)
        files = [EXPOSURE, GRAY]
        if not sensor.rounding:
            write_exr(self.out / UNROUNDED, gray.values.astype(np.float32), channel="gray")
            files.append(UNROUNDED)
        levels = gray_levels(exposure.values, sensor)
        summary = {
            "radiant_exposure": _range(exposure.values),
            "gray": _range(gray.values),
            "saturated_fraction": float(np.mean(levels >= sensor.saturation_gray)),
            "dark_fraction": float(np.mean(levels < sensor.dark_gray + 0.5)),
        }
        return summary, files

    def _write_truth(self) -> list[str]:
        identity = replace(
            self.prepared.scene, text=self.prepared.identity, scales=replace(self.prepared.scene.scales, radiance=1.0)
        )
        tracer = self._tracer(identity, self.work / "identity", (NO_LIGHT,))
        depth, parts = central_maps(self.scene.camera, replace(tracer, channel="equal"))
        write_exr(self.out / DEPTH, depth, channel="depth", metadata={"radwrap:unit": "m"})
        write_png(self.out / PARTS, parts)
        write_manifest(
            self.out / TRUTH,
            {"schema_version": SCHEMA_VERSION, **geometry(self.scene, self.prepared.parts)},
        )
        return [DEPTH, PARTS, TRUTH]

    def _description(self) -> dict[str, Any]:
        options = self.options
        return {
            "schema_version": SCHEMA_VERSION,
            "scene_sha256": scene_sha256(self.scene, self.prepared),
            "run_sha256": self.sha256,
            "method": method_of(self.scene, options),
            "layout": options.layout if len(self.plan.viewpoints) > 1 else None,
            "viewpoints": len(self.plan.viewpoints),
            "pixel_samples": options.pixel_samples,
            "pixel_sampling": options.pixel_sampling,
            "rays_per_pixel": rays_per_pixel(self.scene, options),
            "rays": self.plan.rays,
            "seed": options.seed,
            "trust": options.trust,
            "versions": self.versions,
            "assumed": dict(sorted(self.scene.assumed.items())),
            "warnings": list(warnings_of(self.scene)),
            "camera": plain(self.scene.camera),
            "scene": self.scene.document,
        }


def scene_sha256(scene: Scene, prepared: PreparedScene) -> str:
    """Hash of a scene: its values in SI, and the files that it includes."""
    return sha256_of_value(
        {
            "camera": scene.camera,
            "sources": scene.sources,
            "materials": scene.materials,
            "targets": scene.targets,
            "files": {name: content.hex() for name, content in prepared.scene.files.items()},
            "included": prepared.identity if scene.included else "",
            "text": prepared.scene.text if scene.included else "",
        }
    )


def _range(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    return {"min": float(values.min()), "max": float(values.max()), "mean": float(values.mean())}
