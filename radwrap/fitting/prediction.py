"""Gray levels of all captures for any values of the free keys: from light bases, one for each place that is tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.free_keys import FreeKey, FreeScene
from radwrap.fitting.places import Lit, Places, radiances
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import SourceImages
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.scene.camera import Sensor
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
_STEP: Final = 1e-4  # of a key's scale: levels are linear in it, and the sensor's keys smooth
# Of the image's range: so much a difference by renders changes somewhere. The slope of an edge is then 1 % too small.
_CHANGE: Final = 0.15
_SMOOTH: Final = 0.5  # px: what single pixels show may be the grain of the rays
_FARTHER: Final = 10.0
_LEAST_ROOM: Final = 1.0  # of a step: where a bound cuts one key of several, the others go another way than they should
_FARTHEST: Final = 30.0  # steps of single keys, where several are moved together
_TRIED_STEP: Final = 0.02  # of such a key's scale, to begin with
_SMALLEST, _LARGEST = 1e-7, 0.5  # of such a key's scale: steps
# The same of a value of 0, a pose's say, that has no scale of its own but its unit: turned by more, a lattice of dots
# looks like itself again.
_LARGEST_FROM_0: Final = {"deg": 10.0}
_LARGEST_ELSE: Final = 50.0
_TRIALS: Final = 6
_NEAR_ENOUGH: Final = 0.25  # of a step: so far from where slopes were seen they are the same
# Of what few rays show, by its square: so much may be grain. With .06, where other keys were not determined, answers
# scattered by two to three times what their replicates said.
_FINE_ENOUGH: Final = 1e-2
_TOO_MUCH: Final = 2.0  # times what is fine enough: a slope that was to be is traced again by all rays
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
    basis : Basis or SourceImages
        The light that it is made of.
    """

    scene: Scene
    factors: Array
    exposure: Array
    unclipped: Array
    basis: Basis | SourceImages

    @property
    def sensor(self) -> Sensor:
        """That of the scene."""
        return self.scene.camera.sensor


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


@dataclass(frozen=True, slots=True, eq=False)
class Steepness:
    """How light changes with keys that need renders.

    Attributes
    ----------
    numbers : ndarray of int, shape (n,)
        Which keys.
    changes : ndarray, shape (n, replicates, captures * rows, columns)
        Of the radiant exposure with each key's scale, by independent rays [J m^-2].
    reach : ndarray, shape (n,)
        How far each key was moved for it, in its unit.
    values : ndarray, shape (keys,)
        Of all keys there: levels of sources among them, which the light goes with.
    """

    numbers: NDArray[np.intp]
    changes: Array
    reach: Array
    values: Array


