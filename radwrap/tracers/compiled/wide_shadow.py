"""Whether anything hides a point of a wide light."""

from __future__ import annotations

from typing import Final

from radwrap.tracers.compiled.arrays import WIDE_ZONE, Floats, Nodes, Shapes, Whole, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import crossing, hidden, hider
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_shape import hides_itself

NOTHING_HIDES: Final = -1
# A light does not hide itself: a point of it ends so much before.
_BEFORE: Final = 1 - 1e-7


@compiled
def is_hidden(
    light: Wide,
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    tables: Floats,
    p: Place,
    d: Place,
    away: float,
    itself: int,
    stack: Whole,
) -> bool:
    """Whether anything hides the point of a light that lies in a direction, so far away."""
    end = away * _BEFORE
    if hidden(shapes, nodes, tables, p[0], p[1], p[2], d[0], d[1], d[2], end, itself, stack):
        return True
    return hidden_by_lights(light, discs, disc_nodes, tables, p, d, away, stack)


@compiled
def hidden_by(
    shapes: Shapes,
    nodes: Nodes,
    tables: Floats,
    p: Place,
    d: Place,
    away: float,
    itself: int,
    ways: Whole,
    count: int,
    last: int,
    stack: Whole,
) -> int:
    """Number of the target that hides such a point, or `NOTHING_HIDES`.

    What may is found in some nodes, see `wide_ways.find_ways`; the target that hid the `last` point is asked first.
    """
    end = away * _BEFORE
    if last >= 0 and crossing(shapes[last], tables, p[0], p[1], p[2], d[0], d[1], d[2]) < end:
        return last
    for k in range(count):
        stack[k] = ways[k]
    return hider(shapes, nodes, tables, p[0], p[1], p[2], d[0], d[1], d[2], end, itself, count, stack)


@compiled
def hidden_by_lights(
    light: Wide, discs: Shapes, disc_nodes: Nodes, tables: Floats, p: Place, d: Place, away: float, stack: Whole
) -> bool:
    """Whether the light itself or another one hides such a point."""
    if light.kind == WIDE_ZONE and hides_itself(light, p, d):
        return True
    return light.may_be_hidden != 0 and hidden(
        discs, disc_nodes, tables, p[0], p[1], p[2], d[0], d[1], d[2], away * _BEFORE, light.own, stack
    )
