"""Diffraction under wide lights: rays ask some of their points, and neither noise nor steps of these cost more rays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

pytest.importorskip("numba")

from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.survey import survey, with_smooth_blocks
from radwrap.imaging.tolerance.wave_parts import wave_cells
from radwrap.imaging.tolerance.wave_plan import plan_waves
from radwrap.imaging.tracing import laid_out
from radwrap.scene.scene import Scene
from tests.imaging.test_smooth_blocks import LENS
from tests.tracers.test_compiled_smooth import at, scene_of

COMPILED = RenderOptions(tracer="compiled", tolerance=0.5)
BAR = {
    "type": "rectangle",
    "name": "bar",
    "position": at(0.0, 80.0, 120.0),
    "look_at": at(0.0, 0.0, 0.0),
    "size": ["100 mm", "30 mm"],
    "radiance": "300 W/m^2/sr",
}
DOME = {
    "type": "dome",
    "name": "dome",
    "position": at(0.0, 0.0, 10.0),
    "look_at": at(0.0, 0.0, 0.0),
    "diameter": "400 mm",
    "opening_diameter": "90 mm",
    "radiance": "30 W/m^2/sr",
}
BOX = {"type": "box", "name": "box", "material": "dark", "size": at(4.0, 4.0, 12.0), "position": at(-2.0, 1.0, 6.1)}


def scene_with(diffraction: str, **changes: Any) -> Scene:
    return scene_of(BOX, camera={**LENS, "diffraction": diffraction}, **{"sources": [BAR], **changes})


def test_half_shadows_are_not_cut_for_waves() -> None:
    """Blocks that a sample found smooth: few points of a light, the same for all rays, would make steps of them."""
    with laid_out(scene_with("on", sources=[DOME]), COMPILED) as traced:
        view = traced.view()
        seen = with_smooth_blocks(view, survey(view, 0), 0.5, 0)
        assert seen.smooth is not None
        plan = plan_waves(seen, 550e-9, 2.0, 0)
        assert plan.smooth is seen.smooth
        cells = wave_cells(seen, plan, 0, lambda _: None)
        without = wave_cells(seen, replace(plan, smooth=None), 0, lambda _: None)
        rows, columns = (
            (first + np.arange(size) + 0.5) * plan.kernel.grid.cell - 0.5
            for first, size in zip(cells.first, cells.levels.shape, strict=True)
        )
        u, v = np.meshgrid(columns, rows)
        # A base cell that lies in smooth blocks, as its neighbours do.
        reach = round(2 * plan.kernel.grid.base / plan.kernel.grid.cell)
        inside = minimum_filter(seen.smooth.holds(u, v), 2 * reach + 1, mode="constant")
    # What is left are steep slopes of light.
    assert (cells.levels[inside] > 0).mean() < 0.5 * (without.levels[inside] > 0).mean()
    assert cells.rays < without.rays and cells.levels.any()
    # LEDs are points to all rays: their images keep their cells.
    with laid_out(scene_of(BOX, camera=LENS), COMPILED) as traced:
        view = traced.view()
        assert plan_waves(with_smooth_blocks(view, survey(view, 0), 0.5, 0), 550e-9, 2.0, 0).smooth is None