class Prediction:
    """What the scenes of all captures come to.

    Parameters
    ----------
    shots : sequence of (FreeScene, Places)
        For each capture its scene, and the light that it is seen in. All have the same keys.
    steps : sequence of float, optional
        How far each key may be moved for its slope, over its scale, where that is known from another prediction.
    rough : Prediction, optional
        The same by the fewest rays, which has the slopes.
    looks : sequence of (float, Prediction)
        The same by fewer rays, but more than `rough` has, the fewest first: each with how many times less of what its
        slopes show is grain than with `rough`, by squares.
    """

    def __init__(
        self,
        shots: Sequence[tuple[FreeScene, Places]],
        steps: Sequence[float] = (),
        rough: Prediction | None = None,
        looks: Sequence[tuple[float, Prediction]] = (),
    ) -> None:
        self._rough = rough
        self._looks = tuple(looks)
        self._shots = tuple(shots)
        self._keys: tuple[FreeKey, ...] = shots[0][0].keys
        self._rendered = shots[0][1].rendered
        self._begun = list(steps or [_TRIED_STEP] * len(self._keys))
        # By blur: how far each key is moved for its slope, and where that was seen.
        self._steps: dict[float, list[float]] = {}
        self._seen: dict[float, Array] = {}

    @property
    def _search(self) -> Prediction:
        """By the fewest rays, which has the slopes."""
        return self if self._rough is None else self._rough

    @property
    def has_renders(self) -> bool:
        """Whether some keys need them."""
        return bool(self._rendered.any())

    @property
    def shots(self) -> tuple[tuple[FreeScene, Places], ...]:
        """For each capture its scene, and the light that it is seen in."""
        return self._shots

    @property
    def places(self) -> tuple[Places, ...]:
        """Those that differ."""
        return tuple({id(places): places for _, places in self._shots}.values())

    @property
    def renders(self) -> int:
        """Bases so far."""
        others = [look for _, look in self._looks] + ([] if self._rough is None else [self._rough])
        return sum(places.count for places in self.places) + sum(one.renders for one in others)

    def at(self, values: Sequence[float] | Array) -> Predicted:
        """Gray levels for some values; InputError where a scene does not take them."""
        at = np.array(values, dtype=np.float64)
        parts = []
        for free, places in self._shots:
            scene, lit = free.at([float(value) for value in at]), places.lit(at)
            factors = factors_of(scene, lit)
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
        if self._rough is not None:
            return self._rough.slopes(values, blur)
        if blur not in self._steps:
            begun = self.steps
            self._steps[blur] = [self._step(values, number, blur, step) for number, step in enumerate(begun)]
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
        largest = self._largest(key)
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
        (low, high), span = ends_of(self._keys[number], values, number, step)
        return np.asarray((self.at(high).unclipped - self.at(low).unclipped) / span)

    def steepness(self, values: Array, *, is_last: bool = True) -> Steepness:
        """Change of the radiant exposure with each key that needs renders, by each replicate of the bases.

        Keys that nearly cancel each other are moved together, as far as it takes to see what is left: the difference of
        two large slopes would be off by their grain, and by what a finite step leaves out of each.

        Parameters
        ----------
        values : ndarray, shape (keys,)
            Where.
        is_last : bool
            Else it is by what the search has seen of single keys, without a ray more: it leads to where slopes count.
        """
        slopes, search = self.slopes(values), self._search
        self._steps = search._steps
        near = search._near(values, 0.0)
        scales = np.array([key.scale for key in self._keys])
        reach = np.array(self._steps[0.0]) * scales
        numbers = np.flatnonzero(self._rendered)
        # Of each key by itself, as the search has traced it.
        known = _alike([search._seen_along(near, one) for one in np.diag(reach)[numbers]])
        per_scale = (scales / reach)[numbers, None, None, None]
        if not is_last:
            return Steepness(numbers, known * per_scale, reach[numbers], near)
        if (np.abs(values - near) > _NEAR_ENOUGH * reach)[self._rendered].any():
            near = np.array(values, dtype=np.float64)
        moved = slopes[numbers] * (reach / scales)[numbers, np.newaxis, np.newaxis]
        others = np.flatnonzero(~self._rendered)
        beside = np.linalg.qr(slopes[others].reshape(len(others), slopes[0].size).T)[0]
        ways = self._ways(near, _off(moved.reshape(len(numbers), -1), beside), reach)
        target = _CHANGE * float(np.ptp(self._smooth(search.at(near).unclipped, _SMOOTH)))
        seen, gone = [], np.ones(len(numbers))
        for way in ways:
            step = np.zeros(len(self._keys))
            step[numbers] = way * reach[numbers]
            change = float(np.abs(self._smooth(np.tensordot(way, moved, axes=1), _SMOOTH)).max())
            times = min(target / max(change, target / _FARTHEST), max(self._room(near, step), 1.0))
            grain = _grain_of(np.tensordot(way, known, axes=1), beside) / times**2
            seen.append(self._seen_finely(near, step, times, beside, grain))
            gone = np.maximum(gone, times * np.abs(way))
        changes = np.tensordot(ways, _alike(seen), axes=(0, 0)) * per_scale
        return Steepness(numbers, changes, gone * reach[numbers], near)

    def _ways(self, near: Array, moved: Array, reach: Array) -> Array:
        """Which keys are moved together, over their reach, shape (n, n); at a bound each by itself."""
        ways = np.linalg.svd(moved, full_matrices=False)[0].T
        steps = np.zeros((len(ways), len(self._keys)))
        steps[:, self._rendered] = ways * reach[self._rendered]
        at_bound = min(self._room(near, step) for step in steps) < _LEAST_ROOM
        return np.eye(len(ways)) if at_bound else np.asarray(ways)

    def _seen_finely(self, values: Array, step: Array, times: float, beside: Array, grain: float) -> Array:
        """Change with a step, by so few rays as its grain lets them be, of which the search has seen so much."""
        for less, look in self._looks:
            if grain < less * _FINE_ENOUGH:
                image = look._seen_along(values, step, times)
                if _grain_of(image, beside) < _TOO_MUCH * _FINE_ENOUGH:
                    return image
                break
        return self._seen_along(values, step, times)

    def _seen_along(self, values: Array, step: Array, times: float = 1.0) -> Array:
        """Change of the radiant exposure with a step, shape (replicates, captures * rows, columns)."""
        above, below, span = self._both(values, step, times)
        count = min(len(above), len(below))
        return np.asarray((_joined(above, count) - _joined(below, count)) / span)

    def _room(self, values: Array, step: Array) -> float:
        """How many times a step may be gone both ways: within bounds, and no farther than one key is ever moved."""
        room = [_FARTHEST]
        for value, part, key in zip(values, np.abs(step), self._keys, strict=True):
            if part > 0:
                largest = self._largest(key) * key.scale
                room.append(float(min(value - key.low, key.high - value, largest) / part))
        return min(room)

    def _both(self, values: Array, step: Array, times: float) -> tuple[Array, Array, float]:
        """Radiant exposures on both sides, and how many steps lie between: fewer where the scene does not take them."""
        low, high = np.array([[key.low, key.high] for key in self._keys]).T
        for trial in range(_TRIALS):
            ends = [np.clip(values + sign * times * step, low, high) for sign in (1.0, -1.0)]
            try:
                images = [self._exposures(end) for end in ends]
                break
            except InputError:
                if trial == _TRIALS - 1:
                    raise
                times /= _FARTHER
        return images[0], images[1], float((ends[0] - ends[1]) @ step / (step @ step))

    @staticmethod
    def _largest(key: FreeKey) -> float:
        """The largest step of a key, over its scale."""
        return _LARGEST if key.value else _LARGEST_FROM_0.get(key.unit, _LARGEST_ELSE)

    def _exposures(self, values: Array) -> Array:
        """Radiant exposure of all captures by each replicate, shape (replicates, captures * rows, columns)."""
        parts = self.at(values).parts
        count = min(part.basis.images.shape[1] for part in parts)
        images = []
        for part in parts:
            joined = _joined(part.basis.images.astype(np.float64).swapaxes(0, 1), count)
            scale = exposure_of_radiance(part.scene.camera)
            images.append(np.tensordot(joined, part.factors, axes=(1, 0)) * scale)
        return np.concatenate(images, axis=1)


