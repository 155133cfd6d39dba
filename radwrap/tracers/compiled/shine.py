"""What lights send to a point, many at once.

The compiler computes several lights in the time of one, as long as their
numbers lie in one row each and nothing in the loop goes two ways.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.compiled.arithmetic import exponential, squared_angle_of
from radwrap.tracers.compiled.arrays import GAUSSIAN, LAMBERTIAN, LUMINAIRE, Cluster, Floats, Light, Lights
from radwrap.tracers.compiled.beams import LEAST_COSINE, radiance_along
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.intersect import NEAREST

# Rows of the numbers of lights that lie side by side.
_X, _Y, _Z, _NX, _NY, _NZ, _AREA, _RADIANCE, _NARROW = range(9)
_FARTHEST_FRONT: Final = 0.5  # sin^2 of half of 90 degrees


def side_by_side(lights: NDArray[np.void]) -> Floats:
    """Numbers of lights, those of a kind side by side, shape (9, lights)."""
    named = [lights[name] for name in ("x", "y", "z", "nx", "ny", "nz", "area", "radiance")]
    spread = np.where(lights["beam"] == GAUSSIAN, lights["spread"], 1.0)
    return np.ascontiguousarray([*named, 0.5 / (spread * spread)], dtype=np.float64)


@compiled
def received(
    lights: Lights,
    beside: Floats,
    cluster: Cluster,
    tables: Floats,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
    least: float,
    is_matte: bool,
    diffuse: float,
    given: Floats,
) -> None:
    """What a cluster's lights send to a point at right angles to their direction [W m^-2], if nothing is between.

    Parameters
    ----------
    lights, beside, cluster, tables
        The lights, as rows and `side_by_side`, and all tables.
    x, y, z, nx, ny, nz : float
        The point and the unit normal.
    least : float
        Cosine to the normal up to which lights do not count.
    is_matte, diffuse : bool, float
        Whether the point reflects as a diffuse surface does, and its reflectance over pi: then that is counted in.
    given : ndarray, shape (lights,)
        Filled for the lights of the cluster.
    """
    if cluster.beam == LAMBERTIAN:
        _even(beside, cluster.first, cluster.end, x, y, z, nx, ny, nz, least, is_matte, diffuse, given)
    elif cluster.beam == GAUSSIAN:
        _gaussian(beside, cluster.first, cluster.end, x, y, z, nx, ny, nz, least, is_matte, diffuse, given)
    else:
        for i in range(cluster.first, cluster.end):
            lx, ly, lz, _, solid_angle = towards(lights[i], x, y, z)
            down = lx * nx + ly * ny + lz * nz
            given[i] = 0.0
            if solid_angle > 0 and down > least:
                value = radiance_along(lights[i], tables, -lx, -ly, -lz) * solid_angle
                given[i] = value * (diffuse * down) if is_matte else value


@compiled
def towards(light: Light, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Unit vector to a light, the distance up to it, and the solid angle that it fills; 0 where it does not shine."""
    lx, ly, lz = light.x - x, light.y - y, light.z - z
    away2 = lx * lx + ly * ly + lz * lz
    away = math.sqrt(away2)
    if light.radiance == 0 or away <= NEAREST:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    lx, ly, lz = lx / away, ly / away, lz / away
    solid_angle = light.area / away2
    if light.beam != LUMINAIRE:
        cosine = -(lx * light.nx + ly * light.ny + lz * light.nz)
        solid_angle *= cosine if cosine > LEAST_COSINE else 0.0
    return lx, ly, lz, away - NEAREST, solid_angle


@compiled
def _even(
    beside: Floats,
    first: int,
    end: int,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
    least: float,
    is_matte: bool,
    diffuse: float,
    given: Floats,
) -> None:
    for i in range(first, end):
        lx, ly, lz = beside[_X, i] - x, beside[_Y, i] - y, beside[_Z, i] - z
        away2 = lx * lx + ly * ly + lz * lz
        away = math.sqrt(away2)
        lx, ly, lz = lx / away, ly / away, lz / away
        cosine = -(lx * beside[_NX, i] + ly * beside[_NY, i] + lz * beside[_NZ, i])
        value = beside[_RADIANCE, i] * (beside[_AREA, i] / away2 * cosine)
        down = lx * nx + ly * ny + lz * nz
        value *= diffuse * down if is_matte else 1.0
        given[i] = value if (away > NEAREST) & (cosine > LEAST_COSINE) & (down > least) else 0.0


@compiled
def _gaussian(
    beside: Floats,
    first: int,
    end: int,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
    least: float,
    is_matte: bool,
    diffuse: float,
    given: Floats,
) -> None:
    for i in range(first, end):
        lx, ly, lz = beside[_X, i] - x, beside[_Y, i] - y, beside[_Z, i] - z
        ax, ay, az = beside[_NX, i], beside[_NY, i], beside[_NZ, i]
        away2 = lx * lx + ly * ly + lz * lz
        away = math.sqrt(away2)
        lx, ly, lz = lx / away, ly / away, lz / away
        cosine = -(lx * ax + ly * ay + lz * az)
        half_sine2 = ((-lx - ax) ** 2 + (-ly - ay) ** 2 + (-lz - az) ** 2) / 4
        front = half_sine2 if half_sine2 < _FARTHEST_FRONT else _FARTHEST_FRONT
        share = exponential(-squared_angle_of(front) * beside[_NARROW, i])
        value = (beside[_RADIANCE, i] * share / cosine) * (beside[_AREA, i] / away2 * cosine)
        down = lx * nx + ly * ny + lz * nz
        value *= diffuse * down if is_matte else 1.0
        given[i] = value if (away > NEAREST) & (cosine > LEAST_COSINE) & (down > least) else 0.0
