"""A thin lens: exposure, circle of confusion, kernel and certificate against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.images import RadianceImage
from radwrap.imaging.demand import Demand
from radwrap.imaging.methods.kernel import plan_kernel
from radwrap.imaging.methods.rays import sampled_radiance
from radwrap.imaging.optics.aperture import sub_viewpoints
from radwrap.imaging.optics.view import PixelPlan, View, magnifications_at, pixel_means, ray_blocks, trace_rays, traced
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.imaging.tolerance.certificate import PixelSample, model_errors, root
from radwrap.scene.camera import Aperture, Lens
from radwrap.scene.distortion import Distortion, opencv_distortion
from radwrap.validate.closed_forms.aperture import blurred_edge, even_field_irradiance
from tests.imaging.planes import Array, Planes, Texture, camera, pixel_axes
from tests.imaging.test_certificate import search, true_rms
from tests.imaging.test_kernel import edge, gray, kernel_image

F, FOCUS = 0.01, 0.5
V = F * FOCUS / (FOCUS - F)  # image distance
# Owen-scrambled points integrate an even field to far below this; a wrong cos^4 is 1e-2 off at f/2.
SMOOTH = 2e-4
# Moments of 4096 rays a pixel over a blurred spot; a circle 5 % off would show.
SPREAD = 0.02
RIGHT, WRONG = 0.2, 1.5  # gray levels of 100, rms


def seen_through(aperture: Aperture, *planes: tuple[float, Texture], lens: Lens | None = None, **more: Any) -> View:
    """Planes through a lens focused at half a metre; an even field of radiance 1 gives gray 100, but for cos^4."""
    found = camera(aperture, f=F, **more)
    found = replace(found, lens=lens or Lens(FOCUS))
    scale = found.image_distance**2 / F**2 / found.transmission
    return View(replace(found, sensor=replace(found.sensor, gain=found.sensor.gain * scale)), Planes(planes))


def test_no_places_have_no_magnifications() -> None:
    """Square on and in focus no pixel needs a pair of rays."""
    view = seen_through(Aperture("round", 2e-3), (FOCUS, even))
    assert magnifications_at(view, np.empty(0), np.empty(0)).shape == (0,)
    assert magnifications_at(view, np.array([3.0]), np.array([4.0])) == pytest.approx(0.0, abs=1e-12)


def even(x: Array, y: Array) -> Array:
    """Radiance 1 everywhere."""
    return np.ones_like(x)


@pytest.mark.parametrize("f_number", [1.4, 4.0])
def test_an_even_field_exposes_as_the_exact_integral_over_the_lens_says(f_number: float) -> None:
    """On the axis pi L sin^2 of the image-side half angle; in the corner the exact disc; transmission is a factor."""
    aperture = Aperture("round", F / f_number)
    wide = (4e-4, 5e-4)  # pixels: 12.8 x 12 mm of sensor behind 10 mm
    seen = seen_through(aperture, (1.0, even), lens=Lens(FOCUS, 0.8), pixel=wide)
    seen = replace(seen, camera=replace(seen.camera, principal_point=(15.0, 12.0)))
    u, v = np.array([15.0, 31.0]), np.array([12.0, 0.0])
    # Of the points themselves, not of their pixels.
    tiny = replace(seen.camera.sensor, pixel_width=1e-9, pixel_height=1e-9)
    for place, height in ((0, 0.0), (1, math.hypot(16 * wide[0], 12 * wide[1]))):
        u0 = (u[place] - 15.0) * wide[0] / 1e-9, (v[place] - 12.0) * wide[1] / 1e-9
        point = View(replace(seen.camera, sensor=tiny, principal_point=(0.0, 0.0)), seen.tracer)
        mean = sampled_radiance(point, np.array([u0[0]]), np.array([u0[1]]), 4096, np.random.default_rng(1)).mean()
        found = float(radiant_exposure(RadianceImage(np.array([[mean]])), point.camera).values[0, 0])
        assert found == pytest.approx(0.8 * even_field_irradiance(aperture.diameter / 2, V, height), rel=SMOOTH)
    sine = math.sin(math.atan(aperture.diameter / 2 / V))
    assert even_field_irradiance(aperture.diameter / 2, V) == pytest.approx(math.pi * sine**2, rel=1e-12)


# At the corner, .02 f off the axis, 2.4 % in length and 7 % in area.
BENT = opencv_distortion((60.0,) + (0.0,) * 11)


@pytest.mark.parametrize("distortion", [None, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("table", [((0.0, 1.0),), ((0.0, 1.0), (4e-4, 0.4))])
def test_a_measured_falloff_takes_the_place_of_cos4(
    table: tuple[tuple[float, float], ...], distortion: Distortion | None
) -> None:
    """The axis' exposure times the table, at any height on the sensor, by rays and by the kernel.

    The table is the sensor's: it holds the area that distortion adds or takes.
    """
    aperture = Aperture("round", F / 2)
    seen = seen_through(aperture, (FOCUS, even), lens=Lens(FOCUS, 1.0, table))
    seen = replace(seen, camera=replace(seen.camera, distortion=distortion))
    v, u = np.indices((24, 32))
    height = np.hypot((u - 15.5) * 1e-5, (v - 11.5) * 1.2e-5)
    expected = even_field_irradiance(aperture.diameter / 2, V) / (aperture.area / V**2)
    expected = expected * np.interp(height, *np.transpose(table))
    rays = sampled_radiance(seen, u.ravel().astype(float), v.ravel().astype(float), 256, np.random.default_rng(2))
    assert rays.mean(axis=1).reshape(24, 32) == pytest.approx(expected, rel=5e-3)
    plan = plan_kernel(seen, np.array([0.0]), 0.02)
    assert kernel_image(seen, plan) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("depth", [0.25, 0.4, 0.5, 0.8, 5.0])
def test_a_point_is_blurred_over_the_circle_of_confusion(depth: float) -> None:
    """The second moment of a small spot: a disc of radius (d/2) v |1/z - 1/s|, the pixel's box and the spot itself."""
    aperture = Aperture("round", F / 8)
    spot = 2e-6 * depth / V  # a fifth of a pixel
    circle = aperture.diameter / 2 * V * abs(1 / depth - 1 / FOCUS)

    def small(x: Array, y: Array) -> Array:
        return np.where(np.hypot(x, y) < spot, 1.0, 0.0)

    # Every ray that the spot can get: pixels as wide as the circle needs.
    pixel = max(1e-5, 3 * circle / 16)
    seen = seen_through(aperture, (depth, small), rows=33, columns=33, pixel=(pixel, pixel))
    # By reciprocity: for each opening point the spot is seen at one place; the kernel's footprint must hold it.
    random = np.random.default_rng(3)
    radius, turn = np.sqrt(random.random(4000)), 2 * np.pi * random.random(4000)
    q = aperture.diameter / 2 * radius[:, np.newaxis] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    places = -seen.camera.magnification(depth) * q
    u, v = 16 + places[:, 0] / pixel, 16 + places[:, 1] / pixel
    assert (trace_rays(seen, q, u, v)[0] > 0).all()  # rays meet the spot from there
    beside = 1.5 * spot * V / depth / pixel
    assert (trace_rays(seen, q, u + beside, v)[0] == 0).all()  # and from nowhere else
    assert (places**2).sum(axis=1).mean() == pytest.approx(circle**2 / 2, rel=0.05, abs=1e-20)


