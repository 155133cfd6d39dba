"""Before the centres: background, level, size and neighbours of every dot of a known grid."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.dots.centres import Window
from radwrap.measure.dots.plane import Matrix, jacobian, project
from radwrap.measure.dots.split import FAINT, Model, dot_images, fit_model

Field = NDArray[np.float64]

# Where dots do not touch, a dot's window ends half way to its neighbours [pitch].
HALF_CELL: Final = 0.5
# Light half way between two dots, as a share of the dimmer one's level, from which on they run together.
TOUCHING: Final = 0.10
# Background is sampled at the corners of a dot's cell, farthest from all dots, on patches of this half width [pitch].
SMALLEST_PATCH: Final = 0.05
LARGEST_PATCH: Final = 0.2
PATCH_SAMPLES: Final = 5
MIDDLE_PATCH: Final = 0.05
# First guess of a dot's radius [pitch], before it is measured.
USUAL_RADIUS: Final = 0.3
# A model that leaves more than this share of the levels does not describe the board.
LARGEST_RESIDUAL: Final = 0.15
# Shading is a quadratic in the logarithm of the levels; boards whose levels leave more than this are not so lit.
LARGEST_SHADING_RESIDUAL: Final = 0.06
FEWEST_SHADING_DOTS: Final = 9
# Light that changes by less than this over a pitch shifts no centre by 0.01 px where dots do not touch: their blur
# is then a tenth of a pitch, and the shift a quarter of its square times the gradient.
EVEN: Final = 0.05
# Dots whose middle comes nearer to saturation do not tell the light.
NEAR_SATURATION: Final = 0.98


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid in the picture; dots go row by row.

    Attributes
    ----------
    values : ndarray, shape (rows, columns)
        Gray levels times `sign`.
    sign : int
        +1 for bright dots, -1 for dark ones.
    shape : tuple of int
        Rows and columns of dots.
    homography : ndarray, shape (3, 3)
        Board to image.
    places : ndarray, shape (n, 2)
        Where the dots are expected [px].
    radius : float, optional
        Of the dots [pitch], where the user gave it.
    dark : float, optional
        Gray level to take away in place of the background around the dots.
    saturation : float
        Gray level from which on the sensor saturates.
    """

    values: Field
    sign: int
    shape: tuple[int, int]
    homography: Matrix
    places: Field
    radius: float | None
    dark: float | None
    saturation: float

    @property
    def board(self) -> Field:
        """(column, row) of each dot [pitch], shape (n, 2)."""
        return board_of(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What is known of the dots before their centres.

    Attributes
    ----------
    affine : ndarray, shape (n, 2, 2)
        d(u, v)/d(column, row) at each dot.
    background : ndarray, shape (n, 3)
        b in ``b[0] + b[1] (u - u0) + b[2] (v - v0)`` about each dot's place.
    levels : ndarray, shape (n,)
        Signal in the middle of each dot above its background [gray].
    radius : float
        Of the dots [pitch].
    touching : ndarray of bool, shape (n,)
        Whether a dot's light runs into a neighbour's.
    slopes : ndarray, shape (n, 2), optional
        Relative gradient of the light at each dot [1/px], where levels follow
        a smooth law.
    model : Model, optional
        The board's light, where dots touch or the light falls off, and the
        model holds.
    """

    affine: Field
    background: Field
    levels: Field
    radius: float
    touching: NDArray[np.bool_]
    slopes: Field | None
    model: Model | None


def board_of(shape: tuple[int, int]) -> Field:
    """(column, row) of all dots, row by row."""
    return np.array([(c, r) for r in range(shape[0]) for c in range(shape[1])], dtype=np.float64)


def sampled(values: Field, places: Field) -> Field:
    """Bilinear gray levels at (u, v); NaN outside the picture."""
    from scipy import ndimage

    u, v = places[..., 0], places[..., 1]
    inside = (u >= -0.5) & (u <= values.shape[1] - 0.5) & (v >= -0.5) & (v <= values.shape[0] - 0.5)
    found = ndimage.map_coordinates(values, [v, u], order=1, mode="nearest")
    return np.where(inside, found, np.nan)


def patch_means(values: Field, matrix: Matrix, points: Field, half_width: float) -> Field:
    """Mean gray level on small squares of the board about each point; NaN where all of it is out of view.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Gray levels.
    matrix : ndarray, shape (3, 3)
        Board to image.
    points : ndarray, shape (..., 2)
        On the board [pitch].
    half_width : float
        Of the squares [pitch].
    """
    offsets = np.linspace(-half_width, half_width, PATCH_SAMPLES)
    grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    gray = sampled(values, project(matrix, points[..., None, :] + grid))
    seen = np.isfinite(gray)
    return np.asarray(
        np.where(seen.any(axis=-1), np.where(seen, gray, 0.0).sum(axis=-1) / np.maximum(seen.sum(axis=-1), 1), np.nan)
    )


_CORNERS: Final = np.array(list(itertools.product((-0.5, 0.5), repeat=2)))
_SIDES: Final = ((1, 0), (0, 1))


def survey(grid: Grid, noise: float, earlier: Model | None = None) -> Survey:
    """Look at all dots."""
    board = grid.board
    affine = jacobian(grid.homography, board)
    cell = np.abs(np.linalg.det(affine))
    radius = grid.radius or USUAL_RADIUS
    for _ in range(1 if grid.radius else 3):
        patch = float(np.clip(0.5 * (math.sqrt(0.5) - radius), SMALLEST_PATCH, LARGEST_PATCH))
        corners = patch_means(grid.values, grid.homography, board[:, None, :] + _CORNERS, patch)
        background = _planes(grid, corners, affine)
        levels = _core_means(grid, affine, radius) - background[:, 0]
        if grid.radius is None:
            radius = _radius(grid, affine, background, levels) or radius
    touching = _touching(grid, background, levels, noise)
    usable = grid.sign * (levels + background[:, 0]) < NEAR_SATURATION * grid.saturation
    slopes = shading(grid.places, levels if earlier is None else earlier.levels, usable)
    model = None
    if touching.any() or (slopes is not None and np.abs(slopes).max() * math.sqrt(np.median(cell)) > EVEN):
        model = fit_model(
            grid.values,
            grid.homography,
            grid.shape,
            np.maximum(levels, 1e-3),
            radius=grid.radius,
            slopes=np.zeros_like(grid.places) if slopes is None else slopes,
            earlier=earlier,
        )
        if model.residual > LARGEST_RESIDUAL * float(np.median(model.levels)) + 2 * noise:
            model = None
    if model is not None and touching.any():
        radius = model.radius
        plain = np.column_stack([np.ones(len(board)), grid.places]) @ model.background
        model_planes = np.column_stack([plain, np.tile(model.background[1:], (len(board), 1))])
        background = np.where(touching[:, None], model_planes, background)
    return Survey(affine, background, levels, radius, touching, slopes, model)


def _planes(grid: Grid, corners: Field, affine: Field) -> Field:
    """Background about each dot from the corners of its cell; flat where a corner is out of view."""
    mean = np.nanmean(np.where(np.isfinite(corners).any(axis=1, keepdims=True), corners, 0.0), axis=1)
    whole = np.isfinite(corners).all(axis=1)
    filled = np.where(np.asarray(whole)[:, None], corners, mean[:, None])
    # Least-squares slope over a unit cell's four corners, from board to image.
    slope = 2 * np.einsum("nk,kx->nx", filled, _CORNERS) / 2
    return np.column_stack([mean, np.einsum("nx,nxu->nu", slope, np.linalg.inv(affine))])


def _core_means(grid: Grid, affine: Field, radius: float) -> Field:
    """Mean gray level within half a dot's radius of its place."""
    means = []
    for place, local in zip(grid.places, affine, strict=True):
        window = _cut(grid, place, local, 0.5 * radius)
        if window is None:
            means.append(math.nan)
            continue
        rows, columns, _, distance = window
        inside = distance <= max(0.5 * radius, float(distance.min()))
        means.append(float(grid.values[rows, columns][inside].mean()))
    return np.asarray(np.nan_to_num(np.array(means), nan=float(grid.values.min())))


def _cut(grid: Grid, place: Field, local: Field, reach: float) -> tuple[slice, slice, Field, Field] | None:
    """Pixels within `reach` [pitch] of a place: slices, (u, v) of the first, distance of each [pitch]."""
    extent = reach * np.linalg.norm(local, axis=1) + 1.0
    low = np.maximum(np.ceil(place - extent).astype(int), 0)
    high = np.minimum(np.floor(place + extent).astype(int) + 1, np.array(grid.values.shape[::-1]))
    if (high <= low).any():
        return None
    u, v = np.arange(low[0], high[0]) - place[0], np.arange(low[1], high[1]) - place[1]
    inverse = np.linalg.inv(local)
    s = inverse[0, 0] * u[None, :] + inverse[0, 1] * v[:, None]
    t = inverse[1, 0] * u[None, :] + inverse[1, 1] * v[:, None]
    return slice(low[1], high[1]), slice(low[0], high[0]), low.astype(np.float64), np.hypot(s, t)


def _plane_on(background: Field, place: Field, origin: Field, shape: tuple[int, ...]) -> Field:
    u = origin[0] + np.arange(shape[1]) - place[0]
    v = origin[1] + np.arange(shape[0]) - place[1]
    return np.asarray(background[0] + background[1] * u[None, :] + background[2] * v[:, None])


def _radius(grid: Grid, affine: Field, background: Field, levels: Field) -> float | None:
    """Median over the dots of the radius whose disc holds the dot's light at the dot's level [pitch]."""
    found = []
    for place, local, plane, level in zip(grid.places, affine, background, levels, strict=True):
        window = _cut(grid, place, local, HALF_CELL)
        if window is None or level <= 0:
            continue
        rows, columns, origin, distance = window
        signal = grid.values[rows, columns] - _plane_on(plane, place, origin, distance.shape)
        light = float(signal[distance <= HALF_CELL].sum()) / level
        if light > 0:
            found.append(math.sqrt(light / math.pi / abs(float(np.linalg.det(local)))))
    return float(np.clip(np.median(found), 0.05, HALF_CELL)) if found else None


def _touching(grid: Grid, background: Field, levels: Field, noise: float) -> NDArray[np.bool_]:
    rows, columns = grid.shape
    board = grid.board
    touching = np.zeros(len(board), dtype=bool)
    number = np.arange(len(board)).reshape(rows, columns)
    for across, down in _SIDES:
        here = number[: rows - down, : columns - across].ravel()
        there = number[down:, across:].ravel()
        gray = patch_means(grid.values, grid.homography, (board[here] + board[there]) / 2, MIDDLE_PATCH)
        above = gray - (background[here, 0] + background[there, 0]) / 2
        least = TOUCHING * np.minimum(levels[here], levels[there]) + 4 * noise / PATCH_SAMPLES
        together = np.asarray(above > least)
        touching[here[together]] = True
        touching[there[together]] = True
    return touching


def windows(grid: Grid, found: Survey) -> list[Window | None]:
    """The picture of each dot alone; None for a dot out of view."""
    slopes = np.zeros_like(grid.places) if found.slopes is None else found.slopes
    alone: dict[int, tuple[tuple[int, int], Field]] = {}
    if found.model is not None:
        near = _concerned(grid, found)
        model = found.model
        pictures = dot_images(grid.homography, grid.board[near], slopes[near], model.radius, model.blur)
        alone = dict(zip(near, pictures, strict=True))
    return [_window(grid, found, dot, alone) for dot in range(len(grid.board))]


def _concerned(grid: Grid, found: Survey) -> list[int]:
    """Dots that touch, and all around them."""
    touching = found.touching.reshape(grid.shape)
    padded = np.pad(touching, 1)
    near = np.zeros_like(touching)
    for down, across in itertools.product(range(3), repeat=2):
        near |= padded[down : down + touching.shape[0], across : across + touching.shape[1]]
    return [int(dot) for dot in np.flatnonzero(near)]


def _window(grid: Grid, found: Survey, dot: int, alone: dict[int, tuple[tuple[int, int], Field]]) -> Window | None:
    place, local = grid.places[dot], found.affine[dot]
    model = found.model
    scale = math.sqrt(abs(float(np.linalg.det(local))))
    split = bool(found.touching[dot]) and model is not None
    # Sparse dots need not take in the noise of the whole cell.
    reach = min(HALF_CELL, found.radius + max(0.5 * found.radius, 3.0 / scale))
    if split and model is not None:
        smallest = float(np.linalg.svd(local, compute_uv=False)[-1])
        reach = min(found.radius + (float(model.blur.max()) + 1.0) / smallest, 1.0)
    cut = _cut(grid, place, local, reach)
    if cut is None:
        return None
    rows, columns, origin, distance = cut
    signal = grid.values[rows, columns] - _plane_on(found.background[dot], place, origin, distance.shape)
    inside = distance <= reach
    if split and model is not None:
        own = _laid(alone[dot], origin, distance.shape)
        inside = own > FAINT
        for other in _around(grid.shape, dot):
            if other in alone:
                signal = signal - model.levels[other] * _laid(alone[other], origin, distance.shape)
    if grid.dark is not None and grid.sign > 0:
        # The user's zero in place of the background; neighbours' light stays away.
        signal = signal + _plane_on(found.background[dot], place, origin, distance.shape) - grid.dark
    core = distance <= max(0.5 * found.radius, float(distance.min()))
    level = float(signal[core].mean())
    return Window(origin, signal, inside, place, local, found.radius, reach, level)


def _around(shape: tuple[int, int], dot: int) -> list[int]:
    row, column = divmod(dot, shape[1])
    return [
        (row + down) * shape[1] + column + across
        for down, across in itertools.product((-1, 0, 1), repeat=2)
        if (down or across) and 0 <= row + down < shape[0] and 0 <= column + across < shape[1]
    ]


def _laid(picture: tuple[tuple[int, int], Field], origin: Field, shape: tuple[int, ...]) -> Field:
    """Lay one dot's picture over a window."""
    (left, top), dot = picture
    laid = np.zeros(shape)
    across, down = left - int(origin[0]), top - int(origin[1])
    rows = slice(max(down, 0), min(down + dot.shape[0], shape[0]))
    columns = slice(max(across, 0), min(across + dot.shape[1], shape[1]))
    if rows.stop > rows.start and columns.stop > columns.start:
        laid[rows, columns] = dot[rows.start - down : rows.stop - down, columns.start - across : columns.stop - across]
    return laid


def shading(places: Field, levels: Field, usable: NDArray[np.bool_]) -> Field | None:
    """How the light falls off about each dot.

    The logarithm of the dots' levels as a quadratic in (u, v), which a
    Gaussian beam, vignetting and fall-off with distance nearly are.

    Returns
    -------
    ndarray of shape (n, 2), or None
        Relative gradient of the light at each dot [1/px]; None where the
        levels do not follow such a law, or too few dots are usable.
    """
    usable = usable & (levels > 0)
    if usable.sum() < FEWEST_SHADING_DOTS:
        return None
    mean = places.mean(axis=0)
    size = float(np.ptp(places, axis=0).max()) or 1.0
    x, y = ((places - mean) / size).T
    design = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    logarithm = np.log(np.where(usable, levels, 1.0))
    law = np.linalg.lstsq(design[usable], logarithm[usable], rcond=None)[0]
    residual = (logarithm - design @ law)[usable]
    if float(np.sqrt(np.mean(residual**2))) > LARGEST_SHADING_RESIDUAL:
        return None
    return np.column_stack([law[1] + 2 * law[3] * x + law[4] * y, law[2] + law[4] * x + 2 * law[5] * y]) / size
