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
    return _Crop(
        values=part,
        design=np.column_stack([np.ones(part.size), np.tile(u, len(v)), np.repeat(v, len(u))]),
        used=used,
        clipped=used & (part >= float(values.max())),
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
    kernel = _Blur(cover.shape, blur)
    shares = np.maximum(np.bincount(crop.dot.ravel(), cover.ravel(), len(levels)), 1e-3)
    use, clipped = crop.used.ravel(), crop.clipped.ravel()
    told_exactly = use & ~clipped
    gray = crop.values.ravel()
    rest, background = gray, np.zeros(3)
    for step in range(rounds + 1):
        light = kernel(levels[crop.dot] * cover).ravel()
        # One factor for all levels and the background at once, then each level by how much its own light is
        # over- or under-told.
        columns = np.column_stack([light, crop.design])
        exact = columns[told_exactly]
        factor, *plane = np.linalg.lstsq(exact.T @ exact, exact.T @ gray[told_exactly], rcond=None)[0]
        levels, background = levels * factor, np.array(plane)
        rest = np.where(use, gray - crop.design @ background - factor * light, 0.0)
        rest = np.where(clipped, np.maximum(rest, 0.0), rest)
        if step < rounds:
            told = np.bincount(crop.dot.ravel(), (cover * kernel(rest.reshape(cover.shape))).ravel(), len(levels))
            levels = np.maximum(levels + LEVEL_GAIN * told / shares, 0.0)
    return float(np.sqrt(np.mean(rest[use] ** 2))), levels, background


class _Blur:
    """Convolution with an ellipse of any semi-axes [px], by its Fourier transform 2 J1(x)/x."""

    def __init__(self, shape: tuple[int, ...], axes: Field) -> None:
        from scipy import fft, special

        self._shape = shape
        wide, high = (float(axis) for axis in axes)
        # Room for light that would come in again on the other side.
        self._size = [
            fft.next_fast_len(length + math.ceil(axis) + 1, real=True)
            for length, axis in zip(shape, (high, wide), strict=True)
        ]
        fy = high * np.fft.fftfreq(self._size[0])[:, None]
        fx = wide * np.fft.rfftfreq(self._size[1])[None, :]
        x = 2 * math.pi * np.hypot(fx, fy)
        self._transform = np.where(x > 1e-6, 2 * special.j1(x) / np.maximum(x, 1e-6), 1.0)

    def __call__(self, field: Field) -> Field:
        from scipy import fft

        blurred = fft.irfft2(fft.rfft2(field, self._size) * self._transform, self._size)
        return np.asarray(blurred[: self._shape[0], : self._shape[1]])


def _binned(field: Field, samples: int) -> Field:
    rows, columns = field.shape
    return np.asarray(field.reshape(rows // samples, samples, columns // samples, samples).mean(axis=(1, 3)))


def dot_image(
    homography: Matrix, centre: Field, slope: Field, radius: float, blur: Field
) -> tuple[tuple[int, int], Field]:
    """Picture of one blurred dot of level 1.

    Parameters
    ----------
    homography : ndarray, shape (3, 3)
        Board to image.
    centre : ndarray, shape (2,)
        The dot on the board [pitch].
    slope : ndarray, shape (2,)
        Relative gradient of the light [1/px].
    radius : float
        See `Model`.
    blur : ndarray, shape (2,)
        See `Model`.

    Returns
    -------
    tuple of int
        Column u and row v of its first pixel; may be negative.
    ndarray, shape (rows, columns)
        Share of the level in each pixel, 0 to 1.
    """
    angles = np.linspace(0, 2 * math.pi, 64, endpoint=False)
    rim = project(homography, centre + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
    low = np.floor(rim.min(axis=0) - blur - 1.5).astype(int)
    high = np.ceil(rim.max(axis=0) + blur + 1.5).astype(int) + 1
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u, v = ((np.arange(low[axis], high[axis])[:, None] + offsets).ravel() for axis in (0, 1))
    away = np.linalg.norm(project(np.linalg.inv(homography), _mesh(u, v)) - centre, axis=-1)
    pixels = _mesh(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    cover = _cover(away, _sharpness(away), radius) * _light(slope, pixels - project(homography, centre))
    return (int(low[0]), int(low[1])), _Blur(cover.shape, blur)(cover)


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
    for dot, (centre, slope) in enumerate(zip(board, slopes, strict=True)):
        (left, top), picture = dot_image(homography, centre, slope, model.radius, model.blur)
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
