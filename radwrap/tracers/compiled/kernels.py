"""What is asked of the compiled tracer: light along rays, and what they meet."""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arrays import (
    DISC,
    LUMINAIRE,
    NOTHING,
    POLYGON,
    RECTANGLE,
    SPHERE,
    TRIANGLE,
    TURNED_NORMAL,
    ZONE,
    Clusters,
    Covers,
    Decals,
    Floats,
    Light,
    Lights,
    Nodes,
    Shape,
    Shapes,
    Whole,
    Wides,
)
from radwrap.tracers.compiled.beams import radiance_along
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import LEAST_COSINE, diffuse_at, painted, reflected
from radwrap.tracers.compiled.intersect import closest
from radwrap.tracers.compiled.neighbours import NEIGHBOURS, NOT_ASKED, darken, put_around
from radwrap.tracers.compiled.shadows import darken_own
from radwrap.tracers.compiled.shine import received, towards
from radwrap.tracers.compiled.wide_points import key_of_ray
from radwrap.tracers.compiled.wide_shine import sent

NOTHING_MET: Final = -(1 << 62)


@compiled
def meet(
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    rays: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    lengths: Floats,
    met: Whole,
    stack: Whole,
) -> bool:
    """Which shapes rays meet first.

    Parameters
    ----------
    shapes, nodes, discs, disc_nodes, tables, rays, x0, y0, z0, units, stack
        As `trace`.
    lengths : ndarray, shape (n,)
        Filled with the distance to the first surface in the text's unit, infinite where there is none.
    met : ndarray of int, shape (n,)
        Filled with the number of the shape that is met, -2 minus that of an emitter's, or -1 where there is none.

    Returns
    -------
    bool
        Whether all rays had finite numbers and a direction; it ends at the first that has not.
    """
    for r in range(len(rays)):
        good, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        if not good:
            return False
        distance, target = closest(shapes, nodes, tables, ox, oy, oz, dx, dy, dz, math.inf, stack)
        lengths[r], disc = closest(discs, disc_nodes, tables, ox, oy, oz, dx, dy, dz, distance, stack)
        met[r] = target if disc < 0 else -2 - disc
    return True


