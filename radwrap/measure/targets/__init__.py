"""Points of calibration targets in one image, by the detectors of OpenCV.

Chessboards, ChArUco boards and grids of circles. `measure.dots` measures symmetric grids too; its method conic has the
centres of the discs themselves, not of their images.
"""

from radwrap.measure.targets.opencv_detectors import (
    CharucoBoard,
    ChessboardMethod,
    PointsNotFound,
    charuco_corners,
    chessboard_corners,
    circle_centres,
)

__all__ = [
    "CharucoBoard",
    "ChessboardMethod",
    "PointsNotFound",
    "charuco_corners",
    "chessboard_corners",
    "circle_centres",
]
