"""What is left of a wide light's radiance where something may hide a part of it.

It has no noise where nothing hides the light, or all of it is hidden.
"""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arrays import LAMBERTIAN, Cover, Floats, Nodes, Shapes, Whole, Wide
from radwrap.tracers.compiled.beams import share_of
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import reflected
from radwrap.tracers.compiled.wide_cells import CELLS, within_cells
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_points import mixed, spread_point
from radwrap.tracers.compiled.wide_shadow import NOTHING_HIDES, hidden_by, hidden_by_lights
from radwrap.tracers.compiled.wide_shape import point_on
from radwrap.tracers.compiled.wide_ways import find_ways

# Points of a light that are asked for whether they are hidden, where hardly any is, and elsewhere: powers of two.
_FEWEST: Final = 16
_LEAST: Final = 4  # however often they are halved; each of two sets has two
MOST_POINTS: Final = 64
# Where so few of the other cells are clear, the whole of what may be hidden is known better by them than by its points;
# else two sets of points are noisier than one of as many.
_SOME: Final = 8
_FIRST: Final = 3
_SECOND: Final = 4
_THIRD: Final = 7


@compiled
def left_over(
    light: Wide,
    cover: Cover,
    diffuse: float,
    with_lobe: bool,
    whole: float,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    p: Place,
    n: Place,
    v: Place,
    itself: int,
    chosen: Whole,
    count: int,
    clear: int,
    is_hiding: bool,
    halvings: int,
    key: int,
    ways: Whole,
    stack: Whole,
) -> float:
    """Radiance to the eye [W m^-2 sr^-1] of what of a light is not hidden, an unbiased estimate: perhaps below 0.

    Where some cells are clear, what is hidden of the others is taken from the whole.
    Where hardly any is, two independent sets of points each say how much of the
    other's miss of them counts: with nothing hidden the whole light is left, with
    everything what other cells send, and between them the mean is right.

    Parameters
    ----------
    light : Wide
        The light.
    cover, diffuse, with_lobe : Cover, float, bool
        How the point reflects: its `diffuse_at`, and its Gaussian lobe where that is counted too.
    whole : float
        What it sends with nothing hidden.
    shapes, nodes, discs, disc_nodes, tables
        What may stand between: targets and emitters.
    p, n, v : tuple of float
        The point, its unit normal, and the unit vector to the eye.
    itself : int
        Shape that does not count, or -1.
    chosen, count : ndarray of int, int
        Cells of the light that may be hidden, see `wide_cells.bits_of`.
    clear : int
        How many other cells may send it light; they come after those in `chosen`.
    is_hiding : bool
        Whether some of them are, as far as was seen from near the point.
    halvings : int
        See `CompiledScene`.
    key : int
        Which points of the light are asked; see `wide_points.key_of_ray`.
    ways, stack : ndarray of int, shape (WAYS,), (DEPTH,)
        Room to work in.
    """
    if count == 0:
        return whole
    way_count = find_ways(light, shapes, nodes, p, itself, ways, stack)
    points = halved(MOST_POINTS if is_hiding else _FEWEST, halvings)
    if _SOME * clear > count:
        total, seen = _asked(
            light,
            cover,
            diffuse,
            with_lobe,
            shapes,
            nodes,
            discs,
            disc_nodes,
            tables,
            p,
            n,
            v,
            itself,
            chosen,
            count,
            points,
            mixed(key, _FIRST),
            ways,
            way_count,
            stack,
        )
        left = whole - (total - seen)
    else:
        beside = 0.0
        if clear > 0:
            beside = _sent(
                light,
                cover,
                diffuse,
                with_lobe,
                tables,
                p,
                n,
                v,
                chosen[count:],
                clear,
                points,
                mixed(key, _THIRD),
            )
        own = whole - beside
        all_a, seen_a = _asked(
            light,
            cover,
            diffuse,
            with_lobe,
            shapes,
            nodes,
            discs,
            disc_nodes,
            tables,
            p,
            n,
            v,
            itself,
            chosen,
            count,
            points // 2,
            mixed(key, _FIRST),
            ways,
            way_count,
            stack,
        )
        all_b, seen_b = _asked(
            light,
            cover,
            diffuse,
            with_lobe,
            shapes,
            nodes,
            discs,
            disc_nodes,
            tables,
            p,
            n,
            v,
            itself,
            chosen,
            count,
            points // 2,
            mixed(key, _SECOND),
            ways,
            way_count,
            stack,
        )
        share_a = seen_a / all_a if all_a > 0 else 0.0
        share_b = seen_b / all_b if all_b > 0 else 0.0
        left = beside + (seen_a + share_b * (own - all_a) + seen_b + share_a * (own - all_b)) / 2
    # What is below 0 stays so: cut off, the mean in a shadow is too large, by a tenth of the light with few points.
    return left


