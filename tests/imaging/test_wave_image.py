"""What waves add to an image: closed forms of an edge behind square openings, and what renders make of it."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.methods.central import EdgeSampling
from radwrap.imaging.methods.kernel import GRID_SHARE, decide_tile, gathered_tile, plan_kernel
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.strips import strips_of
from radwrap.imaging.tolerance.bounds import Bounded
from radwrap.imaging.tolerance.cells_in_common import own_change, smaller_cell
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.imaging.tolerance.wave_gather import _crossing
from radwrap.imaging.tolerance.wave_image import WaveError, _common_square, seen_rms, visible_gray, wave_error
from radwrap.imaging.tolerance.wave_parts import WaveParts, wave_parts
from radwrap.imaging.tolerance.wave_plan import by_diameter, plan_waves
from radwrap.imaging.wave_shares import finer, left_to_image
from radwrap.imaging.with_waves import _Image
from radwrap.scene.camera import Aperture, Lens
from radwrap.tracers.tracer import Tracer
from tests.imaging.planes import Array, Planes, camera
from tests.imaging.wave_edge import COLUMNS, PIXEL, ROWS, WAVELENGTH, expected, seen, uncounted

BENCH = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"
CELLS = Path(__file__).parents[2] / "rad_scenes" / "cells"
SETS = 48  # of rays, whose mean shows what cells do
KEY = "camera.diffraction"
RIGHT = 0.05  # of what waves change: noise of the rays, and cells of the central image
COMPILED = radwrap.RenderOptions(tracer="compiled")  # a fifth of Radiance's processor time; both agree ray by ray


def rms(values: Array) -> float:
    return math.sqrt(float((values**2).mean()))


@pytest.mark.parametrize(
    ("side", "focus"),
    [(1e-4, None), (3e-4, None), (5e-4, 1.0), (1e-3, 0.6), (2e-3, 1.0)],
    ids=["pinhole of Fresnel number .5", "of 4", "focused", "out of focus", "finer than a pixel"],
)
@pytest.mark.parametrize("place", [pytest.param(0.0, marks=pytest.mark.long), 0.3])
def test_an_edge_becomes_its_closed_form_within_the_bound(side: float, focus: float | None, place: float) -> None:
    view = seen(side, focus, place)
    rays, change = expected(view.camera, place)
    scale, sensor = view.exposure_of_radiance, view.camera.sensor
    radiance = np.tile(rays, (ROWS, 1))
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1)
    parts = wave_parts(view, [(view, plan)], 2, progress=lambda _: None)
    found = parts.change.mean(axis=0)
    error = wave_error(parts, radiance + found, visible_gray(scale, sensor), plan.block)
    off = (found - change) * scale * sensor.gain
    size = math.sqrt(float(np.mean((change * scale * sensor.gain) ** 2)))
    bound = math.sqrt(error.noise.upper + error.cells + error.tails**2)
    # Bounds of small changes are mostly noise of two replicates: over six seeds .04 to .86; and the law of far light.
    assert math.sqrt(float((off**2).mean())) < bound < max(1.0, 0.3 * size), (bound, size)


@pytest.mark.parametrize("blur", [0.2, pytest.param(0.15, marks=pytest.mark.long)])
def test_a_grating_loses_the_contrast_of_its_frequency(blur: float) -> None:
    """In focus behind a round lens: 2/pi (arccos s - s sqrt(1 - s^2)), s = lambda N nu, whatever the pixels' size.

    Waves of a fraction of a pixel send little light, but far, and most of it to the dark lines beside.
    """
    plain = camera(Aperture("round", 1e-3), rows=4, columns=24, pixel=(PIXEL, PIXEL))
    plain, period = replace(plain, lens=Lens(1.0)), 6.0
    v = plain.image_distance
    plain = replace(plain, aperture=Aperture("round", WAVELENGTH * v / (blur * PIXEL)))

    def lines(x: Array, y: Array) -> Array:
        return (1 + np.cos(2 * np.pi * x * v / (period * PIXEL))) * (1 + x**2 + y**2) ** 2

    tracer: Tracer = Planes(((1.0, lines),))  # type: ignore[assignment]
    view = View(plain, tracer)
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1)
    parts = wave_parts(view, [(view, plan)], 2, progress=lambda _: None)
    s = blur / period
    lost = 1 - 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    wave = np.cos(2 * np.pi * (np.arange(24) - 11.5) / period) * np.sinc(1 / period)
    found = parts.change.mean(axis=(0, 1))
    assert float(found @ wave / (wave @ wave)) == pytest.approx(-lost, rel=RIGHT)


@pytest.mark.parametrize("deviation", [0.03, 0.08])
def test_a_grating_in_a_wide_line_loses_the_mean_over_its_wavelengths(deviation: float) -> None:
    """Near the limit of what passes contrast bends over the wavelength, and two footprints show that.

    A normal distribution of wavelengths, by Hermite's rule; as if the mean stood for all it was off by up to a third.
    """
    plain = camera(Aperture("round", 1e-3), rows=4, columns=24, pixel=(PIXEL, PIXEL))
    plain, period = replace(plain, lens=Lens(1.0)), 6.0
    v, limit = plain.image_distance, 0.9  # of the frequencies that pass, at the mean wavelength
    plain = replace(plain, aperture=Aperture("round", WAVELENGTH * v / (limit * period * PIXEL)))

    def lines(x: Array, y: Array) -> Array:
        return (1 + np.cos(2 * np.pi * x * v / (period * PIXEL))) * (1 + x**2 + y**2) ** 2

    def passed(wavelength: float) -> float:
        s = min(limit * wavelength / WAVELENGTH, 1.0)
        return float(2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2)))

    tracer: Tracer = Planes(((1.0, lines),))  # type: ignore[assignment]
    view = View(plain, tracer)
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    mean = sum(
        w * passed(WAVELENGTH * (1 + deviation * x)) for x, w in zip(nodes, weights / weights.sum(), strict=True)
    )
    wave = np.cos(2 * np.pi * (np.arange(24) - 11.5) / period) * np.sinc(1 / period)
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1)
    contrast = []
    for each in (plan, plan.at(WAVELENGTH, deviation)):
        found = wave_parts(view, [(view, each)], 2, progress=lambda _: None).change.mean(axis=(0, 1))
        contrast.append(1 + float(found @ wave / (wave @ wave)))
    # The very same rays: what the second footprint changes is free of their noise.
    bend = mean - passed(WAVELENGTH)
    assert contrast[1] - contrast[0] == pytest.approx(bend, rel=0.15)
    assert plan.at(WAVELENGTH, 0.001) is plan
    # What the opening's diameter changes is that of both footprints.
    terms = by_diameter(plan.at(WAVELENGTH, deviation)).weights.terms
    assert sorted({one.wavelength for _, one in terms}) == pytest.approx(
        [WAVELENGTH * (1 - deviation), WAVELENGTH * (1 + deviation)]
    )
    assert sum(factor for factor, _ in terms) == pytest.approx(0.0, abs=1e-9)


def scene_of(diffraction: str, **camera_values: object) -> radwrap.Scene:
    document = tomllib.loads(BENCH.read_text())
    document["camera"] |= {"diffraction": diffraction, **camera_values}
    return radwrap.scene_from_document(document)


@pytest.mark.long
def test_a_scene_has_waves_where_they_matter() -> None:
    """Known of this scene by a fast Fourier transform of its pupil and a finer central image: 5.39 rms, peak 156.2."""
    without, auto = (radwrap.render(scene_of(key), options=COMPILED, tolerance=2) for key in ("off", "auto"))
    apart = auto.gray.values - without.gray.values
    assert math.sqrt(float((apart**2).mean())) == pytest.approx(5.4, abs=0.3)
    assert auto.gray.values.max() == pytest.approx(156.2, abs=3)
    assert auto.manifest["diffraction"]["wavelength"] == 550e-9 and "diffraction" not in auto.left_out
    assert auto.met and auto.error.diffraction_gray is not None and auto.error.rms_gray_upper95 < 2
    assert "diffraction" in without.left_out and without.manifest.get("diffraction") is None
    by_rays = radwrap.render(scene_of("on"), options=COMPILED, tolerance=2, method="rays")
    assert math.sqrt(float(((by_rays.gray.values - auto.gray.values) ** 2).mean())) < 2 * math.hypot(1, 1)
    assert radwrap.render(scene_of("auto"), options=COMPILED, tolerance=60).manifest.get("diffraction") is None


@pytest.mark.long
def test_waves_are_no_surer_than_the_image_that_a_budget_left() -> None:
    """They were aimed at the tolerance, whatever the image had come to: 200 times the budget went into them."""
    options = radwrap.RenderOptions(tracer="compiled", tolerance=1e-3, budget_rays=1e5)
    scene = radwrap.with_value(scene_of("on"), "camera.sensor.scale", "1/4")
    waves, rays = (radwrap.render(radwrap.with_value(scene, KEY, key), options=options) for key in ("on", "off"))
    assert waves.run.rays < 4 * rays.run.rays and not waves.met
    assert waves.error.diffraction_gray is not None
    assert waves.error.diffraction_gray < rays.error.rms_gray_upper95


@pytest.mark.long
def test_a_fine_tolerance_is_met_with_waves() -> None:
    """Cells that did not resolve discs' rims and light from far away kept it from that, whatever the rays."""
    made = radwrap.render(scene_of("on"), options=COMPILED, tolerance=0.1, budget_rays=2e7)
    assert made.met and made.run.rays < 1.5e7


