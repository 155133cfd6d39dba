"""The least-squares minimum of Tsai's camera, reached and shown to be reached.

A change of focal length and depth by the same factor hardly changes the
image: the sum of squares has a long flat valley, in which solvers that watch
the fall of the sum stop short. Here the valley is one axis of its own: the
unknowns are the image of the centroid, ln(f/Z) (the magnification, well known)
and ln f (the valley), the turn from the present rotation, and the rest. After
Levenberg-Marquardt, Gauss-Newton steps go on as long as the projection of the
residuals on the tangent plane shrinks; this, not the sum of squares, tells
whether the minimum is reached, because it does not lose half the digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from radwrap.calibrate.camera_model import (
    COLUMNS,
    Array,
    Camera,
    derivatives,
    moved,
    nearest_rotation,
    project,
    turn,
)

# What may be found beside the pose, and its columns of camera_model.derivatives().
FREE: Final = {"focal_length": (6,), "distortion": (7,), "sx": (8,), "centre": (9, 10)}

# Residuals' projection on the tangent plane, over the residuals, at which the minimum counts as reached: the sum of
# squares can then still fall by 1e-10 of itself, a value move by 1e-4 of its standard error. Well-posed points end at
# 1e-10; the bound is for those that hardly tell what is free, where round-off of the residuals ends it at 1e-6.
CONVERGED: Final = 1e-5

# The same at which the search ends: nearer, round-off of the residuals is all that is left.
_AIM: Final = 1e-7

# The same in px for exact points, where nothing but round-off is left: 1e-16 of some 1000 px, times the operations.
ROUND_OFF: Final = 1e-10

# Evaluations and tolerance of a run that tells a good start from a mirror pose,
_GLANCE: Final = 25
_LOOSE: Final = 1e-6
# and of one that goes on until the sum of squares stands still.
_ENOUGH: Final = 200
_TIGHT: Final = 1e-15
_ROUNDS: Final = 12  # restarts of Levenberg-Marquardt, each from the point reached, with fresh scales
_POLISH: Final = 60  # Gauss-Newton steps; each gains at least a factor, or they end
_FARTHEST: Final = 8.0  # largest |ln| by which one run may change focal length or magnification


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the least squares ended.

    Attributes
    ----------
    camera : Camera
    residuals : ndarray, shape (n, 2)
        Predicted minus observed u, v [px].
    sse : float
        Their sum of squares [px^2].
    gradient_norm : float
        Norm of J^T r with the columns of J (of `COLUMNS`, those that are free) scaled to unit length [px].
    predicted_decrease : float
        By how much the sum of squares would still fall, by its tangent plane [px^2].
    condition : float
        Condition number of that J with columns of unit length.
    spread : ndarray, shape (11, p)
        S with S S^T = covariance of camera_model.COLUMNS for a residual variance of 1 px^2.
    converged : bool
    """

    camera: Camera
    residuals: Array
    sse: float
    gradient_norm: float
    predicted_decrease: float
    condition: float
    spread: Array
    converged: bool


def refine(start: Camera, points: Array, image: Array, free: frozenset[str], *, thorough: bool = True) -> Minimum:
    """Find the least-squares minimum that belongs to a start value.

    Parameters
    ----------
    start : Camera
        In front of the points; `origin` is their centroid.
    points : ndarray, shape (n, 3)
        [m].
    image : ndarray, shape (n, 2)
        u, v [px].
    free : frozenset of str
        Keys of `FREE`; the pose is always free.
    thorough : bool
        False ends after one short run: good enough to choose between starts.

    Returns
    -------
    Minimum
        `converged` is False where no minimum was reached.
    """
    evaluations, tolerance = (_ENOUGH, _TIGHT) if thorough else (_GLANCE, _LOOSE)
    camera = _descend(start, points, image, free, evaluations=evaluations, tolerance=tolerance)
    here = describe(camera, points, image, free)
    if not thorough:
        return here
    for _ in range(_ROUNDS):
        here = _polish(here, points, image, free)
        if _within(np.sqrt(here.predicted_decrease), here.sse, _AIM):
            break
        camera = _descend(here.camera, points, image, free, evaluations=_ENOUGH, tolerance=_TIGHT)
        there = describe(camera, points, image, free)
        if there.sse > here.sse or np.isclose(there.sse, here.sse, rtol=1e-15, atol=0.0):
            break
        here = there
    return here


def describe(camera: Camera, points: Array, image: Array, free: frozenset[str]) -> Minimum:
    """Residuals, gradient and covariance of a camera, wherever it stands."""
    residuals = project(camera, points) - image
    basis, solve = _tangent(camera, points, free)
    gradient, condition = gradient_and_condition(derivatives(camera, points)[:, physical_columns(free)], residuals)
    tangent, sse = float(np.linalg.norm(basis.T @ residuals.ravel())), float(np.sum(residuals**2))
    spread = _chain(camera, free) @ solve
    converged = _within(tangent, sse, CONVERGED)
    return Minimum(camera, residuals, sse, gradient, tangent**2, condition, spread, converged)


