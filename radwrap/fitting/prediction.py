"""Gray levels for any values of the free keys, from one light basis and without a ray more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.free_keys import FreeScene
from radwrap.imaging.other_camera import check_same_light
from radwrap.imaging.relight.relit import Basis, Relighter
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.scene.camera import Sensor
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
# Of a wide source its pieces are laid out anew with its level: they are the same light.
_LIGHT: Final = ("radiance", "patches", "reached", "step", "is_outline")
_STEP: Final = 1e-4  # of a key's scale: levels are linear in it, and the sensor's keys smooth
_TRIED: Final = 1e-3  # of a key's scale, to see what hangs on it


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """What is predicted for some values.

    Attributes
    ----------
    scene : Scene
        With these values.
    factors : ndarray, shape (sources,)
        On the radiance of each source of the basis.
    exposure : ndarray, shape (rows, columns)
        H [J m^-2].
    unclipped : ndarray, shape (rows, columns)
        Gray levels without saturation and rounding.
    """

    scene: Scene
    factors: Array
    exposure: Array
    unclipped: Array

    @property
    def sensor(self) -> Sensor:
        """That of the scene."""
        return self.scene.camera.sensor


class Prediction:
    """What a scene with free keys comes to.

    Parameters
    ----------
    free : FreeScene
        Whose keys are all ones that need no ray: levels, exposure time and the sensor's electronics.
    basis : Basis
        Of the scene where the fit begins.
    """

    def __init__(self, free: FreeScene, basis: Basis) -> None:
        self._free, self._basis = free, basis
        self._images = basis.images.astype(np.float64).mean(axis=1)
        self._radiances = radiances(free.scene)

    @property
    def basis(self) -> Basis:
        """Of which gray levels are made."""
        return self._basis

    def at(self, values: Sequence[float] | Array) -> Predicted:
        """Gray levels for some values; InputError where the scene does not take them."""
        scene = self._free.at([float(value) for value in values])
        told = radiances(scene)
        factors = np.array([told[name] / self._radiances[name] for name in self._basis.sources])
        exposure, unclipped = gray_of(scene, factors, self._images)
        return Predicted(scene, factors, exposure, unclipped)

    def slopes(self, values: Array) -> Array:
        """Change of the unclipped gray levels with each key's scale, shape (keys, rows, columns)."""
        found = []
        for number, key in enumerate(self._free.keys):
            step = _STEP * key.scale
            ends = []
            for sign in (1.0, -1.0):
                moved = np.array(values, dtype=np.float64)
                moved[number] = min(max(moved[number] + sign * step, key.low), key.high)
                ends.append((moved[number], self.at(moved).unclipped))
            found.append((ends[0][1] - ends[1][1]) / ((ends[0][0] - ends[1][0]) / key.scale))
        return np.stack(found)

    def replicates(self, predicted: Predicted, other: Basis | None = None) -> Array:
        """The independent images whose mean a prediction is [gray level], shape (replicates, rows, columns)."""
        basis = other or self._basis
        if basis.sources != self._basis.sources:
            raise InputError("has other sources", where="basis")
        count = basis.images.shape[1]
        made = [
            gray_of(predicted.scene, predicted.factors, basis.images[:, number].astype(np.float64))[1]
            for number in range(count)
        ]
        return np.stack(made)

    def certificate(self, predicted: Predicted) -> Certificate:
        """How far its gray levels may be off, measured anew in this light and camera."""
        camera = replace(predicted.scene.camera, distortion=None)
        basis = replace(self._basis, camera=camera, exposure_of_radiance=exposure_of_radiance(camera))
        return Relighter(basis).image(predicted.factors).certificate


def gray_of(scene: Scene, factors: Array, images: Array) -> tuple[Array, Array]:
    """Radiant exposure and unclipped gray levels of sources' images, shape (sources, rows, columns) [W m^-2 sr^-1]."""
    mean = np.maximum(np.tensordot(factors, images, axes=1), 0.0)
    exposure = mean * exposure_of_radiance(scene.camera)
    return exposure, unclipped_gray(exposure, scene.camera.sensor)


def radiances(scene: Scene) -> dict[str, float]:
    """Radiance of each source by its name [W m^-2 sr^-1]."""
    return {emitter.source: emitter.radiance for emitter in scene.emitters}


def check_needs_no_ray(free: FreeScene) -> None:
    """See that no free key changes what rays must tell.

    Raises
    ------
    InputError
        If one does, or it is the level of a source that is dark.
    """
    values = [key.value for key in free.keys]
    base = free.scene
    for number, key in enumerate(free.keys):
        step = _TRIED * key.scale
        moved = list(values)
        moved[number] += step if values[number] + step <= key.high else -step
        other = free.at(moved)
        where = f"free {key.key}"
        if not _same_but_for_levels(base, other):
            raise InputError(
                "needs renders: only levels, exposure time and the sensor's electronics can be fitted yet", where=where
            )
        try:
            check_same_light(base.camera, other.camera)
        except InputError as error:
            raise InputError(
                "needs renders: only levels, exposure time and the sensor's electronics can be fitted yet", where=where
            ) from error
        told = radiances(base)
        if any(radiance != told[name] and not told[name] for name, radiance in radiances(other).items()):
            raise InputError("is the level of a source that is dark", where=where, remedy="let it begin above 0")


def _same_but_for_levels(one: Scene, other: Scene) -> bool:
    for name in ("materials", "targets", "tolerances"):
        if getattr(one, name) != getattr(other, name):
            return False
    lights = [[_without_level(emitter) for emitter in scene.emitters] for scene in (one, other)]
    return lights[0] == lights[1]


def _without_level(emitter: object) -> list[object]:
    names = [field.name for field in fields(emitter) if field.name not in _LIGHT]  # type: ignore[arg-type]
    return [(name, getattr(emitter, name)) for name in names]
