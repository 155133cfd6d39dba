"""Aberrations of a lens: Zernike polynomials, the point spread behind them, and which way it points in an image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from radwrap.imaging.optics.lens_field import glass_at, images_of, lens_field
from radwrap.imaging.optics.measured_spread import MeasuredSpread
from radwrap.imaging.optics.pupil_path import PupilPath
from radwrap.imaging.optics.view import View
from radwrap.imaging.optics.wave_footprint import wave_weights
from radwrap.imaging.optics.waves import Waves
from radwrap.imaging.tolerance.wave_parts import wave_parts
from radwrap.imaging.tolerance.wave_plan import plan_waves
from radwrap.scene.aberrations import ContrastTable, PointSpread, Wavefront
from radwrap.scene.camera import Aperture, Camera, Lens
from radwrap.scene.pixel_window import PixelWindow, box
from radwrap.scene.zernike import HIGHEST_ORDER, Order, order_of, rms, zernike_sum
from radwrap.tracers.tracer import Tracer
from tests.imaging.planes import Array, Planes, camera

WAVELENGTH, DISTANCE, DIAMETER = 550e-9, 12.5e-3, 0.1e-3
LOST = 1e-7  # polynomials of order 20 are sums of numbers up to 1e8
RADIUS, SPREAD = DIAMETER / 2, WAVELENGTH * DISTANCE / DIAMETER  # lambda N_w
ROUND = Aperture("round", DIAMETER)
SHAPES = (
    ROUND,
    Aperture("annular", DIAMETER, inner_diameter=0.4 * DIAMETER),
    Aperture("square", DIAMETER, rotation=0.3),
    Aperture("half_disc", DIAMETER, rotation=0.5),
)
# Sums over squares of the opening, see `pupil_path`: measured 1.2e-4 at a defocus of 6, 5e-5 else.
SQUARES = 2e-4
# Straight and pointed rims that squares cut: measured 1.5e-4 at most.
CORNERS = 4e-4
QUADRATURE = 1e-12

# Noll 1976, Table I; Thibos et al. 2002 (the standard's list), n and m; Wyant and Creath 1992, Table III, from 1.
NOLL = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0), (4, 2), (4, -2)]
OSA = [(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2), (3, -3), (3, -1), (3, 1), (3, 3), (4, -4), (4, -2), (4, 0)]
FRINGE = [(0, 0), (1, 1), (1, -1), (2, 0), (2, 2), (2, -2), (3, 1), (3, -1), (4, 0), (3, 3), (3, -3), (4, 2), (4, -2)]


def pupil_nodes(number: int = 48) -> tuple[Array, Array, Array]:
    """Radius over the pupil's, angle and weight (they sum to 1) of Gauss nodes over a disc."""
    nodes, weights = np.polynomial.legendre.leggauss(number)
    angle = np.arange(4 * number) * 2 * np.pi / (4 * number)
    rho, theta = np.meshgrid(np.sqrt((nodes + 1) / 2), angle, indexing="ij")
    return rho, theta, np.broadcast_to(weights[:, np.newaxis] / 2 / len(angle), rho.shape)


def behind(coefficients: dict[Order, float], aperture: Aperture = ROUND) -> Waves:
    """Waves behind glass of polynomials of rms 1 [waves]."""
    paths = tuple(value * WAVELENGTH for value in coefficients.values())
    return Waves(aperture, DISTANCE, WAVELENGTH, PupilPath(RADIUS, tuple(coefficients), paths))


@pytest.mark.parametrize(("convention", "first", "listed"), [("osa", 0, OSA), ("noll", 1, NOLL), ("fringe", 1, FRINGE)])
def test_numbers_are_those_of_the_published_lists(convention: str, first: int, listed: list[Order]) -> None:
    assert [order_of(convention, first + place) for place in range(len(listed))] == listed  # type: ignore[arg-type]
    assert order_of(convention, first - 1) is None  # type: ignore[arg-type]


def test_the_fringe_set_ends_as_design_programs_have_it() -> None:
    assert [order_of("fringe", index) for index in (16, 25, 36, 37, 38)] == [(6, 0), (8, 0), (10, 0), (12, 0), None]


def zernike(order: Order, rho: Array, theta: Array) -> Array:
    return zernike_sum([order], [1.0], rho * np.cos(theta), rho * np.sin(theta))


