"""Owen-scrambled Sobol points: for each stream its own nested scrambling of the same four-dimensional sequence.

The first 2^k points of a stream have one point in each elementary box of
volume 2^-k (in the pairs of dimensions that Sobol's numbers serve best), and
each point alone is uniformly distributed, so that a mean over them is unbiased.
The nested permutation is Laine and Karras' hash in Burley's form (burley2020).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

MOST_POINTS: Final = 1 << 16
DIMENSIONS: Final = 4

# Joe and Kuo's primitive polynomials (coefficients a, degree s) and first direction numbers m of dimensions 2 to 4.
_JOE_KUO: Final = ((1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)))
_BITS: Final = 32


def _direction_numbers() -> NDArray[np.uint32]:
    columns = [[1 << (_BITS - 1 - k) for k in range(_BITS)]]
    for degree, coefficients, first in _JOE_KUO:
        m = list(first)
        for k in range(degree, _BITS):
            value = m[k - degree] ^ (m[k - degree] << degree)
            for j in range(1, degree):
                if coefficients >> (degree - 1 - j) & 1:
                    value ^= m[k - j] << j
            m.append(value)
        columns.append([m[k] << (_BITS - 1 - k) for k in range(_BITS)])
    return np.array(columns, dtype=np.uint32)


def _sequence(first: int, count: int) -> NDArray[np.uint32]:
    """Sobol's points number `first` and following, shape (count, DIMENSIONS), as 32-bit fractions."""
    index = np.arange(first, first + count, dtype=np.uint32)
    directions = _direction_numbers()
    points = np.zeros((count, DIMENSIONS), dtype=np.uint32)
    for k in range(max(1, int(first + count - 1).bit_length())):
        odd = (index >> np.uint32(k) & np.uint32(1)).astype(bool)
        points[odd] ^= directions[:, k]
    return points


def _reversed_bits(x: NDArray[np.uint32]) -> NDArray[np.uint32]:
    x = x.byteswap()
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F)):
        s, m = np.uint32(shift), np.uint32(mask)
        high = x & m
        high <<= s
        x >>= s
        x &= m
        x |= high
    return x


def _scrambled(x: NDArray[np.uint32], key: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Nested uniform scrambling: each bit is flipped as all higher bits and the key decide."""
    x = _reversed_bits(x) + key
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        x ^= x * np.uint32(factor)
    return _reversed_bits(x)


def scrambled_points(keys: NDArray[np.uint32], count: int, first: int = 0) -> NDArray[np.float64]:
    """Points of several streams.

    Parameters
    ----------
    keys : ndarray of uint32, shape (streams, DIMENSIONS)
        Random keys; equal keys give equal points.
    count, first : int
        Which points of the sequence, at most `MOST_POINTS` in all.

    Returns
    -------
    ndarray, shape (streams, count, DIMENSIONS)
        In the open interval (0, 1).
    """
    if not 0 < count <= MOST_POINTS - first:
        raise ValueError(f"a stream has at most {MOST_POINTS} points")
    with np.errstate(over="ignore"):
        bits = _scrambled(_sequence(first, count)[np.newaxis], keys[:, np.newaxis, :].astype(np.uint32))
    points: NDArray[np.float64] = (bits.astype(np.float64) + 0.5) * 2.0**-_BITS
    return points
