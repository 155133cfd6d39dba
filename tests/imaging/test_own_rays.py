"""Waves by the rays of the image that they are added to."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radwrap.imaging.demand import Demand
from radwrap.imaging.methods.central import CentralImage, central_image
from radwrap.imaging.methods.kernel import KernelPlan, coarsened, region_of
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.own_rays import Beside, OwnRays, strips_beside, suffice, traced_beside
from radwrap.imaging.tolerance.planner import Outcome, render_to_tolerance
from radwrap.imaging.tolerance.replicates import Work
from radwrap.imaging.tolerance.seen_tiles import SeenTile, SeenTiles, cells_of, kept_cell, part_of
from radwrap.imaging.tolerance.wave_image import visible_gray, wave_error
from radwrap.imaging.tolerance.wave_parts import in_turn, wave_parts
from radwrap.imaging.tolerance.wave_plan import WavePlan, plan_waves
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, view
from tests.imaging.wave_edge import COLUMNS, ROWS, WAVELENGTH, expected, seen, uncounted

TOLERANCE = 0.5
MANY = 16  # seeds


def made(folder: Path, of: View, seed: int = 0) -> tuple[Outcome, OwnRays]:
    """An image by a kernel, and its rays."""
    folder.mkdir(exist_ok=True)
    with Programs() as programs:
        work = Work(of, folder, programs, Progress("", 1, shown=False), "none", seed, seen=SeenTiles())
        outcome = render_to_tolerance(work, Demand(TOLERANCE, method="kernel"))
    assert isinstance(outcome.ray_plan, KernelPlan)
    own = OwnRays.of(work, outcome.ray_plan, len(outcome.replicates.images))
    assert own is not None
    return outcome, own


def planned(of: View, own: OwnRays, seed: int = 1, times: int = 1) -> WavePlan:
    """Waves in cells that the image has, or so many times as wide ones."""
    cell = times * own.cell
    plan = plan_waves(
        of, WAVELENGTH, 0.25, seed=seed, share=1.0, most_cell=cell, even_cell=None if times == 1 else cell
    )
    assert suffice(own.plan, own.replicates, plan) and plan.kernel.grid.cell == cell
    return plan


def rms(values: Array) -> float:
    return math.sqrt(float((values**2).mean()))


def beside(of: View, plan: WavePlan, own: OwnRays) -> Beside:
    return traced_beside(of, plan, own.replicates, uncounted, in_turn)


@pytest.mark.parametrize(
    ("side", "focus"), [(1e-4, None), (5e-4, 0.6), (5e-4, 1.0)], ids=["pinhole", "out of focus", "focused"]
)
def test_an_edge_becomes_its_closed_form_by_the_images_own_rays(
    side: float, focus: float | None, tmp_path: Path
) -> None:
    of = seen(side, focus, 0.3)
    rays, change = expected(of.camera, 0.3)
    outcome, own = made(tmp_path, of)
    plan = planned(of, own)
    parts = wave_parts(of, [(of, plan)], own.replicates, progress=uncounted, own=own)
    anew = wave_parts(of, [(of, plan)], own.replicates, progress=uncounted)
    assert parts.by_own_rays and parts.rays < anew.rays
    scale = of.exposure_of_radiance * of.camera.sensor.gain
    whole = outcome.radiance + parts.change.mean(axis=0)
    gray = visible_gray(of.exposure_of_radiance, of.camera.sensor)
    error = wave_error(parts, whole, gray, plan.block, images=outcome.replicates.images)
    known = outcome.certificate.with_waves(error.noise, error.cells, error.tails, 0.0, parts=outcome.parts)
    off = (whole - (rays + change)) * scale
    assert rms(off) < known.rms_gray_upper95 < 2 * TOLERANCE


@pytest.mark.long
def test_what_own_rays_add_is_unbiased_and_its_noise_is_told(tmp_path: Path) -> None:
    """Of many images the mean is the closed form; noise of the sum is less than that of the rays, and told so."""
    of = seen(5e-4, 1.0, 0.3)
    rays, change = expected(of.camera, 0.3)
    gray = visible_gray(of.exposure_of_radiance, of.camera.sensor)
    scale = of.exposure_of_radiance * of.camera.sensor.gain
    alone, sums, told, of_cells = [], [], [], []
    for seed in range(MANY):
        outcome, own = made(tmp_path / str(seed), of, seed)
        plan = planned(of, own, seed)
        parts = wave_parts(of, [(of, plan)], own.replicates, progress=uncounted, own=own)
        whole = outcome.radiance + parts.change.mean(axis=0)
        told.append(wave_error(parts, whole, gray, plan.block, images=outcome.replicates.images).noise.mean)
        of_cells.append(parts.cells * scale)
        alone.append(outcome.radiance * scale)
        sums.append(whole * scale)
    of_rays, of_sums = (float(np.var(each, axis=0, ddof=1).mean()) for each in (alone, sums))
    assert of_sums < 0.8 * of_rays
    assert float(np.mean(told)) == pytest.approx(of_sums - of_rays, rel=0.2)
    off = np.mean(sums, axis=(0, 1)) - (rays + change) * scale
    noise = math.sqrt(of_sums / MANY)
    assert rms(off) < rms(np.mean(of_cells, axis=(0, 1))) + 4 * noise


def near_and_far(x: Array, y: Array) -> Array:
    """A half plane with stripes."""
    return np.where(x < 0, np.where((y % 4e-4) < 2e-4, 1.0, 0.3), np.nan)


def stripes(x: Array, y: Array) -> Array:
    return np.where((x % 6e-4) < 3e-4, 0.9, 0.2)


def two_depths() -> View:
    return view(Aperture("round", 2e-4), (0.5, near_and_far), (1.0, stripes), rows=ROWS, columns=COLUMNS)


def whole_image(own: OwnRays, replicate: int) -> CentralImage:
    """All cells that the image has, of tiles side by side."""
    tiles = [own._tile(number, replicate) for number in range(len(own.plan.tiles))]
    ends = np.array([tile.place for tile in tiles if tile is not None])
    values, depth = np.zeros((2, ends[:, 1].max(), ends[:, 3].max()))
    for tile in tiles:
        assert tile is not None and tile.magnification is not None
        r0, r1, c0, c1 = tile.place
        assert not values[r0:r1, c0:c1].any()  # each cell has one owner
        values[r0:r1, c0:c1], depth[r0:r1, c0:c1] = tile.values, tile.magnification
    assert values.all()
    return CentralImage((0, 0), values, depth, 0)


def make_tiles_small(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("radwrap.imaging.methods.kernel._TILE_ROWS", 40)
    patch.setattr("radwrap.imaging.methods.kernel._TILE_COLUMNS", 60)


@pytest.fixture(scope="module")
def of_many_tiles(tmp_path_factory: pytest.TempPathFactory) -> tuple[View, OwnRays]:
    """Several tests share it: those that keep other tiles have room of their own."""
    of = two_depths()
    with pytest.MonkeyPatch.context() as patch:
        make_tiles_small(patch)
        _, own = made(tmp_path_factory.mktemp("tiles"), of)
    assert len(own.plan.tiles) > 4 and own.plan.grid.with_depth
    return of, own


@pytest.mark.long
@pytest.mark.parametrize("times", [1, 2])
def test_a_tile_gathers_from_what_all_tiles_of_the_image_and_strips_beside_it_saw(
    of_many_tiles: tuple[View, OwnRays], times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    of, own = of_many_tiles
    make_tiles_small(monkeypatch)
    image, plan = whole_image(own, 1), planned(of, own, times=times)
    if times == 2:
        image = coarsened(image)
    assert image.magnification is not None
    strips = beside(of, plan, own).seen[1]
    for tile in range(len(plan.kernel.tiles)):
        found = own.central(plan, tile, strips, 1)
        (row, column), (rows, columns) = region_of(plan.kernel, tile)
        assert found.first == (row, column) and found.values.shape == (rows, columns)
        for place, seen_there in [
            ((0, ROWS * 99, 0, COLUMNS * 99), image),
            *((strip.place, strip) for strip in strips),
        ]:
            first = place[0], place[2]
            part = tuple(
                slice(max(start, begin), min(start + size, begin + number))
                for start, size, begin, number in zip(
                    first, seen_there.values.shape, (row, column), (rows, columns), strict=True
                )
            )
            here, there = (
                tuple(slice(one.start - begin, one.stop - begin) for one, begin in zip(part, corner, strict=True))
                for corner in ((row, column), first)
            )
            if min(one.stop - one.start for one in part) <= 0:
                continue
            assert found.magnification is not None and seen_there.magnification is not None
            assert found.values[here] == pytest.approx(seen_there.values[there], rel=1e-6)
            assert found.magnification[here] == pytest.approx(seen_there.magnification[there], rel=1e-6)


@pytest.mark.long
def test_tiles_that_are_no_longer_kept_are_traced_as_they_were(of_many_tiles: tuple[View, OwnRays]) -> None:
    """A run that was killed finds its image on the disk, and not what its rays saw."""
    of, own = of_many_tiles
    plan = planned(of, own)
    kept, anew = (
        wave_parts(of, [(of, plan)], own.replicates, progress=uncounted, own=each)
        for each in (own, replace(own, seen=SeenTiles()))
    )
    assert kept.change.tobytes() == anew.change.tobytes() and kept.rays == anew.rays


def test_an_image_that_is_not_the_last_one_is_traced_once_more_and_no_oftener(
    of_many_tiles: tuple[View, OwnRays], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search may give back an image before its last one."""
    of, own = of_many_tiles
    make_tiles_small(monkeypatch)
    plan, traced = planned(of, own), list[int]()
    assert len(plan.kernel.tiles) > 4
    tiles = SeenTiles()
    tiles.begin("another", own.plan, own.replicates)
    again = OwnRays.of(replace(own.work, seen=tiles), own.plan, own.replicates)
    assert again is not None
    central = central_image

    def counted(*what: object, **how: object) -> CentralImage:
        traced.append(1)
        return central(*what, **how)  # type: ignore[arg-type]

    strips = beside(of, plan, again).seen
    monkeypatch.setattr("radwrap.imaging.tolerance.own_rays.central_image", counted)
    for replicate, tile in np.ndindex(own.replicates, len(plan.kernel.tiles)):
        again.central(plan, tile, strips[replicate], replicate)
    assert len(traced) == own.replicates * len(own.plan.tiles)


