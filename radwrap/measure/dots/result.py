"""What comes back: all dots, or an error that knows which."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.measure.dots.centres import Method
from radwrap.measure.dots.plane import Matrix

Field = NDArray[np.float64]

REMEDY: Final = "check the numbers of rows and columns, and that the whole board is in view, lit and in focus"


@dataclass(frozen=True, slots=True, eq=False)
class Dot:
    """One dot.

    Attributes
    ----------
    row, column : int
        Place in the grid; row 0 is the top, column 0 the left of the board as
        seen with the smallest rotation.
    u, v : float
        Column and row coordinate of its centre [px]; the centre of the first
        pixel is (0, 0).
    covariance : ndarray, shape (2, 2)
        Of (u, v), from the picture's noise and rounding [px^2]. Systematic
        errors of the method are not in it.
    area : float
        Of the dot's image [px].
    saturated_fraction : float
        Share of the dot's pixels at or above saturation.
    split : bool
        Whether its light ran into a neighbour's and was parted from it.
    unlike : float
        By how much its light differs from that of the board's usual dot: rms beyond noise as a share of its level; 0
        where it does not.
    """

    row: int
    column: int
    u: float
    v: float
    covariance: Field
    area: float
    saturated_fraction: float
    split: bool
    unlike: float


@dataclass(frozen=True, slots=True, eq=False)
class Dots:
    """All dots of a grid.

    Attributes
    ----------
    rows, columns : int
        The grid.
    method : str
        How centres were measured.
    contrast : str
        "bright" dots on a dark board or "dark" ones on a bright board.
    dots : tuple of Dot
        Row by row.
    homography : ndarray, shape (3, 3)
        (column, row, 1) -> (u, v, 1), fitted to the centres.
    noise : float
        Standard deviation of a pixel, rounding included [gray].
    warnings : tuple of str
        What the user should know.
    """

    rows: int
    columns: int
    method: Method
    contrast: str
    dots: tuple[Dot, ...]
    homography: Matrix
    noise: float
    warnings: tuple[str, ...]

    @property
    def centres(self) -> Field:
        """(u, v) of all dots, row by row, shape (rows * columns, 2) [px]."""
        return np.array([(dot.u, dot.v) for dot in self.dots])


class DotsNotFound(InputError):
    """Not all dots, or more than the grid has.

    Attributes
    ----------
    found : ndarray, shape (n, 2)
        (u, v) of the dots that were found [px].
    missing : ndarray, shape (m, 2)
        Where the others should be, as far as that is known [px].
    """

    def __init__(self, what: str, found: Field, missing: Field, *, remedy: str = "") -> None:
        super().__init__(what, remedy=remedy)
        self.found = found
        self.missing = missing


def named_dots(which: NDArray[np.intp], columns: int) -> str:
    """The first of some dots by row and column."""
    named = [f"row {dot // columns} column {dot % columns}" for dot in which[:3].tolist()]
    return ", ".join(named) + (" and others" if len(which) > 3 else "")


def missing(places: Field, shape: tuple[int, int], good: NDArray[np.bool_], why: str = "") -> DotsNotFound:
    """The error for a grid with empty places.

    Parameters
    ----------
    places : ndarray, shape (n, 2)
        Where the dots should be, row by row [px].
    shape : tuple of int
        Rows and columns.
    good : ndarray of bool, shape (n,)
        Which of them are there.
    why : str
        Added to the message.
    """
    return DotsNotFound(
        f"found {int(good.sum())} of {len(good)} dots; missing: {named_dots(np.flatnonzero(~good), shape[1])}{why}",
        places[good],
        places[~good],
        remedy=REMEDY,
    )


def too_many(shape: tuple[int, int], side: str, places: Field) -> DotsNotFound:
    """The error for dots outside the grid: on which side, and (u, v) of all that are seen [px]."""
    return DotsNotFound(
        f"found {shape[0]} x {shape[1]} dots, but dots continue {side} the grid",
        places,
        np.empty((0, 2)),
        remedy="give the whole board's rows and columns",
    )
