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

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.kernel import layer_places, layer_share, layers_met

Array = NDArray[np.float64]
ByLayer = dict[int, Array]  # of the layers that have any, by their number
Flags = NDArray[np.bool_]

# Of the distance between layers: what differs by less from its neighbour goes on as a slope.
_STEP: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Which layers light belongs to that is seen by the same rays, whatever its source.

    Attributes
    ----------
    shares : dict of ndarray, shape (rows, columns)
        Of each layer in the light where it is seen; of layers that have some.
    hiding : tuple of (ndarray of bool, Filling)
        Where near things hide others, the farthest first, and what goes on there.
    behind : dict of ndarray, shape (rows, columns)
        Of each layer in the light that goes on; none where nothing hides.
    """

    shares: ByLayer
    hiding: tuple[tuple[Flags, Filling], ...]
    behind: ByLayer

    @classmethod
    def of(cls, magnification: Array, layers: tuple[float, ...]) -> Layout:
        """For magnifications of shape (rows, columns), and those of the layers, from the farthest on."""
        if len(layers) == 1:
            return cls(shares_by_layer(magnification, layers), (), {})
        place = layer_places(layers, magnification)
        shares = _shares_at(place)
        if not any((np.abs(np.diff(place, axis=axis)) > _STEP).any() for axis in (0, 1)):
            return cls(shares, (), {})
        number = np.rint(place).astype(np.intp)
        hiding, depth = [], magnification.copy()
        for near in np.unique(number)[1:].tolist():
            here, far = number == near, Filling.of(number < near)
            depth[here] = far.filled(magnification)[here]
            hiding.append((here, far))
        return cls(shares, tuple(hiding), shares_by_layer(depth, layers))

    def going_on(self, values: Array) -> ByLayer | None:
        """As `as_seen`, what lies behind laid out to go on; None where nothing hides another thing."""
        if not self.behind:
            return None
        light = np.zeros_like(values)
        for here, far in self.hiding:
            light[here] = far.filled(values)[here]
        found = as_seen(values - light, self.shares)
        for number, share in self.behind.items():
            found[number] = found.get(number, 0.0) + light * share
        return dict(sorted(found.items()))


def shares_by_layer(magnification: Array, layers: tuple[float, ...]) -> ByLayer:
    """Shares of those layers that have any: a tile shows one or two depths of a scene."""
    if len(layers) == 1:
        return {0: np.ones_like(magnification)}
    return _shares_at(layer_places(layers, magnification))


def _shares_at(places: Array) -> ByLayer:
    return {number: layer_share(places, number) for number in layers_met(places)}


def as_seen(values: Array, shares: ByLayer) -> ByLayer:
    """Light of each layer where it is seen, of values of shape (rows, columns)."""
    return {number: values * share for number, share in shares.items()}


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
