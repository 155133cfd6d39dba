"""Edges of known place, angle, blur and gamma; and what is no edge."""

import json
import math
import re
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import fresnel, ndtr
from scipy.stats import exponnorm

from radwrap.cli import measure_edge as command
from radwrap.cli import options
from radwrap.errors import InputError
from radwrap.images import GrayImage, write_png
from radwrap.measure.edges import Edge, disc_edge, fit, measure_edge, pixel_edge
from radwrap.measure.edges.correlation import variance_factor
from radwrap.measure.edges.fit import _strip
from radwrap.measure.edges.model import Model, splines_along
from radwrap.measure.edges.search import find_line
from radwrap.progress import Progress
from radwrap.validate.closed_forms.aperture import blurred_edge

Array = NDArray[np.float64]

# Sums over 16 x 16 points of a pixel stand for its mean to 1/(24 * 256) of E's curvature: 1e-4 of the contrast.
OVERSAMPLING = 16
NOISELESS = 5e-4  # px; what that leaves in position and radius
# The statistics below are seeded; their bounds are 3.5 sigma wide, so a change of the seed fails once in 2000.


def share(angle: float, offset: float, radius: float, *, shape: tuple[int, int] = (56, 60), aspect: float = 1) -> Array:
    """Light beyond an edge by brute force: for each point of a pixel the disc's share that lies beyond."""
    rows, columns = map(np.arange, shape)
    along = radius * math.hypot(math.cos(angle), math.sin(angle) / aspect)  # the normal, of the disc's ellipse
    return blurred_edge(columns, rows, (1, 1), angle=angle, radius=along, offset=offset, points=OVERSAMPLING)


def gray(light: Array, gamma: float = 1.0, low: float = 20, high: float = 180) -> GrayImage:
    return GrayImage(low + (high - low) * light**gamma)


def misplaced(edge: Edge, angle: float, offset: float) -> tuple[float, float]:
    """Errors of angle and offset; a line has two names where its normal is vertical."""
    turned = (edge.angle - angle + math.pi / 2) % math.pi - math.pi / 2
    same = math.cos(edge.angle - angle) > 0
    return turned, (edge.offset if same else -edge.offset) - offset


@pytest.mark.parametrize("order", range(5))
def test_antiderivatives_are_the_disc_integrated(order: int) -> None:
    """int_{t<x} (x - t)^n/n! k(t) dt, summed over chords k of the unit disc."""
    t = (np.arange(200_000) + 0.5) / 100_000 - 1
    chords = 2 / math.pi * np.sqrt(1 - t * t) / 100_000
    for x in (-1.2, -0.7, 0.0, 0.4, 0.99, 1.7):
        moments = np.where(t < x, np.maximum(x - t, 0) ** order / math.factorial(order) * chords, 0).sum()
        assert disc_edge(np.array(2.5 * x), 2.5, order) == pytest.approx(2.5**order * moments, abs=2e-5 * 2.5**order)


def test_known_values_of_the_disc() -> None:
    """By hand: half at the edge, 0 and 1 outside; at S = 1/2 a segment of 120 degrees is left out."""
    values = disc_edge(np.array([-3.0, -2.0, 0.0, 1.0, 2.0, 9.0]), 2.0)
    assert values == pytest.approx([0, 0, 0.5, 1 - (math.pi / 3 - math.sqrt(3) / 4) / math.pi, 1, 1], abs=1e-15)


@pytest.mark.parametrize("angle", [0.0, 5e-4, 0.02, 0.6, math.pi / 4, 1.3])
def test_the_mean_over_a_pixel_is_that_of_its_points(angle: float) -> None:
    distance = np.linspace(-4, 4, 33)
    n = 200
    v, u = (np.indices((n, n)) + 0.5) / n - 0.5
    points = (u * math.cos(angle) + v * math.sin(angle)).ravel()
    for order, mean in enumerate(pixel_edge(distance, 2.0, math.cos(angle), math.sin(angle), 3)):
        brute = disc_edge(distance[:, None] + points, 2.0, order).mean(axis=1)
        assert mean == pytest.approx(brute, abs=1e-5)


