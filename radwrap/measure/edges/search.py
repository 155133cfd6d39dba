"""The first idea of where a straight edge is: gradients vote for the line that they stand on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.measure.background import noise_level
from radwrap.progress import Progress

Array = NDArray[np.float64]

SMOOTHING: Final = 1.5  # px; of the gradients that find the edge: noise falls to 9 %, edges stay apart
FAINTEST: Final = 7.0  # times the gradient's noise; the largest of 10^6 noise pixels reaches 5
RIVAL_SHARE: Final = 0.5  # of the strongest line's votes; a second line with more makes the edge ambiguous
VISIBLE: Final = 0.25  # of the strongest gradient; weaker ones do not vote
MOST_VOTERS: Final = 1 << 21  # of more every second one votes, or every third: they only say where to look
_BAND: Final = 64  # rows
_HALO: Final = 6  # px; SciPy's Gaussian ends after four standard deviations


@dataclass(frozen=True, slots=True)
class Line:
    """A first idea of the edge: its normal points to the bright side; ends are along (-sin, cos) from the centre."""

    angle: float
    centre: tuple[float, float]
    radius: float
    ends: tuple[float, float]

    @property
    def half_width(self) -> float:
        """Of the strip to fit: the blur, and on each side enough to know level and slope [px]."""
        return 2.5 * self.radius + 6.0

    def across(self, u: Array, v: Array) -> Array:
        """Distance from the line, positive on the bright side [px]."""
        return (u - self.centre[0]) * math.cos(self.angle) + (v - self.centre[1]) * math.sin(self.angle)

    def along(self, u: Array, v: Array) -> Array:
        """Place along the line, from the centre [px]."""
        return (v - self.centre[1]) * math.cos(self.angle) - (u - self.centre[0]) * math.sin(self.angle)

    def shift_from(self, other: Line) -> float:
        """Distance of this line's centre from another line [px]."""
        return float(other.across(np.array(self.centre[0]), np.array(self.centre[1])))


def find_line(values: Array, progress: Progress | None = None) -> Line:
    """The strongest straight edge by votes of gradients, each for the one line that it stands on."""
    strength = np.empty(values.shape)
    for first in range(0, len(values), _BAND):  # of a large picture one array is enough
        band = np.s_[first : first + _BAND, :]
        strength[band] = np.hypot(*_gradient(values, *band))
        if progress is not None:
            progress.add(strength[band].size)
    rim = 2
    strength[:rim] = strength[-rim:] = 0
    strength[:, :rim] = strength[:, -rim:] = 0
    peak = float(np.quantile(strength, 0.999))
    noise = noise_level(values) / (math.sqrt(8 * math.pi) * SMOOTHING**2)
    if peak <= max(FAINTEST * noise, 1e-9 * float(np.ptp(values))):
        raise InputError("shows no edge above its noise", where="the image", remedy="raise contrast or exposure")
    u, v, direction, weight = _voters(values, strength, VISIBLE * peak)
    votes, angle, rho = _strongest(u, v, direction, weight)
    for reach in (4.0, 4.0, 3.0, 3.0):
        distance = u * math.cos(angle) + v * math.sin(angle) - rho
        near = (np.abs(distance) < reach + _spread(distance, weight)) & (_turn(direction, angle) < math.radians(25))
        if not near.any():
            raise InputError(
                "shows no straight edge: its gradients lie along no line",
                where="the image",
                remedy="name a region that holds one edge",
            )
        angle, centre = _through(u[near], v[near], weight[near] ** 2, angle)
        rho = centre[0] * math.cos(angle) + centre[1] * math.sin(angle)
    distance = u * math.cos(angle) + v * math.sin(angle) - rho
    spread = _spread(distance, weight)
    rest = (np.abs(distance) > 2.5 * spread + 4.0) | (_turn(direction, angle) > math.radians(45))
    if rest.any():
        rival, other, _ = _strongest(u[rest], v[rest], direction[rest], weight[rest])
        if rival > RIVAL_SHARE * votes:
            raise InputError(
                "shows no single straight edge: beside the one at "
                f"{math.degrees(normal_angle(angle)):.0f} deg another at "
                f"{math.degrees(normal_angle(other)):.0f} deg has {rival / votes:.0%} of its strength",
                where="the image",
                remedy="name a region that holds one edge",
            )
    line = Line(angle, centre, max(2 * math.sqrt(max(spread**2 - SMOOTHING**2, 0.0)), 0.5), (0.0, 0.0))
    along = line.along(u[~rest], v[~rest])
    ends = float(np.quantile(along, 0.01)), float(np.quantile(along, 0.99))
    return Line(angle, centre, line.radius, ends)