def eq9_image(seen: View, depth: float, angle: float) -> Array:
    """Eq. 9 with the circle of confusion in place of R, averaged over each pixel by 16 x 16 midpoints [gray level]."""
    found = seen.camera
    radius = found.aperture.diameter / 2 * V * abs(1 / depth - 1 / FOCUS)
    even_field = even_field_irradiance(found.aperture.diameter / 2, V) / (found.aperture.area / V**2)
    return 100 * even_field * blurred_edge(*pixel_axes(found), angle=angle, radius=radius)


@pytest.mark.parametrize("depth", [0.25, 0.5, 5.0])
@pytest.mark.parametrize("method", ["kernel", "rays", "viewpoints"])
def test_an_edge_in_and_out_of_focus_is_that_of_eq9(depth: float, method: str) -> None:
    aperture = Aperture("round", F / 5.6)  # circles of 3.6, 0 and 3.3 pixels
    seen = seen_through(aperture, (depth, edge(0.5)))
    if method == "kernel":
        plan = plan_kernel(seen, np.array([seen.camera.magnification(depth)]), 0.02, 1)
        ours = gray(seen, kernel_image(seen, plan))
    elif method == "rays":
        v, u = np.divmod(np.arange(seen.camera.sensor.pixels, dtype=float), 32)
        ours = gray(seen, sampled_radiance(seen, u, v, 1024, np.random.default_rng(1)).mean(axis=1)).reshape(24, 32)
    else:
        ours = gray(seen, by_viewpoints(seen, 61, 4))
    off = ours - eq9_image(seen, depth, 0.5)
    assert math.sqrt((off**2).mean()) < (RIGHT if method == "kernel" else 3 * RIGHT)


def by_viewpoints(seen: View, number: int, samples: int) -> Array:
    """Merged sub-viewpoints."""
    found = seen.camera
    points = sub_viewpoints(found.aperture, number)
    mean = np.zeros(found.sensor.pixels)
    for (u, v), weight in zip(points.positions.tolist(), points.weights.tolist(), strict=True):
        for block, radiance in traced(seen.tracer.trace, ray_blocks(found, (u, v), PixelPlan(samples))):
            mean[block.first : block.first + block.pixels] += weight * pixel_means(block, radiance)
    return mean.reshape(found.sensor.rows, found.sensor.columns)