def test_a_sharp_edge_on_pixels_is_their_covered_share() -> None:
    """Without blur, along a row at 0 degrees: a ramp of one pixel."""
    means = pixel_edge(np.array([-0.75, -0.25, 0.0, 0.25, 0.75]), 1e-3, 1.0, 0.0)[0]
    assert means == pytest.approx([0, 0.25, 0.5, 0.75, 1], abs=1e-6)


@pytest.mark.parametrize(
    ("angle", "radius", "gamma"), [(0.0, 3.67, 0.85), (0.31, 2.0, 1.4), (-0.9, 3.0, 0.6), (1.5, 5.0, 1.0)]
)
def test_everything_is_found_where_there_is_no_noise(angle: float, radius: float, gamma: float) -> None:
    offset = 29.3 * math.cos(angle) + 28.6 * math.sin(angle)
    edge = measure_edge(gray(share(angle, offset, radius), gamma))
    turned, moved = misplaced(edge, angle, offset)
    assert abs(turned) < 1e-5
    assert abs(moved) < NOISELESS
    assert edge.radius == pytest.approx(radius, abs=NOISELESS)
    assert edge.gamma == pytest.approx(gamma, abs=1e-3)
    assert (edge.low, edge.high) == pytest.approx((20, 180), abs=0.05)
    assert edge.bright_side == "positive"


def gaussian_share(angle: float, offset: float, sigma: float) -> Array:
    """Light beyond an edge that a Gaussian blurs, on pixels: second difference of ((x^2 + s^2) Phi + x s phi)/2."""
    v, u = np.indices((64, 64))
    distance = u * math.cos(angle) + v * math.sin(angle) - offset
    a, b = abs(math.cos(angle)) / 2, abs(math.sin(angle)) / 2

    def second(x: Array) -> Array:
        density = np.exp(-((x / sigma) ** 2) / 2) / math.sqrt(2 * math.pi)
        return np.asarray(((x**2 + sigma**2) * ndtr(x / sigma) + x * sigma * density) / 2)

    corners = second(distance + a + b) - second(distance + a - b) - second(distance - a + b) + second(distance - a - b)
    return corners / (4 * a * b)


def logistic_share(offset: float, scale: float) -> Array:
    """Light right of an edge along the columns that a logistic curve blurs, on pixels: its integral over each."""
    edges = np.arange(65) - 0.5 - offset
    whole = scale * np.logaddexp(0, edges / scale)
    return np.tile(np.diff(whole), (64, 1))


# The sum of discs follows no such curve exactly, and what is left has some side by the pixels' places.
UNBIASED = 0.01  # px; of a contrast of 150 gray in noise of 1 gray the standard error is larger


@pytest.mark.parametrize("sigma", [0.4, *(pytest.param(sigma, marks=pytest.mark.long) for sigma in (0.8, 1.6)), 2.5])
@pytest.mark.parametrize("angle", [0.3, -2.0, math.pi / 4])
def test_a_symmetric_blur_that_is_no_disc_moves_no_edge(sigma: float, angle: float) -> None:
    """As far as one disc was taken for the blur, the edge lay up to 0.16 px on the dark side."""
    offset = 31.6 * math.cos(angle) + 31.2 * math.sin(angle)
    edge = measure_edge(gray(gaussian_share(angle, offset, sigma)), gamma=1.0)
    turned, moved = misplaced(edge, angle, offset)
    across = edge.centre[0] * math.cos(angle) + edge.centre[1] * math.sin(angle) - offset
    assert abs(across) < UNBIASED
    assert abs(turned) < 1e-4
    assert abs(moved) < UNBIASED
    # The disc of the same variance is 2 sigma wide; the one that fits best is narrower.
    assert 1.5 * sigma < edge.radius < 2 * sigma


@pytest.mark.parametrize(
    ("scale", "place"),
    [(0.3, 31.0), (1.2, 31.5), *(pytest.param(*at, marks=pytest.mark.long) for at in ((0.8, 31.3), (1.2, 31.1)))],
)
def test_tails_on_both_sides_of_an_edge_along_the_columns_have_no_side(scale: float, place: float) -> None:
    """Either side bright: each row of pixels shows the same few places across the edge."""
    light = logistic_share(place, scale)
    for image, true, axis in ((light, place, 0), (light[:, ::-1], 63 - place, 0), (light.T, place, 1)):
        edge = measure_edge(gray(image), gamma=1.0, dark=0.0)
        assert edge.centre[axis] == pytest.approx(true, abs=UNBIASED)


