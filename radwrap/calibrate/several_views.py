"""A camera from several views of a target: OpenCV's models, by our own least squares, with the whole covariance.

Sources: zhang2000 for the start, opencv_calib3d for the distortion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from radwrap.calibrate.camera_model import Array, cross_matrix, turn
from radwrap.calibrate.opencv_views import opencv_start
from radwrap.calibrate.views import (
    COEFFICIENTS,
    MATRIX,
    MODELS,
    POSE,
    CalibrationView,
    DistortionModel,
    coefficients_of,
    free_columns,
)
from radwrap.calibrate.views_solver import Spread, State, cost_of, descended, residuals_of, spread_about
from radwrap.errors import InputError

# Smallest singular value, over the largest, of the derivatives with columns of unit length: below it the points do not
# tell what is free, and round-off decides.
_DETERMINED: Final = 1e-10
# The same below which standard errors of first order no longer hold for single coefficients: it is where a change of
# one standard error bends the model by as much as it moves it, for noise of some tenths of a pixel.
_TOLD_APART: Final = 1e-5
# Share of the focal length from which on its standard error is of first order only, and its value may be far off.
_HARDLY_KNOWN: Final = 0.05
# The gradient over the residuals up to which the minimum counts as reached: the cost can fall by 1e-10 of it.
_REACHED: Final = 1e-5
_ROUND_OFF: Final = 1e-7  # px, of the whole gradient where points are exact
_BESIDE: Final = 1.0  # px; a point may be found so far beside the image
_FAR: Final = 1e3  # of the points' median distance from their middle
_FLAT: Final = 1e-6  # height over a plane, over the target's size, at which points count as coplanar
_TILTED: Final = "give views that fill the image and are tilted about both axes, or a model with fewer coefficients"


@dataclass(frozen=True, slots=True, eq=False)
class PosedView:
    """Where a view's target stands.

    Attributes
    ----------
    name : str
    points : int
    rotation : ndarray, shape (3, 3)
        camera_from_target.
    translation : ndarray, shape (3,)
        The target's origin in the camera's frame [m].
    distance : float
        From the camera's centre to the mean of its points [m].
    covariance : ndarray, shape (6, 6)
        Of turns about the camera's axes, which leave the translation alone [rad], and of the translation [m].
    rms : float
        Of its points' distances to where they are predicted [px].
    """

    name: str
    points: int
    rotation: Array
    translation: Array
    distance: float
    covariance: Array
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class ViewsCalibration:
    """A camera from several views.

    Attributes
    ----------
    model : {"brown", "rational", "thin_prism"}
        Of distortion.
    image_size : tuple of int
        Columns and rows [px].
    camera_matrix : ndarray, shape (3, 3)
        [px].
    distortion_coefficients : ndarray, shape (5,), (8,) or (12,)
        In OpenCV's order.
    parameters : tuple of str
        What is free, beside poses: the order of `covariance`.
    covariance : ndarray, shape (p, p)
        Of them, for points whose noise is `noise`; lengths in px.
    noise : float
        Standard deviation of a coordinate [px]: as given, or by the residuals and their degrees of freedom.
    noise_given : bool
        Whether it was given.
    views : tuple of PosedView
    rms : float
        Of all points' distances [px].
    cost : float
        Sum of squared residuals [px^2].
    opencv_cost : float
        The same where OpenCV ended.
    gradient_norm : float
        Of the residuals' projection on the tangent plane, over the residuals; 0 where the minimum is exact.
    degrees_of_freedom : int
    notes : tuple of str
        What a user of the numbers must know.
    spread : Spread
        For `projection_uncertainty`.
    """

    model: DistortionModel
    image_size: tuple[int, int]
    camera_matrix: Array
    distortion_coefficients: Array
    parameters: tuple[str, ...]
    covariance: Array
    noise: float
    noise_given: bool
    views: tuple[PosedView, ...]
    rms: float
    cost: float
    opencv_cost: float
    gradient_norm: float
    degrees_of_freedom: int
    notes: tuple[str, ...]
    spread: Spread

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of `distortion_coefficients`."""
        return COEFFICIENTS[: len(self.distortion_coefficients)]

    @property
    def sigma(self) -> dict[str, float]:
        """Standard error of each parameter [px, or none]."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def calibrate_views(
    views: Sequence[CalibrationView],
    image_size: tuple[int, int],
    *,
    model: DistortionModel = "brown",
    noise: float | None = None,
) -> ViewsCalibration:
    """Camera matrix, distortion and poses that fit points best in the sense of least squares.

    Parameters
    ----------
    views : sequence of CalibrationView
        All of one target, or of targets whose points share a frame.
    image_size : tuple of int
        Columns and rows [px].
    model : {"brown", "rational", "thin_prism"}
        Distortion: k1, k2, p1, p2, k3; besides k4, k5, k6; or k1 to k3, p1, p2 and s1 to s4.
    noise : float, optional
        Standard deviation of each coordinate [px]; by default that of the residuals.

    Raises
    ------
    InputError
        If there are too few points, or they do not determine what is free; it names what is known least.

    Examples
    --------
    >>> import numpy as np
    >>> board = np.array([[x, y, 0.0] for y in range(6) for x in range(8)]) * 0.02
    >>> shown = []
    >>> for k in range(6):
    ...     turned = turn(np.array([0.4 * np.cos(k), 0.4 * np.sin(k), 0.1 * k]))[0]
    ...     seen = board @ turned.T + [-0.07, -0.05, 0.4]
    ...     shown.append(CalibrationView(board, 600 * seen[:, :2] / seen[:, 2:] + [320, 240], str(k)))
    >>> found = calibrate_views(shown, (640, 480))
    >>> round(float(found.camera_matrix[0, 0]), 6)
    600.0
    """
    if model not in MODELS:
        raise InputError(f"must be one of {', '.join(MODELS)}", where="model")
    if noise is not None and not (math.isfinite(noise) and noise > 0):
        raise InputError("must be above 0 px", where="noise")
    if min(image_size) < 1:
        raise InputError("must be columns and rows, 1 at least", where="image_size")
    _check_number(views, model)
    _check_views(views, image_size)
    axes, origin, flat = _frame(views)
    local = [CalibrationView((view.points - origin) @ axes, view.image, view.name) for view in views]
    free = free_columns(model)
    start = State(*opencv_start(local, image_size, model, flat=flat))
    opencv_cost = cost_of(local, start)
    state, sizes = descended(local, start, free)
    names = (*MATRIX, *MODELS[model])
    _check_determined(sizes, names)
    tangent, spread = spread_about(local, state, free, axes, origin)
    residuals = [residuals_of(view, state.camera, pose) for view, pose in zip(local, state.poses, strict=True)]
    cost = float(sum(np.sum(part**2) for part in residuals))
    if not tangent <= _REACHED * math.sqrt(cost) + _ROUND_OFF:
        raise InputError(
            "no minimum was reached: views that are hardly tilted, or about one axis only, do not separate the focal "
            "length from the distance",
            where="views",
            remedy=f"{_TILTED}; look for wrong points",
        )
    _check_in_front(local, state)
    count = sum(len(view.points) for view in views)
    freedom = 2 * count - len(free) - POSE * len(views)
    known = math.sqrt(cost / freedom) if noise is None else noise
    fx, fy, cx, cy = state.camera[:4]
    return ViewsCalibration(
        model=model,
        image_size=image_size,
        camera_matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion_coefficients=state.camera[4 : 4 + coefficients_of(model)],
        parameters=names,
        covariance=known**2 * spread.parameters,
        noise=known,
        noise_given=noise is not None,
        views=tuple(
            _posed(view, spread, k, part, known) for k, (view, part) in enumerate(zip(local, residuals, strict=True))
        ),
        rms=math.sqrt(cost / count),
        cost=cost,
        opencv_cost=opencv_cost,
        gradient_norm=tangent / math.sqrt(cost) if cost > 0 else 0.0,
        degrees_of_freedom=freedom,
        notes=tuple(_notes(sizes, model, known**2 * spread.parameters, state.camera)),
        spread=spread,
    )


def _check_number(views: Sequence[CalibrationView], model: DistortionModel) -> None:
    names = [view.name for view in views]
    if len(set(names)) < len(names):
        raise InputError("must have names that differ", where="views")
    unknowns = len(MATRIX) + len(MODELS[model]) + POSE * len(views)
    numbers = 2 * sum(len(view.points) for view in views)
    if not views or numbers <= unknowns:
        raise InputError(
            f"{numbers} coordinates, more than {unknowns} are needed: {len(MATRIX) + len(MODELS[model])} of the "
            f"camera, {POSE} of each view",
            where="views",
            remedy="give more points or views, or a model with fewer coefficients",
        )


def _check_views(views: Sequence[CalibrationView], image_size: tuple[int, int]) -> None:
    """What OpenCV would refuse without a name, or take without a word."""
    seen: dict[bytes, str] = {}
    for view in views:
        where = f"view {view.name}"
        outside = (view.image < -_BESIDE) | (view.image > np.array(image_size) - 1 + _BESIDE)
        if outside.any():
            u, v = view.image[int(np.argmax(outside.any(axis=1)))]
            raise InputError(
                f"the point at {u:g}, {v:g} px lies outside of {image_size[0]} x {image_size[1]} pixels",
                where=where,
                remedy="compare the image size, and whether u and v are swapped",
            )
        rows = np.column_stack([view.points, view.image])
        if len(np.unique(rows, axis=0)) < len(rows):
            raise InputError("holds a point twice", where=where, remedy="leave one out: it adds nothing new")
        if (same := seen.setdefault(rows.tobytes(), view.name)) != view.name:
            raise InputError(f"is view {same} again", where=where, remedy="leave one out: it adds nothing new")
        away = np.linalg.norm(view.points - np.median(view.points, axis=0), axis=1)
        if (far := float(away.max())) > _FAR * float(np.median(away)):
            raise InputError(f"holds a point {far:g} m from the others", where=where, remedy="leave it out")
        for what, places in (("the points", view.points), ("the images of the points", view.image)):
            sizes = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
            if not sizes[1] > _FLAT * sizes[0]:
                raise InputError(f"{what} lie on one line", where=where, remedy="leave the view out")


def _check_in_front(views: Sequence[CalibrationView], state: State) -> None:
    for view, pose in zip(views, state.poses, strict=True):
        depths = view.points @ turn(pose[:3])[0][2] + pose[5]
        if not (depths > 0).all():
            raise InputError(
                "its points are found behind the camera",
                where=f"view {view.name}",
                remedy="check whether u and v are swapped, or an axis is mirrored",
            )


def _frame(views: Sequence[CalibrationView]) -> tuple[Array, Array, bool]:
    """Axes and origin of the points' best plane, and whether they lie in it: OpenCV wants such points at z = 0."""
    points = np.concatenate([view.points for view in views])
    origin = points.mean(axis=0)
    _, sizes, vt = np.linalg.svd(points - origin, full_matrices=False)
    return np.column_stack([vt[0], vt[1], np.cross(vt[0], vt[1])]), origin, bool(sizes[2] <= _FLAT * sizes[0])


