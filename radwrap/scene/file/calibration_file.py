"""Calibrations of real cameras: OpenCV's YAML, XML or JSON, and the JSON of ``radwrap calibrate camera``."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.frames import Rotation, Vector, rotation_about_fixed_axes
from radwrap.reading import FileKind, check_tree, read_text

if TYPE_CHECKING:
    import cv2

# Names of camera matrix and coefficients, as OpenCV's samples and others write them.
_CALIBRATION: Final = FileKind("calibration", 1 << 20)
_MATRICES: Final = ("camera_matrix", "cameraMatrix", "K")
_COEFFICIENTS: Final = ("distortion_coefficients", "distCoeffs", "D")
_KNOWN_MODELS: Final = ("", "plumb_bob", "rational_polynomial", "opencv")
_DEEPEST: Final = 32
# Brackets, tags, and what stands at the begin of a line of YAML; strings are passed over.
_NESTING: Final = re.compile(
    r'"(?:[^"\\\n]|\\.)*+"|(?P<open>[\[{]|<[A-Za-z_][^<>]*+>(?<!/>))|(?P<close>[\]}]|</)'
    r"|(?P<indent>(?:^|(?<=\n))[ -]++)"
)
_MODEL: Final = "distortion_model"
_REMEDY: Final = "give OpenCV's YAML or the JSON of `radwrap calibrate camera --json`"
_MOST_COEFFICIENTS: Final = 12  # of those that OpenCV names in its order; further ones are of a tilted sensor


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """What a calibration says of a camera.

    Attributes
    ----------
    focal_lengths : tuple of float
        Along columns and rows [px].
    centre : tuple of float
        Principal point, column and row [px].
    coefficients : tuple of float
        OpenCV's k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, as far as told; empty where kappa1 is given.
    kappa1 : float or None
        Tsai's [m^-2].
    focal_length : float or None
        [m], where the file tells it.
    size : tuple of int or None
        Columns and rows of its pictures.
    pixel : tuple of float or None
        Width and height of a pixel with which it was made [m].
    pose : tuple or None
        Rotation camera_from_world and the world's origin in the camera frame [m].
    """

    focal_lengths: tuple[float, float] | None
    centre: tuple[float, float]
    coefficients: tuple[float, ...]
    kappa1: float | None
    focal_length: float | None
    sx: float
    size: tuple[int, int] | None
    pixel: tuple[float, float] | None
    pose: tuple[Rotation, Vector] | None


def read_intrinsics(path: Path, where: str) -> Intrinsics:
    """Read a calibration.

    Parameters
    ----------
    path : Path
        A file of at most some MiB.
    where : str
        Key, for messages.

    Raises
    ------
    InputError
        If it is none of the known kinds, or holds what no pinhole with distortion can have.
    """
    place = f'{where}: "{path.name}"'
    text = read_text(path, _CALIBRATION, place)
    _check_depth(text, place)
    try:
        told = json.loads(text)
    except ValueError:
        told = None
    check_tree(told, place, finite=False)
    try:
        found = _ours(told) if isinstance(told, dict) and "kappa1" in told else _opencv(text)
    except InputError as error:
        raise InputError(f'"{path.name}": {error.what}', where=where, remedy=error.remedy) from error
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        lacking = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(
            f'"{path.name}" is not a complete calibration: {lacking}', where=where, remedy=_REMEDY
        ) from error
    _check(found, path.name, where)
    return found


def _check_depth(text: str, where: str) -> None:
    """Refuse what is nested so deep that OpenCV's parsers, which call themselves, end the process."""
    depth = 0
    for found in _NESTING.finditer(text):
        depth += 1 if found["open"] else -1 if found["close"] else 0
        if depth > _DEEPEST or len(found["indent"] or "") > 4 * _DEEPEST:
            raise InputError(f"is nested more than {_DEEPEST} levels deep", where=where, remedy=_REMEDY)


def _check(found: Intrinsics, name: str, where: str) -> None:
    numbers = [*found.centre, *found.coefficients, found.kappa1 or 0.0, found.sx, *(found.focal_lengths or ())]
    sizes = [found.sx, *(found.focal_lengths or ()), *(found.pixel or ())]
    sizes += [] if found.focal_length is None else [found.focal_length]
    numbers += sizes if found.pose is None else [*sizes, *found.pose[1], *(x for row in found.pose[0] for x in row)]
    if not all(map(math.isfinite, numbers)) or min(sizes) <= 0:
        raise InputError(f'"{name}" holds a number that is not finite, or a size not above zero', where=where)