@pytest.mark.parametrize("count", [8, pytest.param(60, marks=pytest.mark.long)])
def test_standard_errors_hold_for_a_blur_that_is_no_disc(count: int) -> None:
    """Noisy images of a Gaussian of 1.4 px: mean and mean square of pulls within 3.5 of their deviations."""
    dice = np.random.default_rng(9)
    angle = 0.2
    pulls = []
    for _ in range(count):
        offset = 20 + dice.uniform(-1, 1)
        clean = gray(gaussian_share(angle, offset, 1.4)[:40, :40]).values
        edge = measure_edge(GrayImage(np.rint(clean + dice.normal(0, 2.0, clean.shape))), gamma=1.0)
        across = edge.centre[0] * math.cos(angle) + edge.centre[1] * math.sin(angle) - offset
        pulls.append(across / edge.sigma_position)
    assert abs(float(np.mean(pulls))) < 3.5 / math.sqrt(count)
    assert abs(float(np.mean(np.square(pulls))) - 1) < 3.5 * math.sqrt(2 / count)


def test_a_dark_right_side_keeps_the_line_and_turns_the_sign() -> None:
    light = share(0.2, 32.2, 2.0)
    bright, dark = (measure_edge(gray(image), gamma=1.0) for image in (light, 1 - light))
    assert (dark.angle, dark.offset) == pytest.approx((bright.angle, bright.offset), abs=NOISELESS)
    assert (bright.bright_side, dark.bright_side) == ("positive", "negative")
    assert misplaced(dark, 0.2, 32.2) == pytest.approx((0, 0), abs=NOISELESS)


def test_pixels_that_are_not_square_keep_the_disc_round() -> None:
    """The same disc at 60 degrees; taken for square, the radius is off by up to the aspect."""
    image = gray(share(math.radians(60), 40.2, 3.0, aspect=16 / 13.75))
    right, wrong = measure_edge(image, gamma=1.0, pixel_aspect=16 / 13.75), measure_edge(image, gamma=1.0)
    assert right.radius == pytest.approx(3.0, abs=NOISELESS)
    assert right.offset == pytest.approx(40.2, abs=NOISELESS)
    assert abs(wrong.radius - 3.0) > 0.1


@pytest.mark.parametrize("rows", [40, 12])
@pytest.mark.parametrize("peak", [30.3, 50.0, 10.0])
def test_light_that_falls_off_does_not_move_the_edge(peak: float, rows: int) -> None:
    """A Gaussian beam of sigma 40 px behind the blur; blurring the step alone would be off by 0.08 px at 10.

    A quadratic surface for light would be off by 0.001 to 0.002 px. The dark side is black, gray 22.03 of the dark
    gray 22: taken for unlit, it is off by 0.001 px and more, for gamma bends the foot of the edge.
    """
    n, radius, place = 64, 3.67, 30 + 19 / 64
    u = (np.arange(80 * n) + 0.5) / n - 10.5
    light = np.exp(-(((u - peak) / 40) ** 2) / 2) * (u > place)
    t = np.arange(-int(radius * n), int(radius * n) + 1) / n
    chords = np.sqrt(radius**2 - t * t)
    blurred = np.convolve(light, chords / chords.sum(), "same").reshape(-1, n).mean(axis=1)[10:-10]
    along = np.exp(-(((np.arange(rows) - 0.55 * rows) / 40) ** 2) / 2)
    image = gray(np.outer(along, blurred) + 5e-5, 0.85, low=22)
    edge = measure_edge(image, gamma=0.85, dark=22.0)
    assert edge.centre[0] == pytest.approx(place, abs=5e-4)
    assert edge.angle == pytest.approx(0, abs=1e-4)
    assert edge.radius == pytest.approx(radius, abs=2e-3)


