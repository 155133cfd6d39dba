"""The light of the places that a fit comes to, source by source: to come back to one takes no ray."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.fitting.free_keys import FreeScene
from radwrap.imaging.other_camera import check_same_light
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import SourceImages
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Emitter

Array = NDArray[np.float64]
# Of a wide source its pieces are laid out anew with its level: they are the same light.
_LIGHT: Final = ("radiance", "patches", "reached", "step", "is_outline")
_TRIED: Final = 1e-3  # of a key's scale, to see what hangs on it


@dataclass(frozen=True, slots=True, eq=False)
class Lit:
    """The light of a scene, source by source.

    Attributes
    ----------
    basis : Basis or SourceImages
        As it was traced.
    images : ndarray, shape (sources, rows, columns)
        Mean of its replicates [W m^-2 sr^-1].
    radiances : Mapping[str, float]
        Of each source in that scene [W m^-2 sr^-1].
    """

    basis: Basis | SourceImages
    images: Array
    radiances: Mapping[str, float]

    @classmethod
    def of(cls, scene: Scene, basis: Basis | SourceImages) -> Lit:
        """Of a scene's basis."""
        return cls(basis, basis.images.astype(np.float64).mean(axis=1), radiances(scene))


class Places:
    """The light of a scene with free keys, wherever it is asked for.

    Parameters
    ----------
    free : FreeScene
        What is free.
    rendered : sequence of bool
        Which keys need renders; default none.
    trace : callable
        Traces the basis of a scene, by the same rays for all.
    """

    def __init__(
        self, free: FreeScene, rendered: Sequence[bool], trace: Callable[[Scene], Basis | SourceImages]
    ) -> None:
        self._free = free
        self._begin = np.array([key.value for key in free.keys], dtype=np.float64)
        self._rendered = np.array(rendered or [False] * len(free.keys), dtype=np.bool_)
        self._trace = trace
        self._lit: dict[tuple[float, ...], Lit] = {}

    @property
    def rendered(self) -> NDArray[np.bool_]:
        """Which keys need renders."""
        return self._rendered

    @property
    def count(self) -> int:
        """Bases so far."""
        return len(self._lit)

    def serves(self, scene: Scene) -> bool:
        """Whether another scene where the fit begins differs from this one in nothing that takes a ray."""
        own, other = radiances(self._free.scene), radiances(scene)
        if own.keys() != other.keys() or any(other[name] and not own[name] for name in own):
            return False  # what is dark here cannot be made brighter
        return is_same_but_for_levels(self._free.scene, scene)

    def _place(self, values: Array) -> tuple[float, ...]:
        """What decides where rays go."""
        return tuple(float(value) for value in values[self._rendered])

    def lit(self, values: Array) -> Lit:
        """The light for the values of keys that need a render: the others are as where the fit begins."""
        place = self._place(values)
        if place not in self._lit:
            scene = self.scene(values)
            self._lit[place] = Lit.of(scene, self._trace(scene))
        return self._lit[place]

    def scene(self, values: Array) -> Scene:
        """The scene of that light."""
        return self._free.at([float(value) for value in np.where(self._rendered, values, self._begin)])


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
        found.append(not is_same_but_for_levels(base, other))
    return tuple(found)


def _is_same_light(one: Scene, other: Scene) -> bool:
    if one.spectral is not None and replace(one.camera, exposure_time=other.camera.exposure_time) != other.camera:
        return False  # another sensor may weigh spectra otherwise
    try:
        check_same_light(one.camera, other.camera)
    except InputError:
        return False
    return True


def is_same_but_for_levels(one: Scene, other: Scene) -> bool:
    """Whether two scenes differ in levels of sources, exposure time and the sensor's electronics at most."""
    if not _is_same_light(one, other):
        return False
    for name in ("materials", "targets", "tolerances"):
        if getattr(one, name) != getattr(other, name):
            return False
    lights = [[_without_level(emitter) for emitter in scene.emitters] for scene in (one, other)]
    return lights[0] == lights[1]


def _without_level(emitter: Emitter) -> list[object]:
    names = [field.name for field in fields(emitter) if field.name not in _LIGHT]
    return [(name, getattr(emitter, name)) for name in names]
