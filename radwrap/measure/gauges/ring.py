"""Both rims of a thin ring in one fit: within each other's blur, neither shows both of its levels."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.measure.gauges.calipers import Caliper
from radwrap.measure.gauges.contour import BEYOND, Contour, fit_contour
from radwrap.measure.gauges.narrow import fit_narrow
from radwrap.measure.gauges.response import Light
from radwrap.measure.gauges.rims import Rim, Shape
from radwrap.measure.gauges.scan import Crossings, ScanLines, crossings

Array = NDArray[np.float64]

_LEVEL: Final = 4.0  # px of level between the blurs of two rims, without which each is fitted with the other
_BEYOND: Final = 2.0  # px beyond both rims, where they are looked for
_MOST_OF_RADIUS: Final = 0.95
_FEWEST_SHARE: Final = 0.3  # of the scan lines, that must cross each rim


def thin(one: Caliper, other: Caliper, blur: float) -> bool:
    """Whether two rims lie in each other's blur [px]."""
    return abs(one.radius - other.radius) < 2 * blur + _LEVEL


def ring_middle(inner: Caliper, outer: Caliper) -> Caliper:
    """A caliper that holds both rims."""
    radius = (inner.radius + outer.radius) / 2
    band = (outer.radius - inner.radius) / 2 + max(inner.band, outer.band) + _BEYOND
    (u, v), (x, y) = inner.centre, outer.centre
    return Caliper(((u + x) / 2, (v + y) / 2), radius, min(band, _MOST_OF_RADIUS * radius), arc=outer.arc)


def ring_crossings(light: Light, lines: ScanLines) -> tuple[Crossings, Crossings]:
    """Where scan lines cross the inner and the outer rim: one rises, the other falls."""
    both = [crossings(light.values, lines, "gradient", rising) for rising in (True, False)]
    seen = [one for one in both if one is not None and len(one.line) >= _FEWEST_SHARE * len(lines.origins)]
    if len(seen) < 2:
        raise InputError(
            "shows no ring in the calipers' bands", where="the image", remedy="move the caliper, or widen its band"
        )
    inner, outer = sorted(seen, key=lambda one: float(np.median(one.offsets)))
    return inner, outer


def fit_ring(light: Light, shapes: tuple[Shape, Shape], blur: float, aspect: float) -> tuple[Contour, Contour]:
    """Fit two circles at once.

    Parameters
    ----------
    light : Light
        Of the image.
    shapes : tuple of Shape
        The inner and the outer rim: place, and radius last.
    blur : float
        Radius of the disc of blur to begin with [px].
    aspect : float
        Height of a pixel over its width.

    Returns
    -------
    inner, outer : Contour
        Quality and warnings are those of both.

    Raises
    ------
    InputError
        If another width and blur fits alike.
    """
    inner, outer = shapes
    # Mean of both, difference of their places, and width [px]: half of it is what the radii differ from their mean by.
    one, half = np.eye(len(outer.start)), np.eye(len(outer.start)) / 2
    half[-1, -1] *= outer.units[-1]
    to_outer, to_inner = np.hstack([one, half]), np.hstack([one, -half])

    def rims(parameters: Array, places: Array) -> list[Rim]:
        return [*outer.rims(to_outer @ parameters, places), *inner.rims(to_inner @ parameters, places)]

    units = np.tile(outer.units, 2)
    units[-1] = 1.0
    start = np.concatenate([(outer.start + inner.start) / 2, outer.start - inner.start])
    start[-1] /= outer.units[-1]
    shape = Shape(rims, start, units, outer.length, outer.closed)
    found = fit_narrow(
        shape, blur, lambda begin, wide: fit_contour(light, begin, wide, start[-1] + 2 * wide + BEYOND, aspect)
    )
    if found.in_doubt is not None:
        raise InputError(
            f"does not show how wide the ring is: {found.in_doubt}",
            where="the image",
            remedy="measure the blur at a single edge near it, or average frames",
        )
    return _part(found.fit, to_inner), _part(found.fit, to_outer)


def _part(fit: Contour, to: Array) -> Contour:
    """One of both."""
    return replace(
        fit, parameters=to @ fit.parameters, covariance=to @ fit.covariance @ to.T, influence=to @ fit.influence
    )
