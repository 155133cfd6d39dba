"""Dots that run together: a model of the board's light tells whose light is whose.

Each dot is a disc on the board, seen through the grid's homography and blurred
by the same ellipse everywhere (a pinhole's disc, on pixels that need not be
square); dots differ in level, the background is a plane. From the picture come the levels, the
background, the blur and, where it is not given, the dots' size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.dots.plane import Matrix, fit_homography, jacobian, project

Field = NDArray[np.float64]

# The model looks as far outside the outermost dots' centres as this [pitch]: past the rim of touching dots (0.5),
# and hardly past a board's edge.
OUTSIDE: Final = 0.85
# Sub-samples across a pixel; rims are softened over one sample, which leaves 1e-3 of a pixel's light.
SAMPLES: Final = 2
# Size and blur are sought in a picture binned until a pitch is at most so many pixels.
COARSE_PITCH: Final = 40.0
LEVEL_ROUNDS: Final = 4
MOST_TRIALS: Final = 60
# Pixels, and with them the blur, are less oblong than e^0.5.
LARGEST_LOG_ASPECT: Final = 0.5
# The blurred residual averages over a dot and its surroundings, so it tells less than the level's whole error.
LEVEL_GAIN: Final = 1.5
# Unknowns up to which the normal equations are solved as a full matrix.
DENSE: Final = 1000
# Where a dot's own share of its level falls below this it is dark.
FAINT: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The board's light, explained.

    Attributes
    ----------
    radius : float
        Of the dots [pitch].
    blur : ndarray, shape (2,)
        Semi-axes of the ellipse of blur along u and v [px].
    levels : ndarray, shape (n,)
        Each dot's level above the background [gray].
    background : ndarray, shape (3,)
        b in ``b[0] + b[1] u + b[2] v`` [gray].
    residual : float
        Root mean square of what the model leaves [gray].
    """

    radius: float
    blur: Field
    levels: Field
    background: Field
    residual: float


@dataclass(frozen=True, slots=True, eq=False)
class _Crop:
    """A part of the picture with the board coordinates of its sub-samples."""

    values: Field  # (rows, columns)
    design: Field  # (pixels, 3): 1, u, v
    used: NDArray[np.bool_]  # pixels that the model must explain
    clipped: NDArray[np.bool_]  # of those, at the highest level: the light may be more
    exact: NDArray[np.intp]  # numbers of the others
    plane: Field  # design of the latter
    dot: NDArray[np.intp]  # of each pixel: the nearest dot
    light: Field  # of each pixel, against that in the nearest dot's centre
    distance: Field  # of each sub-sample from the nearest dot's centre [pitch]
    sharpness: Field  # of each sub-sample: samples for each pitch


