"""A half plane that hides a lamp from a slit: Fresnel's integral, the closed form that follows, and what renders make.

A slit's field, sent back from a place on the sensor, is cut by the half plane;
what passes falls on an even lamp behind it, whatever its edge does to it. So
the half plane is a dark step at its own depth, blurred by waves there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from radwrap.imaging.methods.around import least_around, most_around, sum_around
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.wave_behind import Filling, Layout, by_layer
from radwrap.imaging.tolerance.wave_image import WaveError, visible_gray, wave_error
from radwrap.imaging.tolerance.wave_parts import wave_parts
from radwrap.imaging.tolerance.wave_plan import plan_waves
from radwrap.scene.camera import Aperture, Lens
from radwrap.tracers.tracer import Tracer
from tests.imaging.planes import Array, Planes, camera

WAVELENGTH, PIXEL, COLUMNS, ROWS, FOCAL = 550e-9, 1e-5, 96, 8, 0.01
LAMP = 1.0  # m
GRAY = 100.0  # of the lamp alone, see `camera`
Light = Callable[[Array], Array]  # along x of the lamp's plane [m]
# Of the integral: 2^17 samples over .12 m cut the slit of 128 um in steps of .23 um.
SAMPLED = 1e-3
FAR_OFF = 0.03  # gray levels; .02 is seen, and .05 to .18 was where layers kept their own shares of far light


def step_by_waves(side: float, distance: float, magnification: float, x: Array, *, waves: bool) -> Array:
    """A dark half plane x > 0 before a field of 1, at places x [m]."""
    top = side / (WAVELENGTH * distance) if waves else 60 / PIXEL
    nodes, shares = np.polynomial.legendre.leggauss(40)
    f = (np.arange(400)[:, np.newaxis] + (nodes + 1) / 2).ravel() * top / 400
    width = np.maximum(side - WAVELENGTH * distance * f, 0.0) if waves else np.full(f.shape, side)
    passed = width / side * np.sinc(magnification * f * width) * np.tile(shares / 2 * top / 400, 400)
    return np.asarray(0.5 - np.sin(2 * np.pi * np.outer(x, f)) / (np.pi * f) @ passed)


def by_fresnel(side: float, places: Array, light: Light, *, distance: float, near: float, focal: float) -> Array:
    """What places [m] on the sensor gather of a lamp behind a half plane x > 0, by Fresnel's integrals."""
    span, number = 0.12, 1 << 17
    k, pitch = 2 * np.pi / WAVELENGTH, span / number
    x = (np.arange(number) - number / 2) * pitch
    q = x * WAVELENGTH * near / (span * pitch)
    slit = np.clip((side / 2 - np.abs(q)) / (q[1] - q[0]) + 0.5, 0, 1)
    slit = slit * np.exp(0.5j * k * q**2 * (1 / near + 1 / distance - 1 / focal))
    onwards = np.exp(-1j * np.pi * WAVELENGTH * (LAMP - near) * np.fft.fftfreq(number, pitch) ** 2)
    open_, lamp = np.clip(-x / pitch + 0.5, 0, 1), light(x)
    found = []
    for place in places:
        field = np.fft.fftshift(np.fft.fft(np.fft.ifftshift(slit * np.exp(1j * k * q * place / distance))))
        field = field * np.exp(0.5j * k * x**2 / near)
        behind = np.fft.ifft(np.fft.fft(field * open_) * onwards)
        found.append(float((np.abs(behind) ** 2 @ lamp) / (np.abs(field) ** 2).sum()))
    return np.array(found)


def test_a_lamp_behind_a_half_plane_is_blurred_as_the_half_plane_is() -> None:
    """Fresnel's integrals from the sensor through slit and half plane, against the closed form."""
    side, near = math.sqrt(3 * WAVELENGTH * FOCAL), 0.05
    places = np.array([-60.0, -25.0, -3.0, 8.0, 30.0, 75.0]) * 1e-6
    found = by_fresnel(side, places, np.ones_like, distance=FOCAL, near=near, focal=math.inf)
    magnification = FOCAL * (1 / near + 1 / FOCAL)
    expected = step_by_waves(side, FOCAL, magnification, places, waves=True)
    assert np.ptp(expected) > 0.7
    assert found == pytest.approx(expected, abs=SAMPLED)


def by_rays(side: float, places: Array, light: Light, *, distance: float, near: float, focal: float) -> Array:
    """As `by_fresnel`, by rays through the slit."""
    q = ((np.arange(4000) + 0.5) / 4000 - 0.5) * side
    at_edge, at_lamp = (
        depth * (q * (1 / depth + 1 / distance - 1 / focal) + places[:, np.newaxis] / distance)
        for depth in (near, LAMP)
    )
    return np.asarray(np.where(at_edge < 0, light(at_lamp), 0.0).mean(axis=1))


