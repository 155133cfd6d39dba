"""Tsai's camera: points of the world in, pixels out, with all derivatives.

::

    (X, Y, Z) = R (P - origin) + position        camera frame: x right, y down, z forward
    (Xu, Yu)  = f (X, Y) / Z                     undistorted image [m]
    (Xu, Yu)  = (Xd, Yd) (1 + kappa1 r^2)        r^2 = Xd^2 + Yd^2: undistorting
    u = Cx + sx Xd / dx,   v = Cy + Yd / dy      pixels

`kappa1` undistorts, so its sign is opposite to OpenCV's k1, which distorts:
k1 is about -kappa1 f^2. Source: Tsai (1987), key tsai1987.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Columns of derivatives(): turns about the camera's x, y, z [rad], position [m], then the camera itself.
COLUMNS: Final = (
    "turn_x", "turn_y", "turn_z", "x", "y", "z", "focal_length", "kappa1", "sx", "centre_u", "centre_v",
)  # fmt: skip

# kappa1 ru^2 below which Xu = Xd (1 + kappa1 r^2) has no root: there r^2 = -1/(3 kappa1), the image folds over.
FOLD: Final = -4.0 / 27.0

# Below this |kappa1 ru^2| the series is exact to double precision and the closed form would divide 0 by 0.
_SERIES: Final = 1e-6

# Keeps trial steps of the solver finite where a point lies in the plane of the lens or on the fold.
_TINY: Final = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera and its pose, as the solver holds them.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        camera_from_world.
    position : ndarray, shape (3,)
        The point `origin` in the camera frame [m].
    origin : ndarray, shape (3,)
        A point of the world near the calibration points [m]; keeps a distant world origin out of the arithmetic.
    focal_length, kappa1, sx : float
        Focal length [m], radial distortion [m^-2], horizontal scale of the image.
    centre : tuple of float
        Image centre Cx, Cy [px].
    pixel : tuple of float
        Width and height of a pixel dx, dy [m].
    """

    rotation: Array
    position: Array
    origin: Array
    focal_length: float
    kappa1: float
    sx: float
    centre: tuple[float, float]
    pixel: tuple[float, float]

    @property
    def translation(self) -> Array:
        """The world's origin in the camera frame, shape (3,) [m]."""
        moved: Array = self.position - self.rotation @ self.origin
        return moved


def to_camera(camera: Camera, points: Array) -> Array:
    """Take points of the world, shape (n, 3) [m], into the camera frame."""
    inside: Array = (points - camera.origin) @ camera.rotation.T + camera.position
    return inside


def image_metric(camera: Camera, image: Array) -> Array:
    """Distorted image position Xd, Yd [m], shape (n, 2), of pixels u, v, shape (n, 2)."""
    (dx, dy), (cx, cy) = camera.pixel, camera.centre
    return np.column_stack([(image[:, 0] - cx) * dx / camera.sx, (image[:, 1] - cy) * dy])


def distort(undistorted: Array, kappa1: float) -> Array:
    """Invert Xu = Xd (1 + kappa1 r^2) by the closed form of the cubic.

    With w = r/ru and a = kappa1 ru^2 the cubic is a w^3 + w = 1. Its root that
    goes to 1 with a -> 0 is a hyperbolic sine for a > 0, a sine for a < 0.

    Parameters
    ----------
    undistorted : ndarray, shape (n, 2)
        Xu, Yu [m].
    kappa1 : float
        [m^-2].

    Returns
    -------
    ndarray, shape (n, 2)
        Xd, Yd [m]. Beyond the fold (see :func:`fold_margin`), where there is no root, w stays at its last value, 1.5.
    """
    if kappa1 == 0.0:
        return undistorted
    a = kappa1 * np.sum(undistorted**2, axis=1)
    size = np.maximum(np.abs(a), _SERIES)
    c = 2.0 / np.sqrt(3.0 * size)
    plus = c * np.sinh(np.arcsinh(3.0 / c) / 3.0)
    minus = c * np.sin(np.arcsin(np.minimum(3.0 / c, 1.0)) / 3.0)
    w = np.where(a > 0, plus, np.where(a > FOLD, minus, 1.5))
    w = np.where(np.abs(a) < _SERIES, 1.0 - a + 3.0 * a**2, w)
    return undistorted * w[:, None]


def fold_margin(camera: Camera, points: Array) -> float:
    """Smallest 1 + 3 kappa1 r^2 over the points: 0 where the image folds over, 1 without distortion."""
    undistorted = _undistorted(camera, points)
    distorted = distort(undistorted, camera.kappa1)
    if float(np.min(camera.kappa1 * np.sum(undistorted**2, axis=1))) <= FOLD:
        return 0.0
    return float(np.min(1.0 + 3.0 * camera.kappa1 * np.sum(distorted**2, axis=1)))


