"""What is where on calibration and resolution targets: dark marks on a plate, and the points that are looked for.

A plate lies in its own xy plane about its middle, x to the right and y up as it is looked at; rows count from the top,
columns from the left. All lengths in metres. Everything else about a target comes from here: what tracers see, what
truth says, and what is printed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final

from radwrap.scene.patterns.marks import FlatDisc, FlatPolygon, Mark, Place, rectangle

Bits = tuple[tuple[int, ...], ...]

_USAF_GAP: Final = 2.0  # between sets of bars, in widths of the larger bars
_USAF_BARS: Final = 3
_USAF_LENGTH: Final = 5.0  # of a bar, in its widths (key mil_std_150a)
USAF_ELEMENTS: Final = 6  # of a group


@dataclass(frozen=True, slots=True)
class Chessboard:
    """Squares in turn light and dark; the one at the top left is dark.

    Attributes
    ----------
    rows, columns : int
        Squares along -y and x.
    square_size : float
        Side of a square [m].
    margin : float
        From the outermost squares to the plate's edge [m].
    """

    rows: int
    columns: int
    square_size: float
    margin: float

    @property
    def size(self) -> tuple[float, float]:
        """Of the plate along x and y [m]."""
        return _grid_size(self.rows, self.columns, self.square_size, self.margin)

    def marks(self) -> Iterator[Mark]:
        """The dark squares."""
        for row in range(self.rows):
            for column in range(row % 2, self.columns, 2):
                yield _square(self, row, column)

    def corners(self) -> tuple[tuple[int, int, Place], ...]:
        """(row, column, place [m]) of each point where four squares meet; row by row, as OpenCV orders them."""
        return _inner_corners(self)


@dataclass(frozen=True, slots=True)
class Charuco:
    """A chessboard whose light squares hold ArUco markers, laid out as OpenCV's CharucoBoard (not its legacy pattern).

    Attributes
    ----------
    rows, columns : int
        Squares along -y and x.
    square_size, marker_size : float
        Sides of a square and of a marker with its dark border [m].
    margin : float
        From the outermost squares to the plate's edge [m].
    dictionary : str
        Name of the markers' dictionary in OpenCV.
    first_marker : int
        Number in the dictionary of the marker at the top left; the others follow row by row.
    bits : tuple
        Of each marker rows of 0 (dark) and 1 (light), from its top left, without the border.
    """

    rows: int
    columns: int
    square_size: float
    marker_size: float
    margin: float
    dictionary: str
    first_marker: int
    bits: tuple[Bits, ...]

    @property
    def size(self) -> tuple[float, float]:
        """Of the plate along x and y [m]."""
        return _grid_size(self.rows, self.columns, self.square_size, self.margin)

    def marks(self) -> Iterator[Mark]:
        """The dark squares, and the dark cells of markers, those side by side as one rectangle."""
        numbers = iter(range(len(self.bits)))
        for row in range(self.rows):
            for column in range(self.columns):
                if (row + column) % 2 == 0:
                    yield _square(self, row, column)
                else:
                    yield from self._marker(row, column, self.bits[next(numbers)])

    def _marker(self, row: int, column: int, bits: Bits) -> Iterator[Mark]:
        cells = len(bits) + 2
        dark = (0,) * cells
        bordered = (dark, *((0, *line, 0) for line in bits), dark)
        inset = (self.square_size - self.marker_size) / 2
        x0, y0 = _corner_place(self, row, column)
        xs = [x0 + inset + self.marker_size * cell / cells for cell in range(cells + 1)]
        ys = [y0 - inset - self.marker_size * cell / cells for cell in range(cells + 1)]
        for top, left, bottom, right in _merged(bordered):
            yield rectangle(xs[left], ys[bottom], xs[right], ys[top])

    def corners(self) -> tuple[tuple[int, int, Place], ...]:
        """(row, column, place [m]) of each point where four squares meet; their order is that of OpenCV's ids."""
        return _inner_corners(self)


