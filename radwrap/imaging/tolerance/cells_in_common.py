"""Cells of an image by a kernel, and of waves that are added to it: what their sizes change has a part in common."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.kernel import GRID_SHARE, grid_share
from radwrap.imaging.tolerance.planner import Outcome
from radwrap.imaging.tolerance.plans import kernel_of
from radwrap.imaging.tolerance.wave_plan import WavePlan


def own_change(
    image: Outcome, waves: WavePlan, wavelengths: Iterable[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """What the size of an image's own cells adds to it, by itself and as it counts beside waves [W m^-2 sr^-1].

    Where waves have cells of the same size, rays' footprint is in the sum no more, and with it their sharp edges, which
    these cells may not resolve: it is the waves' that they have to.

    Parameters
    ----------
    image : Outcome
        It.
    waves : WavePlan
        Of what is added.
    wavelengths : iterable of float
        Of the light [m].

    Returns
    -------
    tuple of ndarray, shape (rows, columns), or None
        None where there are no cells.
    """
    kernel, change = kernel_of(image.ray_plan), image.replicates.change
    if kernel is None or change is None:
        return None
    cell, per_wavelength = kernel.grid.cell, waves.waves.blur / waves.waves.wavelength
    resolved = all(cell * waves.pitch <= per_wavelength * wavelength for wavelength in wavelengths)
    alike = cell == waves.kernel.grid.cell and resolved
    return change, change * (GRID_SHARE / grid_share(kernel) if alike else 1.0)


def smaller_cell(image: Outcome, waves: WavePlan) -> float:
    """Size of cells of waves that were found too large [px]: that of the image's where these are smaller, or half."""
    kernel, cell = kernel_of(image.ray_plan), waves.kernel.grid.cell
    return kernel.grid.cell if kernel is not None and kernel.grid.cell < cell else cell / 2
