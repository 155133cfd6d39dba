"""What a render gives: images, how far they are off, and what follows of them without a ray."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage, png_bytes, preview_codes, read_image
from radwrap.imaging.forecast.effects import Effect, warnings_of_left_out
from radwrap.imaging.other_camera import Developed, in_other_camera
from radwrap.imaging.output.assumed_values import assumed_effects, warnings_of_assumed
from radwrap.imaging.output.image_files import read_exposure, read_gray_levels
from radwrap.imaging.output.run_manifest import MANIFEST, Extent, RunManifest, components_used, run_manifest_of
from radwrap.imaging.output.sigma_file import SIGMA
from radwrap.imaging.output.truth_files import TRUTH, read_truth
from radwrap.imaging.page.one_file import Page, one_file
from radwrap.imaging.relight.basis import BASIS
from radwrap.imaging.relight.relit import read_basis
from radwrap.imaging.response.noise import fixed_pattern, linear_of, noisy_frame
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.uncertainty import uncertainty
from radwrap.manifest import plain, read_manifest
from radwrap.scene.instants import refuse_time
from radwrap.scene.look.faces import face_towards
from radwrap.scene.scene import Scene
from radwrap.scene.tolerances import Tolerances

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Rendered:
    """What a run made; a notebook shows its picture.

    Attributes
    ----------
    radiant_exposure : ExposureImage
        H [J m^-2].
    gray : GrayImage
        What the camera gives.
    manifest : Mapping
        What was made, of what, with what, as manifest.json holds it.
    run : RunManifest
        The same as values with types.
    truth : Mapping, optional
        With ``truth=True``: ``depth`` along the axis, 0 where nothing is seen,
        float32, shape (rows, columns) [m]; ``mask``, the number of the part
        that each pixel's centre sees, uint16, of that shape; and what
        truth.json holds: ``parts`` (name -> number), ``targets`` (poses, dots,
        edges), ``pixel_convention``.
    scene : Scene
        What was rendered.
    stated_sigma : ndarray, shape (rows, columns), optional
        What gray_sigma.exr holds, where the scene states tolerances.
    basis_folder : Path, optional
        Where its light basis lies, if it was made with one.

    Examples
    --------
    >>> import radwrap
    >>> result = radwrap.render(radwrap.load_scene("scene.toml"), tolerance=8)
    >>> result.gray.values.shape
    (165, 192)
    >>> brighter = result.with_exposure("400 ms")
    >>> bool(brighter.gray.values.mean() > result.gray.values.mean())
    True
    """

    radiant_exposure: ExposureImage
    gray: GrayImage
    manifest: Mapping[str, Any]
    run: RunManifest
    truth: Mapping[str, Any] | None
    scene: Scene
    stated_sigma: Array | None = None
    basis_folder: Path | None = None

    def __repr__(self) -> str:
        rows, columns = self.gray.values.shape
        bound = self.error.rms_gray_upper95
        off = f"off by less than {bound:.2g} gray rms (95 %)" if math.isfinite(bound) else "no bound of its error"
        if self.run.missing:
            off += f", which leaves out (gray rms): {self.run.missing}"
        return (
            f"<Rendered: {columns} x {rows} pixels, gray {self.gray.values.min():g} to {self.gray.values.max():g}, "
            f"mean {self.gray.values.mean():.4g}; {off}; {self.run.method}, {self.run.rays:.3g} rays>"
        )

    def _repr_png_(self) -> bytes:
        return png_bytes(preview_codes(self.gray))

    @property
    def error(self) -> Certificate:
        """How far the gray levels may be off before rounding; infinite where nothing bounds that."""
        return self.run.error

    @property
    def left_out(self) -> Mapping[str, Effect]:
        """Effects that the image and its error lack, by name, with what each would change [gray level].

        Of an image that was made from another one, that one's, as far as the gray levels tell how they grow.
        """
        return self.run.left_out

    @property
    def met(self) -> bool:
        """Whether the image keeps the tolerance that it was rendered to; what has none keeps it."""
        if self.run.files or self.run.tolerance is None:
            return self.run.met
        quantile, largest = self.error.p99_gray_upper95, self.run.max_error
        return self.error.rms_gray_upper95 <= self.run.tolerance and (
            largest is None or (quantile is not None and quantile <= largest)
        )

    @property
    def electrons(self) -> Array:
        """Mean electrons in each pixel, dark signal included, at most the full well, shape (rows, columns).

        Raises
        ------
        InputError
            If the sensor is not described as a linear camera.
        """
        sensor = self.scene.camera.sensor
        linear = linear_of(sensor)
        light = self.radiant_exposure.values * linear.electrons_of_exposure(sensor.pixel_area)
        return np.minimum(light + linear.dark_signal, linear.full_well)

    @property
    def sigma(self) -> Array:
        """Standard deviation of what one captured frame may be off, before rounding [gray level].

        As gray_sigma.exr holds it; of rays alone, where the scene neither states tolerances nor has a linear camera.

        Raises
        ------
        InputError
            If the image has no bound of its error, or it was made from another one of a scene with tolerances.
        """
        if self.stated_sigma is not None:
            return self.stated_sigma
        if self.scene.tolerances is not None:
            raise InputError("is known of rendered images only, as the scene states tolerances", where="sigma")
        if self.scene.camera.sensor.mosaic is not None:
            raise InputError(
                "is known of rendered mosaics with a linear sensor only", where="sigma", remedy="look at one colour"
            )
        if not math.isfinite(self.error.rms_gray):
            raise InputError("has no bound: pixels were saturated when it was rendered", where="sigma")
        return uncertainty(self.radiant_exposure, self.scene.camera, Tolerances(), self.error.rms_gray).sigma

    def frames(self, number: int, seed: int | None = None) -> list[GrayImage]:
        """Frames as a linear camera would send them, with noise.

        Parameters
        ----------
        number : int
            How many.
        seed : int, optional
            Decides their noise; default that of the render. The specimen is the scene's `device_seed`.

        Raises
        ------
        InputError
            If the sensor is not described as a linear camera.
        """
        sensor, seed = self.scene.camera.sensor, self.run.seed if seed is None else seed
        pattern = fixed_pattern(sensor)
        return [noisy_frame(self.radiant_exposure, sensor, pattern, seed, frame) for frame in range(number)]

    def with_exposure(self, exposure_time: str | float) -> Rendered:
        """The image of another exposure time, without a ray.

        Parameters
        ----------
        exposure_time : str or float
            As the scene file would hold it, "64 ms", or a number [s].

        Raises
        ------
        InputError
            If it is no time.
        """
        told = exposure_time if isinstance(exposure_time, str) else f"{float(exposure_time)!r} s"
        return self._in_other_camera({"camera.exposure_time": told})

    def with_sensor(self, **values: Any) -> Rendered:
        """The image of a sensor with other electronics, without a ray.

        Parameters
        ----------
        **values
            Keys of ``[camera.sensor]`` as the scene file would hold them, such as ``system_gain="0.2 DN/e"``.

        Raises
        ------
        InputError
            If a value is wrong, or the sensor's pixels are others: those get other light, and need a render.
        """
        return self._in_other_camera({f"camera.sensor.{name}": value for name, value in values.items()})

    def page(self) -> Page:
        """A page with knobs for light, exposure and sensor, in one file: a notebook shows it, `Page.save` writes it.

        Raises
        ------
        InputError
            If it was rendered without its light basis, or that is damaged.
        """
        refuse_time(self.scene, "a page")
        if self.basis_folder is None:
            raise InputError(
                "needs a light basis", where="page", remedy="render the scene into a folder with `basis=True`"
            )
        return one_file(self.scene, read_basis(self.basis_folder), self.run)

    def mm_per_px(self, target: str) -> tuple[float, float]:
        """Width and height of a pixel in the object [mm], where the camera's axis would meet a target's face squarely.

        Parameters
        ----------
        target : str
            Name of a target with a flat face; that which it turns to the camera counts, at its own origin.

        Raises
        ------
        InputError
            If there is no such target, or no such face.
        """
        found = next((one for one in self.scene.targets if one.name == target), None)
        if found is None:
            known = ", ".join(one.name for one in self.scene.targets)
            raise InputError(f'no target "{target}"', where="mm_per_px", remedy=f"there are {known}")
        camera = self.scene.camera
        depth = face_towards(camera, found).depth(camera)
        return depth * camera.pitch[0] * 1e3, depth * camera.pitch[1] * 1e3

    def _in_other_camera(self, changes: Mapping[str, Any]) -> Rendered:
        made = in_other_camera(self.scene, self.radiant_exposure, self.error, changes)
        run = _run_of(self.run, made)
        told = {key: value for key, value in plain(run, named=False).items() if key not in ("files", "timing")}
        told["error"] = {key: _finite(value) for key, value in told["error"].items()}
        manifest = {**told, "made_from": self.run.run_sha256}
        return Rendered(made.radiant_exposure, made.gray, manifest, run, self.truth, made.scene)


def load_result(scene: Scene, out: Path) -> Rendered:
    """Read back what a run left in its folder."""
    manifest = read_manifest(out / MANIFEST)
    run = run_manifest_of(manifest, str(out / MANIFEST))
    # Else it follows from the image, but for a mosaic, whose neighbours are of different colours.
    stated = SIGMA in run.files and (scene.tolerances is not None or run.mosaic is not None)
    return Rendered(
        radiant_exposure=read_exposure(out, manifest),
        gray=read_gray_levels(out, scene.camera.sensor, manifest),
        manifest=manifest,
        run=run,
        truth=read_truth(out) if TRUTH in run.files else None,
        scene=scene,
        stated_sigma=read_image(out / SIGMA)[0].astype(np.float64) if stated else None,
        basis_folder=out if BASIS in run.files else None,
    )


def _finite(value: Any) -> Any:
    """JSON knows no infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _grown(run: RunManifest, growth: float) -> tuple[dict[str, Effect], tuple[str, ...]]:
    """What is left out of a brighter image and what is said of it; nothing where its gray levels have no bound."""
    stale = {line for effect in run.left_out.values() for line in warnings_of_left_out(effect)}
    warnings = tuple(line for line in run.warnings if line not in stale)
    if not math.isfinite(growth):
        return {}, warnings
    left_out = {name: effect.grown(growth, run.tolerance) for name, effect in run.left_out.items()}
    return left_out, (*warnings, *(line for effect in left_out.values() for line in warnings_of_left_out(effect)))


def _run_of(run: RunManifest, made: Developed) -> RunManifest:
    """What a manifest says of an image that was made from another one: it has no files."""
    sensor = made.scene.camera.sensor
    levels = gray_levels(made.radiant_exposure.values, sensor)
    left_out, warnings = _grown(run, made.growth)
    stale = set(warnings_of_assumed(run.assumed_effects or ()))
    effects = assumed_effects(made.scene, made.radiant_exposure.values)
    return replace(
        run,
        left_out=left_out,
        warnings=(*(line for line in warnings if line not in stale), *warnings_of_assumed(effects)),
        components=components_used(made.scene),
        assumed_effects=effects or None,
        camera=plain(made.scene.camera),
        scene=made.scene.document,
        assumed=dict(sorted(made.scene.assumed.items())),
        radiant_exposure=Extent.of(made.radiant_exposure.values),
        gray=Extent.of(made.gray.values),
        saturated_fraction=float(np.mean(levels >= sensor.saturation_gray)),
        dark_fraction=float(np.mean(levels < sensor.dark_gray + 0.5)),
        error=made.certificate,
        uncertainty=None,
        mosaic=None,  # it tells the errors of that image's colours
        files={},
    )
