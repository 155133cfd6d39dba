"""The wave's point spread against closed forms, and against the field's own integral for shapes that have none."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0, j1, jv, sici

from radwrap.frames import Pose
from radwrap.imaging.optics.aperture import turn
from radwrap.imaging.optics.diffraction import best_opening
from radwrap.imaging.optics.footprint import folded, laid_out, opening_points
from radwrap.imaging.optics.wave_footprint import wave_weights
from radwrap.imaging.optics.waves import Waves
from radwrap.scene.camera import Aperture, Camera, Lens, Sensor
from radwrap.scene.pixel_window import PixelWindow, box, strips

# Transforms are integrals by Gauss' rule, 1e-9, and straight between close values, 3e-5 of what is left at a frequency.
EXACT = 1e-6
BETWEEN = 5e-5

WAVELENGTH, DISTANCE, DIAMETER = 550e-9, 12.5e-3, 0.1e-3
SPREAD = WAVELENGTH * DISTANCE / DIAMETER  # lambda N_w
ROUND = Aperture("round", DIAMETER)
SHAPES = (
    ROUND,
    Aperture("annular", DIAMETER, inner_diameter=0.4 * DIAMETER),
    Aperture("square", DIAMETER, rotation=0.3),
    Aperture("half_disc", DIAMETER, rotation=0.5),
)


def light(aperture: Aperture = ROUND, wavelength: float = WAVELENGTH) -> Waves:
    return Waves(aperture, DISTANCE, wavelength)


def defocus(fresnel: float) -> float:
    """Magnification m = v D at a Fresnel number a^2 D/lambda."""
    return fresnel * WAVELENGTH * DISTANCE / (DIAMETER / 2) ** 2


def camera_of(aperture: Aperture, pitch: float, **more: object) -> Camera:
    sensor = Sensor(64, 64, pitch, pitch, 1.0, 1.0, 0.0, 255.0, **more)  # type: ignore[arg-type]
    return Camera(Pose(), DISTANCE, (31.5, 31.5), 1.0, aperture, sensor)


def radial_intensity(waves: Waves, magnification: float, radius: np.ndarray) -> np.ndarray:
    """Intensity at distances from the middle of a round pattern [m^-2]: the Hankel transform of what passes."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    frequency = (nodes + 1) / 2 * waves.highest_frequency
    passed = waves.transfer(magnification, frequency, np.zeros(1)).real * frequency * weights
    return math.pi * waves.highest_frequency * (j0(2 * np.pi * np.outer(radius, frequency)) @ passed)


