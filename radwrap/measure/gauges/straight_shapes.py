"""Shapes of straight rims: one edge, and a stripe."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Rim, Shape

Array = NDArray[np.float64]


def line_shape(centre: Array, normal_angle: float, length: float, sign: float, start: Array) -> Shape:
    """Edge with the parameters shift along the caliper's normal [px] and turn [rad], about the caliper's centre.

    Light is where the normal points to if the sign is 1.
    """

    def rims(parameters: Array, places: Array) -> list[Rim]:
        across, normal, along = _seen(centre, normal_angle, length, parameters, places)
        distance = sign * across
        return [Rim(distance, sign * normal, np.zeros(len(places)), along)]

    return Shape(rims, start, np.array([1.0, 2 / length]), length, closed=False)


def stripe_shape(centre: Array, normal_angle: float, length: float, start: Array) -> Shape:
    """Stripe with the parameters shift [px] and turn [rad] of its middle, and width [px]."""

    def rims(parameters: Array, places: Array) -> list[Rim]:
        across, normal, along = _seen(centre, normal_angle, length, parameters, places)
        half, flat = parameters[2] / 2, np.zeros(len(places))
        return [Rim(half + across, normal, flat, along), Rim(half - across, -normal, flat, along)]

    return Shape(rims, start, np.array([1.0, 2 / length, 1.0]), length, closed=False)


def _seen(
    centre: Array, normal_angle: float, length: float, parameters: Array, places: Array
) -> tuple[Array, Array, Array]:
    """Distance along the normal, the normal at all places, and the place along the line, also beyond its ends."""
    angle = normal_angle + parameters[1]
    normal = np.array([math.cos(angle), math.sin(angle)])
    away = places - centre
    # The caliper's own ends: pixels must not come and go where the line turns.
    first = np.array([-math.sin(normal_angle), math.cos(normal_angle)])
    along = away @ first + length / 2
    return away @ normal - parameters[0], np.tile(normal, (len(places), 1)), along
