"""Exposure and blur by a round opening: even fields and straight edges (Eqs. 1 to 3, 8 and 9)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cos4(x: Any, y: Any, distance: float) -> Any:
    """cos^4 of the angle to the axis of a point (x, y) in a plane so far away; all in one unit."""
    return 1 / (1 + (x**2 + y**2) / distance**2) ** 2


def pinhole_exposure(radiance: Any, diameter: float, focal_length: float, exposure_time: float = 1.0) -> Any:
    """H = tau A/f^2 L on the axis, through a pinhole that is small beside f.

    Parameters
    ----------
    radiance : float or ndarray
        L, or L cos^4 off the axis [W m^-2 sr^-1].
    diameter, focal_length : float
        [m].
    exposure_time : float
        tau [s].

    Returns
    -------
    float or ndarray
        [J m^-2].
    """
    return exposure_time * math.pi / 4 * diameter**2 / focal_length**2 * radiance


def even_field_irradiance(radius: float, image_distance: float, height: float = 0.0) -> float:
    """E/L on the sensor by a round opening of any width in an even field: the integral of cos^4/v^2 over the opening.

    Parameters
    ----------
    radius, image_distance : float
        Of the opening, and of the sensor behind it, v [m].
    height : float
        Of the sensor's point above the axis [m].

    Returns
    -------
    float
        [sr]; pi R^2/(R^2 + v^2) on the axis.
    """
    square = image_distance**2 + height**2
    root = math.sqrt((square + radius**2) ** 2 - 4 * radius**2 * height**2)
    return math.pi / 2 * (1 - (square - radius**2) / root)


def at_zero_area(numbers: Sequence[int], values: Sequence[Array]) -> Array:
    """Value for cells of no area: the polynomial in 1/N through the values, at 1/N = 0 (Richardson).

    Parameters
    ----------
    numbers : sequence of int
        N, of sub-viewpoints of like cells.
    values : sequence of ndarray
        What came out with each.
    """
    areas = [1 / number for number in numbers]
    result = np.zeros_like(values[0])
    for area, value in zip(areas, values, strict=True):
        result = result + value * math.prod(other / (other - area) for other in areas if other != area)
    return result


def projection_radius(diameter: float, depth: float, focal_length: float) -> float:
    """Eq. 8: R = (d_p/2)(1 + D'/f), of what a point of the sensor sees at a depth; all in one unit."""
    return diameter / 2 * (1 + depth / focal_length)


def share_beyond(s: Any) -> Array:
    """Eq. 9: share of a disc on the bright side of a straight edge.

    Parameters
    ----------
    s : float or ndarray
        How far the disc's centre lies on the bright side, in radii.

    Returns
    -------
    ndarray
        1 - (acos s - s sqrt(1 - s^2))/pi; 0 below -1, 1 above 1.
    """
    s = np.clip(s, -1.0, 1.0)
    share: Array = 1 - (np.arccos(s) - s * np.sqrt(1 - s**2)) / math.pi
    return share


def blurred_edge(
    columns: Any,
    rows: Any,
    pitch: tuple[float, float],
    *,
    angle: float,
    radius: float,
    offset: float = 0.0,
    points: int = 16,
) -> Array:
    """Eq. 9 averaged over each pixel (Eq. 2) by its midpoints.

    Parameters
    ----------
    columns, rows : array_like, shapes (columns,) and (rows,)
        x and y of the pixels' centres, in any unit.
    pitch : tuple of float
        Width and height of a pixel.
    angle : float
        From x towards y, of the normal that points to the bright side [rad].
    radius : float
        Of the disc on the sensor; 0 is a sharp edge.
    offset : float
        Of the edge from (0, 0), along its normal.
    points : int
        Midpoints along a pixel's side; 1 is the pixel's centre.

    Returns
    -------
    ndarray, shape (rows, columns)
        0 to 1.
    """
    inside = (np.arange(points) + 0.5) / points - 0.5
    x = np.asarray(columns)[np.newaxis, :, np.newaxis, np.newaxis] + pitch[0] * inside[np.newaxis, :]
    y = np.asarray(rows)[:, np.newaxis, np.newaxis, np.newaxis] + pitch[1] * inside[:, np.newaxis]
    across = x * math.cos(angle) + y * math.sin(angle) - offset
    mean: Array = share_beyond(across / radius if radius else np.sign(across)).mean(axis=(2, 3))
    return mean