def _made(rms: float) -> Any:
    return SimpleNamespace(certificate=Certificate(rms, rms, None, 0.0, rms, 0, 0, "replicates"), outcome=None)


def test_what_no_ray_makes_smaller_is_left_out_of_what_finer_cells_may_do() -> None:
    """All the cells' part lasts: cells stay, and rays get what it and the image leave."""
    off = WaveError(Bounded(0.04, 0.09), 0.25, 0.25, 0.1, 0.0)
    noise, cells = finer(1.0, _made(0.6), off, least=0.8)
    assert cells == 1.0
    # 1 - 0.1^2 - 0.36 - 0.25 is left; the noise may take three quarters of it.
    assert noise == 1.0
    assert finer(1.0, _made(0.8), off, least=0.8)[0] == pytest.approx(0.8 * math.sqrt(0.75 * 0.1 / 0.09), rel=1e-9)
    # An image gets what rays and cells of waves leave, and half of all where these take more.
    assert left_to_image(0.75, off) == pytest.approx(math.sqrt(0.75 - 0.09))
    assert left_to_image(0.1, off) == pytest.approx(math.sqrt(0.05))


def test_errors_that_have_nothing_in_common_add_as_squares() -> None:
    """Noise of an image and of its waves, a change at edges and far light: the bound is the rms of their sum."""
    random, x = np.random.default_rng(4), np.arange(400) / 400
    image, waves = random.normal(0, 3, (300, 400)), random.normal(0, 2, (300, 400))
    cells, far = np.tile(np.where(np.arange(400) % 8 < 4, 1.0, -1.0), (300, 1)), np.tile(1.5 + x / 2, (300, 1))
    known = Certificate(3.0, 3.0, 10.0, 0.0, 3.0, 0, 0, "replicates")
    square = float((far**2).mean())
    whole = known.with_waves(Bounded(4.0, 4.0), 1.0, math.sqrt(square), 5.0)
    assert whole.rms_gray_upper95 == pytest.approx(math.sqrt(((image + waves + cells + far) ** 2).mean()), rel=0.01)
    assert whole.diffraction_gray == pytest.approx(math.sqrt(((waves + cells + far) ** 2).mean()), rel=0.01)
    # What no pixel is beyond adds as it is, and so does what may look as all else.
    assert whole.p99_gray_upper95 == 15.0
    of_bands = known.with_waves(Bounded(4.0, 4.0), 1.0, math.sqrt(square), 5.0, bands=0.25)
    assert of_bands.rms_gray_upper95 == pytest.approx(whole.rms_gray_upper95 + 0.25)


