"""Irradiance on a plane by lamps, discs and rectangles that face it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import dblquad

Array = NDArray[np.float64]

_DIGITS: Final = 1e-8  # relative, of the integral over a disc


def point_irradiance(intensity: Any, height: float, beside: Any = 0.0) -> Any:
    """E = I h/(h^2 + r^2)^1.5 on a plane, by a point source above it (CIE 171:2006).

    Parameters
    ----------
    intensity : float or ndarray
        I, towards the point [W sr^-1].
    height : float
        h, of the source above the plane [m].
    beside : float or ndarray
        r, of the point from the source's foot [m].

    Returns
    -------
    float or ndarray
        [W m^-2].
    """
    return intensity * height / (height**2 + beside**2) ** 1.5


def small_disc_intensity(radiance: float, radius: float, cosine: float = 1.0) -> float:
    """I = L pi R^2 cos(theta): a Lambertian disc as a point source [W sr^-1]."""
    return radiance * math.pi * radius**2 * cosine


def gaussian_intensity(angle: float, sigma: float) -> float:
    """I(theta)/I(0) = exp(-theta^2/(2 sigma^2)); both angles in the same unit."""
    return math.exp(-(angle**2) / (2 * sigma**2))


def sigma_of_fwhm(width: float) -> float:
    """Standard deviation of a Gaussian from its full width at half maximum, in the same unit."""
    return width / math.sqrt(8 * math.log(2))


def disc_irradiance(radiance: float, radius: float, height: float) -> float:
    """E = pi L R^2/(R^2 + h^2) below the middle of a Lambertian disc.

    Parameters
    ----------
    radiance : float
        L [W m^-2 sr^-1].
    radius, height : float
        R, and h above the plane [m].

    Returns
    -------
    float
        [W m^-2].
    """
    return math.pi * radiance * radius**2 / (radius**2 + height**2)


def disc_irradiance_beside(
    radiance: float,
    radius: float,
    height: float,
    beside: tuple[float, float],
    *,
    inner_radius: float = 0.0,
    intensity: Callable[[float], float] = math.cos,
) -> float:
    """Irradiance by a disc or an annulus at any point of the plane, by quadrature over its area.

    Parameters
    ----------
    radiance : float
        L along the normal [W m^-2 sr^-1].
    radius, height : float
        Of the disc, and above the plane [m].
    beside : tuple of float
        The point, from the disc's foot (x, y) [m].
    inner_radius : float
        Above 0 for an annulus [m].
    intensity : callable
        I(theta)/I(0) of each piece of the area; cos(theta) is Lambert's.

    Returns
    -------
    float
        [W m^-2].
    """

    def piece(turn: float, r: float) -> float:
        x, y = (b - r * way(turn) for b, way in zip(beside, (math.cos, math.sin), strict=True))
        square = x * x + y * y + height**2
        cosine = height / math.sqrt(square)
        return radiance * intensity(math.acos(cosine)) * cosine / square * r

    value, _ = dblquad(piece, inner_radius, radius, 0.0, 2 * math.pi, epsrel=_DIGITS)
    return float(value)


def rectangle_factor(x: tuple[float, float], y: tuple[float, float], height: float) -> float:
    """Configuration factor E/(pi L) of a rectangle that is parallel to the plane (CIE 171:2006, after Lambert).

    Parameters
    ----------
    x, y : tuple of float
        From where to where it reaches, beside the point [m].
    height : float
        Above the plane [m].

    Returns
    -------
    float
        0 to 1.
    """

    def corner(a: float, b: float) -> float:
        # Of the rectangle from the foot to (a, b); odd in a and in b, so that differences make up any rectangle.
        p, q = math.hypot(a, height), math.hypot(b, height)
        return (a / p * math.atan(b / p) + b / q * math.atan(a / q)) / (2 * math.pi)

    return corner(x[1], y[1]) - corner(x[0], y[1]) - corner(x[1], y[0]) + corner(x[0], y[0])
