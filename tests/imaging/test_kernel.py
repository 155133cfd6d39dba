"""The kernel against closed forms, and against rays where it has none."""

from __future__ import annotations

import itertools
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from radwrap.errors import InputError
from radwrap.imaging.methods.central import Cells, EdgeSampling, central_rays, edge_sampling
from radwrap.imaging.methods.grid import GridPlan
from radwrap.imaging.methods.kernel import (
    KernelPlan,
    decide_tile,
    gather_some,
    gathered_tile,
    grid_squares,
    plan_kernel,
)
from radwrap.imaging.methods.rays import plan_rays, sampled_radiance, traced_tile
from radwrap.imaging.optics.footprint import Footprint, folded, footprint, opening_points, reach_px
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.camera import Aperture
from radwrap.scene.pixel_window import PixelWindow, Profile, box, strips
from radwrap.validate.closed_forms.aperture import blurred_edge, cos4, projection_radius
from tests.imaging.planes import Array, Texture, gray, pixel_axes, view

F = 0.01
ROUND = Aperture("round", 2e-4)
# Gray levels of 100: an edge's rms by the kernel at the finest aim, and what any error of the shape is far beyond.
RIGHT, WRONG = 0.15, 1.5


def ignore(_: int) -> None:
    """No progress."""


def kernel_image(seen: View, plan: KernelPlan, seed: int = 0) -> Array:
    """One replicate."""
    sensor = seen.camera.sensor
    image = np.full((sensor.rows, sensor.columns), np.nan)
    for tile, (r0, r1, c0, c1) in enumerate(plan.tiles):
        cells = decide_tile(seen, plan, tile, (seed, 1, tile), ignore)
        found = gathered_tile(seen, plan, tile, cells, seed=(seed, 2, tile), progress=ignore)
        image[r0:r1, c0:c1] = found.values
    return image


def edge(angle: float, offset: float = 0.0) -> Texture:
    """Bright where the distance from a line through (0, 0) is beyond an offset [m]."""
    c, s = math.cos(angle), math.sin(angle)
    return lambda x, y: np.where(x * c + y * s > offset, 1.0, 0.0)


def falloff(seen: View) -> Array:
    """Of each pixel's central ray."""
    camera = seen.camera
    columns, rows, _ = pixel_axes(camera)
    return np.asarray(cos4(*np.meshgrid(columns, rows), F))


def eq9_image(seen: View, depth: float, angle: float) -> Array:
    """Eq. 9 averaged over each pixel by 16 x 16 midpoints [gray level]."""
    camera = seen.camera
    radius = projection_radius(camera.aperture.diameter, depth, F) * F / depth
    return 100 * blurred_edge(*pixel_axes(camera), angle=angle, radius=radius) * falloff(seen)


@pytest.mark.parametrize("depth", [1.0, 3 * F])
@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, 4.0])
def test_an_edge_through_a_round_pinhole_is_that_of_eq9(depth: float, angle: float) -> None:
    seen = view(ROUND, (depth, edge(angle)))
    plan = plan_kernel(seen, np.array([1 + F / depth]), 0.02, 1)
    off = gray(seen, kernel_image(seen, plan)) - eq9_image(seen, depth, angle)
    assert math.sqrt((off**2).mean()) < RIGHT


def test_the_magnification_matters() -> None:
    """At 3 f a kernel of the opening's own size is off far beyond what is allowed: m = 1 + f/z, not 1."""
    seen = view(ROUND, (3 * F, edge(0.0)))
    plan = replace(plan_kernel(seen, np.array([1 + 1 / 3]), 0.02, 1), layers=(1.0,))
    off = gray(seen, kernel_image(seen, plan)) - eq9_image(seen, 3 * F, 0.0)
    assert math.sqrt((off**2).mean()) > WRONG