def _gradient(values: Array, rows: slice, columns: slice) -> tuple[Array, Array]:
    """Smoothed gradient along u and v in a part of the image."""
    from scipy import ndimage

    (top, bottom, _), (left, right, _) = rows.indices(values.shape[0]), columns.indices(values.shape[1])
    first, start = max(top - _HALO, 0), max(left - _HALO, 0)
    part = values[first : bottom + _HALO, start : right + _HALO]
    inside = np.s_[top - first : bottom - first, left - start : right - start]
    along_u, along_v = (ndimage.gaussian_filter(part, SMOOTHING, order=o)[inside] for o in ((0, 1), (1, 0)))
    return along_u, along_v


def _voters(values: Array, strength: Array, least: float) -> tuple[Array, Array, Array, Array]:
    """Column, row, direction and strength of the gradients above the least one."""
    bands = []
    for first in range(0, len(values), _BAND):
        visible = strength[first : first + _BAND] > least
        across = np.flatnonzero(visible.any(axis=0))
        if across.size == 0:
            continue
        columns = slice(int(across[0]), int(across[-1]) + 1)
        along_u, along_v = _gradient(values, slice(first, first + _BAND), columns)
        v, u = np.nonzero(visible[:, columns])
        direction = np.arctan2(along_v[v, u], along_u[v, u])
        bands.append(np.stack([u + columns.start, v + first, direction, strength[v + first, u + columns.start]]))
    voters = np.concatenate(bands, axis=1)
    u, v, direction, weight = voters[:, :: -(-voters.shape[1] // MOST_VOTERS)]
    return u, v, direction, weight


def _turn(directions: Array, angle: float) -> Array:
    turn: Array = np.abs(np.angle(np.exp(1j * (directions - angle))))
    return turn


def normal_angle(angle: float) -> float:
    """The angle of the same line in -pi/2 < angle <= pi/2."""
    return math.pi / 2 - (math.pi / 2 - angle) % math.pi


def _spread(distance: Array, weight: Array) -> float:
    """Half-width of the gradients' ridge, as a standard deviation [px]; far pixels belong to something else."""
    near = np.abs(distance) < 3.0
    for _ in range(20):
        sigma = math.sqrt(float(np.average(distance[near] ** 2, weights=weight[near]))) if near.any() else SMOOTHING
        wider = np.abs(distance) < 3.0 * sigma + 1.0
        if np.array_equal(wider, near):
            break
        near = wider
    return sigma


def _strongest(u: Array, v: Array, direction: Array, weight: Array) -> tuple[float, float, float]:
    """Votes, angle [rad] and offset [px] of the line that most gradients stand on."""
    from scipy import ndimage

    rho = u * np.cos(direction) + v * np.sin(direction)
    size = float(np.hypot(u.max(), v.max())) + 1.0
    votes, angles, offsets = np.histogram2d(
        direction,
        rho,
        bins=(120, max(8, round(size))),
        range=((-math.pi, math.pi), (-size, size)),
        weights=weight,
    )
    votes = ndimage.gaussian_filter(votes, (1.0, 1.5), mode=("wrap", "constant"))
    i, j = np.unravel_index(int(np.argmax(votes)), votes.shape)
    return float(votes[i, j]), float(angles[i : i + 2].mean()), float(offsets[j : j + 2].mean())


def _through(u: Array, v: Array, weight: Array, angle: float) -> tuple[float, tuple[float, float]]:
    """Line of least weighted square distance; its normal stays on the side of `angle`."""
    centre = float(np.average(u, weights=weight)), float(np.average(v, weights=weight))
    spread = np.cov(np.stack([u, v]), aweights=weight, ddof=0)
    across = np.linalg.eigh(spread)[1][:, 0]
    if across @ np.array([math.cos(angle), math.sin(angle)]) < 0:
        across = -across
    return math.atan2(across[1], across[0]), centre
