"""Irradiance by wide lights of even radiance in closed form, with nothing between: rectangle, annulus and zone.

Points lie in the light's own frame, see `scene.wide_shapes`. Light from behind a surface does not count, and a light
shines from its front only. A zone that is seen from outside of its sphere shines as far as its inner side faces.
"""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.wide_contour import (
    Half,
    Place,
    angle_between,
    circle_before,
    circle_within,
    span_within,
)

_EVERYWHERE: Final = (0.0, 0.0, 1.0, math.inf)
_SAME: Final = 1e-9  # rad, and share of the radius: planes so near have no crossing that can be computed


@compiled
def rectangle_irradiance(width: float, height: float, p: Place, n: Place) -> float:
    """Irradiance over radiance [sr] of a point by a rectangle about the origin, which shines along +z.

    Parameters
    ----------
    width, height : float
        Its sides, along x and y.
    p, n : tuple of float
        The point and the unit normal of the lit surface.
    """
    if p[2] <= 0:
        return 0.0
    total, crossings = 0.0, 0
    fx, fy = 0.0, 0.0
    cx, cy = (-width / 2, width / 2, width / 2, -width / 2), (-height / 2, -height / 2, height / 2, height / 2)
    for k in range(4):
        ax, ay, bx, by = cx[k] - p[0], cy[k] - p[1], cx[(k + 1) % 4] - p[0], cy[(k + 1) % 4] - p[1]
        above, after = n[0] * ax + n[1] * ay - n[2] * p[2], n[0] * bx + n[1] * by - n[2] * p[2]
        if above <= 0 and after <= 0:
            continue
        if above <= 0 or after <= 0:
            share = above / (above - after)
            mx, my = ax + share * (bx - ax), ay + share * (by - ay)
            if crossings == 0:
                fx, fy = mx, my
            else:
                total += angle_between(fx, fy, -p[2], mx, my, -p[2]) / 2
            crossings += 1
            if above <= 0:
                ax, ay = mx, my
            else:
                bx, by = mx, my
        total += _side(ax, ay, bx, by, -p[2], n)
    return max(total, 0.0)


@compiled
def _side(ax: float, ay: float, bx: float, by: float, z: float, n: Place) -> float:
    x, y, up = z * (ay - by), z * (bx - ax), ax * by - ay * bx
    length = math.sqrt(x * x + y * y + up * up)
    if length == 0:
        return 0.0
    return -(n[0] * x + n[1] * y + n[2] * up) / length * angle_between(ax, ay, z, bx, by, z) / 2


@compiled
def annulus_irradiance(inner: float, outer: float, p: Place, n: Place) -> float:
    """As `rectangle_irradiance`, by a disc in the plane z = 0 with a hole where `inner` is above 0."""
    if p[2] <= 0:
        return 0.0
    whole = _disc(outer, p, n)
    return max(whole - _disc(inner, p, n), 0.0) if inner > 0 else max(whole, 0.0)


@compiled
def _disc(radius: float, p: Place, n: Place) -> float:
    circle = circle_before(0.0, 0.0, 0.0, radius, (0.0, 0.0, 1.0), p)
    horizon = _above(p, n)
    total = circle_within(circle, horizon, _EVERYWHERE, _EVERYWHERE, p, n)
    some, every, begin, end = span_within(circle, horizon)
    if some and not every:
        _, _, _, _, ux, uy, _, vx, vy, _, _, _, _ = circle
        ax, ay = radius * (ux * begin[1] + vx * begin[2]), radius * (uy * begin[1] + vy * begin[2])
        bx, by = radius * (ux * end[1] + vx * end[2]), radius * (uy * end[1] + vy * end[2])
        total += angle_between(ax - p[0], ay - p[1], -p[2], bx - p[0], by - p[1], -p[2]) / 2
    return total


@compiled
def zone_irradiance(radius: float, low: float, high: float, p: Place, n: Place) -> float:
    """As `rectangle_irradiance`, by the inner side of a sphere about the origin between two heights z."""
    square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    upper = (0.0, 0.0, 1.0, high if high < radius else math.inf)
    lower = (0.0, 0.0, -1.0, -low if low > -radius else math.inf)
    faced = _EVERYWHERE
    if square > radius * radius:
        away = math.sqrt(square)
        faced = (p[0] / away, p[1] / away, p[2] / away, radius * radius / away)
    horizon = _above(p, n)
    # Of two planes that coincide, as a dome's opening and a sheet in it, one counts.
    for half in (horizon, faced):
        for k in range(2):
            likeness = _likeness(half, (upper, lower)[k], radius)
            if likeness < 0:
                return 0.0
            if likeness > 0:
                upper, lower = (_EVERYWHERE, lower) if k == 0 else (upper, _EVERYWHERE)
    total = _rim(radius, upper, lower, faced, horizon, p, n) + _rim(radius, lower, upper, faced, horizon, p, n)
    total += _rim(radius, faced, upper, lower, horizon, p, n) + _rim(radius, horizon, upper, lower, faced, p, n)
    return max(total, 0.0)


@compiled
def _likeness(a: Half, b: Half, radius: float) -> int:
    """1 where two half spaces are the same, -1 where they only share their plane, else 0."""
    if a[3] == math.inf or b[3] == math.inf:
        return 0
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    sign = 1 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0 else -1
    if x * x + y * y + z * z > _SAME * _SAME or abs(a[3] - sign * b[3]) > _SAME * radius:
        return 0
    return sign


@compiled
def _above(p: Place, n: Place) -> Half:
    return -n[0], -n[1], -n[2], -(n[0] * p[0] + n[1] * p[1] + n[2] * p[2])


@compiled
def _rim(radius: float, of: Half, a: Half, b: Half, c: Half, p: Place, n: Place) -> float:
    """What the circle is worth in which a half space cuts a sphere, as far as it lies in three others."""
    x, y, z, height = of
    if abs(height) >= radius:
        return 0.0
    across = math.sqrt((radius - height) * (radius + height))
    return circle_within(circle_before(x * height, y * height, z * height, across, (x, y, z), p), a, b, c, p, n)