def test_deviations_of_bounds_that_have_nothing_in_common_add_as_squares() -> None:
    """Normal noise of three kinds, of 200 degrees of freedom each: the sum holds, and is below all bounds."""
    random = np.random.default_rng(5)
    sizes, degrees, held, ratio = (9.0, 8.0, 10.0), (200,) * 3, 0, []
    for _ in range(2000):
        parts = []
        for size, number in zip(sizes, degrees, strict=True):
            mean = size * random.chisquare(number) / number
            parts.append(Bounded(mean, mean * number / chi2.ppf(0.025, number)))
        rms, upper = (math.sqrt(sum(each[:2])) for each in zip(*((one.mean, one.upper) for one in parts), strict=True))
        known = Certificate(rms, upper, None, 0.0, rms, 0, 0, "replicates")
        whole = known.with_waves(parts[2], 0.0, 0.0, 0.0, parts=parts[:2])
        held += whole.rms_gray_upper95**2 >= sum(sizes)
        ratio.append(whole.rms_gray_upper95**2 / (upper**2 + parts[2].upper))
    assert held >= 0.975 * 2000  # by the largest deviation of the three 92 %
    assert np.median(ratio) < 0.95


def test_what_cells_change_of_an_image_and_of_its_waves_adds_by_pixels() -> None:
    """An image whose cells are off by just what those of waves are off the other way: these add nothing."""
    change = np.tile(np.where(np.arange(8) % 2, 2.0, -2.0), (6, 1))
    nothing = np.zeros((2, 6, 8))
    made = np.full((6, 8), 50.0)
    for own, share, left in ((change, -1.0, 4.0), (change, -2.5, 9.0), (change, 1.0, 16.0)):
        parts = WaveParts(nothing, share * change, nothing, nothing[0], 0, EdgeSampling(1, 0.0))
        found = wave_error(parts, made, lambda values: values, 4, (own, own))
        assert 4.0 + found.cells == pytest.approx(left)
        assert wave_error(parts, made, lambda values: values, 4).cells == pytest.approx((2 * share) ** 2)
    # How light is laid out where things hide has nothing of the image's cells.
    hiding = replace(parts, lasting=nothing + 1.0)
    assert wave_error(hiding, made, lambda values: values, 4, (change, change)).cells == pytest.approx(4.0)


