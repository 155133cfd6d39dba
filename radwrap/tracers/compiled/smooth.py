"""Blocks of an image in which light can only change smoothly: one flat face, wholly seen, matte, and nothing near it.

Of a block the rays through its four corners and its middle are known. What
lies between them is not traced but proved: no shape can stand between the eye
and the block, and none between the block and any light; or what stands there
hides a light from all of the block, see `outlines`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.compiled import outlines
from radwrap.tracers.compiled.arrays import (
    BRUSHED,
    CONE,
    DISC,
    DOTS,
    NOTHING,
    PATTERN,
    RECTANGLE,
    TRIANGLE,
    WARD,
    WIDE_ZONE,
    Cluster,
    Clusters,
    Covers,
    Decals,
    Floats,
    Lights,
    Nodes,
    Shape,
    Shapes,
    Whole,
    Wide,
    Wides,
    put,
    rows,
)
from radwrap.tracers.compiled.beams import changes_slowly
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import from_dot, painted, rim_beyond
from radwrap.tracers.compiled.intersect import closest
from radwrap.tracers.compiled.kernels import placed
from radwrap.tracers.compiled.layout import CompiledScene
from radwrap.tracers.compiled.shadows import clear_between
from radwrap.tracers.compiled.tree import DEPTH
from radwrap.tracers.compiled.whole_face import fills, room
from radwrap.tracers.compiled.wide_shape import may_be_outside
from radwrap.tracers.engine import BlockLight

# By this share of its size a block is taken to be larger: distortion bends its sides.
_SPARE: Final = 0.1
# What shadows a block from nearer than this, in its own half diagonals, may do it sharply.
_NEAR: Final = 2.0
_BROAD: Final = 0.05  # rad; a narrower lobe shows outlines of what it mirrors
# Of the finest angle of a lobe: over a block that is seen from eye and lights under less, straight lines are off by
# the square of that over 8, and most at the middle.
_SMALL: Final = 0.1
_TURNED: Final = 1e-9  # rad, and of lengths: as far as rounding turns and moves faces of one plane
# Where nothing is met a block is looked at so many times as far away as the farthest corner of all that is there.
_BEYOND: Final = 2.0
_LIKELY, _PROVED = int(BlockLight.LIKELY), int(BlockLight.PROVED)
_SHADED: Final = -1  # proved, but for what may stand between it and some small light
_EMITTER: Final = -2
_NOTHING: Final = -1


def smooth_blocks(scene: CompiledScene, corners: Floats, middles: Floats, around: Whole) -> NDArray[np.int8]:
    """How light can change within each block, a `BlockLight`.

    Parameters
    ----------
    scene : CompiledScene
        What is there.
    corners : ndarray, shape (corners, 6)
        Rays through the corners of the blocks, all from one point.
    middles : ndarray, shape (n, 6)
        Rays through their middles.
    around : ndarray of int, shape (n, 4)
        Numbers of each block's corners, one beside the next.
    """
    smooth = np.zeros(len(middles), dtype=np.int8)
    if not len(middles) or (scene.lights["beam"] == CONE).any():  # its light ends at once
        return smooth
    met, cover, place = _faces(scene, corners)
    shape, wears, middle = _faces(scene, middles)
    same, alike = np.empty(len(middles), dtype=np.bool_), np.empty(len(middles), dtype=np.bool_)
    _on_one_face(scene.targets.shapes, met, cover, shape, wears, middle, around, same, alike)
    chosen = np.flatnonzero(same | alike)
    places = np.concatenate([place[around[chosen]], middle[chosen, np.newaxis]], axis=1)
    low, high = places.min(axis=1), places.max(axis=1)
    spare = _SPARE * (high - low)
    boxes = rows(Cluster, len(chosen))
    put(boxes, "x0 y0 z0", low - spare)
    put(boxes, "x1 y1 z1", high + spare)
    reach = np.sqrt(((places[:, :4] - places[:, 4:]) ** 2).sum(axis=2)).max(axis=1) * (1 + _SPARE)
    ex, ey, ez = ((middles[0, :3] - scene.frame.origin) * scene.frame.units).tolist()
    found = np.zeros(len(chosen), dtype=np.int8)
    edges = outlines.edges_of(scene.targets.shapes)
    _undisturbed(
        scene.targets.shapes,
        scene.targets.nodes,
        scene.emitters.shapes,
        scene.emitters.nodes,
        scene.covers,
        scene.decals,
        scene.tables,
        edges,
        scene.lights,
        scene.clusters,
        scene.wides,
        boxes,
        places,
        reach,
        shape[chosen],
        wears[chosen],
        same[chosen],
        ex,
        ey,
        ez,
        np.empty(DEPTH, dtype=np.int64),
        np.empty((4, 3)),
        room(),
        found,
    )
    _settle_shaded(scene, edges, boxes, places, shape[chosen], (ex, ey, ez), found)
    smooth[chosen] = found
    return smooth


def _settle_shaded(
    scene: CompiledScene,
    edges: Floats,
    boxes: NDArray[np.void],
    places: Floats,
    met: Whole,
    eye: tuple[float, float, float],
    found: NDArray[np.int8],
) -> None:
    """Of blocks that are `_SHADED`, those on which no outline falls are proved, and nothing is known of the others."""
    shaded = found == _SHADED
    lights = outlines.places_of(scene.lights, scene.clusters)
    if len(lights) > outlines.MOST_LIGHTS:
        found[shaded] = 0
        return
    shapes = scene.targets.shapes
    even = shaded.copy()
    outlines.settle(
        shapes,
        scene.targets.nodes,
        edges,
        lights,
        boxes,
        places,
        met,
        _SPARE,
        np.array(eye),
        np.empty(DEPTH, dtype=np.int64),
        outlines.room(),
        even,
    )
    found[shaded] = np.where(even[shaded], _PROVED, 0)


@compiled
def _on_one_face(
    shapes: Shapes,
    met: Whole,
    cover: Whole,
    shape: Whole,
    wears: Whole,
    middle: Floats,
    around: Whole,
    same: NDArray[np.bool_],
    alike: NDArray[np.bool_],
) -> None:
    """Fill in whether a block's corners and its middle meet the same shape, and shapes of one target in one plane."""
    for b in range(len(shape)):
        same[b], alike[b] = shape[b] > _EMITTER, shape[b] >= 0
        for k in range(4):
            corner = around[b, k]
            same[b] &= met[corner] == shape[b] and cover[corner] == wears[b]
            alike[b] = (
                alike[b]
                and met[corner] >= 0
                and cover[corner] == wears[b]
                and _in_one_plane(shapes[met[corner]], shapes[shape[b]], middle[b, 0], middle[b, 1], middle[b, 2])
            )


