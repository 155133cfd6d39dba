"""Which layer of depth light belongs to where a near thing hides a far one.

At the edge of what hides, the central image steps from the near thing's light
to that of what lies behind. Waves blur that step as they blur the near edge: a
field that comes from a place on the sensor and is cut by the edge loses what
the edge takes of it at the edge's own depth, and what passes falls on what lies
behind, wherever the edge bends it. So light is laid out as if what lies behind
went on behind the near thing, and the near thing had the difference. For what
is even behind the edge that is exact; how far things differ by their light
being laid out where it is seen is how far this may be off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.around import least_around, most_around, sum_around
from radwrap.imaging.methods.kernel import layer_places, layer_share, layers_met

Array = NDArray[np.float64]
ByLayer = dict[int, Array]  # of the layers that have any, by their number
# Light and the numbers of the layers that it lies at or between; of one layer none are told.
Laid = tuple[tuple[Array, Array | None], ...]
Flags = NDArray[np.bool_]

# Of the distance between layers: what differs by less from its neighbour goes on as a slope. Near a larger step, which
# may be the edge of a wall, so does what differs by less than a share of it.
_STEP: Final = 0.5
_OF_LARGER: Final = 0.2
_NEAR: Final = 65  # cells, of a square
_MOST_CROSSED: Final = 2  # cells in a row that one edge crosses
_FEW: Final = 256  # cells: as many as lie between near and far where an edge crosses them


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """Where something hides what is farther.

    Attributes
    ----------
    near : ndarray of bool, shape (rows, columns)
        Where it is seen.
    step : ndarray, shape (rows, columns)
        By how much it is nearer there than what is seen beside it, in shares of the largest step.
    far : Filling
        Of what lies farther; goes on there.
    """

    near: Flags
    step: Array
    far: Filling


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Which layers light belongs to that is seen by the same rays, whatever its source.

    Attributes
    ----------
    seen : ndarray, shape (rows, columns)
        Number of the layer at which light is seen, or between which two.
    place : ndarray, shape (rows, columns)
        Of that in which things lie.
    edges : tuple of Edge
        Where something hides another thing, the farthest first.
    apart : float
        By how much magnifications differ at an edge, at most.
    behind : ndarray, shape (rows, columns), optional
        At which the light lies that goes on where something hides it; none where nothing hides, or where what lies
        behind is seen in crossed cells only.
    hides : bool
        Whether anything does.
    cuts : dict
        What `uneven` has in common for all light, by its reach: of those that `cut_within` was given.
    """

    seen: Array
    place: Array
    edges: tuple[Edge, ...] = ()
    apart: float = 0.0
    behind: Array | None = None
    hides: bool = False
    cuts: Mapping[int, tuple[tuple[_Cut, ...], Array]] = field(default_factory=dict)

    @classmethod
    def of(cls, magnification: Array, layers: tuple[float, ...]) -> Layout:
        """For magnifications of shape (rows, columns), and those of the layers, from the farthest on.

        Cells beside an edge belong to what is near. An edge may cross them: what lies behind is then seen in a part of
        them, and what is near adds all that the rest of them lacks.
        """
        if len(layers) == 1:
            return cls(nowhere := np.zeros_like(magnification), nowhere)
        seen = place = layer_places(layers, magnification)
        if not _may_step(place):
            return cls(seen, place)
        least = _least_steps(place)
        for _ in range(_MOST_CROSSED):
            nearest = most_around(place, 3)
            place = np.where(nearest - least_around(place, 3) > least, nearest, place)
        number = _parted(place, _between(*_steps(place, least)))
        step = place - least_around(place, 3)
        step[step <= least] = 0.0
        edges, depth, largest = [], magnification.copy(), float(step.max())
        for near in np.flatnonzero(np.bincount(number.ravel()))[1:].tolist():
            edge = Edge(here := number == near, np.where(here, step, 0.0) / largest, Filling.of(number < near))
            depth[here] = edge.far.filled(magnification)[here]
            edges.append(edge)
        if not edges:  # what lies behind is seen in crossed cells only
            return cls(seen, place, hides=True)
        apart = largest * (layers[1] - layers[0])
        return cls(seen, place, tuple(edges), apart, layer_places(layers, depth), hides=True)

    def going_on(self, values: Array) -> Laid | None:
        """Light where it is seen, what lies behind laid out to go on; None where nothing hides another thing."""
        if not self.hides:
            return None
        if self.behind is None:
            return ((values, self.place),)
        light = np.zeros_like(values)
        for edge in self.edges:
            light[edge.near] = edge.far.filled(values)[edge.near]
        return (values - light, self.place), (light, self.behind)

    def cut_within(self, reaches: Iterable[int]) -> Layout:
        """Itself, with what is cut within so many cells of its edges."""
        cuts = {
            reach: (tuple(_Cut.of(edge, reach) for edge in self.edges), most_around(self.place, 2 * reach + 1))
            for reach in set(reaches)
        }
        return replace(self, cuts=cuts)

    def uneven(self, values: Array, reach: int) -> tuple[Laid, Laid]:
        """What lies behind, within so many cells of an edge, less its mean there: as far as it is, and as near.

        An edge cuts some of the opening off from such light, and blurs it as neither depth does.
        """
        cuts, near = self.cuts[reach]
        found = np.zeros_like(values)
        for cut in cuts:
            light = values[cut.part]
            sums = sum_around(np.where(cut.known, light, 0.0), 2 * reach + 1)[cut.where]
            found[cut.part][cut.where] += cut.share * (light[cut.where] - sums / cut.counts)
        return ((found, self.seen),), ((found, near),)


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """Where an edge cuts light that comes from behind.

    Attributes
    ----------
    part : tuple of slice
        The rectangle around it.
    known, where : ndarray of bool, shape (rows, columns)
        Where in that what lies behind is seen, and where it is cut.
    share, counts : ndarray, shape (cut,)
        By how much, and how many cells around show what lies behind.
    """

    part: tuple[slice, slice]
    known: Flags
    where: Flags
    share: Array
    counts: Array

    @classmethod
    def of(cls, edge: Edge, reach: int) -> _Cut:
        """Within so many cells of an edge."""
        part, size = _box(edge.step > 0, 2 * reach), 2 * reach + 1
        known, share = edge.far.known[part], most_around(edge.step[part], size)
        where = known & (share > 0)
        return cls(part, known, where, share[where], sum_around(known.astype(float), size)[where])


