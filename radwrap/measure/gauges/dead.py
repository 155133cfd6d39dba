"""Rows and columns of a sensor that see nothing: constant or dark from end to end, between others that do see.

What the lens shows is blurred, and so no row of it ends from one pixel to the next. A row that is flat, while both rows
beside it are unlike it and like those after them, is the sensor's. It would be an edge of its own to a gauge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.measure.gauges.response import Light, Response, light_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOST: Final = 16  # rows side by side; what is wider is a thing
_MARGIN: Final = 20  # px about the caliper, that are looked at: more than such rows side by side
_FEWEST: Final = 12  # pixels of a row
_FLAT: Final = 0.1  # of the deviation along the rows beside it; a dark row has noise of its own
_LIKE: Final = 0.02  # of what those beside it see, that it may see by chance: a slit's first row sees more
_CHANCE: Final = 3.0  # standard deviations
_ABRUPT: Final = 0.5  # of the step to a row that sees nothing, by which those beside it may differ from the next, rms
# The same of the means of rows along which nothing is to be seen, as beside an edge that is parallel to them.
_ABRUPT_LEVEL: Final = 0.05
_SIGMAS: Final = 10.0  # standard deviations of a pixel, of that step
_LEAST: Final = 0.01  # gray levels of that step; what is less is rounding of the arithmetic


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """An image without its dead rows and columns.

    Attributes
    ----------
    image : GrayImage
        With light carried across them from those beside them, to begin with.
    blind : ndarray of bool, shape (rows, columns)
        Their pixels, which no fit may use.
    warnings : tuple of str
        Which ones they are.
    """

    image: GrayImage
    blind: Flags
    warnings: tuple[str, ...]


def light_that_is_seen(
    image: GrayImage, response: Response | None, centre: tuple[float, float], half: tuple[float, float]
) -> tuple[Light, tuple[str, ...]]:
    """Light of an image, of which dead pixels about a caliper may not be used, and what to warn of.

    Parameters
    ----------
    image, response
        As of `light_of`.
    centre, half : tuple of float
        Of the caliper's box, (u, v) [px].
    """
    sighted = without_dead(image, centre, half)
    light = light_of(sighted.image, response or Response())
    if not sighted.warnings:
        return light, ()
    return replace(light, usable=light.usable & ~sighted.blind), sighted.warnings


def without_dead(image: GrayImage, centre: tuple[float, float], half: tuple[float, float]) -> Sighted:
    """Look for dead rows and columns in a box of half sides [px] about a centre (u, v)."""
    (left, right), (top, bottom) = (_reach(*ends) for ends in zip(centre, half, image.values.shape[::-1], strict=True))
    box = image.values[top:bottom, left:right]
    groups = [("row", top + begin, top + end) for begin, end in dead_rows(box)]
    groups += [("column", left + begin, left + end) for begin, end in dead_rows(box.T)]
    blind = np.zeros(image.values.shape, dtype=np.bool_)
    if not groups:
        return Sighted(image, blind, ())
    bridged = image.values.copy()
    warnings = []
    for name, begin, end in groups:
        is_row = name == "row"
        across = (slice(begin, end), slice(left, right)) if is_row else (slice(top, bottom), slice(begin, end))
        blind[across] = True
        _bridge(bridged[:, left:right] if is_row else bridged[top:bottom].T, begin, end)
        which = f"{name} {begin} is" if end - begin == 1 else f"{name}s {begin} to {end - 1} are"
        warnings.append(f"{which} constant or dark across the caliper, as no lens shows it: dead pixels are left out")
    return Sighted(GrayImage(bridged, image.bit_depth), blind, tuple(warnings))


def _reach(middle: float, half: float, size: int) -> tuple[int, int]:
    first = min(max(0, math.floor(middle - half) - _MARGIN), size)
    return first, min(max(first, math.ceil(middle + half) + 1 + _MARGIN), size)


def _bridge(part: Array, begin: int, end: int) -> None:
    """Write over rows, straight from the last one that sees to the next; in whole gray levels, as others are."""
    share = (np.arange(begin, end) - begin + 1) / (end - begin + 1)
    between = part[begin - 1] + share[:, None] * (part[end] - part[begin - 1])
    part[begin:end] = np.rint(between) if (part == np.rint(part)).all() else between


def dead_rows(box: Array) -> list[tuple[int, int]]:
    """First row of each group of dead ones, and the one after the last.

    Parameters
    ----------
    box : ndarray, shape (rows, columns)
        Gray levels, with rows that see above and below.
    """
    if len(box) < 5 or box.shape[1] < _FEWEST:
        return []
    flat = _perhaps(box)
    found = []
    row = 2
    while row < len(box) - 2:
        ends = [end for end in range(row + 1, min(row + MOST, len(box) - 2) + 1) if flat[row:end].all()]
        # The longest group that is abrupt on both sides.
        end = next((end for end in reversed(ends) if _stands_out(box, row, end)), None)
        if end is not None:
            found.append((row, end))
        row = row + 1 if end is None else end
    return found


def _perhaps(box: Array) -> Flags:
    """Rows that are flatter than most are, or darker."""
    deviation = box.std(axis=1)
    level = box.mean(axis=1)
    dark = level < np.median(level) - _SIGMAS * np.median(_noise(box))
    return np.asarray((deviation < _FLAT * np.median(deviation)) | (np.ptp(box, axis=1) == 0) | dark)


def _noise(rows: Array) -> Array:
    """Standard deviation of the noise along rows, by differences of differences."""
    bends = np.abs(rows[..., 2:] - 2 * rows[..., 1:-1] + rows[..., :-2])
    return np.asarray(1.4826 * np.median(bends, axis=-1) / math.sqrt(6))


def _stands_out(box: Array, begin: int, end: int) -> bool:
    """Whether rows see nothing, and both beside them go on as if nothing were there."""
    dead, beside = box[begin:end], box[[begin - 1, end]]
    ends, after = box[[begin, end - 1]], box[[begin - 2, end + 1]]
    seen = float(beside.std(axis=1).max())
    step, goes_on = (np.sqrt(np.mean((beside - other) ** 2, axis=1)) for other in (ends, after))
    if (goes_on > _ABRUPT * step).any() or step.min() < _LEAST:
        return False
    if np.ptp(dead, axis=1).max() == 0:
        return seen > _LEAST
    if dead.std(axis=1).max() < _FLAT * seen and _sees_nothing(dead, beside.mean(axis=0)):
        return True
    level, levels = dead.mean(axis=1), beside.mean(axis=1)
    fall = levels - level[[0, -1]]
    noise = max(float(_noise(beside).max()), float(dead.std(axis=1).max()))
    return bool(
        (np.abs(levels - after.mean(axis=1)) < _ABRUPT_LEVEL * fall).all()
        and fall.min() > _SIGMAS * noise
        and level.max() <= np.delete(box, np.s_[begin:end], axis=0).mean(axis=1).min()
    )


def _sees_nothing(dead: Array, beside: Array) -> bool:
    """Whether no row has more than chance of what is seen beside it."""
    off = beside - beside.mean()
    power = float(off @ off)
    share = dead @ off / power
    return bool((np.abs(share) < _LIKE + _CHANCE * dead.std(axis=1) / math.sqrt(power)).all())
