"""The prediction near where a search ends: by rays that know no cells, and by slopes.

What a search steps by shares its rays from place to place, and a kernel's cells and model: good for differences, but
its place is off by what all of them have in common. So the light where the search ends is traced once more, by
independent rays over pixel and opening. Near there the prediction is that image, and light changes linearly with the
keys that need renders. The values that agree best with it are off by noise, and by rays whose scatter shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.fitting.free_keys import FreeKey, FreeScene
from radwrap.fitting.places import Lit
from radwrap.fitting.prediction import Part, Predicted, Prediction, Steepness, ends_of, factors_of
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import SourceImages
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.imaging.response.sensor import unclipped_gray
from radwrap.imaging.tolerance.wave_image import visible_gray
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
_NEARER: Final = 0.25  # of what keys are moved for slopes: so near these are the same
_STEP: Final = 1e-4  # of a key's scale, and of the light: what is predicted here is smooth


@dataclass(frozen=True, slots=True, eq=False)
class Grain:
    """What rays of one image have to do with those of its slopes.

    Attributes
    ----------
    slopes : ndarray, shape (keys, keys)
        Expected D^T D of the slopes' error D, over sigma.
    pull : ndarray, shape (keys,)
        D^T e with the error e of the prediction by the same rays, over sigma: J^T (captured - predicted) lacks it.
    """

    slopes: Array
    pull: Array


@dataclass(frozen=True, slots=True, eq=False)
class Grained:
    """How gray levels and their slopes scatter by independent rays, before it is known what pixels count.

    Attributes
    ----------
    rendered, others : ndarray of int, shape (n,) and (m,)
        Keys that need renders, and those that do not.
    changes : ndarray, shape (n, replicates, captures * rows, columns)
        Of the radiant exposure with the former [J m^-2].
    per_light : ndarray, shape (captures * rows, columns)
        What a change of it does to gray levels [m^2 J^-1].
    moved : ndarray, shape (m, replicates, captures * rows, columns)
        Change of the gray levels with the latter.
    own : ndarray, shape (replicates, captures * rows, columns)
        Gray levels by the same rays as these.
    away : ndarray, shape (n,)
        How far the former are from where the image was traced, over their scales: it has gone along their slopes, and
        so has its error.
    """

    rendered: NDArray[np.intp]
    others: NDArray[np.intp]
    changes: Array
    per_light: Array
    moved: Array
    own: Array
    away: Array

    def over(self, used: NDArray[np.bool_], sigma: Array) -> Grain:
        """Of the used pixels.

        Parameters
        ----------
        used : ndarray of bool, shape (captures * rows, columns)
            Pixels that count.
        sigma : ndarray, shape (pixels,)
            Their deviations, over what each counts [gray level].
        """
        keys = len(self.rendered) + len(self.others)
        slopes, pull = np.zeros((keys, keys)), np.zeros(keys)
        if len(self.rendered):
            moved = self.changes[:, :, used] * (self.per_light[used] / sigma)
            slopes[np.ix_(self.rendered, self.rendered)] = scatter = _scatter(moved, moved)
            pull[self.rendered] = scatter @ self.away
        if len(self.others):
            moved = self.moved[:, :, used] / sigma
            slopes[np.ix_(self.others, self.others)] = _scatter(moved, moved)
            pull[self.others] = _scatter(moved, self.own[np.newaxis, :, used] / sigma)[:, 0]
        return Grain(slopes, pull)


class Settled:
    """The prediction near a place, by unbiased rays there.

    Parameters
    ----------
    prediction : Prediction
        What the search stepped by.
    keys : sequence of FreeKey
        Its keys.
    place : ndarray, shape (keys,)
        Where.
    bases : sequence of Basis or SourceImages
        By independent rays of the scene there, in each of the prediction's places.
    before : Settled, optional
        Near another place, whose slopes are taken if they still hold.
    is_last : bool
        Whether it may be the last one: else slopes are those that the search has seen.
    """

    def __init__(
        self,
        prediction: Prediction,
        keys: Sequence[FreeKey],
        place: Array,
        bases: Sequence[Basis | SourceImages],
        before: Settled | None = None,
        *,
        is_last: bool = True,
    ) -> None:
        self._place = np.array(place, dtype=np.float64)
        self._scales = np.array([key.scale for key in keys])
        self._keys = tuple(keys)
        lit = {
            id(places): Lit.of(places.scene(place), basis)
            for places, basis in zip(prediction.places, bases, strict=True)
        }
        self._shots: list[tuple[FreeScene, Lit]] = [(free, lit[id(places)]) for free, places in prediction.shots]
        self.has_renders, self.is_last = prediction.has_renders, is_last
        holds = before is not None and before.is_last == is_last and before.reaches(self._place, _NEARER)
        kept = before.steep if before is not None and holds else None
        steep = kept or (prediction.steepness(self._place, is_last=is_last) if self.has_renders else None)
        self.steep: Steepness | None = steep
        self._seen = self._place if kept is None or before is None else before.seen
        rows, columns = self._shots[0][1].images.shape[1:]
        none = np.zeros((0, 2, len(self._shots) * rows, columns))
        self._rendered = np.zeros(0, dtype=np.intp) if steep is None else steep.numbers
        self._changes = none if steep is None else steep.changes
        self._reach = np.zeros(0) if steep is None else steep.reach
        self._then: list[Array] = []
        if steep is not None:
            scenes = [self._lit_scene(free, steep.values) for free, _ in self._shots]
            for scene, (_, one) in zip(scenes, self._shots, strict=True):
                self._then.append(_lit_by(scene, factors_of(scene, one), one.images))

    @property
    def seen(self) -> Array:
        """Where its slopes were seen."""
        return self._seen

    def bent(self, values: Array) -> float:
        """About what share of a step to some values its slopes leave out: as far as it goes, over their reach."""
        away = np.abs(np.asarray(values) - self._place)[self._rendered]
        return float((away / self._reach).max(initial=0.0))

    def reaches(self, values: Array, share: float = 1.0) -> bool:
        """Whether no key lies farther away than it was moved for slopes, or than a share of that."""
        away = np.abs(values - self._seen)[self._rendered]
        return bool((away <= share * self._reach).all())

    def at(self, values: Sequence[float] | Array) -> Predicted:
        """Gray levels for some values; InputError where a scene does not take them."""
        at = np.array(values, dtype=np.float64)
        parts = []
        for number, (free, lit) in enumerate(self._shots):
            scene, seen = free.at([float(value) for value in at]), self._lit_scene(free, at)
            factors = factors_of(seen, lit)
            exposure = np.maximum(_lit_by(seen, factors, lit.images) + self._moved(number, at), 0.0)
            parts.append(Part(scene, factors, exposure, unclipped_gray(exposure, scene.camera.sensor), lit.basis))
        return Predicted(tuple(parts))

    def slopes(self, values: Array) -> Array:
        """Change of the unclipped gray levels with each key's scale, shape (keys, captures * rows, columns)."""
        found = np.empty((len(self._keys), *self._changes.shape[2:]))
        if len(self._rendered):
            light = self._per_light(self.at(values)) * self._brighter(values)
            found[self._rendered] = light * self._changes.mean(axis=1)
        for number in self._others():
            (low, high), span = ends_of(self._keys[number], values, number, _STEP)
            found[number] = (self.at(high).unclipped - self.at(low).unclipped) / span
        return found

    def replicates(self, values: Array) -> Array:
        """Unclipped gray levels by each of the independent rays, shape (replicates, captures * rows, columns)."""
        shots = []
        for number, (free, lit) in enumerate(self._shots):
            scene, seen = free.at([float(value) for value in values]), self._lit_scene(free, values)
            traced = lit.basis.images[:, : self._count].astype(np.float64)
            exposure = np.maximum(_lit_by(seen, factors_of(seen, lit), traced) + self._moved(number, values), 0.0)
            shots.append(unclipped_gray(exposure, scene.camera.sensor))
        return np.concatenate(shots, axis=1)

    def errors(self, values: Array) -> Array:
        """The same, as far from their mean as that is known: more so where some of them tell what all go by."""
        found = self.replicates(values)
        mean = found.mean(axis=0)
        bases = [lit.basis for _, lit in self._shots]
        carrying = max(one.carrying if isinstance(one, SourceImages) else 0.0 for one in bases)
        return np.asarray(mean + (found - mean) * np.sqrt(1 + carrying))

    def common(self, predicted: Predicted) -> Array:
        """By how much all replicates may be off alike, at most, shape (captures * rows, columns) [gray level].

        Rays over pixel and opening have nothing in common but the cells and the reach of their waves.
        """
        images = []
        for part in predicted.parts:
            waves = part.basis.waves
            if waves is None:
                images.append(np.zeros(part.exposure.shape))
                continue
            scale = exposure_of_radiance(part.scene.camera)
            gray = visible_gray(scale, part.sensor)
            made = part.exposure / scale
            cells, far = np.tensordot(part.factors, waves.astype(np.float64), axes=1)
            images.append(np.abs(gray(made + cells) - gray(made)) + np.abs(gray(made + far) - gray(made)))
        return np.concatenate(images)

    def grained(self, values: Array) -> Grained:
        """How rays scatter at some values of the keys, shape (keys,)."""
        others = self._others()
        ends = [ends_of(self._keys[number], values, number, _STEP) for number in others]
        own = self.replicates(values)
        moved = np.zeros((len(others), *own.shape))
        for row, ((low, high), span) in zip(moved, ends, strict=True):
            row[:] = (self.replicates(high) - self.replicates(low)) / span
        weight = np.zeros(own.shape[1:])
        if len(self._rendered):
            weight = self._per_light(self.at(values)) * self._brighter(values)
        away = ((values - self._place) / self._scales)[self._rendered]
        return Grained(self._rendered, np.array(others, dtype=np.intp), self._changes, weight, moved, own, away)

    @property
    def _count(self) -> int:
        return min(int(lit.basis.images.shape[1]) for _, lit in self._shots)

    def _others(self) -> list[int]:
        """Keys that need no renders."""
        return sorted(set(range(len(self._keys))) - set(self._rendered.tolist()))

    def _lit_scene(self, free: FreeScene, values: Array) -> Scene:
        """The scene in whose light some values are seen: what keys that need renders change is in their slopes."""
        at = np.array(values, dtype=np.float64)
        at[self._rendered] = self._place[self._rendered]
        return free.at([float(value) for value in at])

    def _moved(self, number: int, values: Array) -> Array | float:
        """What keys that need renders change of one capture [J m^-2]."""
        if not len(self._rendered):
            return 0.0
        rows = self._shots[number][1].images.shape[1]
        here = slice(number * rows, (number + 1) * rows)
        shift = ((values - self._place) / self._scales)[self._rendered]
        change = np.tensordot(shift, self._changes.mean(axis=1)[:, here], axes=1)
        return np.asarray(change * self._brighter_in(number, values))

    def _brighter(self, values: Array) -> Array:
        """How many times brighter all is than where slopes were seen, shape (captures * rows, columns)."""
        return np.concatenate([self._brighter_in(number, values) for number in range(len(self._shots))])

    def _brighter_in(self, number: int, values: Array) -> Array:
        """The same of one capture: what a target does goes with the light that it is in, pixel by pixel."""
        free, lit = self._shots[number]
        scene = self._lit_scene(free, values)
        now, then = _lit_by(scene, factors_of(scene, lit), lit.images), self._then[number]
        return np.divide(now, then, out=np.ones_like(now), where=then > 0)

    def _per_light(self, predicted: Predicted) -> Array:
        """Change of the gray level with radiant exposure, shape (captures * rows, columns) [m^2 J^-1]."""
        found = []
        for part in predicted.parts:
            step = _STEP * float(part.exposure.max(initial=0.0)) or 1.0
            ends = [unclipped_gray(part.exposure + more, part.sensor) for more in (0.0, step)]
            found.append((ends[1] - ends[0]) / step)
        return np.concatenate(found)


def _lit_by(scene: Scene, factors: Array, images: Array) -> Array:
    """Radiant exposure by sources' images, shape (rows, columns) [J m^-2]."""
    return np.asarray(np.tensordot(factors, images, axes=1) * exposure_of_radiance(scene.camera))


def _scatter(one: Array, other: Array) -> Array:
    """Covariance of two means over replicates, summed over pixels, shape (n, m).

    Parameters
    ----------
    one : ndarray, shape (n, replicates, pixels)
        Whose mean over replicates is the one.
    other : ndarray, shape (m, replicates, pixels)
        Likewise, of the same replicates.
    """
    count = one.shape[1]
    first, second = (values - values.mean(axis=1, keepdims=True) for values in (one, other))
    return np.asarray(np.tensordot(first, second, axes=([1, 2], [1, 2])) / (count * (count - 1)))
