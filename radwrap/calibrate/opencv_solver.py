"""A second opinion on the same points: OpenCV's calibrateCamera.

OpenCV takes points in single precision (6e-8 of their size, some 1e-6 px here) and
distorts, xd = xu (1 + k1 ru^2) with xu = Xu / f, where Tsai undistorts. Its k1
becomes kappa1 = -k1 / f^2: equal to first order, and off by about
3 kappa1 r^2 of itself at the radius r. Its pinhole model is the same.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from radwrap.calibrate.camera_model import COLUMNS, Array, Camera, moved, turn
from radwrap.calibrate.tsai_refine import Minimum, gradient_and_condition, physical_columns
from radwrap.errors import InputError

_ITERATIONS: Final = 1000


def opencv_minimum(start: Camera, points: Array, image: Array, axes: Array, free: frozenset[str]) -> Minimum:
    """Where OpenCV's calibrateCamera ends from a start value.

    Parameters
    ----------
    start : Camera
        With the values that are held; `origin` is the points' centroid.
    points : ndarray, shape (n, 3)
        [m].
    image : ndarray, shape (n, 2)
        u, v [px].
    axes : ndarray, shape (3, 3)
        world_from_plane of the points' best plane: OpenCV wants coplanar points at z = 0.
    free : frozenset of str
        As for :func:`radwrap.calibrate.tsai_refine.refine`.

    Returns
    -------
    Minimum
        Residuals are those of OpenCV's own model; the gradient tells how near to its minimum it stopped.

    Raises
    ------
    InputError
        If kappa1 is held at another value than 0, which OpenCV's form cannot, or if OpenCV refuses the points.
    """
    import cv2

    if "distortion" not in free and start.kappa1 != 0.0:
        raise InputError(
            f"OpenCV cannot hold kappa1 at {start.kappa1:g} /m^2: it distorts where Tsai undistorts",
            where="kappa1",
            remedy="free the distortion, or use the solver tsai",
        )
    (dx, dy), f = start.pixel, start.focal_length
    # Pixels about the image centre, so that no digits of their single precision are spent on where the centre lies. The
    # image must hold the centre; points outside it do no harm.
    middle = np.array(start.centre)
    size = 1 + int(np.max(np.abs(image - middle)))
    matrix = np.array([[f * start.sx / dx, 0.0, 0.0], [0.0, f / dy, 0.0], [0.0, 0.0, 1.0]])
    coefficients = np.array([-start.kappa1 * f**2, 0.0, 0.0, 0.0, 0.0])
    local = np.ascontiguousarray((points - start.origin) @ axes, dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, _ITERATIONS, float(np.finfo(float).eps))
    try:
        _, matrix, coefficients, turns, places = cv2.calibrateCamera(
            [local],
            [np.ascontiguousarray(image - middle, dtype=np.float32)],
            (size, size),
            matrix,
            coefficients,
            flags=_flags(free),
            criteria=criteria,
        )
    except cv2.error as error:
        raise InputError(
            f"calibrateCamera refused the points: {error.err}", where="OpenCV", remedy="use the solver tsai"
        ) from error
    turned = np.asarray(turns[0], dtype=np.float64).ravel()
    placed = np.asarray(places[0], dtype=np.float64).ravel()
    predicted, by_opencv = cv2.projectPoints(local.astype(np.float64), turned, placed, matrix, coefficients)
    residuals = np.asarray(predicted).reshape(-1, 2) + middle - image

    rotation, left = turn(turned)
    # What is held stays what it was, to the last bit: in pixels and back it would be off by that.
    focal_length = float(matrix[1, 1]) * dy if "focal_length" in free else f
    camera = moved(
        start,
        rotation=rotation @ axes.T,
        position=placed,
        focal_length=focal_length,
        kappa1=-float(np.ravel(coefficients)[0]) / focal_length**2,
        sx=float(matrix[0, 0]) * dx / focal_length if "sx" in free else start.sx,
        centre=(float(matrix[0, 2] + middle[0]), float(matrix[1, 2] + middle[1])),
    )
    columns = physical_columns(free)
    jacobian = _as_ours(np.asarray(by_opencv), left, camera)[:, columns]
    gradient, condition = gradient_and_condition(jacobian, residuals)
    lengths = np.linalg.norm(jacobian, axis=0)
    basis, sizes, vt = np.linalg.svd(jacobian / lengths, full_matrices=False)
    spread = np.zeros((len(COLUMNS), len(columns)))
    spread[columns] = (vt.T / np.maximum(sizes, np.finfo(float).eps * sizes[0])) / lengths[:, None]
    decrease = float(np.sum((basis.T @ residuals.ravel()) ** 2))
    return Minimum(camera, residuals, float(np.sum(residuals**2)), gradient, decrease, condition, spread, True)


def _flags(free: frozenset[str]) -> int:
    """What calibrateCamera is to hold."""
    import cv2

    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    for name, flag in (
        ("focal_length", cv2.CALIB_FIX_FOCAL_LENGTH),
        ("distortion", cv2.CALIB_FIX_K1),
        ("centre", cv2.CALIB_FIX_PRINCIPAL_POINT),
        ("sx", cv2.CALIB_FIX_ASPECT_RATIO),
    ):
        flags |= 0 if name in free else flag
    return int(flags)


def _as_ours(by_opencv: Array, left: Array, camera: Camera) -> Array:
    """Derivatives by `COLUMNS` from those of cv2.projectPoints (turn, place, fx, fy, cx, cy, k1, ...)."""
    (dx, dy), f = camera.pixel, camera.focal_length
    fx, fy, k1 = by_opencv[:, 6], by_opencv[:, 7], by_opencv[:, 10]
    return np.column_stack(
        [
            by_opencv[:, 0:3] @ np.linalg.inv(left),
            by_opencv[:, 3:6],
            fx * camera.sx / dx + fy / dy - 2.0 * camera.kappa1 * f * k1,
            -(f**2) * k1,
            fx * f / dx,
            by_opencv[:, 8:10],
        ]
    )
