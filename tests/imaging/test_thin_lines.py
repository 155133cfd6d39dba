"""What waves add to a bright line that is far thinner than they blur it: base cells may not step over it."""

from __future__ import annotations

import numpy as np
import pytest

from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.wave_parts import wave_parts
from radwrap.imaging.tolerance.wave_plan import plan_waves
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, Planes, camera

WAVELENGTH, PIXEL, SIDE, ROWS, COLUMNS = 550e-9, 2e-6, 1e-4, 20, 80
DARK, BRIGHT = 0.025, 1.0
WIDTH = 2.0  # px; waves of the pinhole blur by 27
RIGHT = 0.1  # of what waves change, rms: noise, and cells


def line(place: float) -> View:
    """A line of some pixels at a place [px] from the middle of the columns, at 1 m."""
    plain = camera(Aperture("square", SIDE), rows=ROWS, columns=COLUMNS, pixel=(PIXEL, PIXEL))
    m = PIXEL / plain.image_distance

    def bright(x: Array, y: Array) -> Array:
        # The field's falloff is taken out.
        light: Array = np.where(np.abs(x / m - place) < WIDTH / 2, BRIGHT, DARK) * (1 + x**2 + y**2) ** 2
        return light

    return View(plain, Planes(((1.0, bright),)))  # type: ignore[arg-type]


def change_by_closed_form(view: View, place: float) -> Array:
    """Of a square opening each direction goes by itself: its transfer less that of rays, over the line's spectrum."""
    seen = view.camera
    v, m = seen.image_distance, float(seen.magnification(1.0))
    f, step = np.linspace(0, 1.2 / PIXEL, 40001, retstep=True)
    width = np.maximum(SIDE - WAVELENGTH * v * f, 0.0)
    rays, waves = np.sinc(m * f * SIDE), width / SIDE * np.sinc(m * f * width)
    spectrum = (BRIGHT - DARK) * WIDTH * PIXEL * np.sinc(f * WIDTH * PIXEL) * np.sinc(f * PIXEL) * (waves - rays)
    x = (np.arange(COLUMNS) - (COLUMNS - 1) / 2 - place) * PIXEL
    waved = 2 * np.cos(2 * np.pi * np.outer(x, f)) * spectrum
    change: Array = (waved.sum(axis=1) - (waved[:, 0] + waved[:, -1]) / 2) * step
    return change


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_line_thinner_than_waves_blur_is_found(seed: int) -> None:
    view, place = line(7.3), 7.3
    plan = plan_waves(view, WAVELENGTH, 1.0, seed)
    assert plan.waves.blur / PIXEL > 4 * WIDTH
    parts = wave_parts(view, [(view, plan)], 2, progress=lambda rays: None)
    change = change_by_closed_form(view, place)
    assert np.abs(change).max() > 0.01
    off = parts.change.mean(axis=0) - change
    assert np.sqrt((off**2).mean()) < RIGHT * np.sqrt((change**2).mean())
