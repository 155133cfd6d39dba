"""How covers reflect: radiance towards the eye for each unit of irradiance at right angles to the light.

The formulas are those of `scene.look.reflection`, which stand there for whole
arrays, and the cuts and the widening of lobes those of Radiance.
"""

from __future__ import annotations

import math
from typing import Final

from radwrap.scene.patterns.partition import MARK
from radwrap.tracers.compiled.arithmetic import angle_between, angle_of, exponential
from radwrap.tracers.compiled.arrays import (
    BEADS,
    BRUSHED,
    COEFFICIENTS,
    DOTS,
    NODE,
    NOTHING,
    PATTERN,
    TURNED_NORMAL,
    WARD,
    Cover,
    Decals,
    Floats,
)
from radwrap.tracers.compiled.compiler import compiled

# Radiance's FTINY: light at a smaller cosine lights nothing.
LEAST_COSINE: Final = 1e-6
# And a smaller lobe [sr^-1] it leaves out.
_LEAST_LOBE: Final = 1e-6
# In place of smaller cosines in a table's projection.
_LEAST_PROJECTION: Final = 1e-9
_LEAST_SINES: Final = 1e-12  # of the squares, where an azimuth means nothing


@compiled
def painted(decals: Decals, tables: Floats, cover: int, decal: int, x: float, y: float, z: float) -> int:
    """The cover that a flat target shows at a place: its own, or that of its dots, of beyond its edge, or its marks."""
    if decal < 0:
        return cover
    d = decals[decal]
    px, py, pz = x - d.x, y - d.y, z - d.z
    across, up = px * d.ux + py * d.uy + pz * d.uz, px * d.vx + py * d.vy + pz * d.vz
    if d.kind == DOTS:
        u, v = from_dot(across, d.a), from_dot(up, d.b)
        shown = d.c - u * u - v * v > 0
    elif d.kind == PATTERN:
        shown = is_marked(tables, int(d.a), across, up)
    else:
        shown = across - d.a > 0
    return d.cover if shown else cover


@compiled
def is_marked(tables: Floats, first: int, x: float, y: float) -> bool:
    """Whether a pattern has a mark at a place of its plate [m], see `scene.patterns.partition`."""
    number = 0
    while number >= 0:
        node = first + number * NODE
        a, b, c = tables[node], tables[node + 1], tables[node + 2]
        side = c - (x - a) * (x - a) - (y - b) * (y - b) if tables[node + 3] > 0 else a * x + b * y - c
        number = int(tables[node + 4] if side > 0 else tables[node + 5])
    return number == MARK


@compiled
def rim_beyond(tables: Floats, first: int, x: float, y: float, reach: float) -> bool:
    """Whether no line or circle that a pattern asks about at a place comes within reach of it [m]."""
    number = 0
    while number >= 0:
        node = first + number * NODE
        a, b, c = tables[node], tables[node + 1], tables[node + 2]
        if tables[node + 3] > 0:
            side = math.sqrt(c) - math.sqrt((x - a) * (x - a) + (y - b) * (y - b))
        else:
            side = a * x + b * y - c
        if abs(side) <= reach:
            return False
        number = int(tables[node + 4] if side > 0 else tables[node + 5])
    return True


@compiled
def from_dot(place: float, count: float) -> float:
    """Distance to the nearest of a row of dots, in their pitch."""
    x = place + (count - 1) / 2
    return x - min(max(math.floor(x + 0.5), 0.0), count - 1)


