"""The least squares of an edge's model, with one disc for the blur and with whatever symmetric blur there is.

Few cameras blur by a disc. A blur with tails leaves a residual that slopes and curvature of the light take up as far as
they can. A sum of discs follows it, and where the light of the dark side may bend as that of the bright side may, the
model is its own mirror image: what it still cannot follow of a symmetric blur has no side to which to pull the edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.background import QUANTISATION
from radwrap.measure.edges.correlation import variance_factor
from radwrap.measure.edges.model import Model

Array = NDArray[np.float64]

# Radii over that of the disc that fits best. With these a Gaussian, a logistic curve and one with exponential tails
# leave a tenth of what one disc leaves, or less.
DISCS: Final = (0.5, 1.5, 2.5)
# Standard deviation of their shares beforehand, by one pixel: a share is at most of this order, and a blur that the
# pixels do not resolve has shares that nothing else holds.
USUAL_SHARE: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A model, its parameters, which of them were fitted, and how much the shares of discs were held to 0.

    Attributes
    ----------
    model : Model
    parameters : ndarray, shape (k,)
    free : ndarray of bool, shape (k,)
    held : float
        Gray levels that a share of 1 weighs as much as.
    """

    model: Model
    parameters: Array
    free: NDArray[np.bool_]
    held: float = 0.0

    @property
    def rows(self) -> Array:
        """What holds the shares, as more rows of the Jacobian."""
        shares = np.zeros((len(self.model.discs), self.free.size))
        shares[:, 4 : self.model.shapes] = self.held * np.eye(len(self.model.discs))
        return shares

    @property
    def variance(self) -> float:
        """Of a pixel, raised for what pixels have in common [gray^2]."""
        residual, strip = self.model.residual(self.parameters), self.model.strip
        variance = float(residual @ residual) / max(residual.size - int(self.free.sum()), 1)
        if (strip.gray == np.rint(strip.gray)).all():
            variance = max(variance, QUANTISATION)  # a fit without residual does not take rounding away
        line = self.model.line
        d, s = (way(strip.u, strip.v)[strip.usable] for way in (line.across, line.along))
        return variance * variance_factor(d, s, residual)


def fitted(
    model: Model,
    start: Array,
    free: NDArray[np.bool_],
    bounds: Array,
    *,
    tolerance: float,
    held: float = 0.0,
    look: Callable[[], None] = lambda: None,
) -> Fitted:
    """Least squares of the parameters that are free, within their bounds, shape (2, k).

    Parameters
    ----------
    model : Model
        With the pixels.
    start : ndarray, shape (k,)
        Parameters to begin with.
    free : ndarray of bool, shape (k,)
        Those to fit.
    bounds : ndarray, shape (2, k)
        Least and largest.
    tolerance : float
        Share of the sum of squares; an improvement below it is the last.
    held : float
        As of `Fitted`.
    look : callable
        Called for each trial.
    """
    from scipy.optimize import least_squares

    rows = Fitted(model, start, free, held).rows

    def whole(p: Array) -> Array:
        full = start.copy()
        full[free] = p
        return full

    def reduced(p: Array) -> tuple[Array, Array]:
        full = whole(p)
        jacobian, residual = model.reduced(full)
        return np.concatenate([jacobian, rows]), np.concatenate([residual, rows @ full])

    # Both come of one decomposition, and the solver asks for the Jacobian where it has just had the residual.
    here = start[free], *reduced(start[free])

    def at(p: Array) -> tuple[Array, Array]:
        nonlocal here
        if not np.array_equal(p, here[0]):
            here = p.copy(), *reduced(p)
            look()
        return here[1], here[2]

    solved = least_squares(
        lambda p: at(p)[1],
        start[free],
        jac=lambda p: at(p)[0][:, free],
        bounds=bounds[:, free],
        x_scale="jac",
        ftol=tolerance,
        xtol=1e-9,
        gtol=1e-12,
        max_nfev=100,
    )
    return Fitted(model, whole(solved.x), free, held)


def any_blur(disc: Fitted, look: Callable[[], None]) -> Fitted:
    """The fit with a sum of discs for the blur, the first of which is the one that fits best, and a bent dark side."""
    model, levels = disc.model, 4 + disc.model.base.shape[1]
    across = model.line.across(model.strip.u, model.strip.v) / model.line.half_width
    wider = replace(model, base=np.column_stack([model.base, across**2]), discs=DISCS)
    shares = np.zeros(len(DISCS))

    def longer(values: Array, new: Array | float, bent: float) -> Array:
        return np.concatenate([values[:4], new + shares, values[4:levels], [bent], values[levels:]])

    start = longer(disc.parameters, 0.0, 0.0)
    free = longer(disc.free.astype(np.float64), 1.0, 1.0) > 0
    free[2] = False
    bounds = np.full((2, start.size), [[-np.inf], [np.inf]])
    bounds[:, 3] = 0.0, np.inf
    residual = model.residual(disc.parameters)
    held = math.sqrt(float(residual @ residual) / residual.size) / USUAL_SHARE
    return fitted(wider, start, free, bounds, tolerance=1e-8, held=held, look=look)


def beyond_disc(disc: Fitted, anyhow: Fitted) -> float:
    """By how much the other discs fit better than noise lets them [standard deviations of chi-square]."""
    rises = [float(np.sum(one.model.residual(one.parameters) ** 2)) for one in (disc, anyhow)]
    free = int(anyhow.free.sum() - disc.free.sum())
    return ((rises[0] - rises[1]) / max(anyhow.variance, 1e-300) - free) / math.sqrt(2 * free)


def covariance_of(disc: Fitted, anyhow: Fitted) -> Array:
    """Of the parameters with any blur, among them the radius, which is that of the fit with one disc.

    Returns
    -------
    ndarray, shape (k, k)
        0 of parameters that were not fitted.
    """
    jacobian = np.concatenate([anyhow.model.reduced(anyhow.parameters)[0], anyhow.rows])
    by_disc = anyhow.free.copy()
    by_disc[4 : anyhow.model.shapes] = by_disc[anyhow.model.shapes + disc.model.base.shape[1]] = False
    by_disc[2] = True
    influence = _influence(jacobian, anyhow.free) * math.sqrt(anyhow.variance)
    influence[2] = _influence(jacobian, by_disc)[2] * math.sqrt(disc.variance)
    return np.asarray(influence @ influence.T)


def _influence(jacobian: Array, free: NDArray[np.bool_]) -> Array:
    """What a row's error does to the parameters that are free; 0 of others."""
    some = jacobian[:, free]
    # The levels' columns can be all but dependent where light is even: the pseudo-inverse leaves out what is not there.
    norms = np.linalg.norm(some, axis=0)
    norms[norms == 0] = 1.0
    found = np.zeros((free.size, len(jacobian)))
    found[free] = np.linalg.pinv(some / norms, rcond=1e-10) / norms[:, None]
    return found