def is_half(x: Array) -> NDArray[np.bool_]:
    """Where the half plane is."""
    return x > 0


def seen(
    side: float,
    near: float,
    focus: float | None,
    *,
    light: Light = np.ones_like,
    hides: Callable[[Array], NDArray[np.bool_]] = is_half,
    shift: float = 0.0,
) -> View:
    """What hides the lamp, whose falloff is taken out; its x = 0 is seen right of the middle [px]."""
    plain = camera(Aperture("square", side), rows=ROWS, columns=COLUMNS, pixel=(PIXEL, PIXEL))
    plain = replace(plain, principal_point=((COLUMNS - 1) / 2 + shift, (ROWS - 1) / 2))
    lens = None if focus is None else Lens(focus)

    def edge(x: Array, y: Array) -> Array:
        return np.where(hides(x), 0.0, np.nan)

    def lamp(x: Array, y: Array) -> Array:
        return light(x) * (1 + (x / LAMP) ** 2 + (y / LAMP) ** 2) ** 2

    tracer: Tracer = Planes(((near, edge), (LAMP, lamp)))  # type: ignore[assignment]  # a stand-in, for its rays
    return View(replace(plain, lens=lens), tracer)


def in_pixels(nodes: int, shift: float = 0.0) -> tuple[Array, Array]:
    """Places over each pixel from what is seen so far right of the middle [px], shape (COLUMNS, nodes) [m]; weights."""
    at, shares = np.polynomial.legendre.leggauss(nodes)
    return ((np.arange(COLUMNS) - (COLUMNS - 1) / 2 - shift)[:, np.newaxis] + at / 2) * PIXEL, shares / 2


def off_by(view: View, waves: Array, rays: Array, aim: float) -> tuple[float, float, WaveError]:
    """How far what waves add to each column is off, its bound, and of what that is [gray level]."""
    plan = plan_waves(view, WAVELENGTH, aim, seed=1)
    parts = wave_parts(view, [(view, plan)], 2, progress=lambda _: None)
    found = parts.change.mean(axis=(0, 1))
    gray = visible_gray(view.exposure_of_radiance, view.camera.sensor)
    error = wave_error(parts, np.tile(rays + found, (ROWS, 1)), gray, plan.block)
    off = GRAY * math.sqrt(float(np.mean((found - (waves - rays)) ** 2)))
    return off, math.sqrt(error.noise.upper + error.cells + error.tails**2), error


# The nearest edge is the hardest: one pinhole stands for all.
SHORT = (3, 0.05)
PINHOLES = [
    pytest.param(math.sqrt(number * WAVELENGTH * FOCAL), None, near, marks=marks)
    for number in (0.3, 3, 30)
    for near in (0.05, 0.5, 0.9)
    for marks in [[] if (number, near) == SHORT else [pytest.mark.long]]
]
LENSES = [pytest.param(2e-3, focus, near, marks=pytest.mark.long) for focus in (1.0, 0.5) for near in (0.5, 0.9)]


@pytest.mark.parametrize(("side", "focus", "near"), PINHOLES + LENSES)
def test_what_hides_is_blurred_at_its_own_depth_within_the_bound(side: float, focus: float | None, near: float) -> None:
    view = seen(side, near, focus)
    distance, m = view.camera.image_distance, float(view.camera.magnification(near))
    x, shares = in_pixels(8)
    waves, rays = (
        step_by_waves(side, distance, m, x.ravel(), waves=which).reshape(x.shape) @ shares for which in (True, False)
    )
    off, bound, error = off_by(view, waves, rays, 0.25)
    assert off < bound
    # What is not known of what hides stays, however fine the cells; right before the lamp it is less than noise.
    assert 0 <= error.lasting <= error.cells
    assert error.lasting > 0 or near == 0.9
    # Light laid out where it is seen was off by up to 1 gray level rms, and by 8 at the edge.
    assert off < 0.2


