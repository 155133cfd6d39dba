"""How a lens bends the image, and the way back, in units of the focal length from the principal point.

::

    opencv   xd = x (1 + k1 r^2 + k2 r^4 + k3 r^6)/(1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
                  + s1 r^2 + s2 r^4
             yd = likewise in y, with p1 (r^2 + 2 y^2) + 2 p2 x y + s3 r^2 + s4 r^4;  r of the undistorted x, y
    tsai     x  = xd (1 + kappa1 rd^2), y likewise;  rd of the distorted xd, yd: it undistorts

Either is given one way and inverted by Newton's method, and each place found is put in again. Where it folds over
(light of two directions at one place) it ends: `limit` and beyond it a place
goes on along its radius in proportion, which no pixel is near. Sources: keys
tsai1987, opencv_calib3d.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]
Bent = tuple[Array, Array, Array]
Model = Literal["opencv", "tsai"]

_PLAIN: Final = 8  # coefficients of OpenCV's without a thin prism
_OPENCV: Final = 12
_DIRECTIONS: Final = 72
_SCAN: Final = 400  # steps of the radius in which a fold is looked for
_CHECKED: Final = 10  # steps of the radius between places that are inverted when a scene is read
_REACH: Final = 4.0  # times the farthest pixel's distance: so far it is looked for
_FOLDED: Final = 0.02  # area ratio below which the image is as good as folded over
_STEPS: Final = 60  # of Newton's method, which takes 3 to 8
_CONVERGED: Final = 1e-15  # of the focal length: 1e-11 px at 10^4 px
_SOLVED: Final = 1e-13  # likewise, what rounding leaves
_AT_LIMIT: Final = 1 + 1e-9  # the limit itself is within
_HALVINGS: Final = 12  # of a step that would lead farther off


@dataclass(frozen=True, slots=True)
class Distortion:
    """A lens's distortion, and how far out it holds.

    Attributes
    ----------
    model : str
        "opencv" or "tsai".
    coefficients : tuple of float
        k1, k2, p1, p2, k3, k4, k5, k6, in OpenCV's order, and s1, s2, s3, s4 of a thin prism where there is one; or
        kappa1 f^2.
    limit : float
        Radius in the undistorted image up to which the formula holds [f].
    distorted_limit : float
        Radius in the distorted image that all its places stay within [f].
    """

    model: Model
    coefficients: tuple[float, ...]
    limit: float = math.inf
    distorted_limit: float = math.inf

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Where the lens puts undistorted places [f]."""
        scale = _beyond(np.hypot(x, y), self.limit)
        xd, yd = self._forward(x / scale, y / scale)
        return xd * scale, yd * scale

    def undistorted(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Undistorted places of distorted ones [f], and the ratio of an area there to the one here."""
        scale = _beyond(np.hypot(x, y), self.distorted_limit)
        xu, yu, ratio = self._backward(x / scale, y / scale)
        return xu * scale, yu * scale, ratio

    def _forward(self, x: Array, y: Array) -> tuple[Array, Array]:
        if self.model == "tsai":
            return _solved(x, y, self.tsai, self.distorted_limit)[:2]
        xd, yd, _ = self.opencv(x, y)
        return xd, yd

    def _backward(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        if self.model == "tsai":
            xu, yu, jacobian = self.tsai(x, y)
            return xu, yu, _determinant(jacobian)
        xu, yu, jacobian = _solved(x, y, self.opencv, self.limit)
        return xu, yu, 1 / _determinant(jacobian)

    def tsai(self, x: Array, y: Array) -> Bent:
        """Undistorted places of distorted ones, and derivatives, shape (2, 2, n)."""
        (kappa,) = self.coefficients
        factor = 1 + kappa * (x * x + y * y)
        cross = 2 * kappa * x * y
        jacobian = np.array([[factor + 2 * kappa * x * x, cross], [cross, factor + 2 * kappa * y * y]])
        return x * factor, y * factor, jacobian

    def opencv(self, x: Array, y: Array) -> Bent:
        """Distorted places of undistorted ones, and derivatives, shape (2, 2, n)."""
        k1, k2, p1, p2, k3, k4, k5, k6, *prism = self.coefficients
        s = x * x + y * y
        above, below = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
        radial = above / below
        # Derivative by s = r^2.
        slope = (k1 + s * (2 * k2 + 3 * s * k3) - radial * (k4 + s * (2 * k5 + 3 * s * k6))) / below
        xd = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
        yd = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
        cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        jacobian = np.array(
            [
                [radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x, cross],
                [cross, radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x],
            ]
        )
        if prism:
            s1, s2, s3, s4 = prism
            xd += s * (s1 + s * s2)
            yd += s * (s3 + s * s4)
            jacobian += 2 * np.array(
                [[(s1 + 2 * s2 * s) * x, (s1 + 2 * s2 * s) * y], [(s3 + 2 * s4 * s) * x, (s3 + 2 * s4 * s) * y]]
            )
        return xd, yd, jacobian


def opencv_distortion(values: tuple[float, ...]) -> Distortion:
    """Distortion by up to twelve coefficients in OpenCV's order: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4."""
    count = _OPENCV if any(values[_PLAIN:]) else _PLAIN
    return Distortion("opencv", (*values, *(0.0,) * (count - len(values)))[:count])


def bounded(distortion: Distortion, corner: float, where: str) -> Distortion:
    """Find out how far a distortion holds.

    Parameters
    ----------
    distortion : Distortion
        With any limits.
    corner : float
        Distance of the farthest corner of the sensor from the principal point [f].
    where : str
        Key, for messages.

    Raises
    ------
    InputError
        If it folds over before that corner, or cannot be inverted there.
    """
    angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    radii = np.arange(_SCAN + 1) / _SCAN * _REACH * corner
    x, y = (np.multiply.outer(radii, wave(angles)) for wave in (np.cos, np.sin))
    with np.errstate(all="ignore"):
        if distortion.model == "tsai":
            # Its formula goes from the distorted radius, alike in all directions, so that is scanned.
            ends_x, ends_y, jacobian = distortion.tsai(x, y)
        else:
            ends_x, ends_y, jacobian = distortion.opencv(x, y)
        good = (_determinant(jacobian) > _FOLDED) & np.isfinite(ends_x + ends_y)
    ends = np.hypot(ends_x, ends_y)
    # Along each direction the radius must grow, and everything nearer must be good.
    good[1:] &= np.diff(ends, axis=0) > 0
    held = np.logical_and.accumulate(good.all(axis=1))
    last = int(held.sum()) - 1
    # Every place up to the limit must come from one within it, in directions between the looked at ones too: of what
    # changes once or twice in a turn, as tangential terms do, the least lies at most so far below the least found.
    between = 2 * (1 - math.cos(math.pi / _DIRECTIONS)) * float(np.ptp(ends[last]))
    given, made = float(radii[last]), float(ends[last].min()) - between
    undistorted, distorted = (made, given) if distortion.model == "tsai" else (given, made)
    if last < 1 or distorted <= corner:
        raise InputError(
            f"the distortion folds the image over at {distorted / corner:.0%} of the sensor's farthest corner",
            where=where,
            remedy="it holds only where it was measured: give coefficients that do so on the whole sensor",
        )
    found = Distortion(distortion.model, distortion.coefficients, undistorted, distorted)
    # Either way, to the corner: what fails later would fail in the midst of a run.
    near = radii[: _SCAN + 1 : _CHECKED] / _REACH
    places = (np.multiply.outer(near, wave(angles)).ravel() for wave in (np.cos, np.sin))
    try:
        found.distorted(*found.undistorted(*places)[:2])
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error
    return found


def _beyond(radius: Array, limit: float) -> Array:
    """How many times the limit a radius is, 1 within it."""
    return np.maximum(radius / limit, 1.0) if math.isfinite(limit) else np.ones_like(radius)


def _determinant(jacobian: Array) -> Array:
    determinant: Array = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    return determinant


def _solved(x: Array, y: Array, formula: Callable[[Array, Array], Bent], limit: float) -> Bent:
    """Places within a limit that a formula takes to (x, y), and its derivatives.

    Newton's method from there finds nearly all; where it went astray it begins anew from the place of that radius.

    Raises
    ------
    InputError
        If there is none.
    """
    with np.errstate(all="ignore"):
        u, v = _newton(x, y, formula)
        astray = ~_solves((u, v), x, y, formula, limit)
        if astray.any():
            u[astray], v[astray] = _careful(x[astray], y[astray], formula, limit)
            if not _solves((u, v), x, y, formula, limit).all():
                raise InputError(
                    "the distortion cannot be inverted on the whole sensor",
                    where="camera.distortion",
                    remedy="it holds only where it was measured: give coefficients that do so on the whole sensor",
                )
    return u, v, formula(u, v)[2]


def _newton(x: Array, y: Array, formula: Callable[[Array, Array], Bent]) -> tuple[Array, Array]:
    u, v = x.copy(), y.copy()
    for _ in range(_STEPS):
        step_u, step_v, _ = _step((u, v), x, y, formula)
        u -= step_u
        v -= step_v
        if max(np.abs(step_u).max(initial=0.0), np.abs(step_v).max(initial=0.0)) <= _CONVERGED:
            break
    return u, v


def _step(
    at: tuple[Array, Array], x: Array, y: Array, formula: Callable[[Array, Array], Bent]
) -> tuple[Array, Array, Array]:
    """What Newton's method takes from some places, and how far off (x, y) they lead."""
    found_x, found_y, jacobian = formula(*at)
    off_x, off_y = found_x - x, found_y - y
    determinant = _determinant(jacobian)
    step_u = (jacobian[1, 1] * off_x - jacobian[0, 1] * off_y) / determinant
    step_v = (jacobian[0, 0] * off_y - jacobian[1, 0] * off_x) / determinant
    return step_u, step_v, np.hypot(off_x, off_y)


def _solves(
    at: tuple[Array, Array], x: Array, y: Array, formula: Callable[[Array, Array], Bent], limit: float
) -> NDArray[np.bool_]:
    """Which places lead to (x, y), and are not beyond a fold; of what is nowhere nothing is asked."""
    found_x, found_y, _ = formula(*at)
    near = np.hypot(found_x - x, found_y - y) <= _SOLVED * np.maximum(np.hypot(x, y), 1.0)
    held: NDArray[np.bool_] = near & (np.hypot(*at) <= limit * _AT_LIMIT) | ~np.isfinite(x + y)
    return held


def _careful(x: Array, y: Array, formula: Callable[[Array, Array], Bent], limit: float) -> tuple[Array, Array]:
    """Newton's method that starts at the right radius and goes no farther than it helps."""
    radius = np.hypot(x, y)
    along_x, along_y = x / np.maximum(radius, 1e-300), y / np.maximum(radius, 1e-300)
    low, high = np.zeros_like(radius), np.minimum(limit * _AT_LIMIT, _REACH * radius)
    for _ in range(_STEPS):  # within the limit the radius grows along each direction
        middle = (low + high) / 2
        found_x, found_y, _ = formula(middle * along_x, middle * along_y)
        short = np.hypot(found_x, found_y) < radius
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    u, v = low * along_x, low * along_y
    for _ in range(_STEPS):
        step_u, step_v, off = _step((u, v), x, y, formula)
        share = np.ones_like(off)
        for _ in range(_HALVINGS):
            *_, after = _step((u - share * step_u, v - share * step_v), x, y, formula)
            share = np.where(after <= off, share, share / 2)
        u, v = u - share * step_u, v - share * step_v
        if np.hypot(step_u, step_v).max(initial=0.0) <= _CONVERGED:
            break
    return u, v
