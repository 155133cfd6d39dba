"""What an emitter sends along a ray."""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arithmetic import angle_of, azimuth, exponential, log_cosine, squared_angle_of
from radwrap.tracers.compiled.arrays import (
    CONE,
    COSINE_POWER,
    GAUSSIAN,
    LAMBERTIAN,
    LUMINAIRE,
    TABLE_BEAM,
    Floats,
    Light,
    Wide,
)
from radwrap.tracers.compiled.compiler import compiled

# As Radiance, which leaves out light that grazes a source.
LEAST_COSINE: Final = 1e-4


@compiled
def radiance_along(light: Light, tables: Floats, dx: float, dy: float, dz: float) -> float:
    """Radiance that leaves an emitter in a direction, of its front [W m^-2 sr^-1]."""
    beam = light.beam
    if beam == LUMINAIRE:
        return light.radiance * _share(light, tables, dx, dy, dz)
    cosine = dx * light.nx + dy * light.ny + dz * light.nz
    if beam == LAMBERTIAN:
        return light.radiance
    half_sine2 = ((dx - light.nx) ** 2 + (dy - light.ny) ** 2 + (dz - light.nz) ** 2) / 4
    return light.radiance * share_of(light, tables, half_sine2) / cosine


@compiled
def share_of(light: Light | Wide, tables: Floats, half_sine2: float) -> float:
    """I(theta)/I(0) of a beam about an axis, from sin^2 of half the angle theta; not of a luminaire."""
    beam, spread = light.beam, light.spread
    if beam == GAUSSIAN:
        return exponential(-squared_angle_of(half_sine2) * (0.5 / (spread * spread)))
    if beam == LAMBERTIAN:
        return max(1 - 2 * half_sine2, 0.0)
    if beam == COSINE_POWER:
        return exponential(log_cosine(half_sine2) / (spread * spread))
    if beam == CONE:
        return 1.0 if angle_of(half_sine2) < spread else 0.0
    first, count = light.table, light.columns
    place = angle_of(half_sine2) / (spread * math.pi / 2) * (count - 1)
    if not place <= count - 1:
        return 0.0
    low = min(int(place), count - 1)
    above = min(low + 1, count - 1)
    return tables[first + low] * (1 - (place - low)) + tables[first + above] * (place - low)


@compiled
def changes_slowly(light: Light, tables: Floats, middle: Floats, reach: float, small: float) -> bool:
    """Whether a light's beam ends nowhere within reach of a place, which it sees under a small share of its width.

    Parameters
    ----------
    light, tables
        As of `radiance_along`.
    middle : ndarray, shape (3,)
        The place.
    reach : float
        Distance from it.
    small : float
        That share. A beam is as wide as it is by its law, but no wider than a radian.
    """
    dx, dy, dz = middle[0] - light.x, middle[1] - light.y, middle[2] - light.z
    away = math.sqrt(dx * dx + dy * dy + dz * dz)
    width = 1.0
    if light.beam != LUMINAIRE:
        before = dx * light.nx + dy * light.ny + dz * light.nz
        if before < -reach:
            return True
        if before <= reach:
            return False
        if light.beam in (GAUSSIAN, COSINE_POWER):
            width = min(width, light.spread)
        elif light.beam == TABLE_BEAM and tables[light.table + light.columns - 1] > 0:
            half_sine2 = (1 - before / away) / 2
            if abs(angle_of(half_sine2) - light.spread * math.pi / 2) * away <= 2 * reach:
                return False
    return reach <= small * width * away


@compiled
def _share(light: Light, tables: Floats, dx: float, dy: float, dz: float) -> float:
    """Share of a luminaire's peak in a direction: straight between the table's steps."""
    x = dx * light.ux + dy * light.uy + dz * light.uz
    y = dx * light.vx + dy * light.vy + dz * light.vz
    z = dx * light.nx + dy * light.ny + dz * light.nz
    first, rows, columns = light.table, light.rows, light.columns
    height = min(azimuth(math.sqrt(x * x + y * y), z) / math.pi, 1.0) * (columns - 1)
    low = min(int(height), columns - 2)
    up = height - low
    turn = azimuth(-y, x) / (2 * math.pi) * (rows - 1)
    row = min(int(turn), max(rows - 2, 0))
    on, after = turn - row, min(row + 1, rows - 1)
    one, two = first + row * columns + low, first + after * columns + low
    return (1 - on) * ((1 - up) * tables[one] + up * tables[one + 1]) + on * (
        (1 - up) * tables[two] + up * tables[two + 1]
    )