@compiled
def trace(
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    covers: Covers,
    decals: Decals,
    lights: Lights,
    beside: Floats,
    clusters: Clusters,
    parts: Clusters,
    wides: Wides,
    cells: Clusters,
    pitch: float,
    halvings: int,
    alike: bool,
    background: float,
    tables: Floats,
    rays: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    values: Floats,
    lengths: Floats,
    met: Whole,
    order: Whole,
    given: Floats,
    points: Floats,
    around: Floats,
    asked: Whole,
    between: Whole,
    heights: Floats,
    known: Whole,
    chosen: Whole,
    room: Floats,
    ways: Whole,
    stack: Whole,
) -> None:
    """Radiance along rays, from each group of emitters.

    Parameters
    ----------
    shapes, nodes : Shapes, Nodes
        Targets and their tree.
    discs, disc_nodes : Shapes, Nodes
        Emitters and their tree.
    covers, decals, lights
        What targets wear, what is painted on them, and what emitters send.
    beside : ndarray
        The lights' numbers `side_by_side`.
    clusters, parts : Clusters
        Lights in groups that lie together, and the same in smaller groups.
    wides : Wides
        Lights that shine as a whole; they are in no group.
    cells, pitch : Clusters, float
        Boxes of the cells of those lights, and the size of a place that asks for them; see `wide_cells`.
    halvings, alike : int, bool
        See `CompiledScene`.
    background : float
        Radiance of what is seen where nothing is; it goes to the last column.
    tables : ndarray
        All tables.
    rays : ndarray, shape (n, 6)
        Origins in the world [m], and directions of any length.
    x0, y0, z0, units : float
        The text's origin in the world [m], and its units in a metre.
    values : ndarray, shape (n, columns)
        To which radiance is added [W m^-2 sr^-1], in the column of each light.
    lengths, met : ndarray, ndarray of int, shape (n,)
        What `meet` found of them.
    order : ndarray of int, shape (n,)
        The rays, those that meet near places near each other. The radiance does not hang on it.
    given, points, around, asked, between, heights
        Room to work in; see `neighbours.darken`.
    known, chosen, room, ways, stack
        Room to work in; see `wide_cells`, `wide_beam`, `wide_ways` and `tree.DEPTH`.
    """
    count = 0
    for k in range(len(order)):
        r = order[k]
        if k % NEIGHBOURS == 0:
            count = put_together(rays, order[k : k + NEIGHBOURS], x0, y0, z0, units, lengths, met, points)
            put_around(points, count, around)
            asked[:] = NOT_ASKED
        _, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        distance, number = lengths[r], met[r]
        if number < -1:
            disc = -2 - number
            light = lights[discs[disc].owner]
            if light.beam == LUMINAIRE or shows_front(light, discs[disc], ox, oy, oz, dx, dy, dz, distance):
                values[r, light.column] += radiance_along(light, tables, -dx, -dy, -dz)
            continue
        if number < 0:
            values[r, -1] += background
            continue
        shape = shapes[number]
        x, y, z = ox + distance * dx, oy + distance * dy, oz + distance * dz
        nx, ny, nz = normal_at(shape, x, y, z)
        cover = covers[painted(decals, tables, shape.owner, shape.decal, x, y, z)]
        if nx * dx + ny * dy + nz * dz > 0:
            if not cover.two_sided:
                continue
            nx, ny, nz = -nx, -ny, -nz
        diffuse = diffuse_at(cover, tables, x, y, z)
        is_flat = shape.kind in (RECTANGLE, POLYGON, DISC)
        flat = 1 / (4 * math.pi) if is_flat else 0.0
        # A flat face does not hide its own points, however grazing the light.
        itself = number if is_flat or shape.kind == TRIANGLE else -1
        least = -2.0 if cover.kind == TURNED_NORMAL else LEAST_COSINE  # a turned normal knows no horizon
        for c in range(len(clusters)):
            cluster = clusters[c]
            received(lights, beside, cluster, tables, x, y, z, nx, ny, nz, least, cover.kind == NOTHING, diffuse, given)
            if cover.kind != NOTHING:
                for i in range(cluster.first, cluster.end):
                    if given[i] > 0:
                        lx, ly, lz, _, solid_angle = towards(lights[i], x, y, z)
                        given[i] *= reflected(
                            cover, tables, diffuse, nx, ny, nz, -dx, -dy, -dz, lx, ly, lz, flat * solid_angle
                        )
            darken(
                lights,
                cluster,
                c,
                parts,
                shapes,
                nodes,
                tables,
                points,
                count,
                around,
                x,
                y,
                z,
                itself,
                given,
                asked,
                between,
                heights,
                stack,
            )
            if cluster.may_be_hidden:
                darken_own(lights, cluster, discs, disc_nodes, tables, x, y, z, given, stack)
            for i in range(cluster.first, cluster.end):
                values[r, lights[i].column] += given[i]
        for w in range(len(wides)):
            if wides[w].radiance > 0:
                key = w
                if not alike:
                    key = key_of_ray(rays[r, 0], rays[r, 1], rays[r, 2], rays[r, 3], rays[r, 4], rays[r, 5], w)
                p, n, v = (x, y, z), (nx, ny, nz), (-dx, -dy, -dz)
                values[r, lights[wides[w].light].column] += sent(
                    wides[w],
                    w,
                    cells,
                    pitch,
                    halvings,
                    alike,
                    cover,
                    diffuse,
                    shapes,
                    nodes,
                    discs,
                    disc_nodes,
                    tables,
                    p,
                    n,
                    v,
                    itself,
                    key,
                    known,
                    chosen,
                    room,
                    ways,
                    stack,
                )


