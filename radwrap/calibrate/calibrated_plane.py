"""The plane of a calibration's board, or one parallel to it, and how well the calibration knows lengths in it.

A calibration gives all of its errors together: a longer focal length and a larger distance leave the scale at the board
as it is. So the scale's error is carried through their covariance, and is much smaller than that of either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.camera_model import COLUMNS, Camera, image_metric, moved, project, turn
from radwrap.errors import InputError
from radwrap.frames import Vector, rotation_about_fixed_axes
from radwrap.measure.gauges.scale import Plane
from radwrap.written import Positive, read_back

Array = NDArray[np.float64]

_STEP: Final = 0.5  # px, over which the scale is taken
_TURN: Final = 1e-6  # rad
_SHARE: Final = 1e-6  # of a length or a focal length
_PIXELS: Final = 1e-3  # px
_KAPPA: Final = 1e-3  # m^-2


@dataclass(frozen=True, slots=True)
class _File:
    """What of ``radwrap calibrate camera --json`` a plane needs."""

    focal_length: Positive
    translation: Vector
    rotation_deg: Vector
    kappa1: float
    sx: Positive
    centre: tuple[float, float]
    pixel_width: Positive
    pixel_height: Positive
    centroid: Vector
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if {len(self.covariance), *map(len, self.covariance)} != {len(COLUMNS)}:
            raise InputError(f"is not a square of {len(COLUMNS)} rows", where="covariance")


def plane_from_calibration(told: Any, where: str, at: tuple[float, float], height: float = 0.0) -> Plane:
    """The plane z = height of a calibration's world.

    Parameters
    ----------
    told : Any
        What the JSON file of the calibration holds.
    where : str
        File, for messages.
    at : tuple of float
        Column and row about which lengths are measured [px]: the scale's error is that there.
    height : float
        Along the world's z axis [m].

    Returns
    -------
    Plane
        With the standard error of lengths in it, as a share, from the calibration's covariance.

    Raises
    ------
    InputError
        If the file is no calibration with a covariance, or the plane is not before the camera there.
    """
    file: _File = read_back(told, _File, where)
    x, y, z = map(math.radians, file.rotation_deg)
    rotation: Array = np.array(rotation_about_fixed_axes((x, y, z)))
    origin = np.array(file.centroid)
    camera = Camera(
        rotation,
        rotation @ origin + np.array(file.translation),
        origin,
        file.focal_length,
        file.kappa1,
        file.sx,
        file.centre,
        (file.pixel_width, file.pixel_height),
    )
    covariance = np.array(file.covariance)
    slopes = np.array([_change(camera, number, np.array(at), height) for number in range(len(COLUMNS))])
    variance = float(slopes @ covariance @ slopes)
    if not math.isfinite(variance) or variance < 0:
        raise InputError("is not a covariance of a plane before the camera", where=f"{where}: covariance")
    return Plane(
        lambda uv: _to_plane(camera, uv, height),
        lambda xy: project(camera, np.column_stack([xy, np.full(len(xy), height)])),
        math.sqrt(variance),
    )


def _to_plane(camera: Camera, uv: Array, height: float) -> Array:
    """Where pixels see the plane, x and y in the world [m]; NaN where they look past it."""
    seen = image_metric(camera, np.atleast_2d(uv))
    undistorted = seen * (1 + camera.kappa1 * np.sum(seen**2, axis=1, keepdims=True))
    rays = np.column_stack([undistorted / camera.focal_length, np.ones(len(seen))]) @ camera.rotation
    eye = camera.origin - camera.rotation.T @ camera.position
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (height - eye[2]) / rays[:, 2]
    places = eye + far[:, None] * rays
    return np.asarray(np.where((far > 0)[:, None], places[:, :2], np.nan))


def _log_scale(camera: Camera, at: Array, height: float) -> float:
    """Logarithm of the length in the plane that a pixel stands for, as the root of an area."""
    steps = _STEP * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    right, left, down, up = _to_plane(camera, at + steps, height)
    (a, b), (c, d) = right - left, down - up
    return 0.5 * math.log(abs(a * d - b * c))


def _change(camera: Camera, number: int, at: Array, height: float) -> float:
    """Derivative of the scale's logarithm by one of the calibration's columns."""
    size = _size(camera, number)
    both = [_log_scale(_moved(camera, number, sign * size), at, height) for sign in (1.0, -1.0)]
    return (both[0] - both[1]) / (2 * size)


def _size(camera: Camera, number: int) -> float:
    """A step of a column that changes the scale by about a millionth."""
    name = COLUMNS[number]
    if name.startswith("turn"):
        return _TURN
    lengths = {"x": camera.position[2], "y": camera.position[2], "z": camera.position[2]}
    others = {"focal_length": camera.focal_length * _SHARE, "kappa1": _KAPPA, "sx": _SHARE}
    return float(lengths[name]) * _SHARE if name in lengths else others.get(name, _PIXELS)


def _moved(camera: Camera, number: int, step: float) -> Camera:
    """The camera with one of its columns changed."""
    name = COLUMNS[number]
    if number < 3:
        return moved(camera, rotation=turn(step * np.eye(3)[number])[0] @ camera.rotation)
    if number < 6:
        return moved(camera, position=camera.position + step * np.eye(3)[number - 3])
    if name in ("centre_u", "centre_v"):
        u, v = camera.centre
        return moved(camera, centre=(u + step, v) if name == "centre_u" else (u, v + step))
    return moved(camera, **{name: getattr(camera, name) + step})
