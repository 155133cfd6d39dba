"""What a camera calibration says: values, standard errors, and how far to trust them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from radwrap.calibrate.camera_model import COLUMNS, Array, Camera, cross_matrix
from radwrap.frames import Rotation, Vector, fixed_axis_angles
from radwrap.manifest import SCHEMA_VERSION

# Below this cosine of the angle about y the angles about x and z are one angle, and have no standard errors.
_GIMBAL: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard errors, from the Jacobian and the residual variance; None for what was held.

    Attributes
    ----------
    focal_length : float or None
        [m].
    translation : tuple of float, shape (3,)
        [m].
    rotation : tuple of float, shape (3,), or None
        Of the angles about x, y, z [rad]; None where the angle about y is +-90 degrees.
    kappa1 : float or None
        [m^-2].
    sx : float or None
    centre : tuple of float or None
        [px].
    """

    focal_length: float | None
    translation: Vector
    rotation: Vector | None
    kappa1: float | None
    sx: float | None
    centre: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class LinearStage:
    """What the linear stage alone says; in the units of :class:`CameraCalibration`."""

    focal_length: float
    translation: Vector
    rotation: Rotation
    kappa1: float
    sx: float
    rms: float


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """A calibrated camera, how well it is known, and how it was found.

    Attributes
    ----------
    focal_length : float
        [m].
    translation : tuple of float, shape (3,)
        The world's origin in the camera frame [m].
    rotation : tuple of tuple of float, shape (3, 3)
        camera_from_world, R = Rz Ry Rx; see `angles`.
    kappa1 : float
        Xu = Xd (1 + kappa1 r^2) [m^-2].
    sx : float
        Horizontal scale of the image.
    centre : tuple of float
        Cx, Cy [px].
    rms : float
        Root mean square distance between predicted and observed image points [px].
    sse : float
        Sum of these distances squared [px^2].
    sigma : Errors
        Standard errors.
    covariance : ndarray, shape (11, 11)
        Of camera_model.COLUMNS: turn about the camera's axes, position of the points' centroid, focal length, kappa1,
        sx, centre; in SI units and px; 0 for what was held.
    centroid : tuple of float, shape (3,)
        Of the points, in the world [m].
    condition : float
        Condition number of the Jacobian by the free of these, its columns scaled to unit length.
    gradient_norm : float
        Norm of J^T r with these columns [px]: 0 at a true minimum.
    predicted_decrease : float
        By how much a further step of Gauss-Newton would lower `sse` [px^2].
    linear_stage : LinearStage or None
        None where it gave no positive focal length and depth, and assumed ones had to do.
    residuals : ndarray, shape (n, 2)
        Predicted minus observed u, v [px].
    solver : str
        "tsai" or "opencv".
    free : tuple of str
        What was found beside the pose.
    points : int
    coplanar : bool
    tilt : float or None
        Angle between the normal of coplanar points and the optical axis [rad].
    notes : tuple of str
        What to know before relying on the numbers.
    """

    focal_length: float
    translation: Vector
    rotation: Rotation
    kappa1: float
    sx: float
    centre: tuple[float, float]
    rms: float
    sse: float
    sigma: Errors
    covariance: Array = field(repr=False, compare=False)
    centroid: Vector
    condition: float
    gradient_norm: float
    predicted_decrease: float
    linear_stage: LinearStage | None
    residuals: Array = field(repr=False, compare=False)
    solver: str
    free: tuple[str, ...]
    points: int
    coplanar: bool
    tilt: float | None
    notes: tuple[str, ...]

    @property
    def angles(self) -> Vector:
        """Angles about x, y, z [rad] of R = Rz Ry Rx."""
        return fixed_axis_angles(self.rotation)


def as_json(found: CameraCalibration) -> dict[str, Any]:
    """What ``radwrap calibrate camera --json`` prints: SI units, but angles in degrees; null for what was held."""
    sigma, linear = found.sigma, found.linear_stage
    return {
        "schema_version": SCHEMA_VERSION,
        "focal_length": found.focal_length,
        "translation": found.translation,
        "rotation_deg": _degrees(found.angles),
        "kappa1": found.kappa1,
        "sx": found.sx,
        "centre": found.centre,
        "rms_px": found.rms,
        "sse_px2": found.sse,
        "sigma": {
            "focal_length": sigma.focal_length,
            "translation": sigma.translation,
            "rotation_deg": None if sigma.rotation is None else _degrees(sigma.rotation),
            "kappa1": sigma.kappa1,
            "sx": sigma.sx,
            "centre": sigma.centre,
        },
        "centroid": found.centroid,
        "covariance": found.covariance.tolist(),
        "condition": found.condition,
        "gradient_norm": found.gradient_norm,
        "predicted_decrease_px2": found.predicted_decrease,
        "linear_stage": None
        if linear is None
        else {
            "focal_length": linear.focal_length,
            "translation": linear.translation,
            "rotation_deg": _degrees(fixed_axis_angles(linear.rotation)),
            "kappa1": linear.kappa1,
            "sx": linear.sx,
            "rms_px": linear.rms,
        },
        "solver": found.solver,
        "free": found.free,
        "points": found.points,
        "coplanar": found.coplanar,
        "tilt_deg": None if found.tilt is None else math.degrees(found.tilt),
        "notes": found.notes,
    }


def _degrees(angles: Vector) -> Vector:
    x, y, z = map(math.degrees, angles)
    return x, y, z


def standard_errors(camera: Camera, covariance: Array, free: frozenset[str]) -> Errors:
    """Standard errors of what is reported, from the covariance of `COLUMNS`, shape (11, 11)."""
    sigma = dict(zip(COLUMNS, map(float, np.sqrt(np.diag(covariance))), strict=True))
    # The world's origin is position - R origin; a turn moves R origin, too.
    moves = np.hstack([cross_matrix(camera.rotation @ camera.origin), np.eye(3)])
    translation = np.sqrt(np.diag(moves @ covariance[:6, :6] @ moves.T))
    # A turn is dz about z, dy about the y axis turned by z, dx about the x axis turned by z and y.
    _, about_y, about_z = fixed_axis_angles(rotation(camera.rotation))
    c, s, cy, sy = math.cos(about_z), math.sin(about_z), math.cos(about_y), math.sin(about_y)
    angles = None
    if abs(cy) > _GIMBAL:
        rates = np.linalg.inv(np.array([[c * cy, -s, 0.0], [s * cy, c, 0.0], [-sy, 0.0, 1.0]]))
        angles = vector(np.sqrt(np.diag(rates @ covariance[:3, :3] @ rates.T)))
    return Errors(
        sigma["focal_length"] if "focal_length" in free else None,
        vector(translation),
        angles,
        sigma["kappa1"] if "distortion" in free else None,
        sigma["sx"] if "sx" in free else None,
        (sigma["centre_u"], sigma["centre_v"]) if "centre" in free else None,
    )


def vector(values: Array) -> Vector:
    """Three plain numbers."""
    x, y, z = map(float, values)
    return x, y, z


def rotation(matrix: Array) -> Rotation:
    """A rotation as plain numbers, row by row."""
    return vector(matrix[0]), vector(matrix[1]), vector(matrix[2])
