"""Where a pixel gathers light across a step in depth: there a kernel may err, for one thing hides another."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.footprint import reach_px
from radwrap.imaging.response.sensor import GrayWhereAsked
from radwrap.scene.camera import Camera

# The far thing's light B is spread by its own magnification m_far, where the near thing's rim lets through what its own
# m_near says: the kernel is off by B (F(x/m_far) - F(x/m_near)); F is an edge under a round opening's blur. Where the
# magnifications differ by the share s that is at most s B/pi, at .7 of the blur's radius, whatever the near thing's
# own light. Of a blur that is smaller than a pixel the pixel's mean counts: 2/(3 pi) of what the radii differ by [px].
_WIDE_COST: Final = 1 / math.pi
_NARROW_COST: Final = 2 / (3 * math.pi)


def steps(
    camera: Camera, magnification: NDArray[np.float64], gray: NDArray[np.float64] | GrayWhereAsked, least: float
) -> NDArray[np.bool_]:
    """Pixels, shape (rows, columns), that gather light across a step in depth that may matter.

    Parameters
    ----------
    camera : Camera
        The view.
    magnification : ndarray, shape (rows, columns)
        Of the survey's grid.
    gray : ndarray, shape (rows, columns)
        The image [gray level].
    least : float
        Smallest error that matters [gray level].
    """
    places = [
        ((np.arange(number) + 0.5) / number * size).astype(np.intp)
        for size, number in zip(gray.shape, magnification.shape, strict=True)
    ]
    cost = cost_on_grid(camera, gray.shape, magnification, gray[np.ix_(*places)])
    wide: NDArray[np.bool_] = (cost > least)[np.ix_(*nearest(gray.shape, cost.shape))]
    return wide


def nearest(shape: tuple[int, ...], numbers: tuple[int, ...]) -> list[NDArray[np.intp]]:
    """Along each axis, in which of so many equal parts each pixel lies."""
    return [np.arange(size) * number // size for size, number in zip(shape, numbers, strict=True)]


def cost_on_grid(
    camera: Camera, shape: tuple[int, ...], magnification: NDArray[np.float64], gray: NDArray[np.float64]
) -> NDArray[np.float64]:
    """About what a kernel is off by at each point of an even grid over an image of a shape [gray level]."""
    # Where a survey's point lies between pixels, a step hides by so much: the reach, and a point more.
    reach = reach_px(camera, float(np.abs(magnification).max()))[::-1]
    far = [
        min(math.ceil(reach[axis] * n / size) + 1, n - 1)
        for axis, (size, n) in enumerate(zip(shape, magnification.shape, strict=True))
    ]
    return cost_of_steps(camera, magnification, gray, far)


def cost_of_steps(
    camera: Camera, magnification: NDArray[np.float64], gray: NDArray[np.float64], far: list[int]
) -> NDArray[np.float64]:
    """About what a kernel is off by at each point, from what is seen within so many points along each axis.

    Magnifications of a lens are small about its plane of focus: their share counts, not what they differ by.
    """
    high, low = _extreme_nearby(magnification, far, np.fmax), _extreme_nearby(magnification, far, np.fmin)
    return _cost(camera, high, low, _extreme_nearby(gray, far, np.fmax))


def cost_of_patches(
    camera: Camera, magnification: NDArray[np.float64], gray: NDArray[np.float64]
) -> NDArray[np.float64]:
    """As `cost_of_steps`, of the middles of patches that reach as far, each by a row of what is seen in it."""
    return _cost(camera, magnification.max(axis=1), magnification.min(axis=1), gray.max(axis=1))


def _cost(
    camera: Camera, high: NDArray[np.float64], low: NDArray[np.float64], brightest: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What a kernel is off by where magnifications lie between two, by the brightest gray level there."""
    largest = np.maximum(np.abs(high), np.abs(low))
    share = np.divide(high - low, largest, out=np.zeros_like(largest), where=largest > 0)
    light = brightest - camera.sensor.dark_gray
    blur = max(reach_px(camera, 1.0)) * largest
    cost: NDArray[np.float64] = np.minimum(_WIDE_COST, _NARROW_COST * blur) * share * light
    return cost


def _extreme_nearby(values: NDArray[np.float64], far: list[int], choose: np.ufunc) -> NDArray[np.float64]:
    """Largest or smallest within so many steps along each axis; what is not a number is passed over."""
    for axis, steps_away in enumerate(far):
        values = _extreme(values, axis, steps_away, choose)
    return values


def _extreme(values: NDArray[np.float64], axis: int, far: int, choose: np.ufunc) -> NDArray[np.float64]:
    """Largest or smallest within so many steps along an axis."""
    values = np.moveaxis(values, axis, 0)
    found = np.concatenate([values[:1].repeat(far, axis=0), values, values[-1:].repeat(far, axis=0)])
    # Of windows twice as wide each time, and last of two that overlap.
    width, wanted = 1, 2 * far + 1
    while width < wanted:
        shift = min(width, wanted - width)
        found = choose(found[:-shift], found[shift:])
        width += shift
    return np.moveaxis(found, 0, axis)
