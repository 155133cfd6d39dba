"""How far the projection of a point may be off, by the noise of the points of a calibration.

Source: mrcal (uncertainty of projection, "mean-pcam").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from radwrap.calibrate.camera_model import Array, cross_matrix, turn
from radwrap.calibrate.opencv_views import project_points
from radwrap.calibrate.several_views import ViewsCalibration
from radwrap.calibrate.views import COEFFICIENTS, MATRIX, POSE, free_columns
from radwrap.errors import InputError

_STEPS: Final = 50
_ARRIVED: Final = 1e-9  # px
_COLUMNS: Final = 9
_ROWS: Final = 7


class NoPlace(InputError):
    """Some pixels are the image of no direction."""


def projection_uncertainty(found: ViewsCalibration, image: Array, distance: float) -> Array:
    """How far the projection of a point that stands still may be off, by the noise of the calibration's points.

    A solution with other noise has another camera, and its targets elsewhere in the camera's frame. A point is held by
    its place beside the targets, which gives it as many places in the new frame as there are views; their mean is
    projected by the new camera. That is how mrcal defines it (mrcal): errors of the camera that its pose makes up for
    do not count.

    Parameters
    ----------
    found : ViewsCalibration
        Its noise is that of the points.
    image : ndarray, shape (n, 2)
        Where the points are seen [px].
    distance : float
        From the camera's centre [m]; infinite for directions.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        Covariance of u, v [px^2].

    Examples
    --------
    >>> from radwrap.calibrate.several_views import calibrate_views
    >>> from radwrap.calibrate.views import CalibrationView
    >>> board = np.array([[x, y, 0.0] for y in range(6) for x in range(8)]) * 0.02
    >>> shown = []
    >>> for k in range(6):
    ...     turned = turn(np.array([0.4 * np.cos(k), 0.4 * np.sin(k), 0.1 * k]))[0]
    ...     seen = board @ turned.T + [-0.07, -0.05, 0.4]
    ...     shown.append(CalibrationView(board, 600 * seen[:, :2] / seen[:, 2:] + [320, 240], str(k)))
    >>> found = calibrate_views(shown, (640, 480), noise=0.1)
    >>> covariance = projection_uncertainty(found, np.array([[320.0, 240.0], [0.0, 0.0]]), 0.4)
    >>> middle, corner = np.sqrt(np.linalg.eigvalsh(covariance)[:, -1])
    >>> bool(middle < corner)
    True
    """
    if not distance > 0:
        raise InputError("must be above 0 m", where="distance")
    camera, spread = _camera_vector(found), found.spread
    seen = _directions(camera, image)
    places = seen if math.isinf(distance) else seen * distance
    free = free_columns(found.model)
    _, jacobian = project_points(places, camera, np.zeros(POSE))
    by_place = jacobian[:, 3:6].reshape(-1, 2, 3)
    by_camera = jacobian[:, POSE:][:, free].reshape(-1, 2, len(free))
    covariance = np.zeros((len(image), 2, 2))
    views = len(spread.poses)
    for pose, own, follows in zip(spread.poses, spread.own, spread.follows, strict=True):
        by_turn = turn(pose[:3])[1]
        moved = np.zeros((len(image), 3, POSE))
        arms = places if math.isinf(distance) else places - pose[3:]
        moved[:, :, :3] = [-cross_matrix(arm) @ by_turn for arm in arms]
        if not math.isinf(distance):
            moved[:, :, 3:] = np.eye(3)
        by_pose = by_place @ moved / views
        by_camera = by_camera - by_pose @ follows
        alone = by_pose @ own
        covariance += alone @ alone.transpose(0, 2, 1)
    covariance += by_camera @ spread.parameters @ by_camera.transpose(0, 2, 1)
    return found.noise**2 * covariance


@dataclass(frozen=True, slots=True)
class UncertaintyOverImage:
    """Standard error of the projection in its worst direction, over the image.

    Attributes
    ----------
    distance : float
        From the camera [m]; infinite for directions.
    columns, rows : tuple of float
        Where it is told [px].
    sigma : tuple of tuple of float
        By row and column [px].
    """

    distance: float
    columns: tuple[float, ...]
    rows: tuple[float, ...]
    sigma: tuple[tuple[float, ...], ...]


def uncertainty_over_image(
    found: ViewsCalibration, distance: float, grid: tuple[int, int] = (_COLUMNS, _ROWS)
) -> UncertaintyOverImage:
    """The projection's standard error on a grid of so many columns and rows over the whole image, corners in.

    Raises
    ------
    InputError
        As `projection_uncertainty`.
    """
    wide, high = found.image_size
    columns, rows = (np.linspace(0, size - 1, number) for size, number in zip((wide, high), grid, strict=True))
    places = np.array([(u, v) for v in rows for u in columns])
    sigma = np.sqrt(np.linalg.eigvalsh(projection_uncertainty(found, places, distance))[:, -1])
    by_row = sigma.reshape(grid[::-1]).tolist()
    return UncertaintyOverImage(distance, tuple(columns.tolist()), tuple(rows.tolist()), tuple(map(tuple, by_row)))


def _camera_vector(found: ViewsCalibration) -> Array:
    camera = np.zeros(len(MATRIX) + len(COEFFICIENTS))
    m = found.camera_matrix
    camera[:4] = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
    camera[4 : 4 + len(found.distortion_coefficients)] = found.distortion_coefficients
    return camera


def _directions(camera: Array, image: Array) -> Array:
    """Unit vectors of the camera's frame that are seen at pixels, by Newton's method from the undistorted place."""
    flat = (image - camera[2:4]) / camera[:2]
    for _ in range(_STEPS):
        shown, jacobian = project_points(np.column_stack([flat, np.ones(len(flat))]), camera, np.zeros(POSE))
        missed = shown - image
        if float(np.abs(missed).max(initial=0.0)) < _ARRIVED:
            break
        # At a depth of 1 a point's move across is that of its direction.
        flat = flat - np.linalg.solve(jacobian[:, 3:5].reshape(-1, 2, 2), missed[:, :, None])[:, :, 0]
    else:
        raise NoPlace(
            "the distortion has no place for some pixels",
            where="image",
            remedy="ask nearer to the calibration's points",
        )
    rays = np.column_stack([flat, np.ones(len(flat))])
    units: Array = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return units
