"""Gray levels along a line between two pixels, as a table."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.face.session import Image
from radwrap.imaging.response.sensor import gray_levels

_COLUMNS: Final = "distance_px,u_px,v_px,code,gray,sigma_gray,radiant_exposure_J_m2"
_ENDS: Final = 4  # coordinates


def ends_of(told: Any, rows: int, columns: int) -> tuple[int, int, int, int]:
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


def line_of(ends: tuple[int, int, int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Columns and rows of the pixels nearest to even steps of at most a pixel, and their distances from the first."""
    u0, v0, u1, v1 = ends
    length = math.hypot(u1 - u0, v1 - v0)
    steps = max(abs(u1 - u0), abs(v1 - v0))
    share = np.arange(steps + 1) / max(steps, 1)
    columns, rows = (np.floor(a + (b - a) * share + 0.5).astype(np.intp) for a, b in ((u0, u1), (v0, v1)))
    return columns, rows, length * share


def profile_table(image: Image, ends: tuple[int, int, int, int]) -> str:
    """The profile as CSV; numbers have all their digits."""
    columns, rows, distances = line_of(ends)
    exposure = image.relit.radiant_exposure.values[rows, columns]
    codes = image.relit.gray.codes[rows, columns]
    gray, sigma = gray_levels(exposure, image.relighter.basis.sensor), image.sigma[rows, columns]
    lines = [
        f"{distance!r},{u},{v},{code},{level!r},{deviation!r},{light!r}"
        for distance, u, v, code, level, deviation, light in zip(
            *(values.tolist() for values in (distances, columns, rows, codes, gray, sigma, exposure)), strict=True
        )
    ]
    return "\n".join([_COLUMNS, *lines, ""])
