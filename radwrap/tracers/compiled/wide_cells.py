"""Which cells of a wide light something may hide: asked once for all points of a small place, as neighbours ask again.

Over its shape's even coordinates (u, v) a light has 8 x 8 cells, and a bit for each. Places are cells of a grid in the
world, so that a point's answer does not hang on what was asked before.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.compiled.arithmetic import cosine_and_sine_of_turn
from radwrap.tracers.compiled.arrays import LAMBERTIAN, WIDE_ZONE, Cluster, Clusters, Floats, Nodes, Shapes, Whole, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.shadows import clear_between
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_points import mixed, spread_point
from radwrap.tracers.compiled.wide_shadow import is_hidden
from radwrap.tracers.compiled.wide_shape import ball_around, point_on

# Cells along each coordinate, and all cells: those of 1, 2 x 2, 4 x 4 and 8 x 8 of them.
CELLS: Final = 8
ALL_CELLS: Final = 1 + 4 + 16 + 64
_ALL: Final = -1  # 64 bits
_WIDE_BEAM: Final = 1.2  # rad: such a beam reaches nearly all places before a light
_NONE: Final = -1  # of a place
# Places that are remembered, and the numbers of each: where it is, its shape, the light, the bits, and 1 where some of
# the light is hidden.
_PLACES: Final = 1 << 14
_NUMBERS: Final = 7
_PILOTS: Final = 32
_SOLID: Final = 3  # in place of a flat shape's axis
_WORD: Final = 0xFFFFFFFF


def memory() -> Whole:
    """Room for what was found; no place is known."""
    return np.full((_PLACES, _NUMBERS), _NONE, dtype=np.int64)


@compiled
def hiding_cells(
    light: Wide,
    number: int,
    cells: Clusters,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    pitch: float,
    p: Place,
    itself: int,
    known: Whole,
    chosen: Whole,
    stack: Whole,
) -> tuple[int, bool]:
    """Bits of the cells of a light that may be hidden from any point of a place, and whether from its middle some are.

    Parameters
    ----------
    light, number : Wide, int
        The light, and which it is.
    cells : Clusters
        Boxes of the cells of all lights, `ALL_CELLS` of each.
    shapes, nodes, discs, disc_nodes, tables
        What may stand between: targets and emitters.
    pitch : float
        Size of a place.
    p : tuple of float
        A point of it.
    itself : int
        Flat shape on which it lies and which does not count, or -1.
    known : ndarray of int
        See `memory`.
    chosen, stack : ndarray of int, shape (cells,), (DEPTH,)
        Room to work in.
    """
    i, j, k = math.floor(p[0] / pitch), math.floor(p[1] / pitch), math.floor(p[2] / pitch)
    axis = _SOLID
    if itself >= 0:  # of a flat shape's places only two numbers count: the third is that of its plane
        s = shapes[itself]
        x, y, z = abs(s.nx), abs(s.ny), abs(s.nz)
        if z >= x and z >= y:
            axis, k = 2, 0
        elif y >= x:
            axis, j = 1, 0
        else:
            axis, i = 0, 0
    key = mixed(mixed(mixed(mixed(mixed(1, i & _WORD), j & _WORD), k & _WORD), itself & _WORD), number)
    entry = known[key % _PLACES]
    if entry[0] == i and entry[1] == j and entry[2] == k and entry[3] == itself and entry[4] == number:
        return entry[5], entry[6] == 1
    x0, y0, z0 = i * pitch, j * pitch, k * pitch
    x1, y1, z1 = x0 + pitch, y0 + pitch, z0 + pitch
    if axis == 2:
        z0, z1 = _heights(s.nx, s.ny, s.nz, s.x, s.y, s.z, x0, x1, y0, y1)
    elif axis == 1:
        y0, y1 = _heights(s.nx, s.nz, s.ny, s.x, s.z, s.y, x0, x1, z0, z1)
    elif axis == 0:
        x0, x1 = _heights(s.ny, s.nz, s.nx, s.y, s.z, s.x, y0, y1, z0, z1)
    bits = _found(light, number, cells, shapes, nodes, discs, disc_nodes, x0, y0, z0, x1, y1, z1, itself, stack)
    middle, is_hiding = ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2), axis == _SOLID
    if not is_hiding:
        count = bits_of(bits, chosen)
        is_hiding = _hides(light, shapes, nodes, discs, disc_nodes, tables, middle, itself, chosen, count, key, stack)
    entry[0], entry[1], entry[2], entry[3], entry[4], entry[5], entry[6] = i, j, k, itself, number, bits, is_hiding
    return bits, is_hiding


@compiled
def _hides(
    light: Wide,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    p: Place,
    itself: int,
    chosen: Whole,
    count: int,
    key: int,
    stack: Whole,
) -> bool:
    """Whether any of some points of the light's cells is hidden."""
    if count == 0:
        return False
    for i in range(_PILOTS):
        u, v = spread_point(i, key)
        u, v = within_cells(u, v, chosen, count)
        x, y, z, _, _, _ = point_on(light, u, v)
        dx, dy, dz = x - p[0], y - p[1], z - p[2]
        away = math.sqrt(dx * dx + dy * dy + dz * dz)
        d = (dx / away, dy / away, dz / away)
        if is_hidden(light, shapes, nodes, discs, disc_nodes, tables, p, d, away, itself, stack):
            return True
    return False