def test_tiles_of_too_large_an_image_are_not_kept(of_many_tiles: tuple[View, OwnRays]) -> None:
    _, own = of_many_tiles
    large = replace(own.plan.camera.sensor, rows=1 << 14, columns=1 << 14)
    tiles, image = SeenTiles(), whole_image(own, 0)
    tiles.begin("large", replace(own.plan, camera=replace(own.plan.camera, sensor=large)), 2)
    tiles.put("large", (0, 0), own.plan, image, image)
    assert tiles.get("large", (0, 0)) is None


def test_blocks_of_far_light_have_the_mean_of_what_was_seen(of_many_tiles: tuple[View, OwnRays]) -> None:
    _, own = of_many_tiles
    image = whole_image(own, 0).values
    for block in (1.0, 2.5, 8.0):
        found, cells = own.means(block, 0), block / own.cell
        assert found.shape == (ROWS // block, COLUMNS // block)
        for row, column in np.ndindex(found.shape):
            rows, columns = (
                slice(*(math.ceil(edge * cells - 0.5) for edge in (number, number + 1))) for number in (row, column)
            )
            assert found[row, column] == pytest.approx(image[rows, columns].mean(), rel=1e-6)


@pytest.mark.parametrize("block", [1.0, 1.5, 5.0])
def test_blocks_that_are_smaller_than_cells_have_a_mean_too(of_many_tiles: tuple[View, OwnRays], block: float) -> None:
    """Cells of 2 px, as behind a wide opening; the last of 25 rows lies half beside the sensor."""
    _, own = of_many_tiles
    camera = replace(own.plan.camera, sensor=replace(own.plan.camera.sensor, rows=25))
    grid = replace(own.plan.grid, base=4, levels=1)
    plan = replace(own.plan, camera=camera, grid=grid, tiles=((0, 12, 0, COLUMNS), (12, 25, 0, COLUMNS)))
    tiles, values = SeenTiles(), np.random.default_rng(1).random((13, COLUMNS // 2)).astype(np.float32)
    tiles.begin("wide", plan, 1)
    image = CentralImage((0, 0), values, np.ones_like(values), 0)
    for tile in (0, 1):
        tiles.put("wide", (0, tile), plan, image, image)
    found = replace(own, plan=plan, replicates=1, name="wide", seen=tiles).means(block, 0)
    pixels = values.repeat(2, axis=0).repeat(2, axis=1)
    for row, column in np.ndindex(found.shape):
        rows, columns = (slice(*(math.ceil(block * n - 0.5) for n in (at, at + 1))) for at in (row, column))
        assert found[row, column] == pytest.approx(pixels[rows, columns].mean(), rel=1e-6)


def test_strips_lie_around_the_sensor_and_nowhere_twice(of_many_tiles: tuple[View, OwnRays]) -> None:
    of, own = of_many_tiles
    plan = planned(of, own)
    cell, places = plan.kernel.grid.cell, strips_beside(plan)
    low = min(place[0] for place in places), min(place[2] for place in places)
    high = max(place[1] for place in places), max(place[3] for place in places)
    covered = np.zeros(
        [max(place[end] for place in places) - begin for end, begin in zip((1, 3), low, strict=True)], int
    )
    for r0, r1, c0, c1 in (*places, (0, math.ceil(ROWS / cell), 0, math.ceil(COLUMNS / cell))):
        covered[r0 - low[0] : r1 - low[0], c0 - low[1] : c1 - low[1]] += 1
    assert (covered == 1).all()
    for tile in range(len(plan.kernel.tiles)):
        (row, column), (rows, columns) = region_of(plan.kernel, tile)
        assert row >= low[0] and column >= low[1]
        assert row + rows <= high[0] and column + columns <= high[1]


def test_rays_suffice_where_cells_and_depths_do(of_many_tiles: tuple[View, OwnRays]) -> None:
    of, own = of_many_tiles
    plan, number, cell = own.plan, own.replicates, own.cell
    waves = planned(of, own)
    assert not suffice(plan, number, plan_waves(of, WAVELENGTH, 0.25, 1, even_cell=cell / 2))
    assert not suffice(plan, number, plan_waves(of, WAVELENGTH, 0.25, 1, even_cell=2.0)) or cell == 2.0
    flat = replace(plan, grid=replace(plan.grid, with_depth=False))
    assert not suffice(flat, number, waves)
    assert suffice(flat, number, replace(waves, kernel=replace(waves.kernel, layers=waves.kernel.layers[:1])))


def test_of_many_cells_such_are_kept_as_waves_usually_ask_for(of_many_tiles: tuple[View, OwnRays]) -> None:
    of, own = of_many_tiles
    sharp = replace(own.plan, grid=replace(own.plan.grid, base=1, levels=2))
    large = replace(own.plan.camera.sensor, rows=2048, columns=2448)
    of_large = replace(sharp, camera=replace(sharp.camera, sensor=large))
    assert kept_cell(sharp, 2) == 0.25 and kept_cell(of_large, 2) == 0.5
    coarse = replace(of_large, grid=replace(sharp.grid, base=1, levels=0))
    assert kept_cell(coarse, 2) == 1.0
    waves = plan_waves(of, WAVELENGTH, 0.25, 1, even_cell=0.5)
    assert suffice(of_large, 2, waves) and not suffice(of_large, 8, waves)


def test_only_the_image_that_was_begun_last_is_kept(of_many_tiles: tuple[View, OwnRays]) -> None:
    _, own = of_many_tiles
    tiles, image = SeenTiles(), whole_image(own, 0)
    tiles.begin("one", own.plan, 2)
    tiles.put("another", (0, 0), own.plan, image, image)
    assert tiles.get("another", (0, 0)) is None
    tiles.put("one", (0, 0), own.plan, image, image)
    tiles.begin("one", own.plan, 2)
    found, place = tiles.get("one", (0, 0)), cells_of(own.plan, 0, own.cell)
    assert isinstance(found, SeenTile) and found.values.tobytes() == part_of(image, place).values.tobytes()
    tiles.begin("another", own.plan, 2)
    assert tiles.get("one", (0, 0)) is None
