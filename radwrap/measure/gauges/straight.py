"""Place and direction of one straight edge or stripe, and the width between two edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.measure.gauges.calipers import Side, StraightCaliper
from radwrap.measure.gauges.contour import BEYOND, Contour
from radwrap.measure.gauges.narrow import NarrowFit
from radwrap.measure.gauges.points import PointFit
from radwrap.measure.gauges.response import Response
from radwrap.measure.gauges.scale import Plane
from radwrap.measure.gauges.scan import Way
from radwrap.measure.gauges.straight_fit import StraightGauge

Array = NDArray[np.float64]

_REMEDY: Final = "measure the blur at a single edge near it, or average frames"
_NOT_PARALLEL: Final = 5.0  # standard errors
_SLANT: Final = 0.05  # px over the caliper's length, below which two edges count as parallel


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A straight edge u cos(angle) + v sin(angle) = offset, or the middle of a stripe.

    Errors by noise are standard errors. Those by rendering are the largest change where no pixel is off by more than
    one gray level, with the worst signs; NaN where the way gives none.

    Attributes
    ----------
    angle, angle_sigma : float
        Of the normal, in -pi/2 to pi/2 [rad].
    offset : float
        Of the line from the first pixel's centre [px].
    centre : tuple of float
        Where it passes the caliper's middle, (u, v) [px].
    position_sigma, position_by_rendering : float
        Across the line at the centre [px].
    width, width_sigma, width_by_rendering : float or None
        Of a stripe [px]; None where a wider one with less blur, or the reverse, looks alike in this noise.
    bright_side : str or None
        "positive" where u cos + v sin > offset is bright, else "negative"; None of a stripe.
    inside : str or None
        "bright" or "dark", of a stripe.
    blur, blur_sigma : float
        Radius of the disc of blur [px]; NaN where the way gives none.
    misfit : float
        Departure from a straight line, rms beyond noise [px]; NaN where the way gives none.
    left_out : float
        Share of the edge that shows something else.
    points : int
        Pixels that were fitted, or points on scan lines.
    way : str
        How it was found.
    warnings : tuple of str
        Where the model does not fit.
    readings : tuple of tuple of float
        Where the width is not known: width and blur of both fits that look alike, the better one first [px].
    """

    angle: float
    angle_sigma: float
    offset: float
    centre: tuple[float, float]
    position_sigma: float
    position_by_rendering: float
    width: float | None
    width_sigma: float | None
    width_by_rendering: float | None
    bright_side: Literal["positive", "negative"] | None
    inside: Side | None
    blur: float
    blur_sigma: float
    misfit: float
    left_out: float
    points: int
    way: Way
    warnings: tuple[str, ...]
    readings: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Width:
    """Distance of two edges that face each other.

    Attributes
    ----------
    width, width_sigma, width_by_rendering : float or None
        At the caliper's middle; errors as of a `Line`. None of a stripe that is hardly wider than its blur, where
        another width with another blur looks alike: place and angle are known even so.
    unit : str
        "px" or "m", of the width.
    inside : str
        "bright" or "dark": what lies between them.
    angle, angle_sigma : float
        Of the mean normal, in -pi/2 to pi/2 [rad].
    slant, slant_sigma : float
        Angle between the edges [rad]; 0 where they were fitted as one stripe.
    centre : tuple of float
        Middle between them, (u, v) [px].
    blur : float
        Radius of the disc of blur, the mean of both [px]; NaN where the way gives none.
    misfit, left_out, points, way, warnings, readings
        As of a `Line`; the larger misfit, all warnings, and widths of readings in the `unit`.
    """

    width: float | None
    width_sigma: float | None
    width_by_rendering: float | None
    unit: Literal["px", "m"]
    inside: Side
    angle: float
    angle_sigma: float
    slant: float
    slant_sigma: float
    centre: tuple[float, float]
    blur: float
    misfit: float
    left_out: float
    points: int
    way: Way
    warnings: tuple[str, ...]
    readings: tuple[tuple[float, float], ...] = ()


