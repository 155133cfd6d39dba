"""Where in its pitch a pixel is sensitive: f(x, y) of Eq. 2, as a product of two profiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Profile:
    """Sensitivity across a pixel in strips, its integral taken as 1.

    Attributes
    ----------
    edges : tuple of float
        Increasing, from -0.5 to 0.5 pitch at most; outside there is none.
    weights : tuple of float
        Share of each strip; their sum is 1, one less than edges.
    """

    edges: tuple[float, ...] = (-0.5, 0.5)
    weights: tuple[float, ...] = (1.0,)

    @property
    def is_whole(self) -> bool:
        """Whether the whole pitch is sensitive alike."""
        return self.edges == (-0.5, 0.5)

    @property
    def _sums(self) -> Array:
        sums = np.concatenate([[0.0], np.cumsum(self.weights)])
        sums[-1] = 1.0
        return sums

    def share_below(self, place: Array) -> Array:
        """Share of the sensitivity below a place from the pixel's middle [pitch]."""
        if self.is_whole:
            whole: Array = np.clip(place + 0.5, 0.0, 1.0)
            return whole
        return np.interp(place, self.edges, self._sums)

    def place(self, share: Array) -> Array:
        """Place below which a share, 0 to 1, of the sensitivity lies [pitch]; the inverse of `share_below`."""
        if self.is_whole:
            whole: Array = share - 0.5
            return whole
        sums, edges = self._sums, np.asarray(self.edges)
        strip = np.clip(np.searchsorted(sums, share, side="right") - 1, 0, len(self.weights) - 1)
        # A strip that sees nothing is never met, save by rounding.
        weight = np.maximum(np.asarray(self.weights)[strip], np.finfo(float).tiny)
        inside = np.clip((share - sums[strip]) / weight, 0.0, 1.0)
        found: Array = edges[strip] + inside * (edges[strip + 1] - edges[strip])
        return found


WHOLE = Profile()


@dataclass(frozen=True, slots=True)
class PixelWindow:
    """Sensitivity over the pixel: f(x, y) = across(x) down(y).

    Attributes
    ----------
    across, down : Profile
        Along a row and along a column of the sensor.
    """

    across: Profile = WHOLE
    down: Profile = WHOLE

    def places(self, shares: Array) -> Array:
        """Places from the pixel's middle [px] for points of the unit square, shape (..., 2): Eq. 2 by equal shares."""
        return np.stack([self.across.place(shares[..., 0]), self.down.place(shares[..., 1])], axis=-1)


def box(width: float) -> Profile:
    """A strip of some width in the middle [pitch]: the fill factor of one axis."""
    return Profile((-width / 2, width / 2), (1.0,))


def strips(sensitivities: tuple[float, ...]) -> Profile:
    """Strips of equal width over the whole pitch, of some sensitivities, not all 0."""
    number, total = len(sensitivities), float(np.sum(sensitivities))
    edges = tuple((k / number) - 0.5 for k in range(number + 1))
    return Profile(edges, tuple(value / total for value in sensitivities))
