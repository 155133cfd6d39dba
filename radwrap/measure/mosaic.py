"""One colour of the raw image of a colour camera, on the grid of its pixels.

A pixel of the colour keeps its gray level; any other one gets the mean of the nearest pixels of the colour, weighted as
a straight line between them has it. That is even to all sides, so that what is measured lies where it lies in the raw
image, and its positions are those of raw pixels. It is not as sharp: an edge gets wider by about a pixel, and noise of
neighbours hangs together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage

Pattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
Colour = Literal["red", "green", "blue"]
PATTERNS: Final[tuple[Pattern, ...]] = get_args(Pattern)
COLOURS: Final[tuple[Colour, ...]] = get_args(Colour)
USUAL_COLOUR: Final[Colour] = "green"  # half of the pixels, where nobody says which
# A straight line between neighbours: 1 at the pixel, 1/2 beside it, 1/4 across the corner.
_WEIGHTS: Final = (0.5, 1.0, 0.5)
_FEWEST: Final = 2  # rows and columns


@dataclass(frozen=True, slots=True)
class RawChannel:
    """A colour of raw images, and the mosaic that says which pixels have its filter."""

    pattern: Pattern
    colour: Colour


def colour_image(image: GrayImage, pattern: Pattern, colour: Colour) -> GrayImage:
    """The image as if all pixels had the filter of one colour; whole gray levels stay whole.

    Parameters
    ----------
    image : GrayImage
        Raw image.
    pattern : str
        Colours of the first two pixels of its first row, then of its second row.
    colour : str
        "red", "green" or "blue".

    Raises
    ------
    InputError
        If the image is too small to have all colours.
    """
    if min(image.values.shape) < _FEWEST:
        raise InputError("is too small for a mosaic of colours: needs two rows and two columns")
    values = colour_levels(image.values, RawChannel(pattern, colour))
    if bool((image.values == np.rint(image.values)).all()):
        np.rint(values, out=values)  # as software does, and as whoever measures expects: gray levels stay whole
    return GrayImage(values, image.bit_depth, {**image.provenance, "colour": colour})


def colour_levels(values: NDArray[np.float64], channel: RawChannel) -> NDArray[np.float64]:
    """The same of levels that need not be whole, shape (rows, columns); two rows and two columns at least."""
    own = _own(values.shape, channel.pattern, channel.colour)
    known = own.astype(np.float64)
    between: NDArray[np.float64] = _summed(values * known) / _summed(known)
    return np.where(own, values, between)


def _own(shape: tuple[int, ...], pattern: Pattern, colour: Colour) -> NDArray[np.bool_]:
    """Which pixels have the colour's filter."""
    own = np.zeros(shape, dtype=bool)
    for place, letter in enumerate(pattern):
        if letter == colour[0].upper():
            own[place // 2 :: 2, place % 2 :: 2] = True
    return own


def _summed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted sum over each pixel and its eight neighbours; nothing lies beyond the border."""
    for axis in (0, 1):
        before, _, after = _WEIGHTS
        summed = values.copy()
        first = [slice(None)] * 2
        last = [slice(None)] * 2
        first[axis], last[axis] = slice(1, None), slice(None, -1)
        summed[tuple(first)] += before * values[tuple(last)]
        summed[tuple(last)] += after * values[tuple(first)]
        values = summed
    return values
