"""Light at many depths in as few images as waves need to gather it.

Most of what a camera sees is flat and square to its axis, or nearly one depth
in a tile: a plate, a belt, a light. Such light lies at one place between two
layers, and one transform gathers it by the weights between theirs. What is
left, along edges and on walls, may be of many layers with few cells each:
these are added one by one. What is of many cells is transformed layer by layer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.transforms import Room
from radwrap.imaging.tolerance.wave_behind import ByLayer, Laid, by_layer

Array = NDArray[np.float64]
Whole = NDArray[np.intp]

_NO_LIGHT: Final = 1e-9  # of the brightest layer: what rounding leaves of a flat face in the layer beside its own
_LOOKED: Final = 8  # rows, and columns, of which one tells at which depths much light may lie
_MUCH: Final = 0.02  # of what was looked at, and is lit
_MOST_EVEN: Final = 4  # depths of one image
# Of the distance between two layers: magnifications are kept as float32, so that a flat face is no more even.
_EVEN: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """Light of one depth.

    Attributes
    ----------
    place : float
        Number of the layer that it lies at, or between which two.
    values : ndarray, shape (rows, columns)
        [W m^-2 sr^-1]
    lit : tuple of int
        First row that has any, and last row + 1.
    """

    place: float
    values: Array
    lit: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class FewCells:
    """Light of few cells, each at one layer.

    Attributes
    ----------
    rows, columns, layers : ndarray of int, shape (n,)
        Where.
    light : ndarray, shape (n,)
        [W m^-2 sr^-1]
    """

    rows: Whole
    columns: Whole
    layers: Whole
    light: Array


@dataclass(frozen=True, slots=True, eq=False)
class Parted:
    """Light of many depths.

    Attributes
    ----------
    sheets : tuple of Sheet
        What is transformed.
    few : FewCells, optional
        What is not.
    """

    sheets: tuple[Sheet, ...]
    few: FewCells | None = None


def lit_layers(light: ByLayer) -> ByLayer:
    """Those layers that have light."""
    brightest = {number: max(float(one.max()), -float(one.min())) for number, one in light.items()}
    least = _NO_LIGHT * max(brightest.values())
    return {number: light[number] for number, most in brightest.items() if most > least}


def by_layers(laid: Laid) -> Parted:
    """Light layer by layer, without the compiler."""
    return Parted(tuple(Sheet(number, one, (0, len(one))) for number, one in lit_layers(by_layer(laid)).items()))


def parted(laid: Laid, layers: int, few: int, room: Room) -> Parted:
    """Light by depths at which much of it lies, and by layers; this needs the compiler.

    Parameters
    ----------
    laid : Laid
        What.
    layers : int
        How many there are.
    few : int
        Cells of a layer that take no longer by themselves than a transform.
    room : Room
        For the sheets.
    """
    if any(places is None for _, places in laid):
        return by_layers(laid)
    from radwrap.imaging.tolerance.sorted_light import counted, sorted_out

    terms = [(values, places) for values, places in laid if places is not None]
    shape = terms[0][0].shape
    even = np.unique(np.concatenate([_even_places(*term) for term in terms]))
    even = even[np.diff(even, prepend=-1.0) > _EVEN]
    of_even, of_layers = np.zeros(len(even), dtype=np.intp), np.zeros(layers + 1, dtype=np.intp)
    for values, places in terms:
        counted(values, places, even, _EVEN, of_even, of_layers)
    # Layers that are transformed anyway take even light that lies between two of them.
    whole = of_layers > few
    number = np.floor(even).astype(np.intp)
    alone = (of_even > 0) & ~(whole[number] & (whole[number + 1] | (even == number)))
    kept = alone | (of_even == 0)
    even, alone = even[kept], alone[kept]
    place_of = np.concatenate([np.flatnonzero(whole).astype(np.float64), even[alone]])
    to_layers = np.where(whole, np.cumsum(whole) - 1, -1)
    to_even = np.where(alone, np.count_nonzero(whole) + np.cumsum(alone) - 1, -1)
    sheets, spans = room.arrays(len(place_of), shape, np.float64), np.zeros((len(place_of), 2), dtype=np.intp)
    sheets[:], spans[:, 0] = 0.0, shape[0]
    most = int(of_layers[~whole].sum())
    rows, columns, at = np.empty((3, most), dtype=np.intp)
    light = np.empty(most)
    found = 0
    for values, places in terms:
        sorts = even, _EVEN, to_even, to_layers
        found = sorted_out(values, places, *sorts, sheets, spans, rows, columns, at, light, found)
    some = FewCells(rows[:found], columns[:found], at[:found], light[:found]) if found else None
    each = zip(place_of.tolist(), sheets, spans.tolist(), strict=True)
    return Parted(tuple(Sheet(place, one, (low, high)) for place, one, (low, high) in each if low < high), some)


def _even_places(values: Array, places: Array) -> Array:
    """Places at which much light lies, by a look at some cells."""
    look = slice(_LOOKED // 2, None, _LOOKED)
    seen = places[look, look][values[look, look] != 0]
    found, counts = np.unique(seen, return_counts=True)
    most = np.argsort(counts)[::-1][:_MOST_EVEN]
    much = most[counts[most] > max(1.0, _MUCH * seen.size)]
    return np.asarray(found[much])
