"""Fourth stage: the grid in the picture, and that every place of it holds a dot and none beyond does."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.measure.dots.centres import Centre, centre
from radwrap.measure.dots.contrast import JUST_OUTSIDE, LIKE_A_DOT, likelier_contrast
from radwrap.measure.dots.detect import blobs
from radwrap.measure.dots.order import Lattice, order
from radwrap.measure.dots.plane import Matrix, fit_homography, is_regular, jacobian, project
from radwrap.measure.dots.result import REMEDY, DotsNotFound, missing, too_many
from radwrap.measure.dots.split import refined
from radwrap.measure.dots.survey import Grid, Survey, board_of, patch_means, sampled, survey, windows
from radwrap.progress import Progress

Field = NDArray[np.float64]

# Scales and contrasts that are tried, the likeliest first.
TRIALS: Final = 12
# Share of the dots that must be seen at once before the grid is trusted to tell where the others are.
ENOUGH: Final = 0.6
# Scales that answer less than this share of the strongest show other things than the dots.
WEAKER: Final = 0.3
HYPOTHESES: Final = 3
# Share of neighbours in a row that may be no brighter than what lies between them: noise, missing dots.
MOST_BRIGHTER: Final = 0.25
UNSEEN_PATCH: Final = 0.08  # [pitch]
# Where dots run together the dark between them is looked at so far from a corner of their cells [pitch]; its centre
# lies aside by less than this unless the grid strayed: right grids of saturated boards show 0.003, strayed ones 0.06.
GAP_REACH: Final = 0.35
GAP_SAMPLES: Final = 7
LARGEST_ASIDE: Final = 0.03
OUTSIDE_PATCH: Final = 0.06  # [pitch]
ROUNDS: Final = 4
# The grid is settled once no dot's place moves by more [px].
SETTLED: Final = 0.03
STEPS: Final = 2
# A dot's centre lies where the grid says to this [pitch]: lens distortion moves neighbours together, not one alone.
LARGEST_MISS: Final = 0.2
# A dot has at least this share of the level of the board's bright dots, and this many times the noise.
FAINTEST: Final = 0.03
LEAST_SIGNAL: Final = 4.0
# Its image has the area that its neighbours' have, to these factors.
SMALLEST_AREA: Final = 0.35
LARGEST_AREA: Final = 2.8
# Places just outside the grid: dots there have this share of the level of their neighbours in the grid; a row of
# dots is one where half of the places in view have one.
LEVEL_BEYOND: Final = 0.3
SHARE_BEYOND: Final = 0.5


def grid_in(
    image: GrayImage,
    shape: tuple[int, int],
    noise: float,
    radius: float | None,
    *,
    saturation: float,
    progress: Progress,
) -> tuple[Grid, Survey]:
    """Find the grid and see that every dot is there.

    Parameters
    ----------
    image : GrayImage
        The picture.
    shape : tuple of int
        Rows and columns of dots.
    noise : float
        Standard deviation of a pixel [gray].
    radius : float or None
        Of the dots, where it is known [pitch].
    saturation : float
        Gray level from which on the sensor saturates.
    progress : Progress
        Counts scales and rounds.

    Returns
    -------
    Grid, Survey

    Raises
    ------
    DotsNotFound
        If dots are missing, or go on beyond the grid.
    """
    number = shape[0] * shape[1]
    lattices = _lattices(image, shape, progress)
    if not lattices:
        nothing = np.empty((0, 2))
        raise DotsNotFound(f"found 0 of {number} dots", nothing, nothing, remedy=REMEDY)
    sign = likelier_contrast(image.values, {one: tried[0] for one, tried in lattices.items()})
    failed: DotsNotFound | None = None
    for likely, lattice in _hypotheses(lattices, sign, number):
        try:
            grid, found = _settled(
                _grid(image, likely, shape, lattice, noise=noise, radius=radius, saturation=saturation),
                noise,
                progress,
            )
            if likely != sign:
                _check_beyond(grid, found, noise)
        except DotsNotFound as error:
            # The likeliest lattice tells the user most.
            failed = error if failed is None or len(failed.found) == 0 else failed
            continue
        # Outside the loop's error: a grid that is whole and goes on is no matter of scale.
        _check_beyond(grid, found, noise)
        misfit = _outside(grid, found)
        if misfit is None:
            return grid, found
        failed = failed or misfit
    best = lattices[sign][0]
    if failed is None or (best.found == number and len(best.beyond) >= min(shape)):
        raise too_many(shape, "around", best.image) from failed
    raise failed


def grid_near(image: GrayImage, near: Grid, noise: float, progress: Progress) -> tuple[Grid, Survey]:
    """Find the grid where that of a very similar image is, without looking for it.

    Parameters
    ----------
    image : GrayImage
        The picture.
    near : Grid
        Of the other image.
    noise : float
        Standard deviation of a pixel [gray].
    progress : Progress
        Counts rounds.

    Returns
    -------
    Grid, Survey

    Raises
    ------
    DotsNotFound
        If it is not there, or not whole.
    """
    progress.expect(ROUNDS)
    grid, found = _settled(replace(near, values=image.values * near.sign), noise, progress)
    _check_beyond(grid, found, noise)
    if (misfit := _outside(grid, found)) is not None:
        raise misfit
    return grid, found


def _hypotheses(lattices: dict[int, list[Lattice]], sign: int, number: int) -> Iterator[tuple[int, Lattice]]:
    """Contrast and lattice, the likeliest first; of the other contrast only what is whole and nothing more.

    The gaps between dots are a lattice too, but they end in notches at the board's rim, or are too few.
    """
    for lattice in lattices[sign]:
        yield sign, lattice
    for lattice in lattices.get(-sign, []):
        if lattice.found == number and len(lattice.beyond) == 0:
            yield -sign, lattice


def _lattices(image: GrayImage, shape: tuple[int, int], progress: Progress) -> dict[int, list[Lattice]]:
    """Lattices of each contrast, of several scales, the likeliest first.

    At too fine a scale long dots count twice and fill a larger grid, at too
    coarse a one some are lost.
    """
    rows, columns = shape
    number = rows * columns
    found: dict[int, list[tuple[float, Lattice]]] = {}
    trials = blobs(image.values, number)[:TRIALS]
    progress.expect(len(trials) + ROUNDS)
    for trial in trials:
        progress.add(1)
        tried = found.setdefault(trial.sign, [])
        answer = trial.answer(number)
        if tried and answer < WEAKER * tried[0][0]:
            continue
        if any(lattice.found == number and len(lattice.beyond) == 0 for _, lattice in tried):
            continue
        lattice = order(trial.points, rows, columns)
        if lattice is not None:
            tried.append((answer, lattice))
    return {
        sign: [lattice for _, lattice in sorted(tried, key=lambda one: (-_neatness(one[1]), -one[0]))[:HYPOTHESES]]
        for sign, tried in found.items()
        if tried
    }


def _neatness(lattice: Lattice) -> float:
    """Dots in the grid, less half of those beyond it."""
    return lattice.found - len(lattice.beyond) / 2


def _grid(
    image: GrayImage,
    sign: int,
    shape: tuple[int, int],
    lattice: Lattice,
    *,
    noise: float,
    radius: float | None,
    saturation: float,
) -> Grid:
    """Take a lattice for the grid, where it shows enough of it."""
    number = shape[0] * shape[1]
    board = board_of(shape)
    if lattice.found < max(ENOUGH * number, 4) or not is_regular(lattice.homography, board):
        raise DotsNotFound(f"found {lattice.found} of {number} dots", lattice.image, np.empty((0, 2)), remedy=REMEDY)
    values = image.values * sign
    matrix = _unseen(values, shape, lattice, noise) if lattice.found < number else lattice.homography
    return Grid(values, sign, shape, matrix, project(matrix, board), radius, None, saturation)


def _unseen(values: Field, shape: tuple[int, int], lattice: Lattice, noise: float) -> Matrix:
    """Where the dots are that no candidate stands for: the homography, after a test of the picture itself.

    Where a whole row has no candidates, it may lie at either end of the rest.
    """
    board = board_of(shape)
    best: tuple[NDArray[np.bool_], Matrix] | None = None
    for shift in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
        shifted = lattice.board + shift
        if (shifted < 0).any() or (shifted > board[-1]).any():
            continue
        matrix = fit_homography(shifted, lattice.image)
        if not is_regular(matrix, board):
            continue
        there = np.zeros(len(board), dtype=bool)
        there[(shifted[:, 1] * shape[1] + shifted[:, 0]).astype(int)] = True
        core = patch_means(values, matrix, board, UNSEEN_PATCH)
        corners = patch_means(values, matrix, board[:, None, :] + _CORNERS, UNSEEN_PATCH)
        with np.errstate(invalid="ignore"):
            level = core - corners.mean(axis=1)
            there |= level > max(FAINTEST * float(np.nanmedian(level[there])), noise)
        if best is None or there.sum() > best[0].sum():
            best = there, matrix
    if best is None or not best[0].all():
        there, matrix = (np.zeros(len(board), dtype=bool), lattice.homography) if best is None else best
        raise missing(project(matrix, board), shape, there)
    return best[1]


def _settled(grid: Grid, noise: float, progress: Progress) -> tuple[Grid, Survey]:
    """Measure all dots where the grid says they are, fit the grid to them, and again."""
    _check_between(grid)
    found: Survey | None = None
    progress.left(ROUNDS)
    for _ in range(ROUNDS):
        progress.add(1)
        found = survey(grid, noise, found.model if found else None)
        before = project(grid.homography, grid.board)
        parted = found.model is not None and bool(found.touching.any())
        if parted:
            grid, found = _parted(grid, found)
        centres = [None if view is None else centre(view, "gray_threshold", noise) for view in windows(grid, found)]
        good = present(grid, found, centres, noise)
        if good.sum() < max(ENOUGH * len(good), 4):
            raise missing(project(grid.homography, grid.board), grid.shape, good)
        if not parted:
            measured = np.array([(math.nan, math.nan) if one is None else one.place for one in centres])
            homography = fit_homography(grid.board[good], measured[good])
            # A lens bends the grid: a dot's window follows the dot.
            places = np.where(good[:, None], measured, project(homography, grid.board))
            grid = replace(grid, homography=homography, places=places)
        if not is_regular(grid.homography, grid.board):
            raise missing(project(grid.homography, grid.board), grid.shape, good)
        if np.abs(project(grid.homography, grid.board) - before).max() < SETTLED:
            break
    found = survey(grid, noise, found.model if found else None)
    if found.model is not None and found.touching.any():
        grid, found = _parted(grid, found)
    if found.touching.any():
        _check_gaps(grid)
    _check_border(grid, found.radius)
    return grid, found


def _check_gaps(grid: Grid) -> None:
    """Where dots run together, what is dark lies about the corners between them; a grid that strayed has it aside.

    A model of light cannot tell where dots are when all of them are saturated, and may walk off with the grid.
    """
    rows, columns = grid.shape
    corners = np.array([(c + 0.5, r + 0.5) for r in range(rows - 1) for c in range(columns - 1)])
    steps = np.linspace(-GAP_REACH, GAP_REACH, 2 * GAP_SAMPLES + 1)
    around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    gray = sampled(grid.values, project(grid.homography, corners[:, None, :] + around))
    darkness = np.nan_to_num(np.nanmax(gray, axis=1, keepdims=True) - gray)
    weight = darkness.sum(axis=1)
    seen = weight > 0
    aside = np.einsum("nk,kx->nx", darkness[seen], around) / weight[seen, None]
    if not seen.any() or float(np.hypot(*np.median(aside, axis=0))) > LARGEST_ASIDE:
        raise DotsNotFound(
            f"found no {rows} x {columns} separate dots: they run together",
            np.empty((0, 2)),
            np.empty((0, 2)),
            remedy="shorten the exposure if the picture is saturated, or sharpen it",
        )


def _check_between(grid: Grid) -> None:
    """Refuse a lattice that counts each long dot twice: half way between its halves it is brightest."""
    board, number = grid.board, np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape)
    highest = float(grid.values.max())
    dots = patch_means(grid.values, grid.homography, board, UNSEEN_PATCH / 2)
    for here, there in ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:])):
        first, second = here.ravel(), there.ravel()
        middle = patch_means(grid.values, grid.homography, (board[first] + board[second]) / 2, UNSEEN_PATCH / 2)
        with np.errstate(invalid="ignore"):
            # Where dots and what lies between them reach the highest level, the picture is saturated, and equal
            # levels tell nothing.
            brighter = (middle >= (dots[first] + dots[second]) / 2) & (middle < highest)
        if brighter.mean() > MOST_BRIGHTER:
            nothing = np.empty((0, 2))
            raise DotsNotFound(f"found 0 of {number.size} dots", nothing, nothing, remedy=REMEDY)


def _parted(grid: Grid, found: Survey) -> tuple[Grid, Survey]:
    """Let the model of the board's light say where dots are that run together."""
    model, homography = found.model, grid.homography
    slopes = np.zeros_like(grid.places) if found.slopes is None else found.slopes
    for _ in range(STEPS):
        if model is not None and is_regular(homography, grid.board):
            homography, model = refined(grid.values, homography, grid.board, slopes, model)
    grid = replace(grid, homography=homography, places=project(homography, grid.board))
    levels = found.levels if model is None else np.where(found.touching, model.levels, found.levels)
    return grid, replace(found, model=model, levels=levels)


