"""The closed forms themselves: against brute force, each other, and printed numbers."""

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from radwrap.validate.closed_forms import aperture, sensor, sheeting, sources

ROUNDING = 1e-13
QUADRATURE = 1e-7  # of scipy's, asked for 1e-8


@pytest.mark.parametrize("s", [-1.5, -1.0, -0.3, 0.0, 0.5, 1.0, 2.0])
def test_share_beyond_is_that_of_a_disc_s_points(s: float) -> None:
    x, y = np.meshgrid(*2 * [(np.arange(2000) + 0.5) / 1000 - 1])
    disc = x**2 + y**2 < 1
    # The rim crosses 4 of 2000 x 2000 points in 2000: a share of some 1e-4 at most.
    assert aperture.share_beyond(s) == pytest.approx((disc & (x > -s)).sum() / disc.sum(), abs=2e-4)


def test_an_edge_over_pixels() -> None:
    """Mirrored it is the rest; turned by a right angle, columns are rows; a sharp one is cut at its place."""
    columns, rows, pitch = np.arange(-3.0, 3.5), np.arange(-2.0, 2.5), (1.0, 1.0)
    seen = aperture.blurred_edge(columns, rows, pitch, angle=0.4, radius=1.7, offset=0.3)
    rest = aperture.blurred_edge(columns, rows, pitch, angle=0.4 + math.pi, radius=1.7, offset=-0.3)
    assert seen + rest == pytest.approx(np.ones_like(seen), rel=ROUNDING)
    turned = aperture.blurred_edge(rows, columns, pitch, angle=math.pi / 2 - 0.4, radius=1.7, offset=0.3)
    assert np.allclose(turned.T, seen, rtol=ROUNDING)
    sharp = aperture.blurred_edge(columns, rows, pitch, angle=0.0, radius=0.0, offset=0.25)
    assert sharp[0].tolist() == [0, 0, 0, 0.25, 1, 1, 1]  # midpoints of 16: exact where a quarter is beyond


@pytest.mark.parametrize("height", [0.0, 2e-3])
def test_an_even_field_is_the_integral_over_the_opening(height: float) -> None:
    radius, distance = 4e-3, 0.0125

    def piece(turn: float, r: float) -> float:
        square = (height - r * math.cos(turn)) ** 2 + (r * math.sin(turn)) ** 2
        return float(aperture.cos4(math.sqrt(square), 0.0, distance)) / distance**2 * r

    due = dblquad(piece, 0, radius, 0, 2 * math.pi, epsrel=1e-9)[0]
    assert aperture.even_field_irradiance(radius, distance, height) == pytest.approx(due, rel=QUADRATURE)
    # A small opening is the pinhole's.
    small = aperture.pinhole_exposure(aperture.cos4(height, 0.0, distance), 2e-7, distance)
    assert aperture.even_field_irradiance(1e-7, distance, height) == pytest.approx(small, rel=1e-4)


def test_no_area_left() -> None:
    """Any parabola in 1/N is taken to its value at 0."""
    numbers = (7, 19, 61)
    values = [np.array([3 + 5 / n - 11 / n**2]) for n in numbers]
    assert aperture.at_zero_area(numbers, values)[0] == pytest.approx(3.0, rel=ROUNDING)


def test_numbers_of_the_paper() -> None:
    """Eq. 8's R = 4.77 mm at 1 m; 47.1 mW/sr of an LED of 5.08 mm; a lobe's peak rho/(4 pi a^2)."""
    assert aperture.projection_radius(1e-4, 1.0, 10.59e-3) == pytest.approx(4.77e-3, abs=5e-6)
    assert sources.small_disc_intensity(2324, 2.54e-3) == pytest.approx(0.0471, abs=5e-5)
    assert sheeting.perturbed_normal_lobe(0.6, 0.02, 0.0) == pytest.approx(0.6 / (4 * math.pi * 0.02**2), rel=ROUNDING)


