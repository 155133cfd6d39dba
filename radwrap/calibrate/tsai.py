"""Camera calibration from one view: known points and where their images lie (Tsai 1987).

The linear stage (:mod:`radwrap.calibrate.tsai_linear`) gives start values, the
full least squares over everything that is free
(:mod:`radwrap.calibrate.tsai_refine`) the result. What is minimised is the
distance in pixels between the observed u, v and those of the projected,
distorted point. What no numbers can tell is refused before, what these numbers
did not tell afterwards, each with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from radwrap.calibrate.camera_model import Array, Camera, fold_margin, moved, project
from radwrap.calibrate.opencv_solver import opencv_minimum
from radwrap.calibrate.tsai_checks import DOUBTFUL_MISFIT, check_found, check_points, check_request, misfit
from radwrap.calibrate.tsai_linear import cloud_of, start_values
from radwrap.calibrate.tsai_refine import Minimum, physical_columns, refine
from radwrap.calibrate.tsai_result import (
    CameraCalibration,
    Errors,
    LinearStage,
    as_json,
    rotation,
    standard_errors,
    vector,
)
from radwrap.errors import InputError

SOLVERS: Final = ("tsai", "opencv")

# The mirror pose counts as a rival where its sum of squares is larger by less than this many residual variances.
_RIVAL: Final = 9.0


def calibrate_camera(
    points: ArrayLike,
    image: ArrayLike,
    *,
    pixel_width: float,
    pixel_height: float,
    centre: tuple[float, float],
    solver: str = "tsai",
    free: Iterable[str] = ("focal_length",),
    focal_length: float | None = None,
    kappa1: float | None = None,
    sx: float | None = None,
    near: CameraCalibration | None = None,
) -> CameraCalibration:
    """Pose and constants of a camera from one view of known points.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Points in the world [m]; at least 5 in any one plane, or 7 in space.
    image : array_like, shape (n, 2)
        Their images u, v [px], u to the right, v down.
    pixel_width, pixel_height : float
        Pitch of the pixels dx, dy [m].
    centre : tuple of float
        Image centre Cx, Cy [px]; a start value where it is free.
    solver : str
        "tsai", or "opencv" for cv2.calibrateCamera on the same points.
    free : iterable of str
        What to find beside the pose: "focal_length", "distortion" (kappa1), "centre", "sx".
    focal_length, kappa1, sx : float, optional
        What to hold where it is not free [m], [m^-2], [1]; kappa1 is 0 and sx is 1 unless given.
    near : CameraCalibration, optional
        From images a little beside these: its minimum is followed, in place of a search from the linear stage. A mirror
        pose that has come to fit better meanwhile goes unseen.

    Returns
    -------
    CameraCalibration
        At the least-squares minimum.

    Raises
    ------
    InputError
        If the points cannot tell what is asked for, with the reason: see :mod:`radwrap.calibrate.tsai_checks`.

    Examples
    --------
    >>> import numpy as np, radwrap
    >>> x, y = np.meshgrid(np.linspace(-0.04, 0.04, 5), np.linspace(-0.04, 0.04, 5))
    >>> board = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    >>> seen = board @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]).T + [0, 0, 0.8]  # tilted, 0.8 m away
    >>> image = 0.0125 / 1e-5 * seen[:, :2] / seen[:, 2:] + 100
    >>> found = radwrap.calibrate_camera(board, image, pixel_width=1e-5, pixel_height=1e-5, centre=(100, 100))
    >>> bool(abs(found.focal_length - 0.0125) < 1e-4)
    True

    Notes
    -----
    Tsai (1987), key tsai1987. A mirrored image of a flat board cannot be told from its back seen unmirrored: u must run
    to the right and v down.
    """
    wanted = check_request(free, solver, SOLVERS, focal_length=focal_length, kappa1=kappa1, sx=sx)
    world, seen, flat = check_points(
        points, image, wanted, pixel=(pixel_width, pixel_height), centre=centre, kappa1=kappa1
    )
    cloud = cloud_of(world)
    held = Camera(
        np.eye(3),
        np.zeros(3),
        cloud.centroid,
        math.nan if focal_length is None else focal_length,
        kappa1 or 0.0,
        1.0 if sx is None else sx,
        (float(centre[0]), float(centre[1])),
        (float(pixel_width), float(pixel_height)),
    )
    linear: list[Camera] = []
    tried: list[Minimum] = []
    if near is None:
        linear, guessed = start_values(held, world, seen, cloud, wanted, flat=flat)
        starts = linear + guessed
        if not starts:
            raise InputError(
                "leave the pose undetermined by the radial alignment constraint",
                where="the points",
                remedy="use more points, no four of five on a line",
            )
        # Where the centre is free, distortion and pose come first: they must not chase a wrong centre at the start.
        firm = wanted - {"centre"}
        tried = [refine(start, world, seen, firm, thorough=False) for start in starts]
        best = min(tried, key=lambda found: found.sse).camera
    else:
        best = _camera_of(near, held, wanted)
        starts = [best]
    if solver == "opencv":
        found = opencv_minimum(starts[0], world, seen, cloud.axes, wanted)
    else:
        found = refine(best, world, seen, wanted)
    freedom = 2 * len(world) - len(physical_columns(wanted))
    variance = found.sse / freedom
    covariance = variance * found.spread @ found.spread.T
    tilt = _tilt(found.camera, cloud.axes) if flat else None
    check_found(found, world, seen, wanted, tilt=tilt, kappa1_error=math.sqrt(covariance[7, 7]))
    notes = [*_rival(tried, found, cloud.axes, variance)] if flat else []
    if (share := misfit(found, seen)) > DOUBTFUL_MISFIT:
        notes.append(f"the residuals are {100.0 * share:.1f} % of the image's size: something is not in the model")
    if solver == "opencv" and "distortion" in wanted:
        notes.append(
            "kappa1 = -k1/f^2 from OpenCV's k1 agrees to first order: it may be off by about "
            f"{1.0 - fold_margin(found.camera, world):.1g} of itself"
        )
    return _result(
        found,
        _linear_stage(linear[0], world, seen) if linear else None,
        len(world),
        covariance=covariance,
        tilt=tilt,
        solver=solver,
        free=wanted,
        notes=tuple(notes),
    )


def _camera_of(near: CameraCalibration, held: Camera, wanted: frozenset[str]) -> Camera:
    """Where to start from a calibration: its pose and what is wanted, with the points' centroid for its origin."""
    turn = np.array(near.rotation)
    return moved(
        held,
        rotation=turn,
        position=turn @ held.origin + np.array(near.translation),
        focal_length=near.focal_length if "focal_length" in wanted else held.focal_length,
        kappa1=near.kappa1 if "distortion" in wanted else held.kappa1,
        sx=near.sx if "sx" in wanted else held.sx,
        centre=near.centre if "centre" in wanted else held.centre,
    )


