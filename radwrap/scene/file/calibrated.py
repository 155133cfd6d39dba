"""A scene's camera with what its calibration file says: focal length, principal point, distortion, perhaps the pose.

The pixel pitch gives the scale: f = fy pixel_height. The pitch along columns
becomes f/fx, so that both focal lengths in pixels are the file's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.frames import fixed_axis_angles
from radwrap.scene.file.beside import named_file
from radwrap.scene.file.calibration_file import Intrinsics, read_intrinsics
from radwrap.units import LENGTH, parse_quantity

KEY: Final = "calibration"
_TOLD: Final = ("focal_length", "principal_point", "distortion")
_POSE: Final = ("position", "translation", "look_at", "rotation", "up", "rotation_order")
# Pixels of a data sheet and a calibration's focal lengths differ by less, else one of them is of another camera.
_SAME_SHAPE: Final = 0.02
_SAME_PITCH: Final = 1e-6
_OPENCV: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")


def with_calibration(document: Mapping[str, Any], origin: str, folder: Path) -> Mapping[str, Any]:
    """The tables of a scene with the values of the calibration that its camera names, if it names one.

    Raises
    ------
    InputError
        If the file cannot be read or is of another camera, or the scene says what it tells.
    """
    camera = document.get("camera")
    if not isinstance(camera, dict) or not isinstance(camera.get(KEY), str):
        return document
    where = f"{origin}: camera.{KEY}"
    for key in _TOLD:
        if key in camera:
            raise InputError(
                "is in the calibration too", where=f"{origin}: camera.{key}", remedy=f"leave it or {KEY} out"
            )
    found = read_intrinsics(named_file(folder, camera[KEY], where), where)
    sensor = _table(camera.get("sensor"), f"{origin}: camera.sensor")
    changes = {**_image(found, sensor, where, _focus(camera)), **_pose(found, camera)}
    return {**document, "camera": {**camera, **changes}}


def _table(sensor: Any, where: str) -> dict[str, Any]:
    if not isinstance(sensor, dict):
        raise InputError("is missing", where=where, remedy="a calibration does not describe a sensor")
    return sensor


def _focus(camera: Mapping[str, Any]) -> float:
    """Distance at which the camera's lens is focused [m]; infinite where it has none, or none that can be read."""
    lens = camera.get("lens")
    try:
        return parse_quantity(lens["focus_distance"], LENGTH) if isinstance(lens, Mapping) else math.inf
    except (InputError, KeyError):
        return math.inf  # the lens's own check says what is wrong


def _image(found: Intrinsics, sensor: dict[str, Any], where: str, focus: float) -> dict[str, Any]:
    """Focal length, principal point, distortion, and the sensor with the pitch that both focal lengths need."""
    width, height = (_pitch(sensor, key, where) for key in ("pixel_width", "pixel_height"))
    if found.size is not None and found.size != (sensor.get("columns"), sensor.get("rows")):
        raise InputError(
            f"is of pictures of {found.size[0]} x {found.size[1]} pixels, the sensor has "
            f"{sensor.get('columns')} x {sensor.get('rows')}",
            where=where,
            remedy="calibrate with whole pictures of this camera",
        )
    if found.pixel is not None and not np.allclose(found.pixel, (width, height), rtol=_SAME_PITCH, atol=0):
        raise InputError(
            f"was made with pixels of {found.pixel[0] * 1e6:g} x {found.pixel[1] * 1e6:g} um, the sensor has "
            f"{width * 1e6:g} x {height * 1e6:g} um",
            where=where,
            remedy="both must be the same: focal length and distortion scale with them",
        )
    if found.focal_lengths is not None:
        fx, fy = found.focal_lengths
        f, across = fy * height, fy * height / fx
    else:
        f, across = found.focal_length or 0.0, width / found.sx
    if abs(across / width - 1) > _SAME_SHAPE:
        raise InputError(
            f"gives pixels {across / height:.4g} times as wide as high, the sensor's are {width / height:.4g}",
            where=where,
            remedy="check pixel_width and pixel_height, or the calibration",
        )
    if found.kappa1 is not None:
        bend: dict[str, Any] = {"model": "tsai", "kappa1": f"{found.kappa1!r} 1/m^2"}
    else:
        bend = {"model": "opencv", **dict(zip(_OPENCV, found.coefficients, strict=False))}
    # A calibration sees how far the image lies behind the lens: 1/f = 1/v + 1/s.
    return {
        "focal_length": f"{f / (1 + f / focus)!r} m",
        "principal_point": [f"{value!r} px" for value in found.centre],
        "distortion": bend,
        "sensor": {**sensor, "pixel_width": f"{across!r} m"},
    }


def _pitch(sensor: dict[str, Any], key: str, where: str) -> float:
    if key not in sensor:
        raise InputError("is missing", where=where.replace(f".{KEY}", f".sensor.{key}"))
    try:
        value = parse_quantity(sensor[key], LENGTH)
    except InputError as error:
        raise InputError(str(error), where=where.replace(f".{KEY}", f".sensor.{key}")) from error
    if value <= 0:
        raise InputError("must be above zero", where=where.replace(f".{KEY}", f".sensor.{key}"))
    return value


def _pose(found: Intrinsics, camera: dict[str, Any]) -> dict[str, Any]:
    """Where the camera stood, where the file tells it and the scene does not."""
    if found.pose is None or any(key in camera for key in _POSE):
        return {}
    rotation, translation = (np.asarray(value) for value in found.pose)
    position = -rotation.T @ translation
    rows = [(float(a), float(b), float(c)) for a, b, c in rotation.T]
    angles = fixed_axis_angles((rows[0], rows[1], rows[2]))
    return {
        "position": [f"{value!r} m" for value in position.tolist()],
        "rotation": [f"{value!r} rad" for value in angles],
        "rotation_order": "xyz",
    }
