"""Diameter and centre of a circle, whole or in part; of an ellipse; and of a circle in a tilted plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.gauges.calipers import Caliper, Side
from radwrap.measure.gauges.contour import Contour, fit_contour
from radwrap.measure.gauges.dead import light_that_is_seen
from radwrap.measure.gauges.points import PointFit, fit_points, robust_circle
from radwrap.measure.gauges.response import Light, Response
from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.ring import fit_ring, ring_crossings, ring_middle, thin
from radwrap.measure.gauges.round_shapes import circle_shape, ellipse_shape, plane_shape
from radwrap.measure.gauges.scale import Plane
from radwrap.measure.gauges.scan import ScanLines, Way, check_unsaturated, crossings

Array = NDArray[np.float64]
Form = Literal["circle", "ellipse"]

_FEWEST_POINTS: Final = 8
_FEWEST_SHARE: Final = 0.45  # of the scan lines, that must lie on the rim
_TURN: Final = 2 * math.pi
_BLURS: Final = 2.5  # of a radius, the fewest without a warning
_FEWEST_BLURS: Final = 1.3  # below, radius and blur hang together, and their standard errors are not known


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """A circle, or an ellipse, with its errors.

    Errors by noise are standard errors. Those by rendering are the largest change where no pixel is off by more than
    one gray level, with the worst signs; NaN where the way gives none.

    Attributes
    ----------
    centre, centre_sigma, centre_by_rendering : tuple of float
        (u, v) [px].
    diameters, diameters_sigma, diameters_by_rendering : tuple of float
        One of a circle, [px] or, in a plane, [m]; the major and the minor axis of an ellipse [px].
    unit : str
        "px" or "m", of diameters.
    orientation, orientation_sigma : float or None
        Direction of an ellipse's major axis, from u towards v, -pi/2 to pi/2 [rad].
    centre_in_plane, centre_in_plane_sigma : tuple of float or None
        In the plane [m].
    inside : str
        "bright" or "dark".
    blur, blur_sigma : float
        Radius of the disc of blur [px]; NaN where the way gives none.
    misfit : float
        Departure of the rim from the shape, rms beyond noise [px]; NaN where the way gives none.
    left_out : float
        Share of the rim that shows something else.
    points : int
        Pixels that were fitted, or points on scan lines.
    way : str
        How the rim was found.
    warnings : tuple of str
        Where the model does not fit.
    """

    centre: tuple[float, ...]
    centre_sigma: tuple[float, ...]
    centre_by_rendering: tuple[float, ...]
    diameters: tuple[float, ...]
    diameters_sigma: tuple[float, ...]
    diameters_by_rendering: tuple[float, ...]
    unit: Literal["px", "m"]
    orientation: float | None
    orientation_sigma: float | None
    centre_in_plane: tuple[float, ...] | None
    centre_in_plane_sigma: tuple[float, ...] | None
    inside: Side
    blur: float
    blur_sigma: float
    misfit: float
    left_out: float
    points: int
    way: Way
    warnings: tuple[str, ...]

    @property
    def diameter(self) -> float:
        """Of a circle; an ellipse has two axes and none."""
        return self.diameters[0] if len(self.diameters) == 1 else math.nan

    @property
    def diameter_sigma(self) -> float:
        """Its standard error by noise."""
        return self.diameters_sigma[0] if len(self.diameters) == 1 else math.nan


def measure_circle(
    image: GrayImage,
    caliper: Caliper,
    *,
    response: Response | None = None,
    form: Form = "circle",
    plane: Plane | None = None,
    beside: Caliper | None = None,
    way: Way = "model",
    pixel_aspect: float = 1.0,
) -> Circle:
    """Measure the circle that a caliper holds.

    Parameters
    ----------
    image : GrayImage
        Gray levels.
    caliper : Caliper
        Where to look.
    response : Response, optional
        Of the camera; default gray levels that follow light.
    form : str
        "circle" or "ellipse".
    plane : Plane, optional
        In which the circle lies; then it is round there, whatever the image shows.
    beside : Caliper, optional
        The other rim of a ring. Where the two lie in each other's blur the model is fitted to both at once.
    way : str
        "model": a fit of the blurred step; "gradient", "moment": points along scan lines, for comparison with what
        other programs do. Blur across a bent rim moves their points, and no standard error holds that.
    pixel_aspect : float
        Height of a pixel over its width.

    Returns
    -------
    Circle
        With standard errors of noise.

    Raises
    ------
    InputError
        If there is no such circle, or the two rims of a thin ring cannot be told from more or less blur.

    Examples
    --------
    >>> import numpy as np
    >>> v, u = np.indices((64, 64))
    >>> disc = 40 + 160 / (1 + np.exp((np.hypot(u - 31.5, v - 30.0) - 20.0) * 3))
    >>> found = measure_circle(GrayImage(disc), Caliper((31, 31), 19, 6))
    >>> bool(abs(found.diameter - 40) < 0.02)
    True
    """
    if not 0.01 <= pixel_aspect <= 100:
        raise InputError("must lie between 0.01 and 100", where="pixel_aspect", remedy="give height over width")
    if form == "ellipse" and plane is not None:
        raise InputError("in a plane a circle is measured", where="shape", remedy="leave it out")
    reach = max(one.radius + one.band for one in (caliper, beside or caliper))
    light, dead = light_that_is_seen(image, response, caliper.centre, (reach, reach / pixel_aspect))
    found = _measured(light, caliper, beside, way, _Named(form, plane, pixel_aspect))
    return replace(found, warnings=(*found.warnings, *dead))


def _measured(light: Light, caliper: Caliper, beside: Caliper | None, way: Way, named: _Named) -> Circle:
    form, plane, pixel_aspect = named.form, named.plane, named.aspect
    lines = _scan_lines(caliper, pixel_aspect)
    rising = None if caliper.inside is None else caliper.inside == "dark"
    found = crossings(light.values, lines, "moment" if way == "moment" else "gradient", rising)
    width = math.inf if found is None else 2 * found.width
    if way == "model" and beside is not None and thin(caliper, beside, width):
        if form == "ellipse":
            raise InputError(
                "shows two rims in each other's blur", where="the image", remedy="measure circles, or in a plane"
            )
        return _of_ring(light, (caliper, beside), named)
    if found is None:
        raise _no_rim()
    points = lines.origins[found.line] + found.offsets[:, None] * lines.directions[found.line]
    centre, radius, near = robust_circle(points, _nearness(caliper, form, plane))
    fewest = max(_FEWEST_POINTS, _FEWEST_SHARE * len(lines.origins))
    if near.sum() < fewest or not abs(radius - caliper.radius) <= caliper.band:
        raise _no_rim()
    shape = _shape(caliper, (centre, radius), -1.0 if found.rising else 1.0, named)
    fit: Contour | PointFit
    if way == "model":
        if form == "ellipse" or plane is not None:
            shape = replace(shape, start=fit_points(shape, points[near]).parameters)
        fit = _larger_than_blur(
            shape, 2 * found.width, lambda begin, blur: fit_contour(light, begin, blur, caliper.band + 2, pixel_aspect)
        )
    else:
        check_unsaturated(light.usable, lines, found)
        fit = fit_points(shape, points[near])
    return _circle(fit, named, way, "dark" if found.rising else "bright", 1 - float(near.mean()))


def _larger_than_blur(shape: Shape, blur: float, fitted: Callable[[Shape, float], Contour]) -> Contour:
    """The fit whose radius is larger than its blur: that of both exchanged looks the same, of another contrast."""
    fit = fitted(shape, blur)
    if (blurs := _blurs(shape, fit)) < 1:
        parameters = fit.parameters.copy()
        parameters[_sizes(shape)] /= blurs
        fit = fitted(replace(shape, start=parameters), fit.blur * blurs)
        blurs = _blurs(shape, fit)
    if blurs < _FEWEST_BLURS:
        raise InputError(
            f"does not show the size of what is hardly larger than its blur: {blurs:.2g} blurs of {fit.blur:.2g} px",
            where="the image",
            remedy="focus better, or take a longer lens",
        )
    if blurs >= _BLURS:
        return fit
    told = (
        f"the radius is {blurs:.2g} times the blur: the other way round, with the radius and the blur exchanged, the "
        f"image is the same but for {blurs**2:.2g} times the contrast, and the diameter hangs on the kind of blur"
    )
    return replace(fit, warnings=(*fit.warnings, told))


def _sizes(shape: Shape) -> slice:
    """Which parameters are the radius, or the semi-axes."""
    return slice(2, min(4, len(shape.start)))


def _blurs(shape: Shape, fit: Contour) -> float:
    """Mean radius in the image over the blur."""
    sizes = _sizes(shape)
    return float(np.mean(np.abs(fit.parameters[sizes] / shape.units[sizes]))) / fit.blur


def _of_ring(light: Light, calipers: tuple[Caliper, Caliper], named: _Named) -> Circle:
    """The first of two rims that are fitted at once."""
    inner, outer = sorted(calipers, key=lambda one: one.radius)
    lines = _scan_lines(ring_middle(inner, outer), named.aspect)
    both = ring_crossings(light, lines)
    shapes = []
    for rim, found in zip((inner, outer), both, strict=True):
        points = lines.origins[found.line] + found.offsets[:, None] * lines.directions[found.line]
        centre, radius, near = robust_circle(points, _nearness(rim, named.form, named.plane))
        if near.sum() < _FEWEST_SHARE * len(lines.origins):
            raise _no_rim()
        # Both distances are positive between them, be it bright or dark there.
        shape = _shape(rim, (centre, radius), 1.0 if rim is outer else -1.0, named)
        begun = shape.start if named.plane is None else fit_points(shape, points[near]).parameters
        shapes.append(replace(shape, start=begun))
    fits = fit_ring(light, (shapes[0], shapes[1]), both[0].width + both[1].width, named.aspect)
    number = 0 if calipers[0] is inner else 1
    return _circle(fits[number], named, "model", "dark" if both[number].rising else "bright", 0.0)


def _no_rim() -> InputError:
    return InputError(
        "shows no rim in the caliper's band", where="the image", remedy="move the caliper, or widen its band"
    )


def _nearness(caliper: Caliper, form: Form, plane: Plane | None) -> float:
    """How far rim points may lie from a circle [px]: those of an ellipse lie off it."""
    return 1.0 if form == "circle" and plane is None else caliper.band


def _scan_lines(caliper: Caliper, aspect: float) -> ScanLines:
    """One for each pixel of the rim."""
    start, extent = caliper.arc or (0.0, _TURN)
    count = max(2 * _FEWEST_POINTS, math.ceil(extent * caliper.radius))
    angles = start + extent * (np.arange(count) + 0.5) / count
    away = np.column_stack([np.cos(angles), np.sin(angles)])
    centre = np.array([caliper.centre[0], caliper.centre[1] * aspect])
    return ScanLines(centre + caliper.radius * away, away, caliper.band, aspect)


def _shape(caliper: Caliper, about: tuple[Array, float], sign: float, named: _Named) -> Shape:
    (centre, radius), plane, aspect = about, named.plane, named.aspect
    if named.form == "ellipse":
        return ellipse_shape(np.array([*centre, radius * 1.01, radius / 1.01, 0.3]), sign, caliper.arc)
    if plane is None:
        return circle_shape(np.array([*centre, radius]), sign, caliper.arc)
    reach = radius + caliper.band + 8
    local = plane.near(centre - reach, centre + reach, aspect)
    middle, slopes = local(centre[None])
    scale = math.sqrt(abs(float(np.linalg.det(slopes[0]))))
    start = np.array([*middle[0], radius * scale])
    return plane_shape(start, sign, caliper.arc, local, scale=scale, centre=centre, radius=radius)


@dataclass(frozen=True, slots=True)
class _Named:
    """What the parameters of a fit mean."""

    form: Form
    plane: Plane | None
    aspect: float

    @property
    def to_centre(self) -> Array:
        """Derivatives of the image's (u, v) by the first two parameters, where there is no plane."""
        return np.diag([1.0, 1 / self.aspect])

    def centre(self, parameters: Array) -> tuple[Array, Array]:
        """Centre [px], and its derivatives by all parameters."""
        slopes = np.zeros((2, len(parameters)))
        if self.plane is None:
            slopes[:, :2] = self.to_centre
            return parameters[:2] / np.array([1.0, self.aspect]), slopes
        step = 1e-3 * parameters[2]
        ends = parameters[:2] + step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        there = self.plane.to_image(ends)
        slopes[:, 0], slopes[:, 1] = (there[1] - there[2]) / (2 * step), (there[3] - there[4]) / (2 * step)
        return there[0], slopes

    def diameters(self, parameters: Array) -> tuple[Array, Array]:
        """Diameter, or axes, the larger first, and their derivatives."""
        which = [2] if self.form == "circle" else sorted([2, 3], key=lambda k: -parameters[k])
        slopes = np.zeros((len(which), len(parameters)))
        slopes[np.arange(len(which)), which] = 2.0
        return slopes @ parameters, slopes

    def orientation(self, parameters: Array) -> float:
        turn = parameters[4] + (0.0 if parameters[2] >= parameters[3] else math.pi / 2)
        return float((turn + math.pi / 2) % math.pi - math.pi / 2)


