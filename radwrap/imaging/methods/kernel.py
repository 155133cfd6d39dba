"""The finite pinhole from one image: the central image, gathered with the opening's shape.

Exact where radiance does not change over the opening and nothing hides
anything; the certificate tells how far that holds. Depth enters by layers:
each cell's light is spread with its own magnification, shared between the two
layers next to it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.methods.central import Cells, CentralImage, central_image, decide_cells
from radwrap.imaging.methods.grid import GridPlan
from radwrap.imaging.methods.transforms import correlated, fast_length, spectrum_of
from radwrap.imaging.optics.footprint import footprint, laid_out, reach_px
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.optics.view import View
from radwrap.imaging.response.sensor import gray_levels
from radwrap.manifest import ONLY_WHERE_USED
from radwrap.scene.camera import Camera, Sensor

# Base cells are at most this share of the blur's radius, grid cells a quarter of them; where the blur is smaller than
# a pixel, grid cells are an eighth of a pixel, for the footprint then has edges as sharp as that.
_BASE_SHARE: Final = 0.25
_LEVELS: Final = 1
_SHARP_LEVELS: Final = 2
_SHARP_BLUR: Final = 1.5  # px
_COARSEST: Final = 64.0  # px
# Base cells of an image, at least: what is smaller than all of them may be missed, and then is only found as noise.
_BASE_CELLS: Final = 1 << 14
# Radii of blur [px] that are told apart: one layer does where all lie this close together, else layers this far apart.
_SAME_RADIUS: Final = 0.02
_LAYER_STEP: Final = 0.25
_MOST_LAYERS: Final = 64
# The error falls as the cells' size to the power 1.5 where edges of light meet edges of the footprint, as its square
# elsewhere: the slower one gives 1/(2^1.5 - 1) of what twice the size adds.
GRID_SHARE: Final = 1 / (2**1.5 - 1)
# What is measured over many pixels sees an edge at every place in a cell. On the average over these places cells of the
# size h blur as a box of width h does: by h^2/24 times the second derivative, and the next term has h^4. So the error
# falls as h^2, and 1/(2^2 - 1) of what twice the size adds is left (Richardson).
_SMOOTH_SHARE: Final = 1 / (2**2 - 1)
# A blur narrower than so many cells is not resolved by them: light comes from beside an edge, and a cell knows its mean
# alone. Smaller cells help nothing until they resolve it, so that all of what twice the size changes may be left.
_RESOLVED: Final = 2.0
# Cells of a footprint up to which sums take less time than transforms of a tile.
_FEW_CELLS: Final = 1024
# Grid cells of a tile: what a transform of some 30 MiB holds; wide rather than high, so that small images have two.
_TILE_ROWS, _TILE_COLUMNS = 400, 1600


# Of a tile of smooth blocks only.
NO_CELLS: Final = Cells((0, 0), np.zeros((1, 1), dtype=np.int8), 0, 0.0, 0)


class TooDeep(InputError):
    """A scene has more depths than one central image may have layers."""


@dataclass(frozen=True, slots=True)
class KernelPlan:
    """All that decides an image by the kernel, the scene and the seed aside.

    Attributes
    ----------
    camera : Camera
        The view.
    grid : GridPlan
        The central image.
    layers : tuple of float
        Magnifications m, see `Camera.magnification`, evenly spaced.
    tiles : tuple
        First row, last row + 1, first column, last column + 1 of each tile of the sensor [px].
    guard : float, optional
        How much farther light may come from than rays go, of waves [px].
    """

    camera: Camera
    grid: GridPlan
    layers: tuple[float, ...]
    tiles: tuple[tuple[int, int, int, int], ...]
    guard: float | None = field(default=None, metadata=ONLY_WHERE_USED)

    @property
    def reach_px(self) -> tuple[float, float]:
        """How far, in columns and rows, a pixel's centre gathers light from at most [px]."""
        columns, rows = reach_px(self.camera, max(map(abs, self.layers)))
        return columns + (self.guard or 0.0), rows + (self.guard or 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """A tile of the image.

    Attributes
    ----------
    values : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) over pixel and opening [W m^-2 sr^-1].
    some : tuple of ndarray of int
        Rows and columns, from the tile's corner, of pixels that tell what the cells' size changes.
    change : ndarray, shape (rows, columns)
        That change at these pixels [W m^-2 sr^-1].
    central, coarser : CentralImage
        What they were gathered from.
    """

    values: NDArray[np.float64]
    some: tuple[NDArray[np.intp], ...]
    change: NDArray[np.float64]
    central: CentralImage
    coarser: CentralImage

    def grid_squares(self, exposure_of_radiance: float, sensor: Sensor) -> NDArray[np.float64]:
        """Of each pixel, or of the nearest that tells, the square of what the cells' size changes [gray level^2]."""
        return self.spread(grid_squares(self.values[self.some], self.change, exposure_of_radiance, sensor))

    def spread(self, told: NDArray[np.float64]) -> NDArray[np.float64]:
        """For each pixel what the nearest one tells of those that do; 0 where none does."""
        if not told.size:
            return np.zeros(self.values.shape)
        near = [
            np.abs(np.arange(size)[:, np.newaxis] - at.ravel()).argmin(axis=1)
            for size, at in zip(self.values.shape, self.some, strict=True)
        ]
        spread: NDArray[np.float64] = told[np.ix_(*near)]
        return spread


def grid_squares(
    radiance: NDArray[np.float64], change: NDArray[np.float64], exposure_of_radiance: float, sensor: Sensor
) -> NDArray[np.float64]:
    """Squares of what changes of radiance [W m^-2 sr^-1] do to gray levels [gray level^2].

    Radiance that rays have corrected may fall below zero by its noise; what counts is the image, which does not.
    """
    each = (np.maximum(values, 0.0) for values in (radiance + change, radiance))
    gray, exact = (gray_levels(values * exposure_of_radiance, sensor) for values in each)
    squares: NDArray[np.float64] = (gray - exact) ** 2
    return squares


def plan_kernel(
    view: View, magnifications: NDArray[np.float64], aim: float, finer: int = 0, *, even_cell: float | None = None
) -> KernelPlan:
    """Choose grid, layers and tiles.

    Parameters
    ----------
    view : View
        For its camera.
    magnifications : ndarray
        m of what is in view, from a survey.
    aim : float
        Rms error of one replicate to aim at [gray level].
    finer : int
        How often the grid's cells are halved, where the usual ones were found too coarse.
    even_cell : float, optional
        A power of 2 [px]: one ray in each cell of that size, in place of cells that follow what is seen.

    Raises
    ------
    TooDeep
        If the scene is too deep for as many layers as are allowed.
    """
    camera = view.camera
    nothing = camera.shear
    low, high = (float(magnifications.min()), float(magnifications.max())) if magnifications.size else (nothing,) * 2
    layers = _layers(camera, low, high)
    # Behind the plane of focus of a lens m is below 0, and in it no opening blurs.
    least, most = (0.0 if low < 0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))
    blur = min(reach_px(camera, least))
    sensor = camera.sensor
    reach = reach_px(camera, most)
    covered = (sensor.columns + 2 * reach[0]) * (sensor.rows + 2 * reach[1])
    coarsest = min(_BASE_SHARE * blur, math.sqrt(covered / _BASE_CELLS), _COARSEST)
    base = 2 ** math.floor(math.log2(max(1.0, coarsest if even_cell is None else even_cell)))
    levels = (_LEVELS if blur >= _SHARP_BLUR else _SHARP_LEVELS) + finer
    opening = camera.aperture.area if not camera.aperture.is_infinitesimal else 0.0
    grid = GridPlan(
        base=base,
        levels=levels if even_cell is None else round(math.log2(base / even_cell)),
        area=1 + opening * least**2 / (sensor.pixel_width * sensor.pixel_height),
        aim=aim,
        exposure_of_radiance=view.exposure_of_radiance,
        sensor=sensor,
        with_depth=len(layers) > 1,
        even=None if even_cell is None else True,
        smooth=view.smooth.sha256 if view.smooth and even_cell is None else None,
    )
    rows, columns = (
        _cuts(size, max(1, int(most * grid.cell)))
        for size, most in ((sensor.rows, _TILE_ROWS), (sensor.columns, _TILE_COLUMNS))
    )
    tiles = tuple((r0, r1, c0, c1) for r0, r1 in rows for c0, c1 in columns)
    return KernelPlan(camera, grid, layers, tiles)


