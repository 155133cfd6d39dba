"""Second stage: which candidate is which dot of the grid."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.dots.plane import Matrix, Points, fit_homography, is_regular, jacobian, project

# Share of the step to a neighbour by which a candidate may miss its predicted place: half a step would be
# ambiguous, perspective changes neighbouring steps by less than a tenth.
REACH: Final = 0.3
# The same once a homography is fitted to all.
FITTED_REACH: Final = 0.22
SEEDS: Final = 8
BASES: Final = 3
NEIGHBOURS: Final = 10
# Two steps that are nearly parallel span no lattice; tilt to 60 degrees leaves at least 37 degrees between them.
LEAST_SINE: Final = 0.35
ROUNDS: Final = 4
# Share of the first dot's inverse distance.
NEAR_HORIZON: Final = 1e-3

Index = tuple[int, int]
Step = tuple[float, float]

# Axis and direction of the steps to the four neighbours.
_WAYS: Final = ((0, 1), (0, -1), (1, 1), (1, -1))


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Candidates with their place in the grid.

    Attributes
    ----------
    board : ndarray, shape (n, 2)
        (column, row) of the candidates inside the grid [pitch].
    image : ndarray, shape (n, 2)
        Their (u, v) [px].
    beyond : ndarray, shape (m, 2)
        (column, row) of candidates that continue the lattice outside the
        grid [pitch].
    homography : ndarray, shape (3, 3)
        Board to image.
    """

    board: Points
    image: Points
    beyond: Points
    homography: Matrix

    @property
    def found(self) -> int:
        """Number of dots inside the grid."""
        return len(self.board)


def order(points: Points, rows: int, columns: int) -> Lattice | None:
    """Fit the grid to candidates.

    Row 0 is the top row and column 0 the left column of the board as seen
    with the smallest rotation, which is the rotation in the polar
    decomposition of d(u, v)/d(column, row) at the grid's centre.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Candidates (u, v) [px], strongest first.
    rows, columns : int
        The grid.

    Returns
    -------
    Lattice or None
        The best one; None where candidates form none.
    """
    from scipy.spatial import cKDTree

    if len(points) < 4:
        return None
    tree = cKDTree(points)
    best: Lattice | None = None
    known: dict[frozenset[int], list[dict[Index, int]]] = {}
    # From the middle of the strongest outwards: a dot in the middle has eight neighbours to show the steps.
    likely = points[: rows * columns]
    seeds = np.argsort(np.sum((likely - np.median(likely, axis=0)) ** 2, axis=1), kind="stable")[:SEEDS]
    for seed in seeds:
        for first, second in _bases(points, tree, int(seed)):
            nodes = _completed(points, tree, _grown(points, tree, int(seed), first, second))
            least = max(4, best.found if best else 0)
            if len(nodes) < least:
                continue
            alike = known.setdefault(frozenset(nodes.values()), [])
            if any(_is_turned(nodes, other) for other in alike):
                continue
            alike.append(nodes)
            lattice = _placed(points, nodes, rows, columns, least)
            if lattice is not None and (best is None or _rank(lattice) > _rank(best)):
                best = lattice
            if best is not None and best.found == rows * columns:
                return best
    return best


def _rank(lattice: Lattice) -> tuple[int, int]:
    return lattice.found, len(lattice.beyond)


def _is_turned(nodes: dict[Index, int], other: dict[Index, int]) -> bool:
    """Whether walks over the same candidates differ by turns, mirrors and shifts alone: both fill the grid alike."""
    here = np.array(sorted(nodes, key=nodes.__getitem__))
    there = np.array(sorted(other, key=other.__getitem__))
    steps, others = here - here[0], there - there[0]
    return any((steps @ turn.T == others).all() for turn in _TURNS)


def _bases(points: Points, tree: Any, seed: int) -> list[tuple[Points, Points]]:
    """Pairs of steps from a candidate that most of its surroundings obey."""
    distances, near = tree.query(points[seed], k=min(NEIGHBOURS + 1, len(points)))
    steps, lengths = points[near[1:]] - points[seed], distances[1:]
    around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])
    a, b = np.triu_indices(len(steps), 1)
    area = np.abs(steps[a, 0] * steps[b, 1] - steps[a, 1] * steps[b, 0])
    across = area >= LEAST_SINE * lengths[a] * lengths[b]
    a, b, area = a[across], b[across], area[across]
    expected = points[seed] + around[:, 0, None] * steps[a, None] + around[:, 1, None] * steps[b, None]
    miss, _ = tree.query(expected)
    obeyed = np.sum(miss < REACH * np.minimum(lengths[a], lengths[b])[:, None], axis=1)
    # Of equally obeyed pairs the smallest cell: larger ones skip dots.
    best = np.lexsort((b, a, area, -obeyed))[:BASES]
    return [(steps[a[pair]], steps[b[pair]]) for pair in best]


