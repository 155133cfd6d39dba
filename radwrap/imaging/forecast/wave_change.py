"""What diffraction changes of an image that rays make: the wave's footprint less that of rays, over the central image.

The central image is traced coarsely, with a ray in each cell, twice: what both
find alike is no noise. Cells are as small as what differs, half of the wave's
length lambda N or of the blur. Far around a place, where only the wave's tails
come from, a ray stands for a block of cells. Some pixels are looked at for
themselves, and of a large image only these: drawn by how much the light around
them differs, each with rays that are drawn from the difference of the footprints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.around import least_around, most_around
from radwrap.imaging.methods.kernel import layer_shares
from radwrap.imaging.optics.footprint import reach_px
from radwrap.imaging.optics.lens_field import LensField, Place, glass_at, glass_reach, lens_field
from radwrap.imaging.optics.view import View, look_at_depths, trace_rays
from radwrap.imaging.optics.wave_footprint import passed_weights
from radwrap.imaging.optics.waves import Waves
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.bounds import NOTHING, Bounded, mean_squares, resampling
from radwrap.imaging.tolerance.wave_behind import Layout, by_layer
from radwrap.random_streams import Rendering, generator
from radwrap.scene.camera import Camera

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rect = tuple[int, int, int, int]

# A cell over the wave's length or the width of fringes along the rim of a blur, the larger of them; the smallest [px].
_CELL_SHARE: Final = 0.25
# An image that is looked at as a whole may have larger cells, which find less: 2, 6 and 12 % less on a board of dots.
_COARSER: Final = (1, 2, 4)
_SMALLEST: Final = 2.0**-6
_BLOCK: Final = 8  # cells along a side of what one ray stands for in the far parts
# Light that waves send farther than the guard band's width comes in from the other side; it counts as an error.
_TAIL: Final = 0.01
_NEAR: Final = 3.0  # wave's lengths beyond the blur within which every cell has a ray
# Radii of blur that are told apart, as a share of the wave's length, and how many at most.
_LAYER_STEP: Final = 0.5
_MOST_LAYERS: Final = 17
_STEPS: Final = 2  # between places of a lens's field along a side: they stand for all of it
_MOST_CELLS: Final = 1 << 22  # around a pixel, of all layers: transforms of 64 MiB
# Rays of a look at depths (a side of the grid), and of an image that is looked at as a whole.
_LOOK: Final = 32
MOST_RAYS: Final = 1 << 16
# Rays of single pixels beside it: a line that is thinner than its cells may be met by few of its rays.
_OF_PIXELS: Final = 0.5  # of the rays that an image may take
# Rays around each pixel, in each of two sets. Few, as pixels differ by more than a pixel's rays: of a chart with an
# edge beside a column of pixels half a percent of them hold two thirds of the mean square.
_RAYS: Final = 8
# Where no image is known, so many around each pixel from which those that are looked at are drawn tell how the light
# around them differs. A pixel where these miss what waves change counts for much if it is drawn: with four of them 8 %
# of the bounds about thin lines were broken, with eight 2 %.
_LOOKS: Final = 8
# Light that looks even may have an edge that shows nowhere: it counts as if it differed by this share of the mean. So
# half of the pixels are drawn anywhere, and none counts for more than two.
_UNSEEN: Final = 1.0
_ONE_SIDED: Final = 1.959963985


@dataclass(frozen=True, slots=True)
class _Grid:
    """Cells, layers, places of the lens's field and guard bands, the same for each part of an image."""

    camera: Camera
    waves: Waves
    lens_field: LensField
    cell: float
    layers: tuple[float, ...]
    near: int
    far: int
    less: Waves  # what they are compared with: rays, or waves behind a perfect lens

    @property
    def block(self) -> float:
        """Side of a block [px]."""
        return _BLOCK * self.cell

    @property
    def reach(self) -> int:
        """How far light changes a pixel by most of what waves do, and rays [px]."""
        sensor, most = self.camera.sensor, max(map(abs, self.layers))
        length = self.waves.blur / min(sensor.pixel_width, sensor.pixel_height)
        return max(2, math.ceil(length + max(reach_px(self.camera, most))))

    @property
    def cut(self) -> float:
        """Share of the light that waves send beyond the guard band."""
        sensor = self.camera.sensor
        return self.waves.tail(self.far * min(sensor.pixel_width, sensor.pixel_height))

    def around(self, rect: Rect, guard: int) -> Rect:
        """First and last block + 1 of rows and columns that hold a part of the sensor and a guard band [px]."""
        r0, r1, c0, c1 = rect
        low, high = (math.floor((at - guard) / self.block) for at in (r0, c0)), (r1, c1)
        ends = (math.ceil((at + guard) / self.block) for at in high)
        (a, b), (c, d) = tuple(low), tuple(ends)
        return a, c, b, d

    def shape(self, rect: Rect) -> tuple[int, int]:
        """Rows and columns of the cells that a part takes."""
        r0, r1, c0, c1 = self.around(rect, self.far)
        return (r1 - r0) * _BLOCK, (c1 - c0) * _BLOCK

    def rays(self, rect: Rect) -> int:
        """How many rays a part takes in each set, about."""
        near, far = ((r1 - r0) * (c1 - c0) for r0, r1, c0, c1 in (self.around(rect, g) for g in (self.near, self.far)))
        return near * _BLOCK**2 + far - near

    def weights(self, shape: tuple[int, int]) -> dict[Place, list[tuple[Complex, Complex]]]:
        """Of each place of the field and layer what is gathered without waves, and what they add to it."""
        without = [passed_weights(self.less, self.camera, layer, self.cell, shape) for layer in self.layers]
        found = {}
        for place in self.lens_field.places:
            waves = replace(self.waves, glass=glass_at(self.camera, place))
            passed = [passed_weights(waves, self.camera, layer, self.cell, shape) for layer in self.layers]
            found[place] = [(rays, each - rays) for rays, each in zip(without, passed, strict=True)]
        return found


