"""What a glossy surface sends to the eye of a wide light, with points of the light and directions of the lobe.

A lobe is that of a Gaussian, about the mirror direction or that to the eye, or stands in a table: then directions are
drawn at angles to the eye, or of a measured BRDF to the mirror direction, that are even in their logarithm.

Each kind of samples sees well what the other does not: a small light before a broad lobe, and a narrow lobe before a
large light. Every sample counts by the density that both kinds together have there (Veach's balance heuristic, key
veach1995). The mean is right, and there is noise.
"""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arithmetic import cosine_and_sine_of_turn, exponential, logarithm
from radwrap.tracers.compiled.arrays import (
    BRDF,
    BRUSHED,
    TURNED_NORMAL,
    WARD,
    Cover,
    Floats,
    Nodes,
    Shapes,
    Whole,
    Wide,
)
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import LEAST_COSINE, reflected
from radwrap.tracers.compiled.wide_cells import cell_of
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_light import halved, shining
from radwrap.tracers.compiled.wide_points import mixed, spread_point
from radwrap.tracers.compiled.wide_shadow import is_hidden
from radwrap.tracers.compiled.wide_shape import meets, point_on

# Samples of each of the two kinds: a power of two.
SAMPLES: Final = 16
_OF_LIGHT: Final = 5
_OF_LOBE: Final = 6

# Unit vectors along the grain and across it, and the squares of the roughness along them.
Grain = tuple[Place, Place, float, float]


@compiled
def sampled_lobe(
    light: Wide,
    cover: Cover,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    p: Place,
    n: Place,
    v: Place,
    itself: int,
    bits: int,
    halvings: int,
    key: int,
    stack: Whole,
) -> float:
    """Radiance that a lobe sends to the eye [W m^-2 sr^-1], an unbiased estimate.

    Parameters
    ----------
    light, shapes, nodes, discs, disc_nodes, tables, p, n, v, itself, key, stack
        As `wide_light.left_over`.
    cover : Cover
        With a lobe.
    bits : int
        Cells of the light that may be hidden, see `wide_cells`.
    halvings : int
        See `CompiledScene`.
    """
    axis, total = axis_of(cover, n, v), 0.0
    grain = grain_of(cover, axis)
    first, second = mixed(key, _OF_LIGHT), mixed(key, _OF_LOBE)
    samples = halved(SAMPLES, halvings)
    for i in range(2 * samples):
        may_be_hidden = bits != 0
        if i < samples:
            a, b = spread_point(i, first)
            d, away, leaving = _towards(light, p, a, b)
            may_be_hidden = bits >> cell_of(a, b) & 1 == 1
        else:
            a, b = spread_point(i - samples, second)
            d = drawn(cover, grain, axis, v, a, b)
            away, leaving = meets(light, p, d)
        value = _weighed(light, cover, tables, grain, axis, n, v, d, away, leaving)
        if value > 0 and not (
            may_be_hidden and is_hidden(light, shapes, nodes, discs, disc_nodes, tables, p, d, away, itself, stack)
        ):
            total += value
    return light.radiance * total / samples


@compiled
def _towards(light: Wide, p: Place, a: float, b: float) -> tuple[Place, float, float]:
    """Direction of an even point of a light, its distance, and the cosine at which it shines."""
    x, y, z, nx, ny, nz = point_on(light, a, b)
    dx, dy, dz = x - p[0], y - p[1], z - p[2]
    away = math.sqrt(dx * dx + dy * dy + dz * dz)
    d = (dx / away, dy / away, dz / away)
    return d, away, -(d[0] * nx + d[1] * ny + d[2] * nz)


@compiled
def _weighed(
    light: Wide,
    cover: Cover,
    tables: Floats,
    grain: Grain,
    axis: Place,
    n: Place,
    v: Place,
    d: Place,
    away: float,
    leaving: float,
) -> float:
    """What light from a direction counts: what is reflected over the densities of both kinds of samples."""
    if not leaving > 0:
        return 0.0
    value = reflected(cover, tables, 0.0, n[0], n[1], n[2], v[0], v[1], v[2], d[0], d[1], d[2], 0.0)
    value *= shining(light, tables, d, leaving) / leaving
    if not value > 0:
        return 0.0
    return value / (away * away / (light.area * leaving) + density(cover, grain, axis, v, d))


@compiled
def axis_of(cover: Cover, n: Place, v: Place) -> Place:
    """The normal of a Gaussian lobe, which a retroreflector turns to the eye; of a table the middle of its lobe."""
    if cover.kind in (WARD, BRUSHED):
        return n
    if cover.kind != BRDF:
        return v
    twice = 2 * (n[0] * v[0] + n[1] * v[1] + n[2] * v[2])
    return twice * n[0] - v[0], twice * n[1] - v[1], twice * n[2] - v[2]


