"""Third stage: the centre of each dot in its window, by five definitions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
Method = Literal["gray", "gray_threshold", "binary", "ellipse", "conic"]
METHODS: Final[tuple[Method, ...]] = ("gray", "gray_threshold", "binary", "ellipse", "conic")

# Shares of a dot's level: "gray_threshold" leaves out what is dimmer, "binary" and "ellipse" cut here.
GRAY_THRESHOLD: Final = 0.25
HALF: Final = 0.5
# The contour is sought on rays this far apart, and so far on either side of where the half level is crossed [px].
RAY_SPACING: Final = 0.7
FEWEST_RAYS: Final = 48
MOST_RAYS: Final = 360
RAY_STEP: Final = 0.125
EDGE_REACH: Final = 2.0
# Rays that miss more of the contour than this leave no ellipse.
LEAST_CONTOUR: Final = 0.75
# Contour points farther from the ellipse than this many robust standard deviations are left out.
OUTLIER: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """One dot's part of the picture, with the light of other dots and the background taken away.

    Attributes
    ----------
    origin : ndarray, shape (2,)
        (u, v) of the first pixel [px].
    signal : ndarray, shape (rows, columns)
        Gray levels above the background; positive on the dot for both contrasts.
    inside : ndarray of bool, shape (rows, columns)
        Pixels that belong to the dot's window.
    place : ndarray, shape (2,)
        Where the dot is expected [px].
    affine : ndarray, shape (2, 2)
        d(u, v)/d(column, row) there [px/pitch].
    radius : float
        Of the dot [pitch].
    reach : float
        How far the window goes from the dot's centre [pitch].
    level : float
        Signal in the middle of the dot [gray].
    """

    origin: Field
    signal: Field
    inside: NDArray[np.bool_]
    place: Field
    affine: Field
    radius: float
    reach: float
    level: float


@dataclass(frozen=True, slots=True, eq=False)
class Centre:
    """A measured centre.

    Attributes
    ----------
    place : ndarray, shape (2,)
        (u, v) [px].
    covariance : ndarray, shape (2, 2)
        [px^2].
    area : float
        Of the dot's image [px].
    """

    place: Field
    covariance: Field
    area: float


def centre(window: Window, method: Method, noise: float) -> Centre | None:
    """Measure a dot's centre; None where there is no dot to measure.

    Parameters
    ----------
    window : Window
        The dot.
    method : str
        ``gray``: mean position weighted by the signal. ``gray_threshold``:
        weighted by the signal above a quarter of the dot's level. ``binary``:
        mean position of the pixels above half the level. ``ellipse`` and
        ``conic``: centre of the ellipse through the half-level contour.
    noise : float
        Standard deviation of a pixel's gray level.
    """
    if window.level <= 0 or not window.inside.any():
        return None
    match method:
        case "gray":
            return _weighted(window, np.where(window.inside, window.signal, 0.0), window.inside, noise)
        case "gray_threshold":
            above = window.signal - GRAY_THRESHOLD * window.level
            body = _body(window, above > 0)
            return _weighted(window, np.where(body, above, 0.0), body, noise)
        case "binary":
            return _binary(window, noise)
        case "ellipse" | "conic":
            return _ellipse(window, noise)


def _positions(window: Window) -> tuple[Field, Field]:
    rows, columns = window.signal.shape
    return window.origin[0] + np.arange(columns), window.origin[1] + np.arange(rows)


def _mean(window: Window, weights: Field) -> tuple[float, Field] | None:
    u, v = _positions(window)
    total = float(weights.sum())
    if total <= 0:
        return None
    return total, np.array([weights.sum(axis=0) @ u, weights.sum(axis=1) @ v]) / total


def _spread(window: Window, used: NDArray[np.bool_], place: Field) -> Field:
    """Sum of (x - place)(x - place)^T over pixels [px^2]."""
    u, v = _positions(window)
    du, dv = u - place[0], v - place[1]
    mask = used.astype(np.float64)
    mixed = float(dv @ mask @ du)
    return np.array([[mask.sum(axis=0) @ du**2, mixed], [mixed, mask.sum(axis=1) @ dv**2]])


def _weighted(window: Window, weights: Field, used: NDArray[np.bool_], noise: float) -> Centre | None:
    found = _mean(window, weights)
    if found is None:
        return None
    total, place = found
    # d place / d gray_i = (x_i - place) / sum of weights, and all pixels have the same noise.
    covariance = noise**2 * _spread(window, used, place) / total**2
    return Centre(place, covariance, float(window.signal[window.inside].sum()) / window.level)


def _body(window: Window, above: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The connected part of a mask that holds most of the window's pixels: specks of noise drop out."""
    from scipy import ndimage

    labels, count = ndimage.label(above & window.inside, structure=np.ones((3, 3), dtype=int))
    if count == 0:
        return np.zeros_like(above)
    return np.asarray(labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:])))


