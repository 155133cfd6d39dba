"""What a pixel gathers from the central image where light is a wave: its box folded with the wave's point spread.

The counterpart of `footprint`, on a grid of cells that goes round: the right
edge of it borders on the left one, and what waves send farther than half of its
size comes in at the other side. So nothing is lost, and the grid must be as
wide as that matters; `Waves.tail` says how much it is.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.footprint import footprint, laid_out, reach_px
from radwrap.imaging.optics.transfer import Transfer
from radwrap.imaging.optics.waves import Waves
from radwrap.scene.camera import Camera, Sensor
from radwrap.scene.pixel_window import PixelWindow, Profile

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Share of a frequency that may be taken for nothing: .03 gray of 255. Of openings with straight edges, whose envelope
# is reached across these edges only, more: the latter takes an integral for each frequency.
_LEAST: Final = {"round": 1e-4, "annular": 1e-4, "square": 1e-3, "half_disc": 1e-2}
# Cells or pixels that the radius of a blur may have so that points stand for the opening; beyond, they are too few.
_POINTS_REACH: Final = 40


def wave_weights(
    waves: Waves,
    sensor: Sensor,
    magnification: float,
    cell: float,
    shape: tuple[int, int],
    *,
    least: float = 0.0,
    phase: tuple[int, ...] = (0, 0),
    transfer: Transfer | None = None,
) -> Complex:
    """Transform of the weights of cells around a pixel, exact for radiance that is even in each cell.

    Parameters
    ----------
    waves : Waves
        Of a wavelength above 0: what passes ends at a frequency, and all of it is taken.
    sensor : Sensor
        Its pixels.
    magnification : float
        m of what is seen.
    cell : float
        Size h of the cells [px]; a power of two. The corner of the pixel, of the first of its kind where cells are
        larger, is that of cell (0, 0).
    shape : tuple of int
        Rows and columns of the grid.
    least : float
        Frequencies of which no greater share passes may be left out; 0 takes all.
    phase : tuple of int
        Row and column of the pixel in the cell [px], where cells are larger.
    transfer : callable, optional
        What passes of frequencies, where it is made already, see `passed`.

    Returns
    -------
    ndarray, shape (rows, columns // 2 + 1)
        As `numpy.fft.rfft2` gives it of weights whose sum is 1.
    """
    window = sensor.window or PixelWindow()
    highest = waves.last_frequency(magnification, least) if least else waves.highest_frequency
    down, of_rows = _axis(highest, np.fft.fftfreq(shape[0]), cell, sensor.pixel_height, window.down, phase=phase[0])
    across, of_columns = _axis(
        highest, np.fft.rfftfreq(shape[1]), cell, sensor.pixel_width, window.across, phase=phase[1]
    )
    found = np.zeros((shape[0], shape[1] // 2 + 1), dtype=np.complex128)
    transfer = transfer or waves.transfer_up_to(highest, magnification)
    some_rows, some_columns = ([np.flatnonzero(np.abs(one) < highest) for one in axis] for axis in (down, across))
    for y, along, rows in zip(down, of_rows, some_rows, strict=True):
        for x, beside, columns in zip(across, of_columns, some_columns, strict=True):
            if rows.size and columns.size:
                at = np.ix_(rows, columns)
                passed = transfer(x[np.newaxis, columns], y[rows, np.newaxis])
                found[at] += passed * along[rows, np.newaxis] * beside[np.newaxis, columns]
    return found


def _axis(
    highest: float, frequency: NDArray[np.floating[Any]], cell: float, pitch: float, profile: Profile, *, phase: int
) -> tuple[list[Array], list[Complex]]:
    """Frequencies that a grid of cells does not tell from each other [m^-1], and what pixel and cell do to each."""
    aliases = math.ceil(highest * cell * pitch + 0.5)
    frequencies, factors = list[Array](), list[Complex]()
    for number in range(-aliases, aliases + 1):
        cycles = (frequency.astype(np.float64) + number) / cell  # a pixel
        # A cell's middle lies by this much beside that of the pixel whose corner it shares.
        place = np.exp(2j * np.pi * cycles * ((cell - 1) / 2 - phase))
        frequencies.append(cycles / pitch)
        factors.append(_profile_transfer(profile, cycles) * np.sinc(cycles * cell) * place)
    return frequencies, factors


def _profile_transfer(profile: Profile, cycles: Array) -> Complex:
    """Transform of a pixel's sensitivity along one axis [cycles a pixel]."""
    found = np.zeros(cycles.shape, dtype=np.complex128)
    for low, high, weight in zip(profile.edges[:-1], profile.edges[1:], profile.weights, strict=True):
        found += weight * np.sinc(cycles * (high - low)) * np.exp(-1j * np.pi * cycles * (high + low))
    return found


def is_laid_out(waves: Waves, camera: Camera, magnification: float, cell: float) -> bool:
    """Whether a footprint is that of rays, over so few cells that `ray_layout` has it."""
    return not waves.wavelength and min(reach_px(camera, magnification)) < _POINTS_REACH * max(cell, 1.0)


def ray_layout(
    camera: Camera, magnification: float, cell: float, shape: tuple[int, int], phase: tuple[int, ...] = (0, 0)
) -> Array:
    """Weights of cells around a pixel, of rays through an even opening, on a grid of a shape that goes round."""
    return laid_out(footprint(camera.without_lens, magnification, cell, phase), shape)


def ray_weights(
    camera: Camera, magnification: float, cell: float, shape: tuple[int, int], phase: tuple[int, ...] = (0, 0)
) -> Complex:
    """As `wave_weights`, of the footprint of rays through an even opening."""
    return np.fft.rfft2(ray_layout(camera, magnification, cell, shape, phase))


def passed(waves: Waves, magnification: float) -> Transfer:
    """What passes of frequencies, as `passed_weights` takes it, for cells of all sizes."""
    least = _LEAST[waves.aperture.shape]
    return waves.transfer_up_to(waves.last_frequency(magnification, least), magnification)


def passed_weights(
    waves: Waves,
    camera: Camera,
    magnification: float,
    cell: float,
    shape: tuple[int, int],
    *,
    phase: tuple[int, ...] = (0, 0),
    transfer: Transfer | None = None,
) -> Complex:
    """As `wave_weights`, or of a wavelength of 0 as `ray_weights`; a blur of many cells may be off by 1e-4."""
    if is_laid_out(waves, camera, magnification, cell):
        return ray_weights(camera, magnification, cell, shape, phase)
    least = _LEAST[waves.aperture.shape]
    return wave_weights(waves, camera.sensor, magnification, cell, shape, least=least, phase=phase, transfer=transfer)