@pytest.mark.parametrize("depth", [0.25, 5.0])
def test_the_openings_shape_turns_over_behind_the_plane_of_focus(depth: float) -> None:
    """A half disc: the kernel agrees with rays on either side, and one of the other sign does not."""
    aperture = Aperture("half_disc", F / 5.6, rotation=0.4)

    def texture(x: Array, y: Array) -> Array:
        return np.where(np.hypot(x / depth + 5e-3, y / depth - 2.5e-3) < 4e-3, 1.0, 0.1)

    seen = seen_through(aperture, (depth, texture))
    m = float(seen.camera.magnification(depth))
    assert (m > 0) == (depth < FOCUS)
    v, u = np.divmod(np.arange(seen.camera.sensor.pixels, dtype=float), 32)
    rays = gray(seen, sampled_radiance(seen, u, v, 1024, np.random.default_rng(1)).mean(axis=1)).reshape(24, 32)
    off = []
    for sign in (1, -1):
        plan = plan_kernel(seen, np.array([sign * m]), 0.05, 1)
        off.append(math.sqrt(((gray(seen, kernel_image(seen, plan)) - rays) ** 2).mean()))
    assert off[0] < 0.6 and off[1] > 5 * off[0]  # the rays' own error is about 0.4


def test_layers_reach_across_the_plane_of_focus() -> None:
    """A plane that leans through the focus, as two halves: each is blurred by its own m, of either sign."""
    near, far = 0.25, 2.0

    def left(x: Array, y: Array) -> Array:
        return np.where(x < 0, np.where(y > 0, 1.0, 0.2), np.nan)

    seen = seen_through(
        Aperture("half_disc", F / 5.6), (near, left), (far, lambda x, y: np.where(y > 0, 1.0, 0.2)), rows=8, columns=96
    )
    plan = plan_kernel(seen, seen.camera.magnification(np.array([near, far])), 0.05, 1)
    assert plan.layers[0] < 0 < plan.layers[-1]
    ours = gray(seen, kernel_image(seen, plan))
    v, u = np.divmod(np.arange(ours.size, dtype=float), 96)
    rays = gray(seen, sampled_radiance(seen, u, v, 1024, np.random.default_rng(1)).mean(axis=1)).reshape(ours.shape)
    aside = np.r_[0:20, 76:96]
    assert math.sqrt(((ours - rays)[:, aside] ** 2).mean()) < 0.5


def test_pairs_find_nothing_on_a_blurred_plane_and_occlusion_where_there_is_some() -> None:
    def near(x: Array, y: Array) -> Array:
        return np.where(x > 0, np.where(y > 0, 0.6, 0.1), np.nan)

    def behind(x: Array, y: Array) -> Array:
        return np.where(y > 0, 1.0, 0.2)

    aperture = Aperture("round", F / 8)
    flat, stepped = (seen_through(aperture, *planes) for planes in (((2.0, behind),), ((0.25, near), (2.0, behind))))
    found = []
    for seen, depths in ((flat, [2.0]), (stepped, [0.25, 2.0])):
        every = np.arange(seen.camera.sensor.pixels)
        sample = PixelSample(every, every * 0, np.ones(1), every * 0 + 16)
        plan = plan_kernel(seen, seen.camera.magnification(np.array(depths)), 0.1)
        errors = model_errors(seen, plan.layers, sample, np.full(len(every), 0.5), seed=(1,))
        found.append(root(errors.mean_square(sample, (2,)).mean))
    assert found[0] < 0.05
    assert found[1] > 0.5


def test_the_planner_certifies_the_kernel_and_refuses_it_where_something_hides(tmp_path: Path) -> None:
    def disc(x: Array, y: Array) -> Array:
        return np.where(np.hypot(x, y) < 1e-2, 1.0, 0.2)

    def near(x: Array, y: Array) -> Array:
        return np.where(x > 0, np.where(y > 0, 0.6, 0.1), np.nan)

    aperture = Aperture("round", F / 8)
    open_view = seen_through(aperture, (2.0, disc))
    outcome = search(open_view, tmp_path / "open", Demand(0.5))
    assert outcome.method == "kernel" and outcome.met
    assert true_rms(open_view, outcome.radiance) <= outcome.certificate.rms_gray_upper95 + 0.1
    hidden = seen_through(aperture, (0.25, near), (2.0, disc), rows=10, columns=16)
    outcome = search(hidden, tmp_path / "hidden", Demand(0.6))
    assert outcome.method == "hybrid" and outcome.met
    assert true_rms(hidden, outcome.radiance, 2048) <= outcome.certificate.rms_gray_upper95 + 0.1