def _binary(window: Window, noise: float) -> Centre | None:
    from scipy import ndimage

    body = _body(window, window.signal > HALF * window.level)
    found = _mean(window, body.astype(np.float64))
    if found is None:
        return None
    area, place = found
    # A pixel on the rim counts whole or not at all: an error of its share with variance 1/12; noise moves the rim
    # by noise over the gradient, which is about half the level for each pixel.
    rim = body & ~ndimage.binary_erosion(body)
    share = 1 / 12 + (noise / (HALF * window.level)) ** 2
    return Centre(place, share * _spread(window, rim, place) / area**2, area)


def _ellipse(window: Window, noise: float) -> Centre | None:
    """Fit an ellipse to the contour.

    On each ray the rim lies where the half level is crossed, made finer by
    conserving light: the signal's integral over the rim's surroundings, in
    units of the level, is the length of ray inside the dot. Of a straight rim
    seen by square pixels that is exact, where interpolation alone errs by up
    to 0.08 px.
    """
    points = _contour(window)
    if points is None:
        return None
    # In units of the dot's radius, where the contour is nearly the unit circle: the algebraic fit is then as good
    # as the geometric one.
    to_pixel = window.affine * window.radius
    plain = (points - window.place) @ np.linalg.inv(to_pixel).T
    kept = np.ones(len(plain), dtype=bool)
    for _ in range(3):
        solved = _conic_centre(plain[kept])
        if solved is None:
            return None
        middle, shape = solved
        away = plain - middle
        missed = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", away, shape, away), 0.0)) - 1
        spread = 1.4826 * float(np.median(np.abs(missed[kept])))
        again = np.abs(missed) <= max(OUTLIER * spread, 1e-6)
        if (again == kept).all():
            break
        kept = again
    place = window.place + to_pixel @ middle
    scale = math.sqrt(abs(float(np.linalg.det(to_pixel))))
    # Independent contour points are one pixel apart, not one ray.
    independent = max(min(2 * math.pi * scale, float(kept.sum())), 6.0)
    # The fit tells its own scatter; on few points it may be small by chance, so noise along the ray is the least.
    scatter = max(float(np.mean(missed[kept] ** 2)), (math.sqrt(2 * EDGE_REACH) * noise / window.level / scale) ** 2)
    covariance = 2 * scatter / independent * (to_pixel @ to_pixel.T)
    area = math.pi * scale**2 / math.sqrt(max(float(np.linalg.det(shape)), 1e-12))
    return Centre(place, covariance, area)


def _contour(window: Window) -> Field | None:
    from scipy import ndimage

    scale = math.sqrt(abs(float(np.linalg.det(window.affine))))
    rim = window.radius * scale
    count = int(np.clip(math.ceil(2 * math.pi * rim / RAY_SPACING), FEWEST_RAYS, MOST_RAYS))
    angles = 2 * math.pi * np.arange(count) / count
    directions = np.column_stack([np.cos(angles), np.sin(angles)]) @ window.affine.T  # [px/pitch]
    lengths = np.linalg.norm(directions, axis=1)
    directions /= lengths[:, None]
    far = lengths * window.reach
    steps = np.arange(0.0, float(far.max()) + EDGE_REACH, RAY_STEP)
    samples = window.place[None, None, :] + directions[:, None, :] * steps[None, :, None] - window.origin
    # Outside the window there is nothing of this dot.
    signal = np.where(window.inside, window.signal, 0.0) / window.level
    profiles = ndimage.map_coordinates(signal, [samples[..., 1], samples[..., 0]], order=1, cval=0.0)
    # From the middle outwards, past what noise does near the centre.
    start = (0.35 * window.radius * lengths)[:, None]
    below = (profiles < HALF) & (steps[None, :] >= start)
    crossed = below.argmax(axis=1)
    valid = below.any(axis=1) & (crossed > 0) & (steps[crossed] <= far + 1.0)
    if valid.mean() < LEAST_CONTOUR:
        return None
    reach = np.minimum(EDGE_REACH, 0.6 * window.radius * lengths)
    middle = steps[crossed]
    near = np.abs(steps[None, :] - middle[:, None]) <= reach[:, None]
    width = near.sum(axis=1) * RAY_STEP
    first = steps[near.argmax(axis=1)] - RAY_STEP / 2
    inside = (np.clip(profiles, -0.5, 1.5) * near).sum(axis=1) * RAY_STEP
    edge = first + np.clip(inside, 0.0, width)
    points: Field = window.place + directions[valid] * edge[valid, None]
    return points


def _conic_centre(points: Field) -> tuple[Field, Field] | None:
    """Centre and shape matrix S of (x - c)^T S (x - c) = 1 through points near the unit circle."""
    if len(points) < 6:
        return None
    x, y = points.T
    a, b, c, d, e = np.linalg.lstsq(np.column_stack([x * x, x * y, y * y, x, y]), np.ones_like(x), rcond=None)[0]
    quadratic = np.array([[a, b / 2], [b / 2, c]])
    if a <= 0 or np.linalg.det(quadratic) <= 0:
        return None
    middle = np.linalg.solve(quadratic, [-d / 2, -e / 2])
    size = 1 + middle @ quadratic @ middle
    return np.asarray(middle), quadratic / size