def _grown(points: Points, tree: Any, seed: int, first: Points, second: Points) -> dict[Index, int]:
    """Walk from dot to dot; each step is predicted from the last one in its direction."""
    seats: list[Step] = [(u, v) for u, v in points.tolist()]
    nodes: dict[Index, int] = {(0, 0): seed}
    taken = {seed}
    bases = (float(first[0]), float(first[1])), (float(second[0]), float(second[1]))
    steps: dict[Index, tuple[Step, Step]] = {(0, 0): bases}
    waiting = [(0, 0)]
    while waiting:
        # All that wait are looked up together: where they look hangs on themselves alone.
        misses, candidates = tree.query([_ahead(seats[nodes[here]], steps[here]) for here in waiting])
        wave, waiting = waiting, []
        for here, missed, found in zip(wave, misses.tolist(), candidates.tolist(), strict=True):
            (u, v), (along, across) = seats[nodes[here]], steps[here]
            reach = REACH * min(math.hypot(*along), math.hypot(*across))
            for (axis, way), miss, candidate in zip(_WAYS, missed, found, strict=True):
                there = (here[0] + way, here[1]) if axis == 0 else (here[0], here[1] + way)
                if there in nodes or miss > reach or candidate in taken:
                    continue
                taken.add(candidate)
                nodes[there] = candidate
                # Half the news: one misplaced candidate must not bend the walk.
                (du, dv), (au, av) = steps[here][axis], seats[candidate]
                bent = (du + way * (au - u)) / 2, (dv + way * (av - v)) / 2
                steps[there] = (bent, across) if axis == 0 else (along, bent)
                waiting.append(there)
    return nodes


def _ahead(seat: Step, steps: tuple[Step, Step]) -> list[Step]:
    """Where the four neighbours should be."""
    return [(seat[0] + way * steps[axis][0], seat[1] + way * steps[axis][1]) for axis, way in _WAYS]


def _completed(points: Points, tree: Any, nodes: dict[Index, int]) -> dict[Index, int]:
    """Fit a homography, drop what does not obey it, add what does."""
    for _ in range(ROUNDS):
        if len(nodes) < 4:
            return nodes
        indices = np.array(list(nodes), dtype=np.float64)
        if np.linalg.matrix_rank(indices - indices.mean(axis=0)) < 2:
            return {}
        matrix = fit_homography(indices, points[list(nodes.values())])
        # No dot may lie near the horizon, where steps grow beyond all bounds.
        if not np.isfinite(matrix).all() or (indices @ matrix[2, :2] + 1 < NEAR_HORIZON).any():
            return {}
        low, high = indices.min(axis=0) - 1, indices.max(axis=0) + 1
        box = np.array(
            list(itertools.product(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))), dtype=np.float64
        )
        box = box[box @ matrix[2, :2] + 1 >= NEAR_HORIZON]
        if len(box) == 0:
            return {}
        pitch = np.linalg.norm(jacobian(matrix, box), axis=1).min(axis=1)
        miss, candidates = tree.query(project(matrix, box))
        nearest_first = np.argsort(miss)
        near = nearest_first[miss[nearest_first] <= FITTED_REACH * pitch[nearest_first]]
        of: dict[int, Index] = {}  # each candidate belongs to the place that it is nearest to
        for candidate, (i, j) in zip(candidates[near].tolist(), box[near].tolist(), strict=True):
            of.setdefault(candidate, (int(i), int(j)))
        again = _connected({index: candidate for candidate, index in of.items()})
        if again.keys() == nodes.keys():
            return again
        nodes = again
    return nodes


def _connected(nodes: dict[Index, int]) -> dict[Index, int]:
    """The largest part that hangs together: a stray candidate beyond a gap is none of the grid's."""
    left, largest = set(nodes), set[Index]()
    while left:
        part, waiting = set[Index](), [left.pop()]
        while waiting:
            i, j = waiting.pop()
            part.add((i, j))
            for near in itertools.product((i - 1, i, i + 1), (j - 1, j, j + 1)):
                if near in left:
                    left.remove(near)
                    waiting.append(near)
        largest = max(largest, part, key=len)
    return {index: nodes[index] for index in nodes if index in largest}


