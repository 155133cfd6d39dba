"""The raw image of a colour camera as a picture in colour, demosaiced by OpenCV."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.files import write_bytes
from radwrap.scene.mosaic import Pattern

COLOUR: Final = "colour.png"
# OpenCV calls a pattern by the second and third pixel of its second row: those of RGGB are B and G.
_NAMES: Final[dict[Pattern, str]] = {"RGGB": "BG", "BGGR": "RG", "GRBG": "GB", "GBRG": "GR"}
_FEWEST: Final = 3  # rows and columns that OpenCV can tell colours of


def demosaiced(codes: NDArray[np.uint8] | NDArray[np.uint16], pattern: Pattern) -> NDArray[np.uint8 | np.uint16]:
    """All three colours of every pixel, shape (rows, columns, 3), red first; OpenCV's bilinear way.

    Parameters
    ----------
    codes : ndarray, shape (rows, columns)
        Gray levels of the raw image.
    pattern : str
        Of its mosaic.

    Raises
    ------
    InputError
        If the image is too small.
    """
    if min(codes.shape) < _FEWEST:
        raise InputError(f"is too small to demosaic: needs {_FEWEST} rows and columns", where="gray.png")
    import cv2

    made = cv2.demosaicing(codes, getattr(cv2, f"COLOR_Bayer{_NAMES[pattern]}2BGR"))
    return np.asarray(made[:, :, ::-1], dtype=codes.dtype)


def write_colour(folder: Path, codes: NDArray[np.uint8] | NDArray[np.uint16], pattern: Pattern) -> None:
    """Write colour.png into a run's folder: gray levels as gray.png holds them, no white balance, no gamma.

    Raises
    ------
    InputError
        As `demosaiced`.
    EnvironmentFailure
        If the disk refuses.
    """
    import cv2

    written, content = cv2.imencode(".png", np.ascontiguousarray(demosaiced(codes, pattern)[:, :, ::-1]))
    if not written:
        raise EnvironmentFailure("cannot be written as PNG", where=str(folder / COLOUR))
    write_bytes(folder / COLOUR, content.tobytes())