@pytest.mark.long
@pytest.mark.parametrize("near", [0.2, 0.1])
def test_light_adds_up_far_from_an_edge_whatever_the_depths(near: float) -> None:
    """A lamp in focus behind a blurred edge: what layers send beyond the guard band differs by a half."""
    side, focus = 2e-3, LAMP
    view = seen(side, near, focus)
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1)
    of_layers = plan.weights.near(plan.kernel.grid.cell, (0, 0), plan.weights.lens_field.places[0])
    assert [one.sum() for one in of_layers] == pytest.approx([-plan.weights.share] * len(of_layers), rel=1e-9)
    assert plan.weights.share_spread > 0.05 * plan.weights.share
    parts = wave_parts(view, [(view, plan)], 2, progress=lambda _: None)
    x, shares = in_pixels(8)
    distance, m = view.camera.image_distance, float(view.camera.magnification(near))
    waves, rays = (
        step_by_waves(side, distance, m, x.ravel(), waves=which).reshape(x.shape) @ shares for which in (True, False)
    )
    off = GRAY * (parts.change.mean(axis=(0, 1)) - (waves - rays))
    assert np.abs(off[:24]).max() < FAR_OFF and np.abs(off[-24:]).max() < FAR_OFF


LIGHT: dict[str, Light] = {
    "stripes": lambda x: 0.5 + 0.5 * np.cos(2 * np.pi * x / 1.1e-3),
    "step": lambda x: np.where(x < -0.9e-3, 1.0, 0.0),
}


@pytest.mark.long  # Fresnel's integrals
@pytest.mark.parametrize("kind", LIGHT)
@pytest.mark.parametrize(("side", "focus", "near"), [(2e-3, 1.0, 0.5), (2e-3, 0.5, 0.5), (2e-3, 0.7, 0.5)])
def test_structure_right_behind_an_edge_is_within_the_bound(side: float, focus: float, near: float, kind: str) -> None:
    """Such light sees a part of the opening only, which no layer knows."""
    light, shift = LIGHT[kind], 0.27
    view = seen(side, near, focus, light=light, shift=shift)
    distance = view.camera.image_distance
    x, shares = in_pixels(3, shift)
    rays, waves = (
        made(side, x.ravel(), light, distance=distance, near=near, focal=FOCAL).reshape(x.shape) @ shares
        for made in (by_rays, by_fresnel)
    )
    off, bound, _ = off_by(view, waves, rays, 0.05)
    assert off < bound


def test_light_that_is_laid_out_adds_up_and_slopes_hide_nothing() -> None:
    layers = (0.0, 0.1, 0.2, 0.3)
    across = np.broadcast_to(np.linspace(0.0, 0.3, 64), (48, 64))
    values = 1 + across
    even = Layout.of(across, layers)
    assert even.going_on(values) is None and sum(by_layer(((values, even.seen),)).values()) == pytest.approx(values)
    hiding = np.where(np.arange(64) < 20, 0.3, 0.1) * np.ones((48, 1))
    going_on = Layout.of(hiding, layers).going_on(values)
    behind = {} if going_on is None else by_layer(going_on)
    assert behind and sum(behind.values()) == pytest.approx(values)
    # What lies behind goes on to the border, and the near layer has what differs from it.
    assert (behind[1][:, 22:] == values[:, 22:]).all() and behind[1][:, 19] == pytest.approx(values[:, 22], rel=0.02)
    assert behind[3] == pytest.approx(values - behind[1])


@pytest.mark.parametrize("crossed", [0.1, 0.12, 0.2, 0.29])
def test_a_cell_that_an_edge_crosses_belongs_to_what_is_near(crossed: float) -> None:
    """Its light is half of what lies behind; its depth, by whichever rays met what, may be any between."""
    depth, values = np.full((12, 40), 0.1), np.full((12, 40), 8.0)
    depth[:, :15], values[:, :15] = 0.3, 1.0
    depth[:, 15], values[:, 15] = crossed, 4.5
    going_on = Layout.of(depth, (0.0, 0.1, 0.2, 0.3)).going_on(values)
    laid_out = {} if going_on is None else by_layer(going_on)
    assert laid_out and laid_out[1] == pytest.approx(np.full(depth.shape, 8.0))
    near, column = (laid_out[2] + laid_out[3])[0], np.arange(40)
    assert near == pytest.approx(np.where(column < 15, -7.0, np.where(column > 15, 0.0, -3.5)))
    assert (np.abs(laid_out[3][0]) >= 0.89 * np.abs(near)).all()


def test_a_wall_that_is_seen_goes_on_as_a_slope() -> None:
    """Of a wall from the ground up to an edge, noise of depth included, only the edge hides anything."""
    column, random = np.arange(80), np.random.default_rng(3)
    place = np.clip((column - 30) / 3, 0, 9) * np.ones((30, 1)) + random.uniform(-0.2, 0.2, (30, 80)) * (column < 57)
    place[:, 60:] = 0.0
    layers = tuple(np.linspace(0.0, 1.0, 11).tolist())
    laid_out = Layout.of(place / 10, layers)
    (edge,) = laid_out.edges
    assert edge.near[:, 45:62].all() and not edge.near[:, 62:].any() and not edge.near[:, :31].any()
    assert laid_out.apart == pytest.approx(0.9, abs=0.05)
    assert edge.step[:, 61].all() and not edge.step[:, :57].any()


