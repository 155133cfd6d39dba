"""What waves add to each pixel of a tile by the light of the central image, gathered by their footprints.

Light comes by its depths, see `wave_light`: what is transformed is gathered at
the pixels only, where cells are smaller than these; few cells go one by one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.central import CentralImage
from radwrap.imaging.methods.kernel import lattice
from radwrap.imaging.methods.transforms import Room, correlated, fast_length, spectrum_of
from radwrap.imaging.optics.lens_field import MIXED_SHARE, Place
from radwrap.imaging.tolerance.wave_behind import Laid
from radwrap.imaging.tolerance.wave_light import FewCells, Parted, Sheet, by_layers, parted
from radwrap.imaging.tolerance.wave_plan import WavePlan
from radwrap.kept import Kept, of_kept

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rect = tuple[int, int, int, int]
Part = tuple[slice, slice]  # rows and columns

_MOST_KEPT: Final = 1 << 27  # byte of transforms
# Numbers of a transform, over such of single cells, that take as long.
_OF_TRANSFORM: Final = 10


def kept_transforms() -> Kept:
    """Room for the transforms of what waves do to the light of each layer.

    Tiles of one size share them, all replicates do, sources of one wavelength, and light that is laid out in two ways.
    """
    return Kept(_MOST_KEPT)


def gathered(
    plan: WavePlan,
    central: CentralImage,
    laid: Laid,
    cell: float,
    place: Rect,
    *,
    transforms: Kept,
    room: Room,
) -> tuple[Array, Array]:
    """What waves add to each pixel of a tile, by the light of each layer; and how far a mixture of places is off."""
    weights = plan.weights
    found, of_coarser = np.zeros((2, place[1] - place[0], place[3] - place[2]))
    phases = [(row, column) for row, column in np.ndindex(max(1, round(cell)), max(1, round(cell)))]
    step = max(1, round(1 / cell))  # cells from one pixel to the next
    light = _parted(plan, laid, cell, room)
    sheets, once = light.sheets, len(phases) == len(weights.lens_field.places) == 1

    def transformed(
        what: tuple[float, tuple[int, int], tuple[int, int], Place, float, tuple[int, int]],
    ) -> Complex:
        return of_kept(
            transforms, lambda: (id(weights), *what), lambda: weights.laid_out(*what), lambda one: one.nbytes
        )

    rows, columns = central.values.shape[-2:]
    whole = (slice(0, rows), slice(0, columns))
    spectra: Iterable[Complex] = ()
    part = (slice(0, 0), slice(0, 0))
    for of_field, share, coarser in weights.lens_field.shares(place) if sheets else ():
        reach = np.max([weights.near(cell, phase, of_field)[0].shape for phase in phases], axis=0) // 2
        cells = _around(share + coarser, central, cell, place, reach)
        # Light has to be transformed anew for a part of it.
        if (len(sheets) + 1) * _number(cells) >= _number(whole):
            cells = whole
        size = cells[0].stop - cells[0].start, cells[1].stop - cells[1].start
        shape = step * fast_length(-(-size[0] // step)), step * fast_length(-(-size[1] // step))
        if cells != part:
            # What is gathered once only is transformed one by one.
            rooms = room.arrays(min(len(sheets), 2 if once else len(sheets)), (shape[0], shape[1] // 2 + 1))
            at_once = (
                _spectrum(one, cells, shape, rooms[min(number, len(rooms) - 1)]) for number, one in enumerate(sheets)
            )
            spectra, part = at_once if once else list(at_once), cells
        for phase in phases:
            pixels = lattice(cell, place, phase)
            row, column = (
                np.floor(at / cell).astype(int) - first - one.start
                for at, first, one in zip(pixels, central.first, cells, strict=True)
            )
            inside = (row >= 0) & (row < size[0]), (column >= 0) & (column < size[1])
            row, column = row[inside[0]], column[inside[1]]
            if not (row.size and column.size):
                continue
            shift = int(row[0]) % step, int(column[0]) % step
            each = (transformed((cell, shape, phase, of_field, one.place, shift)) for one in sheets)
            field = correlated(spectra, each, shape, step, spent=once)
            at = _crossing(
                *(one[some] - begin for one, some, begin in zip(pixels, inside, (place[0], place[2]), strict=True))
            )
            values = field[_crossing(row // step, column // step)]
            found[at] += share[at] * values
            of_coarser[at] += coarser[at] * values
    if light.few is not None:
        (of_field,) = weights.lens_field.places
        _add_few(plan, central, light.few, cell, place, transforms=transforms, out=found)
        of_coarser = found
    return found, MIXED_SHARE * np.abs(found - of_coarser)


def _parted(plan: WavePlan, laid: Laid, cell: float, room: Room) -> Parted:
    """Light in as few images as are to be transformed, where the compiler is at hand: as smooth blocks need it."""
    if plan.smooth is None or cell > 1 or len(plan.weights.lens_field.places) > 1:
        return by_layers(laid)
    reach = math.prod(2 * far + 1 for far in plan.kernel.reach_px)  # pixels
    return parted(laid, len(plan.kernel.layers), round(_OF_TRANSFORM * laid[0][0].size / reach), room)


def _spectrum(sheet: Sheet, cells: Part, shape: tuple[int, int], out: Complex) -> Complex:
    low, high = max(sheet.lit[0], cells[0].start), min(sheet.lit[1], cells[0].stop)
    low = min(low, high)
    return spectrum_of(sheet.values[low:high, cells[1]], shape, max(low - cells[0].start, 0), out)


def _add_few(
    plan: WavePlan, central: CentralImage, few: FewCells, cell: float, place: Rect, *, transforms: Kept, out: Array
) -> None:
    """Add what waves add to a tile by the light of few cells."""
    from radwrap.imaging.tolerance.sorted_light import added_one_by_one, in_phases

    weights, step = plan.weights, round(1 / cell)
    (of_field,) = weights.lens_field.places
    near = weights.near(cell, (0, 0), of_field)

    def in_all_phases() -> Array:
        return np.stack([in_phases(one, step) for one in near])

    each = of_kept(transforms, lambda: (id(weights), cell), in_all_phases, lambda one: one.nbytes)
    origin = tuple(
        round(begin / cell) - first - size // 2
        for begin, first, size in zip((place[0], place[2]), central.first, near[0].shape, strict=True)
    )
    added_one_by_one(few.rows, few.columns, few.layers, few.light, each, (origin[0], origin[1]), step, out)


def _crossing(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> tuple[Any, ...]:
    """Index of where rows and columns cross; slices where both lie evenly, as these need no copy of an image."""
    down, across = _evenly(rows), _evenly(columns)
    return np.ix_(rows, columns) if down is None or across is None else (down, across)


def _evenly(numbers: NDArray[np.intp]) -> slice | None:
    """The slice of numbers that ascend by equal steps, if they do."""
    if len(numbers) < 2:
        return None
    first, step = int(numbers[0]), int(numbers[1] - numbers[0])
    stop = first + step * len(numbers)
    even = step > 0 and np.array_equal(numbers, np.arange(first, stop, step))
    return slice(first, stop, step) if even else None


def _number(cells: Part) -> int:
    return math.prod(int(one.stop - one.start) for one in cells)


def _around(counts: Array, central: CentralImage, cell: float, place: Rect, reach: NDArray[np.intp]) -> Part:
    """Cells of a tile that pixels which count gather from."""
    found = []
    for axis, begin in enumerate((place[0], place[2])):
        used = np.flatnonzero(counts.any(axis=1 - axis)) + begin
        low, high = (math.floor(pixel / cell) - central.first[axis] for pixel in (used[0], used[-1]))
        least, most = max(0, low - int(reach[axis])), min(central.values.shape[axis - 2], high + int(reach[axis]) + 1)
        found.append(slice(least, most))
    return found[0], found[1]
