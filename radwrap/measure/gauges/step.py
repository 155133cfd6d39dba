"""What pixels see of a blurred step of light along a contour that may be bent.

Across a straight contour the blur by a disc gives E(x) of Eq. 9, and a pixel sees its mean. Along a contour of
curvature kappa the bright side ends kappa s^2/2 nearer at a distance s along it. What that takes away is kappa/2 times
the blur's second moment along the contour, which is -int_{t<x} t k(t) dt for any round blur k, and so E_1 - x E_0.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.edges.profile import antiderivatives

Array = NDArray[np.float64]

_NARROW: Final = 5e-4  # px; half of a pixel's shorter side as the contour sees it is never taken as less: off by 4e-8


def pixel_step(distance: Array, normal: Array, curvature: Array, radius: float, aspect: float) -> tuple[Array, Array]:
    """Mean over each pixel of the step, and of the step times the distance, blurred by a disc.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        Of the pixels' centres from the contour, positive on the bright side [px].
    normal : ndarray, shape (n, 2)
        Unit normals of the contour there.
    curvature : ndarray, shape (n,)
        Of the contour, positive where its centre lies on the bright side [1/px].
    radius : float
        Of the disc [px], above 0.
    aspect : float
        Height of a pixel over its width.

    Returns
    -------
    step, ramp : ndarray, shape (n,)
        Share of the pixel's light that is bright, and its mean of x where x > 0 [px].
    """
    sides = np.abs(normal) * np.array([0.5, 0.5 * aspect])
    a, b = np.maximum(sides[:, 0], sides[:, 1]), np.maximum(np.minimum(sides[:, 0], sides[:, 1]), _NARROW)
    corners = np.stack([distance + a + b, distance + a - b, distance - a + b, distance - a - b])
    second, third = antiderivatives(corners, radius, (2, 3))
    area = 4 * a * b
    step = (second[0] - second[1] - second[2] + second[3]) / area
    ramp = (third[0] - third[1] - third[2] + third[3]) / area
    return step - curvature / 2 * (ramp - distance * step), ramp