def test_few_cells_that_lie_between_at_an_edge_are_part_of_what_is_near() -> None:
    """As an edge crosses them: they would be an edge of their own, with all that it takes to lay it out."""
    place = np.where(np.arange(64) < 20, 9.0, 0.0) * np.ones((48, 1))
    place[4:40:9, 20:23] = 3.5  # wider than cells that one edge crosses
    few = Layout.of(place / 9, tuple(np.linspace(0.0, 1.0, 10).tolist()))
    assert len(few.edges) == 1 and few.edges[0].near[4, :22].all()
    place[:, 20:40] = 3.5
    many = Layout.of(place / 9, tuple(np.linspace(0.0, 1.0, 10).tolist()))
    assert len(many.edges) == 2


def test_what_is_even_behind_an_edge_leaves_nothing_uneven() -> None:
    depth = np.where(np.arange(64) < 20, 0.3, 0.1) * np.ones((48, 1))
    laid_out = Layout.of(depth, (0.0, 0.1, 0.2, 0.3)).cut_within([6])
    even = laid_out.uneven(np.where(depth > 0.2, 2.0, 5.0), 6)
    assert all(np.abs(light).max() < 1e-12 for one in even for light in by_layer(one).values())
    striped = 5 + np.cos(np.arange(64) * np.pi / 2) * np.ones((48, 1))
    far, near = map(by_layer, laid_out.uneven(striped, 6))
    uneven = far[1]
    assert near[3] == pytest.approx(uneven)
    # Crossed cells have their share of the edge; beyond its reach and on what is near nothing counts.
    assert not uneven[:, :22].any() and not uneven[:, 29:].any()
    assert np.abs(uneven[:, 22:28]).max() == pytest.approx(1.0, abs=0.2)
    around = striped[20 - 6 : 20 + 7, 22 : 26 + 7]  # of what lies behind, also where no edge reaches
    assert uneven[20, 26] == pytest.approx(striped[20, 26] - around.mean())


def test_what_is_not_known_is_the_mean_around() -> None:
    known = np.zeros((21, 30), dtype=bool)
    known[:, 13:] = True
    even = Filling.of(known).filled(np.where(known, 3.0, 99.0))
    assert even == pytest.approx(np.full(known.shape, 3.0))
    slope = Filling.of(known).filled(np.where(known, np.arange(30.0), -1.0))
    assert (slope[known] == np.broadcast_to(np.arange(30.0), known.shape)[known]).all()
    assert (slope[:, :13] >= 13).all() and (slope[:, :13] <= 29).all()
    one = np.zeros((5, 7), dtype=bool)
    one[2, 3] = True
    assert Filling.of(one).filled(np.full(one.shape, 4.0)) == pytest.approx(np.full(one.shape, 4.0))


@pytest.mark.parametrize("size", [1, 3, 7, 13, 65])
def test_squares_around_cells_are_those_of_scipy(size: int) -> None:
    values = np.random.default_rng(1).normal(size=(23, 31))
    assert (most_around(values, size) == ndimage.maximum_filter(values, size, mode="nearest")).all()
    assert (least_around(values, size) == ndimage.minimum_filter(values, size, mode="nearest")).all()
    expected = size**2 * ndimage.uniform_filter(values, size, mode="constant")
    assert sum_around(values, size) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("wide", [1.0, *(pytest.param(wide, marks=pytest.mark.long) for wide in (0.6, 1.5))])
def test_a_slit_of_few_cells_is_blurred_at_its_own_depth_within_the_bound(wide: float) -> None:
    """All that lies behind is then seen in cells that an edge crosses."""
    side, near, shift = math.sqrt(3 * WAVELENGTH * FOCAL), 0.05, 0.27
    half = wide * PIXEL / 2
    view = seen(side, near, None, hides=lambda x: np.abs(x) > half * near / FOCAL, shift=shift)
    m = float(view.camera.magnification(near))
    x, shares = in_pixels(8, shift)

    def edge(place: float, *, waves: bool) -> Array:
        return step_by_waves(side, FOCAL, m, (x - place).ravel(), waves=waves).reshape(x.shape) @ shares

    waves, rays = (edge(half, waves=which) - edge(-half, waves=which) for which in (True, False))
    off, bound, _ = off_by(view, waves, rays, 0.05)
    assert off < 0.2 and off < bound
