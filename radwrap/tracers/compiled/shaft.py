"""What may stand between any places of two boxes: one walk down a tree of boxes in place of one for each ray."""

from __future__ import annotations

from radwrap.tracers.compiled.arrays import Cluster, Node, Nodes, Whole, Wide
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import inverse_of

# Least and largest places of a box.
Box = tuple[float, float, float, float, float, float]
# Of each axis: least and largest place of the first box, the ways from both to the second, and the inverses of these.
_Axis = tuple[float, float, float, float, float, float]
Shaft = tuple[_Axis, _Axis, _Axis]


@compiled
def box_of(there: Cluster | Wide) -> Box:
    """Least and largest places of a cluster of lights, or of a wide light."""
    return there.x0, there.y0, there.z0, there.x1, there.y1, there.z1


@compiled
def shaft_between(here: Box, there: Box) -> Shaft:
    """All rays from one box to another.

    What they may pass lies, at each share of their way, in a box that changes with it from the one to the other.
    """
    return (
        _along(here[0], here[3], there[0], there[3]),
        _along(here[1], here[4], there[1], there[4]),
        _along(here[2], here[5], there[2], there[5]),
    )


@compiled
def _along(low: float, high: float, there_low: float, there_high: float) -> _Axis:
    a, b = there_low - low, there_high - high
    return low, high, a, b, inverse_of(a), inverse_of(b)


@compiled
def next_leaf(nodes: Nodes, shaft: Shaft, height: int, stack: Whole) -> tuple[int, int]:
    """A node without others in it that a shaft may pass, or -1, and what is left of the stack.

    Ask first with 1 and the number of the tree's root on the stack, then with what is left. Only "none" is sure.
    """
    while height:
        height -= 1
        node = stack[height]
        box = nodes[node]
        if not may_pass(shaft, box):
            continue
        if box.count:
            return node, height
        stack[height], stack[height + 1] = box.second, node + 1
        height += 2
    return -1, 0


@compiled
def may_pass(shaft: Shaft, box: Node) -> bool:
    """Whether a shaft may pass a node's box; only "no" is sure."""
    near, far = _overlap(box.x0, box.x1, shaft[0], 0.0, 1.0)
    near, far = _overlap(box.y0, box.y1, shaft[1], near, far)
    near, far = _overlap(box.z0, box.z1, shaft[2], near, far)
    return near <= far


@compiled
def _overlap(least: float, most: float, axis: _Axis, near: float, far: float) -> tuple[float, float]:
    """Shares of the way, within those given, at which a shaft meets [least, most] on an axis."""
    x0, x1, a, b, ia, ib = axis
    low, high = least - x1, most - x0
    if a >= 0:
        far = min(far, high * ia)
    else:
        near = max(near, high * ia)
    if b >= 0:
        near = max(near, low * ib)
    else:
        far = min(far, low * ib)
    return near, far