def _within(tangent: float, sse: float, share: float) -> bool:
    """Whether what is left of the residuals on the tangent plane is below a share of them, or round-off."""
    return bool(tangent <= share * np.sqrt(sse) + ROUND_OFF)


def gradient_and_condition(jacobian: Array, residuals: Array) -> tuple[float, float]:
    """Norm of the gradient [px] and condition number, both of a Jacobian with columns of unit length.

    The condition number is infinite where a column vanishes.
    """
    lengths = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(lengths > 0.0, lengths, 1.0)
    sizes = np.linalg.svd(scaled, compute_uv=False)
    condition = float(sizes[0] / sizes[-1]) if sizes[-1] > 0.0 else float("inf")
    return float(np.linalg.norm(scaled.T @ residuals.ravel())), condition


def physical_columns(free: frozenset[str]) -> list[int]:
    """Columns of derivatives() that are free."""
    return [*range(6), *(column for name, columns in FREE.items() if name in free for column in columns)]


def _chain(camera: Camera, free: frozenset[str]) -> Array:
    """Derivatives of camera_model.COLUMNS by the solver's unknowns, shape (11, p).

    The unknowns stand in the same order: turn, image of the centroid [px], ln(f/Z), ln f, kappa1, sx, centre.
    """
    (dx, dy), f, z = camera.pixel, camera.focal_length, camera.position[2]
    chain = np.eye(len(COLUMNS))
    chain[3, 3], chain[4, 4] = dx * z / f, dy * z / f
    chain[3:6, 5] = -camera.position
    chain[5, 6], chain[6, 6] = z, f
    return chain[:, physical_columns(free)]


def _stepped(camera: Camera, step: Array, free: frozenset[str]) -> Camera:
    """The camera after a step of the solver's unknowns."""
    full = np.zeros(len(COLUMNS))
    full[physical_columns(free)] = step
    per_metre = camera.focal_length / camera.position[2]
    magnification = per_metre * np.exp(np.clip(full[5], -_FARTHEST, _FARTHEST))
    focal_length = camera.focal_length * float(np.exp(np.clip(full[6], -_FARTHEST, _FARTHEST)))
    across = (camera.position[:2] * per_metre + full[3:5] * camera.pixel) / magnification
    return moved(
        camera,
        rotation=turn(full[:3])[0] @ camera.rotation,
        position=np.array([*across, focal_length / magnification]),
        focal_length=focal_length,
        kappa1=camera.kappa1 + float(full[7]),
        sx=camera.sx + float(full[8]),
        centre=(camera.centre[0] + float(full[9]), camera.centre[1] + float(full[10])),
    )


def _descend(
    start: Camera, points: Array, image: Array, free: frozenset[str], *, evaluations: int, tolerance: float
) -> Camera:
    """One run of Levenberg-Marquardt (MINPACK, through scipy)."""
    from scipy.optimize import least_squares

    def residuals(step: Array) -> Array:
        return (project(_stepped(start, step, free), points) - image).ravel()

    def jacobian(step: Array) -> Array:
        camera = _stepped(start, step, free)
        found = derivatives(camera, points) @ _chain(camera, free)
        found[:, :3] = found[:, :3] @ turn(step[:3])[1]
        return found

    unknowns = len(physical_columns(free))
    found = least_squares(
        residuals,
        np.zeros(unknowns),
        jacobian,
        method="lm",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=evaluations,
    )
    reached = _stepped(start, found.x, free)
    return moved(reached, rotation=nearest_rotation(reached.rotation))


def _tangent(camera: Camera, points: Array, free: frozenset[str]) -> tuple[Array, Array]:
    """Orthonormal basis B of the tangent plane, (2n, p), and S, (p, p): -S B^T r is the step of Gauss-Newton."""
    jacobian = derivatives(camera, points) @ _chain(camera, free)
    lengths = np.linalg.norm(jacobian, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    basis, sizes, vt = np.linalg.svd(jacobian / lengths, full_matrices=False)
    sizes = np.maximum(sizes, np.finfo(float).eps * sizes[0])
    return basis, (vt.T / sizes) / lengths[:, None]


def _polish(here: Minimum, points: Array, image: Array, free: frozenset[str]) -> Minimum:
    """Gauss-Newton steps as long as the residuals' projection on the tangent plane shrinks."""
    for _ in range(_POLISH):
        basis, solve = _tangent(here.camera, points, free)
        step = -solve @ (basis.T @ here.residuals.ravel())
        if not np.all(np.isfinite(step)):
            break
        there = describe(_stepped(here.camera, step, free), points, image, free)
        # Past the aim only round-off is left, and not worth small steps.
        gain = 0.25 if _within(np.sqrt(here.predicted_decrease), here.sse, _AIM) else 1.0
        if not there.predicted_decrease < gain * here.predicted_decrease or there.sse > here.sse * (1.0 + 1e-9) + 1e-18:
            break
        here = there
    return here