def wave_change(
    view: View,
    wavelength: float,
    seed: int,
    most_rays: int = MOST_RAYS,
    *,
    of_glass: bool = False,
    image: Array | None = None,
) -> tuple[Bounded, int]:
    """Mean square of what diffraction would change of the gray levels, and how many rays it took to find out.

    Parameters
    ----------
    view : View
        The camera, and who traces.
    wavelength : float
        Of the light [m].
    seed : int
        Of all that is drawn.
    most_rays : int
        About how many rays it may take, and half as many for single pixels; where they are few the bound is wide.
    of_glass : bool
        Whether only that counts which waves behind a perfect lens do not change.
    image : ndarray, shape (rows, columns), optional
        The image without waves, where it is made: it shows around which pixels the light differs [W m^-2 sr^-1].

    Returns
    -------
    Bounded
        [gray level^2]. The bound holds what so few rays and pixels leave open, and the light that waves send beyond the
        guard band.
    rays : int
    """
    camera = view.camera
    if camera.aperture.is_infinitesimal or not camera.exposure_time:
        return NOTHING, 0
    random = generator(seed, Rendering.WAVES)
    grid, looked = _grid_of(view, Waves(camera.aperture, camera.image_distance, wavelength), random)
    if of_glass:
        grid = replace(grid, less=grid.waves)
    sensor = camera.sensor
    whole = (0, sensor.rows, 0, sensor.columns)
    cells = (replace(grid, cell=times * grid.cell) for times in _COARSER)
    coarse = next((each for each in cells if 2 * each.rays(whole) <= most_rays), None)
    for_pixels = round(_OF_PIXELS * most_rays)
    if coarse is None:
        for_looks = most_rays if image is None else 0
        each = for_looks, for_pixels + most_rays - for_looks
        square, rays = _of_some(view, grid, seed, random, rays=each, image=image)
        return square, looked + rays
    square, rays = _of_whole(view, coarse, random)
    for_looks = for_pixels // 2 if image is None else 0
    each = for_looks, for_pixels - for_looks
    by_pixels, more = _of_some(view, grid, seed, random, rays=each, image=image)
    return _of_both(square, by_pixels), looked + rays + more


def _of_both(whole: Bounded, by_pixels: Bounded) -> Bounded:
    """What two looks find together.

    That of the whole image meets a thin line by few rays, all pixels by the same: where pixels for themselves, each by
    rays of its own, find more than its bound, it stepped over something; what noise takes below zero tells nothing.
    Pixels for themselves know less of what hides.
    """
    estimate = whole.mean if whole.mean > 0 and by_pixels.mean <= whole.upper else by_pixels.mean
    return Bounded(estimate, max(whole.upper, by_pixels.upper))


