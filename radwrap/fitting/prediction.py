"""Gray levels for any values of the free keys: from one light basis, and one more for each place that is tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
_CHANGE: Final = 0.08  # of the image's range: so much a difference by renders changes somewhere
_FARTHER: Final = 10.0
_TRIED_STEP: Final = 0.02  # of such a key's scale, to begin with
_SMALLEST, _LARGEST = 1e-7, 0.5  # of a key's scale: steps of such a key
_TRIALS: Final = 4
_FIT: Final = 2.0  # a step that is right within this factor
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
    basis : Basis
        The light that it is made of.
    """

    scene: Scene
    factors: Array
    exposure: Array
    unclipped: Array
    basis: Basis

    @property
    def sensor(self) -> Sensor:
        """That of the scene."""
        return self.scene.camera.sensor


@dataclass(frozen=True, slots=True, eq=False)
class Lit:
    """The light of a scene, source by source.

    Attributes
    ----------
    basis : Basis
        As it was traced.
    images : ndarray, shape (sources, rows, columns)
        Mean of its replicates [W m^-2 sr^-1].
    radiances : Mapping[str, float]
        Of each source in that scene [W m^-2 sr^-1].
    """

    basis: Basis
    images: Array
    radiances: Mapping[str, float]

    @classmethod
    def of(cls, scene: Scene, basis: Basis) -> Lit:
        """Of a scene's basis."""
        return cls(basis, basis.images.astype(np.float64).mean(axis=1), radiances(scene))


class Prediction:
    """What a scene with free keys comes to.

    It keeps the light of each place that was asked for: to come back to one takes no ray.

    Parameters
    ----------
    free : FreeScene
        What is free.
    basis : Basis
        Of the scene where the fit begins.
    rendered : sequence of bool
        Which keys need renders; default none.
    light : callable, optional
        Traces the basis of a scene, by the same rays for all.
    """

    def __init__(
        self,
        free: FreeScene,
        basis: Basis,
        rendered: Sequence[bool] = (),
        light: Callable[[Scene], Basis] | None = None,
    ) -> None:
        self._free = free
        self._begin = np.array([key.value for key in free.keys], dtype=np.float64)
        self._rendered = np.array(rendered or [False] * len(free.keys), dtype=np.bool_)
        self._light = light
        self._lit = {self._place(self._begin): Lit.of(free.scene, basis)}
        self._steps = [_TRIED_STEP if moved else _STEP for moved in self._rendered]
        self._found = [False] * len(free.keys)

    @property
    def has_renders(self) -> bool:
        """Whether some keys need them."""
        return bool(self._rendered.any())

    @property
    def renders(self) -> int:
        """Bases so far."""
        return len(self._lit)

    def _place(self, values: Array) -> tuple[float, ...]:
        """What decides where rays go."""
        return tuple(float(value) for value in values[self._rendered])

    def lit(self, values: Array) -> Lit:
        """The light for the values of keys that need a render: the others are as where the fit begins."""
        place = self._place(values)
        if place not in self._lit:
            if self._light is None:
                raise TypeError("keys that need renders need who renders")
            scene = self.lit_scene(values)
            self._lit[place] = Lit.of(scene, self._light(scene))
        return self._lit[place]

    def lit_scene(self, values: Array) -> Scene:
        """The scene of that light."""
        return self._free.at([float(value) for value in np.where(self._rendered, values, self._begin)])

    def at(self, values: Sequence[float] | Array) -> Predicted:
        """Gray levels for some values; InputError where the scene does not take them."""
        at = np.array(values, dtype=np.float64)
        scene, lit = self._free.at([float(value) for value in at]), self.lit(at)
        told = radiances(scene)
        factors = np.array([told[name] / lit.radiances[name] for name in lit.basis.sources])
        exposure, unclipped = gray_of(scene, factors, lit.images)
        return Predicted(scene, factors, exposure, unclipped, lit.basis)

    def slopes(self, values: Array) -> Array:
        """Change of the unclipped gray levels with each key's scale, shape (keys, rows, columns).

        A key that needs renders is moved so far that the image somewhere changes by a share of its range: what a
        smaller step shows may be the grain of the rays. How far that is, is found once.
        """
        found = []
        for number in range(len(self._free.keys)):
            slope = self._slope(values, number)
            if self._rendered[number] and not self._found[number]:
                slope = self._with_step(values, number, slope)
            found.append(slope)
        return np.stack(found)

    def _with_step(self, values: Array, number: int, slope: Array) -> Array:
        """Find the step of a key that needs renders, and the slope by it."""
        shown = self.at(values).unclipped
        target = _CHANGE * float(np.ptp(shown))
        for _ in range(_TRIALS):
            # At most tenfold: of a step that moved little its grain may be most.
            times = target / max(float(np.abs(slope).max()) * self._steps[number], target / _FARTHER)
            wanted = min(max(self._steps[number] * times, _SMALLEST), _LARGEST)
            near = 1 / _FIT < wanted / self._steps[number] < _FIT
            self._steps[number] = wanted
            if near:
                break
            slope = self._slope(values, number)
        self._found[number] = True
        return slope

    def _slope(self, values: Array, number: int) -> Array:
        key = self._free.keys[number]
        ends = []
        for sign in (1.0, -1.0):
            moved = np.array(values, dtype=np.float64)
            moved[number] = min(max(moved[number] + sign * self._steps[number] * key.scale, key.low), key.high)
            ends.append((moved[number], self.at(moved).unclipped))
        return np.asarray((ends[0][1] - ends[1][1]) / ((ends[0][0] - ends[1][0]) / key.scale))

    def replicates(self, predicted: Predicted, other: Basis | None = None) -> Array:
        """The independent images whose mean a prediction is [gray level], shape (replicates, rows, columns)."""
        basis = other or predicted.basis
        if basis.sources != predicted.basis.sources:
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
        basis = replace(predicted.basis, camera=camera, exposure_of_radiance=exposure_of_radiance(camera))
        return Relighter(basis).image(predicted.factors).certificate


