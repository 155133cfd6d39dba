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

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.kernel import layer_places, layer_shares

Array = NDArray[np.float64]

# Of the distance between layers: what differs by less from its neighbour goes on as a slope.
_STEP: Final = 0.5


def as_seen(values: Array, magnification: Array, layers: tuple[float, ...]) -> list[Array]:
    """Light of each layer where it is seen; parameters as in `going_on`."""
    return [values * share for share in layer_shares(layers, magnification)]


def going_on(values: Array, magnification: Array, layers: tuple[float, ...]) -> list[Array] | None:
    """Light of each layer, what lies behind laid out to go on.

    Parameters
    ----------
    values, magnification : ndarray, shape (rows, columns)
        Of the central image.
    layers : tuple of float
        Magnifications of the layers, from the farthest on.

    Returns
    -------
    list of ndarray, shape (rows, columns), or None
        They sum up to the values; None where nothing hides another thing.
    """
    if len(layers) == 1:
        return None
    place = layer_places(layers, magnification)
    if not any((np.abs(np.diff(place, axis=axis)) > _STEP).any() for axis in (0, 1)):
        return None
    number = np.rint(place).astype(np.intp)
    light, depth = np.zeros_like(values), magnification.copy()
    for near in np.unique(number)[1:].tolist():
        here, far = number == near, number < near
        light[here], depth[here] = (filled(one, far)[here] for one in (values, magnification))
    near_light, far_light = as_seen(values - light, magnification, layers), as_seen(light, depth, layers)
    return [near + far for near, far in zip(near_light, far_light, strict=True)]


def filled(values: Array, known: NDArray[np.bool_]) -> Array:
    """Values where they are known; elsewhere means of what is known around, the wider the farther that is.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Of any kind where they are not known.
    known : ndarray of bool, shape (rows, columns)
        Where they are; at least one of them.

    Returns
    -------
    ndarray, shape (rows, columns)
    """
    if known.all():
        return values
    rows, columns = (size + size % 2 for size in values.shape)
    weight, total = np.zeros((2, rows, columns))
    weight[: values.shape[0], : values.shape[1]] = known
    total[: values.shape[0], : values.shape[1]] = np.where(known, values, 0.0)
    weights, totals = (one.reshape(rows // 2, 2, columns // 2, 2).sum(axis=(1, 3)) for one in (weight, total))
    there = weights > 0
    coarse = filled(np.divide(totals, weights, out=np.zeros_like(totals), where=there), there)
    fine = _twice(_twice(coarse).T).T[: values.shape[0], : values.shape[1]]
    return np.where(known, values, fine)


def _twice(values: Array) -> Array:
    """Twice as many rows, straight between their middles."""
    wide = np.pad(values, ((1, 1), (0, 0)), mode="edge")
    inside = wide[1:-1]
    return np.stack([3 * inside + wide[:-2], 3 * inside + wide[2:]], axis=1).reshape(-1, values.shape[1]) / 4
