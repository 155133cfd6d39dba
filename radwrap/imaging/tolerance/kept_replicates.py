"""The independent images behind a result, kept beside it: what is measured on them tells what is measured how well."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import read_image, write_exr
from radwrap.imaging.tolerance.replicates import Replicates

REPLICATES: Final = "replicates.exr"
_UNIT: Final = {"radwrap:unit": "J m^-2"}


@dataclass(frozen=True, slots=True, eq=False)
class KeptReplicates:
    """Replicates of an image, as radiant exposure.

    Attributes
    ----------
    images : ndarray, shape (replicates, rows, columns)
        Independent; their mean is the result [J m^-2].
    change : ndarray, shape (rows, columns)
        What the size of the kernel's cells adds to the mean, as far as it does not average out over many pixels; 0
        where there are no cells [J m^-2].
    """

    images: NDArray[np.float64]
    change: NDArray[np.float64]

    def changes(self) -> NDArray[np.float64]:
        """What may be added to the mean, each as its own noise is distributed, shape (replicates, rows, columns)."""
        deviations: NDArray[np.float64] = self.images - self.images.mean(axis=0)
        # The deviation of one has (n - 1)/n of the variance of one, and the mean 1/n of it.
        deviations /= np.sqrt(len(self.images) - 1)
        return deviations


def kept(replicates: Replicates, exposure_of_radiance: float) -> KeptReplicates:
    """The replicates of an even plan, to be kept."""
    images = replicates.images.astype(np.float64) * exposure_of_radiance
    change = np.zeros(images.shape[1:]) if replicates.change is None else replicates.change * exposure_of_radiance
    return KeptReplicates(images, replicates.smooth_share * change)


def write_replicates(folder: Path, found: KeptReplicates) -> list[str]:
    """Write them into the folder of their image, one below the other, the change last; returns the file's name."""
    pixels = np.concatenate([*found.images, found.change]).astype(np.float32)
    write_exr(folder / REPLICATES, pixels, channel="radiant_exposure", metadata=_UNIT)
    return [REPLICATES]


def read_replicates(folder: Path, rows: int) -> KeptReplicates:
    """Read them back.

    Parameters
    ----------
    folder : Path
        Of the image.
    rows : int
        Of the sensor.

    Raises
    ------
    InputError
        If they are not there.
    """
    pixels = read_image(folder / REPLICATES)[0].astype(np.float64)
    if pixels.ndim != 2 or len(pixels) % rows or len(pixels) < 3 * rows:
        raise InputError("holds no replicates of the image", where=str(folder / REPLICATES), remedy="render again")
    images = pixels.reshape(-1, rows, pixels.shape[1])
    return KeptReplicates(images[:-1], images[-1])
