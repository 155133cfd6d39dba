"""Least squares of several views: the minimum, and how camera and poses vary together about it.

The start is OpenCV's calibrateCamera, which takes points in single precision. From there Gauss-Newton steps go on in
double precision until the residuals' projection on the tangent plane is round-off. A view's pose only moves its own
points, so it is eliminated view by view, by an orthogonal basis of its six columns: time and memory grow with the
number of views, not with its cube.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from radwrap.calibrate.camera_model import Array
from radwrap.calibrate.opencv_views import project_points
from radwrap.calibrate.views import POSE, CalibrationView
from radwrap.errors import InputError

_STEPS: Final = 100
_HALVINGS: Final = 30
# The residuals' projection on the tangent plane, over the residuals, at which the minimum is reached: the cost can
# still fall by the square of it. Round-off of points some 1000 px from the corner ends it at 1e-10 px a point.
_CONVERGED: Final = 1e-7
_ROUND_OFF: Final = 1e-9  # px


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Unknowns: fx, fy, cx, cy and all coefficients; rotation vector and translation of each view."""

    camera: Array
    poses: Array


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """How parameters and poses of a solution vary together, for a noise of 1 px.

    A pose's change is ``own e - follows i``: `own` with independent e of variance 1, i the parameters' change.

    Attributes
    ----------
    parameters : ndarray, shape (p, p)
        Covariance of what is free beside poses.
    own : ndarray, shape (views, 6, 6)
        Square roots: ``own own^T`` is a pose's covariance with the parameters held.
    follows : ndarray, shape (views, 6, p)
        Derivatives of poses by parameters along the minimum, with the other sign.
    poses : ndarray, shape (views, 6)
        Rotation vectors and translations, of the points' own frame `axes`, `origin` [m].
    axes : ndarray, shape (3, 3)
    origin : ndarray, shape (3,)
    """

    parameters: Array
    own: Array
    follows: Array
    poses: Array
    axes: Array
    origin: Array


def residuals_of(view: CalibrationView, camera: Array, pose: Array) -> Array:
    """Predicted minus seen u, v, shape (n, 2) [px]."""
    found: Array = project_points(view.points, camera, pose)[0] - view.image
    return found


def cost_of(views: Sequence[CalibrationView], state: State) -> float:
    """Sum of squared residuals [px^2]."""
    return float(
        sum(np.sum(residuals_of(view, state.camera, pose) ** 2) for view, pose in zip(views, state.poses, strict=True))
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A view's derivatives, with its pose eliminated: Q R of the pose's columns, and what is left of the others."""

    basis: Array
    root: Array
    camera: Array
    residuals: Array

    @property
    def left(self) -> tuple[Array, Array]:
        """Derivatives by the camera and residuals, across the pose's columns."""
        across = self.camera - self.basis @ (self.basis.T @ self.camera)
        return across, self.residuals - self.basis @ (self.basis.T @ self.residuals)


def _parts(views: Sequence[CalibrationView], state: State, free: Sequence[int]) -> list[_Part]:
    found = []
    for view, pose in zip(views, state.poses, strict=True):
        shown, jacobian = project_points(view.points, state.camera, pose)
        basis, root = np.linalg.qr(jacobian[:, :POSE])
        found.append(_Part(basis, root, jacobian[:, POSE:][:, free], (shown - view.image).ravel()))
    return found


def _solved(parts: Sequence[_Part]) -> tuple[Array, Array, Array]:
    """Step of the camera, singular values of unit columns, and a square root S of (J^T J)^-1: S S^T."""
    left = [part.left for part in parts]
    jacobian, residuals = np.concatenate([a for a, _ in left]), np.concatenate([b for _, b in left])
    lengths = np.linalg.norm(jacobian, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    basis, sizes, vt = np.linalg.svd(jacobian / lengths, full_matrices=False)
    safe = np.maximum(sizes, np.finfo(float).eps * sizes[0])
    root = vt.T / safe / lengths[:, None]
    return -root @ (basis.T @ residuals), sizes, root


def _tangent(parts: Sequence[_Part], step: Array, moves: Sequence[Array]) -> float:
    """Length of the residuals' projection on the tangent plane [px]: what a step would take away."""
    square = sum(
        float(np.sum((part.camera @ step + part.basis @ (part.root @ move)) ** 2))
        for part, move in zip(parts, moves, strict=True)
    )
    return math.sqrt(square)


def _moves(parts: Sequence[_Part], step: Array) -> list[Array]:
    """Steps of the poses, after that of the camera."""
    return [
        np.asarray(np.linalg.solve(part.root, -part.basis.T @ (part.residuals + part.camera @ step)), dtype=np.float64)
        for part in parts
    ]


def descended(views: Sequence[CalibrationView], start: State, free: Sequence[int]) -> tuple[State, Array]:
    """The minimum that belongs to a start, and the singular values there."""
    state, cost = start, cost_of(views, start)
    sizes = np.ones(1)
    for _ in range(_STEPS):
        parts = _parts(views, state, free)
        try:
            step, sizes, _ = _solved(parts)
            moves = _moves(parts, step)
        except np.linalg.LinAlgError as error:
            raise InputError(
                "the points of a view do not determine its pose", where="views", remedy="spread them over the target"
            ) from error
        if _tangent(parts, step, moves) <= _CONVERGED * math.sqrt(cost) + _ROUND_OFF:
            break
        share = 1.0
        for _ in range(_HALVINGS):
            camera = state.camera.copy()
            camera[free] += share * step
            there = State(camera, state.poses + share * np.array(moves))
            reached = cost_of(views, there)
            if reached < cost:
                break
            share /= 2
        else:
            break  # nothing is left to win but round-off
        state, cost = there, reached
    return state, sizes


def spread_about(
    views: Sequence[CalibrationView], state: State, free: Sequence[int], axes: Array, origin: Array
) -> tuple[float, Spread]:
    """How much of the residuals is left on the tangent plane [px], and how all varies together."""
    parts = _parts(views, state, free)
    step, _, root = _solved(parts)
    own = np.array([np.linalg.inv(part.root) for part in parts])
    follows = np.array([inverse @ (part.basis.T @ part.camera) for inverse, part in zip(own, parts, strict=True)])
    spread = Spread(root @ root.T, own, follows, state.poses, axes, origin)
    return _tangent(parts, step, _moves(parts, step)), spread
