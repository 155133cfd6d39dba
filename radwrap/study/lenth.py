"""Which effects of an unreplicated two-level design stand out (Lenth 1989, key lenth1989).

Where no run is repeated, nothing tells the noise but the effects themselves: most of them are taken for noise, and
the median of their sizes, those left out that clearly are none, estimates its standard deviation, the PSE.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radwrap.errors import InputError
from radwrap.random_streams import Studying, generator

# With fewer contrasts t has less than 7/3 degrees of freedom, and the median hangs on one or two of them.
FEWEST_CONTRASTS: Final = 7
_OUTLYING: Final = 2.5
_TO_SIGMA: Final = 1.5  # median of |z| is 0.6745 sigma
# Draws of the reference; its quantiles are then known to 1 %.
_DRAWS: Final = 40_000


@dataclass(frozen=True, slots=True)
class Lenth:
    """Pseudo standard error of contrasts, and what exceeds it.

    Attributes
    ----------
    pse : float
        Pseudo standard error, in the unit of the contrasts.
    alpha : float
        Share of false alarms that is accepted.
    t : tuple of float
        Contrast/PSE, in the order given.
    t_limit : float
        t(1 - alpha/2; m/3): the limit of one contrast.
    t_limit_simultaneous : float
        The same for all m at a time, t((1 + (1 - alpha)^(1/m))/2; m/3).
    simulated_limit, simulated_limit_simultaneous : float
        Both from draws of m standard normal contrasts, where m/3 degrees of freedom are only an approximation.
    """

    pse: float
    alpha: float
    t: tuple[float, ...]
    t_limit: float
    t_limit_simultaneous: float
    simulated_limit: float
    simulated_limit_simultaneous: float

    @property
    def margin_of_error(self) -> float:
        """ME: an effect beyond it is significant."""
        return self.t_limit * self.pse

    @property
    def simultaneous_margin_of_error(self) -> float:
        """SME: beyond it although so many were looked at."""
        return self.t_limit_simultaneous * self.pse


def pseudo_standard_error(contrasts: NDArray[np.float64]) -> NDArray[np.float64]:
    """PSE along the last axis: 1.5 median of those |c| that stay below 2.5 s0, s0 = 1.5 median |c|."""
    sizes = np.abs(contrasts)
    first = _TO_SIGMA * np.median(sizes, axis=-1, keepdims=True)
    inner = np.where(sizes < _OUTLYING * first, sizes, np.nan)
    # Where all are zero none is smaller than 0: the error is 0 then.
    none = np.isnan(inner).all(axis=-1, keepdims=True)
    pse: NDArray[np.float64] = _TO_SIGMA * np.nanmedian(np.where(none, 0.0, inner), axis=-1)
    return pse


def lenth(contrasts: ArrayLike, alpha: float = 0.05) -> Lenth:
    """Judge the contrasts of an unreplicated orthogonal design.

    Parameters
    ----------
    contrasts : array_like, shape (m,)
        All of them, main effects and interactions: mean at high minus mean at low.
    alpha : float
        Share of false alarms.

    Raises
    ------
    InputError
        If there are fewer than `FEWEST_CONTRASTS`, one is not finite, all are zero, or alpha is no share.
    """
    values = np.asarray(contrasts, dtype=np.float64)
    check_contrasts(len(values))
    if not 0 < alpha < 1:
        raise InputError(f"{alpha:g} is not a share between 0 and 1", where="alpha")
    if not np.isfinite(values).all():
        raise InputError("an effect is not finite", where="the responses")
    pse = float(pseudo_standard_error(values))
    if pse == 0:
        raise InputError(
            "most effects are exactly zero: there is no noise to compare with",
            where="the responses",
            remedy="leave out the factors that change nothing",
        )
    count = len(values)
    single, simultaneous = _simulated(count, alpha)
    return Lenth(
        pse,
        alpha,
        tuple((values / pse).tolist()),
        t_limit(count, alpha),
        _quantile((1 + (1 - alpha) ** (1 / count)) / 2, count / 3),
        single,
        simultaneous,
    )


def check_contrasts(count: int) -> None:
    """Refuse too few contrasts."""
    if count < FEWEST_CONTRASTS:
        raise InputError(
            f"{count} contrasts are too few for Lenth's method, which needs {FEWEST_CONTRASTS} (8 runs)",
            remedy='repeat the runs (replicates = 2), or set analysis = "none"',
        )


def t_limit(count: int, alpha: float) -> float:
    """t(1 - alpha/2; m/3) for m contrasts."""
    return _quantile(1 - alpha / 2, count / 3)


def _quantile(share: float, freedom: float) -> float:
    from scipy.stats import t

    return float(t.ppf(share, freedom))


def _simulated(count: int, alpha: float) -> tuple[float, float]:
    """Limits of one contrast and of all, from contrasts that are nothing but noise."""
    random = generator(Studying.LENTH, count)
    batch = max(1, (1 << 22) // count)
    ratios = []
    for first in range(0, _DRAWS, batch):
        noise = random.standard_normal((min(batch, _DRAWS - first), count))
        ratios.append(np.abs(noise) / pseudo_standard_error(noise)[:, np.newaxis])
    all_ratios = np.concatenate(ratios)
    single = float(np.quantile(all_ratios, 1 - alpha))
    simultaneous = float(np.quantile(all_ratios.max(axis=1), 1 - alpha))
    if not (math.isfinite(single) and math.isfinite(simultaneous)):
        raise InputError("too few contrasts for a simulated limit")
    return single, simultaneous