def test_polynomials_are_orthonormal_over_the_pupil() -> None:
    rho, theta, weight = pupil_nodes()
    orders = [order for order in (order_of("osa", index) for index in range(66)) if order]  # up to order 10
    values = np.array([zernike(order, rho, theta).ravel() for order in orders])
    products = (values * weight.ravel()) @ values.T
    assert np.abs(products - np.eye(len(orders))).max() < QUADRATURE


def test_a_sum_is_that_of_its_terms() -> None:
    """Up to the highest order, a term that is 0 among them, at places in rows and columns."""
    rng = np.random.default_rng(5)
    orders = [(n, m) for n in (0, 1, 2, 5, 8, HIGHEST_ORDER) for m in range(-n, n + 1, 2)]
    values = rng.normal(size=len(orders))
    values[3] = 0.0
    x, y = np.linspace(-0.7, 0.7, 9), np.linspace(-0.7, 0.7, 7)[:, np.newaxis]
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    expected = sum(value * zernike(order, rho, theta) for order, value in zip(orders, values, strict=True))
    assert zernike_sum(orders, values.tolist(), x, y) == pytest.approx(expected, abs=LOST)


def test_a_term_of_unit_peak_is_one_at_the_rim() -> None:
    for index in range(1, 38):
        order = order_of("fringe", index)
        assert order is not None
        values = rms(order) * zernike(order, np.ones(720), np.arange(720) * np.pi / 360)
        assert values.max() == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("fresnel", [-2.0, 0.37, 2.0, 6.0])
def test_a_coefficient_of_defocus_is_that_defocus(fresnel: float) -> None:
    """M q^2/(2 v) is sqrt(3) (2 rho^2 - 1) times m a^2/(4 sqrt(3) v), and a piston that nobody sees."""
    m = fresnel * WAVELENGTH * DISTANCE / RADIUS**2
    waves = m * RADIUS**2 / (4 * math.sqrt(3) * DISTANCE) / WAVELENGTH
    frequency = np.linspace(-1.05, 1.05, 63) / SPREAD
    across, down = frequency[np.newaxis], frequency[:, np.newaxis]
    perfect = Waves(ROUND, DISTANCE, WAVELENGTH)
    found = behind({(2, 0): waves}).transfer(0.0, across, down)
    assert np.abs(found - perfect.transfer(m, across, down)).max() < SQUARES
    undone = behind({(2, 0): -waves}).transfer(m, across, down)
    assert np.abs(undone - perfect.transfer(0.0, across, down)).max() < SQUARES


def test_a_tilt_moves_the_image_by_its_slope() -> None:
    """A path that grows upwards, 2 c rho sin(theta), lets a pixel see what lies higher by 2 c v/a: y goes down."""
    frequency = np.linspace(-1.05, 1.05, 63) / SPREAD
    across, down = frequency[np.newaxis], frequency[:, np.newaxis]
    perfect = Waves(ROUND, DISTANCE, WAVELENGTH).transfer(0.0, across, down)
    moved = 2 * 0.3 * WAVELENGTH * DISTANCE / RADIUS
    for order, phase in (((1, -1), -moved * down), ((1, 1), moved * across)):
        found = behind({order: 0.3}).transfer(0.0, across, down)
        assert np.abs(found - perfect * np.exp(-2j * np.pi * phase)).max() < SQUARES


@pytest.mark.parametrize("order", [(2, 0), (2, 2), (3, -1), (4, 0), (4, -2)])
@pytest.mark.parametrize("sigma", [0.03, 0.07])
def test_the_peak_falls_as_strehl_says(order: Order, sigma: float) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(64)
    radius = (nodes + 1) / 2 / SPREAD
    angle = np.arange(64) * 2 * np.pi / 64
    r, t = np.meshgrid(radius, angle, indexing="ij")
    measure = np.outer(weights / 2 / SPREAD * radius, np.full(64, 2 * np.pi / 64))
    passed = behind({order: sigma}).transfer(0.0, r * np.cos(t), r * np.sin(t)).real
    peak = float((passed * measure).sum()) / (math.pi / 4 / SPREAD**2)
    # The approximation's next term: sixth powers of the phase, and its skewness.
    assert peak == pytest.approx(math.exp(-((2 * math.pi * sigma) ** 2)), abs=0.25 * (2 * math.pi * sigma) ** 4)


def mixture(waves: float) -> dict[Order, float]:
    """Coma, astigmatism, spherical and trefoil, none alike from any side."""
    return {(2, 2): waves, (2, -2): -0.6 * waves, (3, -1): 0.8 * waves, (3, 3): 0.4 * waves, (4, 0): -0.7 * waves}