@compiled
def drawn(cover: Cover, grain: Grain, axis: Place, v: Place, a: float, b: float) -> Place:
    """A direction of a lobe, for an even point of the unit square."""
    if cover.kind in (WARD, BRUSHED, TURNED_NORMAL):
        return mirrored(grain, axis, v, a, b)
    along, aside, _, _ = grain
    least = cover.fine * cover.fine / 2
    # 1 - cos of the angle: even in the logarithm of that and what is least of it.
    fall = min(least * (exponential(a * logarithm(1 + 2 / least)) - 1), 2.0)
    across = math.sqrt(fall * (2 - fall))
    cosine, sine = cosine_and_sine_of_turn(b)
    x, y, z = across * cosine, across * sine, 1 - fall
    return (
        x * along[0] + y * aside[0] + z * axis[0],
        x * along[1] + y * aside[1] + z * axis[1],
        x * along[2] + y * aside[2] + z * axis[2],
    )


@compiled
def density(cover: Cover, grain: Grain, axis: Place, v: Place, d: Place) -> float:
    """Density of `drawn` over directions [sr^-1]."""
    if cover.kind in (WARD, BRUSHED, TURNED_NORMAL):
        return lobe_density(grain, axis, v, d)
    least = cover.fine * cover.fine / 2
    fall = ((d[0] - axis[0]) ** 2 + (d[1] - axis[1]) ** 2 + (d[2] - axis[2]) ** 2) / 2
    return 1 / (2 * math.pi * (fall + least) * logarithm(1 + 2 / least))


@compiled
def grain_of(cover: Cover, n: Place) -> Grain:
    """The directions of a lobe's two roughnesses; of a lobe without grain any two across."""
    gx, gy, gz, across = cover.gx, cover.gy, cover.gz, cover.b
    if cover.kind != BRUSHED:
        gx, gy, gz, across = (1.0, 0.0, 0.0, cover.a) if abs(n[0]) < 0.6 else (0.0, 1.0, 0.0, cover.a)
    sx, sy, sz = n[1] * gz - n[2] * gy, n[2] * gx - n[0] * gz, n[0] * gy - n[1] * gx
    length = math.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / length, sy / length, sz / length
    along = (sy * n[2] - sz * n[1], sz * n[0] - sx * n[2], sx * n[1] - sy * n[0])
    return along, (sx, sy, sz), cover.a, across


@compiled
def mirrored(grain: Grain, n: Place, v: Place, a: float, b: float) -> Place:
    """Direction from which a mirror sends light to the eye, whose normal spreads as the lobe's does."""
    along, aside, x2, y2 = grain
    cosine, sine = cosine_and_sine_of_turn(b)
    steep = math.sqrt(-logarithm(a))
    x, y = steep * cosine * math.sqrt(x2), steep * sine * math.sqrt(y2)
    hx = n[0] + x * along[0] + y * aside[0]
    hy = n[1] + x * along[1] + y * aside[1]
    hz = n[2] + x * along[2] + y * aside[2]
    twice = 2 * (hx * v[0] + hy * v[1] + hz * v[2]) / (hx * hx + hy * hy + hz * hz)
    dx, dy, dz = twice * hx - v[0], twice * hy - v[1], twice * hz - v[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)  # 1 but for rounding
    return dx / length, dy / length, dz / length


@compiled
def lobe_density(grain: Grain, n: Place, v: Place, d: Place) -> float:
    """Density of `mirrored` over directions [sr^-1], 0 where light and eye have no normal between them."""
    along, aside, x2, y2 = grain
    hx, hy, hz = d[0] + v[0], d[1] + v[1], d[2] + v[2]
    up = hx * n[0] + hy * n[1] + hz * n[2]
    if not up > LEAST_COSINE:
        return 0.0
    x = (hx * along[0] + hy * along[1] + hz * along[2]) / up
    y = (hx * aside[0] + hy * aside[1] + hz * aside[2]) / up
    square = hx * hx + hy * hy + hz * hz
    length = math.sqrt(square)
    towards = hx * v[0] + hy * v[1] + hz * v[2]
    # Over normals exp(...)/(pi x y cos^3), and over directions that over 4 cos of the eye to the normal.
    over_normals = (
        exponential(-(x * x / x2 + y * y / y2)) * square * length / (math.pi * math.sqrt(x2 * y2) * up * up * up)
    )
    return over_normals * length / (4 * towards)