@compiled
def _in_one_plane(one: Shape, other: Shape, x: float, y: float, z: float) -> bool:
    """Whether faces of one target lie in one plane, a place of the other's that of the one, as far as rounding goes."""
    turned = max(abs(one.nx - other.nx), abs(one.ny - other.ny), abs(one.nz - other.nz))
    off = one.nx * (one.x - x) + one.ny * (one.y - y) + one.nz * (one.z - z)
    return one.owner == other.owner and turned < _TURNED and abs(off) <= _TURNED * max(abs(x), abs(y), abs(z))


def _faces(scene: CompiledScene, rays: Floats) -> tuple[Whole, Whole, Floats]:
    """Shape that each ray meets, or `_NOTHING` or `_EMITTER`, the cover that it shows there, and the place."""
    met, cover = np.empty(len(rays), dtype=np.int64), np.empty(len(rays), dtype=np.int64)
    place = np.empty((len(rays), 3))
    _met(
        scene.targets.shapes,
        scene.targets.nodes,
        scene.emitters.shapes,
        scene.emitters.nodes,
        scene.decals,
        scene.tables,
        np.ascontiguousarray(rays),
        *scene.frame.origin,
        float(scene.frame.units),
        met,
        cover,
        place,
        np.empty(DEPTH, dtype=np.int64),
    )
    return met, cover, place