def opening_nodes(aperture: Aperture) -> tuple[Array, Array]:
    """Gauss nodes over an opening, apart from the package's own, and weights that sum to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    unit, share = (nodes + 1) / 2, weights / 2
    c, s = math.cos(aperture.rotation), math.sin(aperture.rotation)
    if aperture.shape == "square":
        x, y = (one.ravel() * aperture.diameter / 2 for one in np.meshgrid(nodes, nodes))
    else:
        whole = math.pi if aperture.shape == "half_disc" else 2 * math.pi
        inner = aperture.inner_diameter / 2
        radius = np.sqrt(inner**2 + (RADIUS**2 - inner**2) * unit)
        r, t = np.meshgrid(radius, whole * (unit - 0.5))
        x, y = r.ravel() * np.cos(t.ravel()), r.ravel() * np.sin(t.ravel())
    return np.stack([c * x - s * y, s * x + c * y], axis=1), np.outer(share, share).ravel()


@pytest.mark.parametrize("aperture", SHAPES, ids=lambda one: one.shape)
@pytest.mark.parametrize("magnification", [-0.8, 0.0])
def test_any_opening_gives_the_fields_own_intensity(aperture: Aperture, magnification: float) -> None:
    """Cells and pixels so small that they are none: weights are |U|^2, by the field's integral, at 13 x 13 places."""
    pitch, cells = SPREAD / 8, 1024
    tiny = replace(camera(aperture, 64, 64, (pitch, pitch)).sensor, window=PixelWindow(box(0.01), box(0.01)))
    waves = behind(mixture(0.1), aperture)
    weights = np.fft.irfft2(wave_weights(waves, tiny, magnification, 0.125, (cells, cells)), (cells, cells))
    assert weights.sum() == pytest.approx(1, abs=SQUARES)
    row, column = (at.ravel() for at in np.meshgrid(np.arange(-24, 25, 4), np.arange(-24, 25, 4), indexing="ij"))
    points, shares = opening_nodes(aperture)
    rho, theta = np.hypot(*points.T) / RADIUS, np.arctan2(-points[:, 1], points[:, 0])
    path = sum(value * WAVELENGTH * zernike(order, rho, theta) for order, value in mixture(0.1).items())
    path = path + magnification * (points**2).sum(axis=1) / (2 * DISTANCE)
    places = (np.stack([column, row], axis=1) + 0.5) * 0.125 * pitch - pitch / 2
    wave = 2 * np.pi / WAVELENGTH
    field = np.exp(-1j * wave / DISTANCE * (places @ points.T)) @ (shares * np.exp(1j * wave * path))
    expected = aperture.area / (WAVELENGTH * DISTANCE) ** 2 * np.abs(field) ** 2 * (pitch / 8) ** 2
    found = weights[row % cells, column % cells]
    # The grid goes round, and the tails of all its copies come in.
    tail = Waves(aperture, DISTANCE, WAVELENGTH).tail(cells / 16 * pitch)
    assert np.abs(found - expected).max() < 2e-3 * expected.max() + tail / cells**2


@pytest.mark.parametrize("aperture", SHAPES, ids=lambda one: one.shape)
def test_no_light_is_lost_and_none_is_below_zero(aperture: Aperture) -> None:
    """Parseval: what passes at the frequency 0 is 1; a point spread is an intensity."""
    waves = behind(mixture(0.08), aperture)
    assert waves.transfer(0.3, np.zeros(1), np.zeros(1))[0] == pytest.approx(1, abs=SQUARES)
    pitch = SPREAD / 4
    sensor = camera(aperture, 64, 64, (pitch, pitch)).sensor
    weights = np.fft.irfft2(wave_weights(waves, sensor, 0.3, 0.5, (192, 192)), (192, 192))
    assert weights.min() > -CORNERS * weights.max()
    assert weights.sum() == pytest.approx(1, abs=SQUARES)


# Images: a small lamp in focus before a lens of f/8, and where its light falls.

FOCUS, F, NUMBER, PIXEL, SIDE = 0.5, 0.025, 8.0, 6.9e-6, 48
LAMP = 3.0  # px, radius