@compiled
def halved(points: int, halvings: int) -> int:
    """A power of two halved so often, as far as few are left; doubled where that is below 0."""
    return max(points >> halvings, _LEAST) if halvings >= 0 else points << -halvings


@compiled
def _asked(
    light: Wide,
    cover: Cover,
    diffuse: float,
    with_lobe: bool,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    p: Place,
    n: Place,
    v: Place,
    itself: int,
    chosen: Whole,
    count: int,
    points: int,
    key: int,
    ways: Whole,
    way_count: int,
    stack: Whole,
) -> tuple[float, float]:
    """Radiance by some points of cells: by all of them, and by those that are not hidden [W m^-2 sr^-1]."""
    total, seen, last = 0.0, 0.0, NOTHING_HIDES
    for i in range(points):
        a, b = spread_point(i, key)
        a, b = within_cells(a, b, chosen, count)
        value, d, away = sent_by(light, cover, tables, diffuse, with_lobe, p, n, v, a, b)
        if value > 0:
            total += value
            found = hidden_by(shapes, nodes, tables, p, d, away, itself, ways, way_count, last, stack)
            if found >= 0:
                last = found
            elif not hidden_by_lights(light, discs, disc_nodes, tables, p, d, away, stack):
                seen += value
    scale = light.radiance * light.area * count / (CELLS * CELLS * points)
    return scale * total, scale * seen


@compiled
def _sent(
    light: Wide,
    cover: Cover,
    diffuse: float,
    with_lobe: bool,
    tables: Floats,
    p: Place,
    n: Place,
    v: Place,
    chosen: Whole,
    count: int,
    points: int,
    key: int,
) -> float:
    """Radiance by some points of cells that nothing hides [W m^-2 sr^-1]."""
    total = 0.0
    for i in range(points):
        a, b = spread_point(i, key)
        a, b = within_cells(a, b, chosen, count)
        value, _, _ = sent_by(light, cover, tables, diffuse, with_lobe, p, n, v, a, b)
        total += value
    return light.radiance * light.area * count / (CELLS * CELLS * points) * total


@compiled
def sent_by(
    light: Wide,
    cover: Cover,
    tables: Floats,
    diffuse: float,
    with_lobe: bool,
    p: Place,
    n: Place,
    v: Place,
    a: float,
    b: float,
) -> tuple[float, Place, float]:
    """What a point sends to the eye, by a place of the light and for each unit of its area and radiance.

    Besides the direction to that place, and the distance.
    """
    x, y, z, nx, ny, nz = point_on(light, a, b)
    dx, dy, dz = x - p[0], y - p[1], z - p[2]
    square = dx * dx + dy * dy + dz * dz
    away = math.sqrt(square)
    d = (dx / away, dy / away, dz / away)
    leaving, arriving = -(d[0] * nx + d[1] * ny + d[2] * nz), d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    if leaving <= 0:
        return 0.0, d, away
    value = diffuse * max(arriving, 0.0)
    if with_lobe:
        value += reflected(cover, tables, 0.0, n[0], n[1], n[2], v[0], v[1], v[2], d[0], d[1], d[2], 0.0)
    if value <= 0:
        return 0.0, d, away
    return value * shining(light, tables, d, leaving) / square, d, away


@compiled
def shining(light: Wide, tables: Floats, d: Place, leaving: float) -> float:
    """Intensity of a piece of a light towards where a direction comes from, of its axial one."""
    if light.beam == LAMBERTIAN:
        return leaving
    return share_of(light, tables, ((d[0] + light.nx) ** 2 + (d[1] + light.ny) ** 2 + (d[2] + light.nz) ** 2) / 4)
