"""A rehearsal of what waves add to an image: some tiles of it are made, and timed."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Final

from radwrap.imaging.forecast.rehearsal import Rehearsed, Stopwatch, seconds_per_ray, spread
from radwrap.imaging.optics.view import LitView, View
from radwrap.imaging.tolerance.wave_far import far_rays, far_view
from radwrap.imaging.tolerance.wave_parts import Transforms, wave_cells, wave_tile
from radwrap.imaging.tolerance.wave_plan import WavePlan

# Tiles are made until so long has passed, and so many at least unless they are slow.
_ENOUGH: Final = 0.5  # s
_TOO_LONG: Final = 2.0  # s
_FEWEST_TILES: Final = 4


def rehearsed_waves(
    view: View, plan: WavePlan, replicates: int, wavelengths: int, *, lit: LitView | None = None
) -> Rehearsed:
    """What waves of an image take, by some of its tiles.

    Parameters
    ----------
    view : View
        Of the image.
    plan : WavePlan
        By which rays.
    replicates, wavelengths : int
        How many sets of rays, and in the light of how many wavelengths each.
    lit : LitView, optional
        The light of some sources, each of which gets its waves by the very same rays.
    """
    traced, plans = (view, [plan]) if lit is None else (replace(lit.view, workers=1), [plan] * len(lit.names))
    of_all = None if lit is None or len(lit.names) > 1 else view
    tiles, rays, pixels = spread(len(plan.kernel.tiles)), [0, 0], 0
    deciding = making = 0.0
    begun, clock = time.monotonic(), Stopwatch(view.workers)
    for done, tile in enumerate(tiles):
        passed = time.monotonic() - begun
        if passed > _TOO_LONG or (done >= _FEWEST_TILES and passed > _ENOUGH):
            break
        counted: list[int] = []
        cells = wave_cells(view, plan, tile, counted.append)
        rays[0] += sum(counted)
        deciding += clock.lap()
        counted.clear()
        for _ in wave_tile(traced, plans, (tile, 0), cells, counted.append, transforms=Transforms(), of_all=of_all):
            pass
        rays[1] += sum(counted)
        making += clock.lap()
        r0, r1, c0, c1 = plan.kernel.tiles[tile]
        pixels += (r1 - r0) * (c1 - c0)
    often, sets = plan.kernel.camera.sensor.pixels / pixels, replicates * wavelengths
    far = far_rays(plan)
    each = seconds_per_ray(far_view(traced, plan)) / view.workers
    return Rehearsed(
        often * (deciding + making * sets) + far * sets * each, often * (rays[0] + rays[1] * sets) + far * sets
    )