def lens_camera(wavefront: Wavefront, rows: int = SIDE, columns: int = SIDE) -> Camera:
    plain = camera(Aperture("round", F / NUMBER), rows, columns, (PIXEL, PIXEL), F)
    return replace(plain, lens=Lens(FOCUS, glass=wavefront))


def glass_of(coefficients: dict[Order, float], heights: tuple[float, ...] | None = None) -> Wavefront:
    """Of polynomials of rms 1 [waves], the same for all of the image or growing with the height."""
    orders = tuple(sorted({(n, m) for n, either in coefficients for m in (either, -either)}))
    row = tuple(coefficients.get(order, 0.0) * WAVELENGTH for order in orders)
    if heights is None:
        return Wavefront(F / NUMBER, orders, (row,))
    rows = tuple(tuple(height / heights[-1] * value for value in row) for height in heights)
    return Wavefront(F / NUMBER, orders, rows, heights)


def light_of(of: Camera, lamps: list[tuple[float, float]], depth: float = FOCUS) -> tuple[Array, Array]:
    """What waves add to each pixel for lamps at columns and rows from the middle [px], and what rays see."""

    def texture(x: Array, y: Array) -> Array:
        scale = of.image_distance / depth / PIXEL
        spots = [np.hypot(x * scale - column, y * scale - row) < LAMP for column, row in lamps]
        return np.where(np.any(spots, axis=0), 1.0, 0.0)

    tracer: Tracer = Planes(((depth, texture),))  # type: ignore[assignment]
    view = View(of, tracer)
    plan = plan_waves(view, WAVELENGTH, 0.05, seed=1)
    parts = wave_parts(view, [(view, plan)], 2, progress=lambda _: None)
    return parts.change.mean(axis=0), parts.cells


def moments(image: Array, place: tuple[float, float]) -> tuple[float, float]:
    """Sums of light times column and row from a place, which is told from the middle [px]."""
    row, column = np.indices(image.shape) - (SIDE - 1) / 2
    return float((image * (column - place[0])).sum()), float((image * (row - place[1])).sum())


# Of what light is moved by: what lies beyond a frame of 48 pixels, to which tails of coma add most; measured .11.
IN_FRAME = 0.13


@pytest.mark.parametrize(("order", "toward"), [((3, -1), (0, 1)), ((3, 1), (-1, 0)), ((1, -1), (0, 1))])
def test_coma_and_tilt_send_light_where_their_slope_says(order: Order, toward: tuple[int, int]) -> None:
    """The middle of the light goes by v times the mean slope of the path over the pupil, whatever the wavelength.

    Of sqrt(8) (3 rho^3 - 2 rho) sin(theta) that is sqrt(8)/a upwards, as the rim's integral tells: a pixel sees what
    lies higher, so a lamp appears lower, in a later row.
    """
    waves = 0.4
    of = lens_camera(glass_of({order: waves}))
    norm = math.sqrt(8) if order[0] == 3 else 2.0
    moved = norm * waves * WAVELENGTH / (F / NUMBER / 2) * of.image_distance / PIXEL
    change, _ = light_of(of, [(0.0, 0.0)])
    light = math.pi * LAMP**2
    found = [moment / light / moved for moment in moments(change, (0.0, 0.0))]
    assert found == pytest.approx(list(toward), abs=IN_FRAME)


def test_astigmatism_with_defocus_draws_the_line_that_its_sign_says() -> None:
    """Osa 5 is sqrt(6) 2 x y/a^2, y up; with as much defocus it is a parabola along x = y: light goes to / only."""
    waves = 0.35
    norm = math.sqrt(6) * waves * WAVELENGTH / (F / NUMBER / 2) ** 2
    defocus = norm * (F / NUMBER / 2) ** 2 / (2 * math.sqrt(3)) / WAVELENGTH
    of = lens_camera(glass_of({(2, -2): waves, (2, 0): defocus}))
    change, _ = light_of(of, [(0.0, 0.0)])
    row, column = np.indices(change.shape) - (SIDE - 1) / 2
    inside = np.hypot(row, column) < 20
    rising, falling = ((change * inside * (column - sign * row) ** 2).sum() / 2 for sign in (1, -1))
    # By rays W = norm (x + y)^2 sends light along / by 2 sqrt(2) v norm (x + y), of mean square 4 (v norm a)^2, and
    # none along the other diagonal. Diffraction sends as much to either; what lies beyond 20 pixels is not counted.
    by_rays = math.pi * LAMP**2 * 4 * (of.image_distance * norm * (F / NUMBER / 2) / PIXEL) ** 2
    assert rising - falling == pytest.approx(by_rays, rel=0.15)
    assert abs(falling) < 0.5 * rising


