"""A light basis whose rows are exposed at times of their own, to light that may be pulsed: nothing moves.

Each row of each source counts by how long the source shines into it, and so does all that its error is made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.run_files import RowsFile
from radwrap.scene.camera import Camera
from radwrap.scene.shutter import lit_time, row_windows

Array = NDArray[np.float64]


def row_shares(told: RowsFile, camera: Camera) -> dict[str, Array]:
    """Of each source of a basis, a factor on its light in each row, shape (rows,).

    Parameters
    ----------
    told : RowsFile
        Of the basis.
    camera : Camera
        Whose rows; its exposure time and shutter may be others than when the basis was made.

    Raises
    ------
    InputError
        If a source would shine into a row that the basis has no light of.
    """
    start, end = row_windows(camera.sensor.shutter, camera.sensor.rows, camera.exposure_time)
    for name, strobe in told.missed.items():
        if lit_time(strobe, start, end).any():
            raise InputError(
                f'lets "{name}" shine into a row, which the basis has no light of',
                where="camera.exposure_time",
                remedy="render that camera",
            )
    return {
        name: lit_time(told.strobes.get(name), start, end) / camera.exposure_time / largest
        for name, largest in told.largest.items()
    }


def weighed(basis: Basis, shares: Mapping[str, Array]) -> Basis:
    """The basis with a factor on each row of each source's light; all that its errors are made of likewise."""
    rows = np.stack([shares[name] for name in basis.sources]).astype(np.float32)
    columns = basis.sensor.columns
    sampled = np.zeros(0, dtype=np.intp) if basis.sample is None else basis.sample.pixels
    waves = None if basis.waves is None else basis.waves * rows[:, np.newaxis, :, np.newaxis]
    return replace(
        basis,
        images=basis.images * rows[:, np.newaxis, :, np.newaxis],
        grid=basis.grid * rows[:, np.newaxis, basis.grid_pixels // columns],
        lacks=basis.lacks * rows[:, np.newaxis, sampled // columns],
        waves=waves,
    )