@pytest.mark.parametrize(("waves", "smaller"), [(0.5, 0.25), (0.25, 0.125), (0.125, 0.0625)])
def test_waves_get_the_cells_of_their_image_or_half_of_their_own(waves: float, smaller: float) -> None:
    view = seen(1e-4, None, 0.3)
    image = SimpleNamespace(ray_plan=plan_kernel(view, np.array([1.0]), 1.0, even_cell=0.25))
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1, even_cell=waves)
    assert smaller_cell(image, plan) == smaller  # type: ignore[arg-type]
    guessed = plan_waves(view, WAVELENGTH, 0.25, seed=1, share=1.0)
    assert guessed.kernel.grid.cell > plan_waves(view, WAVELENGTH, 0.25, 1, share=1.0, most_cell=0.125).kernel.grid.cell


@pytest.mark.parametrize(
    ("side", "waves_cell", "share"),
    [(2e-5, 1.0, GRID_SHARE), (2e-5, 0.5, 1.0), (1e-3, 1.0, 1.0), (2e-4, 1.0, 1.0)],
    ids=["alike", "other cells", "finer waves than cells", "a blur that cells resolve"],
)
def test_cells_that_are_alike_have_to_resolve_the_waves_only(side: float, waves_cell: float, share: float) -> None:
    """All that twice the size changes may be left of an image by itself whose blur is narrower than two cells."""
    view = seen(side, 0.9 if side == 1e-3 else None, 0.3)
    kernel = plan_kernel(view, np.array([view.camera.magnification(1.0)]), 1.0, even_cell=1.0)
    image = SimpleNamespace(ray_plan=kernel, replicates=SimpleNamespace(change=np.ones((2, 2))))
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1, even_cell=waves_cell)
    found = own_change(image, plan, [WAVELENGTH])  # type: ignore[arg-type]
    assert found is not None and found[0].tolist() == [[1.0] * 2] * 2
    assert found[1] == pytest.approx(share * found[0])
    assert own_change(SimpleNamespace(ray_plan=kernel, replicates=SimpleNamespace(change=None)), plan, [1.0]) is None  # type: ignore[arg-type]