def _grid_of(view: View, waves: Waves, random: np.random.Generator) -> tuple[_Grid, int]:
    """Cells and layers by a look at the depths."""
    camera, sensor = view.camera, view.camera.sensor
    pitch = min(sensor.pixel_width, sensor.pixel_height)
    length = waves.blur / pitch
    met, rays = look_at_depths(view, _LOOK, random)
    low, high = (float(met.min()), float(met.max())) if met.size else (camera.shear, camera.shear)
    of_one = max(reach_px(camera, 1.0))
    number = math.ceil(of_one * (high - low) / max(_LAYER_STEP * length, _LAYER_STEP)) + 1
    layers = (low,) if low == high else tuple(np.linspace(low, high, min(max(number, 2), _MOST_LAYERS)).tolist())
    least, most = (0.0 if low < 0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))
    # Fresnel's fringes: waves of that length blur a rim of rays over the square root of both lengths.
    radius = min(reach_px(camera, least))
    size = _CELL_SHARE * max(length, min(radius, math.sqrt(2 * length * radius)))
    cell = 2.0 ** math.floor(math.log2(max(size, _SMALLEST)))
    near = math.ceil(max(reach_px(camera, most)) + _NEAR * length + glass_reach(camera) / pitch)
    of_lens = lens_field(camera, waves.wavelength, _STEPS)
    far = max(near, math.ceil(waves.tail_radius(_TAIL) / pitch))
    # Beside a deep blur tails are cut earlier, which the bound holds, and then cells are larger.
    while (2 * far / cell) ** 2 * len(layers) * len(of_lens.places) > _MOST_CELLS:
        far, cell = (max(near, far // 2), cell) if far > near else (far, 2 * cell)
    return _Grid(camera, waves, of_lens, cell, layers, near, far, replace(waves, wavelength=0.0)), rays


def _of_some(
    view: View,
    grid: _Grid,
    seed: int,
    random: np.random.Generator,
    *,
    rays: tuple[int, int],
    image: Array | None,
) -> tuple[Bounded, int]:
    """Mean square over an image by some of its pixels, and how many rays it took.

    Of so many rays the first tell around which of some pixels light differs, and the others what waves change there.
    """
    sensor, scale = view.camera.sensor, view.exposure_of_radiance
    if (places := _Drawn.of(grid)) is None:
        return NOTHING, 0
    if image is None:
        pool = random.choice(sensor.pixels, min(sensor.pixels, rays[0] // _LOOKS), replace=False)
        looks, _, looked = places.seen(view, pool, 1, _LOOKS, random)
        each = looks.mean(axis=1)
        differing = np.ptp(gray_levels(looks * scale, sensor), axis=1)
    else:
        pool, looked, each = None, 0, image.ravel()
        differing = differences_around(gray_levels(image * scale, sensor), grid.reach).ravel()
    chosen, weights = _by_size(differing, max(rays[1] // (2 * _RAYS), 2), random)
    seen = each[chosen]
    light, change_of, traced = places.seen(view, chosen if pool is None else pool[chosen], 2, _RAYS, random)
    # Weights of even light sum to nothing: what all rays of a pixel see alike adds no noise.
    change = ((light - seen[:, np.newaxis]) * change_of).reshape(len(seen), 2, _RAYS).mean(axis=2).T
    first, second = np.sqrt(weights) * _in_gray(seen, change, view)
    again = resampling(np.zeros(len(seen), dtype=np.intp), np.ones(1), (seed, Rendering.WAVE_RESAMPLES))
    (square,) = mean_squares(first[np.newaxis], second[np.newaxis], again)
    if pool is not None and len(pool) < sensor.pixels:
        square = _of_drawn(square, first * second / np.sqrt(weights), len(pool))
    tail = math.sqrt(float((weights * _in_gray(seen, grid.cut * (float(each.mean()) - seen), view) ** 2).mean()))
    return _with_tails(square, tail), looked + traced


def _of_drawn(square: Bounded, each: Array, number: int) -> Bounded:
    """A mean square over so many pixels, which are a draw themselves: by each pixel's, as they are drawn by weights."""
    spread = max(float((each**2).mean()) - square.mean**2, 0.0)
    known = max(square.mean, 0.0)
    width = math.hypot(square.upper - known, _ONE_SIDED * math.sqrt(spread / number))
    return Bounded(square.mean, known + width)


def _by_size(sizes: Array, number: int, random: np.random.Generator) -> tuple[NDArray[np.intp], Array]:
    """So many places drawn by sizes, and how much each counts in a mean over all places."""
    sizes = sizes + max(_UNSEEN * float(sizes.mean()), np.finfo(np.float64).tiny)
    bounds = np.cumsum(sizes)
    drawn = (np.arange(number) + random.random(number)) / number
    chosen = np.minimum(np.searchsorted(bounds, drawn * bounds[-1], side="right"), len(bounds) - 1)
    return chosen, float(bounds[-1]) / len(sizes) / sizes[chosen]


def differences_around(gray: Array, reach: int) -> Array:
    """Largest less smallest gray level around each pixel, a reach [px] to twice that far, shape (rows, columns)."""
    down, across = (np.arange(0, size, reach) for size in gray.shape)
    high, low = (
        around(each.reduceat(each.reduceat(gray, down, axis=0), across, axis=1), 3)
        for each, around in ((np.maximum, most_around), (np.minimum, least_around))
    )
    found = high - low
    rows, columns = (np.arange(size) // reach for size in gray.shape)
    return found.take(rows, axis=0).take(columns, axis=1)


def _in_gray(seen: Array, change: Array, view: View) -> Array:
    """Change of gray levels by a change of radiance whose noise may take it below none, or above saturation.

    What a change so large as to meet either limit would do is read off the other way: to cut noise on one side
    only would take from the mean.
    """
    sensor, scale = view.camera.sensor, view.exposure_of_radiance
    size = np.abs(change)
    here, up, down = (gray_levels(np.maximum(each, 0.0) * scale, sensor) for each in (seen, seen + size, seen - size))
    is_below, is_above = size > seen, (up >= sensor.saturation_gray) & (here < sensor.saturation_gray)
    rise = np.where(is_above, here - down, up - here)
    fall = np.where(is_below, up - here, here - down)
    found: Array = np.where(change > 0, rise, -fall)
    return found


def _with_tails(square: Bounded, tail: float) -> Bounded:
    """A mean square whose bound holds the rms of what the cut tails may do."""
    return Bounded(square.mean, (math.sqrt(square.upper) + tail) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """Rays whose places around a pixel are drawn from what waves change of its footprint.

    Attributes
    ----------
    grid : _Grid
    side : int
        Rows and columns of the cells around the pixel; those before its own lie at the far ends.
    kernels : ndarray, shape (places, layers, side^2)
        What waves add to the weight of each cell, at each place of the lens's field.
    density : ndarray, shape (side^2,)
        By which cells are drawn.
    """

    grid: _Grid
    side: int
    kernels: Array
    density: Array

    @classmethod
    def of(cls, grid: _Grid) -> _Drawn | None:
        """Of all cells that waves reach; None where waves change nothing."""
        side = _BLOCK * math.ceil((2 * grid.far / grid.cell + 1) / _BLOCK)
        kernels = np.stack(
            [
                [np.fft.irfft2(waves, (side, side)).ravel() for _, waves in each]
                for each in grid.weights((side, side)).values()
            ]
        )
        density = np.abs(kernels.reshape(-1, side**2)).mean(axis=0)
        return cls(grid, side, kernels, density / density.sum()) if density.any() else None

    def seen(
        self, view: View, pixels: NDArray[np.intp], sets: int, number: int, random: np.random.Generator
    ) -> tuple[Array, Array, int]:
        """Radiance of sets of so many rays around each pixel, what each counts of the change; and all rays' number.

        Each set is spread over all cells, and independent of the others.
        """
        inside = (np.arange(number) + random.random((len(pixels), sets, number))) / number
        inside = inside.reshape(len(pixels), sets * number)
        bounds = np.cumsum(self.density)
        cell = np.minimum(np.searchsorted(bounds, inside * bounds[-1], side="right"), len(bounds) - 1)
        row, column = ((at + self.side // 2) % self.side - self.side // 2 for at in np.divmod(cell, self.side))
        v, u = np.divmod(pixels, view.camera.sensor.columns)
        places = (
            (pixel[:, np.newaxis] + (at + random.random(at.shape)) * self.grid.cell - 0.5).ravel()
            for pixel, at in ((u, column), (v, row))
        )
        light, depth = trace_rays(view, None, *places, with_depth=len(self.grid.layers) > 1)
        shares = layer_shares(self.grid.layers, depth)
        each = cell.ravel()
        place = np.repeat(self.grid.lens_field.nearest(u, v), cell.shape[1])
        change = sum(
            share * kernel[place, each] for share, kernel in zip(shares, self.kernels.swapaxes(0, 1), strict=True)
        )
        return light.reshape(cell.shape), (change / self.density[each]).reshape(cell.shape), light.size


def _of_whole(view: View, grid: _Grid, random: np.random.Generator) -> tuple[Bounded, int]:
    """Mean square over a whole image, and the rays that it took."""
    sensor = view.camera.sensor
    rect = (0, sensor.rows, 0, sensor.columns)
    shape = grid.shape(rect)
    asked = [_places(grid, rect, random) for _ in range(2)]
    u, v = (np.concatenate([places[axis] for places in asked]) for axis in (0, 1))
    values, magnification = trace_rays(view, None, u, v, with_depth=len(grid.layers) > 1)
    weights = grid.weights(shape)
    found = []
    for places, light, depth in zip(asked, np.split(values, 2), np.split(magnification, 2), strict=True):
        laid = [_laid(places[2], shape, each) for each in (light, depth)]
        found.append((*_gathered(grid, rect, weights, laid[0], laid[1]), float(laid[0].mean())))
    seen = np.maximum((found[0][0] + found[1][0]) / 2, 0.0)
    tails = grid.cut * ((found[0][2] + found[1][2]) / 2 - seen)
    first, second = _in_gray(seen, np.stack([change for _, change, _ in found]), view)
    tail = math.sqrt(float((_in_gray(seen, tails, view) ** 2).mean()))
    return _with_tails(_known(first, second, grid), tail), len(u)


def _known(first: Array, second: Array, grid: _Grid) -> Bounded:
    """Mean square where all of the image was looked at: only rays are drawn, so their noise is what is not known."""
    mean = float((first * second).mean())
    noise = float(((first - second) ** 2).mean()) / 2
    apart = max(1.0, (2 * grid.near / max(1.0, grid.cell)) ** 2)  # pixels over which noise hangs together
    spread = math.sqrt((2 * max(mean, 0.0) * noise + noise**2) / max(1.0, first.size / apart))
    return Bounded(mean, max(mean, 0.0) + _ONE_SIDED * spread)


def _places(grid: _Grid, rect: Rect, random: np.random.Generator) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Columns and rows of rays [px], those of far blocks first, and which blocks are near."""
    r0, r1, c0, c1 = grid.around(rect, grid.far)
    a, b, c, d = grid.around(rect, grid.near)
    near = np.zeros((r1 - r0, c1 - c0), dtype=bool)
    near[a - r0 : b - r0, c - c0 : d - c0] = True
    row, column = np.nonzero(~near)
    rows, columns = (row + random.random(len(row))) * _BLOCK, (column + random.random(len(row))) * _BLOCK
    row, column = np.nonzero(np.repeat(np.repeat(near, _BLOCK, axis=0), _BLOCK, axis=1))
    rows = np.concatenate([rows, row + random.random(len(row))]) + r0 * _BLOCK
    columns = np.concatenate([columns, column + random.random(len(row))]) + c0 * _BLOCK
    return columns * grid.cell - 0.5, rows * grid.cell - 0.5, near


def _laid(near: NDArray[np.bool_], shape: tuple[int, int], values: Array) -> Array:
    """Values of rays in the cells that they stand for."""
    far = int((~near).sum())
    blocks = np.zeros(near.shape)
    blocks[~near] = values[:far]
    cells = np.repeat(np.repeat(blocks, _BLOCK, axis=0), _BLOCK, axis=1).reshape(shape)
    cells[np.repeat(np.repeat(near, _BLOCK, axis=0), _BLOCK, axis=1)] = values[far:]
    return cells


def _gathered(
    grid: _Grid, rect: Rect, weights: dict[Place, list[tuple[Complex, Complex]]], light: Array, depth: Array
) -> tuple[Array, Array]:
    """What rays gather at those pixels of a part that lie alike in their cells, and what waves add."""
    layout = Layout.of(depth, grid.layers)
    behind = layout.going_on(light)
    spectra = {layer: np.fft.rfft2(one) for layer, one in by_layer(((light, layout.seen),)).items()}
    of_behind = spectra if behind is None else {layer: np.fft.rfft2(one) for layer, one in by_layer(behind).items()}
    r0, r1, c0, c1 = rect
    first_row, _, first_column, _ = grid.around(rect, grid.far)
    step = max(1, round(grid.cell))
    at, chosen = [], []
    for begin, end, first in ((r0, r1, first_row), (c0, c1, first_column)):
        pixels = np.arange(begin + -begin % step, end, step)
        at.append(np.floor(pixels / grid.cell).astype(np.intp) - first * _BLOCK)
        chosen.append(pixels - begin)
    found = np.zeros((2, at[0].size * at[1].size))
    for place, share, _ in grid.lens_field.shares(rect):
        of_rays = sum(one * np.conj(weights[place][layer][0]) for layer, one in spectra.items())
        of_waves = sum(one * np.conj(weights[place][layer][1]) for layer, one in of_behind.items())
        each = [np.fft.irfft2(one, light.shape)[np.ix_(*at)].ravel() for one in (of_rays, of_waves)]
        found += share[np.ix_(*chosen)].ravel() * np.stack(each)
    return found[0], found[1]
