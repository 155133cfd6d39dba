"""Light of even radiance by the contour around it: Lambert's formula, E = L/2 times the sum of the edges' angles.

A piece of contour is worth -1/2 of the integral of n . (r x dr)/|r|^2, where r goes from the point to the contour,
and the contour runs counter-clockwise about the axis that leads out of the region.
"""

from __future__ import annotations

import math
from typing import Final

from radwrap.tracers.compiled.arithmetic import angle_of, azimuth, logarithm_of_ratio
from radwrap.tracers.compiled.compiler import compiled

# A share of the middle square distance below which distances to a circle count as equal: the next term is its square.
_ROUND: Final = 1e-8
_TURN: Final = 2 * math.pi

# All q with q . (x, y, z) < c.
Half = tuple[float, float, float, float]
# An angle with its cosine and sine.
Place = tuple[float, float, float]
# Centre, radius, two axes across, and the axis about which a circle runs.
Circle = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]
# Whether any part of a circle lies in a half space, whether all does, and where that part begins and ends.
Span = tuple[bool, bool, Place, Place]


@compiled
def angle_between(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Angle between two vectors [rad]; 0 where one has no length."""
    a, b = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
    if a == 0 or b == 0:
        return 0.0
    cx, cy, cz = ax / a - bx / b, ay / a - by / b, az / a - bz / b
    return angle_of((cx * cx + cy * cy + cz * cz) / 4)


@compiled
def circle_before(cx: float, cy: float, cz: float, radius: float, axis: Place, p: Place) -> Circle:
    """A circle whose angles count from the direction that leads away from a point, as the point sees the circle."""
    ex, ey, ez = axis
    wx, wy, wz = cx - p[0], cy - p[1], cz - p[2]
    along = wx * ex + wy * ey + wz * ez
    ux, uy, uz = wx - along * ex, wy - along * ey, wz - along * ez
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    if length <= 1e-12 * (radius + abs(along)):  # in the axis any direction will do
        if abs(ex) < 0.6:
            ux, uy, uz = 1 - ex * ex, -ex * ey, -ex * ez
        else:
            ux, uy, uz = -ey * ex, 1 - ey * ey, -ey * ez
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    vx, vy, vz = ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux
    return cx, cy, cz, radius, ux, uy, uz, vx, vy, vz, ex, ey, ez


@compiled
def span_within(circle: Circle, half: Half) -> Span:
    """Part of a circle that lies in a half space."""
    cx, cy, cz, radius, ux, uy, uz, vx, vy, vz, _, _, _ = circle
    hx, hy, hz, c = half
    none = (0.0, 1.0, 0.0)
    if c == math.inf:
        return True, True, none, none
    across, up = radius * (hx * ux + hy * uy + hz * uz), radius * (hx * vx + hy * vy + hz * vz)
    swing, room = math.sqrt(across * across + up * up), c - (hx * cx + hy * cy + hz * cz)
    if room >= swing:
        return True, True, none, none
    if room <= -swing:
        return False, False, none, none
    cosine, ca, sa = room / swing, across / swing, up / swing
    sine, middle, aside = math.sqrt(1 - cosine * cosine), azimuth(up, across), angle_of((1 - cosine) / 2)
    begin = (middle + aside, ca * cosine - sa * sine, sa * cosine + ca * sine)
    end = (middle - aside, ca * cosine + sa * sine, sa * cosine - ca * sine)
    return True, False, begin, end


@compiled
def on(turn: float) -> float:
    """An angle from 0 to a full turn."""
    return turn - math.floor(turn / _TURN) * _TURN


@compiled
def circle_within(circle: Circle, a: Half, b: Half, c: Half, p: Place, n: Place) -> float:
    """What the part of a circle in three half spaces is worth to a point with a normal."""
    spans = (span_within(circle, a), span_within(circle, b), span_within(circle, c))
    start = (0.0, 1.0, 0.0)
    is_whole = True
    for some, every, _, _ in spans:
        if not some:
            return 0.0
        is_whole = is_whole and every
    if is_whole:
        return arc(circle, start, _TURN, start, p, n)
    total = 0.0
    for i in range(3):
        if spans[i][1]:
            continue
        begin = spans[i][2]
        inside, length, end = True, _TURN, begin
        for j in range(3):
            if spans[j][1]:
                continue
            left = on(spans[j][3][0] - begin[0])
            if j != i and on(begin[0] - spans[j][2][0]) > on(spans[j][3][0] - spans[j][2][0]):
                inside = False
            if left < length:
                length, end = left, spans[j][3]
        if inside:
            total += arc(circle, begin, length, end, p, n)
    return total


@compiled
def arc(circle: Circle, begin: Place, turn: float, end: Place, p: Place, n: Place) -> float:
    """What an arc is worth, from a place over an angle to another place; in closed form."""
    cx, cy, cz, radius, ux, uy, uz, vx, vy, vz, ex, ey, ez = circle
    wx, wy, wz = cx - p[0], cy - p[1], cz - p[2]
    h, d = wx * ex + wy * ey + wz * ez, max(0.0, wx * ux + wy * uy + wz * uz)
    near, far = math.sqrt((d - radius) ** 2 + h * h), math.sqrt((d + radius) ** 2 + h * h)
    a, b, s = (near * near + far * far) / 2, 2 * radius * d, max(near * far, 1e-300)
    # n . (r x r') = alpha + beta cos t + gamma sin t, and |r|^2 = a + b cos t
    alpha = radius * radius * (n[0] * ex + n[1] * ey + n[2] * ez)
    beta = radius * (n[0] * (wy * vz - wz * vy) + n[1] * (wz * vx - wx * vz) + n[2] * (wx * vy - wy * vx))
    gamma = -radius * (n[0] * (wy * uz - wz * uy) + n[1] * (wz * ux - wx * uz) + n[2] * (wx * uy - wy * ux))
    value = turn * (alpha - beta * b / (s + a)) / s
    if turn < _TURN:
        z = b / (a + s)
        lag = (_lag(z, end) - _lag(z, begin)) / b if b > _ROUND * a else (end[2] - begin[2]) / (2 * a)
        value += 2 * lag * (beta * a - alpha * b) / s
        fall = 2 * (end[1] - begin[1]) / max(2 * a + b * (end[1] + begin[1]), 1e-300)
        value -= gamma * fall * logarithm_of_ratio(b * fall / 2)
    return -value / 2


@compiled
def _lag(z: float, place: Place) -> float:
    """Atan(z sin t/(1 + z cos t)): half of what the angle at the nearest place lags behind t."""
    y, x = z * place[2], max(1 + z * place[1], 1e-300)
    return azimuth(y, x) if y >= 0 else -azimuth(-y, x)