def ends_of(key: FreeKey, values: Array, number: int, step: float) -> tuple[tuple[Array, Array], float]:
    """All values with a key on both sides, within its bounds, and how far these are apart; both over its scale."""
    ends = []
    for sign in (-1.0, 1.0):
        moved = np.array(values, dtype=np.float64)
        moved[number] = min(max(moved[number] + sign * step * key.scale, key.low), key.high)
        ends.append(moved)
    return (ends[0], ends[1]), float(ends[1][number] - ends[0][number]) / key.scale


def _joined(images: Array, count: int) -> Array:
    """Means of neighbouring replicates, as many as asked for; replicates are the first axis."""
    return np.stack([part.mean(axis=0) for part in np.array_split(images, count)])


def _alike(images: Sequence[Array]) -> Array:
    """Some images, each of as many replicates as the one with the fewest has."""
    count = min(len(one) for one in images)
    return np.stack([_joined(one, count) for one in images])


def _off(rows: Array, beside: Array) -> Array:
    """What is left of some rows beside what orthonormal columns do as well."""
    return np.asarray(rows - (rows @ beside) @ beside.T)


def _grain_of(images: Array, beside: Array) -> float:
    """Share of grain, by squares, in the mean of replicates: in what is left of it beside other columns."""
    rows = images.reshape(len(images), -1)
    mean = rows.mean(axis=0)
    grain = float(((rows - mean) ** 2).sum()) / (len(rows) * (len(rows) - 1))
    left = float((_off(mean[np.newaxis], beside) ** 2).sum())
    return grain / left if left > 0 else np.inf


def factors_of(scene: Scene, lit: Lit) -> Array:
    """On the radiance of each source of a light in which a scene is seen, shape (sources,)."""
    told = radiances(scene)
    return np.array([told[name] / lit.radiances[name] if told[name] else 0.0 for name in lit.basis.sources])


def gray_of(scene: Scene, factors: Array, images: Array) -> tuple[Array, Array]:
    """Radiant exposure and unclipped gray levels of sources' images, shape (sources, rows, columns) [W m^-2 sr^-1]."""
    mean = np.maximum(np.tensordot(factors, images, axes=1), 0.0)
    exposure = mean * exposure_of_radiance(scene.camera)
    return exposure, unclipped_gray(exposure, scene.camera.sensor)