@pytest.mark.parametrize(
    "aperture",
    [
        Aperture("half_disc", 2e-4, rotation=0.4),
        Aperture("square", 1.5e-4, rotation=0.2),
        Aperture("annular", 2e-4, inner_diameter=1e-4),
        Aperture("round", 3e-6),
        Aperture("round", 0.0),
    ],
    ids=str,
)
def test_any_opening_as_by_rays(aperture: Aperture) -> None:
    """A spot beside the axis and a slanted edge; for the half disc a convolution would be turned by half a turn."""

    def texture(x: Array, y: Array) -> Array:
        spot = np.hypot(x + 4e-3, y - 3e-3) < 2e-3
        return np.where(spot | (x + 0.3 * y > 8e-3), 1.0, 0.1)

    seen = view(aperture, (1.0, texture))
    plan = plan_kernel(seen, np.array([1 + F]), 0.05, 1)
    ours = gray(seen, kernel_image(seen, plan))
    v, u = np.divmod(np.arange(ours.size, dtype=float), seen.camera.sensor.columns)
    rays = gray(seen, sampled_radiance(seen, u, v, 1024, np.random.default_rng(1)).mean(axis=1)).reshape(ours.shape)
    assert math.sqrt(((ours - rays) ** 2).mean()) < 0.6  # the rays' own error is about 0.4
    if aperture.shape == "half_disc":
        other = footprint(seen.camera, 1 + F, 0.25)
        turned = footprint(
            replace(seen.camera, aperture=replace(aperture, rotation=aperture.rotation + math.pi)), 1 + F, 0.25
        )
        assert np.abs(other.weights[:60, :60] - turned.weights[:60, :60]).max() > 0.2 * other.weights.max()


@pytest.mark.parametrize("place", [-0.25, 0.25, 0.45])
def test_an_edge_beside_a_tiles_border_is_seen(place: float) -> None:
    """Of the outermost cells no neighbour outside says that an edge crosses them."""
    seen = view(Aperture("round", 3e-6), (1.0, edge(math.pi / 2, place * 1.2e-5 / F)))
    plan = replace(plan_kernel(seen, np.array([1 + F]), 0.5, 1), tiles=((0, 12, 0, 32), (12, 24, 0, 32)))
    right = np.clip(np.arange(24) - 11.0 - place, 0.0, 1.0)  # the border is between rows 11 and 12
    for seed in range(10):
        off = gray(seen, kernel_image(seen, plan, seed)) - 100 * right[:, np.newaxis] * falloff(seen)
        assert np.abs(off).max() < 15  # a cell of a quarter of a pixel for a row of a sharp edge: 12


def test_small_spots_are_neither_lost_nor_counted_twice() -> None:
    """Spots smaller than the cells: the mean over many replicates is their light, within 4 standard errors."""

    def texture(x: Array, y: Array) -> Array:
        return np.where(np.hypot((x % 1.1e-2) - 4e-3, (y % 0.9e-2) - 4e-3) < 1e-3, 1.0, 0.0)  # 1 pixel in radius

    seen = view(Aperture("round", 4e-4), (1.0, texture))
    plan = plan_kernel(seen, np.array([1 + F]), 5.0)
    coarse = replace(plan, grid=replace(plan.grid, base=4, levels=1))  # cells of four pixels, cut only where seen
    means = [gray(seen, kernel_image(seen, coarse, seed)).mean() for seed in range(40)]
    v, u = np.divmod(np.arange(seen.camera.sensor.pixels, dtype=float), seen.camera.sensor.columns)
    truth = gray(seen, sampled_radiance(seen, u, v, 1024, np.random.default_rng(3))).mean()
    error = np.std(means, ddof=1) / math.sqrt(len(means))
    assert abs(np.mean(means) - truth) < 4 * error + 0.01
    assert error < 0.1 * truth


def test_layers_keep_the_light_of_a_slanted_depth() -> None:
    """Two planes side by side at different depths: far from the step each is blurred by its own m."""
    near, far = 2 * F, 8 * F

    def left(x: Array, y: Array) -> Array:
        return np.where(x < 0, np.where(y > 0, 1.0, 0.2), np.nan)

    seen = view(ROUND, (near, left), (far, lambda x, y: np.where(y > 0, 1.0, 0.2)), columns=96)
    plan = plan_kernel(seen, np.array([1 + F / near, 1 + F / far]), 0.05, 1)
    assert len(plan.layers) > 3
    ours = gray(seen, kernel_image(seen, plan))
    v, u = np.divmod(np.arange(ours.size, dtype=float), 96)
    rays = gray(seen, sampled_radiance(seen, u, v, 1024, np.random.default_rng(1)).mean(axis=1)).reshape(ours.shape)
    off = ours - rays
    aside = np.r_[0:20, 76:96]
    assert math.sqrt((off[:, aside] ** 2).mean()) < 0.5
    # At the step itself the model fails, which the certificate must see: here it shows.
    assert np.abs(off[:, 40:56]).max() > 3


def test_a_scene_too_deep_for_layers_is_refused() -> None:
    seen = view(Aperture("round", 5e-3), (1.0, edge(0.0)))
    with pytest.raises(InputError, match='`method="rays"`'):
        plan_kernel(seen, np.array([1.1, 2.0]), 0.5)