def _tilt(camera: Camera, axes: Array) -> float:
    """Angle between the points' plane and the image plane [rad], without the loss of digits of an arc cosine at 0."""
    normal = camera.rotation @ axes[:, 2]
    return math.atan2(math.hypot(normal[0], normal[1]), abs(normal[2]))


def _rival(tried: list[Minimum], found: Minimum, axes: Array, variance: float) -> Iterable[str]:
    """Say so where the mirror pose of a board fits the points as well."""
    normal = found.camera.rotation @ axes[:, 2]
    for other in tried:
        angle = math.degrees(math.acos(min(1.0, abs(float(normal @ other.camera.rotation @ axes[:, 2])))))
        if angle > 1.0 and other.sse - found.sse < _RIVAL * variance:
            yield f"a pose whose board is turned by {angle:.1f} degrees against this one fits the points about as well"
            return


def _linear_stage(start: Camera, points: Array, image: Array) -> LinearStage:
    distances = np.sum((project(start, points) - image) ** 2, axis=1)
    return LinearStage(
        start.focal_length,
        vector(start.translation),
        rotation(start.rotation),
        start.kappa1,
        start.sx,
        math.sqrt(float(distances.mean())),
    )


def _result(
    found: Minimum,
    linear: LinearStage | None,
    points: int,
    *,
    covariance: Array,
    tilt: float | None,
    solver: str,
    free: frozenset[str],
    notes: tuple[str, ...],
) -> CameraCalibration:
    camera = found.camera
    return CameraCalibration(
        focal_length=camera.focal_length,
        translation=vector(camera.translation),
        rotation=rotation(camera.rotation),
        kappa1=camera.kappa1,
        sx=camera.sx,
        centre=camera.centre,
        rms=math.sqrt(found.sse / points),
        sse=found.sse,
        sigma=standard_errors(camera, covariance, free),
        covariance=covariance,
        centroid=vector(camera.origin),
        condition=found.condition,
        gradient_norm=found.gradient_norm,
        predicted_decrease=found.predicted_decrease,
        linear_stage=linear,
        residuals=found.residuals,
        solver=solver,
        free=tuple(name for name in ("focal_length", "distortion", "centre", "sx") if name in free),
        points=points,
        coplanar=tilt is not None,
        tilt=tilt,
        notes=notes,
    )


__all__ = ["SOLVERS", "CameraCalibration", "Errors", "LinearStage", "as_json", "calibrate_camera"]
