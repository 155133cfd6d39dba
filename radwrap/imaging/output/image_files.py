"""Radiant exposure and gray image, as files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.images import (
    PREVIEW_BITS,
    ExposureImage,
    GrayImage,
    RadianceImage,
    preview_codes,
    read_image,
    write_exr,
    write_png,
)
from radwrap.imaging.output.run_manifest import Extent
from radwrap.imaging.response.exposure import radiant_exposure
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.scene.camera import Camera, Sensor

EXPOSURE: Final = "radiant_exposure.exr"
GRAY: Final = "gray.png"
UNROUNDED: Final = "gray.exr"
PREVIEW: Final = "preview.png"
_UNIT: Final = {"radwrap:unit": "J m^-2"}


@dataclass(frozen=True, slots=True)
class ImageSummary:
    """What the manifest says of the images.

    Attributes
    ----------
    radiant_exposure, gray : Extent
        Of their values [J m^-2] and [gray level].
    saturated_fraction, dark_fraction : float
        Shares of the pixels.
    """

    radiant_exposure: Extent
    gray: Extent
    saturated_fraction: float
    dark_fraction: float


def write_images(
    folder: Path | None, radiance: NDArray[np.float64], camera: Camera, check: Callable[[], None] | None = None
) -> tuple[ImageSummary, list[str]]:
    """Write both as `write_exposure`, of radiance; what is returned is its own. Without a folder it is all.

    Parameters
    ----------
    folder, check
        As of `write_exposure`.
    radiance : ndarray, shape (rows, columns)
        Mean of L cos^4(theta) [W m^-2 sr^-1].
    camera : Camera
        Whose image.
    """
    exact, sensor = radiant_exposure(RadianceImage(radiance), camera).values, camera.sensor
    if folder is not None:
        return write_exposure(folder, exact, sensor, check)
    exposure = ExposureImage(exact.astype(np.float32).astype(np.float64))
    levels = gray_levels(exposure.values, sensor)
    return _summary(exposure, image_of_levels(levels, sensor, exposure.provenance), levels, sensor), []


def write_exposure(
    folder: Path, exact: NDArray[np.float64], sensor: Sensor, check: Callable[[], None] | None = None
) -> tuple[ImageSummary, list[str]]:
    """Write both, gray levels in full where the sensor does not round, and of more than 8 bits a preview.

    Parameters
    ----------
    folder : Path
        Where to.
    exact : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    sensor : Sensor
        Whose image.
    check : callable, optional
        Asked between the steps, each of which takes some tenths of a second of large sensors; it raises to end them.

    Returns
    -------
    summary : ImageSummary
        What they hold.
    files : list of str
        Their names.
    """
    # The gray image is Eq. 5 of the exposure as the file holds it, so that anybody can compute it again.
    stored = exact.astype(np.float32)
    exposure = ExposureImage(stored.astype(np.float64))
    with ThreadPoolExecutor() as pool:  # one file is compressed while the other one's levels are computed
        exr = pool.submit(write_exr, folder / EXPOSURE, stored, channel="radiant_exposure", metadata=_UNIT)
        levels = gray_levels(exposure.values, sensor)
        _asked(check)
        gray = image_of_levels(levels, sensor, exposure.provenance)
        _asked(check)
        write_png(folder / GRAY, gray.codes)
        exr.result()
    _asked(check)
    files = [EXPOSURE, GRAY]
    if sensor.bit_depth > PREVIEW_BITS:
        write_png(folder / PREVIEW, preview_codes(gray))
        files.append(PREVIEW)
    if not sensor.rounding:
        write_exr(folder / UNROUNDED, gray.values.astype(np.float32), channel="gray")
        files.append(UNROUNDED)
    return _summary(exposure, gray, levels, sensor), files


def _summary(exposure: ExposureImage, gray: GrayImage, levels: NDArray[np.float64], sensor: Sensor) -> ImageSummary:
    return ImageSummary(
        radiant_exposure=Extent.of(exposure.values),
        gray=Extent.of(gray.values),
        saturated_fraction=float(np.mean(levels >= sensor.saturation_gray)),
        dark_fraction=float(np.mean(levels < sensor.dark_gray + 0.5)),
    )


def _asked(check: Callable[[], None] | None) -> None:
    if check is not None:
        check()


def read_exposure(folder: Path, provenance: Mapping[str, Any] | None = None) -> ExposureImage:
    """Radiant exposure as its file holds it."""
    return ExposureImage(read_image(folder / EXPOSURE)[0].astype(np.float64), provenance or {})


def read_gray_levels(folder: Path, sensor: Sensor, provenance: Mapping[str, Any]) -> GrayImage:
    """Gray levels; the PNG holds them rounded, and a sensor that does not round has a file of its own."""
    name = GRAY if sensor.rounding else UNROUNDED
    return GrayImage(read_image(folder / name)[0].astype(np.float64), sensor.bit_depth, provenance)
