"""The map from the board's plane to the image: a homography, and what it does to discs.

Board coordinates are (column, row) in units of the pitch, so that the dot in
row r and column c lies at (c, r).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Matrix = NDArray[np.float64]


def fit_homography(board: Points, image: Points) -> Matrix:
    """Least-squares homography by the direct linear transform, both sides normalised.

    Parameters
    ----------
    board : ndarray, shape (n, 2)
        Points on the board [pitch], n >= 4, not all on a line.
    image : ndarray, shape (n, 2)
        Their images (u, v) [px].

    Returns
    -------
    ndarray, shape (3, 3)
        ``image ~ matrix @ (column, row, 1)``, its last element 1. Where the
        points determine none it holds infinities or sends points behind the
        horizon: see `is_regular`.
    """
    from_board, from_image = _normaliser(board), _normaliser(image)
    x, y = project(from_board, board).T
    u, v = project(from_image, image).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    equations = np.concatenate(
        [
            np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u]),
            np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v]),
        ]
    )
    normalised = np.linalg.svd(equations, full_matrices=len(equations) < 9)[2][-1].reshape(3, 3)
    matrix = np.linalg.inv(from_image) @ normalised @ from_board
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(matrix / matrix[2, 2])


def _normaliser(points: Points) -> Matrix:
    """Similarity that brings points to mean 0 and mean square distance 2."""
    mean = points.mean(axis=0)
    scale = np.sqrt(2.0 / np.mean(np.sum((points - mean) ** 2, axis=1)))
    return np.array([[scale, 0.0, -scale * mean[0]], [0.0, scale, -scale * mean[1]], [0.0, 0.0, 1.0]])


def project(matrix: NDArray[Any], points: NDArray[Any]) -> Points:
    """Apply a homography to points of shape (..., 2)."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def is_regular(matrix: Matrix, board: Points) -> bool:
    """Whether all board points lie on one side of the horizon and the map keeps the sense of rotation."""
    if not np.isfinite(matrix).all():
        return False
    weights = board @ matrix[2, :2] + matrix[2, 2]
    return bool((weights > 0).all() and np.linalg.det(matrix) > 0)


def jacobian(matrix: Matrix, points: Points) -> NDArray[np.float64]:
    """Local affine part of a homography.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        d(u, v)/d(column, row) at each point [px/pitch].
    """
    image = project(matrix, points)
    weights = points @ matrix[2, :2] + matrix[2, 2]
    return np.asarray((matrix[:2, :2] - image[:, :, None] * matrix[2, :2]) / weights[:, None, None])


def disc_centre_shift(matrix: Matrix, centres: Points, radius: float) -> Points:
    """How far the centre of a disc's image lies from the image of the disc's centre (heikkila2000).

    With H the homography and C* = c c^T - diag(r^2, r^2, 0) the dual conic of
    a circle about c, the image's centre is H C* H^T (0, 0, 1)^T: the pole of
    the line at infinity.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)
        Board to image.
    centres : ndarray, shape (n, 2)
        Discs' centres on the board [pitch].
    radius : float
        Their radius [pitch].

    Returns
    -------
    ndarray, shape (n, 2)
        Centre of the ellipse less image of the centre [px].
    """
    homogeneous = np.column_stack([centres, np.ones(len(centres))])
    horizon = matrix[2]
    poles = homogeneous * (homogeneous @ horizon)[:, None] - radius**2 * np.array([horizon[0], horizon[1], 0.0])
    mapped = poles @ matrix.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:] - project(matrix, centres))
