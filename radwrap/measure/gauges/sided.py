"""Whether a blur has sides: coma, a second edge and a clipped level move the contour, and no symmetric blur does.

The blur of the fit is a sum of discs about one middle. Where a disc lies to one side of the others, light changes by
its derivative by the distance less that of all of them. How much of this is in what the fit leaves, beside all that its
own parameters take up, is a linear question (a score test): of so many unknowns noise makes a chi-square. It is asked
twice: of each disc by itself, and of discs that lie farther off as the squares of their radii, as coma has them, which
is one unknown in place of three.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.strip import State, Strip, jacobian_of, slopes_of

Array = NDArray[np.float64]

FALSE_ALARM: Final = 0.002  # of each question: a width of two edges has four, and 2 % of right ones may be warned of
# Of coma where something lies beside an open contour: few pixels are left to show it, and few right ones have that.
FALSE_ALARM_BESIDE: Final = 0.01
SMALLEST: Final = 0.001  # of the contrast, rms: less moves no contour, and in pictures without noise all is significant
_DEPENDENT: Final = 1e-3  # of a column's length; where no more is left beside the fit's own it is rounding
_SAME: Final = 1e-9  # of the largest, of the fit's own columns: what is left there is rounding
_FEWEST: Final = 3  # pixels for each parameter of the fit, of fewer nothing is asked
_WAVES: Final = 3  # around a closed contour: to its inside, and to two sides of the image


def has_sides(
    shape: Shape, strip: Strip, state: State, some: NDArray[np.bool_], *, noise: float, contrast: float
) -> bool:
    """Whether what the fit leaves has sides, by more than chance and by enough to matter.

    Parameters
    ----------
    shape, strip, state
        The fit with a sum of discs.
    some : ndarray of bool, shape (n,)
        Pixels of the strip that are asked: beside a neighbour light has sides that are not the blur's.
    noise : float
        Variance of a weighted pixel.
    contrast : float
        Of the contour [light].
    """
    by_disc = _by_disc(shape, strip, state)
    as_coma = _as_coma(by_disc, state)
    beside = _Beside.of(shape, strip, state, some)
    least = SMALLEST * contrast
    return any(beside.shows(question, noise=noise, least=least) for question in (by_disc, as_coma))


def has_coma(
    shape: Shape, strip: Strip, state: State, *, noise: float, contrast: float, false_alarm: float = FALSE_ALARM
) -> bool:
    """The question for coma, of pixels also farther away: levels that change across the contour hide less of it.

    Parameters
    ----------
    shape, strip, state, noise, contrast
        As above, of one rim, and with levels that suit these pixels.
    false_alarm : float
        Probability of a warning by chance.
    """
    if strip.light.size < _FEWEST * (len(shape.units) + state.terms.matrix.shape[1]) or not state.blur.shares.size:
        return False
    beside = _Beside.of(shape, strip, state, np.ones(strip.light.size, dtype=np.bool_))
    as_coma = _as_coma(_by_disc(shape, strip, state), state)
    # What lies there may be neither a slope nor coma: then it counts as noise.
    return beside.shows(as_coma, noise=max(noise, beside.variance), least=SMALLEST * contrast, false_alarm=false_alarm)


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """What a fit leaves of some pixels and of what it holds, and the span of its own parameters."""

    some: NDArray[np.bool_]
    own: Array
    other: Array
    residual: Array
    weight: float

    @classmethod
    def of(cls, shape: Shape, strip: Strip, state: State, some: NDArray[np.bool_]) -> _Beside:
        rows = np.append(some, np.ones(state.blur.shares.size, dtype=np.bool_))
        jacobian = jacobian_of(shape, strip, state)[rows]
        norms = np.linalg.norm(jacobian, axis=0)
        own, sizes, _ = np.linalg.svd(jacobian / np.where(norms > 0, norms, 1.0), full_matrices=False)
        residual = np.concatenate([state.residual, -state.blur.held * state.blur.shares])[rows]
        weight = float(np.median(strip.weight))
        alone = cls(some, own[:, sizes > _SAME * sizes[0]], np.zeros((len(residual), 0)), residual, weight)
        if len(state.rims) == 1 or shape.slopes.shape[1] == len(shape.slopes):
            return alone
        # Light that changes between two rims, which such a fit takes for level, has a side too.
        slopes = slopes_of(state.rims, [(rim.step, rim.ramp) for rim in state.terms.seen])
        return replace(alone, other=np.linalg.qr(alone.columns(strip.weight[:, None] * slopes))[0])

    @property
    def variance(self) -> float:
        """Of a weighted pixel, by what a fit to the same pixels would leave."""
        left = self.residual - self.own @ (self.own.T @ self.residual)
        return float(np.sum(left**2) / max(len(left) - self.own.shape[1], 1))

    def columns(self, columns: Array) -> Array:
        """What is left of columns, of which each is as long as 1, beside those of the fit."""
        here = columns[self.some]
        used = here[:, np.linalg.norm(here, axis=0) > 0]
        whole = np.zeros((len(self.residual), used.shape[1]))
        whole[: len(used)] = used / np.linalg.norm(used, axis=0)
        return np.asarray(whole - self.own @ (self.own.T @ whole))

    def shows(self, question: Array, *, noise: float, least: float, false_alarm: float = FALSE_ALARM) -> bool:
        """Whether columns are in what the fit leaves, by more than chance and by so much light, rms."""
        from scipy.special import chdtri  # of scipy.stats, which takes a second to load, the same

        columns = self.columns(question.reshape(len(question), -1))
        left, size, _ = np.linalg.svd(columns - self.other @ (self.other.T @ columns), full_matrices=False)
        found = left.T[size > _DEPENDENT] @ self.residual
        power, count = float(found @ found), len(found)
        enough = power > (least * self.weight) ** 2 * int(self.some.sum()) + count * noise
        return bool(count and enough and power > noise * float(chdtri(count, false_alarm)))


def _as_coma(by_disc: Array, state: State) -> Array:
    """All discs as coma moves them: by the squares of their radii."""
    return np.asarray((by_disc * np.square(state.blur.radii[1:])[:, None]).sum(axis=2))


def _by_disc(shape: Shape, strip: Strip, state: State) -> Array:
    """Weighted light by a shift of each further disc against all, shape (n, rims, discs, waves along the contour)."""
    terms = state.terms
    waves = terms.wide[:, : _WAVES if shape.closed else 1]
    by_rim = [
        np.stack([contrast * (disc.step_by_distance - seen.step_by_distance) for disc in discs[1:]], axis=1)
        for (contrast, _), seen, discs in zip(terms.at_rims(state.levels), terms.seen, terms.by_disc, strict=True)
    ]
    return np.asarray(strip.weight[:, None, None, None] * np.stack(by_rim, axis=1)[..., None] * waves[:, None, None])
