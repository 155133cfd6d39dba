"""Masks and rims on the pixel grid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def indices(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Row and column of each pixel."""
    v, u = np.indices(shape)
    return v.astype(np.float64), u.astype(np.float64)


def distance(mask: Mask) -> Array:
    """Distance of each pixel from the nearest one of the mask [px]; large where there is none."""
    import cv2

    if not mask.any():
        return np.full(mask.shape, 1e9)
    if mask.all():
        return np.zeros(mask.shape)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), float)


def pieces(mask: Mask) -> NDArray[np.int32]:
    """Number of the connected piece that each pixel belongs to; 0 outside the mask."""
    import cv2

    labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)[1]
    return np.asarray(labels, dtype=np.int32)


def smoothed(values: Array, sigma: float) -> Array:
    """Gaussian mean."""
    import cv2

    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), dtype=np.float64)


def rim_length(share: Array, inside: Mask, aspect: float) -> float:
    """Length of the rim in pixel widths, from where it crosses rows and columns and how it slopes there.

    Parameters
    ----------
    share : ndarray, shape (rows, columns)
        Covered share of each pixel.
    inside : ndarray of bool, shape (rows, columns)
        Whether the pixel belongs to the part.
    aspect : float
        Height of a pixel over its width.
    """
    slope_v, slope_u = np.gradient(smoothed(share, 1.0))
    steep, flat = np.abs(slope_u), np.abs(slope_v) / aspect
    length = 0.0
    # Each piece of rim is counted once: along the rows where it is steep, along the columns where it is flat.
    for axis, here, other, step in ((1, steep, flat, aspect), (0, flat, steep, 1.0)):
        first, second = (np.s_[:, :-1], np.s_[:, 1:]) if axis else (np.s_[:-1], np.s_[1:])
        crossed = inside[first] != inside[second]
        across = (here[first] + here[second])[crossed]
        along = (other[first] + other[second])[crossed]
        # Rims at exactly 45 degrees cross both.
        weight = np.where(across > along, 1.0, np.where(across == along, 0.5, 0.0))
        length += step * float((weight * np.hypot(across, along) / np.maximum(across, 1e-12)).sum())
    return length


def smallest_rectangle(contour: Array) -> tuple[float, float, float, float, float]:
    """Centre u, v, length, width and direction of the longer side, in -pi/2 to pi/2 [rad], of the smallest one."""
    import cv2

    hull = cv2.convexHull(contour.astype(np.float32))
    (x, y), (width, height), angle = cv2.minAreaRect(hull)
    turn = math.radians(angle) + (math.pi / 2 if height > width else 0.0)
    return x, y, max(width, height), min(width, height), math.pi / 2 - (math.pi / 2 - turn) % math.pi
