"""Views of a target, and OpenCV's camera, by which they are seen.

::

    (X, Y, Z) = R P + t                          camera frame: x right, y down, z forward
    (x, y)    = (X, Y) / Z                       distorted by OpenCV's coefficients, in its order
    u = fx x + cx,   v = fy y + cy               pixels

Source: opencv_calib3d.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from radwrap.calibrate.camera_model import Array
from radwrap.errors import InputError

DistortionModel = Literal["brown", "rational", "thin_prism"]

# OpenCV's coefficients, and which of them a model frees, after those of the camera's matrix.
COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
MODELS: Final[dict[str, tuple[str, ...]]] = {
    "brown": COEFFICIENTS[:5],
    "rational": COEFFICIENTS[:8],
    "thin_prism": (*COEFFICIENTS[:5], *COEFFICIENTS[8:]),
}
MATRIX: Final = ("fx", "fy", "cx", "cy")
POSE: Final = 6  # numbers of a pose: rotation vector and translation
_FEWEST_POINTS: Final = 4  # of a view: its pose has six unknowns, and two numbers are left over


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationView:
    """Points of a target in one image.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        In the target's frame [m].
    image : ndarray, shape (n, 2)
        u, v [px].
    name : str
        As the table names the view.
    """

    points: Array
    image: Array
    name: str

    def __post_init__(self) -> None:
        if self.points.shape != (len(self.points), 3) or self.image.shape != (len(self.points), 2):
            raise InputError("needs as many rows of x, y, z as of u, v", where=f"view {self.name}")
        if not (np.isfinite(self.points).all() and np.isfinite(self.image).all()):
            raise InputError("holds NaN or infinity", where=f"view {self.name}", remedy="leave the point out")
        if len(self.points) < _FEWEST_POINTS:
            raise InputError(
                f"holds {len(self.points)} points, {_FEWEST_POINTS} are needed",
                where=f"view {self.name}",
                remedy="leave the view out",
            )


def coefficients_of(model: DistortionModel) -> int:
    """How many coefficients OpenCV writes for a model."""
    return COEFFICIENTS.index(MODELS[model][-1]) + 1


def free_columns(model: DistortionModel) -> list[int]:
    """Which of fx, fy, cx, cy and the coefficients are free."""
    return [*range(len(MATRIX)), *(len(MATRIX) + COEFFICIENTS.index(name) for name in MODELS[model])]