def measure_line(
    image: GrayImage,
    caliper: StraightCaliper,
    *,
    response: Response | None = None,
    stripe: bool = False,
    bright_side: Literal["positive", "negative"] | None = None,
    way: Way = "model",
    pixel_aspect: float = 1.0,
) -> Line:
    """Measure the straight edge, or the stripe, that a caliper holds.

    Parameters
    ----------
    image : GrayImage
        Gray levels.
    caliper : StraightCaliper
        Where to look.
    response : Response, optional
        Of the camera; default gray levels that follow light.
    stripe : bool
        Whether to look for two edges of one stripe, and measure its middle.
    bright_side : str, optional
        "positive" if light lies where the caliper's normal points to; default the stronger edge.
    way : str
        "model", "gradient" or "moment".
    pixel_aspect : float
        Height of a pixel over its width.

    Returns
    -------
    Line
        With standard errors of noise.

    Raises
    ------
    InputError
        If there is no such edge.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.indices((40, 40))[1]
    >>> edge = 40 + 160 / (1 + np.exp((18.3 - u) * 3))
    >>> found = measure_line(GrayImage(edge), StraightCaliper((19, 20), 0.0, 30, 10))
    >>> bool(abs(found.offset - 18.3) < 0.05)
    True
    """
    gauge = StraightGauge.of(image, caliper, response, pixel_aspect)
    if stripe:
        both = gauge.pair(way)
        stripe_fit = gauge.stripe_fit(both, way)
        if isinstance(stripe_fit, PointFit):
            return _line(gauge, stripe_fit, way, None, both.inside)
        line = _line(gauge, stripe_fit.fit, way, None, both.inside)
        return line if stripe_fit.in_doubt is None else replace(line, **_without_width(line.warnings, stripe_fit))
    rising = None if bright_side is None else bright_side == "positive"
    found = gauge.crossings(rising, way)
    fit = gauge.edge_fit(found, way, caliper.band + 2)
    return _line(gauge, fit, way, found.rising, None)


def measure_width(
    image: GrayImage,
    caliper: StraightCaliper,
    *,
    response: Response | None = None,
    inside: Side | None = None,
    plane: Plane | None = None,
    way: Way = "model",
    pixel_aspect: float = 1.0,
) -> Width:
    """Measure the distance of two straight edges that face each other.

    Parameters
    ----------
    image : GrayImage
        Gray levels.
    caliper : StraightCaliper
        Where to look; both edges lie in its band.
    response : Response, optional
        Of the camera; default gray levels that follow light.
    inside : str, optional
        "bright" or "dark": what lies between the edges; default what the stronger edges say.
    plane : Plane, optional
        In which they lie.
    way : str
        "model", "gradient" or "moment".
    pixel_aspect : float
        Height of a pixel over its width.

    Returns
    -------
    Width
        With standard errors of noise.

    Raises
    ------
    InputError
        If there are no such edges.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.indices((40, 60))[1]
    >>> bar = 40 + 160 / (1 + np.exp((np.abs(u - 30) - 12.2) * 3))
    >>> found = measure_width(GrayImage(bar), StraightCaliper((30, 20), 0.0, 30, 25))
    >>> bool(abs(found.width - 24.4) < 0.1)
    True
    """
    gauge = StraightGauge.of(image, caliper, response, pixel_aspect)
    both = gauge.pair(way, inside)
    gap = both.gap
    blur = max(both.low.width, both.high.width) * 2
    if gap < 2 * (blur + BEYOND) and (plane is None or way == "model"):
        fit = gauge.stripe_fit(both, way, plane)
        if isinstance(fit, PointFit):
            return _width(gauge, [fit], both.inside, None, way)
        width = _width(gauge, [fit.fit], both.inside, plane, way)
        of_pixel = 1.0 if plane is None else gauge.pixel_in(plane)
        return width if fit.in_doubt is None else replace(width, **_without_width(width.warnings, fit, of_pixel))
    fits = [gauge.edge_fit(one, way, min(caliper.band, gap / 2)) for one in (both.low, both.high)]
    return _width(gauge, fits, both.inside, plane, way)


def _without_width(warnings: tuple[str, ...], fit: NarrowFit, of_pixel: float = 1.0) -> dict[str, Any]:
    """What changes where the width is not known; `of_pixel` is the length of a pixel."""
    told = f"the width is not known: {fit.in_doubt}: {_REMEDY}"
    unknown = dict.fromkeys(("width", "width_sigma", "width_by_rendering"))
    readings = tuple((width * of_pixel, blur) for width, blur in fit.readings)
    return {**unknown, "readings": readings, "warnings": (*warnings, told)}


def _rendering(fit: Contour | PointFit) -> Callable[[Array], float]:
    return fit.by_rendering if isinstance(fit, Contour) else lambda _: math.nan


def _quality(gauge: StraightGauge, fits: list[Contour | PointFit]) -> dict[str, Any]:
    """What fits have in common in all results."""
    models = [fit for fit in fits if isinstance(fit, Contour)]
    return {
        "blur": float(np.mean([fit.blur for fit in models])) if models else math.nan,
        "misfit": max(fit.misfit for fit in models) if models else math.nan,
        "left_out": max((fit.left_out for fit in models), default=0.0),
        "points": sum(fit.pixels if isinstance(fit, Contour) else fit.points for fit in fits),
        "warnings": (*dict.fromkeys(text for fit in models for text in fit.warnings), *gauge.dead),
    }


