"""Where scan lines cross a rim: by the gradient, or by the moments of the gray levels along them [tabatabai1984]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError

Array = NDArray[np.float64]
Way = Literal["model", "gradient", "moment"]
WAYS: Final[tuple[Way, ...]] = ("model", "gradient", "moment")

SAMPLING: Final = 0.5  # px between samples of a scan line
_SMOOTHING: Final = 1.0  # px, of the gradient
_WINDOW: Final = 2.5  # of moments, in widths of the gradient's peak: both levels are in it
_SHORTEST_WINDOW: Final = 3.0  # px
_BESIDE: Final = 1.5  # px
_MOST_SATURATED: Final = 0.05
_FAINT: Final = 0.25  # of the median gradient; a scan line whose strongest is less crosses no rim


@dataclass(frozen=True, slots=True, eq=False)
class ScanLines:
    """Lines across a rim.

    Attributes
    ----------
    origins, directions : ndarray, shape (n, 2)
        Their middles and unit vectors, in pixel widths [px].
    half_length : float
        How far they reach to either side [px].
    aspect : float
        Height of a pixel over its width.
    """

    origins: Array
    directions: Array
    half_length: float
    aspect: float

    def at(self, offsets: Array) -> Array:
        """Places on the lines, shape (n, 2), one on each."""
        places: Array = self.origins + offsets[:, None] * self.directions
        return places


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """Where scan lines cross the rim.

    Attributes
    ----------
    line : ndarray of int, shape (m,)
        Numbers of the lines that do.
    offsets : ndarray, shape (m,)
        On them [px].
    width : float
        How wide the gradient's peak is, as the sigma of a bell [px].
    rising : bool
        Whether light rises along the lines.
    """

    line: NDArray[np.intp]
    offsets: Array
    width: float
    rising: bool


def profiles(values: Array, lines: ScanLines) -> tuple[Array, Array]:
    """Offsets of the samples, shape (k,) [px], and the light there, shape (n, k); NaN beyond the image."""
    from scipy.ndimage import map_coordinates

    count = 2 * max(2, math.ceil(lines.half_length / SAMPLING)) + 1
    offsets: Array = np.asarray((np.arange(count) - count // 2) * SAMPLING, dtype=np.float64)
    u = lines.origins[:, :1] + offsets * lines.directions[:, :1]
    v = (lines.origins[:, 1:] + offsets * lines.directions[:, 1:]) / lines.aspect
    rows, columns = values.shape
    top, left = max(0, math.floor(v.min()) - 2), max(0, math.floor(u.min()) - 2)
    part = values[top : max(top + 1, math.ceil(v.max()) + 3), left : max(left + 1, math.ceil(u.max()) + 3)]
    inside = (u >= 0) & (u <= columns - 1) & (v >= 0) & (v <= rows - 1)
    if part.size == 0:
        return offsets, np.full(u.shape, np.nan)
    sampled = np.asarray(map_coordinates(part, [v - top, u - left], order=1, mode="nearest"), dtype=np.float64)
    return offsets, np.asarray(np.where(inside, sampled, np.nan))


def crossings(values: Array, lines: ScanLines, way: Way = "gradient", rising: bool | None = None) -> Crossings | None:
    """Strongest step on each line; None where hardly a line has one.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
        Light.
    lines : ScanLines
        Where to look.
    way : str
        "gradient": the peak of the slope; "moment": the step with the same three moments.
    rising : bool, optional
        Which steps count; default those that are stronger on the whole.
    """
    from scipy.ndimage import gaussian_filter1d

    offsets, light = profiles(values, lines)
    whole = np.isfinite(light).all(axis=1)
    if whole.sum() < 3:
        return None
    slope = np.full(light.shape, 0.0)
    slope[whole] = gaussian_filter1d(light[whole], _SMOOTHING / SAMPLING, axis=1, order=1, mode="nearest") / SAMPLING
    if rising is None:
        ups, downs = (np.sort(np.maximum(sign * slope[whole], 0).max(axis=1)) for sign in (1, -1))
        rising = bool(np.median(ups) >= np.median(downs))
    up = slope if rising else -slope
    peak = np.clip(up.argmax(axis=1), 1, len(offsets) - 2)
    each = np.arange(len(up))
    strength = np.where(whole, up[each, peak], 0.0)
    usual = float(np.median(strength[whole]))
    found = np.flatnonzero(whole & (strength > max(_FAINT * usual, 0.0)))
    if usual <= 0 or len(found) < 3:
        return None
    before, here, after = (up[found, peak[found] + shift] for shift in (-1, 0, 1))
    bend = np.maximum(2 * here - before - after, 1e-12 * np.abs(here) + 1e-300)
    fine = offsets[peak[found]] + np.clip((after - before) / (2 * bend), -0.75, 0.75) * SAMPLING
    total = float(np.median(up[found].clip(min=0).sum(axis=1) * SAMPLING / here)) / math.sqrt(2 * math.pi)
    width = math.sqrt(max(total**2 - _SMOOTHING**2, 0.05))
    if way == "moment":
        fine = _by_moments(light[found], offsets, fine, max(_WINDOW * width, _SHORTEST_WINDOW))
    return Crossings(found, fine, width, rising)


def check_unsaturated(usable: NDArray[np.bool_], lines: ScanLines, found: Crossings) -> None:
    """Refuse points of scan lines beside which pixels are saturated: there the steepest place is that of clipping.

    Raises
    ------
    InputError
        If that is so on more than a twentieth of them.
    """
    bad = np.zeros(len(found.line), dtype=np.bool_)
    for shift in (-_BESIDE, 0.0, _BESIDE):
        places = lines.origins[found.line] + (found.offsets + shift)[:, None] * lines.directions[found.line]
        u, v = (np.rint(part).astype(np.intp) for part in (places[:, 0], places[:, 1] / lines.aspect))
        bad |= ~usable[v.clip(0, usable.shape[0] - 1), u.clip(0, usable.shape[1] - 1)]
    if bad.mean() > _MOST_SATURATED:
        raise InputError(
            f"is saturated beside {bad.mean():.0%} of the rim", where="the image", remedy="shorten the exposure"
        )


def _by_moments(light: Array, offsets: Array, start: Array, half: float) -> Array:
    """Place of the sharp step of which the samples within half a window have the same first three moments."""
    place = start
    for _ in range(2):  # a window that lies askew pulls the step; the second lies even
        inside = np.abs(offsets - place[:, None]) <= half
        weight = inside / inside.sum(axis=1, keepdims=True)
        first = (weight * light).sum(axis=1, keepdims=True)
        off = light - first
        sigma = np.sqrt((weight * off**2).sum(axis=1))
        skew = (weight * off**3).sum(axis=1) / np.maximum(sigma, 1e-300) ** 3
        low = 0.5 * (1 + skew / np.sqrt(4 + skew**2))  # share of the samples on the dark side
        begin = np.where(inside, offsets, np.inf).min(axis=1) - SAMPLING / 2
        length = inside.sum(axis=1) * SAMPLING
        falls = (weight * off * (offsets - place[:, None])).sum(axis=1) < 0
        place = begin + np.where(falls, 1 - low, low) * length
    return np.asarray(np.where(np.isfinite(place), place, start), dtype=np.float64)