@pytest.mark.long
@pytest.mark.parametrize("waves_cell", [1.0, 0.25])
def test_cells_of_one_size_do_not_show_where_waves_are_smooth(waves_cell: float) -> None:
    """An opening of 2 px, whose waves are 28 px wide, and cells of 1 px.

    By itself the image is off at the edge by the rays' footprint in such cells. In the sum only the waves' footprint
    is left where both have the same cells, and nothing cancels where these of the waves are smaller.
    """
    view = seen(2e-5, None, 0.3)
    rays, change = expected(view.camera, 0.3)
    kernel = plan_kernel(view, np.array([view.camera.magnification(1.0)]), 1.0, even_cell=1.0)
    images = np.zeros((SETS, ROWS, COLUMNS))
    for number in range(SETS):
        for tile, (r0, r1, c0, c1) in enumerate(kernel.tiles):
            cells = decide_tile(view, kernel, tile, (1, number), uncounted)
            images[number, r0:r1, c0:c1] = gathered_tile(
                view, kernel, tile, cells, seed=(2, number), progress=uncounted
            ).values
    plan = plan_waves(view, WAVELENGTH, 0.25, seed=1, even_cell=waves_cell)
    parts = wave_parts(view, [(view, plan)], SETS, progress=uncounted)
    off = [values.mean(axis=(0, 1)) for values in (images, images + parts.change)]
    about = slice(44, 53)  # the edge
    alone, both = (rms((one - known)[about]) for one, known in zip(off, (rays, rays + change), strict=True))
    assert alone > 0.015
    assert both < 0.25 * alone if waves_cell == 1.0 else both > 0.8 * alone


def test_light_from_far_away_shows_most_where_a_pixel_is_dark() -> None:
    """A tenth of the pixels is bright: far light is as bright as the mean, and shows by the slope of the response."""
    view = seen(1e-4, None, 0.3)
    sensor = replace(view.camera.sensor, gamma=0.5, gain=100.0, saturation_gray=1e9)
    view = replace(view, camera=replace(view.camera, sensor=sensor))
    radiance = np.where(np.arange(1000) % 10, 1.0, 100.0)
    unit = 100.0 * math.sqrt(view.exposure_of_radiance)
    slopes = np.where(radiance == 1.0, 0.5, 0.05) * unit
    assert seen_rms(radiance, view) == pytest.approx(10.9 * rms(slopes), rel=0.06)


def test_what_lasts_holds_no_noise_of_rays() -> None:
    """Of three sets with an error in common, 2, and noise of 3: what they have in common is told."""
    noise = np.random.default_rng(1).normal(0, 3, (3, 600, 400))  # of more than one strip

    def common(lasting: Array) -> float:
        return _common_square(lasting, np.full(lasting.shape[1:], 7.0), lambda values: values)

    assert common(2 + noise) == pytest.approx(4, rel=0.02)
    assert common(noise) < 0.1
    assert common(np.stack([np.ones((2, 2)), -np.ones((2, 2))])) == 0.0


def test_an_image_of_many_strips_has_the_error_of_all_its_pixels() -> None:
    """Rows are looked at few at a time: none is left out, and none counts twice."""
    random, shape = np.random.default_rng(5), (601, 400)
    made, change = 5 + np.arange(601)[:, np.newaxis] / 300 + random.random(shape), random.normal(0, 1, (2, *shape))
    cells, beyond = random.normal(0, 0.5, shape), np.full(shape, 0.25)
    parts = WaveParts(change, cells, np.zeros_like(change), beyond, 0, EdgeSampling(1, 0.0))

    def gray(values: Array) -> Array:
        return 3 * values

    found = wave_error(parts, made, gray, 1)
    samples = 3 * (change[0] - change[1]) / 2
    assert found.noise.mean == pytest.approx(float((samples**2).mean()))
    assert found.cells == pytest.approx(9 * float((cells**2).mean()))
    assert found.tails == pytest.approx(0.75)
    off = math.sqrt(found.noise.upper / found.noise.mean) * np.abs(samples) + 3 * np.abs(cells) + 0.75
    assert found.quantile == pytest.approx(float(np.quantile(off, 0.995)))
    assert [row for strip in strips_of(*shape) for row in range(601)[strip]] == list(range(601))