@compiled
def _heights(
    a: float, b: float, c: float, u: float, v: float, w: float, u0: float, u1: float, v0: float, v1: float
) -> tuple[float, float]:
    """Least and largest w of the plane with the normal (a, b, c) through (u, v, w), over a rectangle."""
    p, q, r, s = a * (u0 - u) / c, a * (u1 - u) / c, b * (v0 - v) / c, b * (v1 - v) / c
    return w - max(p, q) - max(r, s), w - min(p, q) - min(r, s)


@compiled
def _found(
    light: Wide,
    number: int,
    cells: Clusters,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    itself: int,
    stack: Whole,
) -> int:
    if light.kind == WIDE_ZONE:
        x = max(abs(x0 - light.x), abs(x1 - light.x))
        y = max(abs(y0 - light.y), abs(y1 - light.y))
        z = max(abs(z0 - light.z), abs(z1 - light.z))
        if x * x + y * y + z * z > light.a * light.a:  # seen from outside it hides itself
            return _ALL
    bits, base = 0, number * ALL_CELLS
    # Cells of cells that are clear are clear.
    level, open_cells = 1, 1
    while level <= CELLS and open_cells:
        below, finer = 0, 2 * level
        for cell in range(level * level):
            if not open_cells >> cell & 1:
                continue
            there = cells[base + cell]
            free = clear_between(shapes, nodes, there, x0, y0, z0, x1, y1, z1, itself, True, stack)
            if free and light.may_be_hidden:
                free = clear_between(discs, disc_nodes, there, x0, y0, z0, x1, y1, z1, light.own, True, stack)
            if free:
                continue
            if level == CELLS:
                bits |= 1 << cell
            else:
                row, column = cell // level, cell % level
                corner = 2 * row * finer + 2 * column
                below |= (1 << corner) | (1 << (corner + 1)) | (1 << (corner + finer)) | (1 << (corner + finer + 1))
        base += level * level
        level, open_cells = finer, below
    return bits


@compiled
def lit_cells(light: Wide, number: int, cells: Clusters, p: Place) -> int:
    """Bits of the cells from which a beam reaches a point; see `hiding_cells`."""
    if light.beam == LAMBERTIAN or light.reach > _WIDE_BEAM:
        return _ALL
    bits, first = 0, number * ALL_CELLS + ALL_CELLS - CELLS * CELLS
    cosine, sine = cosine_and_sine_of_turn(light.reach / (2 * math.pi))
    for k in range(CELLS * CELLS):
        box = cells[first + k]
        (x, y, z), half = ball_around(box, p)
        high = -(x * light.nx + y * light.ny + z * light.nz)
        aside = math.sqrt(max(x * x + y * y + z * z - high * high, 0.0))
        # How far the ball about the cell is outside of the cone in which light reaches the point.
        if aside * cosine - high * sine <= half:
            bits |= 1 << k
    return bits


@compiled
def cells_above(light: Wide, number: int, cells: Clusters, p: Place, n: Place) -> int:
    """Bits of the cells of which any part may lie above a point's horizon; see `hiding_cells`."""
    nx, ny, nz = abs(n[0]), abs(n[1]), abs(n[2])
    middle = _height(light, p, n)
    if middle >= (nx * (light.x1 - light.x0) + ny * (light.y1 - light.y0) + nz * (light.z1 - light.z0)) / 2:
        return _ALL
    bits, first = 0, number * ALL_CELLS + ALL_CELLS - CELLS * CELLS
    for k in range(CELLS * CELLS):
        box = cells[first + k]
        half = (nx * (box.x1 - box.x0) + ny * (box.y1 - box.y0) + nz * (box.z1 - box.z0)) / 2
        if _height(box, p, n) + half > 0:
            bits |= 1 << k
    return bits


@compiled
def _height(box: Cluster | Wide, p: Place, n: Place) -> float:
    """Of a box's middle, above a point's horizon."""
    x, y, z = (box.x0 + box.x1) / 2 - p[0], (box.y0 + box.y1) / 2 - p[1], (box.z0 + box.z1) / 2 - p[2]
    return x * n[0] + y * n[1] + z * n[2]


@compiled
def bits_of(bits: int, chosen: Whole) -> int:
    """How many bits are set; their places are filled in, neighbours after neighbours."""
    count = 0
    for k in range(CELLS * CELLS):
        # Every second bit of k is the row's, as on Morton's curve.
        row = (k >> 1 & 1) | (k >> 2 & 2) | (k >> 3 & 4)
        column = (k & 1) | (k >> 1 & 2) | (k >> 2 & 4)
        cell = row * CELLS + column
        if bits >> cell & 1:
            chosen[count] = cell
            count += 1
    return count


@compiled
def within_cells(u: float, v: float, chosen: Whole, count: int) -> tuple[float, float]:
    """An even point of the unit square in even points of some of its cells."""
    which = min(int(u * count), count - 1)
    row, column = chosen[which] // CELLS, chosen[which] % CELLS
    return (row + (u * count - which)) / CELLS, (column + v) / CELLS


@compiled
def cell_of(u: float, v: float) -> int:
    """The cell of a point of the unit square."""
    return min(int(u * CELLS), CELLS - 1) * CELLS + min(int(v * CELLS), CELLS - 1)
