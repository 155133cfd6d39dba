"""Files of an image that is put together from others: colours, or instants."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.files import make_folder
from radwrap.images import write_exr
from radwrap.imaging.output.frame_files import write_frames
from radwrap.imaging.output.image_files import ImageSummary, write_exposure
from radwrap.imaging.output.sigma_file import SIGMA
from radwrap.imaging.output.truth_files import DEPTH, PARTS, TRUTH
from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.camera import Sensor

Array = NDArray[np.float64]
_TRUTH_FILES: Final = (TRUTH, DEPTH, PARTS)


def write_composed(
    work: Path,
    exposure: Array,
    sensor: Sensor,
    options: RenderOptions,
    *,
    sigma: Array | None,
    truth_of: Path,
    check: Callable[[], None],
) -> tuple[ImageSummary, list[str]]:
    """Write the image, its standard deviation, frames and truth into a folder; returns what it holds and their names.

    Parameters
    ----------
    work : Path
        Folder for what is not yet whole; it is made.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    sensor : Sensor
        Whose gray levels are written.
    options : RenderOptions
        Which say how many frames there are, and whether truth is written.
    sigma : ndarray, shape (rows, columns), optional
        Standard deviation of a captured frame [gray level], where it is known.
    truth_of : Path
        Folder of the render whose truth this image has.
    check : callable
        Asked now and then; it raises to end the work.
    """
    make_folder(work)
    images, files = write_exposure(work, exposure, sensor, check)
    if sigma is not None:
        write_exr(work / SIGMA, sigma.astype(np.float32), channel="gray_sigma")
        files.append(SIGMA)
    files += write_frames(work, sensor, options.frames, options.seed)
    if options.truth:
        for name in _TRUTH_FILES:
            shutil.copyfile(truth_of / name, work / name)
        files += _TRUTH_FILES
    return images, files
