"""Walks of light from surface to surface, in one compiled loop: the draws and the steps of `tracers.bouncing`."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.bouncing import ABOVE, DRAWS, FIRST, GOLDEN, LONGEST_WALK, MOST_LIKELY, SECOND
from radwrap.tracers.compiled.arithmetic import cosine_and_sine_of_turn, logarithm
from radwrap.tracers.compiled.arrays import Clusters, Covers, Decals, Floats, Lights, Nodes, Shapes, Whole, Wides
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import painted
from radwrap.tracers.compiled.kernels import normal_at, placed, trace
from radwrap.tracers.compiled.wide_contour import Place

Key = np.uint64

# What came of it.
DONE: Final = 0
BAD_RAY: Final = 1
ENDLESS_WALK: Final = 2

_NO_DRAWS: Final = np.uint64(0)
_SHIFTS: Final = (np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11))
_UNIT: Final = 2.0**-53


@compiled
def walk(
    shapes: Shapes,
    nodes: Nodes,
    discs: Shapes,
    disc_nodes: Nodes,
    covers: Covers,
    decals: Decals,
    lights: Lights,
    beside: Floats,
    clusters: Clusters,
    parts: Clusters,
    wides: Wides,
    cells: Clusters,
    pitch: float,
    background: float,
    tables: Floats,
    rays: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    values: Floats,
    lengths: Floats,
    met: Whole,
    given: Floats,
    known: Whole,
    chosen: Whole,
    stack: Whole,
    reflecting: Floats,
    orders: int,
    sure_steps: int,
    ray: Floats,
    value: Floats,
    length: Floats,
    number: Whole,
) -> int:
    """Radiance along rays, with what a walk finds that goes on from where each ends.

    Parameters
    ----------
    shapes, nodes, discs, disc_nodes, covers, decals, lights, beside, clusters, parts, wides, cells, pitch, background
        As `kernels.trace`.
    tables, rays, x0, y0, z0, units, lengths, met, given, known, chosen, stack
        The same.
    values : ndarray, shape (n, 1)
        To which radiance is added [W m^-2 sr^-1].
    reflecting : ndarray, shape (covers, 3)
        Diffuse and specular reflectance of each cover, and the roughness of its lobe.
    orders : int
        Steps of a walk at most; below 0: walks end by chance.
    sure_steps : int
        Steps of such a walk that do not.
    ray, value, length, number : ndarray, shape (1, 6), (1, 1), (1,), (1,)
        Room to work in.

    Returns
    -------
    int
        `DONE`, `BAD_RAY` or `ENDLESS_WALK`; the latter two end it.
    """
    for r in range(len(rays)):
        for k in range(6):
            ray[0, k] = rays[r, k]
        key, share = key_of(ray), 1.0
        steps = orders if orders >= 0 else sure_steps + LONGEST_WALK
        for step in range(steps + 1):
            value[0, 0] = 0.0
            if not trace(
                shapes,
                nodes,
                discs,
                disc_nodes,
                covers,
                decals,
                lights,
                beside,
                clusters,
                parts,
                wides,
                cells,
                pitch,
                background,
                tables,
                ray,
                x0,
                y0,
                z0,
                units,
                value,
                length,
                number,
                False,
                given,
                known,
                chosen,
                stack,
            ):
                return BAD_RAY
            if step == 0:
                values[r, 0] += value[0, 0]
                lengths[r], met[r] = length[0], number[0]
            elif number[0] >= 0:  # a lamp shines straight on what the walk came from, and was counted there
                values[r, 0] += share * value[0, 0]
            if number[0] < 0 or step == orders:
                break
            may_end = orders < 0 and step + 1 > sure_steps
            weight = _goes_on(
                shapes, decals, reflecting, x0, y0, z0, units, length[0], number[0], key, step + 1, may_end, ray
            )
            if weight == 0:
                break
            share *= weight
            if step == steps:
                return ENDLESS_WALK
    return DONE


@compiled
def _goes_on(
    shapes: Shapes,
    decals: Decals,
    reflecting: Floats,
    x0: float,
    y0: float,
    z0: float,
    units: float,
    length: float,
    number: int,
    key: Key,
    step: int,
    may_end: bool,
    ray: Floats,
) -> float:
    """Put the ray of the next step in place of one that met a shape; 0, or what share of its radiance counts."""
    _, ox, oy, oz, dx, dy, dz = placed(ray, 0, x0, y0, z0, units)
    shape = shapes[number]
    x, y, z = ox + length * dx, oy + length * dy, oz + length * dz
    nx, ny, nz = normal_at(shape, x, y, z)
    if nx * dx + ny * dy + nz * dz > 0:
        nx, ny, nz = -nx, -ny, -nz
    cover = painted(decals, shape.owner, shape.decal, x, y, z)
    n, v = (nx, ny, nz), (-dx, -dy, -dz)
    diffuse, specular, roughness = reflecting[cover, 0], reflecting[cover, 1], reflecting[cover, 2]
    (lx, ly, lz), weight = scattered(diffuse, specular, roughness, n, v, key, step)
    chance = min(weight, MOST_LIKELY) if may_end else 1.0
    if not (weight > 0 and _draw(key, step, 3) < chance):
        return 0.0
    distance = length / units
    above = distance * ABOVE
    ray[0, 0] += distance * dx + above * nx
    ray[0, 1] += distance * dy + above * ny
    ray[0, 2] += distance * dz + above * nz
    ray[0, 3], ray[0, 4], ray[0, 5] = lx, ly, lz
    return weight / chance


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
def key_of(ray: Floats) -> Key:
    """A number of a ray, of all its digits."""
    key = _NO_DRAWS
    for k in range(6):
        key = _mixed((key ^ np.float64(ray[0, k] + 0.0).view(np.uint64)) + GOLDEN)  # + 0.0: one zero
    return key


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
