"""Light from beyond the guard band: the coarse image, seen from pixels."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from radwrap.imaging.optics.smooth import SmoothField, corners_of
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.tolerance.wave_far import (
    _interpolated,
    _kernel,
    _rings,
    far_change,
    far_light,
    far_rays,
    strata_for,
)
from radwrap.imaging.tolerance.wave_plan import plan_waves
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, Planes, camera


@pytest.mark.parametrize("shape", [(5, 7), (1, 3), (2, 2)])
def test_between_blocks_light_is_as_scipy_has_it(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(1)
    values, rows, columns = random.random(shape), random.uniform(-2, 9, 13), random.uniform(-2, 9, 11)
    told = map_coordinates(values, np.meshgrid(rows, columns, indexing="ij"), order=1, mode="nearest")
    found = _interpolated(_interpolated(values, rows, 0), columns, 1)
    assert found == pytest.approx(told, rel=1e-14)


@pytest.mark.parametrize("times", [2.0, 4.0, 12.0])
def test_light_from_beyond_the_first_ring_is_its_share_of_the_tail(times: float) -> None:
    """Dark but for what lies farther than a radius: a pixel on the axis gets the tail's share beyond it.

    The last ring ends somewhere: what comes from there on is taken to be as the rest of it.
    """
    pixel = 1e-5
    plain = camera(Aperture("round", 2e-4), rows=9, columns=9, pixel=(pixel, pixel))
    view = View(plain, Planes(((1.0, lambda x, y: np.zeros_like(x)),)))  # type: ignore[arg-type]
    plan = plan_waves(view, 550e-9, 0.1, 1, even_cell=0.5)
    first, *_, last = _rings(plan)
    radius = times * first.far

    def lit(x: Array, y: Array) -> Array:
        # The field's falloff is taken out.
        bright: Array = np.where(np.hypot(x, y) > radius * pixel / plain.image_distance, 1.0, 0.0)
        return bright * (1 + x**2 + y**2) ** 2

    view = View(plain, Planes(((1.0, lit),)))  # type: ignore[arg-type]
    (around,) = far_light(view, plan, 0, lambda rays: None)
    change, _ = far_change(plan, around)
    tail = plan.waves.tail(radius * pixel)
    begins, ends = (plan.waves.tail(far * pixel) for far in (last.near, last.far))
    expected = begins * (tail - ends) / (begins - ends) if radius > last.near else tail
    assert change[4, 4] == pytest.approx(expected, rel=0.1)
    assert expected == pytest.approx(tail, rel=0.2)


def test_what_is_known_of_smooth_blocks_is_not_traced_again() -> None:
    """Light that grows evenly: blocks on the sensor, of four rays each, are known exactly; others are not."""
    plain = camera(Aperture("round", 2e-4), rows=40, columns=40, pixel=(1e-5, 1e-5))

    def lit(x: Array, y: Array) -> Array:
        return (2 + 100 * x) * (1 + x**2 + y**2) ** 2  # the field's falloff is taken out

    view = View(plain, Planes(((1.0, lit),)))  # type: ignore[arg-type]
    first, shape = (0, 0), (5, 5)
    u, v = corners_of(first, shape)
    values, m = trace_rays(view, None, u.ravel(), v.ravel(), with_depth=True)
    corners = u.shape
    field = SmoothField(
        first,
        np.ones(shape, dtype=bool),
        values.reshape(corners),
        m.reshape(corners),
        np.ones(shape, dtype=bool),
        0.0,
        0.0,
        0,
        np.zeros(corners, dtype=np.int8),
    )
    counts, found = [], []
    for one in (view, replace(view, smooth=field)):
        plan, rays = plan_waves(one, 550e-9, 0.1, 1), list[int]()
        found.append(far_light(one, plan, 0, rays.append))
        counts.append(sum(rays))
        assert sum(rays) == pytest.approx(far_rays(plan), rel=0.02)
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert counts[0] - counts[1] > 130


def test_fewer_rays_make_far_light_noisier_and_else_no_different() -> None:
    """One ray a block in place of up to nine: the same in the mean of many, and noise is told by what is seen."""
    plain = camera(Aperture("round", 2e-4), rows=12, columns=12, pixel=(1e-5, 1e-5))

    def lit(x: Array, y: Array) -> Array:
        bright: Array = np.where((np.floor(3e4 * x) + np.floor(3e4 * y)) % 2 > 0, 40.0, 0.0)  # finer than blocks
        return bright * (1 + x**2 + y**2) ** 2

    view = View(plain, Planes(((1.0, lit),)))  # type: ignore[arg-type]
    plan = plan_waves(view, 550e-9, 0.1, 1, even_cell=0.5)
    means, spreads = [], []
    for strata in (1, 3):
        one = replace(plan, far_strata=strata)
        rays = list[int]()
        found = np.array([far_change(one, *far_light(view, one, k, rays.append))[0] for k in range(40)])
        assert sum(rays) / 40 == pytest.approx(far_rays(one), rel=0.02)
        means.append(found.mean(axis=0))
        spreads.append(float(found.std(axis=0).mean()))
    # All light of a block is noise, 20 about a mean of 20. Seven eighths of it come from the first ring, and blocks are
    # mixed with their neighbours.
    expected = 20 * abs(plan.weights.share) * math.sqrt(float((_kernel(plan, _rings(plan)[0]) ** 2).sum()))
    assert 0.6 * expected < spreads[0] < 0.9 * expected
    assert spreads[1] < spreads[0] / 2
    assert means[0] == pytest.approx(means[1], abs=4 * expected / math.sqrt(40))
    # Noise of 20 gray levels a ray, and what is allowed of it: n x n rays have an n-th of it.
    for part, strata in ((1.01, 1), (0.51, 2), (0.34, 3), (0.01, 3)):
        assert strata_for(plan, 20.0, part * expected) == strata


@pytest.mark.long
def test_what_waves_send_farther_does_not_hang_on_the_cells() -> None:
    """The weights lie on a grid that ends: what goes round on it was a twentieth of that share for fine cells."""
    view = View(camera(Aperture("round", 1e-4), rows=9, columns=9, pixel=(1e-5, 1e-5)), Planes(()))  # type: ignore[arg-type]
    shares = [plan_waves(view, 550e-9, 0.1, 1, even_cell=cell).weights.share for cell in (0.5, 0.25, 0.125)]
    assert shares == pytest.approx([shares[0]] * len(shares), rel=0.01)
