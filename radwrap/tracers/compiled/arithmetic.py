"""Functions of angles by plus, minus, times, divided by and square root only: the same bytes on every processor.

A C library's own exp and acos differ in the last digit between processors, and cannot be computed for several sources
at once.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.tracers.compiled.compiler import compiled

# Series in the small arguments that are left after reduction: as many terms as the last digit needs, in fours.
_EXP: Final = tuple(1 / math.factorial(n) if n < 14 else 0.0 for n in range(16))
_ARCSINE: Final = tuple(
    math.factorial(2 * n) / (4**n * math.factorial(n) ** 2 * (2 * n + 1)) for n in range(20)
)  # of asin(x)/x in x^2
_ARTANH: Final = tuple(1 / (2 * n + 1) for n in range(12))  # of artanh(x)/x in x^2
_COSINE: Final = tuple((-1) ** n / math.factorial(2 * n) for n in range(9, -1, -1))
_SINE: Final = tuple((-1) ** n / math.factorial(2 * n + 1) for n in range(9, -1, -1))
_LOG2_E: Final = 1 / math.log(2)
# ln 2 in two parts, of which the first has so few digits that its product with a whole number is exact.
_LN2_HIGH: Final = 6.93147180369123816490e-01
_LN2_LOW: Final = 1.90821492927058770002e-10
_LEAST_EXPONENT: Final = -700.0  # exp of less is nothing
_MOST_EXPONENT: Final = 700.0
_EXPONENT_OF_1: Final = 1023  # in the bits of a double
_DIGITS: Final = 52  # behind it


@compiled
def exponential(x: float) -> float:
    """e^x; 0 below -700, and e^700 above 700. It has no branch, so that several can be computed at once."""
    held = _LEAST_EXPONENT if x < _LEAST_EXPONENT else x  # NaN stays what it is
    held = _MOST_EXPONENT if held > _MOST_EXPONENT else held
    k = math.floor(held * _LOG2_E + 0.5)
    r = (held - k * _LN2_HIGH) - k * _LN2_LOW
    r2 = r * r
    r4 = r2 * r2
    c = _EXP
    low = _four(c[0], c[1], c[2], c[3], r, r2) + _four(c[4], c[5], c[6], c[7], r, r2) * r4
    high = _four(c[8], c[9], c[10], c[11], r, r2) + _four(c[12], c[13], c[14], c[15], r, r2) * r4
    # 2^k by its bits: an exponent, and no digits.
    power = np.int64((np.int64(k) + _EXPONENT_OF_1) << _DIGITS).view(np.float64)
    value = (low + high * (r4 * r4)) * power
    return 0.0 if x < _LEAST_EXPONENT else value


@compiled
def _four(a: float, b: float, c: float, d: float, x: float, x2: float) -> float:
    """A + b x + c x^2 + d x^3: sums of fours do not wait for each other, as those of a longer chain do."""
    return (a + b * x) + (c + d * x) * x2


@compiled
def angle_between(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Angle [rad] between unit vectors."""
    return angle_of(((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) / 4)


@compiled
def angle_of(half_sine2: float) -> float:
    """Angle [rad] between unit vectors, from sin^2 of its half: a quarter of the square of the chord between them.

    From the chord all digits of a small angle are right, of which the cosine has half.
    """
    z = min(half_sine2, 1.0)
    # Halved once more, the series is of an argument below 0.5 in x^2, and below 0.15 up to 90 degrees.
    quarter = z / (2 * (1 + math.sqrt(1 - z)))
    if quarter > 0.15:
        eighth = quarter / (2 * (1 + math.sqrt(1 - quarter)))
        return 8 * math.sqrt(eighth) * _arcsine(eighth)
    return 4 * math.sqrt(quarter) * _arcsine(quarter)


@compiled
def squared_angle_of(half_sine2: float) -> float:
    """Square of `angle_of` an angle up to 90 degrees, without a root at its end."""
    quarter = half_sine2 / (2 * (1 + math.sqrt(1 - half_sine2)))
    arcsine = _arcsine(quarter)
    return 16 * quarter * (arcsine * arcsine)


@compiled
def _arcsine(w: float) -> float:
    """Asin(sqrt(w))/sqrt(w) for w below 0.15."""
    w2 = w * w
    w4 = w2 * w2
    c = _ARCSINE
    low = _four(c[0], c[1], c[2], c[3], w, w2) + _four(c[4], c[5], c[6], c[7], w, w2) * w4
    high = _four(c[8], c[9], c[10], c[11], w, w2) + _four(c[12], c[13], c[14], c[15], w, w2) * w4
    w8 = w4 * w4
    return low + (high + _four(c[16], c[17], c[18], c[19], w, w2) * w8) * w8


@compiled
def log_cosine(half_sine2: float) -> float:
    """Ln cos of an angle below 90 deg, from sin^2 of its half."""
    cosine = 1 - 2 * half_sine2
    if cosine > 0.71:  # then the series' argument is below 0.17, and no digit of a small angle is lost
        return _log_ratio(-half_sine2 / (1 - half_sine2))
    return logarithm(cosine)


@compiled
def _log_ratio(x: float) -> float:
    """ln((1+x)/(1-x))."""
    y = x * x
    y2 = y * y
    y4 = y2 * y2
    c = _ARTANH
    low = _four(c[0], c[1], c[2], c[3], y, y2) + _four(c[4], c[5], c[6], c[7], y, y2) * y4
    return 2 * x * (low + _four(c[8], c[9], c[10], c[11], y, y2) * (y4 * y4))


@compiled
def logarithm(x: float) -> float:
    """Ln x of a number above 0."""
    mantissa, exponent = math.frexp(x)
    if mantissa < 0.7:
        mantissa, exponent = 2 * mantissa, exponent - 1
    return _log_ratio((mantissa - 1) / (mantissa + 1)) + exponent * (_LN2_HIGH + _LN2_LOW)


@compiled
def azimuth(y: float, x: float) -> float:
    """Angle of a point from the x axis towards y, from 0 to a full turn [rad]; 0 of the origin."""
    length2 = x * x + y * y
    if length2 == 0:
        return 0.0
    # Of the angle to the nearer axis the sine is below 0.71: sin^2(half) = (1 - cos)/2 without a difference.
    large, small = max(abs(x), abs(y)), min(abs(x), abs(y))
    length = math.sqrt(length2)
    turn = angle_of(small * small / (2 * length * (length + large)))
    if abs(y) > abs(x):
        turn = math.pi / 2 - turn
    if x < 0:
        turn = math.pi - turn
    return 2 * math.pi - turn if y < 0 and turn > 0 else turn


@compiled
def logarithm_of_ratio(x: float) -> float:
    """Ln((1+x)/(1-x))/(2x), from -1 to 1: artanh(x)/x, and 1 at 0."""
    if abs(x) < 1e-9:
        return 1.0
    if abs(x) < 0.17:
        return _log_ratio(x) / (2 * x)
    return logarithm((1 + abs(x)) / max(1 - abs(x), 1e-300)) / (2 * abs(x))


@compiled
def cosine_and_sine_of_turn(share: float) -> tuple[float, float]:
    """Cosine and sine of a share of a full turn, from 0 to 1."""
    quarter = math.floor(4 * share + 0.5)
    x = (share - quarter / 4) * (2 * math.pi)  # at most 45 degrees
    y = x * x
    cosine, sine = 0.0, 0.0
    for k in range(len(_COSINE)):
        cosine, sine = cosine * y + _COSINE[k], sine * y + _SINE[k]
    sine *= x
    if quarter == 1:
        return -sine, cosine
    if quarter == 2:
        return -cosine, -sine
    if quarter == 3:
        return sine, -cosine
    return cosine, sine
