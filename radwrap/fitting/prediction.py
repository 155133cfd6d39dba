"""Gray levels of all captures for any values of the free keys: from light bases, one for each place that is tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.free_keys import FreeKey, FreeScene
from radwrap.fitting.places import Places, radiances
from radwrap.imaging.relight.relit import Basis, Relighter
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.scene.camera import Sensor
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
_STEP: Final = 1e-4  # of a key's scale: levels are linear in it, and the sensor's keys smooth
# Of the image's range: so much a difference by renders changes somewhere. The slope of an edge is then 1 % too small.
_CHANGE: Final = 0.15
_SMOOTH: Final = 0.5  # px: what single pixels show may be the grain of the rays
_FARTHER: Final = 10.0
_TRIED_STEP: Final = 0.02  # of such a key's scale, to begin with
_SMALLEST, _LARGEST = 1e-7, 0.5  # of such a key's scale: steps
# The same of a value of 0, a pose's say, that has no scale of its own but its unit: turned by more, a lattice of dots
# looks like itself again.
_LARGEST_FROM_0: Final = {"deg": 10.0}
_LARGEST_ELSE: Final = 50.0
_TRIALS: Final = 6
_FIT: Final = 2.0  # a step that is right within this factor


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What is predicted for the scene of one capture.

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

    def certificate(self) -> Certificate:
        """How far its gray levels may be off, measured anew in this light and camera."""
        camera = replace(self.scene.camera, distortion=None)
        basis = replace(self.basis, camera=camera, exposure_of_radiance=exposure_of_radiance(camera))
        return Relighter(basis).image(self.factors).certificate


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """What is predicted for some values, for all captures.

    Attributes
    ----------
    parts : tuple of Part
        One for each capture.
    """

    parts: tuple[Part, ...]

    @property
    def exposure(self) -> Array:
        """H of all, one below the other, shape (captures * rows, columns) [J m^-2]."""
        return np.concatenate([part.exposure for part in self.parts])

    @property
    def unclipped(self) -> Array:
        """Gray levels without saturation and rounding, likewise."""
        return np.concatenate([part.unclipped for part in self.parts])


class Prediction:
    """What the scenes of all captures come to.

    Parameters
    ----------
    shots : sequence of (FreeScene, Places)
        For each capture its scene, and the light that it is seen in. All have the same keys.
    steps : sequence of float, optional
        How far each key may be moved for its slope, over its scale, where that is known from another prediction.
    """

    def __init__(self, shots: Sequence[tuple[FreeScene, Places]], steps: Sequence[float] = ()) -> None:
        self._shots = tuple(shots)
        self._keys: tuple[FreeKey, ...] = shots[0][0].keys
        self._rendered = shots[0][1].rendered
        self._begun = list(steps or [_TRIED_STEP] * len(self._keys))
        # By blur: how far each key is moved for its slope, and where that was seen.
        self._steps: dict[float, list[float]] = {}
        self._seen: dict[float, Array] = {}

    @property
    def has_renders(self) -> bool:
        """Whether some keys need them."""
        return bool(self._rendered.any())

    @property
    def places(self) -> tuple[Places, ...]:
        """Those that differ."""
        return tuple({id(places): places for _, places in self._shots}.values())

    @property
    def renders(self) -> int:
        """Bases so far."""
        return sum(places.count for places in self.places)

    def at(self, values: Sequence[float] | Array) -> Predicted:
        """Gray levels for some values; InputError where a scene does not take them."""
        at = np.array(values, dtype=np.float64)
        parts = []
        for free, places in self._shots:
            scene, lit = free.at([float(value) for value in at]), places.lit(at)
            told = radiances(scene)
            factors = np.array([told[name] / lit.radiances[name] if told[name] else 0.0 for name in lit.basis.sources])
            exposure, unclipped = gray_of(scene, factors, lit.images)
            parts.append(Part(scene, factors, exposure, unclipped, lit.basis))
        return Predicted(tuple(parts))

    def slopes(self, values: Array, blur: float = 0.0) -> Array:
        """Change of the unclipped gray levels with each key's scale, shape (keys, captures * rows, columns).

        A key that needs renders is moved so far that the image somewhere changes by a share of its range: what a
        smaller step shows may be the grain of the rays. How far that is, is found once for each blur.

        Parameters
        ----------
        values : ndarray, shape (keys,)
            Where.
        blur : float
            Sigma of the blur that the image is looked at with [px]: the wider, the farther a key is moved.
        """
        if blur not in self._steps:
            self._steps[blur] = [self._step(values, number, blur, step) for number, step in enumerate(self._begun)]
        near = self._near(values, blur)
        return np.stack([self._slope(near, number, step) for number, step in enumerate(self._steps[blur])])

    @property
    def steps(self) -> tuple[float, ...]:
        """How far each key was moved last for its slope, over its scale."""
        return tuple(next(reversed(self._steps.values()), self._begun))

    def _near(self, values: Array, blur: float) -> Array:
        """The place of the slopes: one where they were seen, unless a key is farther from it than slopes reach."""
        reach = np.array(self._steps[blur]) * np.array([key.scale for key in self._keys])
        known = self._seen.get(blur)
        if known is None or (np.abs(values - known) > reach)[self._rendered].any():
            self._seen[blur] = known = np.array(values, dtype=np.float64)
        return np.where(self._rendered, known, values)

    def _step(self, values: Array, number: int, blur: float, step: float) -> float:
        """How far a key is moved to see its slope, sought from some step on."""
        if not self._rendered[number]:
            return _STEP
        sigma = max(blur, _SMOOTH)
        target = _CHANGE * float(np.ptp(self._smooth(self.at(values).unclipped, sigma)))
        key = self._keys[number]
        largest = _LARGEST if key.value else _LARGEST_FROM_0.get(key.unit, _LARGEST_ELSE)
        taken = 0.0
        for _ in range(_TRIALS):
            try:
                slope = self._slope(values, number, step)
            except InputError:  # beyond what the scene takes
                if taken:
                    break
                step /= _FARTHER
                continue
            taken = step
            seen = float(np.abs(self._smooth(slope, sigma)).max())
            # At most tenfold: of a step that moved little its grain may be most.
            wanted = step * target / max(seen * step, target / _FARTHER)
            if 1 / _FIT < wanted / step < _FIT:
                break
            step = min(max(wanted, _SMALLEST), largest)
            if step == taken:
                break
        return taken or step

    def _smooth(self, images: Array, sigma: float) -> Array:
        """Each capture's image, blurred."""
        from scipy.ndimage import gaussian_filter

        parts = np.split(images, len(self._shots))
        return np.concatenate([gaussian_filter(image, sigma) for image in parts])

    def _slope(self, values: Array, number: int, step: float) -> Array:
        key = self._keys[number]
        ends = []
        for sign in (1.0, -1.0):
            moved = np.array(values, dtype=np.float64)
            moved[number] = min(max(moved[number] + sign * step * key.scale, key.low), key.high)
            ends.append((moved[number], self.at(moved).unclipped))
        return np.asarray((ends[0][1] - ends[1][1]) / ((ends[0][0] - ends[1][0]) / key.scale))

    def replicates(self, predicted: Predicted, others: Sequence[Sequence[Basis]]) -> tuple[Array, int]:
        """Independent images whose mean a prediction is, and others of their kind.

        Captures in the same light share the error of its rays. Where bases have more replicates than others, some of
        these are joined, so that all have as many.

        Parameters
        ----------
        predicted : Predicted
            The prediction.
        others : sequence of sequence of Basis
            Of each of `places` in turn the same number of further bases, by other rays.

        Returns
        -------
        images : ndarray, shape (replicates, captures * rows, columns)
            Unclipped gray levels.
        own : int
            How many of them, the first ones, the prediction is the mean of.

        Raises
        ------
        InputError
            If a basis has other sources.
        """
        own = [predicted.parts[self._first(places)].basis for places in self.places]
        if any(basis.sources != known.sources for known, bases in zip(own, others, strict=True) for basis in bases):
            raise InputError("has other sources", where="basis")
        rounds = [own, *zip(*others, strict=True)]
        count = min(basis.images.shape[1] for bases in rounds for basis in bases)
        return np.concatenate([self._images(predicted, bases, count) for bases in rounds]), count

    def _images(self, predicted: Predicted, bases: Sequence[Basis], count: int) -> Array:
        """By one basis for each of the places, shape (count, captures * rows, columns)."""
        joined = {id(places): _joined(basis.images, count) for places, basis in zip(self.places, bases, strict=True)}
        stacks = []
        for part, (_, places) in zip(predicted.parts, self._shots, strict=True):
            images = joined[id(places)]
            stacks.append([gray_of(part.scene, part.factors, images[:, one])[1] for one in range(count)])
        return np.concatenate([np.stack(stack) for stack in stacks], axis=1)

    def _first(self, places: Places) -> int:
        return next(number for number, (_, other) in enumerate(self._shots) if other is places)


def _joined(images: NDArray[np.float32], count: int) -> Array:
    """Means of neighbouring replicates, as many as asked for, shape (sources, count, rows, columns)."""
    parts = np.array_split(images.astype(np.float64), count, axis=1)
    return np.stack([part.mean(axis=1) for part in parts], axis=1)


def gray_of(scene: Scene, factors: Array, images: Array) -> tuple[Array, Array]:
    """Radiant exposure and unclipped gray levels of sources' images, shape (sources, rows, columns) [W m^-2 sr^-1]."""
    mean = np.maximum(np.tensordot(factors, images, axes=1), 0.0)
    exposure = mean * exposure_of_radiance(scene.camera)
    return exposure, unclipped_gray(exposure, scene.camera.sensor)
