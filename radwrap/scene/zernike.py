"""Zernike polynomials over a round pupil: the numbers that three conventions give them, and their values.

A polynomial is known here by its order n and frequency m: N R_n^|m|(rho) times
cos(m theta) for m >= 0 and sin(|m| theta) for m < 0, theta from the pupil's x
towards its y. N = sqrt((2 - [m = 0]) (n + 1)) makes its rms over the pupil 1.

::

    osa     ISO 24157 and ANSI Z80.28: j = (n (n + 2) + m)/2 from 0 on, unit rms
    noll    from 1 on, by n, then |m|; even j has the cosine; unit rms
    fringe  University of Arizona's, from 1 to 37, by (n + |m|)/2, then falling |m|; peak 1 at the pupil's rim;
            37 is rho^12's, as optical design programs have it

Sources: keys noll1976, iso24157.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Convention = Literal["osa", "noll", "fringe"]
Order = tuple[int, int]  # n, m

# Lens surfaces are told by far fewer; sums of higher ones lose digits.
HIGHEST_ORDER: Final = 20
_LAST_FRINGE: Final = 37


def order_of(convention: Convention, index: int) -> Order | None:
    """N and m of a number; None where the convention has none, or of an order above `HIGHEST_ORDER`."""
    if convention == "osa":
        n, m = _by_osa(index) if index >= 0 else (-1, 0)
    elif convention == "noll":
        n, m = _by_noll(index) if index >= 1 else (-1, 0)
    else:
        n, m = _by_fringe(index) if 1 <= index <= _LAST_FRINGE else (-1, 0)
    return (n, m) if 0 <= n <= HIGHEST_ORDER else None


def _by_osa(index: int) -> Order:
    n = (math.isqrt(8 * index + 1) - 1) // 2
    return n, 2 * index - n * (n + 2)


def _by_noll(index: int) -> Order:
    n = (math.isqrt(8 * index - 7) - 1) // 2
    place = index - 1 - n * (n + 1) // 2  # among those of n, from 0
    m = 2 * (place // 2) + 1 if n % 2 else 2 * ((place + 1) // 2)
    return n, m if index % 2 == 0 else -m


def _by_fringe(index: int) -> Order:
    if index == _LAST_FRINGE:
        return 12, 0
    half = math.isqrt(index - 1)  # (n + |m|)/2
    left = (half + 1) ** 2 - index
    m = (left + 1) // 2
    return 2 * half - m, m if left % 2 == 0 else -m


def rms(order: Order) -> float:
    """Of a polynomial of peak 1 over the pupil, 1/N."""
    n, m = order
    return 1 / math.sqrt((2 if m else 1) * (n + 1))


def zernike_sum(orders: Sequence[Order], coefficients: Sequence[float], x: Array, y: Array) -> Array:
    """Sum of polynomials of rms 1, each times its coefficient.

    Terms of one m share a polynomial in the radius squared, and (x + iy)^m, so that no angle is asked for.

    Parameters
    ----------
    orders : sequence of tuple of int
        n and m of each.
    coefficients : sequence of float
        Of each.
    x, y : ndarray
        Places over the pupil's radius.
    """
    by_m = dict[int, Array]()
    for (n, m), value in zip(orders, coefficients, strict=True):
        if value:
            powers = by_m.setdefault(m, np.zeros(HIGHEST_ORDER // 2 + 1))
            for power, factor in _factors(n, abs(m)):
                powers[(power - abs(m)) // 2] += value / rms((n, m)) * factor
    found, square = np.zeros(np.broadcast_shapes(x.shape, y.shape)), x**2 + y**2
    turned, reached = np.ones(found.shape, dtype=np.complex128), 0
    for m in sorted(by_m, key=abs):
        while reached < abs(m):
            turned, reached = turned * (x + 1j * y), reached + 1
        along = by_m[m][: 1 + int(np.flatnonzero(by_m[m]).max(initial=0))]
        radial = np.full(found.shape, along[-1])
        for factor in along[-2::-1]:
            radial = radial * square + factor
        found += radial * (turned.real if m >= 0 else turned.imag)
    return found


def _factors(n: int, m: int) -> Iterator[tuple[int, float]]:
    """Powers of the radius in R_n^m, and their factors."""
    for s in range((n - m) // 2 + 1):
        upper, lower = (n + m) // 2 - s, (n - m) // 2 - s
        factor = math.factorial(n - s) / (math.factorial(s) * math.factorial(upper) * math.factorial(lower))
        yield n - 2 * s, (-1) ** s * factor