def test_a_table_turns_with_the_azimuth() -> None:
    """Coma straight above the axis is along y; to the right along x; at 30 degrees between."""
    table = glass_of({(3, -1): 1.0}, (0.0, 1e-3))
    by_order = [dict(zip(table.orders, table.at(x, y), strict=True)) for x, y in ((0, 1e-3), (1e-3, 0), (0, 0.5e-3))]
    assert by_order[0][3, -1] == pytest.approx(WAVELENGTH) and by_order[0][3, 1] == pytest.approx(0, abs=1e-20)
    assert by_order[1][3, 1] == pytest.approx(WAVELENGTH) and by_order[1][3, -1] == pytest.approx(0, abs=1e-20)
    assert by_order[2][3, -1] == pytest.approx(WAVELENGTH / 2)
    # What a place sees of the pupil is the table's pattern turned by its azimuth less 90 degrees.
    angle, theta = math.radians(30.0), np.linspace(0, 2 * np.pi, 37)
    astigmatism = glass_of({(2, 2): 0.7, (2, -2): 0.2}, (0.0, 1e-3))
    at = dict(zip(astigmatism.orders, astigmatism.at(1e-3 * math.cos(angle), 1e-3 * math.sin(angle)), strict=True))
    found = sum(value * zernike(order, np.ones(37), theta) for order, value in at.items())
    turned = theta - (angle - math.pi / 2)
    expected = sum(
        value * WAVELENGTH * zernike(order, np.ones(37), turned) for order, value in {(2, 2): 0.7, (2, -2): 0.2}.items()
    )
    assert np.abs(found - expected).max() < QUADRATURE


@pytest.mark.long
def test_coma_of_a_lens_points_along_the_radius_all_over_the_image() -> None:
    """A lamp above the axis and to its right: its light is moved inwards, as the slope grows outwards."""
    far = 10.0
    corner = math.hypot(SIDE, SIDE) / 2 * PIXEL
    of = lens_camera(glass_of({(3, -1): 0.4}, (0.0, corner)))
    moved = 0.4 * far * PIXEL / corner * math.sqrt(8) * WAVELENGTH / (F / NUMBER / 2) * of.image_distance / PIXEL
    light = math.pi * LAMP**2
    place = (0.6 * far, -0.8 * far)
    change, _ = light_of(of, [place])
    along, beside = moments(change, place)
    inwards = -(0.6 * along - 0.8 * beside) / light / moved
    # Each pixel gathers by its own coma, and those farther inwards have less than the lamp's own place.
    assert 0.3 < inwards < 1.0
    assert abs(0.8 * along + 0.6 * beside) / light / moved < 0.05


def test_shares_of_places_sum_to_one_and_hold_what_is_straight() -> None:
    of = lens_camera(glass_of({(3, -1): 0.3}, (0.0, 1e-3)))
    places, rect = lens_field(of, WAVELENGTH), (5, 40, 20, 48)
    row, column = np.indices((35, 28)) + np.array([5, 20])[:, np.newaxis, np.newaxis]
    found = np.zeros((2, 3, 35, 28))
    for (u, v), *shares in places.shares(rect):
        for number, share in enumerate(shares):
            found[number] += share * np.array([1.0, u, v])[:, np.newaxis, np.newaxis]
    assert np.abs(found - np.stack([np.ones_like(row), column, row])).max() < 1e-12
    assert len(lens_field(lens_camera(glass_of({(3, -1): 0.3})), WAVELENGTH).places) == 1


@pytest.mark.parametrize(
    ("coefficients", "images"), [({(3, -1): 0.3, (2, 2): 0.2, (4, 0): 0.1}, 4), ({(3, -1): 0.3, (3, 1): 0.2}, 2)]
)
def test_mirrored_places_pass_mirrored_frequencies(coefficients: dict[Order, float], images: int) -> None:
    """Of a lens that is alike from both sides of the field's radius, four; of any other, what lies opposite."""
    of = lens_camera(glass_of(coefficients, (0.0, 1e-3)))
    places = lens_field(of, WAVELENGTH)
    waves = Waves(of.aperture, of.image_distance, WAVELENGTH)
    nu = 0.3 * waves.highest_frequency * np.array([0.2, -1.0, 0.7, 1.3])
    found = images_of(of, places, places.places[1])
    assert len(found) == images and len({place for place, _ in found}) == images
    at_first = replace(waves, glass=glass_at(of, found[0][0]))
    for place, (across, down) in found:
        there = replace(waves, glass=glass_at(of, place)).transfer(0.003, nu, nu[::-1])
        assert there == pytest.approx(at_first.transfer(0.003, across * nu, down * nu[::-1]), abs=1e-9)
    assert images_of(of, places, (of.principal_point[0], of.principal_point[1])) == ((of.principal_point, (1, 1)),)
    # A half disc looks another way when it is turned over.
    half = replace(of, aperture=Aperture("half_disc", of.aperture.diameter))
    assert images_of(half, places, places.places[1]) == ((places.places[1], (1, 1)),)


