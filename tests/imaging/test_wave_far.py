"""Light from beyond the guard band: the coarse image, seen from pixels."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.wave_far import _interpolated, _rings, far_change, far_light, far_rays
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


@pytest.mark.parametrize("times", [2.0, 4.0])
def test_light_from_beyond_the_first_ring_is_its_share_of_the_tail(times: float) -> None:
    """Dark but for what lies farther than a radius: a pixel on the axis gets the tail's share beyond it.

    The second ring ends somewhere: what comes from there on is taken to be as the rest of it.
    """
    pixel = 1e-5
    plain = camera(Aperture("round", 2e-4), rows=9, columns=9, pixel=(pixel, pixel))
    view = View(plain, Planes(((1.0, lambda x, y: np.zeros_like(x)),)))  # type: ignore[arg-type]
    plan = plan_waves(view, 550e-9, 0.1, 1, even_cell=0.5)
    first, second = _rings(plan)
    radius = times * first.far

    def lit(x: Array, y: Array) -> Array:
        # The field's falloff is taken out.
        bright: Array = np.where(np.hypot(x, y) > radius * pixel / plain.image_distance, 1.0, 0.0)
        return bright * (1 + x**2 + y**2) ** 2

    view = View(plain, Planes(((1.0, lit),)))  # type: ignore[arg-type]
    (around,) = far_light(view, plan, 0, lambda rays: None)
    change, _ = far_change(plan, around)
    begins, ends = (plan.waves.tail(far * pixel) for far in (first.far, second.far))
    expected = begins * (plan.waves.tail(radius * pixel) - ends) / (begins - ends)
    assert change[4, 4] == pytest.approx(expected, rel=0.1)
    assert expected == pytest.approx(plan.waves.tail(radius * pixel), rel=0.5)


def test_far_light_takes_as_many_rays_as_what_it_may_be_off_by_needs() -> None:
    """A pattern finer than blocks, 1 or 0 alike often: the noise of one ray in each block is known."""
    pixel = 1e-5
    plain = camera(Aperture("round", 2e-4), rows=40, columns=40, pixel=(pixel, pixel))
    random = np.random.default_rng(0)

    def lit(x: Array, y: Array) -> Array:
        return random.integers(2, size=x.shape).astype(float) * (1 + x**2 + y**2) ** 2

    view = View(plain, Planes(((1.0, lit),)))  # type: ignore[arg-type]
    many = plan_waves(view, 550e-9, 0.1, 1)
    few = plan_waves(view, 550e-9, 0.1, 1, seen=1.0)
    assert far_rays(few) < 0.75 * far_rays(many)
    off = []
    for seed in range(8):
        (around,) = far_light(view, replace(few, seed=seed), 0, lambda rays: None)
        off.append(abs(few.weights.share) * (around - 0.5))
    # A ray is off by 1/2, where light that is seen as 1 lets it be off by as much as it is.
    assert 0 < float(np.sqrt(np.mean(np.square(off)))) <= few.far_noise


@pytest.mark.long
def test_what_waves_send_farther_does_not_hang_on_the_cells() -> None:
    """The weights lie on a grid that ends: what goes round on it was a twentieth of that share for fine cells."""
    view = View(camera(Aperture("round", 1e-4), rows=9, columns=9, pixel=(1e-5, 1e-5)), Planes(()))  # type: ignore[arg-type]
    shares = [plan_waves(view, 550e-9, 0.1, 1, even_cell=cell).weights.share for cell in (0.5, 0.25, 0.125)]
    assert shares == pytest.approx([shares[0]] * len(shares), rel=0.01)
