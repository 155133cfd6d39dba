"""Captures of one scene: their mean, how many there are, and which pixels count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage, read_gray, read_image
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_LEAST_PIXELS: Final = 2
_BINS: Final = 8  # gray levels between which the scatter of repeats is told apart
_SEVERAL: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class Captured:
    """What a camera gave of one scene.

    Attributes
    ----------
    mean : ndarray, shape (rows, columns)
        Over the repeats [gray level].
    highest, lowest : ndarray, shape (rows, columns)
        Over the repeats: whether any of them was cut.
    repeats : int
        Captures of the very same scene.
    mask : ndarray of bool, shape (rows, columns)
        Pixels that count.
    variance : ndarray, shape (rows, columns), optional
        Of one capture, by the scatter of the repeats [gray level^2]; None for a single one.
    """

    mean: Array
    highest: Array
    lowest: Array
    repeats: int
    mask: Flags
    variance: Array | None


def read_captures(paths: Sequence[str | Path | GrayImage]) -> list[GrayImage]:
    """Read captured images."""
    return [path if isinstance(path, GrayImage) else read_gray(Path(path)) for path in paths]


def read_mask(path: str | Path) -> Flags:
    """Read a picture of which pixels count: those that are not black."""
    return np.asarray(read_image(Path(path))[0] != 0, dtype=np.bool_)


def captured(images: Sequence[GrayImage], names: Sequence[str], sensor: Sensor, mask: Flags | None) -> Captured:
    """Repeated captures of one scene.

    Raises
    ------
    InputError
        If there is none, their size or bit depth is not the sensor's, or the mask leaves nothing.
    """
    if not images:
        raise InputError("is missing", where="CAPTURE", remedy="name one captured image or more")
    shape = (sensor.rows, sensor.columns)
    for image, name in zip(images, names, strict=True):
        if image.values.shape != shape:
            rows, columns = image.values.shape
            raise InputError(
                f"has {columns} x {rows} pixels, the scene's sensor {sensor.columns} x {sensor.rows}", where=name
            )
        deepest = float(image.values.max())
        # A file of 16 bits may hold 10 or 12: its own levels tell whether they fit.
        if image.bit_depth < sensor.bit_depth or deepest > 2**sensor.bit_depth - 1:
            raise InputError(
                f"has {image.bit_depth} bits and levels up to {deepest:g}, the scene's sensor {sensor.bit_depth} bits",
                where=name,
                remedy="set camera.sensor.bit_depth, or capture in that mode",
            )
    counted = np.ones(shape, dtype=np.bool_) if mask is None else mask
    if counted.shape != shape:
        raise InputError(f"has the shape {counted.shape}, the sensor {shape}", where="mask")
    if np.count_nonzero(counted) < _LEAST_PIXELS:
        raise InputError("leaves no pixel", where="mask")
    stack = np.stack([image.values for image in images])
    return Captured(
        stack.mean(axis=0), stack.max(axis=0), stack.min(axis=0), len(images), counted, _scatter(stack, counted)
    )


def _scatter(stack: Array, mask: Flags) -> Array | None:
    """Variance of one capture at each pixel, pooled over pixels of about the same gray level."""
    if len(stack) < _SEVERAL:
        return None
    mean, each = stack.mean(axis=0), stack.var(axis=0, ddof=1)
    order = np.argsort(mean[mask], kind="stable")
    bins = [part for part in np.array_split(order, _BINS) if part.size]
    levels = np.array([mean[mask][part].mean() for part in bins])
    pooled = np.array([each[mask][part].mean() for part in bins])
    levels, kept = np.unique(levels, return_index=True)
    return np.asarray(np.interp(mean, levels, pooled[kept]), dtype=np.float64)
