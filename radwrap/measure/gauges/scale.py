"""From pixels to lengths: one scale for all of an image, or a plane that the camera sees askew."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]

_DEGREE: Final = 6  # of the polynomials that stand for a plane's map near a caliper
_GRID: Final = 15
_TRUE: Final = 1e-3  # px; they must follow it so closely
_STRAIGHT: Final = 1e-6  # px; without distortion a homography follows it to rounding


@dataclass(frozen=True, slots=True)
class Scale:
    """Length of a pixel.

    Attributes
    ----------
    length : float
        A pixel's width in the object [m].
    sigma : float
        Its standard error [m].
    """

    length: float
    sigma: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.length < math.inf:
            raise InputError("must be a length above 0", where="mm_per_px")
        if not 0 <= self.sigma < math.inf:
            raise InputError("has a negative or infinite error", where="mm_per_px")

    @property
    def relative_sigma(self) -> float:
        """Standard error as a share."""
        return self.sigma / self.length


@dataclass(frozen=True, slots=True)
class Plane:
    """A plane in the object and its image.

    Attributes
    ----------
    to_plane, to_image : callable
        Places in the image [px], shape (n, 2), to places in the plane [m], and back.
    relative_sigma : float
        Standard error of lengths in it, as a share: that of its distance.
    """

    to_plane: Callable[[Array], Array]
    to_image: Callable[[Array], Array]
    relative_sigma: float = 0.0

    @classmethod
    def of_homography(cls, homography: Array, relative_sigma: float = 0.0) -> Plane:
        """Plane by the matrix, shape (3, 3), that takes (x, y, 1) [m] to the image's (u, v, 1) times a number [px].

        Raises
        ------
        InputError
            If the matrix cannot be inverted.
        """
        matrix = np.asarray(homography, dtype=np.float64)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 3:
            raise InputError("must be a matrix of 3 x 3 that can be inverted", where="homography")
        inverse: Array = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        return cls(lambda at: _mapped(inverse, at), lambda at: _mapped(matrix, at), relative_sigma)

    def near(self, low: Array, high: Array, aspect: float) -> Callable[[Array], tuple[Array, Array]]:
        """The map to the plane within a box of the image, with its derivatives, as polynomials.

        Places are in pixel widths: (u, v times the pixel's aspect).

        Raises
        ------
        InputError
            If the plane is seen edge on there, or bends more than polynomials do.
        """
        middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1.0)
        nodes = np.cos(np.pi * (np.arange(_GRID) + 0.5) / _GRID)
        grid = np.stack(np.meshgrid(nodes, nodes), axis=-1).reshape(-1, 2)
        there = self.to_plane((middle + half * grid) / np.array([1.0, aspect]))
        if not np.isfinite(there).all():
            raise InputError("is not before the camera all over the caliper", where="plane")
        size = float(np.median(np.linalg.norm(np.diff(there.reshape(_GRID, _GRID, 2)[_GRID // 2], axis=0), axis=1)))
        pixel = size / float(np.median(np.abs(np.diff(nodes)))) / half[0]
        matrix = _homography(grid, there)
        if np.abs(_mapped(matrix, grid) - there).max() <= _STRAIGHT * pixel:
            # Without distortion a plane's image is a homography, which is thirty times as fast.
            return lambda at: _mapped_with_slopes(matrix, at, middle, half)
        terms, _ = _polynomials(grid)
        weights, *_ = np.linalg.lstsq(terms, there, rcond=None)
        if np.abs(terms @ weights - there).max() > _TRUE * pixel:
            raise InputError("is seen too much askew for the caliper", where="plane", remedy="take a smaller one")

        def local(at: Array) -> tuple[Array, Array]:
            found, slopes = _polynomials((at - middle) / half)
            return found @ weights, np.einsum("ntj,ti->nij", slopes / half, weights)

        return local


def _mapped(matrix: Array, at: Array) -> Array:
    """Places through a homography."""
    whole = np.column_stack([at, np.ones(len(at))]) @ matrix.T
    return np.asarray(whole[:, :2] / whole[:, 2:])


def _mapped_with_slopes(matrix: Array, at: Array, middle: Array, half: Array) -> tuple[Array, Array]:
    """Places through a homography of (place - middle)/half, and their derivatives by the place, shape (n, 2, 2)."""
    x, y = ((at - middle) / half).T
    a, b, c = matrix
    down = 1 / (c[0] * x + c[1] * y + c[2])
    u, v = (a[0] * x + a[1] * y + a[2]) * down, (b[0] * x + b[1] * y + b[2]) * down
    slopes = np.empty((len(at), 2, 2))
    for axis in (0, 1):
        slopes[:, 0, axis] = (a[axis] - u * c[axis]) * down / half[axis]
        slopes[:, 1, axis] = (b[axis] - v * c[axis]) * down / half[axis]
    return np.column_stack([u, v]), slopes


def _homography(at: Array, there: Array) -> Array:
    """The matrix, shape (3, 3), that takes places to others best: least squares of the linear equations."""
    centre, spread = there.mean(axis=0), float(there.std()) or 1.0
    u, v = ((there - centre) / spread).T
    x, y = at.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    rows = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1),
        ]
    )
    found = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    back = np.array([[spread, 0, centre[0]], [0, spread, centre[1]], [0, 0, 1]])
    return np.asarray(back @ found)


def _polynomials(at: Array) -> tuple[Array, Array]:
    """Monomials up to the degree, shape (n, terms), and their derivatives, shape (n, terms, 2)."""
    x, y = (np.stack([at[:, axis] ** k for k in range(_DEGREE + 1)], axis=1) for axis in (0, 1))
    pairs = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    terms = np.stack([x[:, i] * y[:, j] for i, j in pairs], axis=1)
    by_x = np.stack([i * x[:, max(i - 1, 0)] * y[:, j] for i, j in pairs], axis=1)
    by_y = np.stack([j * x[:, i] * y[:, max(j - 1, 0)] for i, j in pairs], axis=1)
    return terms, np.stack([by_x, by_y], axis=2)
