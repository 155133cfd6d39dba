"""What OpenCV does for several views: its projection with derivatives, and its own calibration as a start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radwrap.calibrate.camera_model import Array
from radwrap.calibrate.views import COEFFICIENTS, MATRIX, CalibrationView, DistortionModel
from radwrap.errors import InputError


def project_points(points: Array, camera: Array, pose: Array) -> tuple[Array, Array]:
    """Pixels of points, and their derivatives by rotation vector, translation, fx, fy, cx, cy and coefficients.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        [m].
    camera : ndarray, shape (16,)
        fx, fy, cx, cy, and OpenCV's coefficients.
    pose : ndarray, shape (6,)
        Rotation vector [rad], translation [m].

    Returns
    -------
    image : ndarray, shape (n, 2)
    jacobian : ndarray, shape (2 n, 22)
    """
    import cv2

    matrix = np.array([[camera[0], 0, camera[2]], [0, camera[1], camera[3]], [0, 0, 1.0]])
    shown, jacobian = cv2.projectPoints(np.ascontiguousarray(points), pose[:3], pose[3:], matrix, camera[4:])
    return np.asarray(shown, dtype=np.float64).reshape(-1, 2), np.asarray(jacobian, dtype=np.float64)


def opencv_start(
    views: Sequence[CalibrationView], size: tuple[int, int], model: DistortionModel, *, flat: bool
) -> tuple[Array, Array]:
    """Where OpenCV's calibrateCamera ends: a camera, shape (16,), and poses, shape (views, 6)."""
    import cv2

    flags = {"brown": 0, "rational": cv2.CALIB_RATIONAL_MODEL, "thin_prism": cv2.CALIB_THIN_PRISM_MODEL}[model]
    if model == "thin_prism":
        flags |= cv2.CALIB_FIX_K4 | cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6
    matrix, coefficients = np.eye(3), np.zeros(len(COEFFICIENTS))
    if not flat:
        # Where points are not flat OpenCV wants a camera to begin with.
        matrix = np.array([[max(size), 0, (size[0] - 1) / 2], [0, max(size), (size[1] - 1) / 2], [0, 0, 1.0]])
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    points = [
        np.ascontiguousarray(view.points * [1, 1, 0] if flat else view.points, dtype=np.float32) for view in views
    ]
    image = [np.ascontiguousarray(view.image, dtype=np.float32) for view in views]
    # Several threads add up in the order in which they end: the same points would not give the same bytes.
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        _, found, given, turns, places = cv2.calibrateCamera(points, image, size, matrix, coefficients, flags=flags)
    except cv2.error as error:
        raise InputError(
            f"calibrateCamera refused the points: {error.err}", where="OpenCV", remedy="look for wrong points"
        ) from error
    finally:
        cv2.setNumThreads(threads)
    camera = np.zeros(len(MATRIX) + len(COEFFICIENTS))
    camera[:4] = found[0, 0], found[1, 1], found[0, 2], found[1, 2]
    bent = np.ravel(given)[: len(COEFFICIENTS)]
    camera[4 : 4 + len(bent)] = bent
    poses = np.array([[*np.ravel(a), *np.ravel(b)] for a, b in zip(turns, places, strict=True)], dtype=np.float64)
    if not (np.isfinite(camera).all() and np.isfinite(poses).all() and (camera[:2] > 0).all()):
        raise InputError("calibrateCamera found no camera", where="OpenCV", remedy="look for wrong points")
    return camera, poses
