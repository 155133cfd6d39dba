"""Blocks of an image in which light can only change smoothly: one flat face, wholly seen, matte, and nothing near it.

Of a block the rays through its four corners and its middle are known. What
lies between them is not traced but proved: no shape can stand between the eye
and the block, and none between the block and any light; or what stands there
hides a light from all of the block, see `outlines`.
"""

from __future__ import annotations

import math
from itertools import product
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


def smooth_blocks(scene: CompiledScene, corners: Floats, middles: Floats) -> NDArray[np.int8]:
    """How light can change within each block, a `BlockLight`.

    Parameters
    ----------
    scene : CompiledScene
        What is there.
    corners : ndarray, shape (rows + 1, columns + 1, 6)
        Rays through the corners of the blocks, all from one point.
    middles : ndarray, shape (rows, columns, 6)
        Rays through their middles.
    """
    count = middles.shape[:2]
    if (scene.lights["beam"] == CONE).any():  # its light ends at once
        return np.zeros(count, dtype=np.int8)
    met, cover, place = _faces(scene, corners)
    shape, wears, middle = _faces(scene, middles)
    at_corners = [slice(None, -1), slice(1, None)]
    same, alike = shape > _EMITTER, shape >= 0
    for down, right in product(at_corners, at_corners):
        same &= (met[down, right] == shape) & (cover[down, right] == wears)
        alike &= (met[down, right] >= 0) & (cover[down, right] == wears)
    for down, right in product(at_corners, at_corners):
        alike[alike] = _in_one_plane(scene, met[down, right][alike], shape[alike], middle[alike])
    chosen = np.nonzero(same | alike)
    row, column = chosen
    places = np.stack(
        [place[row, column], place[row + 1, column], place[row + 1, column + 1], place[row, column + 1], middle[chosen]]
    )
    low, high = places.min(axis=0), places.max(axis=0)
    spare = _SPARE * (high - low)
    boxes = rows(Cluster, len(row))
    put(boxes, "x0 y0 z0", low - spare)
    put(boxes, "x1 y1 z1", high + spare)
    reach = np.sqrt(((places[:4] - places[4]) ** 2).sum(axis=2)).max(axis=0) * (1 + _SPARE)
    ex, ey, ez = ((middles[0, 0, :3] - scene.frame.origin) * scene.frame.units).tolist()
    found = np.zeros(len(row), dtype=np.int8)
    places = np.ascontiguousarray(places.transpose(1, 0, 2))
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
    smooth = np.zeros(count, dtype=np.int8)
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


def _in_one_plane(scene: CompiledScene, one: Whole, other: Whole, place: Floats) -> NDArray[np.bool_]:
    """Whether faces of one target lie in one plane, as far as rounding goes."""
    shapes = scene.targets.shapes
    a, b = shapes[one], shapes[other]
    normals = [np.stack([s["nx"], s["ny"], s["nz"]], axis=-1) for s in (a, b)]
    off = (normals[0] * (np.stack([a["x"], a["y"], a["z"]], axis=-1) - place)).sum(axis=-1)
    alike: NDArray[np.bool_] = (a["owner"] == b["owner"]) & (np.abs(normals[0] - normals[1]).max(axis=-1) < _TURNED)
    return alike & (np.abs(off) <= _TURNED * np.abs(place).max(axis=-1))


def _faces(scene: CompiledScene, rays: Floats) -> tuple[Whole, Whole, Floats]:
    """Shape that each ray meets, or `_NOTHING` or `_EMITTER`, the cover that it shows there, and the place."""
    block = np.ascontiguousarray(rays.reshape(-1, 6))
    met, cover = np.empty(len(block), dtype=np.int64), np.empty(len(block), dtype=np.int64)
    place = np.empty((len(block), 3))
    _met(
        scene.targets.shapes,
        scene.targets.nodes,
        scene.emitters.shapes,
        scene.emitters.nodes,
        scene.decals,
        scene.tables,
        block,
        *scene.frame.origin,
        float(scene.frame.units),
        met,
        cover,
        place,
        np.empty(DEPTH, dtype=np.int64),
    )
    shape = rays.shape[:-1]
    return met.reshape(shape), cover.reshape(shape), place.reshape(*shape, 3)


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
