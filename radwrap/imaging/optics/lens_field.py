"""Over the field of a lens: what its glass does at places of the sensor, and how few of them stand for all.

Between places on a grid what waves do is mixed, straight along rows and
columns. A mixture is off by the square of what changes from one place to the
next, so that twice as large a grid tells how far: by a third of what it
differs (Richardson), and half of it is counted.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.pupil_path import PupilPath
from radwrap.scene.camera import Camera

Array = NDArray[np.float64]
Rect = tuple[int, int, int, int]
Place = tuple[float, float]

# Between neighbouring places a wavefront may change by so much of a wave, rms over the pupil: .63 rad. A mixture is
# then off by a twentieth of the light that is moved.
_STEP: Final = 0.1
_FEWEST, _MOST = 4, 12  # steps along a side; what they leave is in the error
# What a mixture is off by, over what one of places twice as far apart differs.
MIXED_SHARE: Final = 1 / 2


@dataclass(frozen=True, slots=True)
class LensField:
    """Places of the sensor at which it is known what the glass does.

    Attributes
    ----------
    rows, columns : tuple of float
        Of the places on a grid [px], from one end of the sensor to the other; an odd number each, or one where all
        places are alike.
    """

    rows: tuple[float, ...]
    columns: tuple[float, ...]

    @property
    def places(self) -> tuple[Place, ...]:
        """Columns and rows of all places [px], row by row."""
        return tuple((column, row) for row, column in itertools.product(self.rows, self.columns))

    def nearest(self, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Number of the place that is nearest to each pixel."""
        down, across = (
            np.abs(at[:, np.newaxis] - np.array(nodes)).argmin(axis=1)
            for at, nodes in ((rows, self.rows), (columns, self.columns))
        )
        found: NDArray[np.intp] = down * len(self.columns) + across
        return found

    def shares(self, rect: Rect) -> Iterator[tuple[Place, Array, Array]]:
        """Places that count in a part of the sensor.

        Parameters
        ----------
        rect : tuple of int
            First row, last row + 1, first column, last column + 1.

        Yields
        ------
        place : tuple of float
            Column and row [px].
        share, of_coarser : ndarray, shape (rows, columns)
            Its shares of each pixel, and those where every other place stands for all; over all places they sum to 1.
        """
        down = [_hats(self.rows[::step], rect[0], rect[1]) for step in (1, 2)]
        across = [_hats(self.columns[::step], rect[2], rect[3]) for step in (1, 2)]
        for (i, row), (j, column) in itertools.product(enumerate(self.rows), enumerate(self.columns)):
            share = np.outer(down[0][i], across[0][j])
            of_coarser = np.zeros_like(share)
            if i % 2 == j % 2 == 0:
                of_coarser = np.outer(down[1][i // 2], across[1][j // 2])
            if share.any() or of_coarser.any():
                yield (column, row), share, of_coarser


def _hats(nodes: tuple[float, ...], begin: int, end: int) -> Array:
    """Shares of each node in what lies straight between two of them, shape (nodes, pixels)."""
    pixels = np.arange(begin, end, dtype=np.float64)
    if len(nodes) == 1:
        return np.ones((1, len(pixels)))
    return np.stack([np.interp(pixels, nodes, one) for one in np.eye(len(nodes))])


def lens_field(camera: Camera, wavelength: float, most: int = _MOST) -> LensField:
    """Choose places: one in the middle where all are alike, else so many that the glass changes little between them.

    Parameters
    ----------
    camera : Camera
        Its lens and sensor.
    wavelength : float
        Of the light [m].
    most : int
        Steps along a side at most; even.
    """
    sensor = camera.sensor
    middle = LensField(((sensor.rows - 1) / 2,), ((sensor.columns - 1) / 2,))
    wavefront = None if camera.lens is None else camera.lens.glass
    if wavefront is None or wavefront.heights is None:
        return middle
    for steps in range(min(_FEWEST, most), most + 1, 2):
        found = LensField(_nodes(sensor.rows, steps), _nodes(sensor.columns, steps))
        if _largest_step(camera, found) <= _STEP * wavelength:
            break
    return found


def _nodes(pixels: int, steps: int) -> tuple[float, ...]:
    return tuple(np.linspace(0.0, max(pixels - 1, 1), steps + 1).tolist())


def _largest_step(camera: Camera, field: LensField) -> float:
    """How far wavefronts of neighbouring places differ, rms over the pupil [m]."""
    values = np.array([_coefficients(camera, place) for place in field.places])
    grid = values.reshape(len(field.rows), len(field.columns), -1)
    return max(float(np.sqrt((np.diff(grid, axis=axis) ** 2).sum(axis=-1)).max()) for axis in (0, 1))


def glass_at(camera: Camera, place: Place) -> PupilPath | None:
    """What the glass does at a column and row of the sensor [px]; None where it does nothing."""
    wavefront = None if camera.lens is None else camera.lens.glass
    if wavefront is None:
        return None
    return PupilPath(wavefront.pupil_diameter / 2, wavefront.orders, _coefficients(camera, place))


def _coefficients(camera: Camera, place: Place) -> tuple[float, ...]:
    assert camera.lens is not None and camera.lens.glass is not None  # noqa: S101  (the caller knows)
    (column, row), (cu, cv), sensor = place, camera.principal_point, camera.sensor
    return camera.lens.glass.at((column - cu) * sensor.pixel_width, (cv - row) * sensor.pixel_height)


def glass_reach(camera: Camera) -> float:
    """How far the glass sends rays from where a perfect lens does, at most [m]."""
    wavefront = None if camera.lens is None else camera.lens.glass
    if wavefront is None:
        return 0.0
    steepest = max(
        PupilPath(wavefront.pupil_diameter / 2, wavefront.orders, row).steepest(camera.aperture.reach)
        for row in wavefront.coefficients
    )
    return steepest * camera.image_distance