@compiled
def _met(
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
    met: Whole,
    cover: Whole,
    place: Floats,
    stack: Whole,
) -> None:
    for r in range(len(rays)):
        _, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        distance, shape = closest(shapes, nodes, tables, ox, oy, oz, dx, dy, dz, math.inf, stack)
        _, disc = closest(discs, disc_nodes, tables, ox, oy, oz, dx, dy, dz, distance, stack)
        met[r], cover[r] = _NOTHING, _NOTHING
        if disc >= 0:
            met[r] = _EMITTER
        elif shape < 0:
            distance = _beyond(nodes, ox, oy, oz) + _beyond(disc_nodes, ox, oy, oz) + 1
        place[r, 0], place[r, 1], place[r, 2] = ox + distance * dx, oy + distance * dy, oz + distance * dz
        if shape >= 0:
            met[r] = shape if disc < 0 else _EMITTER
            x, y, z = place[r, 0], place[r, 1], place[r, 2]
            cover[r] = painted(decals, tables, shapes[shape].owner, shapes[shape].decal, x, y, z)


@compiled
def _beyond(nodes: Nodes, x: float, y: float, z: float) -> float:
    """More than the distance from a point to anything in a tree."""
    if not len(nodes):
        return 0.0
    box = nodes[0]
    return _BEYOND * (
        max(abs(box.x0 - x), abs(box.x1 - x))
        + max(abs(box.y0 - y), abs(box.y1 - y))
        + max(abs(box.z0 - z), abs(box.z1 - z))
    )


@compiled
def _undisturbed(
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    covers: Covers,
    decals: Decals,
    tables: Floats,
    edges: Floats,
    lights: Lights,
    clusters: Clusters,
    wides: Wides,
    boxes: Clusters,
    places: Floats,
    reach: Floats,
    met: Whole,
    wears: Whole,
    same: NDArray[np.bool_],
    ex: float,
    ey: float,
    ez: float,
    stack: Whole,
    quad: Floats,
    polygons: Floats,
    found: NDArray[np.int8],
) -> None:
    for b in range(len(boxes)):
        box, but, proved, filled = boxes[b], met[b], same[b], False
        if but >= 0:
            cover = covers[wears[b]]
            middle = places[b, 4]
            if cover.columns != 0 or cover.kind not in (NOTHING, WARD, BRUSHED):
                continue
            if cover.kind != NOTHING and cover.fine < _BROAD:
                continue
            for k in range(4):
                for axis in range(3):
                    quad[k, axis] = middle[axis] + (1 + _SPARE) * (places[b, k, axis] - middle[axis])
            s = shapes[but]
            filled = s.kind == TRIANGLE and s.decal < 0
            filled = filled and fills(shapes, nodes, edges, True, quad, but, _SPARE * reach[b], stack, polygons)
            proved = filled or (proved and _is_one_face(s, decals, tables, middle[0], middle[1], middle[2], reach[b]))
            proved = proved and _all_change_slowly(lights, clusters, tables, middle, reach[b])
            if cover.kind != NOTHING:
                away = _SMALL * cover.fine
                proved = proved and reach[b] <= away * _distance(box, ex, ey, ez)
                for c in range(len(clusters)):
                    proved = proved and reach[b] <= away * _between(box, clusters[c])
                for w in range(len(wides)):
                    proved = proved and reach[b] <= away * _between(box, wides[w])
        # Of surfaces in one plane any may be seen.
        free = clear_between(shapes, nodes, box, ex, ey, ez, ex, ey, ez, but, filled or not proved, stack)
        proved = proved and free and clear_between(discs, disc_nodes, box, ex, ey, ez, ex, ey, ez, -1, False, stack)
        if but < 0:
            if proved:
                found[b] = _PROVED
            continue
        x0, y0, z0, x1, y1, z1 = box.x0, box.y0, box.z0, box.x1, box.y1, box.z1
        lit = True
        for c in range(len(clusters)):
            lit = lit and clear_between(shapes, nodes, clusters[c], x0, y0, z0, x1, y1, z1, but, True, stack)
            if free and clusters[c].may_be_hidden:
                free = clear_between(discs, disc_nodes, clusters[c], x0, y0, z0, x1, y1, z1, -1, True, stack)
        for w in range(len(wides)):
            own = wides[w].own
            free = free and not (wides[w].kind == WIDE_ZONE and may_be_outside(wides[w], box))
            proved = proved and free
            proved = proved and clear_between(shapes, nodes, wides[w], x0, y0, z0, x1, y1, z1, but, True, stack)
            proved = proved and clear_between(discs, disc_nodes, wides[w], x0, y0, z0, x1, y1, z1, own, True, stack)
        if free and proved:
            found[b] = _PROVED if lit else _SHADED
        elif free and lit and len(wides):
            # Where a small emitter may be in the way, its outline may lie between the rays.
            if len(clusters) and not clear_between(discs, disc_nodes, box, ex, ey, ez, ex, ey, ez, -1, False, stack):
                continue
            is_plain = shapes[but].kind == TRIANGLE or _is_one_face(
                shapes[but], decals, tables, middle[0], middle[1], middle[2], reach[b]
            )
            if is_plain and fills(shapes, nodes, edges, False, quad, but, _NEAR * reach[b], stack, polygons):
                found[b] = _LIKELY


