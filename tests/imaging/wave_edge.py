"""An edge behind a square opening, in closed form: by rays, and what waves add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radwrap.imaging.optics.view import View
from radwrap.scene.camera import Aperture, Camera, Lens
from radwrap.tracers.tracer import Tracer
from tests.imaging.planes import Array, Planes, camera

WAVELENGTH, PIXEL, COLUMNS, ROWS = 550e-9, 1e-5, 96, 24
LOW, HIGH = 0.2, 1.0


def seen(side: float, focus: float | None, place: float) -> View:
    """A step at a place [px] from the middle of the columns, at 1 m."""
    plain = camera(Aperture("square", side), rows=ROWS, columns=COLUMNS, pixel=(PIXEL, PIXEL))
    lens = None if focus is None else Lens(focus)
    v = replace(plain, lens=lens).image_distance

    def edge(x: Array, y: Array) -> Array:
        # The field's falloff is taken out: tails come from far beside the axis.
        return np.where(x > place * PIXEL / v, HIGH, LOW) * (1 + x**2 + y**2) ** 2

    tracer: Tracer = Planes(((1.0, edge),))  # type: ignore[assignment]
    return View(replace(plain, lens=lens), tracer)


def uncounted(_: int) -> None:
    """Rays are not counted."""


def expected(of: Camera, place: float) -> tuple[Array, Array]:
    """The step by rays, and what waves add [radiance on the axis]."""
    columns, pitch = of.sensor.columns, of.sensor.pixel_width
    side, v, m = of.aperture.diameter, of.image_distance, float(of.magnification(1.0))
    top = 60 / pitch
    nodes, shares = np.polynomial.legendre.leggauss(40)
    f = (np.arange(400)[:, np.newaxis] + (nodes + 1) / 2).ravel() * top / 400
    weights = np.tile(shares / 2 * top / 400, 400)
    width = np.maximum(side - WAVELENGTH * v * f, 0.0)
    rays = np.sinc(m * f * side) * np.sinc(f * pitch)
    waves = width / side * np.sinc(m * f * width) * np.sinc(f * pitch)
    x = (np.arange(columns) - (columns - 1) / 2 - place) * pitch
    step = np.sin(2 * np.pi * np.outer(x, f)) / (np.pi * f)
    return LOW + (HIGH - LOW) * (0.5 + step @ (rays * weights)), (HIGH - LOW) * step @ ((waves - rays) * weights)
