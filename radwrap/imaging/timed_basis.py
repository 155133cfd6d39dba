"""Any levels of the sources of a scene that changes in the course of its exposure, without a ray.

At each instant light is linear in the levels, and so is its sum over time. Where nothing moves, one light basis does,
whose rows are weighed; else each instant has a basis of its own, and a sum of relit instants has its error as the
render has it, measured in that very light.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage
from radwrap.imaging.other_camera import SceneText, basis_in_other_camera, check_same_light
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.relight.basis import read_sealed, sealed
from radwrap.imaging.relight.relit import Basis, Relit, read_basis, relit
from radwrap.imaging.relight.row_shares import row_shares, weighed
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.imaging.run_files import TIMED_BASIS, LightFile, TimedBasisFile
from radwrap.imaging.summed_instants import AtInstant, certificate_of_sum, summed
from radwrap.imaging.time_steps import Light, Steps
from radwrap.imaging.tolerance.uncertainty import Uncertainty, uncertainty
from radwrap.manifest import SCHEMA_VERSION, plain, write_manifest
from radwrap.scene.camera import Camera
from radwrap.scene.file.load import camera_with
from radwrap.scene.tolerances import Tolerances
from radwrap.written import read_back

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MovingBasis:
    """The light bases of all instants.

    Attributes
    ----------
    folder : Path
        Of the run.
    camera : Camera
        Whose gray levels count, but for its distortion, which the images hold.
    lights : tuple of LightFile
        Sources that shine at the same times, and their instants.
    sources, dark : tuple of str
        Names of those that any instant sees, and of those that none does.
    tolerance : float
        That the image in the light of all sources was made to [gray level].
    scene_sha256 : str
        Of the scene.
    """

    folder: Path
    camera: Camera
    lights: tuple[LightFile, ...]
    sources: tuple[str, ...]
    dark: tuple[str, ...]
    tolerance: float
    scene_sha256: str
    max_error: None = None


@dataclass(frozen=True, slots=True, eq=False)
class MovingRelit:
    """An image of instants in its own light, how far its pixels scatter, and whether it keeps the basis' tolerance."""

    image: Relit
    uncertainty: Uncertainty
    keeps: bool


def write_timed_basis(out: Path, told: TimedBasisFile) -> str:
    """Write what tells of the bases in a folder; returns the file's name."""
    write_manifest(out / TIMED_BASIS, sealed({"schema_version": SCHEMA_VERSION, **plain(told, named=False)}))
    return TIMED_BASIS


def read_timed_basis(
    folder: Path, run: RunManifest, changes: Mapping[str, Any], scene_folder: Path | None = None
) -> Basis | MovingBasis:
    """Read what a render with a basis left of a scene that changes in time, in another camera where keys are changed.

    Parameters
    ----------
    folder : Path
        Of the run.
    run : RunManifest
        Its manifest.
    changes : Mapping
        Key of the scene file, of the camera -> value as the file would hold it.
    scene_folder : Path, optional
        Where files lie that its camera names; default that of the run.

    Raises
    ------
    InputError
        If there is no whole basis, it is of another run, a value is wrong, or a change needs rays.
    """
    path = folder / TIMED_BASIS
    if not path.is_file():
        raise InputError("holds no light basis", where=str(folder), remedy="render with `basis`")
    told: TimedBasisFile = read_back(read_sealed(path), TimedBasisFile, str(path))
    if told.scene_sha256 != run.scene_sha256:
        raise InputError("is of another run", where=str(path), remedy="make the basis again")
    text = SceneText(run.scene, scene_folder or folder, run.bands is not None)
    if told.rows is None:
        return _moving(folder, told, text, changes)
    basis = basis_in_other_camera(replace(read_basis(folder / told.rows.basis), camera=told.camera), text, changes)
    return replace(weighed(basis, row_shares(told.rows, basis.camera)), scene_sha256=told.scene_sha256)


