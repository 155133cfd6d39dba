"""Shapes of wide sources, cut into cells: where a cell lies, how it is halved, and which flat patch stands for it.

A shape lies in its own frame and shines along +z; a dome shines to its centre, its pole lies on -z. A cell is the
product of two intervals of the shape's own coordinates, (a0, a1, b0, b1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cell = tuple[float, float, float, float]

# Arcs are drawn with at least so many sides a turn: a polygon of that many has 4.5e-5 less area than its circle.
_SIDES: Final = 384
_SECTORS: Final = 6
_ZONE_CELLS: Final = 6


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle in its xy plane; cells in x and y [m]."""

    width: float
    height: float


@dataclass(frozen=True, slots=True)
class Annulus:
    """A disc in its xy plane, with a hole where inner_radius is above 0; cells in radius [m] and azimuth [rad]."""

    inner_radius: float
    radius: float


@dataclass(frozen=True, slots=True)
class Zone:
    """The part of a sphere between two angles from its pole on -z; cells in polar angle and azimuth [rad].

    Attributes
    ----------
    radius : float
        Of the sphere about the origin [m].
    least, most : float
        Angles from the pole [rad].
    """

    radius: float
    least: float
    most: float


WideShape = Rectangle | Annulus | Zone


def area(shape: WideShape) -> float:
    """Area [m^2]."""
    match shape:
        case Rectangle(width, height):
            return width * height
        case Annulus(inner, outer):
            return math.pi * (outer**2 - inner**2)
        case Zone(radius, least, most):
            return 2 * math.pi * radius**2 * (math.cos(least) - math.cos(most))


def first_cells(shape: WideShape) -> list[Cell]:
    """As few cells as the shape can have."""
    match shape:
        case Rectangle(width, height):
            return [(-width / 2, width / 2, -height / 2, height / 2)]
        case Annulus(inner, outer):
            # The mean of a patch's corners must lie in it, which that of a long thin arc does not.
            count = max(_SECTORS, math.ceil(math.pi / math.sqrt((outer - inner) / (outer + inner) / 2)))
            low, high = inner, outer
        case Zone():
            count, low, high = _ZONE_CELLS, shape.least, shape.most
    turns = [2 * math.pi * k / count for k in range(count + 1)]
    # From pole to pole the flat patch of a cell has no area.
    heights = (low, high) if low > 0 or high < math.pi else (low, (low + high) / 2, high)
    return [(*rise, *turn) for rise in pairwise(heights) for turn in pairwise(turns)]


def halves(shape: WideShape, cell: Cell) -> tuple[Cell, Cell]:
    """A cell cut across its longer side."""
    a0, a1, b0, b1 = cell
    match shape:
        case Rectangle():
            first, second = a1 - a0, b1 - b0
        case Annulus():
            first, second = a1 - a0, (b1 - b0) * (a0 + a1) / 2
        case Zone():
            first, second = a1 - a0, (b1 - b0) * math.sin((a0 + a1) / 2)
    if first >= second:
        middle = (a0 + a1) / 2
        return (a0, middle, b0, b1), (middle, a1, b0, b1)
    middle = (b0 + b1) / 2
    return (a0, a1, b0, middle), (a0, a1, middle, b1)


def corners(shape: WideShape, cell: Cell) -> Array:
    """Corners of the flat patch that stands for a cell, counter-clockwise from where it shines to, shape (n, 3) [m]."""
    a0, a1, b0, b1 = cell
    match shape:
        case Rectangle():
            return np.array([(a0, b0, 0.0), (a1, b0, 0.0), (a1, b1, 0.0), (a0, b1, 0.0)])
        case Annulus():
            # A power of two: halves of a cell then have corners that their neighbours have too.
            sides = 2 ** max(0, math.ceil(math.log2((b1 - b0) * _SIDES / (2 * math.pi))))
            turn = np.linspace(b0, b1, sides + 1)
            outer = _polar(np.full(len(turn), a1), turn)
            inner = _polar(np.full(len(turn), a0), turn[::-1]) if a0 > 0 else np.zeros((1, 3))
            return np.vstack([outer, inner])
        case Zone(radius):
            around = [(a0, b0), (a1, b0), (a1, b1), (a0, b1)]
            if a0 <= 0:
                around = around[:3]
            elif a1 >= math.pi:
                around = [around[0], around[1], around[3]]
            polar, turn = np.array(around).T
            # Sides of a polygon of as much area as the circle's, so that its light is not a percent less.
            wider = math.sqrt((b1 - b0) / math.sin(b1 - b0))
            return radius * _outwards(polar, turn) * [wider, wider, 1.0]


def nodes(shape: WideShape, cells: Array, count: int) -> tuple[Array, Array, Array]:
    """Points spread over cells of the true shape, for quadrature.

    Parameters
    ----------
    shape : WideShape
        The shape.
    cells : ndarray, shape (m, 4)
        Cells.
    count : int
        Points along each side of a cell.

    Returns
    -------
    points, normals : ndarray, shape (m, count^2, 3)
        [m]; unit normals of the shining side.
    areas : ndarray, shape (m, count^2)
        What each point stands for [m^2].
    """
    gauss, weight = np.polynomial.legendre.leggauss(count)
    first, second = (grid.ravel() for grid in np.meshgrid((gauss + 1) / 2, (gauss + 1) / 2))
    share = np.outer(weight, weight).ravel() / 4
    a = cells[:, :1] + (cells[:, 1:2] - cells[:, :1]) * first
    b = cells[:, 2:3] + (cells[:, 3:4] - cells[:, 2:3]) * second
    size = (cells[:, 1:2] - cells[:, :1]) * (cells[:, 3:4] - cells[:, 2:3]) * share
    up = np.broadcast_to([0.0, 0.0, 1.0], (*a.shape, 3))
    match shape:
        case Rectangle():
            return np.stack([a, b, np.zeros_like(a)], axis=-1), up, size
        case Annulus():
            return _polar(a, b), up, size * a
        case Zone(radius):
            outwards = _outwards(a, b)
            return radius * outwards, -outwards, size * radius**2 * np.sin(a)


def _polar(radius: Array, turn: Array) -> Array:
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros_like(turn)], axis=-1)


def _outwards(polar: Array, turn: Array) -> Array:
    """Unit vectors from the centre, at an angle from the pole on -z."""
    return np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)], axis=-1)