def fit_model(
    values: Field,
    homography: Matrix,
    shape: tuple[int, int],
    levels: Field,
    *,
    radius: float | None,
    slopes: Field,
    earlier: Model | None = None,
) -> Model:
    """Fit the board's light.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Gray levels; the sign turned so that dots are bright.
    homography : ndarray, shape (3, 3)
        Board to image.
    shape : tuple of int
        Rows and columns of the grid.
    levels : ndarray, shape (n,)
        Levels to start from, row by row [gray].
    radius : float, optional
        Of the dots [pitch], where it is known.
    slopes : ndarray, shape (n, 2)
        Relative gradient of the light at each dot [1/px].
    earlier : Model, optional
        To start from.

    Returns
    -------
    Model
    """
    from scipy.optimize import minimize
    from threadpoolctl import threadpool_limits

    middle = np.array([[(shape[1] - 1) / 2, (shape[0] - 1) / 2]])
    pitch = math.sqrt(abs(float(np.linalg.det(jacobian(homography, middle)[0]))))
    binning = max(1, math.floor(pitch / COARSE_PITCH))
    crop = _crop(values, homography, shape, binning, slopes)
    # Levels of the best trial so far serve the next one: they hardly depend on size and blur.
    best: tuple[float, Field] = (math.inf, levels if earlier is None else earlier.levels)

    def unpacked(parameters: Field) -> tuple[float, Field]:
        size = radius if radius is not None else float(parameters[2])
        return size, float(parameters[0]) * np.exp(np.array([0.5, -0.5]) * parameters[1])

    def misfit(parameters: Field) -> float:
        nonlocal best
        size, blur = unpacked(parameters)
        if not (0.1 < size < 0.62 and 0.0 <= parameters[0] < 1.5 * pitch and abs(parameters[1]) < LARGEST_LOG_ASPECT):
            return math.inf
        residual, now, _ = _explained(crop, best[1], size, blur / binning, 1)
        if residual < best[0]:
            best = residual, now
        return residual

    if earlier is None:
        sizes = (0.3, 0.38, 0.46) if radius is None else (radius,)
        starts = [np.array([blur * pitch, 0.0, size]) for blur in (0.04, 0.16, 0.3, 0.5, 0.7) for size in sizes]
        with threadpool_limits(1):
            start, step = min(starts, key=misfit), 0.06
    else:
        wide, high = earlier.blur
        start, step = np.array([math.sqrt(wide * high), math.log(wide / high), earlier.radius]), 0.01
    free = 3 if radius is None else 2
    simplex = start + np.vstack([np.zeros(3), np.diag([step * pitch, 2 * step, step / 2])])
    options = {
        "initial_simplex": simplex[: free + 1, :free],
        "maxfev": MOST_TRIALS if earlier is None else MOST_TRIALS // 2,
        "xatol": 2e-3,
        "fatol": 1e-3 * float(np.median(levels)),
    }
    with threadpool_limits(1):  # of many small matrices: threads would wait for one another most of the time
        found = minimize(misfit, start[:free], method="Nelder-Mead", options=options).x
        size, blur = unpacked(found)
        residual, levels, background = _explained(crop, best[1], size, blur / binning, LEVEL_ROUNDS)
    return Model(size, blur, levels, background, residual)


def _crop(values: Field, homography: Matrix, shape: tuple[int, int], binning: int, slopes: Field) -> _Crop:
    rows, columns = shape
    corners = np.array(
        [(c, r) for c in (-OUTSIDE, columns - 1 + OUTSIDE) for r in (-OUTSIDE, rows - 1 + OUTSIDE)], dtype=np.float64
    )
    image = project(homography, corners)
    low = np.maximum(np.floor(image.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(image.max(axis=0)).astype(int) + 1, np.array(values.shape[::-1]))
    high = low + (high - low) // binning * binning
    part = _binned(values[low[1] : high[1], low[0] : high[0]], binning)
    u = low[0] + (binning - 1) / 2 + binning * np.arange(part.shape[1])
    v = low[1] + (binning - 1) / 2 + binning * np.arange(part.shape[0])
    inverse = np.linalg.inv(homography)
    inside = project(inverse, _mesh(u, v))
    last = np.array([columns - 1, rows - 1])
    used: NDArray[np.bool_] = np.asarray(((inside >= -OUTSIDE) & (inside <= last + OUTSIDE)).all(axis=-1))
    nearest = np.clip(np.rint(inside), 0, last)
    dot = (nearest[..., 1] * columns + nearest[..., 0]).astype(np.intp)
    away = _mesh(u, v) - project(homography, nearest)
    offsets: Field = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5) * binning
    fine = project(inverse, _mesh((u[:, None] + offsets).ravel(), (v[:, None] + offsets).ravel()))
    distance = np.linalg.norm(fine - np.clip(np.rint(fine), 0, last), axis=-1)
    clipped = used & (part >= float(values.max()))
    exact = np.flatnonzero(used & ~clipped)
    design = np.column_stack([np.ones(part.size), np.tile(u, len(v)), np.repeat(v, len(u))])
    return _Crop(
        values=part,
        design=design,
        used=used,
        clipped=clipped,
        exact=exact,
        plane=design[exact],
        dot=dot,
        light=_light(slopes[dot], away),
        distance=distance,
        sharpness=_sharpness(distance),
    )


def _mesh(u: NDArray[Any], v: NDArray[Any]) -> Field:
    """(u, v) of all pairs, shape (len(v), len(u), 2)."""
    return np.asarray(np.stack(np.meshgrid(u, v), axis=-1), dtype=np.float64)


def _light(slope: Field, away: Field) -> Field:
    """Light off a dot's centre, 1 in it; no more than a factor of e is believed."""
    return np.asarray(np.exp(np.clip(np.sum(slope * away, axis=-1), -1.0, 1.0)))


