"""What of a pattern lies at a place: a tree of lines and circles that part the plate.

A plate with marks as surfaces of their own would be two surfaces in one plane. So tracers ask the plate's material, by
this tree, which of the two it shows. A rim is where the comparison of one number changes its sign, in all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.patterns.marks import FlatDisc, Mark

Array = NDArray[np.float64]
_Line = tuple[float, float, float]

PLATE: Final = -1  # in place of a node's number
MARK: Final = -2
_NEAR: Final = 1e-12  # of the plate's size: what is thinner is rounding
_MOST_CANDIDATES: Final = 48
_MOST_SAMPLED: Final = 16  # of many pieces, those whose sides are tried
_CUT: Final = 2  # what a mark that is cut in two costs, in marks of the larger side


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """A tree over a plate.

    Attributes
    ----------
    nodes : ndarray, shape (n, 6)
        a, b, c, whether it is a circle, and where to go on inside and outside: the number of a node, `PLATE` or
        `MARK`. Inside of a line is where a x + b y - c > 0, (a, b) being a unit vector, inside of a circle where
        c - (x - a)^2 - (y - b)^2 > 0; lengths in metres. The first node is the root.
    """

    nodes: Array

    def covered(self, xy: Array) -> NDArray[np.bool_]:
        """Which points of the plate, shape (n, 2) [m], lie on a mark."""
        at = np.zeros(len(xy), dtype=np.intp)
        while (going := np.flatnonzero(at >= 0)).size:
            a, b, c, is_circle, inside, outside = self.nodes[at[going]].T
            x, y = xy[going].T
            side = np.where(is_circle > 0, c - (x - a) ** 2 - (y - b) ** 2, a * x + b * y - c)
            at[going] = np.where(side > 0, inside, outside).astype(np.intp)
        covered: NDArray[np.bool_] = at == MARK
        return covered


@dataclass(frozen=True, slots=True)
class _Piece:
    """What of a mark lies in a region; of a disc all of it is kept."""

    mark: Mark
    outline: Array


def partition(marks: Iterable[Mark], size: tuple[float, float]) -> Partition:
    """Part a plate by marks, which do not overlap each other.

    Parameters
    ----------
    marks : iterable of Mark
        Convex polygons and discs on the plate [m].
    size : tuple of float
        Of the plate along x and y [m].
    """
    x, y = size[0] / 2, size[1] / 2
    growth = _Growth(_NEAR * max(size), [])
    pieces = [_Piece(mark, _outline(mark)) for mark in marks]
    root = growth.grow(np.array([(-x, -y), (x, -y), (x, y), (-x, y)]), pieces)
    if root < 0:
        growth.add((1.0, 0.0, 0.0), False, root, root)
    nodes = np.array(growth.nodes, dtype=np.float64)
    # Nodes are added after those below them: turned round, the root is the first.
    nodes = nodes[::-1].copy()
    below = nodes[:, 4:]
    below[below >= 0] = len(nodes) - 1 - below[below >= 0]
    return Partition(nodes)


def _outline(mark: Mark) -> Array:
    if isinstance(mark, FlatDisc):
        return np.array([(mark.x, mark.y)])
    return np.array(mark.vertices, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Growth:
    """Nodes as they are made, those below a node before it."""

    near: float
    nodes: list[tuple[float, ...]]

    def add(self, numbers: _Line, is_circle: bool, inside: int, outside: int) -> int:
        self.nodes.append((*numbers, float(is_circle), float(inside), float(outside)))
        return len(self.nodes) - 1

    def grow(self, region: Array, pieces: Sequence[_Piece]) -> int:
        """Root of a tree over a convex region."""
        if not pieces:
            return PLATE
        if any(self._fills(piece.mark, region) for piece in pieces):
            return MARK
        if len(pieces) == 1:
            return self._around(pieces[0], region, PLATE)
        line = self._best(pieces)
        if line is None:  # no line parts them: they are asked one by one
            below = PLATE
            for piece in pieces:
                below = self._around(piece, region, below)
            return below
        sides = [self.grow(*self._side(line, region, pieces, sign)) for sign in (1, -1)]
        return self.add(line, False, *sides)

    def _fills(self, mark: Mark, region: Array) -> bool:
        if isinstance(mark, FlatDisc):
            return bool((np.hypot(*(region - (mark.x, mark.y)).T) <= mark.radius).all())
        return all((_height(line, region) >= -self.near).all() for line in _sides(np.array(mark.vertices)))

    def _around(self, piece: _Piece, region: Array, otherwise: int) -> int:
        """A tree that tells one mark from what is there otherwise."""
        mark = piece.mark
        if isinstance(mark, FlatDisc):
            return self.add((mark.x, mark.y, mark.radius**2), True, MARK, otherwise)
        below = MARK
        for line in _sides(np.array(mark.vertices)):
            if _height(line, region).min() < -self.near:
                below = self.add(line, False, below, otherwise)
        return below

    def _best(self, pieces: Sequence[_Piece]) -> _Line | None:
        """The line that parts the pieces most evenly and cuts few; None where none makes them fewer."""
        lines = _candidates(pieces)
        points = np.concatenate([piece.outline for piece in pieces])
        first = np.cumsum([0, *(len(piece.outline) for piece in pieces)])[:-1]
        radius = np.array([piece.mark.radius if isinstance(piece.mark, FlatDisc) else 0.0 for piece in pieces])
        heights = lines[:, :2] @ points.T - lines[:, 2:]
        inside = (np.maximum.reduceat(heights, first, axis=1) + radius > self.near).sum(axis=1)
        outside = (np.minimum.reduceat(heights, first, axis=1) - radius < -self.near).sum(axis=1)
        most = np.maximum(inside, outside)
        cost = most + _CUT * (inside + outside - len(pieces))
        cost[most >= len(pieces)] = 4 * len(pieces)
        least = int(cost.argmin())
        if most[least] >= len(pieces):
            return None
        a, b, c = lines[least].tolist()
        return a, b, c

    def _side(
        self, line: _Line, region: Array, pieces: Sequence[_Piece], sign: int
    ) -> tuple[Array, tuple[_Piece, ...]]:
        """Region and pieces on one side of a line."""
        a, b, c = (sign * value for value in line)
        line = (a, b, c)
        found = []
        for piece in pieces:
            if isinstance(piece.mark, FlatDisc):
                if _height(line, piece.outline)[0] + piece.mark.radius > self.near:
                    found.append(piece)
            elif _height(line, piece.outline).max() > self.near:
                found.append(_Piece(piece.mark, _clipped(line, piece.outline)))
        return _clipped(line, region), tuple(found)


def _candidates(pieces: Sequence[_Piece]) -> Array:
    """Lines along the pieces' sides and beside discs, shape (n, 3); of many those spread over all."""
    found: list[_Line] = []
    for piece in pieces[:: max(1, len(pieces) // _MOST_SAMPLED)]:
        if isinstance(piece.mark, FlatDisc):
            x, y, r = piece.mark.x, piece.mark.y, piece.mark.radius
            found += [(1.0, 0.0, x - r), (1.0, 0.0, x + r), (0.0, 1.0, y - r), (0.0, 1.0, y + r)]
        else:
            found += _sides(piece.outline)
    lines = np.array(found)
    turned = (lines[:, 0] < 0) | ((lines[:, 0] == 0) & (lines[:, 1] < 0))
    lines[turned] *= -1
    lines = np.unique(lines + 0.0, axis=0)
    if len(lines) > _MOST_CANDIDATES:
        lines = lines[np.linspace(0, len(lines) - 1, _MOST_CANDIDATES).astype(int)]
    return lines


def _sides(outline: Array) -> list[_Line]:
    """Lines along the sides of a counter-clockwise polygon, which lies inside of them."""
    along = np.roll(outline, -1, axis=0) - outline
    length = np.hypot(*along.T)
    some = length > 0
    normal = np.column_stack([-along[some, 1], along[some, 0]]) / length[some, np.newaxis]
    heights = (normal * outline[some]).sum(axis=1)
    return [(a, b, c) for (a, b), c in zip(normal.tolist(), heights.tolist(), strict=True)]


def _height(line: _Line, points: Array) -> Array:
    height: Array = points @ np.array(line[:2]) - line[2]
    return height


def _clipped(line: _Line, outline: Array) -> Array:
    """What of a convex polygon lies inside of a line."""
    height = _height(line, outline)
    kept = []
    for at, here, there in zip(range(len(outline)), height, np.roll(height, -1), strict=True):
        if here >= 0:
            kept.append(outline[at])
        if (here > 0 > there) or (here < 0 < there):
            share = here / (here - there)
            kept.append(outline[at] + share * (outline[(at + 1) % len(outline)] - outline[at]))
    return np.array(kept).reshape(-1, 2)
