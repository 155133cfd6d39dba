"""Diffraction under wide lights: rays ask some of their points, and neither noise nor steps of these cost more rays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

pytest.importorskip("numba")

from radwrap.imaging.methods.smooth_blocks import in_other_light
from radwrap.imaging.optics.view import trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.survey import survey, with_smooth_blocks
from radwrap.imaging.tolerance.wave_gather import kept_transforms
from radwrap.imaging.tolerance.wave_image import visible_gray
from radwrap.imaging.tolerance.wave_parts import wave_cells, wave_parts, wave_tile
from radwrap.imaging.tolerance.wave_plan import known_to, plan_waves
from radwrap.imaging.tracing import laid_out
from radwrap.scene.aberrations import Wavefront
from radwrap.scene.scene import Scene
from tests.imaging.test_smooth_blocks import LENS
from tests.tracers.belt import at, scene_of

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


def test_no_ray_goes_where_nothing_changes_but_smoothly() -> None:
    """Under LEDs, which have no noise, what is known of smooth blocks is what rays would see there."""
    with laid_out(scene_of(BOX, camera=LENS), COMPILED) as traced:
        view = traced.view()
        seen = with_smooth_blocks(view, survey(view, 0), 0.5, 0)
        assert seen.smooth is not None and seen.smooth.share > 0.2
        parts = []
        for one in (seen, replace(seen, smooth=None)):
            plan = plan_waves(one, 550e-9, 0.5, 0)
            parts.append(wave_parts(one, [(one, plan)], 2, progress=lambda _: None))
        # Of images that are compared no light decides where rays go.
        even = plan_waves(seen, 550e-9, 0.5, 0, even_cell=0.5)
        assert even.smooth is None and known_to(seen, even) is None and known_to(seen, plan) is seen.smooth
        sensor = view.camera.sensor
        v, u = np.indices((sensor.rows, sensor.columns), dtype=np.float64)
        light = trace_rays(view, None, u.ravel(), v.ravel())[0].reshape(v.shape)
    with_smooth, without = (visible_gray(view.exposure_of_radiance, sensor)(light + made.change) for made in parts)
    assert np.abs(with_smooth - gray_levels(light * view.exposure_of_radiance, sensor)).max() > 0.5
    assert np.sqrt(((with_smooth - without) ** 2).mean()) < 0.05
    assert parts[0].rays < 0.9 * parts[1].rays  # beside the sensor all are traced


@pytest.mark.long
def test_smaller_blocks_too_are_known_in_other_light() -> None:
    """Each source of two wide ones: its waves once had the light of both, where blocks are small."""
    with laid_out(scene_with("on", sources=[BAR, DOME]), COMPILED) as traced:
        view = traced.view()
        field = with_smooth_blocks(view, survey(view, 0), 0.5, 0).smooth
        assert field is not None and field.finer is not None
        random, sensor = np.random.default_rng(0), view.camera.sensor
        u, v = (random.uniform(-0.5, size - 0.5, 4000) for size in (sensor.columns, sensor.rows))
        small = field.finer.holds(u, v)
        assert small.sum() > 100
        of_both = 0.0
        for name in ("bar", "dome"):
            alone = traced.view_of(name)
            known = in_other_light(field, alone).at(u[small], v[small])[0]
            seen = trace_rays(alone.with_noise(-4), None, u[small], v[small])[0]
            assert known.mean() == pytest.approx(seen.mean(), rel=0.02)
            of_both = of_both + known
        assert of_both == pytest.approx(field.at(u[small], v[small])[0], rel=0.2)


def test_a_tile_of_smooth_blocks_has_the_sum_of_the_weights() -> None:
    """As its cells would say, but for how little light bends between their corners; no ray is taken."""
    with laid_out(scene_of(camera=LENS), COMPILED) as traced:
        view = traced.view()
        seen = with_smooth_blocks(view, survey(view, 0), 0.5, 0)
        plan = plan_waves(seen, 550e-9, 2.0, 0)
        rows, columns = (round(far) + 2 for far in plan.kernel.reach_px[::-1])
        sensor = view.camera.sensor
        inside = (rows, sensor.rows - rows, columns, sensor.columns - columns)
        plan = replace(plan, kernel=replace(plan.kernel, tiles=(inside,)))
        taken: list[int] = []
        cells = wave_cells(seen, plan, 0, taken.append)
        general = wave_cells(seen, replace(plan, smooth=None), 0, taken.append)
        assert cells.samples == 0 and general.samples
        # Coma moves a point's light to one side, which the sum of the weights does not tell.
        assert view.camera.lens is not None
        coma = Wavefront(view.camera.aperture.diameter, ((3, 1), (3, -1)), ((1e-7, 0.0),))
        camera = replace(view.camera, lens=replace(view.camera.lens, glass=coma))
        behind_glass = replace(plan, kernel=replace(plan.kernel, camera=camera))
        assert wave_cells(seen, behind_glass, 0, lambda _: None).samples
        taken.clear()
        found, wanted = (
            next(wave_tile(seen, [plan], (0, 0), each, taken.append, transforms=kept_transforms()))
            for each in (cells, general)
        )
    assert not sum(taken)
    assert np.abs(wanted[0]).max() > 0
    assert np.abs(found[0] - wanted[0]).max() < 0.01 * np.abs(wanted[0]).max()
    assert not found[1].any() and not found[2].any()
