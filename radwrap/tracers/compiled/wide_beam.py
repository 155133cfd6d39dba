"""Irradiance by flat wide lights with any beam, with nothing between.

All places of the light at one angle to the beam's axis lie on a circle about the point's foot in the light's plane.
What an arc of it gives is a closed form, so that one integral is left, over that angle.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.compiled.arithmetic import angle_of, azimuth, cosine_and_sine_of_turn
from radwrap.tracers.compiled.arrays import WIDE_RECTANGLE, Floats, Wide
from radwrap.tracers.compiled.beams import share_of
from radwrap.tracers.compiled.compiler import compiled
from radwrap.tracers.compiled.wide_contour import Place, on

_TURN: Final = 2 * math.pi
# Room for angles at which the integrand may have a corner: the ends, four corners, sides and crossings with the horizon
# of a rectangle, the horizon itself, and one that is not kept.
CUTS: Final = 16
# A piece is so many times as long as the beam's narrow angle at most, and ends at so many times its distance from the
# plane's horizon.
_PIECE: Final = 1.6
_NEARER: Final = 3.0
_LEAST_PIECE: Final = 1e-9  # rad
# Gauss-Legendre nodes, on which an end like a square root's is smooth: at (1 - cos pi t)/2, weights with that slope.
_COUNT: Final = 7
_T, _W = np.polynomial.legendre.leggauss(_COUNT)
_NODES: Final = tuple(float(x) for x in (1 - np.cos(np.pi * (_T + 1) / 2)) / 2)
_WEIGHTS: Final = tuple(float(w) for w in _W / 2 * np.pi / 2 * np.sin(np.pi * (_T + 1) / 2))

# A part of a circle: a unit vector to its middle, and the least cosine to that.
Part = tuple[float, float, float]
_ALL: Final = (1.0, 0.0, -2.0)


@compiled
def beam_irradiance(light: Wide, tables: Floats, p: Place, n: Place, cuts: Floats) -> float:
    """Irradiance over radiance [sr] of a point by a rectangle or annulus about the origin, which shines along +z.

    Parameters
    ----------
    light : Wide
        The light; its beam, and its sizes.
    tables : ndarray
        All tables.
    p, n : tuple of float
        The point and the unit normal of the lit surface, in the light's frame.
    cuts : ndarray, shape (CUTS,)
        Room to work in.
    """
    if p[2] <= 0:
        return 0.0
    nearest, farthest = _reach(light, p)
    first = azimuth(nearest, p[2])
    last = min(azimuth(farthest, p[2]), light.reach)
    if not last > first:
        return 0.0
    count = _filled(light, p, n, first, last, cuts)
    total = 0.0
    for k in range(count - 1):
        start, end = cuts[k], cuts[k + 1]
        while end - start > _LEAST_PIECE:
            step = min(_PIECE * light.narrow, (math.pi / 2 - start) * (1 - 1 / _NEARER))
            # The last two pieces are as long as each other.
            piece_end = end if end - start <= step else start + min(step, (end - start) / 2)
            total += _piece(light, tables, p, n, start, piece_end)
            start = piece_end
    return max(total, 0.0)


@compiled
def _piece(light: Wide, tables: Floats, p: Place, n: Place, start: float, end: float) -> float:
    total = 0.0
    for i in range(_COUNT):
        angle = start + (end - start) * _NODES[i]
        cosine, sine = cosine_and_sine_of_turn(angle / _TURN)
        share = share_of(light, tables, sine * sine / (2 * (1 + cosine)))
        if share > 0 and cosine > 0:
            total += _WEIGHTS[i] * share * sine / cosine * _around(light, p, n, p[2] * sine / cosine, cosine, sine)
    return total * (end - start)


@compiled
def _reach(light: Wide, p: Place) -> tuple[float, float]:
    """Least and largest distance of the light's places from a point's foot."""
    if light.kind == WIDE_RECTANGLE:
        x, y = abs(p[0]), abs(p[1])
        aside, along = max(x - light.a / 2, 0.0), max(y - light.b / 2, 0.0)
        far, farther = x + light.a / 2, y + light.b / 2
        return math.sqrt(aside * aside + along * along), math.sqrt(far * far + farther * farther)
    away = math.sqrt(p[0] * p[0] + p[1] * p[1])
    return max(away - light.b, light.a - away, 0.0), away + light.b


@compiled
def _filled(light: Wide, p: Place, n: Place, first: float, last: float, cuts: Floats) -> int:
    """Fill in angles between the first and the last at which the integrand may have a corner, sorted; how many."""
    h = p[2]
    cuts[0], cuts[1], kept = first, last, 2
    aside = math.sqrt(n[0] * n[0] + n[1] * n[1])
    if aside > 0:  # the horizon is a line n_x x + n_y y = n_z h of the light's plane
        kept = _with(abs(n[2]) * h / aside, h, first, last, cuts, kept)
    if light.kind == WIDE_RECTANGLE:
        x0, x1, y0, y1 = -light.a / 2 - p[0], light.a / 2 - p[0], -light.b / 2 - p[1], light.b / 2 - p[1]
        for x in (x0, x1):
            for y in (y0, y1):
                kept = _with(math.sqrt(x * x + y * y), h, first, last, cuts, kept)
            if y0 < 0 < y1:
                kept = _with(abs(x), h, first, last, cuts, kept)
            if y0 * abs(n[1]) < (n[2] * h - n[0] * x) * (1 if n[1] > 0 else -1) < y1 * abs(n[1]):
                y = (n[2] * h - n[0] * x) / n[1]
                kept = _with(math.sqrt(x * x + y * y), h, first, last, cuts, kept)
        for y in (y0, y1):
            if x0 < 0 < x1:
                kept = _with(abs(y), h, first, last, cuts, kept)
            if x0 * abs(n[0]) < (n[2] * h - n[1] * y) * (1 if n[0] > 0 else -1) < x1 * abs(n[0]):
                x = (n[2] * h - n[1] * y) / n[0]
                kept = _with(math.sqrt(x * x + y * y), h, first, last, cuts, kept)
    else:
        away = math.sqrt(p[0] * p[0] + p[1] * p[1])
        for radius in (light.a, light.b):
            if radius == 0:
                continue
            kept = _with(abs(radius - away), h, first, last, cuts, kept)
            kept = _with(radius + away, h, first, last, cuts, kept)
            # From the centre to the horizon, and from there to the circle along it.
            to = n[2] * h + n[0] * p[0] + n[1] * p[1]
            if aside > 0 and abs(to) < radius * aside:
                to /= aside
                half = math.sqrt(radius * radius - to * to)
                for side in (-half, half):
                    x = to * n[0] / aside - side * n[1] / aside - p[0]
                    y = to * n[1] / aside + side * n[0] / aside - p[1]
                    kept = _with(math.sqrt(x * x + y * y), h, first, last, cuts, kept)
    for k in range(1, kept):  # few: sorted by insertion
        value, j = cuts[k], k
        while j > 0 and cuts[j - 1] > value:
            cuts[j] = cuts[j - 1]
            j -= 1
        cuts[j] = value
    return kept


@compiled
def _with(radius: float, height: float, first: float, last: float, cuts: Floats, kept: int) -> int:
    """Add the angle to a distance from the foot, if it is between the others."""
    cuts[kept] = azimuth(radius, height)
    return kept + 1 if first < cuts[kept] < last else kept


@compiled
def _around(light: Wide, p: Place, n: Place, radius: float, cosine: float, sine: float) -> float:
    """Integral of the cosine to the normal around a circle, as far as it is of the light and above the horizon."""
    aside = math.sqrt(n[0] * n[0] + n[1] * n[1])
    level = -cosine * n[2]
    above = _ALL
    if sine * aside > 0:
        above = (n[0] / aside, n[1] / aside, -level / (sine * aside))
    elif level <= 0:
        return 0.0
    if light.kind == WIDE_RECTANGLE:
        return _arcs(
            (-1.0, 0.0, (p[0] - light.a / 2) / radius),
            (1.0, 0.0, (-p[0] - light.a / 2) / radius),
            (0.0, -1.0, (p[1] - light.b / 2) / radius),
            (0.0, 1.0, (-p[1] - light.b / 2) / radius),
            above,
            n,
            level,
            sine,
        )
    away2 = p[0] * p[0] + p[1] * p[1]
    away = math.sqrt(away2)
    outer, inner = _ALL, _ALL
    if away * radius > 0:
        x, y, rest, twice = p[0] / away, p[1] / away, away2 + radius * radius, 2 * away * radius
        outer = (-x, -y, (rest - light.b * light.b) / twice)
        inner = (x, y, (light.a * light.a - rest) / twice)
    elif radius > light.b or radius < light.a:
        return 0.0
    return _arcs(outer, inner, _ALL, _ALL, above, n, level, sine)


@compiled
def _arcs(a: Part, b: Part, c: Part, d: Part, e: Part, n: Place, level: float, sine: float) -> float:
    """Integral of level + sine (n_x cos + n_y sin) over what is in all of five parts of a circle."""
    parts = (a, b, c, d, e)
    count = 0
    for part in parts:
        if part[2] >= 1:
            return 0.0
        count += part[2] > -1
    if count == 0:
        return _TURN * level
    if count == 1:
        for x, y, least in parts:
            if least > -1:
                half = angle_of((1 - least) / 2)
                return 2 * (level * half + sine * (n[0] * x + n[1] * y) * math.sqrt(1 - least * least))
    spans = (_span(a), _span(b), _span(c), _span(d), _span(e))
    # What is in all of them begins where one of them does.
    total = 0.0
    for i in range(5):
        if parts[i][2] <= -1:
            continue
        begin, length, inside, last = spans[i][0], spans[i][1], True, i
        for j in range(5):
            if j == i or parts[j][2] <= -1:
                continue
            since = on(begin - spans[j][0])
            if since >= spans[j][1] or (since == 0 and j < i):
                inside = False
                break
            if spans[j][1] - since < length:
                length, last = spans[j][1] - since, j
        if inside:
            (x0, y0), (x1, y1) = _ends(parts[i])[0], _ends(parts[last])[1]
            total += level * length + sine * (n[0] * (y1 - y0) + n[1] * (x0 - x1))
    return total


@compiled
def _span(part: Part) -> tuple[float, float]:
    """Angle at which a part begins, and how long it is."""
    x, y, least = part
    if least <= -1:
        return 0.0, _TURN
    half = angle_of((1 - least) / 2)
    return azimuth(y, x) - half, 2 * half


@compiled
def _ends(part: Part) -> tuple[tuple[float, float], tuple[float, float]]:
    """Unit vectors to where a part begins and ends."""
    x, y, least = part
    across = math.sqrt(max(1 - least * least, 0.0))
    return (x * least + y * across, y * least - x * across), (x * least - y * across, y * least + x * across)
