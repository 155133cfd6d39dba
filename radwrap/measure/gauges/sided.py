"""Whether a blur has sides: coma, a second edge and a clipped level move the contour, and no symmetric blur does.

The blur of the fit is a sum of discs about one middle. Where a disc lies to one side of the others, light changes by
its derivative by the distance less that of all of them. How much of this is in what the fit leaves, beside all that its
own parameters take up, is a linear question (a score test): of so many unknowns noise makes a chi-square. It is asked
twice: of each disc by itself, and of discs that lie farther off as the squares of their radii, as coma has them, which
is one unknown in place of three.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.strip import State, Strip, jacobian_of, slopes_of

Array = NDArray[np.float64]

FALSE_ALARM: Final = 0.002  # of each question: a width of two edges has four, and 2 % of right ones may be warned of
SMALLEST: Final = 0.001  # of the contrast, rms: less moves no contour, and in pictures without noise all is significant
_DEPENDENT: Final = 1e-3  # of a column's length; where no more is left beside the fit's own it is rounding
_SAME: Final = 1e-9  # of the largest, of the fit's own columns: what is left there is rounding
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
    from scipy.special import chdtri  # of scipy.stats, which takes a second to load, the same

    rows = np.append(some, np.ones(state.blur.shares.size, dtype=np.bool_))
    jacobian = jacobian_of(shape, strip, state)[rows]
    norms = np.linalg.norm(jacobian, axis=0)
    own, sizes, _ = np.linalg.svd(jacobian / np.where(norms > 0, norms, 1.0), full_matrices=False)
    own = own[:, sizes > _SAME * sizes[0]]

    def beside(columns: Array) -> Array:
        """What is left of columns, of which each is as long as 1, beside those of the fit."""
        here = columns[some]
        used = here[:, np.linalg.norm(here, axis=0) > 0]
        whole = np.zeros((len(jacobian), used.shape[1]))
        whole[: len(used)] = used / np.linalg.norm(used, axis=0)
        return np.asarray(whole - own @ (own.T @ whole))

    residual = np.concatenate([state.residual, -state.blur.held * state.blur.shares])[rows]
    if len(state.rims) > 1 and shape.slopes.shape[1] < len(shape.slopes):
        # Light that changes between two rims, which such a fit takes for level, has a side too.
        slopes = slopes_of(state.rims, [(rim.step, rim.ramp) for rim in state.terms.seen])
        other = np.linalg.qr(beside(strip.weight[:, None] * slopes))[0]
    else:
        other = np.zeros((len(residual), 0))
    least = (SMALLEST * contrast * float(np.median(strip.weight))) ** 2 * int(some.sum())
    by_disc = _by_disc(shape, strip, state)
    as_coma = (by_disc * np.square(state.blur.radii[1:])[:, None]).sum(axis=2)
    for question in (by_disc, as_coma):
        columns = beside(question.reshape(len(question), -1))
        left, size, _ = np.linalg.svd(columns - other @ (other.T @ columns), full_matrices=False)
        found = left.T[size > _DEPENDENT] @ residual
        power, count = float(found @ found), len(found)
        if count and power > least + count * noise and power > noise * float(chdtri(count, FALSE_ALARM)):
            return True
    return False


def _by_disc(shape: Shape, strip: Strip, state: State) -> Array:
    """Weighted light by a shift of each further disc against all, shape (n, rims, discs, waves along the contour)."""
    terms = state.terms
    waves = terms.wide[:, : _WAVES if shape.closed else 1]
    by_rim = [
        np.stack([contrast * (disc.step_by_distance - seen.step_by_distance) for disc in discs[1:]], axis=1)
        for (contrast, _), seen, discs in zip(terms.at_rims(state.levels), terms.seen, terms.by_disc, strict=True)
    ]
    return np.asarray(strip.weight[:, None, None, None] * np.stack(by_rim, axis=1)[..., None] * waves[:, None, None])
