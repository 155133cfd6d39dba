"""Tiles in the light of each source: which cells a pixel gathers from is found once, and what it sees is as before."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.imaging.methods import kernel
from radwrap.imaging.methods.by_source import gathered_sources
from radwrap.imaging.methods.central import Cells, central_image
from radwrap.imaging.methods.direct_gather import gathered_by_source
from radwrap.imaging.methods.kernel import (
    coarsened,
    decide_tile,
    gathered_each,
    has_small_footprints,
    lattice,
    plan_kernel,
)
from radwrap.imaging.methods.smooth_blocks import in_other_light, smooth_field
from radwrap.imaging.optics.view import LitView, View, look_at_depths
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import laid_out
from tests.imaging.test_smooth_blocks import LENS
from tests.tracers.belt import at, scene_of

NAMES = tuple(f"ring.led{number:02d}" for number in range(12))
BOX = {"type": "box", "name": "box", "material": "dark", "size": at(4.0, 4.0, 30.0), "position": at(-2.0, 1.0, 15.1)}
ROUNDING = 1e-12  # of the largest value: the same products, in another order
SEED = (3, 1)


def uncounted(_: int) -> None:
    """Nobody wants to know how many rays there are."""


def apart(found: Any, wanted: Any) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


@pytest.mark.parametrize(("depths", "few"), [pytest.param(1, True, marks=pytest.mark.long), (2, True), (2, False)])
def test_sums_over_traced_cells_are_sums_over_the_grid(depths: int, few: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a tall box the blur differs over the scene: each cell's light is shared between layers.

    Of a finer grid only the cells of twice the size may be few enough for sums.
    """
    with laid_out(scene_of(BOX, camera=LENS), RenderOptions(tracer="compiled")) as traced:
        view = traced.view()
        smooth = smooth_field(view, 4.0, 0.5)
        assert smooth is not None and smooth.share > 0.1
        seen = View(view.camera, view.tracer, smooth=smooth)
        met, _ = look_at_depths(view, 32, np.random.default_rng(1))
        plan = plan_kernel(seen, met if depths > 1 else met[:1], 0.3)
        assert (len(plan.layers) > 1) == (depths > 1) and has_small_footprints(plan, 2 * plan.grid.cell)
        if not few:
            for fewest in range(1, 1024):
                monkeypatch.setattr(kernel, "_FEW_CELLS", fewest)
                if has_small_footprints(plan, 2 * plan.grid.cell):
                    break
            assert not has_small_footprints(plan, plan.grid.cell)
        (together,) = traced.views_of(NAMES)
        lit = LitView(NAMES, View(view.camera, together.view.tracer, smooth=in_other_light(smooth, together.view)))
        cells = decide_tile(seen, plan, 0, SEED, uncounted)
        assert cells.samples and len(np.unique(cells.levels)) > 1
        pixels = [len(axis) for axis in lattice(2 * plan.grid.cell, plan.tiles[0])]
        kept = np.arange(0, pixels[0] * pixels[1], 7)
        found = list(gathered_sources(lit.view, plan, 0, cells, kept, seed=SEED, progress=uncounted))
        wanted = on_the_grid(lit, plan, cells)
    assert len(found) == len(wanted) == len(NAMES)
    for (values, change), one in zip(found, wanted, strict=True):
        assert apart(values, one.values) < ROUNDING
        assert np.abs(change - one.change.ravel()[kept]).max() < ROUNDING * np.abs(one.values).max()
    assert max(np.abs(change).max() for _, change in found) > 0


def on_the_grid(lit: LitView, plan: Any, cells: Cells) -> list[Any]:
    """Each source's light laid out in cells as small as the smallest, and gathered from there."""
    central = central_image(lit.view, plan.grid, cells, seed=SEED, progress=uncounted)
    of_all = type(central)(central.first, central.values.sum(axis=0), central.magnification, 0)
    return list(gathered_each(plan, plan.tiles[0], central, coarsened(central, coarsened(of_all))))


def test_a_cell_counts_as_often_as_a_pixel_gathers_from_it() -> None:
    """Four places belong to one cell of light 2, others to cells of light 0 and 10; two layers share each place."""
    numbers = np.array([[0, 0, 1], [0, 0, 2]])
    values = np.array([[2.0, 20.0], [0.0, 0.0], [10.0, 100.0]])
    shares = np.stack([np.full((2, 3), 0.25), np.full((2, 3), 0.75)])
    weights = np.stack([np.full((2, 2), 0.25), np.array([[0.0, 0.0], [0.0, 1.0]])])
    corners = np.array([0, 0]), np.array([0, 1])
    found = gathered_by_source(values, numbers, 1, shares=shares, weights=weights, corners=corners)
    # The first pixel sees even light; the second a quarter of the mean of 2, 0, 2 and 10, and three quarters of 10.
    second = 0.25 * 3.5 + 0.75 * 10
    assert found == pytest.approx(np.array([[2.0, 20.0], [second, 10 * second]]), rel=1e-15)
    # Squares of four places.
    square = np.ones((1, 1, 1))
    where = np.array([0]), np.array([0])
    whole = gathered_by_source(values, numbers[:, 1:], 2, shares=square, weights=square, corners=where)
    assert whole == pytest.approx(np.array([[(2 + 0 + 2 + 10) / 4, 35.0]]), rel=1e-15)
