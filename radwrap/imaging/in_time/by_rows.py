"""A scene in which nothing moves: each row of a light basis counts by how long each source shines into it.

No ray is traced for that, and the errors are those of the very gray levels, see `relit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.relight.relit import Basis, Relit, read_basis, relit
from radwrap.imaging.relight.row_shares import row_shares, weighed
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.run_files import BASES, RowsFile
from radwrap.scene.instants import held, lit_by, row_levels
from radwrap.scene.scene import Scene
from radwrap.scene.sources import emitters

Array = NDArray[np.float64]


class StillRender(Protocol):
    """Renders a scene at one instant into a folder."""

    def __call__(
        self, scene: Scene, folder: Path, options: RenderOptions, /, *, instants_left: int | None = None
    ) -> Rendered:
        """The render; `instants_left` are to follow, where it is one of several."""


@dataclass(frozen=True, slots=True, eq=False)
class ByRows:
    """An image whose rows have light of their own.

    Attributes
    ----------
    base : Rendered
        All rows with the largest level that each source has in any of them.
    image : Relit
        With its error.
    rows : RowsFile
        What each row's light is made of.
    """

    base: Rendered
    image: Relit
    rows: RowsFile


def by_rows(scene: Scene, folder: Path, options: RenderOptions, render_still: StillRender) -> ByRows:
    """Render a light basis, and weigh its rows."""
    largest = {name: float(level.max()) for name, level in row_levels(scene).items()}
    base = render_still(lit_by(held(scene), largest), folder, replace(options, basis=True, frames=0))
    found = read_basis(folder)
    rows = _rows_of(scene, largest, found, folder)
    basis = weighed(found, row_shares(rows, scene.camera))
    return ByRows(base, next(relit(basis, np.ones((1, len(basis.sources))))), rows)


def _rows_of(scene: Scene, largest: Mapping[str, float], basis: Basis, folder: Path) -> RowsFile:
    """By the names that a basis has: those of LEDs in place of their ring's."""
    ring_of = {
        name: source.name
        for source in scene.sources
        for name in (source.name, *(emitter.source for emitter in emitters(source)))
    }
    pulsed = {name: strobe for name, ring in ring_of.items() if (strobe := scene.strobes.get(ring)) is not None}
    return RowsFile(
        basis=f"{BASES}/{folder.name}",
        largest={name: largest[ring_of[name]] for name in basis.sources},
        strobes={name: strobe for name, strobe in pulsed.items() if name in basis.sources},
        missed={name: strobe for name, strobe in pulsed.items() if largest[ring_of[name]] == 0},
    )
