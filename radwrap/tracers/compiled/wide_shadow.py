"""Whether anything hides a point of a wide light."""

from __future__ import annotations

from typing import Final

from radwrap.tracers.compiled.arrays import WIDE_ZONE, Floats, Nodes, Shapes, Whole, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import hidden
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_shape import hides_itself

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
    if light.kind == WIDE_ZONE and hides_itself(light, p, d):
        return True
    if hidden(shapes, nodes, tables, p[0], p[1], p[2], d[0], d[1], d[2], end, itself, stack):
        return True
    return light.may_be_hidden != 0 and hidden(
        discs, disc_nodes, tables, p[0], p[1], p[2], d[0], d[1], d[2], end, light.own, stack
    )
