"""A scene in which nothing moves: each row of a light basis counts by how long each source shines into it.

No ray is traced for that, and the errors are those of the very gray levels, see `relit`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.relight.relit import Basis, Relit, read_basis, relit
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.scene.instants import held, lit_by, row_levels
from radwrap.scene.scene import Scene
from radwrap.scene.sources import emitters

Array = NDArray[np.float64]
StillRender = Callable[[Scene, Path, RenderOptions], Rendered]


@dataclass(frozen=True, slots=True, eq=False)
class ByRows:
    """An image whose rows have light of their own.

    Attributes
    ----------
    base : Rendered
        All rows with the largest level that each source has in any of them.
    image : Relit
        With its error.
    """

    base: Rendered
    image: Relit


def by_rows(scene: Scene, folder: Path, options: RenderOptions, render_still: StillRender) -> ByRows:
    """Render a light basis, and weigh its rows."""
    levels = row_levels(scene)
    largest = {name: float(level.max()) for name, level in levels.items()}
    base = render_still(lit_by(held(scene), largest), folder, replace(options, basis=True, frames=0))
    shares = {name: levels[name] / largest[name] for name in levels if largest[name] > 0}
    basis = weighed(read_basis(folder), _of_emitters(scene, shares))
    return ByRows(base, next(relit(basis, np.ones((1, len(basis.sources))))))


def _of_emitters(scene: Scene, shares: Mapping[str, Array]) -> dict[str, Array]:
    """The same by the names that a basis has: those of LEDs in place of their ring's."""
    return {
        name: shares[source.name]
        for source in scene.sources
        if source.name in shares
        for name in (source.name, *(emitter.source for emitter in emitters(source)))
    }


def weighed(basis: Basis, shares: Mapping[str, Array]) -> Basis:
    """The basis with a factor on each row of each source's light; all that its errors are made of likewise."""
    rows = np.stack([shares[name] for name in basis.sources]).astype(np.float32)
    columns = basis.sensor.columns
    sampled = np.zeros(0, dtype=np.intp) if basis.sample is None else basis.sample.pixels
    waves = None if basis.waves is None else basis.waves * rows[:, np.newaxis, :, np.newaxis]
    return replace(
        basis,
        images=basis.images * rows[:, np.newaxis, :, np.newaxis],
        grid=basis.grid * rows[:, np.newaxis, basis.grid_pixels // columns],
        lacks=basis.lacks * rows[:, np.newaxis, sampled // columns],
        waves=waves,
    )
