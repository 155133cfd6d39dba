"""A target laid out on sheets of paper, at its true size: what `print_files` writes.

Lengths in metres; a page's origin is its lower left corner, x to the right, y up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from radwrap.errors import InputError
from radwrap.scene.patterns.layouts import Layout
from radwrap.scene.patterns.marks import FlatDisc, FlatPolygon, Mark, Place, rectangle

Paper = Literal["a4", "letter"]
PAPERS: Final[dict[Paper, tuple[float, float]]] = {"a4": (0.210, 0.297), "letter": (0.2159, 0.2794)}
BAR: Final = 0.100  # what a ruler must show
BAR_WIDTH: Final = 0.001
TEXT: Final = 0.003  # height of letters
_BORDER: Final = 0.010  # what a printer may leave white
_STRIP: Final = 0.012  # for the bar and a line of text, at the bottom
_MOST_SHEETS: Final = 400
_CROP: Final = 0.005  # length of the marks at which sheets are cut


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of a page."""

    left: float
    bottom: float
    right: float
    top: float


@dataclass(frozen=True, slots=True)
class Page:
    """One sheet.

    Attributes
    ----------
    name : str
        "" of a single sheet, else such as "row1_column2".
    size : tuple of float
        Width and height.
    window : Window
        Where the plate may be printed.
    marks : tuple of Mark
        Dark parts of the plate, those that reach into the window; they are cut at its border.
    guides : tuple of FlatPolygon
        The bar of 100 mm, and thin lines along which the sheet is cut.
    text : str
        A line beside the bar.
    text_place : tuple of float
        Where it begins.
    """

    name: str
    size: tuple[float, float]
    window: Window
    marks: tuple[Mark, ...]
    guides: tuple[FlatPolygon, ...]
    text: str
    text_place: Place


def pages(name: str, layout: Layout, paper: Paper) -> tuple[Page, ...]:
    """Sheets that show a plate at its true size, row by row from its top left.

    A plate that fits on one sheet, upright or turned, stands in its middle; larger ones are cut into tiles that meet
    edge to edge, on as few sheets as possible.

    Raises
    ------
    InputError
        If it takes more sheets than anybody glues together.
    """
    width, height = layout.size
    upright = PAPERS[paper]
    (columns, rows), size = min(
        ((_tiles(layout.size, size), size) for size in (upright, upright[::-1])), key=lambda found: math.prod(found[0])
    )
    if rows * columns > _MOST_SHEETS:
        raise InputError(
            f'"{name}" is {width:.4g} x {height:.4g} m and takes {rows * columns} sheets, more than {_MOST_SHEETS}',
            where="the target's size",
            remedy="check its units",
        )
    area = _printable(size)
    marks = tuple(layout.marks())
    found = []
    for row in range(rows):
        for column in range(columns):
            # The tile's part of the plate, whose tiles are alike and as large as what they show.
            left, right = (width * (step / columns - 0.5) for step in (column, column + 1))
            bottom, top = (height * (0.5 - step / rows) for step in (row + 1, row))
            x = (area.left + area.right) / 2 - (left + right) / 2
            y = (area.bottom + area.top) / 2 - (bottom + top) / 2
            window = Window(left + x, bottom + y, right + x, top + y)
            shown = tuple(moved for mark in marks if _meets(moved := _moved(mark, x, y), window))
            single = rows * columns == 1
            told = f"{name}: {width * 1e3:.6g} x {height * 1e3:.6g} mm. Print at 100 %: the bar is 100 mm long."
            if not single:
                told += f" Row {row + 1} of {rows}, column {column + 1} of {columns}."
            guides = (rectangle(_BORDER, _BORDER, _BORDER + BAR, _BORDER + BAR_WIDTH), *_crop_marks(window))
            place = (_BORDER, _BORDER + BAR_WIDTH + TEXT / 2)
            part = "" if single else f"row{row + 1}_column{column + 1}"
            found.append(Page(part, size, window, shown, guides, told, place))
    return tuple(found)


def _printable(size: tuple[float, float]) -> Window:
    return Window(_BORDER, _BORDER + _STRIP, size[0] - _BORDER, size[1] - _BORDER)


def _tiles(plate: tuple[float, float], size: tuple[float, float]) -> tuple[int, int]:
    """How many columns and rows of sheets of a size a plate takes."""
    area = _printable(size)
    # Crop marks of tiles stand outside of them.
    free = (area.right - area.left, area.top - area.bottom)
    if plate[0] <= free[0] and plate[1] <= free[1]:
        return 1, 1
    across, up = (math.ceil(side / (room - 2 * _CROP)) for side, room in zip(plate, free, strict=True))
    return across, up


def _crop_marks(window: Window) -> Iterator[FlatPolygon]:
    """Lines beside the corners, their inner edges where the plate ends."""
    thin = 1e-4
    for x, outwards in ((window.left, -1), (window.right, 1)):
        for y, upwards in ((window.bottom, -1), (window.top, 1)):
            yield _box(x, y, outwards * thin, upwards * _CROP)
            yield _box(x, y, outwards * _CROP, upwards * thin)


def _box(x: float, y: float, dx: float, dy: float) -> FlatPolygon:
    return rectangle(min(x, x + dx), min(y, y + dy), max(x, x + dx), max(y, y + dy))


def _moved(mark: Mark, x: float, y: float) -> Mark:
    if isinstance(mark, FlatDisc):
        return FlatDisc(mark.x + x, mark.y + y, mark.radius)
    return FlatPolygon(tuple((a + x, b + y) for a, b in mark.vertices))


def _meets(mark: Mark, window: Window) -> bool:
    if isinstance(mark, FlatDisc):
        across = (mark.x - mark.radius, mark.x + mark.radius)
        up = (mark.y - mark.radius, mark.y + mark.radius)
    else:
        xs, ys = zip(*mark.vertices, strict=True)
        across, up = (min(xs), max(xs)), (min(ys), max(ys))
    return across[1] > window.left and across[0] < window.right and up[1] > window.bottom and up[0] < window.top
