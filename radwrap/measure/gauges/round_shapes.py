"""Shapes of round rims: a circle, an ellipse, and a circle in a plane that the camera sees askew."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Rim, Shape, implicit, length_of

Array = NDArray[np.float64]
_TURN = 2 * math.pi


def circle_shape(start: Array, sign: float, arc: tuple[float, float] | None) -> Shape:
    """Circle with the parameters u, v and radius [px]; light is inside where the sign is 1, outside where it is -1."""

    def rims(parameters: Array, places: Array) -> list[Rim]:
        away = places - parameters[:2]
        distance = np.maximum(length_of(away), 1e-9)
        radius = parameters[2]
        normal = -sign * away / distance[:, None]
        curvature = np.full(len(places), sign / radius)
        return [Rim(sign * (radius - distance), normal, curvature, _along(away, arc, length))]

    length = start[2] * (_TURN if arc is None else arc[1])
    return Shape(rims, start, np.ones(3), length, closed=arc is None)


def ellipse_shape(start: Array, sign: float, arc: tuple[float, float] | None) -> Shape:
    """Ellipse with the parameters u, v, semi-axes [px] and direction of the first [rad]."""

    def rims(parameters: Array, places: Array) -> list[Rim]:
        centre, a, b, turn = parameters[:2], *parameters[2:]
        cos, sin = math.cos(turn), math.sin(turn)
        to_round = np.array([[cos / a, sin / a], [-sin / b, cos / b]])

        def value(at: Array) -> tuple[Array, Array]:
            inner = (at - centre) @ to_round.T
            radius = np.maximum(length_of(inner), 1e-9)
            return sign * (1 - radius), -sign * (inner / radius[:, None]) @ to_round

        rim = implicit(value, places)
        return [Rim(rim.distance, rim.normal, rim.curvature, _along(places - centre, arc, length))]

    mean = (start[2] + start[3]) / 2
    length = mean * (_TURN if arc is None else arc[1])
    # The direction of nearly equal axes is hardly known: a step of 1 px at most there too.
    turning = 1 / max(abs(start[2] - start[3]), 1.0)
    return Shape(rims, start, np.array([1.0, 1.0, 1.0, 1.0, turning]), length, closed=arc is None)


def plane_shape(
    start: Array,
    sign: float,
    arc: tuple[float, float] | None,
    local: Callable[[Array], tuple[Array, Array]],
    *,
    scale: float,
    centre: Array,
    radius: float,
) -> Shape:
    """Circle with the parameters x, y and radius in a plane [m].

    Parameters
    ----------
    start : ndarray, shape (3,)
        To begin with [m].
    sign : float
        1 where light is inside.
    arc : tuple of float or None
        In the image.
    local : callable
        Places [px] -> places in the plane [m], shape (n, 2), and their derivatives, shape (n, 2, 2).
    scale : float
        About how long a pixel is in the plane [m].
    centre, radius
        About where it is in the image [px].
    """

    def rims(parameters: Array, places: Array) -> list[Rim]:
        def value(at: Array) -> tuple[Array, Array]:
            inner, by_place = local(at)
            away = inner - parameters[:2]
            distance = np.maximum(length_of(away), 1e-300)
            unit = away / distance[:, None]
            slope = -sign * (unit[:, :1] * by_place[:, 0] + unit[:, 1:] * by_place[:, 1])
            return sign * (parameters[2] - distance), slope

        rim = implicit(value, places)
        return [Rim(rim.distance, rim.normal, rim.curvature, _along(places - centre, arc, length))]

    length = radius * (_TURN if arc is None else arc[1])
    return Shape(rims, start, np.full(3, scale), length, closed=arc is None)


def _along(away: Array, arc: tuple[float, float] | None, length: float) -> Array:
    """Place along the contour by the angle about its centre; of an arc also what lies beyond its ends."""
    first, extent = arc or (0.0, _TURN)
    middle = first + extent / 2
    turn = np.mod(np.arctan2(away[:, 1], away[:, 0]) - middle + math.pi, _TURN) - math.pi
    return np.asarray((turn / extent + 0.5) * length)