@compiled
def _all_change_slowly(lights: Lights, clusters: Clusters, tables: Floats, middle: Floats, reach: float) -> bool:
    """Whether no beam of small lights ends, or changes much, within reach of a place."""
    for c in range(len(clusters)):
        for i in range(clusters[c].first, clusters[c].end):
            if not changes_slowly(lights[i], tables, middle, reach, _SMALL):
                return False
    return True


@compiled
def _distance(box: Cluster, x: float, y: float, z: float) -> float:
    """From a place to a box."""
    dx, dy, dz = max(box.x0 - x, x - box.x1, 0.0), max(box.y0 - y, y - box.y1, 0.0), max(box.z0 - z, z - box.z1, 0.0)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@compiled
def _between(box: Cluster, there: Cluster | Wide) -> float:
    """Distance of two boxes."""
    dx = max(box.x0 - there.x1, there.x0 - box.x1, 0.0)
    dy = max(box.y0 - there.y1, there.y0 - box.y1, 0.0)
    dz = max(box.z0 - there.z1, there.z0 - box.z1, 0.0)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@compiled
def _is_one_face(shape: Shape, decals: Decals, tables: Floats, x: float, y: float, z: float, reach: float) -> bool:
    """Whether a shape is flat and without notches, and nothing else is painted on it within reach of a place."""
    if shape.kind not in (TRIANGLE, RECTANGLE, DISC):
        return False
    if shape.decal < 0:
        return True
    d = decals[shape.decal]
    px, py, pz = x - d.x, y - d.y, z - d.z
    across, up = px * d.ux + py * d.uy + pz * d.uz, px * d.vx + py * d.vy + pz * d.vz
    if d.kind == PATTERN:
        # Metres in place of the text's unit.
        return rim_beyond(tables, int(d.a), across, up, reach * math.sqrt(d.ux * d.ux + d.uy * d.uy + d.uz * d.uz))
    if d.kind != DOTS:
        return abs(across - d.a) > reach * math.sqrt(d.ux * d.ux + d.uy * d.uy + d.uz * d.uz)
    # In pitches, of which there is one across and one up.
    widest = math.sqrt(max(d.ux * d.ux + d.uy * d.uy + d.uz * d.uz, d.vx * d.vx + d.vy * d.vy + d.vz * d.vz))
    u, v = from_dot(across, d.a), from_dot(up, d.b)
    return abs(math.sqrt(u * u + v * v) - math.sqrt(d.c)) > reach * widest
