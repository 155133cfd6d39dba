"""Shapes fitted to points that scan lines found: outliers told by threes, standard errors by what is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Shape
from radwrap.random_streams import Measuring, generator

Array = NDArray[np.float64]

_TRIES: Final = 300  # threes, or pairs, of which nearly always one has no outlier while two thirds are outliers
_NEAR: Final = 1.0  # px; points so near belong to it
_BLOCK: Final = 4  # neighbouring scan lines share pixels: their points are taken as one


@dataclass(frozen=True, slots=True, eq=False)
class PointFit:
    """A shape through points.

    Attributes
    ----------
    parameters, covariance : ndarray
        Of the shape.
    rms : float
        Of what is left [px].
    points : int
        How many there are.
    """

    parameters: Array
    covariance: Array
    rms: float
    points: int


def robust_circle(points: Array, near: float = _NEAR) -> tuple[Array, float, NDArray[np.bool_]]:
    """Circle that most points lie on: centre, radius, and which they are."""
    dice = generator(Measuring.RIMS, len(points))
    threes = points[dice.integers(len(points), size=(_TRIES, 3))]
    centre, radius = _through(threes)
    off = np.abs(np.linalg.norm(points[None] - centre[:, None], axis=2) - radius[:, None])
    score = np.minimum(np.where(np.isfinite(off), off, np.inf), near).sum(axis=1)
    best = int(np.argmin(score))
    middle, size, inside = centre[best], float(radius[best]), off[best] < near
    for _ in range(4):
        middle, size = _by_least_squares(points[inside])
        inside = np.abs(np.linalg.norm(points - middle, axis=1) - size) < near
        if inside.sum() < 3:
            break
    return middle, size, inside


def robust_line(points: Array, near: float = _NEAR) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Line that most points lie on: a point of it, its direction, and which they are."""
    dice = generator(Measuring.RIMS, len(points))
    pairs = points[dice.integers(len(points), size=(_TRIES, 2))]
    along = pairs[:, 1] - pairs[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / np.maximum(length, 1e-12)[:, None]
    away = points[None] - pairs[:, :1]
    off = np.abs(away[..., 0] * along[:, None, 1] - away[..., 1] * along[:, None, 0])
    score = np.where(length > 2, np.minimum(off, near).sum(axis=1), np.inf)
    inside = off[int(np.argmin(score))] < near
    middle, direction = points.mean(axis=0), np.array([1.0, 0.0])
    for _ in range(4):
        middle = points[inside].mean(axis=0)
        direction = np.linalg.svd(points[inside] - middle)[2][0]
        from_it = points - middle
        inside = np.abs(from_it[:, 0] * direction[1] - from_it[:, 1] * direction[0]) < near
    return middle, direction, inside


def fit_points(shape: Shape, points: Array) -> PointFit:
    """Least squares of the points' distances from the shape."""
    from scipy.optimize import least_squares

    def distances(scaled: Array) -> Array:
        return shape.rims(scaled * shape.units, points)[0].distance

    solved = least_squares(distances, shape.start / shape.units, x_scale="jac", loss="soft_l1", f_scale=0.5)
    left = distances(solved.x)
    jacobian = np.stack(
        [(distances(solved.x + h) - distances(solved.x - h)) / 2e-4 for h in 1e-4 * np.eye(len(solved.x))], axis=1
    )
    inverse = np.linalg.pinv(jacobian)
    variance = float(left @ left) / max(len(left) - len(solved.x), 1)
    blocks = np.add.reduceat(left, np.arange(0, len(left), _BLOCK)) / np.sqrt(_BLOCK)
    together = max(float(blocks @ blocks) / max(len(blocks) - len(solved.x), 1) / max(variance, 1e-300), 1.0)
    scaled = inverse @ inverse.T * variance * together
    rms = float(np.sqrt(np.mean(left**2)))
    return PointFit(solved.x * shape.units, scaled * np.outer(shape.units, shape.units), rms, len(points))


def _through(threes: Array) -> tuple[Array, Array]:
    """Centres and radii of the circles through three points each."""
    first = threes[:, 0]
    a, b = threes[:, 1] - first, threes[:, 2] - first
    twice = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    aa, bb = (a**2).sum(axis=1), (b**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (b[:, 1] * aa - a[:, 1] * bb) / twice
        y = (a[:, 0] * bb - b[:, 0] * aa) / twice
    return first + np.column_stack([x, y]), np.hypot(x, y)


def _by_least_squares(points: Array) -> tuple[Array, float]:
    """Circle by the linear least squares of x^2 + y^2."""
    middle = points.mean(axis=0)
    near = points - middle
    columns = np.column_stack([2 * near, np.ones(len(near))])
    x, y, rest = np.linalg.lstsq(columns, (near**2).sum(axis=1), rcond=None)[0]
    return middle + np.array([x, y]), float(np.sqrt(max(rest + x * x + y * y, 0.0)))
