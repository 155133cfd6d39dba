"""Shapes of wide lights: their even points, where rays meet them, and what an open place gets of them."""

from __future__ import annotations

import math

from radwrap.tracers.compiled.arithmetic import cosine_and_sine_of_turn
from radwrap.tracers.compiled.arrays import LAMBERTIAN, WIDE_ANNULUS, WIDE_RECTANGLE, WIDE_ZONE, Cluster, Floats, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.wide_beam import beam_irradiance
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_lambert import annulus_irradiance, rectangle_irradiance, zone_irradiance


@compiled
def ball_around(box: Cluster | Wide, p: Place) -> tuple[Place, float]:
    """Middle of a ball around a box, from a point, and its radius."""
    middle = (box.x0 + box.x1) / 2 - p[0], (box.y0 + box.y1) / 2 - p[1], (box.z0 + box.z1) / 2 - p[2]
    return middle, math.sqrt((box.x1 - box.x0) ** 2 + (box.y1 - box.y0) ** 2 + (box.z1 - box.z0) ** 2) / 2


@compiled
def may_light(light: Wide, p: Place, n: Place) -> bool:
    """Whether any of a light's box lies above the horizon of a point with a normal."""
    x = max((light.x0 - p[0]) * n[0], (light.x1 - p[0]) * n[0])
    y = max((light.y0 - p[1]) * n[1], (light.y1 - p[1]) * n[1])
    z = max((light.z0 - p[2]) * n[2], (light.z1 - p[2]) * n[2])
    return x + y + z > 0


@compiled
def unhidden(light: Wide, tables: Floats, p: Place, n: Place, room: Floats) -> float:
    """Irradiance of a point with a normal, if nothing is between [W m^-2]; there is `room` for `wide_beam.CUTS`."""
    q, m = _within(light, p[0] - light.x, p[1] - light.y, p[2] - light.z), _within(light, n[0], n[1], n[2])
    if light.beam != LAMBERTIAN:
        return light.radiance * beam_irradiance(light, tables, q, m, room)
    if light.kind == WIDE_RECTANGLE:
        return light.radiance * rectangle_irradiance(light.a, light.b, q, m)
    if light.kind == WIDE_ANNULUS:
        return light.radiance * annulus_irradiance(light.a, light.b, q, m)
    return light.radiance * zone_irradiance(light.a, light.b, light.c, q, m)


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


@compiled
def meets(light: Wide, p: Place, d: Place) -> tuple[float, float]:
    """How far along a ray the light's shining side is, and its cosine there; infinite and 0 where it is missed."""
    q, e = _within(light, p[0] - light.x, p[1] - light.y, p[2] - light.z), _within(light, d[0], d[1], d[2])
    if light.kind == WIDE_ZONE:
        along, half = _chord(light.a, q, e)
        far = along + half
        if half <= 0 or far <= 0:
            return math.inf, 0.0
        if not light.b <= q[2] + far * e[2] <= light.c:
            return math.inf, 0.0
        return far, half / light.a
    if q[2] <= 0 or e[2] >= 0:
        return math.inf, 0.0
    far = -q[2] / e[2]
    x, y = q[0] + far * e[0], q[1] + far * e[1]
    square = x * x + y * y
    if light.kind == WIDE_RECTANGLE:
        inside = abs(x) <= light.a / 2 and abs(y) <= light.b / 2
    else:
        inside = light.a * light.a <= square <= light.b * light.b
    return (far, -e[2]) if inside else (math.inf, 0.0)


@compiled
def hides_itself(light: Wide, p: Place, d: Place) -> bool:
    """Whether a ray meets the outer side of a zone first."""
    if is_inside(light, p):
        return False
    q, e = _within(light, p[0] - light.x, p[1] - light.y, p[2] - light.z), _within(light, d[0], d[1], d[2])
    along, half = _chord(light.a, q, e)
    if half < 0 or along - half <= 0:
        return False
    return light.b <= q[2] + (along - half) * e[2] <= light.c


@compiled
def may_be_outside(light: Wide, box: Cluster) -> bool:
    """Whether any place of a box may lie outside of a zone's sphere."""
    x = max(abs(box.x0 - light.x), abs(box.x1 - light.x))
    y = max(abs(box.y0 - light.y), abs(box.y1 - light.y))
    z = max(abs(box.z0 - light.z), abs(box.z1 - light.z))
    return x * x + y * y + z * z > light.a * light.a


@compiled
def is_inside(light: Wide, p: Place) -> bool:
    """Whether a point lies within a zone's sphere."""
    x, y, z = p[0] - light.x, p[1] - light.y, p[2] - light.z
    return x * x + y * y + z * z <= light.a * light.a


@compiled
def _chord(radius: float, q: Place, e: Place) -> tuple[float, float]:
    """Way along a ray to the foot of a sphere's middle, and half of its way within the sphere; -1 where it misses."""
    along = -(q[0] * e[0] + q[1] * e[1] + q[2] * e[2])
    x, y, z = q[0] + along * e[0], q[1] + along * e[1], q[2] + along * e[2]
    square = radius * radius - (x * x + y * y + z * z)
    return along, math.sqrt(square) if square >= 0 else -1.0


@compiled
def _within(light: Wide, x: float, y: float, z: float) -> Place:
    return (
        x * light.ux + y * light.uy + z * light.uz,
        x * light.vx + y * light.vy + z * light.vz,
        x * light.nx + y * light.ny + z * light.nz,
    )