def _cuts(size: int, side: int) -> list[tuple[int, int]]:
    number = -(-size // side)
    bounds = [size * i // number for i in range(number + 1)]
    return list(itertools.pairwise(bounds))


def _layers(camera: Camera, low: float, high: float) -> tuple[float, ...]:
    """Magnifications between which each cell's light is shared."""
    spread = max(reach_px(camera, 1.0)) * (high - low)
    if spread <= _SAME_RADIUS:
        return ((low + high) / 2,)
    number = math.ceil(spread / _LAYER_STEP) + 1
    if number > _MOST_LAYERS:
        raise TooDeep(
            f"the blur's radius differs by {spread:.3g} px over the scene's depth, too much for one central image",
            where='method="kernel"',
            remedy='use `method="rays"`',
        )
    return tuple(np.linspace(low, high, max(2, number)).tolist())


def layer_shares(layers: tuple[float, ...], magnification: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Share of each layer in light of the given magnifications; shares sum to 1."""
    if len(layers) == 1:
        return [np.ones_like(magnification)]
    place = layer_places(layers, magnification)
    return [layer_share(place, number) for number in range(len(layers))]


def layer_share(place: NDArray[np.float64], number: int) -> NDArray[np.float64]:
    """Share of one of several layers in light that lies at some places between them, see `layer_places`."""
    return np.asarray(np.maximum(0.0, 1 - np.abs(place - number)))


def layer_places(layers: tuple[float, ...], magnification: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers of the layers, of two at least, that light of the given magnifications lies at or between."""
    return np.asarray(np.clip((magnification - layers[0]) / (layers[1] - layers[0]), 0.0, len(layers) - 1.0))


def decide_tile(
    view: View,
    plan: KernelPlan,
    tile: int,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
    *,
    smooth: SmoothField | None = None,
) -> Cells:
    """Find out which cells of the central image a tile needs; parameters as in `gathered_tile`.

    With smooth blocks no cell is cut within them, though they are traced as the others.
    """
    if plan.grid.smooth and is_smooth(view.smooth, plan, plan.tiles[tile]):
        return NO_CELLS
    return decide_cells(view, plan.grid, region_of(plan, tile), seed=seed, progress=progress, smooth=smooth)


def region_of(plan: KernelPlan, tile: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """First row and column of the grid cells that a tile gathers from, and how many rows and columns they are."""
    place, cell, reach = plan.tiles[tile], plan.grid.cell, plan.reach_px
    # One pair of cells more on each side, for the coarser image.
    spans = [
        (math.floor((begin - far) / cell) - 2, math.ceil((end + far) / cell) + 2)
        for begin, end, far in ((*place[:2], reach[1]), (*place[2:], reach[0]))
    ]
    return (spans[0][0], spans[1][0]), (spans[0][1] - spans[0][0], spans[1][1] - spans[1][0])


def gathered_tile(
    view: View,
    plan: KernelPlan,
    tile: int,
    cells: Cells,
    *,
    seed: tuple[int, ...],
    progress: Callable[[int], None],
) -> Gathered:
    """Trace what a tile needs of the central image, and gather it.

    Parameters
    ----------
    view : View
        Who traces.
    plan : KernelPlan
        What to do.
    tile : int
        Number of the tile.
    cells : Cells
        What `decide_tile` found.
    seed : tuple of int
        Decides the rays.
    progress : callable
        Is told how many rays were traced.
    """
    if not cells.samples:
        (known,) = smooth_tiles(view, plan, plan.tiles[tile])
        return known
    central = central_image(view, plan.grid, cells, seed=seed, progress=progress)
    (found,) = gathered_each(plan, plan.tiles[tile], central, coarsened(central))
    return found


def gathered_each(
    plan: KernelPlan, place: tuple[int, int, int, int], central: CentralImage, coarser: CentralImage
) -> Iterator[Gathered]:
    """Gather a tile for each source of a central image, given that image in cells of twice the size."""
    cell = plan.grid.cell
    values = gather(plan, central, cell, place)
    # Cells of twice the size add their error less that of these: so much of it, see `GRID_SHARE`. Some pixels tell.
    some, coarse = (gather_all if plan.grid.even else gather_some)(plan, coarser, 2 * cell, place)
    each = (array.reshape(-1, *array.shape[-2:]) for array in (central.values, coarser.values, values, coarse))
    for one, of_one, fine, rough in zip(*each, strict=True):
        change = grid_share(plan) * (rough - fine[some])
        yield Gathered(fine, some, change, replace(central, values=one), replace(coarser, values=of_one))


def smooth_tiles(view: View, plan: KernelPlan, place: tuple[int, int, int, int]) -> Iterator[Gathered]:
    """A tile of smooth blocks alone, of each source that the view's tracer tells apart."""
    known = view.smooth
    if known is None:
        raise TypeError("no block of this view is known to be smooth")
    for values in known.values[np.newaxis] if known.values.ndim == 2 else known.values:
        yield _smooth_tile(replace(known, values=values), plan, place)


def is_smooth(known: SmoothField | None, plan: KernelPlan, place: tuple[int, int, int, int]) -> bool:
    """Whether all that the pixels of a tile gather from is known to be smooth."""
    if known is None or plan.camera.sensor.window is not None:
        return False
    columns, rows = (far + 0.5 for far in plan.reach_px)
    return known.holds_all((place[0] - rows, place[1] - 1 + rows), (place[2] - columns, place[3] - 1 + columns))


def _smooth_tile(known: SmoothField, plan: KernelPlan, place: tuple[int, int, int, int]) -> Gathered:
    """A tile that gathers from smooth blocks only: the mean of what changes evenly is what is seen in the middle."""
    values, _ = known.in_pixels(place)
    some = np.ix_(*(at - first for at, first in zip(lattice(2 * plan.grid.cell, place), place[::2], strict=True)))
    nothing = CentralImage((0, 0), np.zeros((0, 0)), None, 0)
    unchanged = np.zeros((len(some[0]), some[1].size))
    return Gathered(values, some, unchanged, nothing, nothing)


def grid_share(plan: KernelPlan) -> float:
    """What the cells may be off by, over what twice their size changes."""
    blurs = [max(reach_px(plan.camera, magnification)) for magnification in plan.layers]
    return 1.0 if any(0 < blur < _RESOLVED * plan.grid.cell for blur in blurs) else GRID_SHARE


def smooth_share(plan: KernelPlan) -> float:
    """Of what a certificate counts for the cells, the part that is left in what is measured over many pixels."""
    counted = grid_share(plan)
    return _SMOOTH_SHARE / counted if counted == GRID_SHARE else 1.0


def gather(
    plan: KernelPlan, central: CentralImage, cell: float, place: tuple[int, int, int, int]
) -> NDArray[np.float64]:
    """Correlate the central image, of each source, with the footprint of each pixel of a tile."""
    result = np.empty((*central.values.shape[:-2], place[1] - place[0], place[3] - place[2]))
    step = max(1, round(cell))
    for pixels, values in _by_phase(plan, central, cell, place, np.ndindex(step, step)):
        row, column = pixels
        result[..., row, column] = values
    return result


def gather_all(
    plan: KernelPlan, central: CentralImage, cell: float, place: tuple[int, int, int, int]
) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]:
    """As `gather_some`, for every pixel."""
    values = gather(plan, central, cell, place)
    return np.ix_(*(np.arange(size) for size in values.shape[-2:])), values


def gather_some(
    plan: KernelPlan, central: CentralImage, cell: float, place: tuple[int, int, int, int]
) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]:
    """As `gather`, for the pixels that lie alike in their cells only: where they are in the tile, and their values."""
    return next(_by_phase(plan, central, cell, place, iter([(0, 0)])))


def _by_phase(
    plan: KernelPlan,
    central: CentralImage,
    cell: float,
    place: tuple[int, int, int, int],
    phases: Iterator[tuple[int, ...]],
) -> Iterator[tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]]:
    """Pixels whose corner lies alike in a cell have one footprint; gather them together."""
    if has_small_footprints(plan, cell):
        yield _by_sums(plan, central, cell, place)
        return
    shape = tuple(fast_length(size) for size in central.values.shape[-2:])
    if central.magnification is None:
        spectra = [spectrum_of(central.values, shape)]
    else:
        shares = layer_shares(plan.layers, central.magnification)
        spectra = [spectrum_of(central.values * share, shape) for share in shares]
    for phase in phases:
        prints = (laid_out(footprint(plan.camera, layer, cell, phase), shape) for layer in plan.layers)
        field = correlated(spectra, [np.conj(spectrum_of(one, shape)) for one in prints], shape)
        pixels = lattice(cell, place, phase)
        row, column = (np.floor(at / cell).astype(int) - first for at, first in zip(pixels, central.first, strict=True))
        # The transform leaves rounding errors of 1e-16 of the largest value, of either sign.
        yield (
            np.ix_(pixels[0] - place[0], pixels[1] - place[2]),
            np.maximum(field[..., row[:, np.newaxis], column], 0.0),
        )


def has_small_footprints(plan: KernelPlan, cell: float) -> bool:
    """Whether the footprints of all layers are of few cells: then sums are faster.

    Sums need the compiler, which is there where the view's blocks are smooth, and takes a third of a second to load.
    """
    if not plan.grid.smooth or cell >= 1:
        return False
    most = reach_px(plan.camera, max(map(abs, plan.layers)))
    return math.prod(math.ceil((2 * reach + 1) / cell) + 1 for reach in most) <= _FEW_CELLS


def layers_met(places: NDArray[np.float64] | None) -> range:
    """Numbers of the layers that have light which lies at some places between them: few of a deep scene's in a tile."""
    return range(1) if places is None else range(math.floor(places.min()), math.ceil(places.max()) + 1)


def _by_sums(
    plan: KernelPlan, central: CentralImage, cell: float, place: tuple[int, int, int, int]
) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]:
    """All pixels of a tile, where cells are smaller than pixels and footprints small."""
    from radwrap.imaging.methods.direct_gather import gathered_directly

    pixels = lattice(cell, place)
    values = np.zeros((*central.values.shape[:-2], *(len(at) for at in pixels)))
    row, column = (int(at[0] / cell) - first for at, first in zip(pixels, central.first, strict=True))
    places = None if central.magnification is None else layer_places(plan.layers, central.magnification)
    prints = {number: footprint(plan.camera, plan.layers[number], cell) for number in layers_met(places)}
    gathered_directly(central.values, places, prints, corner=(row, column), step=round(1 / cell), out=values)
    return np.ix_(pixels[0] - place[0], pixels[1] - place[2]), values


