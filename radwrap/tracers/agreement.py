"""Whether two tracers answer the same along the same rays."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.tracers.tracer import Tracer
from radwrap.written import NotNegative, Rays

# Two tracers that do the same arithmetic in other orders differ by 1e-6; Radiance's answers are float32.
SAME: Final = 2e-5
# What is darker than this share of the brightest is compared with that.
_DARK: Final = 1e-6
# Rays that meet a rim, or the rim of a shadow, may pass it on either side.
_CHANCE_HITS: Final = 2
# Radiance's hits on meshes are off by 1e-6 mm, so that up to some per cent of the points there lose the light of one
# source to their own triangle: as many rays may differ, if what they lack together is little.
_MESH_SHARE: Final = 0.02
_MESH_RMS: Final = 2e-4


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far two tracers agree.

    Attributes
    ----------
    rays : int
        That were compared.
    differing : int
        Whose radiances differ by more than 2e-5.
    largest_relative_difference : float
        Of the other rays.
    rms_relative_difference : float
        Root mean square of all differences but those that chance may make, over that of the radiance.
    agree : bool
        Whether the two tracers may stand for each other.
    """

    rays: Rays
    differing: Rays
    largest_relative_difference: NotNegative
    rms_relative_difference: NotNegative
    agree: bool


def agreement(
    reference: Tracer, other: Tracer, rays: NDArray[np.float64], places: int = 1, nothing: float = 0.0
) -> Agreement:
    """Compare the radiance of two tracers along rays, shape (n, 6).

    Where a ray's radiance comes from several places, such as those of a walk, each may be lit or met otherwise.
    Differences up to `nothing` are none: what is that dark a tracer may have lost to its number format.
    """
    expected, found = (_radiance(tracer, rays) for tracer in (reference, other))
    scale = np.maximum(expected, _DARK * expected.max(initial=0.0))
    difference = np.abs(found - expected)
    difference[difference <= nothing] = 0.0
    relative = np.where(difference > 0, difference / np.where(scale > 0, scale, 1.0), 0.0)
    relative[(scale == 0) & (difference > 0)] = np.inf
    same = relative <= SAME
    by_chance, own_shadows, most = _CHANCE_HITS * places, _MESH_SHARE * places * len(rays), _MESH_RMS * places
    rest = np.sort(difference)[: max(len(difference) - by_chance, 0)]
    mean_square = float((expected**2).mean())
    rms = float(np.sqrt((rest**2).sum() / len(rays) / mean_square)) if mean_square > 0 else float(rest.any())
    differing = int((~same).sum())
    return Agreement(
        rays=len(rays),
        differing=differing,
        largest_relative_difference=float(relative[same].max(initial=0.0)),
        rms_relative_difference=rms,
        agree=differing <= by_chance or (differing <= own_shadows and rms <= most),
    )


def _radiance(tracer: Tracer, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    with closing(tracer.trace([rays])) as answers:
        return next(answers)
