"""Shapes of contours, and how far pixels lie from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CURVATURE_STEP: Final = 0.5  # px along the contour, over which its turn is taken


@dataclass(frozen=True, slots=True, eq=False)
class Rim:
    """A contour as pixels see it.

    Attributes
    ----------
    distance : ndarray, shape (n,)
        Positive on the bright side [px].
    normal : ndarray, shape (n, 2)
        Towards it.
    curvature : ndarray, shape (n,)
        Positive where the centre lies on the bright side [1/px].
    along : ndarray, shape (n,)
        Place along the contour [px]: 0 to its length, and beyond what is not fitted.
    """

    distance: Array
    normal: Array
    curvature: Array
    along: Array


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A contour, or two of one object.

    Attributes
    ----------
    rims : callable
        Parameters and places, shape (n, 2) [px] -> one rim or two.
    start : ndarray, shape (k,)
        Parameters to begin with.
    units : ndarray, shape (k,)
        A change of each that moves the contour by about 1 px.
    length : float
        Of the contour [px].
    closed : bool
        Whether it comes back to where it began.
    slopes : ndarray, shape (2, m)
        Of two rims, m ways in which light may change across both: the slope outside, and what is added to it between.
    """

    rims: Callable[[Array, Array], Sequence[Rim]]
    start: Array
    units: Array
    length: float
    closed: bool
    slopes: Array = field(default_factory=lambda: np.zeros((2, 0)))


def length_of(vectors: Array) -> Array:
    """Lengths of vectors, shape (n, 2): column by column, as sums over two of many rows take five times as long."""
    x, y = vectors[:, 0], vectors[:, 1]
    return np.asarray(np.sqrt(x * x + y * y))


def implicit(value: Callable[[Array], tuple[Array, Array]], places: Array) -> Rim:
    """Rim where a function is 0, of which value and gradient are given; `along` is left 0.

    The distance is that to the foot on the contour, right to third order in it.
    """
    here, slope = value(places)
    size = length_of(slope)
    foot = places - (here / size**2)[:, None] * slope
    rest, there = value(foot)
    size_there = length_of(there)
    distance = (here - rest) / ((size + size_there) / 2) + rest / size_there
    normal = there / size_there[:, None]
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    ends = []
    for sign in (1, -1):
        _, turned = value(foot + sign * _CURVATURE_STEP * tangent)
        ends.append(turned / length_of(turned)[:, None])
    bend = tangent * (ends[0] - ends[1])
    curvature = -(bend[:, 0] + bend[:, 1]) / (2 * _CURVATURE_STEP)
    return Rim(distance, normal, curvature, np.zeros(len(places)))
