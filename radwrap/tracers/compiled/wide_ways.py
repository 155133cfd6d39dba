"""Where walks down a tree begin: what may stand between a point and a wide light lies in few of its boxes.

A ray that leaves a surface goes down to where it begins, past boxes that hold its first place, for nothing: what lies
there is the surface. Of all points of a light that is asked once.
"""

from __future__ import annotations

from typing import Final

from radwrap.tracers.compiled.arrays import Cluster, Node, Nodes, Shapes, Whole, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.shadows import aside
from radwrap.tracers.compiled.shaft import box_of, may_pass, shaft_between
from radwrap.tracers.compiled.wide_contour import Place

# Boxes where walks may begin; where there would be more, they begin at the root.
WAYS: Final = 32


@compiled
def find_ways(light: Wide, shapes: Shapes, nodes: Nodes, p: Place, itself: int, ways: Whole, stack: Whole) -> int:
    """Fill in nodes that hold all that may stand between a point and a light; how many they are.

    Parameters
    ----------
    light : Cluster or Wide
        The light: only its box counts.
    shapes, nodes
        What may stand between.
    p : tuple of float
        The point.
    itself : int
        Shape that does not count, or -1.
    ways : ndarray of int, shape (WAYS,)
        To be filled.
    stack : ndarray of int, shape (DEPTH,)
        Room to work in.
    """
    if len(shapes) <= (itself >= 0):
        return 0
    shaft = shaft_between((p[0], p[1], p[2], p[0], p[1], p[2]), box_of(light))
    count, height = 0, 1
    stack[0] = 0
    while height:
        height -= 1
        number = stack[height]
        box = nodes[number]
        if not may_pass(shaft, box):
            continue
        if box.count == 0 and _holds(box, p):
            stack[height], stack[height + 1] = box.second, number + 1
            height += 2
        elif box.count == 0 or _may_hide(light, shapes, box, p, itself):
            if count == WAYS:
                ways[0] = 0
                return 1
            ways[count] = number
            count += 1
    return count


@compiled
def _holds(box: Node, p: Place) -> bool:
    return box.x0 <= p[0] <= box.x1 and box.y0 <= p[1] <= box.y1 and box.z0 <= p[2] <= box.z1


@compiled
def _may_hide(light: Cluster | Wide, shapes: Shapes, leaf: Node, p: Place, itself: int) -> bool:
    """Whether any shape of a node without others in it but one may stand between a point and a light."""
    for i in range(leaf.first, leaf.first + leaf.count):
        if i != itself and not aside(shapes[i], light, p[0], p[1], p[2], p[0], p[1], p[2], True):
            return True
    return False