def _box(flags: Flags, around: int) -> tuple[slice, slice]:
    """The rectangle that holds all flags, of which there is one at least, and so many cells around them."""
    ends = (np.flatnonzero(flags.any(axis=axis))[[0, -1]] for axis in (1, 0))
    rows, columns = (slice(max(0, int(first) - around), int(last) + around + 1) for first, last in ends)
    return rows, columns


def _may_step(place: Array) -> bool:
    """Whether cells beside each other, or beside one that an edge crosses, differ by a step."""
    return any(
        bool((np.abs(cells[apart:] - cells[:-apart]) > _STEP).any()) for cells in (place, place.T) for apart in (1, 2)
    )


def _least_steps(place: Array) -> Array:
    """What is a step at each place: more than half a layer, and than a wall rises in a cell near a larger one."""
    across = most_around(place, 3) - least_around(place, 3)
    return np.asarray(np.maximum(_STEP, _OF_LARGER * most_around(across, _NEAR)))


def _steps(place: Array, least: Array) -> tuple[Array, Array]:
    """Places that lie beside each other at a step: the farther and the nearer of each two."""
    beside = [
        (one[1:], one[:-1], np.maximum(most[1:], most[:-1])) for one, most in ((place, least), (place.T, least.T))
    ]
    both = np.concatenate([np.stack((a, b))[:, np.abs(a - b) > most] for a, b, most in beside], axis=1)
    far, near = np.sort(both, axis=0)
    return far, near


def _between(far: Array, near: Array) -> list[float]:
    """Places between those at steps, as few as part them all, the farthest first."""
    found = list[float]()
    while far.size:
        least = near.min()
        parted = far < least
        found.append(float(far[parted].max() + least) / 2)
        far, near = far[~parted], near[~parted]
    return found


def _parted(place: Array, between: list[float]) -> NDArray[np.intp]:
    """Between which of them each place lies; few cells, which an edge crosses, lie with what is nearer."""
    number = np.digitize(place, between)
    counts = np.bincount(number.ravel(), minlength=len(between) + 1)
    # Of the farthest there may be few.
    goes = [here for here in range(1, len(between)) if counts[here] < _FEW]
    for here in goes:
        number[number == here] = here + 1
    return number


def places_seen(magnification: Array | None, layers: tuple[float, ...]) -> Array | None:
    """Numbers of the layers that light of some magnifications lies at or between; of one layer none are told."""
    return None if magnification is None or len(layers) == 1 else layer_places(layers, magnification)


def by_layer(laid: Laid) -> ByLayer:
    """Light of each layer, of those that may have any: a tile shows one or two depths of a scene."""
    found = ByLayer()
    for values, places in laid:
        for number in layers_met(places):
            light = values if places is None else values * layer_share(places, number)
            found[number] = found[number] + light if number in found else light
    return dict(sorted(found.items()))


@dataclass(frozen=True, slots=True, eq=False)
class Filling:
    """Where values are known, and by what they are filled elsewhere: half the size, and so on until all is known.

    Attributes
    ----------
    known : ndarray of bool, shape (rows, columns)
        Where they are; at least one of them.
    weights : ndarray, shape (half the rows, half the columns)
        How many of four are.
    coarser : Filling, optional
        Of means of four; None where all is known.
    """

    known: Flags
    weights: Array
    coarser: Filling | None

    @classmethod
    def of(cls, known: Flags) -> Filling:
        """For what is known."""
        if known.all():
            return cls(known, np.empty((0, 0)), None)
        weights = _fours(known.astype(np.float64))
        return cls(known, weights, cls.of(weights > 0))

    def filled(self, values: Array) -> Array:
        """Values where they are known; elsewhere means of what is known around, the wider the farther that is."""
        if self.coarser is None:
            return values
        totals = _fours(np.where(self.known, values, 0.0))
        coarse = np.divide(totals, self.weights, out=np.zeros_like(totals), where=self.coarser.known)
        fine = _twice(_twice(self.coarser.filled(coarse)).T).T[: values.shape[0], : values.shape[1]]
        return np.where(self.known, values, fine)


def _fours(values: Array) -> Array:
    """Sums of squares of four."""
    whole = np.pad(values, [(0, size % 2) for size in values.shape])
    rows = whole[::2] + whole[1::2]
    return np.asarray(rows[:, ::2] + rows[:, 1::2])


def _twice(values: Array) -> Array:
    """Twice as many rows, straight between their middles."""
    found = np.empty((len(values), 2, values.shape[1]))
    np.multiply(values[:, np.newaxis], 0.75, out=found)
    found[1:, 0] += values[:-1] / 4
    found[:-1, 1] += values[1:] / 4
    found[0, 0] += values[0] / 4
    found[-1, 1] += values[-1] / 4
    return found.reshape(-1, values.shape[1])