def _folded(angle: float) -> tuple[float, float]:
    """The same direction in -pi/2 to pi/2, and 1 or, where that turns it round, -1."""
    turned = (angle + math.pi / 2) % math.pi - math.pi / 2
    return turned, 1.0 if math.cos(turned - angle) > 0 else -1.0


def _line(gauge: StraightGauge, fit: Contour | PointFit, way: Way, rising: bool | None, inside: Side | None) -> Line:
    shift, turn = fit.parameters[:2]
    angle, sign = _folded(gauge.angle + turn)
    normal = sign * np.array([math.cos(angle), math.sin(angle)])
    at = (gauge.centre + shift * normal) / np.array([1.0, gauge.aspect])
    # Rows are `aspect` apart: the normal in the image itself.
    image_angle = math.atan2(gauge.aspect * math.sin(angle), math.cos(angle))
    by = _rendering(fit)
    position, width = np.eye(len(fit.parameters))[0], np.eye(len(fit.parameters))[-1]
    stripe = inside is not None
    side = None if rising is None else ("positive" if (sign > 0) == rising else "negative")
    return Line(
        angle=image_angle,
        angle_sigma=math.sqrt(fit.covariance[1, 1]),
        offset=float(at[0] * math.cos(image_angle) + at[1] * math.sin(image_angle)),
        centre=(float(at[0]), float(at[1])),
        position_sigma=math.sqrt(fit.covariance[0, 0]),
        position_by_rendering=by(position),
        width=float(fit.parameters[2]) if stripe else None,
        width_sigma=math.sqrt(fit.covariance[2, 2]) if stripe else None,
        width_by_rendering=by(width) if stripe else None,
        bright_side=side,  # type: ignore[arg-type]
        inside=inside,
        blur_sigma=fit.blur_sigma if isinstance(fit, Contour) else math.nan,
        way=way,
        **_quality(gauge, [fit]),
    )


def _width(gauge: StraightGauge, fits: list[Contour | PointFit], inside: Side, plane: Plane | None, way: Way) -> Width:
    parameters = np.concatenate([fit.parameters for fit in fits])
    covariance = np.zeros((len(parameters), len(parameters)))
    first = len(fits[0].parameters)
    covariance[:first, :first] = fits[0].covariance
    if len(fits) > 1:
        covariance[first:, first:] = fits[1].covariance
    # Of one stripe: shift, turn and width; of two edges: shift and turn of each.
    if len(fits) == 1:
        of_pixel = 1.0 if plane is None else gauge.pixel_in(plane)
        width, slopes, middle = of_pixel * float(parameters[2]), np.array([0.0, 0.0, of_pixel]), parameters[:2]
        slant, by_slant, by_turn = 0.0, np.zeros(3), np.array([0.0, 1.0, 0.0])
    else:
        step = np.array([1e-4, 1e-4 / gauge.length] * 2)
        width = gauge.distance(parameters, plane)
        ends = [(gauge.distance(parameters + h, plane) - gauge.distance(parameters - h, plane)) for h in np.diag(step)]
        slopes = np.array(ends) / (2 * step)
        middle = (parameters[:2] + parameters[2:]) / 2
        slant, by_slant = float(parameters[3] - parameters[1]), np.array([0.0, -1.0, 0.0, 1.0])
        by_turn = np.array([0.0, 0.5, 0.0, 0.5])
    slant_sigma = math.sqrt(by_slant @ covariance @ by_slant)
    angle, _ = _folded(gauge.angle + middle[1])
    normal = np.array([math.cos(gauge.angle + middle[1]), math.sin(gauge.angle + middle[1])])
    at = (gauge.centre + middle[0] * normal) / np.array([1.0, gauge.aspect])
    quality = _quality(gauge, fits)
    if abs(slant) > _NOT_PARALLEL * slant_sigma and abs(slant) * gauge.length > _SLANT and plane is None:
        quality["warnings"] += (
            f"the edges are not parallel: {math.degrees(slant):.3g} deg apart, so the width holds at the middle",
        )
    parts = np.split(slopes, [first]) if len(fits) > 1 else [slopes]
    return Width(
        width=abs(width),
        width_sigma=math.sqrt(slopes @ covariance @ slopes),
        width_by_rendering=sum(_rendering(fit)(part) for fit, part in zip(fits, parts, strict=True)),
        unit="px" if plane is None else "m",
        inside=inside,
        angle=math.atan2(gauge.aspect * math.sin(angle), math.cos(angle)),
        angle_sigma=math.sqrt(by_turn @ covariance @ by_turn),
        slant=slant,
        slant_sigma=slant_sigma,
        centre=(float(at[0]), float(at[1])),
        way=way,
        **quality,
    )
