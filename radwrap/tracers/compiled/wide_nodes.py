"""What a broad lobe sends to the eye of a wide light with nothing between, by quadrature over the light."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.compiled.arithmetic import angle_between, angle_of
from radwrap.tracers.compiled.arrays import (
    BEADS,
    BRDF,
    BRUSHED,
    COEFFICIENTS,
    CONE,
    LAMBERTIAN,
    TURNED_NORMAL,
    WARD,
    WIDE_ANNULUS,
    WIDE_RECTANGLE,
    WIDE_ZONE,
    Cover,
    Floats,
    Wide,
)
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.covers import turn_between
from radwrap.tracers.compiled.wide_contour import Place
from radwrap.tracers.compiled.wide_light import sent_by
from radwrap.tracers.compiled.wide_shape import ball_around, may_light

# Nodes along a light.
_FEWEST: Final = 4
_MOST: Final = 26
# A light that is w roughnesses long, as an angle, has 2 + 1.05 w nodes; a lobe's standard deviation is sqrt 2
# roughnesses, and of a beam its own counts. Gauss-Legendre nodes lie pi/2 farther apart in the middle than in the mean:
# one node for each standard deviation misses 1e-3 of a lobe's light, without any noise. These miss 3e-5.
_NODES_MORE: Final = 2.0
_NODES_EACH: Final = 1.05
# Half a turn away from the eye's direction a lobe of .5 still has 2 per cent of its height, and is cut.
_BROADEST: Final = 0.3  # roughness
# Even places around a round light: from 8 on one for each roughness until there are 32, which are enough for 44.8.
_FEWEST_AROUND: Final = 8
_MOST_AROUND: Final = 32
_LONGEST_AROUND: Final = 44.8
# Where normals halfway between the eye and a horizon that cuts the light stand off by fewer roughnesses, a lobe ends at
# that horizon while it is seen: 2.5 of them leave .2 per cent of its height.
_REACH: Final = 2.5
# Gauss-Legendre nodes from 0 to 1 and their weights: of 4, 6, 8 and so on, one after the other.
_RULES: Final = [np.polynomial.legendre.leggauss(count) for count in range(_FEWEST, _MOST + 1, 2)]
_NODES: Final = np.concatenate([(x + 1) / 2 for x, _ in _RULES])
_WEIGHTS: Final = np.concatenate([w / 2 for _, w in _RULES])


@compiled
def nodes_along(light: Wide, cover: Cover, tables: Floats, p: Place, n: Place, v: Place) -> tuple[int, int]:
    """How many nodes along the two coordinates of a light resolve a lobe at a point; 0 where too many would be due."""
    along, around = _lengths(light)
    if light.beam == CONE or _has_corner(light, cover, tables, p, n, v):
        return 0, 0
    fine = min(_resolved(light, cover, p, n, v), _BROADEST)
    if light.beam != LAMBERTIAN:
        fine = min(fine, light.narrow / math.sqrt(2))
    step = fine * _nearest(light, p)
    if step <= 0:
        return 0, 0
    first = _nodes_for(along / step)
    second = _nodes_for(around / step) if light.kind == WIDE_RECTANGLE else _places_for(around / step)
    return (first, second) if first > 0 and second > 0 else (0, 0)


@compiled
def _nodes_for(width: float) -> int:
    """Gauss-Legendre nodes along so many roughnesses, an even number; 0 where `_MOST` are too few."""
    due = _NODES_MORE + _NODES_EACH * width
    return 0 if due > _MOST else max(2 * math.ceil(due / 2), _FEWEST)


@compiled
def _places_for(width: float) -> int:
    """Even places along a circle so many roughnesses long; 0 where `_MOST_AROUND` are too few."""
    count = _FEWEST_AROUND
    while count < min(width, _MOST_AROUND):
        count *= 2
    return count if width <= _LONGEST_AROUND else 0


@compiled
def _rule(count: int) -> int:
    """Where the nodes of so many begin."""
    return (count - _FEWEST) * (count + _FEWEST - 2) // 4


@compiled
def _resolved(light: Wide, cover: Cover, p: Place, n: Place, v: Place) -> float:
    """Angle over which what a lobe sends to the eye changes much with where light comes from [rad]; 0 at a horizon."""
    if cover.kind == TURNED_NORMAL:
        return cover.fine
    is_cut = may_light(light, p, (-n[0], -n[1], -n[2]))
    if cover.kind not in (WARD, BRUSHED):
        return 0.0 if is_cut else cover.fine
    cosine = min(1.0, n[0] * v[0] + n[1] * v[1] + n[2] * v[2])
    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
    rough = math.sqrt(max(cover.a, cover.b) if cover.kind == BRUSHED else cover.a)
    # The tangent of half the angle between the eye and the horizon beyond the normal is cos/(1 + sin).
    if is_cut and cosine < _REACH * rough * (1 + sine):
        return 0.0
    # A grazing eye sees a lobe whose light comes from a narrow band above the horizon: a direction aside turns the
    # normal halfway by one over the sum of both cosines, of which that of the light is about as far off as the lobe.
    return cover.fine * max(cosine - rough * sine, 0.0)


@compiled
def _has_corner(light: Wide, cover: Cover, tables: Floats, p: Place, n: Place, v: Place) -> bool:
    """Whether a table may bend within a light as it is seen: it is straight from node to node of its angles."""
    if cover.kind not in (COEFFICIENTS, BEADS, BRDF):
        return False
    (x, y, z), reach = ball_around(light, p)
    away = math.sqrt(x * x + y * y + z * z)
    if reach >= away:
        return True
    d, sine = (x / away, y / away, z / away), reach / away
    first = cover.table
    second = first + int(cover.a)
    third = second + int(cover.b)
    half = _angle_of_sine(sine)
    observation = angle_between(d[0], d[1], d[2], v[0], v[1], v[2])
    incidence = angle_between(d[0], d[1], d[2], n[0], n[1], n[2])
    if cover.kind == BEADS:
        return _bends(tables, first, second, observation, half)
    if cover.kind == COEFFICIENTS:
        return _bends(tables, first, second, observation, half) or _bends(tables, second, third, incidence, half)
    last = third + int(cover.c)
    return _bends(tables, first, second, incidence, half) or _turns(tables, third, last, n, v, d, sine)


@compiled
def _angle_of_sine(sine: float) -> float:
    return angle_of(sine * sine / (2 * (1 + math.sqrt(1 - sine * sine))))


@compiled
def _bends(tables: Floats, first: int, end: int, angle: float, half: float) -> bool:
    """Whether a node of a table lies within half a width of an angle; a table of one node bends nowhere."""
    is_within = False
    for i in range(first, end):
        is_within |= abs(tables[i] - angle) <= half
    return is_within and end - first > 1


@compiled
def _turns(tables: Floats, first: int, end: int, n: Place, v: Place, d: Place, sine: float) -> bool:
    """As `_bends`, of the azimuth about the normal between the eye and a ball of a light."""
    light, eye = n[0] * d[0] + n[1] * d[1] + n[2] * d[2], n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    aside = math.sqrt(max(1 - light * light, 0.0))
    if aside <= sine:
        return True
    turn = turn_between(light, eye, d[0] * v[0] + d[1] * v[1] + d[2] * v[2])
    return _bends(tables, first, end, turn, _angle_of_sine(sine / aside))


@compiled
def _lengths(light: Wide) -> tuple[float, float]:
    """Lengths of a light along its two coordinates at most; the second of a round one goes all around it."""
    if light.kind == WIDE_RECTANGLE:
        return light.a, light.b
    if light.kind == WIDE_ANNULUS:
        return light.b - light.a, 2 * math.pi * light.b
    across = math.sqrt(max(light.a**2 - light.b**2, 0.0)) - math.sqrt(max(light.a**2 - light.c**2, 0.0))
    # No arc of half a turn is longer than pi/2 of its chord.
    return math.pi / 2 * math.sqrt(across * across + (light.c - light.b) ** 2), 2 * math.pi * light.a


@compiled
def _nearest(light: Wide, p: Place) -> float:
    """No point of a light is nearer."""
    if light.kind == WIDE_ZONE:
        x, y, z = p[0] - light.x, p[1] - light.y, p[2] - light.z
        return max(light.a - math.sqrt(x * x + y * y + z * z), 0.0)
    x = max(light.x0 - p[0], p[0] - light.x1, 0.0)
    y = max(light.y0 - p[1], p[1] - light.y1, 0.0)
    z = max(light.z0 - p[2], p[2] - light.z1, 0.0)
    return math.sqrt(x * x + y * y + z * z)


@compiled
def whole_lobe(
    light: Wide, cover: Cover, tables: Floats, p: Place, n: Place, v: Place, first: int, second: int
) -> float:
    """Radiance that a lobe sends to the eye [W m^-2 sr^-1], by `nodes_along` a light: around a round one even ones."""
    total = 0.0
    for i in range(first):
        a, of_a = _NODES[_rule(first) + i], _WEIGHTS[_rule(first) + i]
        for j in range(second):
            b, of_b = (j + 0.5) / second, 1 / second
            if light.kind == WIDE_RECTANGLE:
                b, of_b = _NODES[_rule(second) + j], _WEIGHTS[_rule(second) + j]
            value, _, _ = sent_by(light, cover, tables, 0.0, True, p, n, v, a, b)
            total += of_a * of_b * value
    return light.radiance * light.area * total