def lattice(
    cell: float, place: tuple[int, int, int, int], phase: tuple[int, ...] = (0, 0)
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the sensor in which a tile's pixels lie alike in their cells [px]."""
    step = max(1, round(cell))
    rows, columns = (
        np.arange(begin + (shift - begin) % step, end, step)
        for begin, end, shift in ((*place[:2], phase[0]), (*place[2:], phase[1]))
    )
    return rows, columns


def coarsened(central: CentralImage, like: CentralImage | None = None) -> CentralImage:
    """Cells of twice the size, on a grid whose corner is the same; with the magnifications of another such image."""
    row, column = (first % 2 for first in central.first)
    shape = central.values.shape[-2:]
    rows, columns = ((size - skip) // 2 * 2 for size, skip in zip(shape, (row, column), strict=True))

    def halved(values: NDArray[np.float64]) -> NDArray[np.float64]:
        cut = values[..., row : row + rows, column : column + columns]
        upper, lower = cut[..., ::2, :], cut[..., 1::2, :]
        means: NDArray[np.float64] = (upper[..., ::2] + upper[..., 1::2] + (lower[..., ::2] + lower[..., 1::2])) / 4
        return means

    values = halved(central.values)
    magnification = like.magnification if like else None
    if central.magnification is not None and like is None:
        light = halved(central.values * central.magnification)
        magnification = np.where(values > 0, light / np.where(values > 0, values, 1.0), halved(central.magnification))
    first = ((central.first[0] + row) // 2, (central.first[1] + column) // 2)
    return replace(central, first=first, values=values, magnification=magnification)
