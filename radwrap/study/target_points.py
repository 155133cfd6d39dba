"""Points of a calibration target as a detector finds them in an image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.dots import DotsNotFound, find_dots
from radwrap.measure.targets import (
    CharucoBoard,
    ChessboardMethod,
    PointsNotFound,
    charuco_corners,
    chessboard_corners,
    circle_centres,
)
from radwrap.scene.patterns.layouts import Charuco, Chessboard, CircleGrid, Layout
from radwrap.scene.patterns.marks import Place

Detector = Literal["refined", "sb", "corners", "charuco", "circles", "dots"]
DETECTORS: Final[tuple[Detector, ...]] = get_args(Detector)
Found = tuple[Sequence[Place], NDArray[np.float64]]


def detector_of(layout: Layout, asked: Detector | None, *, target: str, where: str) -> Detector:
    """The detector that is asked for, or the first that looks for such a target.

    Parameters
    ----------
    layout : Layout
        What is on the target.
    asked : str, optional
        Its name.
    target, where : str
        Where target and detector were given, for errors.

    Raises
    ------
    InputError
        If none looks for such a target, or the one that is asked for does not.
    """
    fitting: tuple[Detector, ...]
    match layout:
        case Chessboard():
            fitting = ("refined", "sb", "corners")
        case Charuco():
            fitting = ("charuco",)
        case CircleGrid():
            fitting = ("circles",) if layout.asymmetric else ("dots", "circles")
        case _:
            raise InputError(
                f"a {type(layout).__name__} has no points that calibrate a camera",
                where=target,
                remedy="take a chessboard, a ChArUco board or a grid of circles",
            )
    if asked is not None and asked not in fitting:
        raise InputError(
            f'"{asked}" does not look for a {type(layout).__name__}',
            where=where,
            remedy=f"use {' or '.join(fitting)}",
        )
    return asked or fitting[0]


def places_of(layout: Layout) -> list[Place]:
    """Places of all points of a target that calibrates [m], in the order of its detectors."""
    match layout:
        case Chessboard() | Charuco():
            return [place for *_, place in layout.corners()]
        case CircleGrid():
            return [place for *_, place in layout.centres()]
    raise TypeError(f"{type(layout).__name__} has no points")


def finder_of(layout: Layout, detector: Detector) -> Callable[[GrayImage], Found]:
    """What finds the points of a target in an image: their places on it [m], and their images [px].

    It raises `PointsNotFound` where the image does not show them.
    """
    places = places_of(layout)
    match layout:
        case Chessboard():
            method: ChessboardMethod = detector if detector in ("sb", "corners") else "refined"
            return lambda image: (places, chessboard_corners(image, layout.rows, layout.columns, method))
        case Charuco():
            share = layout.marker_size / layout.square_size
            board = CharucoBoard(layout.rows, layout.columns, share, layout.dictionary, layout.first_marker)

            def charuco(image: GrayImage) -> Found:
                ids, shown = charuco_corners(image, board)
                return [places[number] for number in ids.tolist()], shown

            return charuco
        case CircleGrid():
            if detector == "dots":
                return lambda image: (places, _dots(image, layout))
            return lambda image: (
                places,
                circle_centres(image, layout.rows, layout.columns, asymmetric=layout.asymmetric),
            )
    raise TypeError(f"{type(layout).__name__} has no points")


def _dots(image: GrayImage, grid: CircleGrid) -> NDArray[np.float64]:
    if image.values.min() == image.values.max():
        raise PointsNotFound("shows one gray level everywhere", remedy="look at how it was taken")
    try:
        return find_dots(
            image, grid.rows, grid.columns, method="conic", pitch=grid.pitch, dot_diameter=grid.dot_diameter
        ).centres
    except DotsNotFound as error:
        raise PointsNotFound(error.what, remedy=error.remedy) from error
