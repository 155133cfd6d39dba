"""What pixels see of a blurred step of light along a contour that may be bent.

Across a straight contour the blur by a disc gives E(x) of Eq. 9, and a pixel sees its mean. Along a contour of
curvature kappa the bright side ends y = kappa s^2/2 nearer at a distance s along it. That takes away

    int y k(x, s) ds - d/dx int y^2/2 k(x, s) ds,

k the blur. The first is kappa/2 times its second moment along the contour, -int_{t<x} t k(t) dt = E_1 - x E_0 of any
round blur. For a disc of radius b these moments are 2 c^3/(3 pi b^2) and, of s^4, 2 c^5/(5 pi b^2) with
c^2 = b^2 - x^2, so that both together are kappa/2 (E_1 - x E_0)(1 + 3/4 kappa x). Where the contour is bent more within
its blur, the step is that of its arc (`bent`); the slope of light is known to first order there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.edges.profile import antiderivatives
from radwrap.measure.gauges.bent import bent_step

Array = NDArray[np.float64]

_NARROW: Final = 5e-4  # px; half of a pixel's shorter side as the contour sees it is never taken as less: off by 4e-8
_SECOND: Final = 0.75  # of kappa x, what the second order in the curvature adds to the first
_BENT: Final = 0.2  # of kappa b; there the second order is off by 1e-4 of the contrast, at 0.4 by 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What pixels see of a step, and how that changes with their place.

    Attributes
    ----------
    step, ramp : ndarray, shape (n,)
        Share of the pixel's light that is bright, and its mean of x where x > 0 [px].
    step_by_distance, ramp_by_distance : ndarray, shape (n,)
        Their derivatives by the distance from the contour.
    step_by_curvature : ndarray, shape (n,)
        Derivative by the curvature [px].
    """

    step: Array
    ramp: Array
    step_by_distance: Array
    ramp_by_distance: Array
    step_by_curvature: Array

    @property
    def parts(self) -> tuple[Array, ...]:
        """All of them."""
        return self.step, self.ramp, self.step_by_distance, self.ramp_by_distance, self.step_by_curvature

    def moved(self, distance: Array, curvature: Array) -> tuple[Array, Array]:
        """Step and ramp after a small change of both [px, 1/px]."""
        step = self.step + self.step_by_distance * distance + self.step_by_curvature * curvature
        return step, self.ramp + self.ramp_by_distance * distance


def mixed(steps: Sequence[Step], shares: Array) -> Step:
    """What pixels see of a step whose blur is a sum, with the shares of its parts."""
    if len(steps) == 1:
        return steps[0]
    columns = zip(*(step.parts for step in steps), strict=True)
    return Step(*(sum(share * part for share, part in zip(shares, parts, strict=True)) for parts in columns))


def pixel_step(distance: Array, normal: Array, curvature: Array, radius: float, aspect: float) -> Step:
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
    Step
        With derivatives, but for what a turn of the normal does.
    """
    sides = np.abs(normal) * np.array([0.5, 0.5 * aspect])
    a, b = np.maximum(sides[:, 0], sides[:, 1]), np.maximum(np.minimum(sides[:, 0], sides[:, 1]), _NARROW)
    corners = np.stack([distance + a + b, distance + a - b, distance - a + b, distance - a - b])
    area = 4 * a * b
    density, step, ramp = ((e[0] - e[1] - e[2] + e[3]) / area for e in antiderivatives(corners, radius, (1, 2, 3)))
    if not curvature.any():
        return Step(step, ramp, density, step, np.zeros_like(step))
    if float(np.abs(curvature).max()) * radius > _BENT and curvature.all():
        bent, by_distance, by_curvature = bent_step(distance, normal, curvature, radius, aspect)
        return Step(bent, ramp, by_distance, step, by_curvature)
    moment = ramp - distance * step
    twice = curvature * distance * (2 * _SECOND)
    return Step(
        step - curvature / 2 * moment * (1 + twice / 2),
        ramp,
        density + curvature / 2 * (distance * density * (1 + twice / 2) - moment * curvature * _SECOND),
        step,
        -moment / 2 * (1 + twice),
    )