def test_a_dark_side_that_is_lit_needs_the_dark_gray() -> None:
    """G = 10 + 150 H^0.7 with H from 0.2 to 1: with G0 the place is right, without it the dark side is taken for G0."""
    light = 0.2 + 0.8 * share(0.1, 30.2, 3.0)
    image = GrayImage(10 + 150 * light**0.7)
    known, unknown = (measure_edge(image, dark=dark, gamma=0.7) for dark in (10.0, None))
    assert misplaced(known, 0.1, 30.2) == pytest.approx((0, 0), abs=NOISELESS)
    assert abs(unknown.offset - 30.2) > 0.1


def pulls_by_noise(count: int) -> tuple[Array, Array]:
    """Errors over their sigmas, shape (count, 6), and chi-squares of the four whose covariance is known, (count,)."""
    generator = np.random.default_rng(4)
    angle, offset = 0.23, 26.4
    clean = gray(share(angle, offset, 2.5, shape=(24, 48)), 0.85).values
    pulls, squares = [], []
    for _ in range(count):
        noisy = GrayImage(clean + generator.normal(0, 1.5, clean.shape))
        edge = measure_edge(noisy)
        pulls.append(
            [
                (edge.angle - angle) / edge.sigma_angle,
                (edge.offset - offset) / edge.sigma_offset,
                (edge.radius - 2.5) / edge.sigma_radius,
                (edge.gamma - 0.85) / edge.sigma_gamma,
                (edge.low - 20) / edge.sigma_low,
                (edge.high - 180) / edge.sigma_high,
            ]
        )
        error = np.array([edge.offset - offset, edge.angle - angle, edge.radius - 2.5, edge.gamma - 0.85])
        squares.append(float(error @ np.linalg.solve(edge.covariance, error)))
    return np.array(pulls), np.array(squares)


def test_standard_errors_cover_what_ten_noisy_images_do() -> None:
    """The sum of their chi-squares, 40 degrees of freedom, within 3.5 of its deviations, and no pull beyond 4.

    Sigmas half as large again as stated make the sum 90 +- 20, beyond its bound of 71 in 83 of 100 samples, twice as
    large 160 +- 36, in 99; what ten images cannot tell, sixty do (long).
    """
    pulls, squares = pulls_by_noise(10)
    assert abs(squares.sum() - 40) < 3.5 * math.sqrt(2 * 40), squares
    assert np.abs(pulls).max() < 4


@pytest.mark.long
def test_standard_errors_cover_what_noise_does() -> None:
    """60 noisy images: chi-square per parameter against its own expectation of 1, and shares within 1 and 2 sigma."""
    count = 60
    pulls, _ = pulls_by_noise(count)
    square = np.mean(np.square(pulls), axis=0)
    assert np.all(np.abs(square - 1) < 3.5 * math.sqrt(2 / count)), square
    for sigmas, expected in ((1, 0.683), (2, 0.954)):
        inside = np.mean(np.abs(pulls) < sigmas, axis=0)
        assert np.all(np.abs(inside - expected) < 3.5 * math.sqrt(expected * (1 - expected) / count)), inside


@pytest.mark.long
@pytest.mark.parametrize("count", [12, 50])
def test_standard_errors_cover_rounding_that_is_the_same_in_every_row(count: int) -> None:
    """Some places of an edge along the columns, gamma fitted, no noise: a pixel count would say 0.03 px of 0.09.

    Errors of places within one pixel are nearly independent; bounds are 3.5 binomial standard deviations wide,
    upwards they are open: what is not known may be overstated, not understated. With a pixel count's sigma one half
    lies within two of them, and 12 places, of which 9 must, find that in 93 of 100 samples; 50 always.
    """
    pulls = []
    for i in range(count):
        place = 30 + i / count
        edge = measure_edge(GrayImage(np.rint(gray(share(0.0, place, 3.67, shape=(24, 60)), 0.85, 22, 62).values)))
        pulls.append([(edge.centre[0] - place) / edge.sigma_position, (edge.gamma - 0.85) / edge.sigma_gamma])
    for sigmas, expected in ((1, 0.683), (2, 0.954), (3, 0.997)):
        inside = np.mean(np.abs(pulls) < sigmas, axis=0)
        assert np.all(inside > expected - 3.5 * math.sqrt(expected * (1 - expected) / count)), (sigmas, inside)
    # Nor is it overstated so far that it tells nothing.
    assert np.all(np.mean(np.square(pulls), axis=0) > 0.2)