def test_weights_of_a_mirrored_place_are_those_of_its_own_glass() -> None:
    of = lens_camera(glass_of({(3, -1): 0.3, (2, 2): 0.2}, (0.0, 1e-3)), 16, 16)
    tracer: Tracer = Planes(((FOCUS, lambda x, _: 1 + 0 * x),))  # type: ignore[assignment]
    plan = plan_waves(View(of, tracer), WAVELENGTH, 0.5, seed=1)
    weights, cell = plan.weights, plan.kernel.grid.cell
    last = weights.lens_field.places[-1]
    assert images_of(of, weights.lens_field, last)[0][0] != last
    for size in (cell, 2 * cell):
        own = weights.of_layer(plan.kernel.layers[0], size, (0, 0), last)
        assert weights.near(size, (0, 0), last)[0] == pytest.approx(own, abs=1e-9 * float(np.abs(own).max()))


@pytest.mark.long
def test_places_between_are_mixed_within_what_is_counted_for_it() -> None:
    """Against each pixel by its own wavefront, at pixels of one row beside lamps in a field of strong coma."""
    corner = math.hypot(SIDE, SIDE) / 2 * PIXEL
    of = lens_camera(glass_of({(3, -1): 0.3, (2, 0): 0.2, (2, 2): 0.2}, (0.0, 0.5 * corner, corner)))
    lamps = [(column, row) for column in (-14.0, 0.0, 14.0) for row in (-14.0, 0.0, 14.0)]
    change, cells = light_of(of, lamps)
    places = lens_field(of, WAVELENGTH)
    assert len(places.places) >= 9
    off, counted = [], []
    for row, column in ((12, 9), (30, 20), (36, 38), (40, 12)):
        glass = glass_at(of, (column, row))
        assert glass is not None
        alone = replace(
            of.lens,  # type: ignore[type-var]
            glass=Wavefront(F / NUMBER, glass.orders, (glass.coefficients,)),
        )
        exact, _ = light_of(replace(of, lens=alone), lamps)
        off.append(change[row, column] - exact[row, column])
        counted.append(cells[row, column])
    # Of light 1; noise of the rays is .002. Without a mixture, by the nearest place, pixels are off by .05.
    assert math.hypot(*off) / 2 < 1.3 * math.hypot(*counted) / 2 + 0.004
    assert math.hypot(*off) / 2 < 0.02


def contrast_lens(tangential: float, sagittal: float) -> Camera:
    """Shares of the limit from 5 % of the highest frequency on, at all heights but the axis."""
    of = camera(Aperture("round", F / NUMBER), SIDE, SIDE, (PIXEL, PIXEL), F)
    low = 0.05 / (WAVELENGTH * NUMBER)
    shares = (((1.0, 1.0, 1.0), (1.0, value, value)) for value in (tangential, sagittal))
    return replace(of, lens=Lens(FOCUS, glass=ContrastTable((0.0, low, 2 * low), *shares, (0.0, 1e-3))))


def test_tangential_contrast_is_that_along_the_radius() -> None:
    """Above the axis to the right, at half the table's last height: gratings along the radius, across it, between."""
    of = contrast_lens(0.4, 0.8)
    middle, away = (SIDE - 1) / 2, 0.5e-3 / PIXEL
    waves = Waves(of.aperture, of.image_distance, WAVELENGTH)
    for angle in (0.0, 0.5, 2.0):
        place = (middle + away * math.cos(angle), middle - away * math.sin(angle))
        behind_glass = replace(waves, glass=glass_at(of, place))
        nu = 0.3 * waves.highest_frequency
        for turned, share in ((0.0, 0.7), (math.pi / 2, 0.9), (math.pi / 4, 0.8)):
            across, down = np.array([nu * math.cos(angle + turned)]), np.array([-nu * math.sin(angle + turned)])
            for m in (0.0, 0.005):
                limit = waves.transfer(m, across, down)
                found = behind_glass.transfer(m, across, down)
                assert found == pytest.approx(share * limit, abs=SQUARES)