def gray_of(scene: Scene, factors: Array, images: Array) -> tuple[Array, Array]:
    """Radiant exposure and unclipped gray levels of sources' images, shape (sources, rows, columns) [W m^-2 sr^-1]."""
    mean = np.maximum(np.tensordot(factors, images, axes=1), 0.0)
    exposure = mean * exposure_of_radiance(scene.camera)
    return exposure, unclipped_gray(exposure, scene.camera.sensor)


def radiances(scene: Scene) -> dict[str, float]:
    """Radiance of each source by its name [W m^-2 sr^-1]."""
    return {emitter.source: emitter.radiance for emitter in scene.emitters}


def need_renders(free: FreeScene) -> tuple[bool, ...]:
    """Of each key, whether it changes more than levels, exposure time and the sensor's electronics.

    Raises
    ------
    InputError
        If a key is the level of a source that is dark.
    """
    found = []
    values = [key.value for key in free.keys]
    base = free.scene
    for number, key in enumerate(free.keys):
        step = _TRIED * key.scale
        moved = list(values)
        moved[number] += step if values[number] + step <= key.high else -step
        other = free.at(moved)
        told = radiances(base)
        if any(radiance != told[name] and not told[name] for name, radiance in radiances(other).items()):
            raise InputError(
                "is the level of a source that is dark", where=f"free {key.key}", remedy="let it begin above 0"
            )
        found.append(not (_same_but_for_levels(base, other) and _is_same_light(base, other)))
    return tuple(found)


def _is_same_light(one: Scene, other: Scene) -> bool:
    if one.spectral is not None and replace(one.camera, exposure_time=other.camera.exposure_time) != other.camera:
        return False  # another sensor may weigh spectra otherwise
    try:
        check_same_light(one.camera, other.camera)
    except InputError:
        return False
    return True


def _same_but_for_levels(one: Scene, other: Scene) -> bool:
    for name in ("materials", "targets", "tolerances"):
        if getattr(one, name) != getattr(other, name):
            return False
    lights = [[_without_level(emitter) for emitter in scene.emitters] for scene in (one, other)]
    return lights[0] == lights[1]


def _without_level(emitter: object) -> list[object]:
    names = [field.name for field in fields(emitter) if field.name not in _LIGHT]  # type: ignore[arg-type]
    return [(name, getattr(emitter, name)) for name in names]