def test_independent_noise_raises_no_variance_and_rows_alike_raise_it_by_their_number() -> None:
    """Hand-made residuals on 20 rows of 40 pixels: 20 equal rows are one; the factor scatters by sqrt(2/40)."""
    generator = np.random.default_rng(8)
    v, u = (index.ravel().astype(float) for index in np.indices((20, 40)))
    factors = [variance_factor(u, v, generator.normal(size=800)) for _ in range(40)]
    assert np.mean(np.equal(factors, 1.0)) >= 0.95
    alike = [variance_factor(u, v, np.tile(generator.normal(size=40), 20)) for _ in range(40)]
    # Neighbours that go together by chance are counted, those that do not are not: some 15 % too much.
    assert 18 < np.mean(alike) < 26
    assert variance_factor(u, v, np.zeros(800)) == 1.0


@pytest.mark.parametrize("angle", [0.5, -1.1])
def test_the_covariance_gives_the_error_where_the_edge_is(angle: float) -> None:
    """A line moves at c by d offset - (c . n') d angle, n' = (-sin, cos): at the centre that is sigma_position."""
    offset = 34 * math.cos(angle) + 27 * math.sin(angle)
    clean = gray(share(angle, offset, 2.0)).values
    noisy = GrayImage(clean + np.random.default_rng(2).normal(0, 1, clean.shape))
    edge = measure_edge(noisy, gamma=1.0, region=(6, 4, 57, 52))
    lever = np.array([1, edge.centre[0] * math.sin(edge.angle) - edge.centre[1] * math.cos(edge.angle)])
    assert math.sqrt(lever @ edge.covariance[:2, :2] @ lever) == pytest.approx(edge.sigma_position, rel=1e-6)
    assert edge.sigma_offset > 1.05 * edge.sigma_position


def test_a_region_speaks_of_the_whole_image() -> None:
    """Two edges; the region holds one, and its numbers are those of the image."""
    both = share(0.1, 20.4, 2.0) * (1 - share(-0.2, 38.0, 2.0))
    edge = measure_edge(gray(both), gamma=1.0, region=(2, 5, 29, 50))
    assert misplaced(edge, 0.1, 20.4) == pytest.approx((0, 0), abs=2 * NOISELESS)
    assert 5 < edge.centre[1] < 50


def test_saturated_pixels_are_left_out() -> None:
    image = gray(share(0.1, 30.2, 2.0)).values
    image[10:14, 35:37] = 255
    edge = measure_edge(GrayImage(image), gamma=1.0)
    assert edge.saturated == 8
    assert misplaced(edge, 0.1, 30.2) == pytest.approx((0, 0), abs=NOISELESS)


SQUARE = np.indices((56, 60)).astype(float)
NOISE = np.random.default_rng(1)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((56, 60), 50.0), "is blank: gray 50"),
        (np.full((56, 60), 255.0), "is saturated all over"),
        (np.full((1, 1), 50.0), "1 x 1 pixels, an edge needs 12 x 12"),
        (NOISE.normal(100, 5, (56, 60)), "no edge above its noise"),
        (NOISE.integers(0, 256, (56, 60)).astype(float), "no edge above its noise"),
        (2 * SQUARE[1], "not show a complete edge"),
        (20 + 100 * np.exp(-((SQUARE[1] - 30) ** 2 + (SQUARE[0] - 28) ** 2) / 450), "no single straight edge"),
        (20 + 100 * disc_edge(20 - np.hypot(SQUARE[1] - 30, SQUARE[0] - 28), 2.0), "no single straight edge"),
        (gray(share(0.0, 30.2, 2.0) * share(1.57, 28.0, 2.0)).values, "no single straight edge"),
        (gray(np.abs(share(0.3, 36.0, 2.0) - share(-0.9, -4.0, 2.0))).values, "name a region that holds one edge"),
        (gray(share(0.0, 59.3, 2.0)).values, "not show a complete edge"),
        (gray(share(0.0, 56.2, 2.0)).values, "not show a complete edge"),
        (np.minimum(gray(share(0.0, 30.2, 2.0), high=400).values, 255), "is saturated: 4.% of the pixels"),
    ],
)
def test_what_is_no_single_edge_is_refused(values: Array, message: str) -> None:
    with pytest.raises(InputError, match=message):
        measure_edge(GrayImage(values), gamma=1.0)


