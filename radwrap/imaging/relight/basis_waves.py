"""What waves add to each source's light in a basis: traced tile by tile, as its images are.

Light adds, whatever its source, and so does what waves do to it. The rays are
those that were decided in the light of all sources.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.pieces import log_call
from radwrap.imaging.optics.diffraction import Light
from radwrap.imaging.optics.view import LitView
from radwrap.imaging.relight.basis_pieces import BasisPieces
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.wave_far import far_change, far_light
from radwrap.imaging.tolerance.wave_gather import kept_transforms
from radwrap.imaging.tolerance.wave_parts import wave_cells, wave_tile
from radwrap.imaging.tolerance.wave_plan import WavePlan


@dataclass(frozen=True, slots=True, eq=False)
class BasisWaves:
    """Waves of a basis.

    Attributes
    ----------
    work : Work
        The run, in the light of all sources.
    plan : WavePlan
        Which rays.
    pieces : BasisPieces
        Where finished pieces are.
    views : tuple of LitView
        The views of the pieces, which know the smooth blocks of the plan.
    replicates : int
        As many as the images have.
    lights : tuple of Light
        Which wavelength stands for which sources.
    plans : tuple of WavePlan
        The same rays for each of them.
    """

    work: Work
    plan: WavePlan
    pieces: BasisPieces
    views: tuple[LitView, ...]
    replicates: int
    lights: tuple[Light, ...]
    plans: tuple[WavePlan, ...]

    @property
    def description(self) -> dict[str, Any]:
        """What `basis.json` tells of them; the first wavelength is of the light of all."""
        wavelengths = [light.wavelength for light in self.lights]
        return {"wavelength": self.plan.waves.wavelength, "wavelengths": wavelengths}

    def kinds(self) -> Iterator[str]:
        """Kinds of pieces."""
        yield from (self._kind(replicate, tile) for replicate, tile in self._tiles())
        yield from map(self._around, range(self.replicates))

    def jobs(self) -> Iterator[Callable[[], None]]:
        """What is still to be traced."""
        for tile in range(len(self.plan.kernel.tiles)):
            due = {replicate: self.pieces.due(self._kind(replicate, tile)) for replicate in range(self.replicates)}
            if any(due.values()):
                yield partial(self._trace_tile, tile, due)
        for replicate in range(self.replicates):
            yield from (
                partial(self._trace_around, replicate, view) for view in self.pieces.due(self._around(replicate))
            )

    def replicate(self, view: int, replicate: int) -> NDArray[np.float32]:
        """What waves add to a view's sources, and what their cells may change, shape (2, sources, rows, columns)."""
        sensor = self.plan.kernel.camera.sensor
        found = np.empty((2, len(self.views[view].names), sensor.rows, sensor.columns), dtype=np.float32)
        for tile, (r0, r1, c0, c1) in enumerate(self.plan.kernel.tiles):
            for number, rows in enumerate(self.pieces.each(self._kind(replicate, tile), view)):
                found[:, number, r0:r1, c0:c1] = rows.reshape(2, r1 - r0, c1 - c0)
        around = self.pieces.each(self._around(replicate), view)
        for number, (plan, light) in enumerate(zip(self._plans(view), around, strict=True)):
            found[0, number] += far_change(plan, light.astype(np.float64))[0].astype(np.float32)
        return found

    def beyond(self, view: int, change: NDArray[np.float32]) -> NDArray[np.float32]:
        """What light may change that comes from farther than was looked at, and other wavelengths than the one taken.

        Parameters
        ----------
        view : int
            Of which sources.
        change : ndarray, shape (sources, rows, columns)
            What waves add.

        Returns
        -------
        ndarray, shape (sources, rows, columns)
        """
        each = [self.pieces.each(self._around(replicate), view) for replicate in range(self.replicates)]
        around: NDArray[np.float64] = np.asarray(each, dtype=np.float64).mean(axis=0)  # of each source
        spreads = [self.lights[number].spread for number in self._of_sources(view)]
        found = [
            (far_change(plan, light)[1] + spread * np.abs(by_waves)).astype(np.float32)
            for plan, light, spread, by_waves in zip(self._plans(view), around, spreads, change, strict=True)
        ]
        return np.stack(found)

    def _of_sources(self, view: int) -> list[int]:
        """Numbers of the lights that the sources of a view belong to."""
        return [
            next(number for number, light in enumerate(self.lights) if light.names is None or name in light.names)
            for name in self.views[view].names
        ]

    def _plans(self, view: int) -> list[WavePlan]:
        return [self.plans[number] for number in self._of_sources(view)]

    def _tiles(self) -> Iterator[tuple[int, int]]:
        tiles = range(len(self.plan.kernel.tiles))
        return ((replicate, tile) for replicate in range(self.replicates) for tile in tiles)

    @staticmethod
    def _kind(replicate: int, tile: int) -> str:
        return f"waves_{replicate:03d}_{tile:05d}"

    def _trace_tile(self, tile: int, due: dict[int, list[int]]) -> None:
        of_all, count = replace(self.work.view, workers=1), self.work.progress.add
        cells, transforms = wave_cells(of_all, self.plan, tile, count), kept_transforms()
        for replicate, view in ((replicate, view) for replicate, views in due.items() for view in views):
            kind, lit = self._kind(replicate, tile), self.views[view]
            log_call(self.pieces.folder, f"{kind} {view}")
            alone = of_all if len(lit.names) == 1 else None
            one, plans = replace(lit.view, workers=1), self._plans(view)
            traced = wave_tile(one, plans, (tile, replicate), cells, count, transforms=transforms, of_all=alone)
            self.pieces.write(kind, view, (part.ravel() for change, off, _ in traced for part in (change, off)))

    @staticmethod
    def _around(replicate: int) -> str:
        return f"waves_around_{replicate:03d}"

    def _trace_around(self, replicate: int, view: int) -> None:
        kind = self._around(replicate)
        log_call(self.pieces.folder, f"{kind} {view}")
        lit = replace(self.views[view].view, workers=1)
        around = far_light(lit, self.plan, replicate, self.work.progress.add)
        self.pieces.write(kind, view, around.reshape(-1, around.shape[-1]))
