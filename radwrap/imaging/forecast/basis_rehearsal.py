"""A rehearsal of a light basis: some tiles are traced in the light of some sources, and timed."""

from __future__ import annotations

from radwrap.imaging.forecast.rehearsal import Stopwatch, for_a_while
from radwrap.imaging.optics.view import LitView
from radwrap.imaging.relight.basis import freeze_tile
from radwrap.imaging.tolerance.replicates import Plan, Work


def rehearsed_basis(work: Work, plan: Plan, replicates: int, lit: LitView) -> float:
    """How long an image's rays take again in the light of some sources [s], by some of its tiles.

    Parameters
    ----------
    work : Work
        Where and by whom; the folder is for the rehearsal only.
    plan : KernelPlan, RaysPlan or HybridPlan
        Of the image in the light of all.
    replicates : int
        How many of it.
    lit : LitView
        The light of those sources.
    """
    in_one_pass, pixels, seconds = len(lit.names) > 1, 0, 0.0
    for tile in for_a_while(len(plan.tiles)):
        # What the image's own tiles decide is there before its basis is made.
        freeze_tile(work, plan, 0, tile, in_one_pass=True)
        clock = Stopwatch(work.view.workers)
        for _ in freeze_tile(work, plan, 0, tile, in_one_pass=in_one_pass).trace(lit, work.progress.add):
            pass
        # One thread had the tile, where the run has one for each.
        seconds += clock.lap()
        r0, r1, c0, c1 = plan.tiles[tile]
        pixels += (r1 - r0) * (c1 - c0)
    return seconds * replicates * plan.camera.sensor.pixels / pixels
