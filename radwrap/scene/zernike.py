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


def zernike(order: Order, rho: Array, theta: Array) -> Array:
    """Values of a polynomial of rms 1.

    Parameters
    ----------
    order : tuple of int
        n and m.
    rho : ndarray
        Distance from the pupil's middle over its radius.
    theta : ndarray
        Angle from x towards y [rad].
    """
    n, m = order
    turned = np.cos(m * theta) if m >= 0 else np.sin(-m * theta)
    found: Array = _radial(n, abs(m), rho) * turned / rms(order)
    return found


def _radial(n: int, m: int, rho: Array) -> Array:
    """R_n^m, 1 at rho = 1."""
    found = np.zeros_like(rho)
    for s in range((n - m) // 2 + 1):
        upper, lower = (n + m) // 2 - s, (n - m) // 2 - s
        factor = math.factorial(n - s) / (math.factorial(s) * math.factorial(upper) * math.factorial(lower))
        found += (-1) ** s * factor * rho ** (n - 2 * s)
    return found
