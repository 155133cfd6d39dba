"""The mosaic of a colour camera: which colour filter lies on which pixel, and what each filter lets through.

The pixels of one filter are those of a monochrome camera behind it: a raw image is three monochrome images of which
each pixel is taken from one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Colour = Literal["red", "green", "blue"]
Pattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
# Wavelength [m] and quantum efficiency, or relative response.
Filter = tuple[tuple[float, float], ...]

COLOURS: Final[tuple[Colour, ...]] = get_args(Colour)
_LETTERS: Final[dict[str, Colour]] = {"R": "red", "G": "green", "B": "blue"}
_CELL: Final = 2  # pixels a side of the pattern's cell


@dataclass(frozen=True, slots=True)
class Mosaic:
    """Colour filters on the pixels of a sensor.

    Attributes
    ----------
    pattern : str
        Colours of the first two pixels of the first row, then of the second row; the cell repeats.
    red, green, blue : tuple of tuple of float
        Filters: wavelength [m] and quantum efficiency (of the power law: relative response) at the nodes.
    relative : tuple of float, optional
        Of a linear sensor: quantum efficiencies of red, green and blue at the sensor's wavelength, over the largest
        of them, which the sensor's own levels hold for.
    """

    pattern: Pattern
    red: Filter
    green: Filter
    blue: Filter
    relative: tuple[float, float, float] | None = None

    def places(self, colour: Colour) -> tuple[tuple[slice, slice], ...]:
        """Where the pixels of a colour are: slices of rows and columns."""
        return places_of(self.pattern, colour)

    def moved(self, left: int, top: int) -> Mosaic:
        """The same filters on a part of the sensor that begins at another column and row."""
        letters = "".join(
            self.pattern[_CELL * ((row + top) % _CELL) + (column + left) % _CELL]
            for row in range(_CELL)
            for column in range(_CELL)
        )
        return replace(self, pattern=next(known for known in get_args(Pattern) if known == letters))


def places_of(pattern: Pattern, colour: Colour) -> tuple[tuple[slice, slice], ...]:
    """Where the pixels of a colour are: slices of rows and columns."""
    return tuple(
        (slice(i // _CELL, None, _CELL), slice(i % _CELL, None, _CELL))
        for i, letter in enumerate(pattern)
        if _LETTERS[letter] == colour
    )


def pixels_of(pattern: Pattern, colour: Colour, shape: tuple[int, ...]) -> int:
    """How many pixels of an image of so many rows and columns have the filter of a colour."""
    rows, columns = shape
    places = places_of(pattern, colour)
    return sum(len(range(rows)[down]) * len(range(columns)[right]) for down, right in places)


def composed(pattern: Pattern, planes: Mapping[Colour, NDArray[np.float64]]) -> NDArray[np.float64]:
    """An image each of whose pixels is that of its own colour, shape (rows, columns)."""
    made = np.empty_like(planes["green"])
    for colour in COLOURS:
        for place in places_of(pattern, colour):
            made[place] = planes[colour][place]
    return made
