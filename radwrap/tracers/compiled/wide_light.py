"""What a diffuse surface gets of a wide light: all of it in closed form, less what some points of it find hidden.

The estimate is unbiased over keys, and has no noise where nothing hides the light.
"""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arithmetic import cosine_and_sine_of_turn
from radwrap.tracers.compiled.arrays import WIDE_ANNULUS, WIDE_RECTANGLE, Floats, Nodes, Shapes, Whole, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import hidden
from radwrap.tracers.compiled.shadows import clear
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_lambert import annulus_irradiance, rectangle_irradiance, zone_irradiance
from radwrap.tracers.compiled.wide_points import spread_point

# Points of a light that are asked for whether they are hidden: a power of two.
POINTS: Final = 16
# A light does not hide itself: a point of it ends so much before.
_BEFORE: Final = 1 - 1e-7


@compiled
def unhidden(light: Wide, p: Place, n: Place) -> float:
    """Irradiance of a point with a normal, if nothing is between [W m^-2]."""
    q, m = _within(light, p[0] - light.x, p[1] - light.y, p[2] - light.z), _within(light, n[0], n[1], n[2])
    if light.kind == WIDE_RECTANGLE:
        return light.radiance * rectangle_irradiance(light.a, light.b, q, m)
    if light.kind == WIDE_ANNULUS:
        return light.radiance * annulus_irradiance(light.a, light.b, q, m)
    return light.radiance * zone_irradiance(light.a, light.b, light.c, q, m)


@compiled
def _within(light: Wide, x: float, y: float, z: float) -> Place:
    return (
        x * light.ux + y * light.uy + z * light.uz,
        x * light.vx + y * light.vy + z * light.vz,
        x * light.nx + y * light.ny + z * light.nz,
    )


@compiled
def kept_back(
    light: Wide,
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    p: Place,
    n: Place,
    itself: int,
    key: int,
    stack: Whole,
) -> float:
    """Estimate of the irradiance that shapes keep back from a point [W m^-2].

    Parameters
    ----------
    light : Wide
        The light.
    shapes, nodes, tables
        What may stand between.
    p, n : tuple of float
        The point and its unit normal.
    itself : int
        Shape that does not count, or -1.
    key : int
        Which points of the light are asked; see `wide_points.key_of_ray`.
    stack : ndarray of int, shape (DEPTH,)
        Room to work in.
    """
    if clear(shapes, nodes, light, p[0], p[1], p[2], itself, stack):
        return 0.0
    total = 0.0
    for i in range(POINTS):
        u, v = spread_point(i, key)
        x, y, z, nx, ny, nz = point_on(light, u, v)
        dx, dy, dz = x - p[0], y - p[1], z - p[2]
        square = dx * dx + dy * dy + dz * dz
        arriving, leaving = dx * n[0] + dy * n[1] + dz * n[2], -(dx * nx + dy * ny + dz * nz)
        if arriving <= 0 or leaving <= 0:
            continue
        away = math.sqrt(square)
        if hidden(
            shapes, nodes, tables, p[0], p[1], p[2], dx / away, dy / away, dz / away, away * _BEFORE, itself, stack
        ):
            total += arriving * leaving / (square * square)
    return light.radiance * light.area * total / POINTS


@compiled
def point_on(light: Wide, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    """A point of the light and its unit normal there: evenly spread over its area for even (u, v) from 0 to 1."""
    x, y, z, mx, my, mz = (u - 0.5) * light.a, (v - 0.5) * light.b, 0.0, 0.0, 0.0, 1.0
    if light.kind != WIDE_RECTANGLE:
        cosine, sine = cosine_and_sine_of_turn(v)
        if light.kind == WIDE_ANNULUS:
            across = math.sqrt(light.a * light.a + u * (light.b - light.a) * (light.b + light.a))
        else:
            z = light.b + u * (light.c - light.b)
            across = math.sqrt(max((light.a - z) * (light.a + z), 0.0))
            mx, my, mz = -across * cosine / light.a, -across * sine / light.a, -z / light.a
        x, y = across * cosine, across * sine
    return (
        light.x + x * light.ux + y * light.vx + z * light.nx,
        light.y + x * light.uy + y * light.vy + z * light.ny,
        light.z + x * light.uz + y * light.vz + z * light.nz,
        mx * light.ux + my * light.vx + mz * light.nx,
        mx * light.uy + my * light.vy + mz * light.ny,
        mx * light.uz + my * light.vz + mz * light.nz,
    )
