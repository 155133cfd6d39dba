"""A rehearsal of what waves add to an image: some tiles of it are made, and timed."""

from __future__ import annotations

from dataclasses import replace

from radwrap.imaging.forecast.rehearsal import Rehearsed, Stopwatch, for_a_while, seconds_per_ray
from radwrap.imaging.methods.central import Cells
from radwrap.imaging.optics.view import LitView, View
from radwrap.imaging.tolerance.wave_far import far_rays, far_view
from radwrap.imaging.tolerance.wave_parts import kept_transforms, sampling_of_all, wave_cells, wave_tile
from radwrap.imaging.tolerance.wave_plan import WavePlan


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
    rays, pixels, decided = [0, 0], 0, dict[int, Cells]()
    deciding = making = 0.0
    clock = Stopwatch(view.workers)
    for tile in for_a_while(len(plan.kernel.tiles)):
        counted: list[int] = []
        decided[tile] = wave_cells(view, plan, tile, counted.append)
        rays[0] += sum(counted)
        deciding += clock.lap()
        counted.clear()
        cells = decided[tile].with_rays(plan.kernel.grid.levels, sampling_of_all(plan, decided))
        for _ in wave_tile(
            traced, plans, (tile, 0), cells, counted.append, transforms=kept_transforms(), of_all=of_all
        ):
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