@pytest.mark.parametrize(("blur", "share"), [(0.1, 1.0), (3.0, 1 / (2**1.5 - 1))])
def test_smaller_cells_are_no_help_before_they_resolve_the_blur(blur: float, share: float) -> None:
    """What twice the cells' size changes: all of it may be left, where the blur [px] is below two cells."""
    seen = view(Aperture("round", 2 * blur * 1e-5 / 1.1), (0.1, edge(0.3)))
    plan = plan_kernel(seen, np.array([1.1]), aim=5.0)
    assert 2 * plan.grid.cell > 0.1
    cells = decide_tile(seen, plan, 0, (1,), ignore)
    gathered = gathered_tile(seen, plan, 0, cells, seed=(2,), progress=ignore)
    coarse = gather_some(plan, gathered.coarser, 2 * plan.grid.cell, plan.tiles[0])[1]
    assert gathered.change == pytest.approx(share * (coarse - gathered.values[gathered.some]), rel=1e-12)
    assert float(np.abs(gathered.change).max()) > 0


def test_footprints_are_exact_shares_of_area() -> None:
    aperture = Aperture("round", 1e-4)
    seen = view(aperture, (1.0, edge(0.0)))
    found = footprint(seen.camera, 1.0, 0.25)
    assert found.weights.sum() == pytest.approx(1, abs=1e-12)
    # The folded disc's profile across is that of Eq. 9 less itself a pixel on.
    radius = reach_px(seen.camera, 1.0)[0]
    edges = found.first[1] + np.arange(found.weights.shape[1] + 1)

    def twice_integrated(x: Array) -> Array:
        s = np.clip(x / radius, -1, 1)
        return radius * (s * (np.arcsin(s) / math.pi + 0.5) + (np.sqrt(1 - s**2) * (2 + s**2) / 3) / math.pi) + (
            x - radius
        ) * (x > radius)

    places = edges * 0.25 - 0.5
    exact = np.diff(twice_integrated(places + 0.5) - twice_integrated(places - 0.5))
    assert np.abs(found.weights.sum(axis=0) - exact).max() < 3e-3 * exact.max()


