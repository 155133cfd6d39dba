"""Area, place and direction of a part from its covered shares, and their standard errors.

Sums of w, w x, w x x over the part are its area and moments; the blur's own second moment is taken off. Every result
is to first order a sum F = sum_i f(x_i) w_i over the band, with f

- 1 for the area, (x - x_c)/A for the place,
- p q/(A (m_pp - m_qq)) for the orientation, p and q along the principal axes, m the central second moments,

and three things move it: noise of each pixel, sigma_w = noise/contrast; errors of the two levels, see level.py; and
the pixel grid, since a covered share does not say where in its pixel it lies. A sharp edge at a random place
displaces the first moment of one pixel by 0.0373 px^3 (standard deviation of p (1 - p)/2 for p even in 0 to 1),
along the edge's normal; as many neighbours as the edge needs to pass on by a pixel share it. Blur takes it away by
exp(-pi^2 R^2), what the disc's spectrum has at the grid's frequency.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.parts.cover import Cover, PartScene, lies_on, spread_by_blur
from radwrap.measure.parts.level import level_covariance
from radwrap.measure.parts.raster import smallest_rectangle
from radwrap.measure.parts.result import Part

Array = NDArray[np.float64]

GRID_ERROR: Final = math.sqrt(1 / 120 - 1 / 144)  # px^3, see above
ROUNDEST: Final = 0.01  # (m_pp - m_qq)/(m_pp + m_qq); below it an axis is the shape's tolerance, not its orientation
_FEWEST_CORNERS: Final = 4  # of a closed line, the first one twice
LOOSEST: Final = math.radians(7)  # of the orientation's error; then the axes are within 4 sigma of changing places


def measured(cover: Cover, scene: PartScene) -> Part | None:
    """The part, or None where it is wider blurred than itself: light that falls off, nothing with its own level."""
    share = cover.share
    area = float(share.sum())
    if area <= math.pi * cover.blur**2 / scene.aspect:
        return None
    u, v = float((share * cover.u).sum() / area), float((share * cover.v).sum() / area)
    x, y = cover.u - u, cover.v - v
    xx, yy, xy = (float((share * product).sum() / area) for product in (x * x, y * y, x * y))
    added_u, added_v = spread_by_blur(cover.blur, scene.aspect)
    xx, yy = xx - added_u, yy - added_v
    orientation = math.atan2(2 * xy, xx - yy) / 2
    middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    cos, sin = math.cos(orientation), math.sin(orientation)
    p, q = x * cos + y * sin, y * cos - x * sin
    difference = max(2 * apart, 1e-12 * abs(middle))
    ones, zeros = np.ones_like(x), np.zeros_like(x)
    functionals = np.stack([ones, x / area, y / area, p * q / (area * difference)])
    gradients_u = np.stack([zeros, ones / area, zeros, (q * cos - p * sin) / (area * difference)])
    gradients_v = np.stack([zeros, zeros, ones / area, (q * sin + p * cos) / (area * difference)])
    variances = np.diag(_covariance(cover, scene, functionals)) + _grid(cover, scene, gradients_u, gradients_v)
    sigma_area, sigma_u, sigma_v, sigma_orientation = (float(sigma) for sigma in np.sqrt(variances))
    major, minor = (4 * math.sqrt(max(middle + side * apart, 0.0)) for side in (1, -1))
    box = _rectangle(cover, u, v)
    if box is None:
        return None
    rectangle, rectangle_orientation = box
    inside_u, inside_v = cover.u[cover.inside], cover.v[cover.inside]
    rows, columns = scene.light.shape
    from_border = (inside_u.min(), inside_v.min(), columns - 1 - inside_u.max(), rows - 1 - inside_v.max())
    return Part(
        u=u,
        v=v,
        sigma_u=sigma_u,
        sigma_v=sigma_v,
        orientation=orientation,
        # Nothing is known worse than an even spread over half a turn.
        sigma_orientation=min(sigma_orientation, math.pi / math.sqrt(12)),
        orientation_ambiguous=bool(sigma_orientation > LOOSEST or apart < ROUNDEST * middle),
        area=area,
        sigma_area=sigma_area,
        major_axis=major,
        minor_axis=minor,
        rectangle=rectangle,
        rectangle_orientation=rectangle_orientation,
        contours=_contours(cover),
        contrast=cover.depth,
        noise=cover.noise,
        blur_radius=cover.blur,
        touches_border=bool(min(from_border) < 1),
    )


def _covariance(cover: Cover, scene: PartScene, functionals: Array) -> Array:
    """Of sums of f w: noise of each pixel, and errors of the two levels."""
    light = cover.around.surface - cover.share * cover.contrast
    by_light = np.where(cover.band, functionals / cover.contrast, 0.0)
    total: Array = np.einsum("sij,ij,tij->st", by_light, cover.pixel_variance, by_light)
    for level, weight in ((cover.around, 1 - cover.share), (cover.core, cover.share)):
        own = np.where(lies_on(level, light, scene), -by_light, 0.0)
        total += level_covariance(level, by_light * weight, own, scene.response)
    return total


def _grid(cover: Cover, scene: PartScene, gradients_u: Array, gradients_v: Array) -> Array:
    """Variance from not knowing where in its pixel a covered share lies."""
    slope_v, slope_u = (np.asarray(slope, dtype=np.float64) for slope in np.gradient(cover.share))
    length = np.hypot(slope_u, slope_v)
    rim = cover.band & (length > 0.1)
    normal_u, normal_v, length = slope_u[rim] / length[rim], slope_v[rim] / length[rim], length[rim]
    larger = np.maximum(np.abs(normal_u), np.abs(normal_v))
    smaller = np.minimum(np.abs(normal_u), np.abs(normal_v))
    side = math.sqrt(float(cover.share.sum()))
    alike = np.minimum(larger / np.maximum(smaller, 1e-6), side)
    across = gradients_u[:, rim] * normal_u + gradients_v[:, rim] * normal_v
    squared_blur = cover.blur**2 * (normal_u**2 + (normal_v / scene.aspect) ** 2)
    left = GRID_ERROR**2 * np.exp(-(math.pi**2) * squared_blur)
    variances: Array = (left * across**2 * length * alike).sum(axis=1)
    return variances


def _contours(cover: Cover) -> tuple[Array, ...]:
    """Lines along which half of a pixel is covered, the longest first."""
    from contourpy import contour_generator

    # A frame of empty pixels closes what ends at the border of the piece that was looked at.
    share = np.pad(np.where(cover.band | cover.inside, cover.share, 0.0), 1)
    lines = contour_generator(z=share).lines(0.5)
    offset = np.array([cover.u[0, 0] - 1, cover.v[0, 0] - 1])
    found = [np.asarray(line, dtype=np.float64) + offset for line in lines if len(line) > _FEWEST_CORNERS]
    return tuple(sorted(found, key=lambda line: -float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())))


def _rectangle(cover: Cover, u: float, v: float) -> tuple[tuple[float, float, float, float], float] | None:
    """Smallest rectangle about the half-level contour, and the direction of its longer side."""
    high = np.where(cover.band | cover.inside, cover.share, 0.0) - 0.5
    points = []
    for axis in (0, 1):
        first, second = (high[:-1], high[1:]) if axis == 0 else (high[:, :-1], high[:, 1:])
        rows, columns = np.nonzero((first > 0) != (second > 0))
        part = first[rows, columns] / (first[rows, columns] - second[rows, columns])
        place = np.stack([columns + part * axis, rows + part * (1 - axis)], axis=1)
        points.append(place + np.array([cover.u[0, 0] - u, cover.v[0, 0] - v]))
    contour = np.concatenate(points)
    if len(contour) < 3:
        return None
    x, y, length, width, turn = smallest_rectangle(contour)
    return (u + x, v + y, length, width), turn
