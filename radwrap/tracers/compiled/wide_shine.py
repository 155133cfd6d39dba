"""What a lit point sends to the eye of wide lights that shine as a whole."""

from __future__ import annotations

from typing import Final

from radwrap.tracers.compiled.arrays import (
    NOTHING,
    TURNED_NORMAL,
    Clusters,
    Cover,
    Floats,
    Nodes,
    Shapes,
    Whole,
    Wide,
)
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.wide_cells import bits_of, cells_above, hiding_cells, lit_cells
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_light import MOST_POINTS, left_over
from radwrap.tracers.compiled.wide_lobe import SAMPLES, sampled_lobe
from radwrap.tracers.compiled.wide_nodes import nodes_along, whole_lobe
from radwrap.tracers.compiled.wide_shape import may_light, unhidden

# Points of a light that are asked for at most: as many lights would take as long.
POINTS_OF_A_LIGHT: Final = MOST_POINTS + 2 * SAMPLES


@compiled
def sent(
    light: Wide,
    number: int,
    cells: Clusters,
    pitch: float,
    halvings: int,
    alike: bool,
    cover: Cover,
    diffuse: float,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    p: Place,
    n: Place,
    v: Place,
    itself: int,
    key: int,
    known: Whole,
    chosen: Whole,
    room: Floats,
    ways: Whole,
    stack: Whole,
) -> float:
    """Radiance to the eye [W m^-2 sr^-1].

    Parameters
    ----------
    light, number : Wide, int
        The light, and which it is.
    cells, pitch, known
        See `wide_cells.hiding_cells`.
    halvings, alike : int, bool
        See `CompiledScene`.
    cover : Cover
        How the point reflects.
    diffuse : float
        Its `diffuse_at` the point.
    shapes, nodes, discs, disc_nodes, tables
        What may stand between: targets and emitters.
    p, n, v : tuple of float
        The point, its unit normal on the eye's side, and the unit vector to the eye.
    itself : int
        Shape that does not count, or -1.
    key : int
        See `wide_points.key_of_ray`.
    chosen, ways, stack : ndarray of int, shape (cells,), (WAYS,), (DEPTH,)
        Room to work in.
    room : ndarray, shape (CUTS,)
        The same.
    """
    # A turned normal knows no horizon.
    if not (may_light(light, p, n) or (cover.kind == TURNED_NORMAL and may_light(light, p, v))):
        return 0.0
    whole = diffuse * unhidden(light, tables, p, n, room) if diffuse > 0 else 0.0
    with_lobe = False
    if cover.kind != NOTHING:
        first, second = nodes_along(light, cover, tables, p, n, v)
        with_lobe = first > 0
        if with_lobe:
            whole += whole_lobe(light, cover, tables, p, n, v, first, second)
    bits, is_hiding, value = 0, False, 0.0
    if whole > 0 or (cover.kind != NOTHING and not with_lobe):
        bits, is_hiding = hiding_cells(
            light, number, cells, shapes, nodes, discs, disc_nodes, tables, pitch, p, itself, known, chosen, stack
        )
    if alike and bits != 0:  # places with other cells would ask other points
        bits = -1
    if whole > 0:
        lit = lit_cells(light, number, cells, p)
        if cover.kind == NOTHING:
            lit &= cells_above(light, number, cells, p, n)
        count = bits_of(bits & lit, chosen)
        clear = bits_of(lit & ~bits, chosen[count:])
        value = left_over(
            light,
            cover,
            diffuse,
            with_lobe,
            whole,
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
            clear,
            is_hiding,
            halvings,
            key,
            ways,
            stack,
        )
    if cover.kind != NOTHING and not with_lobe:
        value += sampled_lobe(
            light, cover, shapes, nodes, discs, disc_nodes, tables, p, n, v, itself, bits, halvings, key, stack
        )
    return value
