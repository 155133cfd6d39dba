"""What rays met, kept: the same rays meet the same in other light, by other materials, and are not traced again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from radwrap.kept import Kept
from radwrap.tracers.compiled.arrays import POLYGON, Floats, Tree, Whole
from radwrap.tracers.compiled.layout import CompiledScene


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What a block of rays met.

    Attributes
    ----------
    lengths : ndarray, shape (n,)
        Distances in units of the text, infinite where nothing is.
    met : ndarray of int, shape (n,)
        What `kernels.trace` fills in.
    """

    lengths: Floats
    met: Whole


@dataclass(frozen=True, slots=True)
class KeptHits:
    """Hits in one geometry, and radiances in one light, by the bytes of the rays.

    Attributes
    ----------
    kept : Kept
        Where they are.
    geometry, light : bytes
        Hash of all that hits hang on, and of all that radiances do.
    """

    kept: Kept
    geometry: bytes
    light: bytes

    @classmethod
    def of(cls, kept: Kept, scene: CompiledScene) -> KeptHits:
        """Those of a scene."""
        frame = repr((scene.frame.length, scene.frame.origin)).encode()
        trees = (scene.targets, scene.emitters)
        corners = scene.tables if any((tree.shapes["kind"] == POLYGON).any() for tree in trees) else np.zeros(0)
        geometry = _hashed(frame, corners, *(array for tree in trees for array in _arrays(tree)))
        return cls(kept, geometry, _light_of(scene))

    def in_light_of(self, scene: CompiledScene) -> KeptHits:
        """Those of a scene with the same surfaces."""
        return replace(self, light=_light_of(scene))

    def key(self, block: Floats) -> bytes:
        """What a block of rays is known by."""
        return _hashed(block)

    def hits(self, key: bytes) -> Hits | None:
        """What a block met, if that is kept."""
        found = self.kept.get(("hits", self.geometry, key))
        return found if isinstance(found, Hits) else None

    def keep(self, key: bytes, hits: Hits) -> None:
        """Keep what a block met."""
        self.kept.put(("hits", self.geometry, key), hits, hits.lengths.nbytes + hits.met.nbytes)

    def radiance(self, key: bytes) -> Floats | None:
        """Radiances of a block, shape (n, 1) [W m^-2 sr^-1], if they are kept."""
        found = self.kept.get(("radiance", self.light, key))
        return found if isinstance(found, np.ndarray) else None

    def keep_radiance(self, key: bytes, values: Floats) -> None:
        """Keep radiances of a block."""
        values.flags.writeable = False
        self.kept.put(("radiance", self.light, key), values, values.nbytes)


def _light_of(scene: CompiledScene) -> bytes:
    """Hash of all that a scene holds, whatever comes to it: what radiances hang on is among that."""
    everything = (getattr(scene, field.name) for field in fields(scene))
    return _hashed(*(part for value in everything for part in _parts(value)))


def _parts(value: object) -> Iterator[bytes | NDArray[np.generic]]:
    if isinstance(value, Tree):
        yield from (value.shapes, value.nodes)
    else:
        yield value if isinstance(value, np.ndarray) else repr(value).encode()


def _arrays(tree: Tree) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """A tree without what its shapes wear and whose they are."""
    places = tree.shapes.copy()
    places["owner"] = places["decal"] = 0
    return places, tree.nodes


def _hashed(*parts: bytes | NDArray[np.generic]) -> bytes:
    found = hashlib.sha256()
    for part in parts:
        content = part if isinstance(part, bytes) else part.tobytes()
        found.update(len(content).to_bytes(8, "little"))
        found.update(content)
    return found.digest()
