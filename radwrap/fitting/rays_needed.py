"""How many unbiased rays each pixel needs, so that intervals are nearly as narrow as noise lets them be.

What the rays of a pixel are off by moves the keys as its noise does. Let w be the share of the keys' variance by noise
that is this pixel's, and v the variance of a single ray over that of noise. The sum of w v n^-p over pixels, of some
number of rays in all, is least for n in proportion to (w v)^(1/(1 + p)) (J. Neyman, Journal of the Royal Statistical
Society 97, 1934, for p = 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.fitting.covariance import GRAIN, SURE, inverse_of
from radwrap.fitting.prediction import Prediction
from radwrap.fitting.settled import Grained, Settled
from radwrap.fitting.solution import Solution
from radwrap.imaging.demand import FEWEST, MOST
from radwrap.imaging.methods.rays import ORDER, pooled, spare_rays
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import AimedRays, SourceImages

Array = NDArray[np.float64]
WIDER: Final = (
    0.1  # of an interval: so much the rays of the prediction may add to it. Half of that takes 1.8 times the rays
)
_FALLS: Final = 2 * ORDER  # p: so the variance of a pixel's mean falls with its rays


def rays_needed(
    prediction: Prediction,
    bases: Sequence[Basis | SourceImages],
    near: Settled,
    solved: Solution,
    grained: Grained,
    *,
    aimed: AimedRays,
    share: int,
) -> list[NDArray[np.intp] | None]:
    """Rays of each pixel and replicate, for each of the prediction's places; None where rays are not told by pixels.

    Parameters
    ----------
    prediction, bases, near, solved, grained
        What few rays led to: they say how much a ray scatters, and none of them may be in what is traced by the answer.
    aimed : AimedRays
        What the whole image is to keep besides, as the verdict counts all pixels.
    share : int
        The few are one of so many that the whole image takes at most: it keeps the aim by these.
    """
    traced = [one.numbers for one in bases if isinstance(one, SourceImages) and one.numbers is not None]
    if len(traced) < len(bases):
        return [None] * len(bases)
    at = [prediction.places.index(places) for _, places in prediction.shots]
    used, count = solved.weighed.used, np.count_nonzero(solved.weighed.used)
    seen = near.replicates(solved.values)
    one_ray = seen.std(axis=0, ddof=1) * np.concatenate([traced[place] for place in at]) ** ORDER
    # Four replicates know little of a pixel by itself.
    one_ray = np.concatenate([pooled(one) for one in np.split(one_ray, len(at))])
    moved = _moved(solved, grained)
    found = np.zeros((len(moved) + 1, *np.shape(traced)))
    left_out = np.zeros(np.shape(traced), dtype=np.bool_)
    # Captures in one light have all rays in common: what these are off by moves a key by their sum.
    of_shots = np.split(moved, len(at), axis=1), np.split(one_ray, len(at)), np.split(used, len(at))
    for place, key, ray, counts in zip(at, *of_shots, strict=True):
        found[:-1, place] += key * ray
        found[-1, place] += counts * ray**2 / (count * aimed.rms**2)
        left_out[place] |= ~counts
    keys = (found[:-1] ** 2).sum(axis=0) / max(len(moved), 1) / widening(WIDER, aimed.replicates)
    most = share * sum(float(one.sum()) for one in traced) * len(seen) / aimed.replicates
    wanted = shared_out(np.stack([keys, found[-1]]) / aimed.replicates, most)
    # A pixel that saturates, if it had few rays, would be seen below saturation by chance, and count for its error.
    least = np.where(left_out, traced, FEWEST)
    return [np.maximum(one, np.maximum(few, spare_rays(one, FEWEST))) for one, few in zip(wanted, least, strict=True)]


def _moved(solved: Solution, grained: Grained) -> Array:
    """What a gray level more of each pixel moves each key by, over its deviation by noise; of keys that move at all.

    Returns
    -------
    ndarray, shape (keys, captures * rows, columns)
    """
    used, sigma = solved.weighed.used, solved.weighed.sigma[solved.weighed.used]
    inverse = inverse_of(solved.jacobian, GRAIN, grained.over(used, sigma).slopes).matrix
    deviations = np.linalg.norm(inverse, axis=1, keepdims=True)
    moving = deviations[:, 0] > 0
    found = np.zeros((np.count_nonzero(moving), *used.shape))
    found[:, used] = inverse[moving] / deviations[moving] / sigma
    return found


def widening(share: float, replicates: int) -> float:
    """Variance of rays over that of noise, where it widens an interval by some share; few replicates count by t."""
    from scipy.stats import norm, t

    sure = 0.5 + SURE / 2
    return ((1 + share) ** 2 - 1) * float(norm.ppf(sure) / t.ppf(sure, replicates - 1)) ** 2


def shared_out(needs: Array, most: float = np.inf) -> NDArray[np.intp]:
    """About the fewest rays n, powers of 2, with which no sum of needs n^-p is more than 1, shape (...).

    Parameters
    ----------
    needs : ndarray, shape (sums, ...)
        What each pixel adds to each sum by a single ray.
    most : float
        Rays of all pixels: where the sums would take more, they are as small as these make them.
    """
    root = needs.sum(axis=0) ** (1 / (1 + _FALLS))
    less = np.divide(1.0, root, out=np.zeros_like(root), where=root > 0) ** _FALLS
    largest = float((needs * less).reshape(len(needs), -1).sum(axis=1).max())
    wanted = largest ** (1 / _FALLS) * root
    wanted = np.clip(wanted * min(most / max(float(wanted.sum()), 1.0), 1.0), FEWEST, MOST)
    return np.asarray(2 ** np.rint(np.log2(wanted)), dtype=np.intp)