def _check_determined(sizes: Array, names: Sequence[str]) -> None:
    if len(sizes) < len(names) or not sizes[-1] > _DETERMINED * sizes[0]:
        raise InputError(
            f"the points do not separate {', '.join(names)}",
            where="views",
            remedy=_TILTED,
        )


def _notes(sizes: Array, model: DistortionModel, covariance: Array, camera: Array) -> Iterator[str]:
    share = float(np.max(np.sqrt(np.diag(covariance)[:2]) / camera[:2]))
    if share > _HARDLY_KNOWN:
        yield (
            f"the focal length is known to {share:.0%} only, and may be farther off: without tilted views only "
            "distortion separates it from the distance"
        )
    if sizes[-1] < _TOLD_APART * sizes[0]:
        yield (
            f"the coefficients of {model} can hardly be separated: their standard errors hold together, not one by "
            "one; see the uncertainty of the projection, or take a model with fewer coefficients"
        )


def _posed(view: CalibrationView, spread: Spread, number: int, residuals: Array, noise: float) -> PosedView:
    """A view's pose in the target's own frame."""
    pose, own, follows = spread.poses[number], spread.own[number], spread.follows[number]
    covariance = own @ own.T + follows @ spread.parameters @ follows.T
    rotation, by_turn = turn(pose[:3])
    whole = rotation @ spread.axes.T
    moved = whole @ spread.origin
    # The target's origin is moved by turns about that of the points' frame: d(R o) = turn x (R o).
    chain = np.eye(POSE)
    chain[:3, :3] = by_turn
    chain[3:, :3] = cross_matrix(moved) @ by_turn
    return PosedView(
        name=view.name,
        points=len(view.points),
        rotation=whole,
        translation=pose[3:] - moved,
        distance=float(np.linalg.norm(pose[3:] + rotation @ view.points.mean(axis=0))),
        covariance=noise**2 * chain @ covariance @ chain.T,
        rms=float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))),
    )


def as_json(found: ViewsCalibration) -> dict[str, Any]:
    """What `radwrap calibrate camera --json` prints."""
    return {
        "model": found.model,
        "image_width": found.image_size[0],
        "image_height": found.image_size[1],
        "camera_matrix": found.camera_matrix.tolist(),
        "distortion_coefficients": found.distortion_coefficients.tolist(),
        "parameters": list(found.parameters),
        "covariance": found.covariance.tolist(),
        "sigma": found.sigma,
        "noise_px": found.noise,
        "noise_given": found.noise_given,
        "rms_px": found.rms,
        "cost_px2": found.cost,
        "opencv_cost_px2": found.opencv_cost,
        "gradient_norm": found.gradient_norm,
        "degrees_of_freedom": found.degrees_of_freedom,
        "notes": list(found.notes),
        "views": [
            {
                "view": view.name,
                "points": view.points,
                "rotation": view.rotation.tolist(),
                "translation": view.translation.tolist(),
                "distance": view.distance,
                "covariance": view.covariance.tolist(),
                "rms_px": view.rms,
            }
            for view in found.views
        ],
    }