@dataclass(frozen=True, slots=True)
class CircleGrid:
    """Discs on a grid.

    Attributes
    ----------
    rows, columns : int
        Of discs along -y, and discs in each row along x.
    pitch : float
        Between rows, and between columns of a symmetric grid [m]. In an asymmetric grid discs of a row are two
        pitches apart, and every other row stands one to the right, as OpenCV has it.
    dot_diameter : float
        Of each disc [m].
    margin : float
        From the outermost discs' rims to the plate's edge [m].
    asymmetric : bool
        Which of the two grids it is.
    """

    rows: int
    columns: int
    pitch: float
    dot_diameter: float
    margin: float
    asymmetric: bool

    @property
    def _extent(self) -> tuple[float, float]:
        steps = 2 * (self.columns - 1) + min(self.rows - 1, 1) if self.asymmetric else self.columns - 1
        return steps * self.pitch, (self.rows - 1) * self.pitch

    @property
    def size(self) -> tuple[float, float]:
        """Of the plate along x and y [m]."""
        width, height = self._extent
        around = self.dot_diameter + 2 * self.margin
        return width + around, height + around

    def marks(self) -> Iterator[Mark]:
        """The discs."""
        for _, _, (x, y) in self.centres():
            yield FlatDisc(x, y, self.dot_diameter / 2)

    def centres(self) -> tuple[tuple[int, int, Place], ...]:
        """(row, column, centre [m]), row by row, as OpenCV orders them."""
        width, height = self._extent

        def centre(row: int, column: int) -> Place:
            steps = 2 * column + row % 2 if self.asymmetric else column
            return steps * self.pitch - width / 2, height / 2 - row * self.pitch

        return tuple((row, column, centre(row, column)) for row in range(self.rows) for column in range(self.columns))


@dataclass(frozen=True, slots=True)
class SiemensStar:
    """Dark spokes about the middle, as wide as the light ones between them.

    Spokes end on chords, so the outline is a polygon whose corners lie on the circle.

    Attributes
    ----------
    spokes : int
        How many dark ones.
    diameter, inner_diameter : float
        Of the circles through the spokes' outer and inner corners [m]; 0 inside for spokes that meet.
    margin : float
        From the circle to the plate's edge [m].
    """

    spokes: int
    diameter: float
    inner_diameter: float
    margin: float

    @property
    def size(self) -> tuple[float, float]:
        """Of the plate along x and y [m]."""
        side = self.diameter + 2 * self.margin
        return side, side

    def marks(self) -> Iterator[Mark]:
        """The dark spokes; the first one begins at the right and goes to the left, counter-clockwise."""
        for spoke in range(self.spokes):
            turns = [math.pi * (2 * spoke + side) / self.spokes for side in (0, 1)]
            outer = [_polar(self.diameter / 2, turn) for turn in turns]
            inner = [_polar(self.inner_diameter / 2, turn) for turn in turns[::-1]] if self.inner_diameter else [(0, 0)]
            yield FlatPolygon((*outer, *inner))


@dataclass(frozen=True, slots=True)
class UsafElement:
    """One element: three bars in each of two directions, each as wide as the gaps between them.

    Attributes
    ----------
    group, element : int
        As the standard numbers them.
    bar_width : float
        [m]; a pair of lines is twice as wide.
    upright, level : tuple of float
        Middle of the bars along y, and of those along x [m].
    """

    group: int
    element: int
    bar_width: float
    upright: Place
    level: Place