def _moving(folder: Path, told: TimedBasisFile, text: SceneText, changes: Mapping[str, Any]) -> MovingBasis:
    camera = told.camera
    if changes:
        made = camera_with(text.document, changes, origin=text.origin, folder=text.folder, spectral=text.spectral)
        camera = replace(made.camera, distortion=None)
        check_same_light(told.camera, camera)
        _check_same_instants(told.camera, camera)
    firsts = [read_basis(folder / light.instants[0].basis) for light in told.lights]
    sources = tuple(dict.fromkeys(name for basis in firsts for name in basis.sources))
    dark = tuple(dict.fromkeys(name for basis in firsts for name in basis.dark if name not in sources))
    return MovingBasis(folder, camera, told.lights, sources, dark, told.tolerance, told.scene_sha256)


def _check_same_instants(old: Camera, new: Camera) -> None:
    before, after = old.sensor.shutter, new.sensor.shutter
    for key, same in (
        ("camera.exposure_time", old.exposure_time == new.exposure_time),
        ("camera.sensor.line_time", before is None or after is None or before.line_time == after.line_time),
        ("camera.sensor.readout", before is None or after is None or before.readout == after.readout),
        ("camera.sensor.shutter", before == after),
    ):
        if not same:
            raise InputError(
                "changes which instants count, and the targets move", where=key, remedy="render that camera"
            )


def moving_relit(basis: MovingBasis, factors: Array) -> Iterator[MovingRelit]:
    """Images for any levels of the sources, shape (images, sources); errors as `relit`."""
    sensor, steps = basis.camera.sensor, [_steps(light) for light in basis.lights]
    for levels in factors:
        instants = _RelitInstants(basis, dict(zip(basis.sources, levels.tolist(), strict=True)))
        made = summed(steps, instants.at, sensor, lambda: None)
        certificate = certificate_of_sum(made, instants.at, sensor)
        # As a file holds it.
        exposure = ExposureImage(made.exposure.astype(np.float32).astype(np.float64), {"scene": basis.scene_sha256})
        gray = gray_levels(exposure.values, sensor)
        saturated = float(np.mean(gray >= sensor.saturation_gray))
        image = Relit(exposure, image_of_levels(gray, sensor, exposure.provenance), certificate, saturated)
        known = uncertainty(exposure, basis.camera, Tolerances(), certificate.rms_gray)
        yield MovingRelit(image, known, certificate.rms_gray_upper95 <= basis.tolerance)


def _steps(light: LightFile) -> Steps:
    return Steps(
        Light(light.sources, light.strobe, light.first, light.last),
        np.array(light.times),
        np.array(light.weights),
        np.array(light.without_every_second),
    )


@dataclass(slots=True, eq=False)
class _RelitInstants:
    """Images at instants in other levels of the sources.

    Attributes
    ----------
    basis : MovingBasis
        Of which they are made.
    levels : Mapping
        Source -> factor on its radiance.
    made : dict
        What was made already: sources of the light and number of the instant -> its image.
    """

    basis: MovingBasis
    levels: Mapping[str, float]
    made: dict[tuple[tuple[str, ...], int], AtInstant] = field(default_factory=dict)

    def at(self, steps: Steps, number: int) -> AtInstant:
        """The image at an instant."""
        key = steps.light.sources, number
        if key not in self.made:
            light = next(light for light in self.basis.lights if light.sources == steps.light.sources)
            self.made[key] = self._relit(light, number)
        return self.made[key]

    def _relit(self, light: LightFile, number: int) -> AtInstant:
        told = next(instant for instant in light.instants if instant.number == number)
        basis = read_basis(self.basis.folder / told.basis)
        factors = np.array([[self.levels[name] for name in basis.sources]])
        # Brighter light must not saturate the levels by which errors are told.
        sensor = replace(basis.sensor, gain=basis.sensor.gain / max(1.0, float(factors.max())))
        image = next(relit(replace(basis, camera=replace(basis.camera, sensor=sensor)), factors))
        return AtInstant(image.radiant_exposure.values, image.certificate, sensor.gain, told.first)
