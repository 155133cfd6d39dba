"""A rehearsal of what waves add to an image: some tiles of it are made, and timed."""

from __future__ import annotations

from dataclasses import dataclass, replace

from radwrap.imaging.forecast.rehearsal import Rehearsed, Stopwatch, for_a_while, seconds_per_ray
from radwrap.imaging.methods.central import Cells
from radwrap.imaging.optics.view import LitView, View
from radwrap.imaging.tolerance.own_rays import strips_beside
from radwrap.imaging.tolerance.wave_far import far_rays, far_view
from radwrap.imaging.tolerance.wave_gather import kept_transforms
from radwrap.imaging.tolerance.wave_parts import (
    sampling_of_all,
    wave_cells,
    wave_images,
    wave_tile,
    waves_of,
)
from radwrap.imaging.tolerance.wave_plan import WavePlan


@dataclass(frozen=True, slots=True)
class ForeseenWaves:
    """By which rays waves are expected to be taken.

    Attributes
    ----------
    plan : WavePlan
        Where they go.
    replicates : int
        How many sets of them.
    by_own_rays : bool
        Whether these are the image's own, so that only light beside it is traced.
    """

    plan: WavePlan
    replicates: int
    by_own_rays: bool


def rehearsed_waves(view: View, waves: ForeseenWaves, wavelengths: int, *, lit: LitView | None = None) -> Rehearsed:
    """What waves of an image take, by some of its tiles.

    Parameters
    ----------
    view : View
        Of the image.
    waves : ForeseenWaves
        By which rays.
    wavelengths : int
        In the light of how many each.
    lit : LitView, optional
        The light of some sources, each of which gets its waves by the very same rays.
    """
    plan = waves.plan
    traced, plans = (view, [plan]) if lit is None else (replace(lit.view, workers=1), [plan] * len(lit.names))
    of_all = None if lit is None or len(lit.names) > 1 else view
    rays, cells_seen, pixels, decided = [0, 0], 0.0, 0, dict[int, Cells]()
    deciding = tracing = gathering = 0.0
    clock = Stopwatch(view.workers)
    for tile in for_a_while(len(plan.kernel.tiles)):
        counted: list[int] = []
        decided[tile] = wave_cells(view, plan, tile, counted.append)
        rays[0] += sum(counted)
        deciding += clock.lap()
        counted.clear()
        cells = decided[tile].with_rays(plan.kernel.grid.levels, sampling_of_all(plan, decided))
        which, transforms = (tile, 0), kept_transforms()
        if cells.samples:
            images = wave_images(traced, plan, which, cells, counted.append, of_all=of_all)
            tracing += clock.lap()
            gathered = waves_of(plans, tile, *images, transforms=transforms)
        else:
            gathered = wave_tile(traced, plans, which, cells, counted.append, transforms=transforms)
        for _ in gathered:
            pass
        gathering += clock.lap()
        rays[1] += sum(counted)
        cells_seen += cells.levels.size
        r0, r1, c0, c1 = plan.kernel.tiles[tile]
        pixels += (r1 - r0) * (c1 - c0)
    often, sets = plan.kernel.camera.sensor.pixels / pixels, waves.replicates * wavelengths
    beside = often
    if waves.by_own_rays:
        beside = sum((r1 - r0) * (c1 - c0) for r0, r1, c0, c1 in strips_beside(plan)) / max(cells_seen, 1)
    far = far_rays(plan, beside=waves.by_own_rays)
    each = seconds_per_ray(far_view(traced, plan)) / view.workers
    near = beside * (deciding + tracing * sets) + often * gathering * sets
    return Rehearsed(near + far * sets * each, beside * (rays[0] + rays[1] * sets) + far * sets)