def _bases_of_the_plane() -> tuple[NDArray[np.int64], ...]:
    """Changes of the lattice's basis: the steps that the walk took may be diagonals of the grid."""
    found = []
    for a, b, c, d in itertools.product(range(-2, 3), repeat=4):
        # Turned by 90 degrees the steps (first, second) are (second, -first): of four turns one stands for all.
        turns = ((a, b, c, d), (c, d, -a, -b), (-a, -b, -c, -d), (-c, -d, a, b))
        if a * d - b * c == 1 and turns[0] == max(turns):
            found.append(np.array([[a, b], [c, d]]))
    return tuple(found)


_PLANE_BASES: Final = _bases_of_the_plane()
# Quarter turns and mirrors.
_TURNS: Final = tuple(
    np.array(rows)[:, axes]
    for rows in itertools.product(((1, 0), (-1, 0)), ((0, 1), (0, -1)))
    for axes in ([0, 1], [1, 0])
)


def _placed(points: Points, nodes: dict[Index, int], rows: int, columns: int, least: int) -> Lattice | None:
    """Turn lattice indices into rows and columns: the change of basis that fills the grid best.

    None where that puts fewer than `least` of them into the grid.
    """
    indices = np.array(list(nodes), dtype=np.int64)
    image = points[list(nodes.values())]
    best: tuple[int, NDArray[np.int64]] | None = None
    for basis in _least_sheared_first(indices, image):
        changed = indices @ basis.T
        for wide, high in {(columns, rows), (rows, columns)}:
            corner, inside = _fullest(changed, wide, high)
            # What lies outside counts against: the right basis of a clean picture leaves nothing there.
            value = 2 * inside - len(nodes)
            if best is None or value > best[0]:
                best = value, changed - corner
    if best is None or best[0] + len(nodes) < 2 * least:
        return None
    return _turned(best[1], image, rows, columns)


def _least_sheared_first(indices: NDArray[np.int64], image: Points) -> list[NDArray[np.int64]]:
    """Changes of basis, those with the shortest steps in the image first: others may fill a narrow grid as well."""
    about, seen = indices - indices.mean(axis=0), image - image.mean(axis=0)
    steps = np.linalg.lstsq(about, seen, rcond=None)[0]
    return sorted(_PLANE_BASES, key=lambda basis: float(np.sum((np.linalg.inv(basis).T @ steps) ** 2)))


def _fullest(indices: NDArray[np.int64], wide: int, high: int) -> tuple[NDArray[np.int64], int]:
    """Corner of the window of wide x high that holds most indices, and how many."""
    low = indices.min(axis=0)
    shape = indices.max(axis=0) - low + 1
    filled = np.zeros((int(shape[0]) + 2 * wide, int(shape[1]) + 2 * high), dtype=np.int64)
    filled[tuple((indices - low + (wide, high)).T)] = 1
    total = np.pad(filled.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    counts = total[wide:, high:] - total[:-wide, high:] - total[wide:, :-high] + total[:-wide, :-high]
    i, j = np.unravel_index(int(np.argmax(counts)), counts.shape)
    return low + np.array([int(i) - wide, int(j) - high]), int(counts[i, j])


def _turned(indices: NDArray[np.int64], image: Points, rows: int, columns: int) -> Lattice | None:
    """Of the turns that fit the grid, the one with the smallest rotation."""
    best: tuple[float, Lattice] | None = None
    for swap, flip_first, flip_second in itertools.product((False, True), repeat=3):
        size = (rows, columns) if swap else (columns, rows)
        turned = indices.copy()
        for axis, flip in enumerate((flip_first, flip_second)):
            if flip:
                turned[:, axis] = size[axis] - 1 - turned[:, axis]
        if swap:
            turned = turned[:, ::-1]
        inside = ((turned >= 0) & (turned < (columns, rows))).all(axis=1)
        board = turned[inside].astype(np.float64)
        if inside.sum() < 4 or np.linalg.matrix_rank(board - board.mean(axis=0)) < 2:
            continue
        matrix = fit_homography(board, image[inside])
        if not is_regular(matrix, board):
            continue
        (((a, b), (c, d)),) = jacobian(matrix, np.array([[(columns - 1) / 2, (rows - 1) / 2]]))
        rotation = abs(math.atan2(c - b, a + d))
        lattice = Lattice(board, image[inside], turned[~inside].astype(np.float64), matrix)
        if best is None or (lattice.found, -rotation) > (best[1].found, -best[0]):
            best = rotation, lattice
    return None if best is None else best[1]