def test_a_lens_of_low_contrast_sends_no_light_away() -> None:
    of = contrast_lens(0.4, 0.8)
    change, _ = light_of(replace(of, lens=replace(of.lens, glass=None)), [(0.0, 0.0)])  # type: ignore[type-var]
    by_glass, _ = light_of(of, [(8.0, -8.0)])
    light = math.pi * LAMP**2
    assert abs(by_glass.sum() - change.sum()) < IN_FRAME * light
    assert moments(by_glass, (8.0, -8.0)) == pytest.approx((0.0, 0.0), abs=IN_FRAME * light)


# A measured point spread: two Gaussian spots, .3 of the light in the one that lies right of and below the other.

SIGMA, PITCH, BESIDE = 3.0e-6, 1.5e-6, (12e-6, 9e-6)


def two_spots() -> PointSpread:
    at = (np.arange(48) - 23.5) * PITCH
    spots = [
        share * np.exp(-((at - x) ** 2 + (at[:, np.newaxis] - y) ** 2) / (2 * SIGMA**2))
        for share, x, y in ((0.7, 0.0, 0.0), (0.3, *BESIDE))
    ]
    light = sum(spots)
    light = light / light.sum()
    row, column = np.indices(light.shape)
    middle = float((light * row).sum()), float((light * column).sum())
    return PointSpread("", PITCH, middle, 20e-6, tuple(map(tuple, light.tolist())))


@pytest.mark.parametrize("depth", [FOCUS, 0.502])
def test_a_point_looks_as_it_was_measured_whichever_way_it_points(depth: float) -> None:
    """Third moments of the light are those of two spots: lamp and opening, alike from both sides, add none.

    With shares .7 and .3 about their common middle they are .7 (-.3)^3 + .3 .7^3 = .084 of the cube of the distance.
    """
    of = replace(
        camera(Aperture("round", F / NUMBER), SIDE, SIDE, (PIXEL, PIXEL), F), lens=Lens(FOCUS, glass=two_spots())
    )
    change, _ = light_of(of, [(0.0, 0.0)], depth)
    light = math.pi * LAMP**2
    row, column = np.indices(change.shape) - (SIDE - 1) / 2
    found = [float((change * at**3).sum()) / light for at in (column, row)]
    assert found == pytest.approx([0.084 * (one / PIXEL) ** 3 for one in BESIDE], rel=0.03)
    mixed = float((change * column * row).sum()) / light
    assert mixed == pytest.approx(0.21 * BESIDE[0] * BESIDE[1] / PIXEL**2, rel=0.03)
    assert moments(change, (0.0, 0.0)) == pytest.approx((0.0, 0.0), abs=0.01 * light)


def test_a_measured_spread_takes_the_place_of_waves_and_is_folded_with_defocus() -> None:
    at = (np.arange(33) - 16) * PITCH
    light = np.exp(-(at**2 + at[:, np.newaxis] ** 2) / (2 * SIGMA**2))
    spread = PointSpread("", PITCH, (16.0, 16.0), 15e-6, tuple(map(tuple, light.tolist())))
    aperture = Aperture("round", F / NUMBER)
    found = Waves(aperture, DISTANCE, WAVELENGTH, MeasuredSpread(spread))
    frequency = np.linspace(-0.9, 0.9, 21) * found.highest_frequency / math.sqrt(2)
    across, down = frequency[np.newaxis], frequency[:, np.newaxis]
    gauss = np.exp(-2 * (np.pi * SIGMA) ** 2 * (across**2 + down**2))
    for m in (0.0, 0.004):
        rays = Waves(aperture, DISTANCE, 0.0).transfer(m, across, down)
        assert np.abs(found.transfer(m, across, down) - gauss * rays).max() < SQUARES
    one_by_one = found.transfer(0.004, *(one.ravel() for one in np.broadcast_arrays(across, down)))
    assert np.abs(one_by_one - found.transfer(0.004, across, down).ravel()).max() < SQUARES
    assert not found.transfer(0.0, np.array([1.01 * 0.5 / PITCH]), np.zeros(1)).any()