def _undistorted(camera: Camera, points: Array) -> Array:
    inside = to_camera(camera, points)
    depth = np.where(np.abs(inside[:, 2]) < _TINY, _TINY, inside[:, 2])
    image: Array = camera.focal_length * inside[:, :2] / depth[:, None]
    return image


def project(camera: Camera, points: Array) -> Array:
    """Pixels u, v, shape (n, 2) [px], of points of the world, shape (n, 3) [m].

    A point behind the camera is projected through the centre all the same: who calls looks at the depth.
    """
    (dx, dy), (cx, cy) = camera.pixel, camera.centre
    distorted = distort(_undistorted(camera, points), camera.kappa1)
    return np.column_stack([cx + camera.sx * distorted[:, 0] / dx, cy + distorted[:, 1] / dy])


def derivatives(camera: Camera, points: Array) -> Array:
    """Derivatives of u, v by everything that the camera consists of.

    Returns
    -------
    ndarray, shape (2 n, 11)
        Rows u0, v0, u1, v1, ... [px]; columns as in `COLUMNS`, in SI units. A turn is about the camera's own axes,
        through `origin`.
    """
    f, kappa1, sx, (dx, dy) = camera.focal_length, camera.kappa1, camera.sx, camera.pixel
    turned = (points - camera.origin) @ camera.rotation.T
    inside = turned + camera.position
    depth = np.where(np.abs(inside[:, 2]) < _TINY, _TINY, inside[:, 2])
    slope = inside[:, :2] / depth[:, None]

    # Undistorted image by position, then by turn (position moves by turn x turned), then by focal length.
    count = len(points)
    flat = np.zeros((count, 2, 8))
    flat[:, 0, 3] = flat[:, 1, 4] = f / depth
    flat[:, :, 5] = -f * slope / depth[:, None]
    flat[:, :, 0] = -flat[:, :, 4] * turned[:, 2:3] + flat[:, :, 5] * turned[:, 1:2]
    flat[:, :, 1] = flat[:, :, 3] * turned[:, 2:3] - flat[:, :, 5] * turned[:, 0:1]
    flat[:, :, 2] = -flat[:, :, 3] * turned[:, 1:2] + flat[:, :, 4] * turned[:, 0:1]
    flat[:, :, 6] = slope

    # Distortion: dXu = M dXd + r^2 Xd dkappa1, hence dXd = M^-1 (dXu - r^2 Xd dkappa1).
    distorted = distort(f * slope, kappa1)
    square = np.sum(distorted**2, axis=1)
    flat[:, :, 7] = -square[:, None] * distorted
    tangential = 1.0 + kappa1 * square
    radial = tangential + 2.0 * kappa1 * square
    radial = np.where(np.abs(radial) < _TINY, _TINY, radial)
    # M = tangential I + 2 kappa1 Xd Xd^T has the eigenvalues `radial` along Xd and `tangential` across.
    along = np.einsum("ni,nij->nj", distorted, flat)
    bent = flat / tangential[:, None, None]
    bent -= (2.0 * kappa1 / (tangential * radial))[:, None, None] * distorted[:, :, None] * along[:, None, :]

    found = np.zeros((count, 2, len(COLUMNS)))
    found[:, 0, :8] = bent[:, 0] * (sx / dx)
    found[:, 1, :8] = bent[:, 1] / dy
    found[:, 0, 8] = distorted[:, 0] / dx
    found[:, 0, 9] = found[:, 1, 10] = 1.0
    return found.reshape(2 * count, len(COLUMNS))


def cross_matrix(vector: Array) -> Array:
    """The matrix A with A x = vector x x."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turn(vector: Array) -> tuple[Array, Array]:
    """Rotation by |vector| about vector, and how it moves.

    Parameters
    ----------
    vector : ndarray, shape (3,)
        [rad].

    Returns
    -------
    ndarray, shape (3, 3)
        The rotation exp([vector]x), by Rodrigues' formula.
    ndarray, shape (3, 3)
        The left Jacobian J: exp([vector + d]x) = exp([J d]x) exp([vector]x) to first order in d.
    """
    angle = float(np.linalg.norm(vector))
    k = cross_matrix(vector)
    if angle < 1e-4:  # series: the next terms are below 1e-17
        a, b, c = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
        c = (1.0 - a) / angle**2
    return np.eye(3) + a * k + b * k @ k, np.eye(3) + b * k + c * k @ k


def nearest_rotation(matrix: Array) -> Array:
    """The rotation nearest to a matrix (3, 3), which removes what round-off left."""
    u, _, vt = np.linalg.svd(matrix)
    rotation: Array = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation


def moved(camera: Camera, **changes: object) -> Camera:
    """The same camera with some values changed."""
    return dataclasses.replace(camera, **changes)  # type: ignore[arg-type]