@compiled
def put_together(
    rays: Floats,
    some: Whole,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    lengths: Floats,
    met: Whole,
    points: Floats,
) -> int:
    """Fill in where some rays meet targets, in the text's frame; how many do."""
    count = 0
    for r in some:
        if met[r] >= 0:
            _, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
            t = lengths[r]
            points[count, 0], points[count, 1], points[count, 2] = ox + t * dx, oy + t * dy, oz + t * dz
            count += 1
    return count


@compiled
def placed(
    rays: Floats, r: int, x0: float, y0: float, z0: float, units: float
) -> tuple[bool, float, float, float, float, float, float]:
    """Whether a ray has finite numbers and a direction; its origin in the text's frame, and its unit direction."""
    ox, oy, oz = (rays[r, 0] - x0) * units, (rays[r, 1] - y0) * units, (rays[r, 2] - z0) * units
    dx, dy, dz = rays[r, 3], rays[r, 4], rays[r, 5]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    good = length > 0 and math.isfinite(length) and math.isfinite(ox + oy + oz)
    return good, ox, oy, oz, dx / length, dy / length, dz / length


@compiled
def shows_front(
    light: Light, s: Shape, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, t: float
) -> bool:
    """Whether a ray meets an emitter of that shape, so far away, from its shining side."""
    nx, ny, nz = light.nx, light.ny, light.nz
    if s.kind == ZONE:
        nx, ny, nz = normal_at(s, ox + t * dx, oy + t * dy, oz + t * dz)
    return nx * dx + ny * dy + nz * dz < 0


@compiled
def normal_at(s: Shape, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Unit normal of a shape's front at a place on it."""
    kind = s.kind
    if kind in (TRIANGLE, RECTANGLE, POLYGON, DISC):
        return s.nx, s.ny, s.nz
    px, py, pz = x - s.x, y - s.y, z - s.z
    if kind == ZONE:  # it shines to its middle
        return -px / s.a, -py / s.a, -pz / s.a
    if kind != SPHERE:
        along = px * s.nx + py * s.ny + pz * s.nz
        px, py, pz = px - along * s.nx, py - along * s.ny, pz - along * s.nz
    return px / s.a, py / s.a, pz / s.a


@compiled
def surfaces(
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    decals: Decals,
    tables: Floats,
    rays: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    distances: Floats,
    normals: Floats,
    found: Whole,
    stack: Whole,
) -> bool:
    """What rays meet first.

    Parameters
    ----------
    shapes, nodes, discs, disc_nodes, decals, tables, rays, x0, y0, z0, units, stack
        As `trace`.
    distances : ndarray, shape (n,)
        Filled with the distance to the first surface [m], infinite where there is none.
    normals : ndarray, shape (n, 3)
        Filled with unit normals of the front; 0 where nothing is.
    found : ndarray of int, shape (n,)
        Filled with the number of the cover, -1 minus that of an emitter, or `NOTHING_MET`.
    """
    for r in range(len(rays)):
        good, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        if not good:
            return False
        distance, met = closest(shapes, nodes, tables, ox, oy, oz, dx, dy, dz, math.inf, stack)
        nearer, disc = closest(discs, disc_nodes, tables, ox, oy, oz, dx, dy, dz, distance, stack)
        distances[r] = nearer / units
        nx, ny, nz, found[r] = 0.0, 0.0, 0.0, NOTHING_MET
        x, y, z = ox + nearer * dx, oy + nearer * dy, oz + nearer * dz
        if disc >= 0:
            nx, ny, nz = normal_at(discs[disc], x, y, z)
            found[r] = -1 - discs[disc].owner
        elif met >= 0:
            shape = shapes[met]
            nx, ny, nz = normal_at(shape, x, y, z)
            found[r] = painted(decals, tables, shape.owner, shape.decal, x, y, z)
        normals[r, 0], normals[r, 1], normals[r, 2] = nx, ny, nz
    return True