@compiled
def diffuse_at(cover: Cover, tables: Floats, x: float, y: float, z: float) -> float:
    """Diffuse reflectance over pi, where a print may lie."""
    columns, rows = cover.columns, cover.rows
    if columns == 0:
        return cover.diffuse
    px, py, pz = x - cover.x, y - cover.y, z - cover.z
    across = px * cover.ux + py * cover.uy + pz * cover.uz
    up = px * cover.vx + py * cover.vy + pz * cover.vz
    column = max(0.0, min(columns - 1.0, (0.5 + across) * columns - 0.5))
    row = max(0.0, min(rows - 1.0, (0.5 - up) * rows - 0.5))
    left, top = min(int(column), max(columns - 2, 0)), min(int(row), max(rows - 2, 0))
    on, down = column - left, row - top
    right, below = min(left + 1, columns - 1), min(top + 1, rows - 1)
    upper, lower = cover.image + top * columns, cover.image + below * columns
    high = (1 - on) * tables[upper + left] + on * tables[upper + right]
    low = (1 - on) * tables[lower + left] + on * tables[lower + right]
    return cover.diffuse * ((1 - down) * high + down * low)


@compiled
def reflected(
    cover: Cover,
    tables: Floats,
    diffuse: float,
    nx: float,
    ny: float,
    nz: float,
    vx: float,
    vy: float,
    vz: float,
    lx: float,
    ly: float,
    lz: float,
    widening: float,
) -> float:
    """L/E_perp [sr^-1] of a lit point.

    Parameters
    ----------
    cover : Cover
        What is lit.
    tables : ndarray
        All tables.
    diffuse : float
        Its `diffuse_at` the point.
    nx, ny, nz, vx, vy, vz, lx, ly, lz : float
        Unit vectors: the normal on the eye's side, to the eye, to the light.
    widening : float
        On a flat face, the light's solid angle over 4 pi, by which Radiance widens Gaussian lobes; else 0.
    """
    kind = cover.kind
    light = nx * lx + ny * ly + nz * lz
    total = diffuse * light if light > LEAST_COSINE else 0.0
    if kind == NOTHING:
        return total
    if kind == TURNED_NORMAL:
        # Its normal is the eye's direction, whatever the surface's: no horizon.
        half_sine2 = ((lx - vx) ** 2 + (ly - vy) ** 2 + (lz - vz) ** 2) / 4
        cosine2 = 1 - half_sine2
        if 1 - 2 * half_sine2 <= LEAST_COSINE:
            return total
        lobe = exponential(-half_sine2 / cosine2 / cover.a) / (4 * math.pi * cover.a * cosine2 * cosine2 * cosine2)
        return total + cover.weight * lobe * (1 - 2 * half_sine2) if lobe > _LEAST_LOBE else total
    if light <= LEAST_COSINE:
        return total
    if kind in (WARD, BRUSHED):
        return total + glossy(cover, nx, ny, nz, vx, vy, vz, lx, ly, lz, widening)
    eye = nx * vx + ny * vy + nz * vz
    if kind in (COEFFICIENTS, BEADS):
        projection = max(light, _LEAST_PROJECTION) * max(eye, _LEAST_PROJECTION)
        alpha, beta = angle_between(lx, ly, lz, vx, vy, vz), angle_between(lx, ly, lz, nx, ny, nz)
        return total + cover.weight * light * _coefficient(cover, tables, alpha, beta) / projection
    incidence, viewing = angle_between(lx, ly, lz, nx, ny, nz), angle_between(vx, vy, vz, nx, ny, nz)
    turn = turn_between(light, eye, lx * vx + ly * vy + lz * vz)
    return total + cover.weight * light * _measured(cover, tables, incidence, viewing, turn)


@compiled
def turn_between(light: float, eye: float, both: float) -> float:
    """Azimuth [rad] of the light from the eye about the normal, by their cosines to it and to each other."""
    sines = math.sqrt(max(_LEAST_SINES, (1 - light * light) * (1 - eye * eye)))
    cosine = min(1.0, max(-1.0, (both - light * eye) / sines))
    return angle_of((1 - cosine) / 2)


@compiled
def glossy(
    cover: Cover,
    nx: float,
    ny: float,
    nz: float,
    vx: float,
    vy: float,
    vz: float,
    lx: float,
    ly: float,
    lz: float,
    widening: float,
) -> float:
    """What a Gaussian lobe adds to `reflected`."""
    light = nx * lx + ny * ly + nz * lz
    if light <= LEAST_COSINE:
        return 0.0
    lobe = _lobe(cover, nx, ny, nz, lx + vx, ly + vy, lz + vz, widening)
    return cover.weight * light * lobe if lobe > _LEAST_LOBE else 0.0