@dataclass(frozen=True, slots=True)
class Usaf1951:
    """Elements of the sizes of MIL-STD-150A, a column for each group from its first element down; without figures.

    Attributes
    ----------
    first_group, last_group : int
        The coarsest group, on the left, and the finest one.
    margin : float
        From the bars to the plate's edge [m].
    """

    first_group: int
    last_group: int
    margin: float

    @property
    def size(self) -> tuple[float, float]:
        """Of the plate along x and y [m]."""
        return self._placed()[1]

    def elements(self) -> tuple[UsafElement, ...]:
        """All elements, group by group."""
        return self._placed()[0]

    def _placed(self) -> tuple[tuple[UsafElement, ...], tuple[float, float]]:
        side = partial(_usaf_width, self.first_group)
        height = sum((_USAF_LENGTH + _USAF_GAP) * side(e) for e in range(1, USAF_ELEMENTS + 1))
        height -= _USAF_GAP * side(USAF_ELEMENTS)
        columns = [_usaf_width(group, 1) for group in range(self.first_group, self.last_group + 1)]
        set_width = 2 * _USAF_LENGTH + _USAF_GAP
        width = sum((set_width + _USAF_GAP) * bar for bar in columns) - _USAF_GAP * columns[-1]
        found = []
        left = -width / 2
        for group in range(self.first_group, self.last_group + 1):
            top = height / 2
            for element in range(1, USAF_ELEMENTS + 1):
                bar = _usaf_width(group, element)
                half = _USAF_LENGTH * bar / 2
                upright = (left + half, top - half)
                level = (left + half + (_USAF_LENGTH + _USAF_GAP) * bar, top - half)
                found.append(UsafElement(group, element, bar, upright, level))
                top -= (_USAF_LENGTH + _USAF_GAP) * bar
            left += (set_width + _USAF_GAP) * _usaf_width(group, 1)
        return tuple(found), (width + 2 * self.margin, height + 2 * self.margin)

    def marks(self) -> Iterator[Mark]:
        """All bars."""
        for element in self.elements():
            bar, half = element.bar_width, _USAF_LENGTH * element.bar_width / 2
            for number in range(_USAF_BARS):
                near, far = -half + 2 * number * bar, -half + (2 * number + 1) * bar
                x, y = element.upright
                yield rectangle(x + near, y - half, x + far, y + half)
                x, y = element.level
                yield rectangle(x - half, y + near, x + half, y + far)


Layout = Chessboard | Charuco | CircleGrid | SiemensStar | Usaf1951


def markers_of(rows: int, columns: int) -> int:
    """How many markers a ChArUco board of so many squares has."""
    return rows * columns // 2


def _usaf_width(group: int, element: int) -> float:
    """Width of a bar [m]: 2^(group + (element - 1)/6) pairs of lines in a millimetre (key mil_std_150a)."""
    pairs: float = 2.0 ** (group + (element - 1) / USAF_ELEMENTS)
    return 1e-3 / (2 * pairs)


def _polar(radius: float, turn: float) -> Place:
    return radius * math.cos(turn), radius * math.sin(turn)


def _grid_size(rows: int, columns: int, square: float, margin: float) -> tuple[float, float]:
    return columns * square + 2 * margin, rows * square + 2 * margin


def _corner_place(board: Chessboard | Charuco, row: int, column: int) -> Place:
    """Top left corner of a square."""
    return (column - board.columns / 2) * board.square_size, (board.rows / 2 - row) * board.square_size


def _square(board: Chessboard | Charuco, row: int, column: int) -> FlatPolygon:
    left, top = _corner_place(board, row, column)
    right, bottom = _corner_place(board, row + 1, column + 1)
    return rectangle(left, bottom, right, top)


def _inner_corners(board: Chessboard | Charuco) -> tuple[tuple[int, int, Place], ...]:
    return tuple(
        (row, column, _corner_place(board, row + 1, column + 1))
        for row in range(board.rows - 1)
        for column in range(board.columns - 1)
    )


def _merged(cells: Bits) -> Iterator[tuple[int, int, int, int]]:
    """Rectangles that cover the dark cells (0), each once: top, left, bottom, right; widest first, then down."""
    left_over = {(row, column) for row, line in enumerate(cells) for column, bit in enumerate(line) if not bit}
    while left_over:
        top, left = min(left_over)
        right = left
        while (top, right) in left_over:
            right += 1
        bottom = top + 1
        while all((bottom, column) in left_over for column in range(left, right)):
            bottom += 1
        left_over -= {(row, column) for row in range(top, bottom) for column in range(left, right)}
        yield top, left, bottom, right
