"""What pixels see of a step of light along an arc that is bent within its blur: areas that two discs share.

Of a disc with the radius r, of which a disc of blur with the radius b at a distance d from its middle covers

    A(d) = b^2 (p - sin p cos p) + r^2 (q - sin q cos q),   b sin p = r sin q = c, b cos p + r cos q = d,

c half of the chord that both outlines share, A/(pi b^2) is bright. The outline moves outwards along its arc 2 r q, and
the blur moves along the chord, so that dA/dr = 2 r q and dA/dd = -2 c. A pixel's mean is that of some places in it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PLACES: Final = 4  # a side in each pixel, by Gauss: off by 1e-3 at most at a blur of 1 px, and by 1e-5 in the mean


def shared_area(distance: Array, radius: float | Array, blur: float) -> tuple[Array, Array, Array]:
    """Share of a disc of blur within a disc, and its derivatives by the disc's radius and by the distance.

    Parameters
    ----------
    distance : ndarray
        Of both middles, 0 or more [px].
    radius : float or ndarray
        Of the disc [px].
    blur : float
        Radius of the disc of blur [px].

    Returns
    -------
    share, by_radius, by_distance : ndarray
        0 to 1, and [1/px].
    """
    d = np.maximum(distance, 1e-12)
    cos_p = np.clip((d * d + blur * blur - radius * radius) / (2 * d * blur), -1.0, 1.0)
    cos_q = np.clip((d * d + radius * radius - blur * blur) / (2 * d * radius), -1.0, 1.0)
    p, q = np.arccos(cos_p), np.arccos(cos_q)
    sin_q = np.sqrt(1 - cos_q * cos_q)
    area = blur**2 * (p - np.sqrt(1 - cos_p * cos_p) * cos_p) + radius**2 * (q - sin_q * cos_q)
    whole = math.pi * blur**2
    return area / whole, 2 * radius * q / whole, -2 * radius * sin_q / whole


def bent_step(
    distance: Array, normal: Array, curvature: Array, radius: float, aspect: float
) -> tuple[Array, Array, Array]:
    """Mean over each pixel of the step along an arc, blurred by a disc, and its derivatives.

    Parameters
    ----------
    distance, normal, curvature, radius, aspect
        As of `step.pixel_step`; the arc is that of the circle with this curvature, which is not 0.

    Returns
    -------
    step, by_distance, by_curvature : ndarray, shape (n,)
        Share of the pixel's light that is bright, 1/px, and px.
    """
    sign, of_arc = np.sign(curvature), 1 / np.abs(curvature)
    from_middle = of_arc - sign * distance
    nodes, weights = np.polynomial.legendre.leggauss(_PLACES)
    u, v = (part.ravel() / 2 for part in np.meshgrid(nodes, aspect * nodes))
    weight = np.outer(weights, weights).ravel() / 4
    # From the arc's middle a place lies by so much along the ray to the pixel's, and across it.
    along = from_middle[:, None] - sign[:, None] * (normal[:, :1] * u + normal[:, 1:] * v)
    away = np.hypot(along, normal[:, :1] * v - normal[:, 1:] * u)
    share, by_arc, by_away = shared_area(away, of_arc[:, None], radius)
    turned = by_away * along / np.maximum(away, 1e-12)
    inside = share @ weight
    return (
        np.where(sign > 0, inside, 1 - inside),
        -(turned @ weight),
        -(of_arc**2) * ((by_arc + turned) @ weight),
    )
