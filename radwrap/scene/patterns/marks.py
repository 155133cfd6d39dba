"""The two shapes that patterns are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class FlatPolygon:
    """A convex polygon; corners (x, y) on the plate [m], counter-clockwise."""

    vertices: tuple[Place, ...]


@dataclass(frozen=True, slots=True)
class FlatDisc:
    """A disc; its centre and radius on the plate [m]."""

    x: float
    y: float
    radius: float


Mark = FlatPolygon | FlatDisc


def rectangle(left: float, bottom: float, right: float, top: float) -> FlatPolygon:
    """A rectangle by its sides [m]."""
    return FlatPolygon(((left, bottom), (right, bottom), (right, top), (left, top)))


def narrowest_of(mark: Mark) -> float:
    """Width of a mark's narrowest part [m]: a polygon's least distance from a side to the corner opposite."""
    if isinstance(mark, FlatDisc):
        return 2 * mark.radius
    corners = mark.vertices
    return min(
        max(_beside(start, end, corner) for corner in corners)
        for start, end in zip(corners, (*corners[1:], corners[0]), strict=True)
    )


def _beside(start: Place, end: Place, point: Place) -> float:
    dx, dy = end[0] - start[0], end[1] - start[1]
    return abs(dx * (point[1] - start[1]) - dy * (point[0] - start[0])) / math.hypot(dx, dy)