def _sharpness(distance: Field) -> Field:
    """Samples for each pitch of distance: softens a rim over one sample."""
    return np.asarray(1 / np.maximum(np.hypot(*np.gradient(distance)), 1e-9))


def _cover(distance: Field, sharpness: Field, radius: float) -> Field:
    """Share of each pixel that a disc covers."""
    return _binned(np.clip((radius - distance) * sharpness + 0.5, 0.0, 1.0), SAMPLES)


def _explained(crop: _Crop, levels: Field, radius: float, blur: Field, rounds: int) -> tuple[float, Field, Field]:
    """What size and blur leave unexplained, with the levels and the background that go with them."""
    cover = _cover(crop.distance, crop.sharpness, radius) * crop.light
    kernel = _Blur(blur)
    shares = np.maximum(np.bincount(crop.dot.ravel(), cover.ravel(), len(levels)), 1e-3)
    use, clipped = crop.used.ravel(), crop.clipped.ravel()
    gray = crop.values.ravel()
    told = gray[crop.exact]
    normal, target = np.empty((4, 4)), np.empty(4)
    normal[1:, 1:], target[1:] = crop.plane.T @ crop.plane, crop.plane.T @ told
    rest, background = gray, np.zeros(3)
    for step in range(rounds + 1):
        light = kernel(levels[crop.dot] * cover).ravel()
        # One factor for all levels and the background at once, then each level by how much its own light is
        # over- or under-told.
        lit = light[crop.exact]
        normal[0, 0], target[0] = lit @ lit, lit @ told
        normal[0, 1:] = normal[1:, 0] = lit @ crop.plane
        factor, *plane = np.linalg.lstsq(normal, target, rcond=None)[0]
        levels, background = levels * factor, np.array(plane)
        rest = np.where(use, gray - crop.design @ background - factor * light, 0.0)
        rest = np.where(clipped, np.maximum(rest, 0.0), rest)
        if step < rounds:
            left = np.bincount(crop.dot.ravel(), (cover * kernel(rest.reshape(cover.shape))).ravel(), len(levels))
            levels = np.maximum(levels + LEVEL_GAIN * left / shares, 0.0)
    return float(np.sqrt(np.mean(rest[use] ** 2))), levels, background


class _Blur:
    """Convolution with an ellipse of any semi-axes [px], by its Fourier transform 2 J1(x)/x."""

    def __init__(self, axes: Field) -> None:
        self._wide, self._high = (float(axis) for axis in axes)
        self._transforms: dict[tuple[int, int], Field] = {}  # dots are many, their pictures' sizes few

    def __call__(self, field: Field) -> Field:
        from scipy import fft

        # Room for light that would come in again on the other side.
        rows, columns = (
            fft.next_fast_len(length + math.ceil(axis) + 1, real=True)
            for length, axis in zip(field.shape, (self._high, self._wide), strict=True)
        )
        blurred = fft.irfft2(fft.rfft2(field, (rows, columns)) * self._transform(rows, columns), (rows, columns))
        return np.asarray(blurred[: field.shape[0], : field.shape[1]])

    def _transform(self, rows: int, columns: int) -> Field:
        from scipy import special

        if (rows, columns) not in self._transforms:
            fy = self._high * np.fft.fftfreq(rows)[:, None]
            fx = self._wide * np.fft.rfftfreq(columns)[None, :]
            x = 2 * math.pi * np.hypot(fx, fy)
            self._transforms[rows, columns] = np.where(x > 1e-6, 2 * special.j1(x) / np.maximum(x, 1e-6), 1.0)
        return self._transforms[rows, columns]


