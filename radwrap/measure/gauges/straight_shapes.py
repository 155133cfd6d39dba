"""Shapes of straight rims: one edge, a stripe, and a stripe in a plane that the camera sees askew."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Rim, Shape, implicit

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


def stripe_in_plane_shape(
    centre: Array,
    normal_angle: float,
    length: float,
    start: Array,
    local: Callable[[Array], tuple[Array, Array]],
    *,
    scale: float,
) -> Shape:
    """Stripe with sides that are parallel in a plane: shift [px] and turn [rad] of its middle in the image, and width.

    Parameters
    ----------
    centre, normal_angle, length
        Of the caliper, in pixel widths.
    start : ndarray, shape (3,)
        To begin with; the width in units of `scale`.
    local : callable
        Places [px] -> places in the plane [m], shape (n, 2), and their derivatives, shape (n, 2, 2).
    scale : float
        About how long a pixel is across the stripe [m].
    """

    def rims(parameters: Array, places: Array) -> list[Rim]:
        angle = normal_angle + parameters[1]
        normal, tangent = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
        (middle,), (by_place,) = local((centre + parameters[0] * normal)[None])
        x, y = by_place @ tangent
        across = np.array([y, -x]) / math.hypot(x, y)
        across *= math.copysign(1.0, float(across @ by_place @ normal))
        _, _, along = _seen(centre, normal_angle, length, parameters, places)

        def rim(sign: float) -> Rim:
            def value(at: Array) -> tuple[Array, Array]:
                there, slopes = local(at)
                here = parameters[2] / 2 + sign * (there - middle) @ across / scale
                return here, sign * (across[0] * slopes[:, 0] + across[1] * slopes[:, 1]) / scale

            return replace(implicit(value, places), along=along)

        return [rim(1.0), rim(-1.0)]

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
