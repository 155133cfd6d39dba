"""Points for the shadows of wide lights: spread evenly, scrambled by a key, without a random state.

The first 2^k points have one point in each elementary box of area 2^-k (Sobol's first two dimensions), and nested
scrambling by Laine and Karras' hash in Burley's form (burley2020) keeps that; see `imaging.methods.sobol`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from radwrap.tracers.compiled.compiler import compiled

_WORD: Final = 0xFFFFFFFF
_MASKS: Final = ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF))
_FACTORS: Final = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)


@compiled
def key_of_ray(x: float, y: float, z: float, dx: float, dy: float, dz: float, number: int) -> int:
    """Key of a ray and a light: of the ray's numbers as single floats, in whose digits all processors agree."""
    key = mixed(number + 1, 0)
    for value in (float(x), float(y), float(z), float(dx), float(dy), float(dz)):
        key = mixed(key, int(np.float32(value).view(np.int32)) & _WORD)
    return key


@compiled
def mixed(key: int, value: int) -> int:
    """A hash of a hash and a value, each of 32 bits."""
    h = (key * 0x9E3779B1 + value) & _WORD
    h = ((h ^ (h >> 16)) * 0x85EBCA6B) & _WORD
    h = ((h ^ (h >> 13)) * 0xC2B2AE35) & _WORD
    return h ^ (h >> 16)


@compiled
def spread_point(index: int, key: int) -> tuple[float, float]:
    """A point of the unit square: number `index` of a key's points; 0 < both < 1."""
    second, step, rest = 0, 1 << 31, index
    while rest:
        if rest & 1:
            second ^= step
        step ^= step >> 1
        rest >>= 1
    first = _scrambled(_reversed(index), mixed(key, 1))
    second = _scrambled(second, mixed(key, 2))
    return (first + 0.5) / 4294967296.0, (second + 0.5) / 4294967296.0


@compiled
def _reversed(x: int) -> int:
    for shift, mask in _MASKS:
        x = ((x >> shift) & mask) | ((x & mask) << shift)
    return (x >> 16) | ((x << 16) & _WORD)


@compiled
def _scrambled(x: int, key: int) -> int:
    x = (_reversed(x) + key) & _WORD
    for factor in _FACTORS:
        x ^= (x * factor) & _WORD
    return _reversed(x)