def test_cells_larger_than_pixels_have_a_footprint_for_each_place() -> None:
    points, weights = opening_points(Aperture("square", 1.0), 0.1)
    whole = folded(points * 3, weights, 1.0)

    def halved(found: Footprint) -> dict[tuple[int, int], float]:
        sums: dict[tuple[int, int], float] = {}
        for (i, j), weight in np.ndenumerate(found.weights):
            cell = ((found.first[0] + i) // 2, (found.first[1] + j) // 2)
            sums[cell] = sums.get(cell, 0.0) + weight
        return sums

    pairs = folded(points * 3, weights, 2.0, (0, 0))
    for (i, j), weight in np.ndenumerate(pairs.weights):
        assert weight == pytest.approx(halved(whole).get((pairs.first[0] + i, pairs.first[1] + j), 0.0), abs=1e-12)
    shifted = folded(points * 3, weights, 2.0, (1, 1))
    assert shifted.weights.sum() == pytest.approx(1, abs=1e-12)
    assert not np.allclose(shifted.weights[:3, :3], pairs.weights[:3, :3])


@pytest.mark.parametrize("cell", [0.0625, 0.25, 1.0, 4.0])
@pytest.mark.parametrize("window", [None, PixelWindow(box(0.6), strips((1.0, 0.0, 2.0)))])
def test_footprints_are_the_sum_of_each_points_shares(cell: float, window: PixelWindow | None) -> None:
    """Written down again cell by cell, for a few points anywhere."""
    random = np.random.default_rng(3)
    points, weights = random.uniform(-6, 6, (20, 2)), random.dirichlet(np.ones(20))
    found = folded(points, weights, cell, (1, 2), window)
    profiles = (window.down, window.across) if window else (Profile(), Profile())
    expected = np.zeros(found.weights.shape)
    for (x, y), weight in zip(points, weights, strict=True):
        shares = []
        for start, first, size, profile in zip((y + 1, x + 2), found.first, found.weights.shape, profiles, strict=True):
            borders = (first + np.arange(size + 1)) * cell - (start + 0.5)
            shares.append(np.diff(profile.share_below(borders)))
        expected += weight * np.outer(*shares)
    assert found.weights == pytest.approx(expected, abs=1e-15)
    assert expected.sum() == pytest.approx(1, abs=1e-12)


def test_a_wide_footprint_takes_memory_like_its_cells() -> None:
    """55000 points and 550 x 550 cells: a share of each point in each row and column would be 500 MB."""
    points, weights = opening_points(Aperture("round", 1.0), 1e-9)
    tracemalloc.start()
    try:
        found = folded(points * 137, weights, 0.25)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert min(found.weights.shape) > 500
    assert peak < 5e7


@pytest.mark.parametrize("make", [lambda x, y: np.where(np.hypot(x, y) < 9e-3, 1.0, 0.3)])
def test_rays_are_unbiased_and_a_planted_bias_is_found(make: Texture) -> None:
    """z-test over pixels at a false-alarm rate of 1e-4, with a bias of 1 % that it must find."""
    seen = view(ROUND, (1.0, make))
    plan = plan_rays(seen, 0.5)

    def replicate(seed: int) -> Array:
        tiles = [traced_tile(seen, plan, tile, (seed, tile), ignore).values for tile in range(len(plan.tiles))]
        return gray(seen, np.vstack(tiles))

    images = np.stack([replicate(seed) for seed in range(8)])
    # The reference's error is a seventh of one replicate's: so many more rays of its own.
    v, u = np.divmod(np.arange(seen.camera.sensor.pixels, dtype=float), seen.camera.sensor.columns)
    reference = gray(seen, sampled_radiance(seen, u, v, 2048, np.random.default_rng(9)).mean(axis=1))
    off = images.mean(axis=0).ravel() - reference
    spread = images.std(axis=0, ddof=1).ravel() / math.sqrt(8)
    noisy = spread > 1e-6

    def z(difference: Array) -> float:
        return float(difference[noisy].sum() / math.sqrt((spread[noisy] ** 2).sum()))

    assert abs(z(off)) < 3.9
    assert abs(z(off + 0.01 * reference)) > 3.9
    assert math.sqrt((spread**2).mean() * 8) < 1.0  # the aim of .5, within a factor of two


def test_rays_of_pixels_far_above_saturation_are_enough_to_keep_them_there() -> None:
    """Stripes finer than a pixel, whose mean is twice saturation: every 16th mean of four rays would be dark."""

    def stripes(x: Array, y: Array) -> Array:
        return np.where(np.sin(2e5 * x) > 0, 1.0, 0.0)

    seen = view(Aperture("round", 2e-4), (1.0, stripes), rows=40, columns=40)
    sensor = replace(seen.camera.sensor, saturation_gray=25.0)  # of a mean of 50
    seen = replace(seen, camera=replace(seen.camera, sensor=sensor))
    plan = plan_rays(seen, 0.3)
    (values,) = (traced_tile(seen, plan, tile, (5, tile), ignore).values for tile in range(len(plan.tiles)))
    saturated = gray_levels(values * seen.exposure_of_radiance, sensor)
    assert float(((saturated - 25.0) ** 2).mean()) < 0.3**2


def test_pixels_that_look_even_get_a_share_of_the_rays_of_others() -> None:
    """Behind a bright edge that the pilot of a pixel misses: none stays at the fewest where others take thousands."""

    def striped(x: Array, y: Array) -> Array:
        return np.where(x < 0, np.where(np.sin(2e5 * x) > 0, 1.0, 0.0), 0.2)

    seen = view(Aperture("round", 2e-4), (1.0, striped), rows=20, columns=40)
    plan = plan_rays(seen, 0.3)
    numbers = traced_tile(seen, plan, 0, (6,), ignore).numbers
    assert numbers.max() > 1000
    assert numbers.min() >= numbers.mean() / 64
    assert numbers.min() > plan.fewest


def test_radiance_below_zero_counts_as_none() -> None:
    """Corrections by rays have noise: a power law of what is negative would be no number."""
    sensor = replace(view(Aperture(), (1.0, np.ones_like)).camera.sensor, gamma=0.5, gain=1.0, saturation_gray=1e9)
    radiance, change = np.array([-0.04, -0.04, 0.25, 0.01]), np.array([0.01, 0.13, 0.0, -0.05])
    # sqrt: 0 stays 0; 0 becomes .3; .5 stays; .1 becomes 0.
    assert grid_squares(radiance, change, 1.0, sensor) == pytest.approx([0.0, 0.09, 0.0, 0.01])


def cells_of(heights: Array, shape: tuple[int, int] = (20, 20)) -> Cells:
    """Cells of a grid, the first of which edges of such heights cross [gray level]."""
    levels = np.zeros(shape, dtype=np.int8)
    levels.ravel()[: len(heights)] = 3
    return Cells((0, 0), levels, 1, 0.0, 0, heights.astype(np.float32))


def one_ray(grid: GridPlan, heights: Array, cells: int) -> float:
    """Rms of an image whose crossed cells have a ray each: of edges as of docs/methods.md [gray level]."""
    return math.sqrt(float((heights**2).sum()) / 12 * grid.cell**2 / grid.area / cells)


@pytest.mark.parametrize(("least", "samples"), [(1.01, 1), (0.7, 2), (0.25, 3), (0.02, 8)])
def test_a_tile_without_edges_leaves_its_share_to_the_others(least: float, samples: int) -> None:
    """With three parts in four that have none an image is off by half as much; n x n rays make it n^1.5 less."""
    heights = np.full(40, 50.0)
    grid = replace(plan_kernel(view(ROUND), np.zeros(1), 1.0).grid, levels=2, area=2.5)
    grid = replace(grid, aim=least * one_ray(grid, heights, 400) / 2)
    found = edge_sampling(grid, [(cells_of(heights), 100), (cells_of(np.empty(0)), 300)])
    assert found.samples == samples
    assert found.passed_over == (50.0 if samples == 1 else 0.0)


@pytest.mark.parametrize("share", [0.9, 0.5, 0.2, 0.07])
def test_rays_go_where_much_differs(share: float) -> None:
    """As few as any choice of n and of what is passed over needs, tried one by one, for heights of any kind."""
    random = np.random.default_rng(7)
    heights = np.float32(np.concatenate([random.uniform(1, 3, 150), random.uniform(20, 90, 30), [90.0] * 9]))
    random.shuffle(heights)
    tile, grid = cells_of(heights), replace(plan_kernel(view(ROUND), np.zeros(1), 1.0).grid, levels=2, area=2.5)
    grid = replace(grid, aim=share * one_ray(grid, heights, 400))
    found = edge_sampling(grid, [(tile, 100)])
    fewest = []
    for n, most in itertools.product(range(1, 9), [0.0, *heights.tolist()]):
        few = heights <= most
        off = np.where(few, heights, heights / n**1.5)
        if one_ray(grid, off, 400) <= grid.aim:
            fewest.append(int(few.sum() + (~few).sum() * n**2))
    given = tile.with_rays(2, found)
    assert (given.levels == 3).sum() == (heights > found.passed_over).sum() == len(given.heights)
    assert (given.with_rays(2, found).levels == given.levels).all()
    assert (given.levels == 2).sum() + (given.levels == 3).sum() * found.samples**2 == min(fewest)
    assert central_rays(grid, given) < 0.5 * central_rays(grid, tile.with_rays(2, EdgeSampling(found.samples, 0.0)))


@pytest.mark.parametrize("opening", [1e-6, 3e-5])  # blurred over .05 and 1.5 px
def test_pixels_that_an_edge_goes_through_keep_the_aim_by_themselves(opening: float) -> None:
    """An edge of 100 gray in an image that is even elsewhere, with an aim of .5, as it is asked of linear cameras.

    The rms over the image alone is kept by fewer rays, of which most of the error is in few pixels. By how much the
    edge then moves from image to image is the standard error of its pixels' sum over its height and its length.
    """
    aim, angle, images = 0.5, 0.3, 12
    seen = view(Aperture("round", opening), (1.0, edge(angle)), rows=90, columns=90)
    columns, rows, pitch = pixel_axes(seen.camera)
    across = (columns * math.cos(angle) + rows[:, np.newaxis] * math.sin(angle)) / pitch[0]
    at_edge, beside = np.abs(across) < 0.5, np.abs(across) < 4
    rms, moved = [], []
    plan = plan_kernel(seen, np.array([1 + F]), aim)
    for one in (plan, replace(plan, grid=replace(plan.grid, edges=True))):
        found = gray(seen, np.stack([kernel_image(seen, one, seed) for seed in range(images)]))
        noise = found.std(axis=0, ddof=1)
        assert math.sqrt(float((noise**2).mean())) < aim
        rms.append(math.sqrt(float((noise[at_edge] ** 2).mean())))
        moved.append(float(found[:, beside].sum(axis=1).std(ddof=1)) / 100 / (90 / math.cos(angle)))
    assert rms[0] > 2 * aim
    assert rms[1] < aim
    assert moved[1] < 0.5 * moved[0]
