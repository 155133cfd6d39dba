"""The same light on another exposure or another sensor's electronics: an image without a ray, and how far it is off.

Radiant exposure is proportional to exposure time, and an error of Eq. 5 to its own factor: K' (s H)^gamma is off by
(K'/K) s^gamma times what K H^gamma is off by, at each pixel. Clipping makes errors smaller, so that this holds where
the new image saturates earlier than the old one. Where it saturates later, pixels that were saturated before are not
bound by anything: rays were spent, and errors measured, on clipped gray levels.

A light basis keeps what its certificate needs in radiance, before Eq. 5: in another camera its errors are not scaled,
but measured anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import ExposureImage, GrayImage
from radwrap.imaging.output.run_manifest import MANIFEST, read_run_manifest
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.file.load import camera_with, with_camera
from radwrap.scene.instants import refuse_time
from radwrap.scene.scene import Scene

_SAME: Final = 1e-9  # of a level; rounding alone
# So many times the certified rms below saturation a pixel may be saturated in truth.
_MAY_SATURATE: Final = 3.0
_SHAPE: Final = ("rows", "columns", "pixel_width", "pixel_height", "window", "channel", "mosaic")
_ELECTRONIC: Final = ("exposure_time", "sensor")
_KEYS: Final = {"pose": "position"}  # of the scene, where it calls something else than the camera does
_BOUNDS: Final = (
    "rms_gray",
    "rms_gray_upper95",
    "p99_gray_upper95",
    "model_rms_gray",
    "discretisation_rms_gray",
    "bands_gray",
    "diffraction_gray",
    "motion_gray",
)


@dataclass(frozen=True, slots=True, eq=False)
class Developed:
    """What another camera makes of the same light.

    Attributes
    ----------
    scene : Scene
        With that camera.
    radiant_exposure : ExposureImage
        H [J m^-2].
    gray : GrayImage
        What the camera gives.
    certificate : Certificate
        How far the gray levels may be off; infinite where nothing is known of that.
    growth : float
        How many times as large a change of a gray level is, at most; infinite likewise.
    """

    scene: Scene
    radiant_exposure: ExposureImage
    gray: GrayImage
    certificate: Certificate
    growth: float


def in_other_camera(
    scene: Scene, exposure: ExposureImage, certificate: Certificate, changes: Mapping[str, Any]
) -> Developed:
    """Another exposure time, or other electronics of the sensor, on the same light.

    Parameters
    ----------
    scene : Scene
        That was rendered.
    exposure : ExposureImage
        Its radiant exposure [J m^-2].
    certificate : Certificate
        How far its gray levels may be off.
    changes : Mapping
        Key of the scene file, of the camera -> value as the file would hold it.

    Raises
    ------
    InputError
        If a value is wrong, or the change is one of what light the pixels get.
    """
    refuse_time(scene, "what is made without a ray")
    other = with_camera(scene, changes)
    old, new = scene.camera, other.camera
    check_same_light(old, new)
    times = _times(old, new)
    made = ExposureImage(exposure.values * times, exposure.provenance)
    gray = image_of_levels(gray_levels(made.values, new.sensor), new.sensor, made.provenance)
    growth = growth_of(old.sensor, new.sensor, times, exposure.values, certificate.rms_gray_upper95)
    return Developed(other, made, gray, scaled(certificate, growth), growth)


@dataclass(frozen=True, slots=True)
class SceneText:
    """A scene as its basis' run knows it: enough to read its camera again.

    Attributes
    ----------
    document : str
        As `Scene.document`.
    folder : Path
        Against which the camera's files are resolved, where it names any.
    spectral : bool
        Whether it tells spectra.
    origin : str
        For messages.
    """

    document: str
    folder: Path
    spectral: bool
    origin: str = "scene"

    @classmethod
    def of(cls, scene: Scene) -> SceneText:
        """Of a scene."""
        return cls(scene.document, scene.folder, scene.spectral is not None, scene.origin)


def scene_text_of(folder: Path, basis: Basis, scene_folder: Path | None = None) -> SceneText:
    """The scene of a basis, as the manifest of its run tells it.

    Parameters
    ----------
    folder : Path
        Of the basis.
    basis : Basis
        That was read from there.
    scene_folder : Path, optional
        Where files lie that its camera names; default the basis' own.

    Raises
    ------
    InputError
        If the manifest is of another run.
    """
    run = read_run_manifest(folder)
    if run.scene_sha256 != basis.scene_sha256:
        raise InputError("is of another run", where=str(folder / MANIFEST), remedy="make the basis again")
    return SceneText(run.scene, scene_folder or folder, run.bands is not None)


def basis_in_other_camera(basis: Basis, scene: SceneText, changes: Mapping[str, Any]) -> Basis:
    """A light basis as another exposure time, or other electronics of the sensor, would have it, without a ray.

    Parameters
    ----------
    basis : Basis
        See `read_basis`.
    scene : SceneText
        Of which it was made.
    changes : Mapping
        As of `in_other_camera`.

    Raises
    ------
    InputError
        As `in_other_camera`.
    """
    if not changes:
        return basis
    other = camera_with(scene.document, changes, origin=scene.origin, folder=scene.folder, spectral=scene.spectral)
    old, new = basis.camera, replace(other.camera, distortion=None)
    check_same_light(old, new)
    return replace(basis, camera=new, exposure_of_radiance=basis.exposure_of_radiance * _times(old, new))


def _times(old: Camera, new: Camera) -> float:
    """By how much the exposure grows."""
    if not old.exposure_time:
        raise InputError("is 0, which leaves nothing to scale", where="camera.exposure_time", remedy="render the scene")
    return new.exposure_time / old.exposure_time


def check_same_light(old: Camera, new: Camera) -> None:
    """See that pixels of another camera get the same light.

    Raises
    ------
    InputError
        If they do not.
    """
    shape = next((name for name in _SHAPE if getattr(old.sensor, name) != getattr(new.sensor, name)), None)
    if shape is not None:
        raise InputError(
            "changes which light a pixel gets", where=f"camera.sensor.{shape}", remedy="render that camera"
        )
    lengths = [sensor.linear and sensor.linear.wavelength for sensor in (old.sensor, new.sensor)]
    if old.diffraction is not None and lengths[0] != lengths[1]:
        raise InputError(
            "changes what the opening's waves do to the image",
            where="camera.sensor.wavelength",
            remedy='render that camera, or set `camera.diffraction = "off"`',
        )
    for one in fields(Camera):
        if one.name not in _ELECTRONIC and getattr(old, one.name) != getattr(new, one.name):
            where = f"camera.{_KEYS.get(one.name, one.name)}"
            raise InputError("changes which light a pixel gets", where=where, remedy="render that camera")


def growth_of(old: Sensor, new: Sensor, times: float, exposure: NDArray[np.float64], bound: float) -> float:
    """How many times as large an error of a gray level is, at most.

    Parameters
    ----------
    old, new : Sensor
        Their electronics may differ.
    times : float
        So many times as much light as before comes to each pixel.
    exposure : ndarray
        Radiant exposure before, of all pixels [J m^-2].
    bound : float
        Of the root mean square of its error [gray level].

    Returns
    -------
    float
        Infinite where that is not known: with another gamma, and where what was saturated is so no longer.
    """
    if new.gamma != old.gamma:
        return math.inf
    growth: float = new.gain / old.gain * times**new.gamma
    span, reached = old.saturation_gray - old.dark_gray, new.saturation_gray - new.dark_gray
    if reached > growth * span * (1 + _SAME):
        near = span - _MAY_SATURATE * bound
        if bool(np.any(gray_levels(exposure, old) - old.dark_gray >= near)):
            return math.inf
    return growth


def scaled(certificate: Certificate, growth: float) -> Certificate:
    """How far gray levels may be off whose errors are so many times as large; no bound where that is infinite."""
    found: dict[str, Any] = {}
    for name in _BOUNDS:
        value = getattr(certificate, name)
        if value is not None:
            found[name] = growth * value if math.isfinite(growth) else math.inf
    return replace(certificate, **found)