@compiled
def _lobe(cover: Cover, nx: float, ny: float, nz: float, hx: float, hy: float, hz: float, widening: float) -> float:
    """A Gaussian lobe about the mirror direction, of the vector half way between light and eye (key geisler2010)."""
    along = nx * hx + ny * hy + nz * hz
    square, along2 = hx * hx + hy * hy + hz * hz, along * along
    if cover.kind == WARD:
        a2 = cover.a + widening
        return exponential(-(square - along2) / along2 / a2) * square / (math.pi * along2 * along2 * a2)
    # The grain's direction in the face, and the one across it: as Radiance, side = n x grain first.
    sx = ny * cover.gz - nz * cover.gy
    sy = nz * cover.gx - nx * cover.gz
    sz = nx * cover.gy - ny * cover.gx
    length2 = sx * sx + sy * sy + sz * sz
    across = (hx * sx + hy * sy + hz * sz) ** 2 / length2
    gx, gy, gz = sy * nz - sz * ny, sz * nx - sx * nz, sx * ny - sy * nx
    grain = (hx * gx + hy * gy + hz * gz) ** 2 / length2
    x2, y2 = cover.a + widening, cover.b + widening
    return exponential(-(grain / x2 + across / y2) / along2) * square / (math.pi * along2 * along2 * math.sqrt(x2 * y2))


@compiled
def _place(nodes: Floats, first: int, count: int, value: float) -> tuple[int, float]:
    """The interval of increasing nodes that holds a value, and where in it from 0 to 1; held at the ends."""
    if count < 2 or value <= nodes[first]:
        return 0, 0.0
    if value >= nodes[first + count - 1]:
        return count - 2, 1.0
    low, high = 0, count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[first + middle] <= value:
            low = middle
        else:
            high = middle
    return low, (value - nodes[first + low]) / (nodes[first + high] - nodes[first + low])


@compiled
def _coefficient(cover: Cover, tables: Floats, alpha: float, beta: float) -> float:
    """R_A [sr^-1] at observation angle alpha and entrance angle beta [rad]; held at the ends of the data."""
    first = cover.table
    count = int(cover.a)
    i, up = _place(tables, first, count, alpha)
    if cover.kind == BEADS:
        profile = tables[first + count + i] * (1 - up) + tables[first + count + i + 1] * up
        return cover.b * exponential(profile - beta * beta / cover.c)
    entrances = int(cover.b)
    j, on = _place(tables, first + count, entrances, beta)
    values = first + count + entrances
    low, high = values + i * entrances + j, values + min(i + 1, count - 1) * entrances + j
    step = 1 if entrances > 1 else 0
    value = (1 - up) * ((1 - on) * tables[low] + on * tables[low + step]) + up * (
        (1 - on) * tables[high] + on * tables[high + step]
    )
    return exponential(value) if cover.c else value


@compiled
def _measured(cover: Cover, tables: Floats, incidence: float, viewing: float, turn: float) -> float:
    """F of a measured BRDF [sr^-1], straight between its nodes and held beyond them."""
    first = cover.table
    a, b, c = int(cover.a), int(cover.b), int(cover.c)
    i, u = _place(tables, first, a, incidence)
    j, v = _place(tables, first + a, b, viewing)
    k, w = _place(tables, first + a + b, c, turn)
    values = first + a + b + c
    total = 0.0
    for corner in range(8):
        di, dj, dk = corner & 1, corner >> 1 & 1, corner >> 2
        weight = (u if di else 1 - u) * (v if dj else 1 - v) * (w if dk else 1 - w)
        if weight > 0:  # a table of one node has no next one
            total += weight * tables[values + ((i + di) * b + j + dj) * c + k + dk]
    return total