def _binned(field: Field, samples: int) -> Field:
    rows, columns = field.shape
    return np.asarray(field.reshape(rows // samples, samples, columns // samples, samples).mean(axis=(1, 3)))


def dot_images(
    homography: Matrix, centres: Field, slopes: Field, radius: float, blur: Field
) -> list[tuple[tuple[int, int], Field]]:
    """Pictures of blurred dots of level 1, each for itself.

    Parameters
    ----------
    homography : ndarray, shape (3, 3)
        Board to image.
    centres : ndarray, shape (n, 2)
        The dots on the board [pitch].
    slopes : ndarray, shape (n, 2)
        Relative gradient of the light at each [1/px].
    radius : float
        See `Model`.
    blur : ndarray, shape (2,)
        See `Model`.

    Returns
    -------
    list of (tuple of int, ndarray of shape (rows, columns))
        Column u and row v of its first pixel, which may be negative, and the share of the level in each pixel, 0 to 1.
    """
    kernel, inverse = _Blur(blur), np.linalg.inv(homography)
    angles = np.linspace(0, 2 * math.pi, 64, endpoint=False)
    rims = project(homography, centres[:, None, :] + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
    lows = np.floor(rims.min(axis=1) - blur - 1.5).astype(int)
    highs = np.ceil(rims.max(axis=1) + blur + 1.5).astype(int) + 1
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    pictures = []
    for centre, slope, low, high in zip(centres, slopes, lows, highs, strict=True):
        u, v = ((np.arange(low[axis], high[axis])[:, None] + offsets).ravel() for axis in (0, 1))
        away = np.linalg.norm(project(inverse, _mesh(u, v)) - centre, axis=-1)
        pixels = _mesh(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        cover = _cover(away, _sharpness(away), radius) * _light(slope, pixels - project(homography, centre))
        pictures.append(((int(low[0]), int(low[1])), kernel(cover)))
    return pictures


def refined(values: Field, homography: Matrix, board: Field, slopes: Field, model: Model) -> tuple[Matrix, Model]:
    """Move all dots at once to where the model explains the picture best.

    One step of Gauss and Newton for every dot's shift and level and the
    background together, so that a dot is not drawn to a neighbour's light;
    the homography is then fitted to the shifted dots.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Gray levels times the sign of the contrast.
    homography : ndarray, shape (3, 3)
        Board to image.
    board : ndarray, shape (n, 2)
        (column, row) of each dot.
    slopes : ndarray, shape (n, 2)
        Relative gradient of the light at each dot [1/px].
    model : Model
        Where to start from.

    Returns
    -------
    homography : ndarray, shape (3, 3)
    model : Model
        With new levels and background.
    """
    from scipy import sparse

    height, width = values.shape
    entries: list[Field] = []
    pixels: list[NDArray[np.intp]] = []
    columns: list[NDArray[np.intp]] = []
    pictures = dot_images(homography, board, slopes, model.radius, model.blur)
    for dot, ((left, top), picture) in enumerate(pictures):
        dv, du = np.gradient(picture)
        v, u = np.mgrid[top : top + picture.shape[0], left : left + picture.shape[1]]
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        place = (v * width + u)[seen]
        for number, part in enumerate((picture, -model.levels[dot] * du, -model.levels[dot] * dv)):
            entries.append(part[seen])
            pixels.append(place)
            columns.append(np.full(len(place), 3 * dot + number, dtype=np.intp))
    # Only pixels that some dot reaches; the background is seen between the dots.
    used, rows = np.unique(np.concatenate(pixels), return_inverse=True)
    count = 3 * len(board)
    shape = (len(used), count)
    light = sparse.csr_array((np.concatenate(entries), (rows, np.concatenate(columns))), shape=shape)
    plane = np.column_stack([np.ones(len(used)), used % width, used // width])
    gray = values.ravel()[used]
    # A clipped pixel does not tell its light, so nothing of where dots are.
    exact = gray < gray.max()
    design = sparse.hstack([light, sparse.csr_array(plane)]).tocsr()[exact].tocsc()
    normal = (design.T @ design).toarray() if count < DENSE else None
    target = design.T @ gray[exact]
    if normal is not None:
        solution = np.linalg.lstsq(normal, target, rcond=1e-13)[0]
    else:
        from scipy.sparse.linalg import spsolve

        solution = spsolve((design.T @ design).tocsc(), target)
    dots = solution[:count].reshape(-1, 3)
    # No farther than a pixel a step: beyond, the picture's gradient means nothing.
    places = project(homography, board) + np.clip(dots[:, 1:], -1.0, 1.0)
    return fit_homography(board, places), replace(
        model, levels=np.maximum(dots[:, 0], 1e-3), background=solution[count:]
    )
