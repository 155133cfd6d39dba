"""A step of walks of light from surface to surface: the draws and the directions of `tracers.bouncing`."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.bouncing import ABOVE, DRAWS, FIRST, GOLDEN, MOST_LIKELY, SECOND
from radwrap.tracers.compiled.arithmetic import cosine_and_sine_of_turn, logarithm
from radwrap.tracers.compiled.arrays import Decals, Floats, Shapes, Whole
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import painted
from radwrap.tracers.compiled.kernels import normal_at, placed
from radwrap.tracers.compiled.wide_contour import Place

Key = np.uint64
_SHIFTS: Final = (np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11))
_UNIT: Final = 2.0**-53


@compiled
def go_on(
    shapes: Shapes,
    decals: Decals,
    tables: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    rays: Floats,
    lengths: Floats,
    met: Whole,
    reflecting: Floats,
    step: int,
    may_end: bool,
    numbers: Whole,
    keys: NDArray[np.uint64],
    shares: Floats,
) -> int:
    """Take a step of walks: those that go on come first in their arrays, in their order, with their next rays.

    Parameters
    ----------
    shapes, decals, tables, x0, y0, z0, units, lengths, met
        As `kernels.trace`.
    rays : ndarray, shape (n, 6)
        Of the walks' last steps, and of the next.
    reflecting : ndarray, shape (covers, 3)
        Diffuse and specular reflectance of each cover, and the roughness of its lobe.
    step : int
        Number of the step, from 1.
    may_end : bool
        Whether walks end by chance.
    numbers : ndarray of int, shape (n,)
        Whose walks they are.
    keys : ndarray of uint64, shape (n,)
        Of their draws.
    shares : ndarray, shape (n,)
        What counts of the radiance that they find.

    Returns
    -------
    int
        How many go on.
    """
    count = 0
    for r in range(len(rays)):
        if met[r] < 0:  # nothing, or a lamp, which reflects nothing
            continue
        _, ox, oy, oz, dx, dy, dz = placed(rays, r, x0, y0, z0, units)
        length, shape = lengths[r], shapes[met[r]]
        x, y, z = ox + length * dx, oy + length * dy, oz + length * dz
        nx, ny, nz = normal_at(shape, x, y, z)
        if nx * dx + ny * dy + nz * dz > 0:
            nx, ny, nz = -nx, -ny, -nz
        cover, key = painted(decals, tables, shape.owner, shape.decal, x, y, z), keys[r]
        (lx, ly, lz), weight = scattered(
            reflecting[cover, 0],
            reflecting[cover, 1],
            reflecting[cover, 2],
            (nx, ny, nz),
            (-dx, -dy, -dz),
            key,
            step,
        )
        chance = min(weight, MOST_LIKELY) if may_end else 1.0
        if not (weight > 0 and _draw(key, step, 3) < chance):
            continue
        distance = length / units
        above = distance * ABOVE
        rays[count, 0] = rays[r, 0] + distance * dx + above * nx
        rays[count, 1] = rays[r, 1] + distance * dy + above * ny
        rays[count, 2] = rays[r, 2] + distance * dz + above * nz
        rays[count, 3], rays[count, 4], rays[count, 5] = lx, ly, lz
        numbers[count], keys[count], shares[count] = numbers[r], key, shares[r] * weight / chance
        count += 1
    return count


@compiled
def scattered(
    diffuse: float, specular: float, roughness: float, n: Place, v: Place, key: Key, step: int
) -> tuple[Place, float]:
    """A direction by which a surface reflects, and its weight; 0 where it is lost.

    See `bouncing`: the diffuse part or Ward's lobe, each as often as it reflects.

    Parameters
    ----------
    diffuse, specular, roughness : float
        Reflectances, and the width of the lobe.
    n, v : tuple of float
        Unit vectors: the normal on the side of the eye, and to the eye.
    key, step : int
        Whose draws.
    """
    whole, first, turn = diffuse + specular, _draw(key, step, 0), _draw(key, step, 1)
    if specular == 0 or _draw(key, step, 2) * whole < diffuse:
        return _from_normal(n, math.sqrt(1 - first), turn), whole
    # 1 - draw lies above 0, where the logarithm ends.
    cosine = 1 / math.sqrt(1 - roughness * roughness * logarithm(1 - first))
    h = _from_normal(n, cosine, turn)
    along = h[0] * v[0] + h[1] * v[1] + h[2] * v[2]
    mirrored = (2 * along * h[0] - v[0], 2 * along * h[1] - v[1], 2 * along * h[2] - v[2])
    light = mirrored[0] * n[0] + mirrored[1] * n[1] + mirrored[2] * n[2]
    return mirrored, whole * light / (along * cosine) if along > 0 and light > 0 else 0.0


@compiled
def _from_normal(n: Place, cosine: float, turn: float) -> Place:
    """Unit vector at an angle of that cosine to the normal, turned about it by a share of a full turn."""
    # Frisvad's frame by Duff et al. 2017: no branch but the sign.
    x, y, z = n
    sign = -1.0 if z < 0 else 1.0
    a = -1 / (sign + z)
    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
    u, v = cosine_and_sine_of_turn(turn)
    u, v = sine * u, sine * v
    return (
        u * (1 + sign * x * x * a) + v * (x * y * a) + cosine * x,
        u * (sign * x * y * a) + v * (sign + y * y * a) + cosine * y,
        u * (-sign * x) + v * (-y) + cosine * z,
    )


@compiled
def _mixed(value: Key) -> Key:
    """SplitMix64's finaliser, see `bouncing`."""
    value = (value ^ (value >> _SHIFTS[0])) * FIRST
    value = (value ^ (value >> _SHIFTS[1])) * SECOND
    return value ^ (value >> _SHIFTS[2])


@compiled
def _draw(key: Key, step: int, which: int) -> float:
    """Number of a step, even in 0 to 1."""
    return float(_mixed(key + GOLDEN * np.uint64(step * DRAWS + which)) >> _SHIFTS[3]) * _UNIT
