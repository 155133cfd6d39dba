"""Closed forms of a blurred step on pixels (Eqs. 9 and 10), and of its antiderivatives.

With x^n/n! times the step on the bright side, the disc's blur gives E_n, the n-th antiderivative of Eq. 9; the
pixel's mean of that is a second difference of E_(n+2), for every angle of the edge.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CACHED: Final = 1024  # pixels of which all corners fit the processor's cache together
NARROW_BOX: Final = 1e-3  # px; a pixel's shorter side as seen by the edge counts as 0: off by b^2/6 E'', 2e-7


def disc_edge(distance: Array, radius: float, order: int = 0) -> Array:
    """Blur of x^n/n! times the step at 0 by a disc: Eq. 9 for order 0, its n-th antiderivative above.

    Parameters
    ----------
    distance : ndarray
        x from the edge, positive on the bright side [px].
    radius : float
        Of the disc [px], above 0.
    order : int
        n, 0 to 6.

    Returns
    -------
    ndarray
        E_n [px^n]; 0 for x < -radius.
    """
    return antiderivatives(distance, radius, (order,))[0]


def antiderivatives(distance: Array, radius: float, orders: tuple[int, ...]) -> list[Array]:
    """E_n(x) = int_{t<x} (x - t)^n/n! k(t) dt, each from the two before it.

    With E_(-1) = k, from (1 - t^2) k' + t k = 0 integrated m = n times:
    n (n + 2) E_n = (1 - x^2) E_(n-2) + (2 n + 1) x E_(n-1), at all x.
    """
    x = distance / radius
    s = np.clip(x, -1.0, 1.0)
    chord = np.sqrt(1 - s * s)
    rest = 1 - x * x
    before, last = 2 / math.pi * chord, 1 - (np.arccos(s) - s * chord) / math.pi
    found = {0: last}
    for n in range(1, max(orders) + 1):
        before, last = last, (rest * before + (2 * n + 1) * (x * last)) / (n * (n + 2))
        found[n] = last
    return [radius**n * found[n] for n in orders]


def pixel_edge(distance: Array, radius: float, along_u: float, along_v: float, orders: int = 1) -> list[Array]:
    """Mean of E_0 to E_(orders-1) over a pixel whose sides are, along the edge's normal, along_u and along_v long.

    Parameters
    ----------
    distance : ndarray
        Of the pixel's centre from the edge [px], positive on the bright side.
    radius : float
        Of the disc of blur [px].
    along_u, along_v : float
        Pixel width times |cos|, height times |sin| of the normal's angle [px].
    orders : int
        How many, 1 to 5.

    Returns
    -------
    list of ndarray
        Mean of E_n [px^n].
    """
    a, b = max(along_u, along_v) / 2, min(along_u, along_v) / 2
    if b < NARROW_BOX / 2:
        wanted = tuple(range(1, orders + 1))
        ends = _all_at(distance, (a, -a), radius, wanted)
        return [(u - w) / (2 * a) for u, w in ends]
    wanted = tuple(range(2, orders + 2))
    corners = _all_at(distance, (a + b, a - b, b - a, -a - b), radius, wanted)
    return [(p - q - r + s) / (4 * a * b) for p, q, r, s in corners]


def _all_at(
    distance: Array, shifts: tuple[float, ...], radius: float, orders: tuple[int, ...]
) -> Iterable[Iterable[Array]]:
    """Antiderivatives at shifted places: for each order those of all shifts."""
    if distance.size > _CACHED:
        return zip(*(antiderivatives(distance + shift, radius, orders) for shift in shifts), strict=True)
    # Of few pixels the calls take longer than the arithmetic.
    return antiderivatives(np.stack([distance + shift for shift in shifts]), radius, orders)