def present(grid: Grid, found: Survey, centres: list[Centre | None], noise: float) -> NDArray[np.bool_]:
    """Which places of the grid hold a dot."""
    strong = float(np.quantile(found.levels, 0.9))
    expected = project(grid.homography, grid.board)
    areas = np.array([0.0 if one is None else one.area for one in centres])
    cells = np.abs(np.linalg.det(found.affine))
    usual = float(np.median(areas / cells))
    good = found.levels > np.maximum(
        LEAST_SIGNAL * noise / np.sqrt(0.2 * found.radius**2 * cells + 1), FAINTEST * strong
    )
    for dot, one in enumerate(centres):
        if one is None:
            good[dot] = False
            continue
        miss = np.linalg.solve(found.affine[dot], one.place - expected[dot])
        share = areas[dot] / cells[dot] / usual if usual > 0 else 0.0
        good[dot] &= bool(np.hypot(*miss) < LARGEST_MISS and SMALLEST_AREA < share < LARGEST_AREA)
    return np.asarray(good)


def _check_border(grid: Grid, radius: float) -> None:
    """A dot that the picture's border cuts has no centre to measure."""
    extent = radius * np.linalg.norm(jacobian(grid.homography, grid.board), axis=2)
    size = np.array(grid.values.shape[::-1])
    whole = ((grid.places - extent > -1.0) & (grid.places + extent < size)).all(axis=1)
    if not whole.all():
        raise missing(grid.places, grid.shape, whole, " (cut by the picture's border)")