def _ours(told: dict[str, Any]) -> Intrinsics:
    x, y, z = (math.radians(float(angle)) for angle in told["rotation_deg"])
    a, b, c = map(float, told["translation"])
    u, v = map(float, told["centre"])
    pixel = None
    if "pixel_width" in told:
        pixel = float(told["pixel_width"]), float(told["pixel_height"])
    return Intrinsics(
        focal_lengths=None,
        centre=(u, v),
        coefficients=(),
        kappa1=float(told["kappa1"]),
        focal_length=float(told["focal_length"]),
        sx=float(told["sx"]),
        size=None,
        pixel=pixel,
        pose=(rotation_about_fixed_axes((x, y, z), "xyz"), (a, b, c)),
    )


def _opencv(text: str) -> Intrinsics:
    import cv2

    kinds = {"<": cv2.FILE_STORAGE_FORMAT_XML, "{": cv2.FILE_STORAGE_FORMAT_JSON}
    kind = kinds.get(text.lstrip()[:1], cv2.FILE_STORAGE_FORMAT_YAML)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY | kind)
    except (cv2.error, SystemError) as error:
        raise InputError("OpenCV cannot read it", remedy=_REMEDY) from error
    try:
        matrix = _numbers(storage, _MATRICES, required=True)
        bend = _numbers(storage, _COEFFICIENTS, required=False)
        model = _model(storage)
        names = storage.root().keys()  # a node is no mapping, and cannot be gone through
        unknown = [key for key in names if key.lower().startswith("dist") and key != _MODEL]
        if unknown and not bend:
            raise InputError(f'"{unknown[0]}" is not a known name', remedy=f"call the coefficients {_COEFFICIENTS[0]}")
        width, height = (_size(storage, key) for key in ("image_width", "image_height"))
        size = None if width is None or height is None else (width, height)
    finally:
        storage.release()
    if model not in _KNOWN_MODELS:
        raise InputError(f'the distortion model "{model}" is not expressed', remedy="calibrate with OpenCV's k and p")
    if len(matrix) != 9 or any(matrix[k] for k in (3, 6, 7)) or matrix[8] != 1:
        raise InputError("its camera matrix is not [fx 0 cx; 0 fy cy; 0 0 1]")
    if matrix[1]:
        raise InputError("its camera matrix has a skew, which is not expressed")
    if any(bend[_MOST_COEFFICIENTS:]):
        raise InputError("its coefficients of a tilted sensor are not expressed", remedy="calibrate without them")
    fx, _, cx, _, fy, cy = matrix[:6]
    return Intrinsics((fx, fy), (cx, cy), tuple(bend[:_MOST_COEFFICIENTS]), None, None, 1.0, size, None, None)


def _size(storage: cv2.FileStorage, key: str) -> int | None:
    """Columns or rows of the pictures; None where the file does not tell."""
    node = storage.getNode(key)
    if node.isNone():
        return None
    # OpenCV gives 2^1023 or so for the number of what is none.
    if not node.isInt() or node.real() < 1:
        raise InputError(
            f"its {key} is not a whole number of 1 or more", remedy=f"write {key}: 640, without quotes or point"
        )
    return int(node.real())


def _model(storage: cv2.FileStorage) -> str:
    """Name of the distortion model; OpenCV's sample marks its fisheye model by a flag."""
    fisheye = storage.getNode("fisheye_model")
    if not fisheye.isNone() and (not (fisheye.isInt() or fisheye.isReal()) or fisheye.real() != 0):
        return "fisheye"
    return str(storage.getNode(_MODEL).string())


def _numbers(storage: cv2.FileStorage, names: tuple[str, ...], *, required: bool) -> list[float]:
    """Values of the first of some matrices that is there: as OpenCV writes it, flat, or row by row."""
    for name in names:
        node = storage.getNode(name)
        if not node.isNone():
            values = node.getNode("data") if node.isMap() else node
            items = [values.at(k) for k in range(values.size())] if values.isSeq() else []
            if items and all(item.isSeq() for item in items):
                items = [row.at(k) for row in items for k in range(row.size())]
            if not items or not all(item.isReal() or item.isInt() for item in items):
                raise InputError(f"its {name} is not a matrix of numbers")
            return [float(np.float64(item.real())) for item in items]
    if required:
        raise InputError(f"holds no {' or '.join(names)}", remedy=_REMEDY)
    return []
