"""A scene in which nothing moves: each row of a light basis counts by how long each source shines into it.

No ray is traced for that, and the errors are those of the very gray levels, see `relit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

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

_ATTEMPTS: Final = 4  # each to half of the tolerance of the one before


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
    tolerance : float, optional
        That was asked for [gray level]; that of the base may be finer.
    rays : int
        That all bases took.
    tracer_cpu_s : float
        Processor time of these [s].
    image : Relit
        With its error.
    rows : RowsFile
        What each row's light is made of.
    """

    base: Rendered
    tolerance: float | None
    rays: int
    tracer_cpu_s: float
    image: Relit
    rows: RowsFile


def by_rows(scene: Scene, folder: Path, options: RenderOptions, render_still: StillRender) -> ByRows:
    """Render a light basis, and weigh its rows; by finer ones where that image misses the tolerance.

    A basis is held against rays where it errs in the light of all sources at their largest. Rows that a pulse misses
    may err elsewhere, and not much is known of that.
    """
    largest = {name: float(level.max()) for name, level in row_levels(scene).items()}
    then, options = lit_by(held(scene), largest), replace(options, basis=True, frames=0)
    asked: float | None = None
    rays, seconds = 0, 0.0
    for attempt in range(_ATTEMPTS):
        at = folder if attempt == 0 else folder.with_name(f"{folder.name}_{attempt}")
        base = render_still(then, at, options)
        rays, seconds = rays + base.run.rays, seconds + base.run.timing.tracer_cpu_s
        found = read_basis(at)
        rows = _rows_of(scene, largest, found, at)
        image = next(relit(weighed(found, row_shares(rows, scene.camera)), np.ones((1, len(found.sources)))))
        tolerance = base.run.tolerance
        asked = tolerance if asked is None else asked
        missed = asked is not None and image.certificate.rms_gray_upper95 > asked >= base.run.error.rms_gray_upper95
        if not missed or tolerance is None:
            break
        options = replace(options, tolerance=tolerance / 2)
    return ByRows(base, asked, rays, seconds, image, rows)


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
