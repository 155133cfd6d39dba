"""Masks as COCO's polygons: along the borders of pixels, without holes, as polygons cannot have any.

A piece with a hole is cut along a row through it. Corners are whole numbers: (0, 0) is the upper left corner of the
first pixel, as COCO counts. The polygons of a mask hold the centres of its pixels and of no others.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
_Corner = tuple[int, int]  # row, column


def polygons(mask: Mask) -> list[list[int]]:
    """Outlines of a mask, each as COCO has them: x, y, x, y, ... [px].

    Parameters
    ----------
    mask : ndarray of bool, shape (rows, columns)
        Pixels that belong to it.

    Examples
    --------
    >>> import numpy as np
    >>> polygons(np.array([[False, True, True], [False, True, False]]))
    [[1, 0, 3, 0, 3, 1, 2, 1, 2, 2, 1, 2]]
    """
    found = []
    for piece, row, column in _pieces(mask, 0, 0):
        outline = _outline(piece)
        found.append([value for r, c in outline for value in (c + column, r + row)])
    return found


def _pieces(mask: Mask, row: int, column: int) -> Iterator[tuple[Mask, int, int]]:
    """Parts of a mask whose pixels hang together by their sides and that have no hole, with their first row, column."""
    from scipy import ndimage

    labels, _ = ndimage.label(mask)
    for number, (rows, columns) in enumerate(ndimage.find_objects(labels), 1):
        piece = labels[rows, columns] == number
        around, _ = ndimage.label(np.pad(~piece, 1, constant_values=True), np.ones((3, 3)))
        holes = ndimage.find_objects(around * (around != around[0, 0]))
        hole = next((one for one in holes if one is not None), None)
        first, left = row + rows.start, column + columns.start
        if hole is None:
            yield piece, first, left
            continue
        cut = (hole[0].start + hole[0].stop) // 2 - 1  # of the padded rows: the hole opens to one side at least
        yield from _pieces(piece[:cut], first, left)
        yield from _pieces(piece[cut:], first + cut, left)


def _outline(piece: Mask) -> list[_Corner]:
    """Corners of the border of a piece, its pixels to the right of each step; those on a straight line are left out."""
    padded = np.pad(piece, 1)
    steps: dict[_Corner, list[_Corner]] = {}
    # A side of a pixel beyond which there is none: from which corner of it, and in which direction, one walks.
    for (r, c), (dr, dc), beyond in (
        ((0, 0), (0, 1), (-1, 0)),
        ((0, 1), (1, 0), (0, 1)),
        ((1, 1), (0, -1), (1, 0)),
        ((1, 0), (-1, 0), (0, -1)),
    ):
        other = np.roll(padded, (-beyond[0], -beyond[1]), (0, 1))
        for y, x in np.argwhere(padded & ~other).tolist():
            steps.setdefault((y - 1 + r, x - 1 + c), []).append((dr, dc))
    place = start = min(steps)
    step = (0, 1)
    corners: list[_Corner] = []
    while True:
        ways = steps[place]
        right = (step[1], -step[0])  # where two pieces touch, to the right is the same pixel
        chosen = right if right in ways else ways[0]
        ways.remove(chosen)
        if chosen != step or not corners:
            corners.append(place)
        place, step = (place[0] + chosen[0], place[1] + chosen[1]), chosen
        if place == start and not steps[start]:
            return corners