def test_an_image_that_a_budget_ended_too_soon_is_not_taken() -> None:
    """It was made anew, came out worse than before, and was kept all the same."""

    def made(rms: float, rays: int) -> Any:
        return SimpleNamespace(certificate=SimpleNamespace(rms_gray_upper95=rms), used=SimpleNamespace(rays=rays))

    for found, kept, taken in ((8.6, 4.7, 105), (2.1, 2.1, 107)):
        image = _Image(made(4.7, 7), 100, lambda _, found=found: made(found, 5))
        image.make_finer(2.5)
        assert image.made.certificate.rms_gray_upper95 == kept and image.taken == taken
        assert not image.may_be_finer
    image = _Image(made(1.3, 7), 100, lambda _: pytest.fail("it is as fine already"))
    image.make_finer(6.3)
    assert image.made.used.rays == 7 and image.taken == 100


@pytest.mark.long
def test_the_image_is_made_finer_where_hiding_keeps_waves_from_a_tolerance() -> None:
    """Parts before a backlight: cells of waves were made ever finer in vain, with 4e7 rays in all."""
    scene = radwrap.with_value(radwrap.load_scene(CELLS / "backlight.toml"), "camera.sensor.scale", "1/4")
    made = radwrap.render(scene, options=COMPILED, tolerance=0.5)
    assert made.met and made.run.rays < 2e7
    assert made.manifest["diffraction"]["rays"] < 4e6
    diffraction = made.error.diffraction_gray
    assert diffraction is not None and 0.1 < made.manifest["diffraction"]["lasting_gray"] <= diffraction  # .14


@pytest.mark.long
def test_a_small_image_has_waves_in_cells_as_small_as_its_own() -> None:
    """Twice as wide ones changed .19 gray levels, as much as the rest of the error, and saved no ray."""
    scene = radwrap.load_scene(CELLS.parent / "design_edge" / "scene.toml")
    scene = radwrap.with_value(scene, "camera.aperture.diameter", "0.137 mm")
    made = radwrap.render(radwrap.with_value(scene, "camera.exposure_time", "200 ms"), tolerance=0.25)
    assert made.met and made.error.diffraction_gray is not None and made.error.diffraction_gray < 0.1


@pytest.mark.long
def test_waves_are_tried_once_where_time_is_spent(monkeypatch: pytest.MonkeyPatch) -> None:
    """bench_board at 0.02 within 15 s took 117 s."""
    scene = radwrap.with_value(scene_of("on"), "camera.sensor.scale", "1/4")
    free = radwrap.render(scene, options=COMPILED, tolerance=0.1)
    monkeypatch.setattr("radwrap.imaging.tolerance.pace.Pace.is_spent", lambda _: True)
    spent = radwrap.render(scene, options=COMPILED, tolerance=0.1, budget_seconds=1e6)
    assert free.met and not spent.met
    assert spent.run.rays < free.run.rays
    # Waves are in both: what is spared is not their first set.
    assert spent.error.diffraction_gray is not None and free.error.diffraction_gray is not None


@pytest.mark.long
def test_one_wavelength_for_a_wide_line_is_in_the_error() -> None:
    """The same rays in both: only what the mean wavelength leaves out differs."""
    errors = []
    for width in ("1 nm", "130 nm"):
        scene = radwrap.with_value(scene_of("on"), "sources[0].spectrum", {"line": "550 nm", "width": width})
        made = radwrap.render(scene, options=COMPILED, tolerance=4)
        assert made.error.diffraction_gray is not None and scene.spectral is not None
        errors.append(made.error.diffraction_gray)
        left = scene.spectral.wavelength_spread * made.manifest["diffraction"]["about_rms_gray"]
    sigma = 130 / math.sqrt(8 * math.log(2))
    assert left == pytest.approx(5.4 * (sigma / 550) ** 2 / 2, rel=0.15)
    assert errors[1] - errors[0] == pytest.approx(left, rel=0.1)


@pytest.mark.long
def test_noise_is_known_of_an_image_hardly_wider_than_what_waves_blur() -> None:
    """Of two replicates the noise on so few pixels could be anything, and its bound missed the tolerance."""
    document = tomllib.loads(BENCH.read_text())
    document["camera"]["diffraction"] = "on"
    document["camera"]["sensor"] |= {"rows": 12, "columns": 14, "pixel_width": "8 um", "pixel_height": "8 um"}
    made = radwrap.render(radwrap.scene_from_document(document), tolerance=2)
    assert made.met and made.error.diffraction_gray is not None and made.error.diffraction_gray < 1