_CORNERS: Final = np.array([(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)])


def _sides(shape: tuple[int, int], step: float) -> dict[str, Field]:
    """Places that lie `step` outside the outermost dots of each side, shape (dots, 2) [pitch]."""
    rows, columns = shape
    sides = {
        "above": [(c, -step) for c in range(columns)],
        "below": [(c, rows - 1 + step) for c in range(columns)],
        "left of": [(-step, r) for r in range(rows)],
        "right of": [(columns - 1 + step, r) for r in range(rows)],
    }
    return {side: np.array(places, dtype=np.float64) for side, places in sides.items()}


def _outside(grid: Grid, found: Survey) -> DotsNotFound | None:
    """An error where the picture does not look like board just outside the grid.

    A grid that reaches past the dots on one side leaves out dots on the other; one of the gaps between dots
    has the board's dark surroundings outside. On a board the dots end where the grid does.
    """
    number = np.arange(len(grid.board)).reshape(grid.shape)
    border = {"above": number[0], "below": number[-1], "left of": number[:, 0], "right of": number[:, -1]}
    for side, points in _sides(grid.shape, JUST_OUTSIDE).items():
        if not is_regular(grid.homography, points):
            continue
        dots = border[side]
        gray = patch_means(grid.values, grid.homography, points, OUTSIDE_PATCH)
        inwards = patch_means(grid.values, grid.homography, grid.board[dots], OUTSIDE_PATCH)
        # The darkest corner of a dot's cell: the others may hold a neighbour's light.
        corners = patch_means(grid.values, grid.homography, grid.board[dots][:, None, :] + _CORNERS, OUTSIDE_PATCH)
        with np.errstate(invalid="ignore", divide="ignore"):
            gap = corners.min(axis=1)
            like_dots = (gray - gap) / (inwards - gap)
        like_dots = like_dots[np.isfinite(like_dots)]
        if len(like_dots) and float(np.median(like_dots)) > LIKE_A_DOT:
            nothing = np.empty((0, 2))
            return DotsNotFound(
                f"found 0 of {number.size} dots: what looks like a grid has no board {side} it",
                nothing,
                nothing,
                remedy=REMEDY,
            )
    return None


def _check_beyond(grid: Grid, found: Survey, noise: float) -> None:
    """A row of dots just outside the grid means that another grid was asked for."""
    rows, columns = grid.shape
    levels = found.levels.reshape(rows, columns)
    border = {"above": levels[0], "below": levels[-1], "left of": levels[:, 0], "right of": levels[:, -1]}
    for side, points in _sides(grid.shape, 1.0).items():
        neighbours = border[side]
        if not is_regular(grid.homography, points):
            continue
        core = patch_means(grid.values, grid.homography, points, 0.4 * found.radius)
        corners = patch_means(grid.values, grid.homography, points[:, None, :] + _CORNERS, 0.05)
        # Above the brightest corner: a board's edge is bright on one side only. NaN, out of view, is no dot.
        with np.errstate(invalid="ignore"):
            dots = core - corners.max(axis=1) > np.maximum(LEVEL_BEYOND * neighbours, 6 * noise)
        seen = np.isfinite(core) & np.isfinite(corners).all(axis=1)
        if seen.sum() >= 2 and dots[seen].mean() >= SHARE_BEYOND:
            raise too_many(grid.shape, side, np.concatenate([grid.places, project(grid.homography, points[dots])]))