def _circle(fit: Contour | PointFit, named: _Named, way: Way, inside: Side, missed: float) -> Circle:
    centre, by_centre = named.centre(fit.parameters)
    sizes, by_sizes = named.diameters(fit.parameters)
    modelled = fit if isinstance(fit, Contour) else None
    ellipse, plane = named.form == "ellipse", named.plane

    def sigmas(slopes: Array) -> tuple[float, ...]:
        return tuple(np.sqrt(np.maximum(np.diag(slopes @ fit.covariance @ slopes.T), 0.0)).tolist())

    def rendering(slopes: Array) -> tuple[float, ...]:
        by: Callable[[Array], float] = (lambda _: math.nan) if modelled is None else modelled.by_rendering
        return tuple(map(by, slopes))

    return Circle(
        centre=tuple(centre.tolist()),
        centre_sigma=sigmas(by_centre),
        centre_by_rendering=rendering(by_centre),
        diameters=tuple(np.abs(sizes).tolist()),
        diameters_sigma=sigmas(by_sizes),
        diameters_by_rendering=rendering(by_sizes),
        unit="px" if plane is None else "m",
        orientation=named.orientation(fit.parameters) if ellipse else None,
        orientation_sigma=math.sqrt(fit.covariance[4, 4]) if ellipse else None,
        centre_in_plane=None if plane is None else tuple(fit.parameters[:2].tolist()),
        centre_in_plane_sigma=None if plane is None else sigmas(np.eye(3)[:2]),
        inside=inside,
        blur=math.nan if modelled is None else modelled.blur,
        blur_sigma=math.nan if modelled is None else modelled.blur_sigma,
        misfit=math.nan if modelled is None else modelled.misfit,
        left_out=float(missed) if modelled is None else modelled.left_out,
        points=int(fit.pixels if isinstance(fit, Contour) else fit.points),
        way=way,
        warnings=() if modelled is None else modelled.warnings,
    )