def test_the_paraxial_scalar_model_is_named_where_it_ends() -> None:
    model = "camera.diffraction.model"
    assert (
        model not in scene_of("auto").assumed and model not in scene_of("off", aperture={"diameter": "10 mm"}).assumed
    )
    for diameter in ("10 mm", "10 um"):
        assert "scalar, paraxial" in scene_of("auto", aperture={"diameter": diameter}).assumed[model]


def test_what_knows_no_waves_is_refused() -> None:
    with pytest.raises(InputError, match="needs an opening"):
        scene_of("on", aperture={"diameter": "0 mm"})
    with pytest.raises(InputError, match=r"method: has no opening"):
        radwrap.render(scene_of("on"), method="pinhole")


@pytest.mark.parametrize(("side", "focus"), [(1e-4, None), (5e-4, 0.6)], ids=["pinhole", "out of focus"])
def test_the_slope_by_the_diameter_is_that_of_the_closed_form(side: float, focus: float | None) -> None:
    """Two footprints, as waves have no second moments: against the closed form of slightly other openings."""
    view = seen(side, focus, 0.3)
    plan = by_diameter(plan_waves(view, WAVELENGTH, 0.1, seed=1))
    found = wave_parts(view, [(view, plan)], 2, progress=lambda _: None).change.mean(axis=0)
    narrower, wider = (sum(expected(seen(factor * side, focus, 0.3).camera, 0.3)) for factor in (0.98, 1.02))
    slope = (wider - narrower) / math.log(1.02 / 0.98)
    # All rows see the same edge: their mean is free of most of the rays' noise.
    assert np.abs(found.mean(axis=0) - slope).max() < 0.1 * np.abs(slope).max()


def of_an_unsure_opening() -> dict[str, Any]:
    """A scene's document."""
    document = tomllib.loads(BENCH.read_text())
    document["camera"]["sensor"] |= {"rows": 44, "columns": 51, "pixel_width": "28 um", "pixel_height": "28 um"}
    document["tolerances"] = {"aperture_diameter": "2 um"}
    return document


@pytest.mark.long
def test_the_opening_of_an_image_with_waves_is_not_sure() -> None:
    """Its light is known of any footprint, where nothing changes; at rims waves turn the sign of what the size does."""
    document, made = of_an_unsure_opening(), {}
    for key in ("on", "off"):
        document["camera"]["diffraction"] = key
        made[key] = radwrap.render(radwrap.scene_from_document(document), tolerance=1.0).sigma
    # Wider by 2 %: 4 % more light, of which waves leave less in the brightest places. To .3 gray: 2.45 and 2.60.
    assert 0.9 * made["off"].max() < made["on"].max() < 0.98 * made["off"].max()


def test_an_unsure_opening_is_refused_of_a_basis_with_waves() -> None:
    document = of_an_unsure_opening()
    document["camera"]["diffraction"] = "auto"
    with pytest.raises(InputError, match=r"tolerances.aperture_diameter: is not known of a light basis"):
        radwrap.render(radwrap.scene_from_document(document), "unused", basis=True)


@pytest.mark.long
@pytest.mark.parametrize(("tolerance", "seed"), [(0.1, 0), (0.016, 1)])
def test_a_kernel_is_not_given_up_before_a_smaller_aim_was_tried(tolerance: float, seed: int) -> None:
    """Finer cells changed nothing, or the bound was wide for lack of pairs: single rays took far more."""
    scene = scene_of("off")
    made = radwrap.render(scene, options=COMPILED, tolerance=tolerance, seed=seed, budget_rays=2e7)
    assert made.met and made.run.method == "kernel"


@pytest.mark.parametrize(
    ("rows", "columns", "even"),
    [
        ([1, 3, 5], [0, 1, 2, 3], True),
        ([0, 1, 2, 3, 4, 5], [2, 5], True),
        ([1, 3, 4], [0, 1], False),
        ([0, 1], [5, 4], False),
        ([2], [0, 1], False),
        ([], [0, 1], False),
    ],
)
def test_places_that_lie_evenly_are_seen_without_a_copy(rows: list[int], columns: list[int], even: bool) -> None:
    image = np.arange(36.0).reshape(6, 6)
    index = _crossing(np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp))
    assert np.array_equal(
        image[index], [[image[row, column] for column in columns] for row in rows] or np.zeros((0, 2))
    )
    assert np.shares_memory(image, image[index]) == even