def test_discs_agree_on_the_axis_and_far_away() -> None:
    on_axis = sources.disc_irradiance(3.0, 0.4, 0.7)
    assert sources.disc_irradiance_beside(3.0, 0.4, 0.7, (0.0, 0.0)) == pytest.approx(on_axis, rel=QUADRATURE)
    annulus = sources.disc_irradiance_beside(3.0, 0.4, 0.7, (0.1, 0.2), inner_radius=0.25)
    whole, hole = (sources.disc_irradiance_beside(3.0, r, 0.7, (0.1, 0.2)) for r in (0.4, 0.25))
    assert annulus == pytest.approx(whole - hole, rel=QUADRATURE)
    # From afar a point: I falls with the cosine.
    cosine = 0.7 / math.hypot(0.7, 0.5)
    point = sources.point_irradiance(sources.small_disc_intensity(3.0, 1e-4, cosine), 0.7, 0.5)
    assert sources.disc_irradiance_beside(3.0, 1e-4, 0.7, (0.3, 0.4)) == pytest.approx(point, rel=1e-6)


@pytest.mark.parametrize(("x", "y"), [((-0.5, 0.5), (-0.5, 0.5)), ((-1.0, 0.0), (0.0, 1.0)), ((0.2, 0.9), (-0.4, 0.1))])
def test_a_rectangle_is_its_integral(x: tuple[float, float], y: tuple[float, float]) -> None:
    height = 0.8
    due = dblquad(lambda b, a: (height / (a * a + b * b + height**2)) ** 2 / math.pi, *x, *y, epsrel=1e-9)[0]
    assert sources.rectangle_factor(x, y, height) == pytest.approx(due, rel=QUADRATURE)


def test_a_square_at_its_own_size() -> None:
    """Below the centre of 1 x 1 m at 1 m: four corners of 2 (a/p) atan(a/p)/(2 pi), a/p = 1/sqrt(5)."""
    by_hand = 4 / math.pi / math.sqrt(5) * math.atan(1 / math.sqrt(5))
    assert sources.rectangle_factor((-0.5, 0.5), (-0.5, 0.5), 1.0) == pytest.approx(by_hand, rel=ROUNDING)


def test_half_of_a_gaussian_is_left_at_half_its_width() -> None:
    assert sources.gaussian_intensity(3.8, sources.sigma_of_fwhm(7.6)) == pytest.approx(0.5, rel=ROUNDING)


@pytest.mark.parametrize(("alpha", "beta", "around"), [(0.2, -4, 90), (2.0, 30, 180), (30.0, 10, 0)])
def test_angles_of_astm_e808(alpha: float, beta: float, around: float) -> None:
    light, view = sheeting.light_direction(beta), sheeting.view_direction(alpha, beta, around)
    assert math.degrees(math.acos(light[2])) == pytest.approx(abs(beta))
    assert np.linalg.norm(view) == pytest.approx(1.0, rel=ROUNDING)
    assert math.degrees(math.acos(light @ view)) == pytest.approx(alpha)


def test_glass_beads_are_straight_in_the_logarithm() -> None:
    """By hand between the last nodes, and at half a degree the anchor."""
    assert sheeting.glass_beads(95, 1.25, 30.0) == pytest.approx(95 * math.sqrt(0.374 * 0.549) * math.exp(-900 / 2220))
    assert sheeting.glass_beads(95, 0.5) == 95


def test_gray_levels_by_heart() -> None:
    """1000 * 0.04^0.5 = 200; h c/lambda is one photon; (64 + 400)/16 and a twelfth."""
    assert sensor.power_law(0.04, gain=1000, gamma=0.5, dark_gray=22) == pytest.approx(222, rel=ROUNDING)
    energy = 6.62607015e-34 * 299792458 / 650e-9
    assert sensor.photons(energy / 20e-12, 20e-12, 650e-9) == pytest.approx(1.0, rel=ROUNDING)
    assert sensor.transfer_mean(400, gain=0.25, offset=100) == 200
    assert sensor.transfer_variance(400, gain=0.25, read_noise=8) == pytest.approx(4 + 25 + 1 / 12, rel=ROUNDING)
