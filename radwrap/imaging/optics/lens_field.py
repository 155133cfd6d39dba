"""Over the field of a lens: what its glass does at places of the sensor, and how few of them stand for all.

Between places on a grid what waves do is mixed, straight along rows and
columns. A mixture is off by the square of what changes from one place to the
next, so that twice as large a grid tells how far: by a third of what it
differs (Richardson), and half of it is counted.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.contrast_share import ContrastShare
from radwrap.imaging.optics.measured_spread import MeasuredSpread
from radwrap.imaging.optics.pupil_path import PupilPath
from radwrap.scene.aberrations import ContrastTable, PointSpread, Wavefront
from radwrap.scene.camera import Camera

Array = NDArray[np.float64]
Rect = tuple[int, int, int, int]
Place = tuple[float, float]
Glass = PupilPath | ContrastShare | MeasuredSpread
Signs = tuple[int, int]

# Between neighbouring places a wavefront may change by so much of a wave, rms over the pupil: .63 rad. A mixture is
# then off by a twentieth of the light that is moved. Shares of contrast may change by as much.
_STEP: Final = 0.1
_FEWEST, _MOST = 4, 12  # steps along a side; what they leave is in the error
_SAME_PLACE: Final = 1e-6  # px
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
    sensor, lens = camera.sensor, camera.lens
    middle = LensField(((sensor.rows - 1) / 2,), ((sensor.columns - 1) / 2,))
    glass = None if lens is None else lens.glass
    if glass is None or isinstance(glass, PointSpread) or glass.heights is None:
        return middle
    for steps in range(min(_FEWEST, most), most + 1, 2):
        found = LensField(_nodes(sensor.rows, steps), _nodes(sensor.columns, steps))
        if _largest_step(camera, found, wavelength) <= _STEP:
            break
    return found


def _nodes(pixels: int, steps: int) -> tuple[float, ...]:
    return tuple(np.linspace(0.0, max(pixels - 1, 1), steps + 1).tolist())


def _largest_step(camera: Camera, field: LensField, wavelength: float) -> float:
    """How far glass of neighbouring places differs: wavefronts rms over the pupil [waves], or shares of contrast."""
    each = [glass_at(camera, place) for place in field.places]
    values = np.array([_as_numbers(glass, wavelength) for glass in each])
    grid = values.reshape(len(field.rows), len(field.columns), -1)
    steps = [np.diff(grid, axis=axis) for axis in (0, 1)]
    if isinstance(each[0], PupilPath):
        return max(float(np.sqrt((step**2).sum(axis=-1)).max()) for step in steps)
    return max(float(np.abs(step).max()) for step in steps)


def _as_numbers(glass: Glass | None, wavelength: float) -> Array:
    """What changes over the field, in axes that do not turn with it."""
    if isinstance(glass, PupilPath):
        return np.array(glass.coefficients) / wavelength
    if not isinstance(glass, ContrastShare):
        return np.zeros(1)
    tangential, sagittal = np.array(glass.tangential), np.array(glass.sagittal)
    apart = (tangential - sagittal) / 2
    turned = (np.cos(2 * glass.azimuth) * apart, np.sin(2 * glass.azimuth) * apart)
    return np.concatenate([(tangential + sagittal) / 2, *turned])


def glass_at(camera: Camera, place: Place) -> Glass | None:
    """What the glass does at a column and row of the sensor [px]; None where it does nothing."""
    lens, sensor, (column, row), (cu, cv) = camera.lens, camera.sensor, place, camera.principal_point
    if lens is None or lens.glass is None:
        return None
    x, y = (column - cu) * sensor.pixel_width, (cv - row) * sensor.pixel_height  # y up
    if isinstance(lens.glass, PointSpread):
        return MeasuredSpread(lens.glass)
    if isinstance(lens.glass, Wavefront):
        return PupilPath(lens.glass.pupil_diameter / 2, lens.glass.orders, lens.glass.at(x, y))
    return ContrastShare(lens.glass.frequencies, *lens.glass.at(x, y), math.atan2(y, x))


def images_of(camera: Camera, field: LensField, place: Place) -> tuple[tuple[Place, Signs], ...]:
    """Places of a field that see the same glass but for a mirror, and the one that stands for them first.

    Parameters
    ----------
    camera : Camera
        Its lens, opening and sensor.
    field : LensField
        With the place.
    place : tuple of float
        Column and row [px].

    Returns
    -------
    tuple of (place, (int, int))
        And signs of across and down: what passes of a frequency there is what passes at the first place of the
        frequency with these signs.
    """
    cu, cv = camera.principal_point
    away = [
        other
        for other in field.places
        if math.isclose(abs(other[0] - cu), abs(place[0] - cu), abs_tol=_SAME_PLACE)
        and math.isclose(abs(other[1] - cv), abs(place[1] - cv), abs_tol=_SAME_PLACE)
    ]
    first = away[0]
    glass = glass_at(camera, first)
    alone = ((place, (1, 1)),)
    if camera.aperture.shape not in ("round", "annular") or not isinstance(glass, PupilPath):
        return alone
    found = [(first, (1, 1))]
    for other in away[1:]:
        signs = tuple(
            -1 if (one - c) * (base - c) < 0 else 1
            for one, base, c in zip(other, first, camera.principal_point, strict=True)
        )
        if glass.is_mirrored(glass_at(camera, other), *signs):
            found.append((other, (signs[0], signs[1])))
    return tuple(found) if place in dict(found) else alone


def glass_reach(camera: Camera) -> float:
    """How far the glass sends light from where a perfect lens does, at most, or where it leaves half a contrast [m]."""
    glass = None if camera.lens is None else camera.lens.glass
    match glass:
        case Wavefront():
            rows = [PupilPath(glass.pupil_diameter / 2, glass.orders, row) for row in glass.coefficients]
            return max(row.steepest(camera.aperture.reach) for row in rows) * camera.image_distance
        case ContrastTable():
            pairs = zip(glass.tangential, glass.sagittal, strict=True)
            return max(ContrastShare(glass.frequencies, *pair, 0.0).reach for pair in pairs)
        case PointSpread():
            return glass.reach
    return 0.0
