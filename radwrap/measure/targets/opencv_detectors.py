"""OpenCV's detectors of calibration targets, with the settings that small and large images need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.dots.plane import fit_homography, project

Points = NDArray[np.float64]

_LEAST_DISC: Final = 12.0  # px; of smaller ones there are too few pixels to weigh
_LARGEST_SHARE: Final = 0.5  # of the image's area over the number of discs, that a disc may cover
_NEAREST_DISCS: Final = 3.0  # px between centres
_WINDOW: Final = 0.35  # of the distance of neighbouring corners, to each side of one that is refined
_LARGEST_WINDOW: Final = 11  # px
_ROUNDS: Final = 100
_SETTLED: Final = 1e-4  # px
_FEWEST_CORNERS: Final = 4  # of a ChArUco board, which a pose needs


class PointsNotFound(InputError):
    """A detector did not find its target."""


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """What OpenCV must know of a ChArUco board.

    Attributes
    ----------
    rows, columns : int
        Squares.
    marker_share : float
        Side of a marker over that of a square.
    dictionary : str
        Name of the predefined dictionary, such as DICT_4X4_50.
    first_marker : int
        Number of the marker at the top left.
    """

    rows: int
    columns: int
    marker_share: float
    dictionary: str
    first_marker: int


ChessboardMethod = Literal["refined", "sb", "corners"]


def chessboard_corners(image: GrayImage, rows: int, columns: int, method: ChessboardMethod = "refined") -> Points:
    """Inner corners of a chessboard, row by row from its dark top left square.

    A board that looks the same after a turn may be taken as turned so.

    Parameters
    ----------
    image : GrayImage
        The whole board in view, with some light about it.
    rows, columns : int
        Squares, at least 3 each.
    method : str
        ``sb``: by ``findChessboardCornersSB``. ``corners``: by ``findChessboardCorners`` with ``cornerSubPix``.
        ``refined``: found as by ``sb``, placed by ``cornerSubPix``.

    Returns
    -------
    ndarray, shape ((rows - 1) (columns - 1), 2)
        u, v [px].

    Raises
    ------
    PointsNotFound
        If it does not see every corner.
    """
    import cv2

    if min(rows, columns) < 3:
        raise InputError(f"a board of {rows} x {columns} squares", remedy="OpenCV needs 3 rows and columns at least")
    codes = _eight_bits(image)
    size = (columns - 1, rows - 1)
    if method != "corners":
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        seen, found = cv2.findChessboardCornersSB(codes, size, flags=flags)
    else:
        seen, found = cv2.findChessboardCorners(codes, size)
    if not seen or found is None:
        raise _not_found(f"the {size[1]} x {size[0]} inner corners of a chessboard")
    corners = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    if method != "sb":
        corners = _refined(codes, corners, size)
    return _from_dark_square(image.values, corners, size)


def charuco_corners(image: GrayImage, board: CharucoBoard) -> tuple[NDArray[np.intp], Points]:
    """Corners of a ChArUco board that are seen beside its markers.

    Returns
    -------
    ids : ndarray, shape (n,)
        Numbers of the corners, row by row; n is 4 at least.
    corners : ndarray, shape (n, 2)
        u, v [px].

    Raises
    ------
    PointsNotFound
        If fewer than four are seen.
    """
    import cv2

    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    numbers = np.arange(board.first_marker, board.first_marker + board.rows * board.columns // 2)
    size = (board.columns, board.rows)
    detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(size, 1.0, board.marker_share, markers, numbers))
    corners, ids, _, seen = detector.detectBoard(_eight_bits(image))
    if ids is None or len(ids) < _FEWEST_CORNERS:
        count = 0 if seen is None else len(seen)
        raise _not_found(
            f"{_FEWEST_CORNERS} corners of a ChArUco board ({count} of its {len(numbers)} markers are seen)"
        )
    order = np.argsort(np.ravel(ids))
    places = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return np.ravel(ids)[order].astype(np.intp), places[order]


def circle_centres(image: GrayImage, rows: int, columns: int, *, asymmetric: bool) -> Points:
    """Centres of dark discs on a grid, by OpenCV's ``SimpleBlobDetector`` and ``findCirclesGrid``.

    They are centres of the discs' images, which lie beside the images of the discs' centres where the grid is tilted.

    Returns
    -------
    ndarray, shape (rows columns, 2)
        u, v [px], row by row.

    Raises
    ------
    PointsNotFound
        If it does not see the whole grid.
    """
    import cv2

    codes = _eight_bits(image)
    # OpenCV's own description of its types lacks the blob detector.
    library: Any = cv2
    settings = library.SimpleBlobDetector_Params()
    settings.minArea = _LEAST_DISC
    settings.maxArea = max(_LARGEST_SHARE * codes.size / (rows * columns), 2 * _LEAST_DISC)
    settings.minDistBetweenBlobs = _NEAREST_DISCS
    detector = library.SimpleBlobDetector_create(settings)
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        seen, found = cv2.findCirclesGrid(codes, (columns, rows), flags=flags, blobDetector=detector)
        if seen and found is not None:
            return np.asarray(found, dtype=np.float64).reshape(-1, 2)
    raise _not_found(f"{rows} x {columns} dark circles")


def _not_found(what: str) -> PointsNotFound:
    return PointsNotFound(
        f"OpenCV does not find {what}",
        remedy="check the target's rows and columns, and that it is wholly in view, lit and in focus",
    )


def _eight_bits(image: GrayImage) -> NDArray[np.uint8]:
    """The codes, in 8 bits; of more than that, its darkest to its brightest level."""
    if image.bit_depth <= 8:
        return np.asarray(image.codes, dtype=np.uint8)
    low, high = float(image.values.min()), float(image.values.max())
    return np.rint((image.values - low) * (255 / max(high - low, 1.0))).astype(np.uint8)


def _refined(codes: NDArray[np.uint8], corners: Points, size: tuple[int, int]) -> Points:
    import cv2

    grid = corners.reshape(size[1], size[0], 2)
    nearest = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
    half = int(min(max(_WINDOW * nearest, 2), _LARGEST_WINDOW))
    end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _ROUNDS, _SETTLED)
    found: Any = cv2.cornerSubPix(codes, corners.astype(np.float32), (half, half), (-1, -1), end)
    return np.asarray(found, dtype=np.float64)


def _from_dark_square(values: NDArray[np.float64], corners: Points, size: tuple[int, int]) -> Points:
    """The corners in an order by which the square before the first one is dark."""
    grid = corners.reshape(size[1], size[0], 2)
    turns = (0, 1, 2, 3) if size[0] == size[1] else (0, 2)
    column, row = np.meshgrid(np.arange(size[0] - 1) + 0.5, np.arange(size[1] - 1) + 0.5)
    middles = np.column_stack([column.ravel(), row.ravel()])
    board = np.column_stack([part.ravel() for part in np.meshgrid(np.arange(size[0]), np.arange(size[1]))])
    # The square between the first four corners has the colour of the one at the top left.
    is_dark = (np.floor(middles).sum(axis=1) % 2) == 0
    for turn in turns:
        turned = np.rot90(grid, turn).reshape(-1, 2)
        u, v = np.rint(project(fit_homography(board.astype(np.float64), turned), middles)).astype(int).T
        v, u = np.clip(v, 0, values.shape[0] - 1), np.clip(u, 0, values.shape[1] - 1)
        gray = values[v, u]
        if is_dark.all() or gray[is_dark].mean() < gray[~is_dark].mean():
            return turned
    return corners