def test_nan_never_becomes_an_image() -> None:
    with pytest.raises(ValueError, match="NaN"):
        GrayImage(np.full((20, 20), np.nan))


def test_a_sharp_edge_tells_nothing_about_gamma() -> None:
    sharp = GrayImage(np.where(SQUARE[1] > 30, 180.0, 20.0))
    with pytest.raises(InputError, match="nothing about gamma"):
        measure_edge(sharp)
    assert measure_edge(sharp, gamma=1.0).offset == pytest.approx(30.5, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"saturation": math.nan}, "saturation"),
        ({"saturation": -5.0}, "saturation"),
        ({"dark": 500.0}, "dark"),
        ({"gamma": 9.0}, "gamma"),
        ({"dark": math.nan}, "dark"),
        ({"pixel_aspect": 0.0}, "pixel_aspect"),
        ({"region": (0, 0, 99, 20)}, "region"),
        ({"region": (30, 0, 20, 20)}, "region"),
        ({"region": (0, 0, 5, 20)}, "region"),
        ({"region": (0, 0, 20, 55)}, "the image"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as caught:
        measure_edge(gray(share(0.0, 40.2, 2.0)), **options)
    assert caught.value.where == where


def run(*arguments: str) -> int:
    import argparse

    parser = argparse.ArgumentParser()
    command.add_to(parser.add_subparsers())
    parsed = parser.parse_args(["edge", *arguments])
    return int(parsed.run(parsed))


def test_the_command_tells_what_the_function_finds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "edge.png"
    write_png(path, np.rint(gray(share(0.1, 30.2, 2.0)).values).astype(np.uint8))
    assert run(str(path), "--gamma", "1", "--region", "5", "5", "54", "50", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema_version"] == 1
    assert (told["offset"], told["angle"]) == pytest.approx((30.2, 0.1), abs=0.01)
    assert told["transition_width"] == 2 * told["radius"]
    assert np.sqrt(np.diag(told["covariance"]["values"])) == pytest.approx(
        [told["sigma_offset"], told["sigma_angle"], told["sigma_radius"], told["sigma_gamma"]]
    )
    assert run(str(path)) == 0
    told_plainly = capsys.readouterr().out
    assert "gamma: 1.0" in told_plainly
    assert "place and gamma can hardly be separated" in told_plainly
    assert run(str(path), "--gamma", "1") == 0
    assert "can hardly be separated" not in capsys.readouterr().out


def test_a_plateau_below_full_scale_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Clipped at 150 of 8 bits: gamma takes the clipping up and leaves no residual, so the levels must tell."""
    whole = gray(share(0.1, 30.2, 4.0)).values + np.random.default_rng(5).normal(0, 1, (56, 60))
    path = tmp_path / "edge.png"
    write_png(path, np.rint(whole).astype(np.uint8))
    assert run(str(path), "--json") == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    write_png(path, np.rint(np.minimum(whole, 150)).astype(np.uint8))
    assert run(str(path)) == 0
    assert "warning: 100% of the bright side has one and the same gray level" in capsys.readouterr().out
    with pytest.raises(InputError, match="is saturated"):
        run(str(path), "--saturation", "150")


def across_the_edge(kind: str) -> Array:
    """Light along a row of 60 pixels, by 16 points of each: a step about 30.2 that is one or that is none."""
    x = (np.arange(60 * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5 - 30.2
    sine, cosine = fresnel(x / 3.0)
    light = {
        "Gaussian": ndtr(x / 1.2),
        "motion": np.clip(0.5 + x / 5, 0, 1),
        "two edges": 0.6 * ndtr((x + 2.5) / 0.8) + 0.4 * ndtr((x - 2.5) / 0.8),
        "diffraction": 0.35 * ((cosine + 0.5) ** 2 + (sine + 0.5) ** 2),
        "a bright line beside": ndtr(x / 1.2) + 0.3 * np.exp(-(((x - 6) / 1.5) ** 2) / 2),
        "coma": np.where(x > -8, exponnorm.cdf(x, 3.0, scale=0.8), 0),
        "saturation": np.minimum(ndtr(x / 1.2), 0.7),
    }[kind]
    return np.asarray(light.reshape(60, OVERSAMPLING).mean(axis=1))


@pytest.mark.parametrize(
    ("kind", "warned"),
    [
        ("Gaussian", ""),
        ("motion", ""),
        ("two edges", "across the edge light differs"),
        ("diffraction", "across the edge light differs"),
        ("a bright line beside", "across the edge light differs"),
        ("coma", "across the edge light differs"),
        ("saturation", "one and the same gray level"),
    ],
)
def test_what_is_no_single_step_is_warned_of(
    kind: str, warned: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows of whole gray levels with noise of one of them; the saturated ones are clipped after the noise."""
    rows = 30 + 150 * np.tile(across_the_edge(kind), (40, 1))
    noisy = np.rint(rows + np.random.default_rng(6).normal(0, 1, rows.shape))
    path = tmp_path / "edge.png"
    write_png(path, (np.minimum(noisy, 135) if kind == "saturation" else noisy).astype(np.uint8))
    assert run(str(path), "--gamma", "1", "--json") == 0
    told = " ".join(json.loads(capsys.readouterr().out)["warnings"])
    assert warned in told if warned else told == ""


@pytest.mark.parametrize("given", ["fitted", "0.85"])
@pytest.mark.parametrize("kind", ["Gaussian", "disc"])
def test_a_fitted_gamma_is_warned_of_where_the_blur_is_no_disc(
    kind: str, given: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What one does to the profile another gamma and place do nearly as well: by up to 0.5 px and ten sigmas."""
    light = share(0.3, 30.2, 3.0) if kind == "disc" else gaussian_share(0.3, 30.2, 1.5)
    noisy = gray(light, 0.85, 20).values + np.random.default_rng(8).normal(0, 0.7, light.shape)
    path = tmp_path / "edge.png"
    write_png(path, np.rint(noisy).astype(np.uint8))
    assert run(str(path), "--gamma", given, "--dark", "20", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert any("the blur is not a disc" in text for text in told["warnings"]) == (
        kind == "Gaussian" and given == "fitted"
    )
    assert (told["beyond_disc"] > 5) == (kind == "Gaussian")


@pytest.mark.parametrize("dark", [30.2, 30.47])
def test_rounding_that_is_the_same_in_every_row_is_no_misfit(dark: float) -> None:
    """A contrast of 40 gray without noise: rounding leaves up to half a gray level at each distance."""
    rows = dark + 40 * np.tile(across_the_edge("Gaussian"), (40, 1))
    edge = measure_edge(GrayImage(np.rint(rows)), gamma=1.0)
    assert (edge.misfit, edge.even_misfit) == (0, 0)


def test_errors_of_the_command_name_file_or_option(tmp_path: Path) -> None:
    import OpenImageIO as oiio  # noqa: N813

    path = tmp_path / "blank.png"
    write_png(path, np.full((20, 20), 7, np.uint8))
    with pytest.raises(InputError, match="blank"):
        run(str(path))
    with pytest.raises(InputError) as caught:
        run(str(path), "--gamma", "two")
    assert caught.value.where == "gamma"
    with pytest.raises(InputError) as caught:
        run(str(path), "--region", "0", "0", "50", "50")
    assert caught.value.where == "region", "which the command spells as its option"
    cut = tmp_path / "cut.png"
    cut.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match=r"cut\.png"):
        run(str(cut))
    colour = tmp_path / "colour.tif"
    pixels = np.zeros((20, 20, 3), np.uint8)
    pixels[:, 10:, 0] = 200
    output = oiio.ImageOutput.create(str(colour))
    output.open(str(colour), oiio.ImageSpec(20, 20, 3, "uint8"))
    output.write_image(pixels)
    output.close()
    with pytest.raises(InputError, match="is in colour"):
        run(str(colour))


@pytest.mark.long
def test_the_reduced_fit_knows_all_that_least_squares_ask_for() -> None:
    """J^T J, J^T f and f^T f of the banded decomposition, against the whole Jacobian of an edge of 300 px."""
    image = gray(share(0.3, 100.0, 2.0, shape=(300, 120))).values
    line = find_line(image)
    strip = _strip(image, image < 179.99, line)  # some pixels are saturated
    s = line.along(strip.u, strip.v)
    base = np.column_stack([np.ones_like(s), s / 300])
    model = Model(strip, line, 1.0, None, 160.0, splines_along(s, float(s.min()), float(s.max())), base)
    splines = model.along
    parameters = np.random.default_rng(1).uniform(0.9, 1.1, 4 + 2 + 3 * splines.count)
    local = model._slopes_and_residual(parameters)[:, :-1]
    whole = np.zeros((len(s), len(parameters)))
    whole[:, :6] = local[:, :6]
    for third in range(3):
        columns = 6 + third * splines.count + splines.first[:, None] + np.arange(4)
        np.put_along_axis(whole, columns, local[:, 6 + 4 * third : 10 + 4 * third], axis=1)
    whole, residual = whole[strip.usable], model.residual(parameters)
    jacobian, left = model.reduced(parameters)
    assert 0 < strip.usable.sum() < len(s) and splines.count > 8 and len(jacobian) <= len(parameters) + 1
    scale = float(np.abs(whole.T @ whole).max())
    assert jacobian.T @ jacobian == pytest.approx(whole.T @ whole, rel=1e-10, abs=1e-14 * scale)
    assert jacobian.T @ left == pytest.approx(whole.T @ residual, rel=1e-10)
    assert left @ left == pytest.approx(residual @ residual, rel=1e-13)


@pytest.mark.long
def test_a_large_picture_takes_no_more_memory_than_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Peak of what Python's allocators give out."""
    monkeypatch.setattr(options, "_WORTH_A_WORD", 0)
    path = tmp_path / "edge.png"
    write_png(path, np.rint(long_edge(250, 20.0)).astype(np.uint8))  # half of it is the strip
    assert run(str(path), "--gamma", "1") == 0  # loads modules, which count as well
    capsys.readouterr()
    tracemalloc.start()
    assert run(str(path), "--gamma", "1") == 0
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "0.0625 million pixels take up to 0.0 GiB" in capsys.readouterr().err
    most = 250**2 * (command._BYTES + command._STRIP_BYTES)
    assert most / 4 < peak < most


def test_an_edge_too_large_for_its_fit_is_refused_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    image = GrayImage(long_edge(200, 20.0))
    monkeypatch.setattr(fit, "MOST_BYTES", 1 << 20)
    monkeypatch.setattr(fit, "_strip", None)  # which would lay out all of its pixels
    with pytest.raises(InputError, match=r"fit takes .* GiB of memory.*name a region, some \d+ px long"):
        measure_edge(image)


def test_it_says_how_far_it_is(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radwrap.progress._LOG_PERIOD", 0.0)
    told = Progress("measuring the edge", 1)
    measure_edge(GrayImage(long_edge(100, 2.0)), progress=told)
    shares = [int(share) for share in re.findall(r"measuring the edge +(\d+) %", capsys.readouterr().err)]
    assert len(shares) > 5 and 0 < shares[0] < 100


def long_edge(size: int, blur: float) -> Array:
    angle = 0.1
    v, u = np.indices((size, size), dtype=float)
    across = np.clip((u - size / 2) * math.cos(angle) + (v - size / 2) * math.sin(angle), -2 * blur, 2 * blur)
    noise = np.random.default_rng(2).normal(0, 1, (size, size))
    return np.asarray(20 + 160 * disc_edge(across, blur) + noise)


def test_light_that_only_slopes_has_no_edge() -> None:
    """An edge that is blurred over more than the picture; it was an error of radwrap's own."""
    rows, columns = np.mgrid[:24, :32]
    levels = np.rint(148 - 0.55 * rows + (5 + 0.012 * columns) * columns)
    with pytest.raises(InputError, match="shows no straight edge: its gradients lie along no line"):
        measure_edge(GrayImage(levels, 12), gamma=1)