def field_intensity(aperture: Aperture, magnification: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """|U|^2 over its integral at places of the central image, by the field's integral over points of the opening."""
    points, weights = dense_points(aperture)
    phase = np.pi / (WAVELENGTH * DISTANCE)
    pupil = weights * np.exp(1j * phase * magnification * (points**2).sum(axis=1))
    places = np.stack([x, y], axis=1)
    field = np.exp(-2j * phase * (places @ points.T)) @ pupil
    return aperture.area / (WAVELENGTH * DISTANCE) ** 2 * np.abs(field) ** 2


def dense_points(aperture: Aperture) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes over an opening, independent of the package's own."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    unit, share = (nodes + 1) / 2, weights / 2
    if aperture.shape == "square":
        x, y = np.meshgrid(nodes, nodes)
        points, both = np.stack([x.ravel(), y.ravel()], axis=1) * aperture.diameter / 2, np.outer(share, share).ravel()
    else:
        whole = math.pi if aperture.shape == "half_disc" else 2 * math.pi
        inner = aperture.inner_diameter / 2
        radius = np.sqrt(inner**2 + ((aperture.diameter / 2) ** 2 - inner**2) * unit)
        angle = whole * (unit - 0.5)
        r, t = np.meshgrid(radius, angle)
        points = np.stack([r.ravel() * np.cos(t.ravel()), r.ravel() * np.sin(t.ravel())], axis=1)
        both = np.outer(share, share).ravel()
    return points @ turn(aperture.rotation).T, both


def test_a_clear_circle_in_focus_has_the_contrast_of_the_textbook() -> None:
    s = np.linspace(0, 1, 101)
    expected = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    found = light().transfer(0.0, s / SPREAD, np.zeros(1))
    assert np.abs(found - expected).max() < BETWEEN
    assert not light().transfer(0.0, np.array([1.01 / SPREAD]), np.zeros(1)).any()


def test_in_focus_its_pattern_is_airys() -> None:
    u = np.linspace(0.1, 20, 200)
    found = radial_intensity(light(), 0.0, u * SPREAD / np.pi)
    peak = np.pi / 4 / SPREAD**2
    assert np.abs(found / peak - (2 * j1(u) / u) ** 2).max() < BETWEEN
    zero = radial_intensity(light(), 0.0, np.array([1.2196698912665045 * SPREAD]))
    assert abs(zero[0]) < BETWEEN * peak


def test_a_ring_is_the_difference_of_two_discs() -> None:
    share = 0.4
    u = np.linspace(0.1, 20, 200)
    field = (2 * j1(u) / u - share**2 * 2 * j1(share * u) / (share * u)) / (1 - share**2)
    peak = np.pi / 4 * (1 - share**2) / SPREAD**2
    found = radial_intensity(light(SHAPES[1]), 0.0, u * SPREAD / np.pi)
    assert np.abs(found / peak - field**2).max() < 3 * BETWEEN


def test_a_square_is_a_slit_each_way_and_its_edge_a_sine_integral() -> None:
    opening = Aperture("square", DIAMETER)
    frequency = np.linspace(-1.2, 1.2, 97) / SPREAD
    passed = light(opening).transfer(0.0, frequency, np.zeros(1))
    assert np.abs(passed - np.maximum(1 - np.abs(frequency) * SPREAD, 0)).max() < EXACT
    # An edge is what lies on one side: the integral of sinc^2 up to x, by the frequencies that pass.
    x = np.linspace(-4, 4, 41) * SPREAD
    nodes, weights = np.polynomial.legendre.leggauss(200)
    f = (nodes + 1) / 2 / SPREAD
    passed = light(opening).transfer(0.0, f, np.zeros(1)).real
    edge = 0.5 + (np.sin(2 * np.pi * np.outer(x, f)) / (np.pi * f)) @ (passed * weights) / 2 / SPREAD
    u = np.pi * x / SPREAD
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = 0.5 + np.where(u == 0, 0, sici(2 * u)[0] - np.sin(u) ** 2 / u) / np.pi
    assert np.abs(edge - expected).max() < EXACT


def test_an_edge_is_steepest_in_its_middle_by_the_closed_form() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(200)
    frequency = (nodes + 1) / 2 / SPREAD
    slope = light().transfer(0.0, frequency, np.zeros(1)).real @ weights / SPREAD
    assert slope * SPREAD == pytest.approx(8 / (3 * math.pi), rel=BETWEEN)


@pytest.mark.parametrize("fresnel", [0.37, 1.0, 2.0, 3.3, 4.0, 12.0])
def test_out_of_focus_the_axis_has_the_textbooks_intensity(fresnel: float) -> None:
    found = radial_intensity(light(), defocus(fresnel), np.zeros(1))[0] / (np.pi / 4 / SPREAD**2)
    half = math.pi * fresnel / 2
    assert found == pytest.approx((math.sin(half) / half) ** 2, abs=BETWEEN)


@pytest.mark.parametrize("fresnel", [0.5, 2.0, 6.0])
def test_out_of_focus_the_plane_has_lommels_intensity(fresnel: float) -> None:
    # Born and Wolf 8.8: I = (2/u)^2 (U_1^2 + U_2^2), u = 2 pi F, v = pi r/(lambda N) times 1.
    u, v = 2 * math.pi * fresnel, np.linspace(0, 25, 60)
    inside = v < u
    first, second = np.zeros(len(v)), np.zeros(len(v))
    for s in range(60):
        outside = u / np.where(inside, 1, v) * ~inside
        first += (-1) ** s * outside ** (1 + 2 * s) * jv(1 + 2 * s, v)
        second += (-1) ** s * outside ** (2 + 2 * s) * jv(2 + 2 * s, v)
    # Beyond the shadow's edge the series of U_n loses no digits, within it that of V_n.
    v0, v1 = np.zeros(len(v)), np.zeros(len(v))
    for s in range(60):
        v0 += (-1) ** s * (v * inside / u) ** (2 * s) * jv(2 * s, v)
        v1 += (-1) ** s * (v * inside / u) ** (1 + 2 * s) * jv(1 + 2 * s, v)
    phase = (u + v**2 / u) / 2
    lit = (2 / u) ** 2 * (1 + v0**2 + v1**2 - 2 * v0 * np.cos(phase) - 2 * v1 * np.sin(phase))
    expected = np.where(inside, lit, (2 / u) ** 2 * (first**2 + second**2))
    found = radial_intensity(light(), defocus(fresnel), v * SPREAD / np.pi) / (np.pi / 4 / SPREAD**2)
    assert np.abs(found - expected).max() < BETWEEN


@pytest.mark.parametrize("aperture", SHAPES, ids=lambda one: one.shape)
@pytest.mark.parametrize("magnification", [-0.8, 0.0, 1.016])
def test_any_opening_gives_the_fields_own_intensity(aperture: Aperture, magnification: float) -> None:
    # Cells so small that their box, and that of a pixel, is none: weights are the intensity itself.
    pitch, cells = SPREAD / 8, 256
    camera = camera_of(aperture, pitch)
    tiny = replace(camera.sensor, window=PixelWindow(box(0.01), box(0.01)))
    weights = np.fft.irfft2(wave_weights(light(aperture), tiny, magnification, 0.125, (cells, cells)), (cells, cells))
    assert weights.sum() == pytest.approx(1, abs=EXACT)
    row, column = np.meshgrid(np.arange(-24, 25, 4), np.arange(-24, 25, 4), indexing="ij")
    x, y = (((at + 0.5) * 0.125 - 0.5) * pitch for at in (column.ravel(), row.ravel()))
    expected = field_intensity(aperture, magnification, x, y) * (pitch / 8) ** 2
    found = weights[row.ravel() % cells, column.ravel() % cells]
    # The grid goes round, and the tails of all its copies come in.
    tail = light(aperture).tail(cells / 16 * pitch)
    assert np.abs(found - expected).max() < 2e-3 * expected.max() + tail / cells**2


@pytest.mark.parametrize("aperture", SHAPES, ids=lambda one: one.shape)
@pytest.mark.parametrize("magnification", [-0.7, 0.0, 1.016])
def test_no_light_is_lost_whatever_the_defocus(aperture: Aperture, magnification: float) -> None:
    for wavelength in (0.0, 450e-9, 650e-9):
        whole = light(aperture, wavelength).transfer(magnification, np.zeros(1), np.zeros(1))[0]
        assert abs(whole - 1) < EXACT


@pytest.mark.parametrize("aperture", SHAPES, ids=lambda one: one.shape)
@pytest.mark.parametrize("magnification", [-1.0, 1.016])
def test_short_waves_are_rays(aperture: Aperture, magnification: float) -> None:
    """Up to frequencies that pixels tell they pass what the opening's magnified shape does, turned as that is."""
    frequency = np.linspace(-0.5, 0.5, 9) / 12e-6
    across, down = (values.ravel() for values in np.meshgrid(frequency, frequency))
    points, weights = opening_points(aperture, 1e-6)
    expected = np.exp(-2j * np.pi * magnification * (np.stack([across, down], axis=1) @ points.T)) @ weights
    for wavelength in (0.0, 0.01e-9):
        waves = light(aperture, wavelength)
        found = waves.transfer(magnification, across, down)
        # Points that stand for the opening are good to 2e-3; waves lose contrast as the rim's length over area says.
        lost = 2 * math.pi**2 * waves.tail(1.0) * np.hypot(across, down).max()
        assert np.abs(found - expected).max() < 2e-3 + lost
        assert lost < 1e-3


@pytest.mark.parametrize("cell", [0.25, 1.0, 4.0])
def test_pixels_and_cells_are_folded_in_alike(cell: float) -> None:
    """In focus the weights are those of the pattern in points, each with the pixel's box around it."""
    window = PixelWindow(strips((1.0, 3.0)), box(0.5))
    camera = camera_of(ROUND, SPREAD / 2, window=window)
    shape = (256, 256) if cell < 1 else (64, 64)
    found = np.fft.irfft2(wave_weights(light(), camera.sensor, 0.0, cell, shape), shape)
    fine = np.arange(-24, 24, 0.125) + 0.0625  # px
    x, y = np.meshgrid(fine, fine)
    u = np.pi * np.hypot(x, y) / 2
    pattern = (2 * j1(u) / u) ** 2 * np.pi / 4 / 4 * 0.125**2
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    expected = laid_out(folded(points, pattern.ravel(), cell, (0, 0), window), shape)
    some = np.ix_(np.arange(-6, 6), np.arange(-6, 6))
    # What lies beyond the points, and comes round.
    left = light().tail(24 * camera.sensor.pixel_width)
    assert np.abs(found[some] - expected[some]).max() < 2e-3 * expected.max() + left / expected.size


def test_tails_fall_as_the_rim_of_the_opening_says() -> None:
    # The Airy pattern's energy beyond a radius is J0^2 + J1^2; its mean over a ring is 2/(pi u).
    radius = 20 * SPREAD
    u = np.pi * np.linspace(19.5, 20.5, 201)
    assert light().tail(radius) == pytest.approx(float((j0(u) ** 2 + j1(u) ** 2).mean()), rel=2e-3)
    assert light().tail(light().tail_radius(0.01)) == pytest.approx(0.01)
    # Of any shape the loss of contrast begins with the same length of rim over area.
    for aperture in SHAPES:
        waves = light(aperture)
        angle = np.linspace(0, 2 * np.pi, 721)[:-1]
        low = 1e-3 * waves.highest_frequency
        lost = 1 - waves.transfer(0.0, low * np.cos(angle), low * np.sin(angle)).real.mean()
        assert 2 * math.pi * lost / low / (2 * math.pi) ** 2 * 2 == pytest.approx(2 * waves.tail(1.0), rel=5e-3)


def edge_slope(diameter: float, distance: float, magnification: float) -> float:
    """Of an edge in its middle, over its contrast [m^-1]."""
    waves = Waves(Aperture("round", diameter), distance, WAVELENGTH)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    frequency = (nodes + 1) / 2 * waves.highest_frequency
    return float(waves.transfer(magnification, frequency, np.zeros(1)).real @ weights * waves.highest_frequency)


@pytest.mark.parametrize(("focus", "depth"), [(None, 1e6), (None, 0.05), (0.3, 0.4)], ids=["far", "near", "lens"])
def test_the_steepest_edge_is_that_of_the_opening_that_is_named(focus: float | None, depth: float) -> None:
    camera = replace(camera_of(ROUND, 1e-5), lens=None if focus is None else Lens(focus))
    v, m = camera.image_distance, float(camera.magnification(depth))
    best = best_opening(camera, WAVELENGTH, [depth])
    assert best is not None
    at, smaller, larger = (edge_slope(share * best.steepest_diameter, v, m) for share in (1.0, 0.93, 1.07))
    assert at > smaller and at > larger
    if depth == 1e6:  # 12.5 mm and 550 nm
        assert best.steepest_diameter == pytest.approx(0.13e-3, abs=0.005e-3)
    # At the balance waves in focus are as steep as the geometric disc.
    d = best.balanced_diameter
    assert edge_slope(d, v, 0.0) == pytest.approx(4 / (math.pi * abs(m) * d), rel=BETWEEN)
    assert best.balanced_f_number == pytest.approx(camera.focal_length / d)
    # A depth in focus asks for nothing.
    assert focus is None or best_opening(camera, WAVELENGTH, [focus]) is None
