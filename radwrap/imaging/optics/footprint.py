"""What a pixel gathers on the central image: its box folded with the opening's magnified shape.

A point at depth z that is seen through the opening's point q appears at
x' = x_c - m q, with m = 1 + f/z and x_c its place on the central image (that
of the opening's centre); for a lens see `Camera.magnification`. So a pixel gathers the central image over its own
box, moved by + m q for all q: a correlation with the magnified opening. To
convolve instead would turn the opening by half a turn.

Places are in pixels; the grid's cells have the size h, the corner of cell
(0, 0) is that of pixel (0, 0), so that cells and pixels divide each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.aperture import place, turn
from radwrap.imaging.optics.falloff import opening_shares
from radwrap.scene.camera import Aperture, Camera
from radwrap.scene.pixel_window import PixelWindow, Profile

# Points that stand for the opening's area lie this share of a cell or pixel apart, whichever is larger: with the box
# folded over them, the weights across the opening are then right to 2e-3 of the largest.
_SPACING: Final = 0.5
_FEWEST, _MOST = 32, 96  # rings of points
_GOLDEN: Final = (math.sqrt(5) - 1) / 2
_TURN_POINTS: Final = 6  # points on a ring for each ring: about as far from each other as the rings are


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Weights of cells around a pixel.

    Attributes
    ----------
    first : tuple of int
        Row and column of the first cell, from the cell in which the pixel's corner lies.
    weights : ndarray, shape (rows, columns)
        Not negative; their sum is 1.
    """

    first: tuple[int, int]
    weights: NDArray[np.float64]


def opening_points(aperture: Aperture, spacing: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points that stand for parts of an opening.

    Parameters
    ----------
    aperture : Aperture
        Any; the infinitesimal one has one point.
    spacing : float
        About how far apart [m].

    Returns
    -------
    positions : ndarray, shape (n, 2)
        Along the camera's x and y [m].
    weights : ndarray, shape (n,)
        Their sum is 1.
    """
    if aperture.is_infinitesimal:
        return np.zeros((1, 2)), np.ones(1)
    rings = min(max(math.ceil(aperture.reach / spacing), _FEWEST), _MOST)
    number = _TURN_POINTS * rings
    # Rings of equal width, which have unequal areas: those of equal area would leave the middle empty.
    bounds = (np.arange(rings + 1) / rings) ** 2
    s, t = np.meshgrid((bounds[1:] + bounds[:-1]) / 2, (np.arange(number) + 0.5) / number, indexing="ij")
    # Each ring is turned against the one before, so that no line lies across points of many rings.
    t = (t + _GOLDEN * np.arange(rings)[:, np.newaxis] / number) % 1.0
    points = place(aperture, s.ravel(), t.ravel()) @ turn(aperture.rotation).T
    return points, np.repeat(np.diff(bounds), number) / number


def reach_px(camera: Camera, magnification: float) -> tuple[float, float]:
    """How far, in columns and rows, a pixel's centre gathers light from [px]."""
    reach = camera.aperture.reach * abs(magnification)
    return reach / camera.sensor.pixel_width, reach / camera.sensor.pixel_height


def footprint(camera: Camera, magnification: float, cell: float, phase: tuple[int, ...] = (0, 0)) -> Footprint:
    """Weights of the cells from which a pixel gathers light, exact for radiance that is even in each cell.

    Parameters
    ----------
    camera : Camera
        Its opening and pixels.
    magnification : float
        m; 0 where nothing depends on the opening, below 0 behind the plane of focus.
    cell : float
        Size h of the cells [px]; a power of two.
    phase : tuple of int
        Row and column of the pixel [px]; where cells are smaller than pixels all pixels are alike.
    """
    sensor = camera.sensor
    spacing = _SPACING * max(cell, 1.0) * min(sensor.pixel_width, sensor.pixel_height) / max(abs(magnification), 1e-9)
    points, weights = opening_points(camera.aperture, spacing)
    if camera.lens is not None:
        weights = weights * opening_shares(camera, points)
        weights = weights / weights.sum()
    places = points * magnification / (sensor.pixel_width, sensor.pixel_height)
    return folded(places, weights, cell, phase, sensor.window)


def folded(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    cell: float,
    phase: tuple[int, ...] = (0, 0),
    window: PixelWindow | None = None,
) -> Footprint:
    """Weights of cells for a pixel's box around each of some points, as `footprint`.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Columns and rows from the pixel's centre [px].
    weights : ndarray, shape (n,)
        Whatever each stands for; their sum is 1.
    cell, phase
        As in `footprint`.
    window : PixelWindow, optional
        Where in its box the pixel is sensitive; default all of it, alike.
    """
    window = window or PixelWindow()
    column, across = _shares(points[:, 0] + phase[1], cell, window.across)
    row, along = _shares(points[:, 1] + phase[0], cell, window.down)
    first = (int(row.min()), int(column.min()))
    shape = (int(row.max()) - first[0] + along.shape[1], int(column.max()) - first[1] + across.shape[1])
    corner = (row - first[0]) * shape[1] + column - first[1]
    field = np.zeros(shape[0] * shape[1])
    for i, j in np.ndindex(along.shape[1], across.shape[1]):
        share = weights * along[:, i] * across[:, j]
        field += np.bincount(corner + i * shape[1] + j, share, minlength=len(field))
    return Footprint(first, field.reshape(shape))


def laid_out(print_: Footprint, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Weights in a field of a shape, those of cells before the pixel's own at the far ends."""
    weights = np.zeros(shape)
    places = (
        np.arange(first, first + size) % whole
        for first, size, whole in zip(print_.first, print_.weights.shape, shape, strict=True)
    )
    weights[np.ix_(*places)] = print_.weights
    return weights


def _shares(starts: NDArray[np.float64], cell: float, profile: Profile) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """First cells that pixels see whose boxes begin at `starts` [px], and the shares of these cells and the next."""
    first = np.floor(starts / cell).astype(np.intp)
    borders = first[:, np.newaxis] + np.arange(math.ceil(1 / cell) + 2)
    return first, np.diff(profile.share_below(borders * cell - starts[:, np.newaxis] - 0.5), axis=1)
