"""Gray levels along a line between two pixels, as a table."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.face.traced import Image
from radwrap.imaging.response.sensor import gray_levels

Ends = tuple[int, int, int, int]
Pixels = NDArray[np.intp]
WIDEST: Final = 99  # px
_COLUMNS: Final = "distance_px,u_px,v_px,code,gray,sigma_gray,radiant_exposure_J_m2,pixels"
_ENDS: Final = 4  # coordinates


def ends_of(told: Any, rows: int, columns: int) -> Ends:
    """Column and row of both ends, from JSON.

    Raises
    ------
    InputError
        If they are no pixels of the image.
    """
    whole = isinstance(told, list) and len(told) == _ENDS and all(type(value) is int for value in told)
    if not whole or not all(0 <= value < (columns, rows)[k % 2] for k, value in enumerate(told)):
        raise InputError(f"needs column and row of two of {columns} x {rows} pixels", where="profile")
    u0, v0, u1, v1 = told
    return u0, v0, u1, v1


def line_of(ends: Ends) -> tuple[Pixels, Pixels, NDArray[np.float64]]:
    """Columns and rows of the pixels nearest to even steps of at most a pixel, and their distances from the first."""
    u0, v0, u1, v1 = ends
    length = math.hypot(u1 - u0, v1 - v0)
    steps = max(abs(u1 - u0), abs(v1 - v0))
    share = np.arange(steps + 1) / max(steps, 1)
    columns, rows = (np.floor(a + (b - a) * share + 0.5).astype(np.intp) for a, b in ((u0, u1), (v0, v1)))
    return columns, rows, length * share


def width_of(told: Any) -> int:
    """Width of a profile, from JSON: an odd number of pixels; one where nothing is told.

    Raises
    ------
    InputError
        If it is none.
    """
    if told is None:
        return 1
    if type(told) is not int or not 1 <= told <= WIDEST or told % 2 == 0:
        raise InputError(f"must be an odd number of pixels up to {WIDEST}", where="width")
    return told


def strip_of(ends: Ends, width: int, rows: int, columns: int) -> tuple[Pixels, Pixels, NDArray[np.bool_]]:
    """Columns and rows of the pixels nearest to steps of a pixel across the line, and which of them are in the image.

    Returns
    -------
    ndarray, ndarray, ndarray
        Each of shape (steps along the line, width).
    """
    u0, v0, u1, v1 = ends
    steps = max(abs(u1 - u0), abs(v1 - v0))
    share = (np.arange(steps + 1) / max(steps, 1))[:, None]
    length = math.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2)
    across = (-(v1 - v0) / length, (u1 - u0) / length) if length else (0.0, 1.0)
    off = np.arange(width) - (width - 1) / 2
    u, v = (
        np.floor(a + (b - a) * share + off * one + 0.5).astype(np.intp)
        for a, b, one in ((u0, u1, across[0]), (v0, v1, across[1]))
    )
    return u, v, (u >= 0) & (u < columns) & (v >= 0) & (v < rows)


def profile_table(image: Image, ends: Ends, width: int = 1) -> str:
    """The profile as CSV; numbers have all their digits.

    Of a wider one each value is the mean of the pixels across the line. So is its deviation: pixels may err together,
    and then no mean makes that smaller.
    """
    columns, rows, distances = line_of(ends)
    u, v, inside = strip_of(ends, width, *image.sigma.shape)
    at = np.where(inside, v, 0), np.where(inside, u, 0)
    exposure, codes = image.relit.radiant_exposure.values[at], image.relit.gray.codes[at]
    sigma = image.sigma[at]
    gray = gray_levels(exposure, image.relighter.basis.sensor)
    pixels = inside.sum(axis=1)
    if width > 1:
        means = [(np.where(inside, one, 0.0).sum(axis=1) / pixels).tolist() for one in (codes, gray, sigma, exposure)]
    else:
        means = [one[:, 0].tolist() for one in (codes, gray, sigma, exposure)]
    lines = [
        f"{distance!r},{u},{v},{code},{level!r},{deviation!r},{light!r},{count}"
        for distance, u, v, code, level, deviation, light, count in zip(
            *(values.tolist() for values in (distances, columns, rows)), *means, pixels.tolist(), strict=True
        )
    ]
    return "\n".join([_COLUMNS, *lines, ""])
