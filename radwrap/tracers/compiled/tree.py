"""A tree of boxes over shapes: halved where the surface area heuristic says (MacDonald and Booth 1990)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.compiled.arrays import Floats, Node, Nodes, Whole, rows
from radwrap.tracers.compiled.compiler import compiled_with_memory

_BINS: Final = 16
_LEAF: Final = 4  # shapes that are not worth another box
_LARGEST_LEAF: Final = 16  # more are halved, whatever it costs: many shapes in one place
# Deeper than any tree of halves; each level holds one node on a walk's stack.
DEPTH: Final = 128


def tree_of(low: Floats, high: Floats) -> tuple[Whole, NDArray[np.void]]:
    """Order of shapes, and the nodes of their tree.

    Parameters
    ----------
    low, high : ndarray, shape (n, 3)
        Boxes of the shapes.
    """
    count = len(low)
    order, nodes = np.arange(count, dtype=np.int64), rows(Node, 2 * count)
    used = _grow(low, high, (low + high) / 2, order, nodes) if count else 0
    return order, nodes[:used].copy()


@compiled_with_memory
def _grow(low: Floats, high: Floats, middle: Floats, order: Whole, nodes: Nodes) -> int:
    """Fill the nodes, first children first; how many there are."""
    waiting = np.empty(
        (DEPTH, 4), dtype=np.int64
    )  # first and end of the shapes, parent whose second child it is, depth
    waiting[0] = (0, len(order), -1, 0)
    height, used = 1, 0
    box = np.empty(6)
    while height:
        height -= 1
        first, end, parent, depth = waiting[height]
        node, used = used, used + 1
        if parent >= 0:
            nodes[parent].second = node
        box[:3], box[3:] = np.inf, -np.inf
        for place in range(first, end):
            _widen(box, low[order[place]], high[order[place]])
        here = nodes[node]
        here.x0, here.y0, here.z0, here.x1, here.y1, here.z1 = box[0], box[1], box[2], box[3], box[4], box[5]
        # A walk down a tree of halves is short: what is left when few levels remain is cut in the middle.
        cut = _cut(low, high, middle, order, first, end, DEPTH - depth < 64)
        if cut == end:
            here.first, here.count = first, end - first
            continue
        waiting[height] = (cut, end, node, depth + 1)
        waiting[height + 1] = (first, cut, -1, depth + 1)
        height += 2
    return used


@compiled_with_memory
def _cut(low: Floats, high: Floats, middle: Floats, order: Whole, first: int, end: int, halve: bool) -> int:
    """Sort shapes to both sides of the best cut; where the second side begins, or `end` where none is worth it."""
    count = end - first
    if count <= 1:
        return end
    best, best_axis, best_bin, best_low, best_width = np.inf, -1, 0, 0.0, 0.0
    numbers = np.empty(_BINS, dtype=np.int64)
    bounds = np.empty((_BINS, 6))
    right = np.empty(_BINS)
    for axis in range(3):
        least, most = np.inf, -np.inf
        for place in range(first, end):
            least = min(least, middle[order[place], axis])
            most = max(most, middle[order[place], axis])
        width = (most - least) / _BINS
        if not width > 0:
            continue
        numbers[:] = 0
        bounds[:, :3], bounds[:, 3:] = np.inf, -np.inf
        for place in range(first, end):
            shape = order[place]
            b = min(int((middle[shape, axis] - least) / width), _BINS - 1)
            numbers[b] += 1
            _widen(bounds[b], low[shape], high[shape])
        around = np.array([np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf])
        behind = 0
        for b in range(_BINS - 1, 0, -1):
            behind += numbers[b]
            _widen(around, bounds[b, :3], bounds[b, 3:])
            right[b] = _half_area(around) * behind
        around[:3], around[3:] = np.inf, -np.inf
        before = 0
        for b in range(1, _BINS):
            before += numbers[b - 1]
            _widen(around, bounds[b - 1, :3], bounds[b - 1, 3:])
            cost = _half_area(around) * before + right[b]
            if 0 < before < count and cost < best:
                best, best_axis, best_bin, best_low, best_width = cost, axis, b, least, width
    around = np.array([np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf])
    for place in range(first, end):
        _widen(around, low[order[place]], high[order[place]])
    if best_axis < 0 or halve:
        return end if count <= _LARGEST_LEAF else first + count // 2
    if count <= _LEAF and best >= _half_area(around) * (count - 1):  # a box costs as much as a shape
        return end
    if count <= _LARGEST_LEAF and best >= _half_area(around) * count:
        return end
    place, last = first, end
    while place < last:
        if min(int((middle[order[place], best_axis] - best_low) / best_width), _BINS - 1) < best_bin:
            place += 1
        else:
            last -= 1
            order[place], order[last] = order[last], order[place]
    return place


@compiled_with_memory
def _widen(box: Floats, low: Floats, high: Floats) -> None:
    for axis in range(3):
        box[axis] = min(box[axis], low[axis])
        box[3 + axis] = max(box[3 + axis], high[axis])


@compiled_with_memory
def _half_area(box: Floats) -> float:
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    if x < 0:
        return 0.0
    return x * y + y * z + z * x
