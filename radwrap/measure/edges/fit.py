"""Place, blur, levels and gamma of a straight edge by least squares, with their covariance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.edges.blur import Fitted, any_blur, beyond_disc, covariance_of, fitted
from radwrap.measure.edges.misfit import misfit_of
from radwrap.measure.edges.model import Model, Pixels, splines_along
from radwrap.measure.edges.search import Line, find_line, normal_angle
from radwrap.progress import Progress

Array = NDArray[np.float64]
Region = tuple[int, int, int, int]

SMALLEST_SIDE: Final = 12  # px; less holds no edge with both of its levels
LEVEL_PIXELS: Final = 3  # beyond the blur, on each side, in every row: level, slope and curvature hang on them
LARGEST_SATURATED: Final = 0.05  # share of the strip; beyond it the bright level is not known
_BYTES: Final = 200  # a pixel of the strip; 176 were measured on one of 10^6
MOST_BYTES: Final = 1 << 30  # of all the strip
_USUAL_TRIALS: Final = 20  # of parameters in two rounds of the fit, for the time that is left
_TRIAL_WORK: Final = 10  # times as much as to look for the line, for each pixel
_BAND: Final = 64  # rows
LARGEST_RESIDUAL: Final = 0.15  # of the contrast; a straight edge between smooth sides leaves less
LARGEST_GAMMA_ERROR: Final = 0.3  # a gamma known worse than that tells nothing, and spoils the position
NARROWEST: Final = 1e-3  # px; blur below this is the sharp step
UNLIT: Final = 0.0002  # of the contrast; a dark side this near to dark counts as unlit: H^gamma has no slope at 0
GAMMA_RANGE: Final = (0.1, 5.0)


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A straight edge u cos(angle) + v sin(angle) = offset; u is the column, v the row, as in truth.json.

    Attributes
    ----------
    angle, offset : float
        Of the edge's normal, in -pi/2 to pi/2 [rad]; distance from the first pixel's centre [px].
    sigma_angle, sigma_offset : float
        Standard errors [rad], [px]; the offset's holds the lever arm of the angle.
    centre : tuple of float
        Where the edge is, (u, v) [px]: the middle of its visible part.
    sigma_position : float
        Standard error across the edge at the centre [px].
    radius, sigma_radius : float
        Radius of the disc of blur that fits best, in pixel widths [px].
    gamma, sigma_gamma : float
        Exponent of the sensor's response; error 0 where it was given.
    low, high, sigma_low, sigma_high : float
        Gray level of the dark and the bright side at the centre (I_min, I_max).
    bright_side : str
        "positive" where u cos + v sin > offset is bright, else "negative".
    covariance : ndarray, shape (4, 4)
        Of offset [px], angle [rad], radius [px], gamma.
    residual_rms : float
        What the fit leaves, with whatever symmetric blur [gray].
    pixels, saturated : int
        Pixels that were fitted, and pixels left out as saturated.
    half_width, length : float
        Of the strip that was fitted, across (one side) and along the edge [px].
    level_share : float
        Share of the bright side's pixels that have exactly its highest gray level: near 1 in even light without
        noise, or where the camera saturates below full scale. Then gamma takes the clipping up, and place and blur
        are off by more than their standard errors.
    misfit, even_misfit : float
        Means at each distance from the edge of what the fit leaves, rms beyond noise over the contrast: of all of it,
        and of what has the same sign on both sides, as of a fringe, a shadow or a blur that is not symmetric. 0 by
        chance.
    beyond_disc : float
        By how much a blur that is no disc fits better [standard deviations of what noise makes of that]. Another gamma
        at another place fits nearly as well then: where gamma is fitted neither is known.
    """

    angle: float
    offset: float
    sigma_angle: float
    sigma_offset: float
    centre: tuple[float, float]
    sigma_position: float
    radius: float
    sigma_radius: float
    gamma: float
    sigma_gamma: float
    low: float
    high: float
    sigma_low: float
    sigma_high: float
    bright_side: Literal["positive", "negative"]
    covariance: Array
    residual_rms: float
    pixels: int
    saturated: int
    half_width: float
    length: float
    level_share: float
    misfit: float
    even_misfit: float
    beyond_disc: float

    @property
    def position_gamma_correlation(self) -> float:
        """Of the place across the edge, at the centre, and gamma; 0 where gamma was given."""
        if self.sigma_gamma == 0 or self.sigma_position == 0:
            return 0.0
        u, v = self.centre
        lever = u * math.sin(self.angle) - v * math.cos(self.angle)
        together = self.covariance[0, 3] + lever * self.covariance[1, 3]
        return float(together / (self.sigma_position * self.sigma_gamma))


def measure_edge(
    image: GrayImage,
    *,
    dark: float | None = None,
    gamma: float | None = None,
    region: Region | None = None,
    pixel_aspect: float = 1.0,
    saturation: float | None = None,
    progress: Progress | None = None,
) -> Edge:
    """Position, angle, blur, levels and gamma of the one straight edge of an image, by least squares.

    The radius is that of the disc that fits best. Place, levels and gamma then follow any symmetric blur, as a sum of
    four discs, so that tails of the blur do not move the edge.

    Parameters
    ----------
    image : GrayImage
        Gray levels.
    dark : float, optional
        Gray level without light, G0 of Eq. 5. Without it the dark side counts as unlit, as in Eq. 9, which
        is right for gamma 1 and for a black dark side.
    gamma : float, optional
        Exponent of the sensor's response; without it, it is fitted too.
    region : tuple of int, optional
        (u0, v0, u1, v1): first and last column and row to look at, all included.
    pixel_aspect : float
        Height of a pixel over its width. The disc of blur is round on the sensor: of pixels that are not
        square it needs to know. Lengths across the edge that are called radius are in pixel widths.
    saturation : float, optional
        Gray level from which pixels are left out; default the largest of the image's bit depth.
    progress : Progress, optional
        Counts pixels that are looked at.

    Returns
    -------
    Edge
        With standard errors from the Jacobian and the residual, raised where the residual is not independent
        from pixel to pixel: rounding, for one, is the same in every row of an edge along the columns.

    Raises
    ------
    InputError
        If the image is too small, blank, saturated, without an edge, with more than one, or if the edge
        tells nothing about gamma.

    Examples
    --------
    >>> import numpy as np, radwrap
    >>> v, u = np.indices((40, 60))
    >>> picture = radwrap.GrayImage(np.rint(30 + 150 / (1 + np.exp((31.4 - u - 0.1 * v) / 0.4))))
    >>> edge = radwrap.measure_edge(picture, gamma=1.0)
    >>> bool(abs(edge.offset - 31.4 / np.hypot(1, 0.1)) < 0.05)
    True
    """
    _check_options(dark, gamma, pixel_aspect, saturation)
    values, corner = _cut(image, region)
    limit = float(2**image.bit_depth - 1) if saturation is None else saturation
    usable = values < limit
    low, high = float(values.min()), float(values.max())
    if not usable.any():
        raise InputError("is saturated all over", where="the image", remedy="shorten the exposure")
    if low == high:
        raise InputError(f"is blank: gray {low:g} all over", where="the image", remedy="aim at an edge")
    from threadpoolctl import ThreadpoolController

    progress = progress or Progress("", 1, shown=False)
    progress.expect(2 * values.size)
    found = find_line(values, progress)
    libraries = ThreadpoolController()  # to look for them takes as long as a fit
    for tolerance in (1e-4, 1e-10, 1e-10, 1e-10):  # the strip follows the blur; it stands after two or three rounds
        _check_size(found, values.size)
        strip = _strip(values, usable, found)
        last = found
        work = _TRIAL_WORK * strip.u.size
        look = partial(progress.add, work)
        progress.left(_USUAL_TRIALS * work)
        with libraries.limit(limits=1):  # small matrices: threads would wait for one another most of the time
            disc = _fit(strip, found, dark, gamma, aspect=pixel_aspect, tolerance=tolerance, look=look)
        found = _refined(found, disc.parameters)
        if abs(found.half_width - last.half_width) < 1.0 and abs(found.shift_from(last)) < 0.05:
            break
    progress.left(_USUAL_TRIALS * work)
    with libraries.limit(limits=1):
        return _moved(_edge(disc, any_blur(disc, look)), corner)


def _check_options(dark: float | None, gamma: float | None, pixel_aspect: float, saturation: float | None) -> None:
    if saturation is not None and not (math.isfinite(saturation) and saturation > 0):
        raise InputError("must be a gray level above 0", where="saturation")
    if gamma is not None and not GAMMA_RANGE[0] <= gamma <= GAMMA_RANGE[1]:
        raise InputError(f"must lie between {GAMMA_RANGE[0]:g} and {GAMMA_RANGE[1]:g}", where="gamma")
    if dark is not None and not math.isfinite(dark):
        raise InputError("is not a finite number", where="dark")
    if not 0.01 <= pixel_aspect <= 100:
        raise InputError("must lie between 0.01 and 100", where="pixel_aspect", remedy="give height over width")


def _cut(image: GrayImage, region: Region | None) -> tuple[Array, tuple[int, int]]:
    rows, columns = image.values.shape
    u0, v0, u1, v1 = region or (0, 0, columns - 1, rows - 1)
    if not (0 <= u0 <= u1 < columns and 0 <= v0 <= v1 < rows):
        raise InputError(
            f"{u0} {v0} {u1} {v1} does not lie in an image of {columns} x {rows} pixels",
            where="region",
            remedy="give first column, first row, last column, last row, counted from 0",
        )
    if min(u1 - u0, v1 - v0) + 1 < SMALLEST_SIDE:
        raise InputError(
            f"holds {u1 - u0 + 1} x {v1 - v0 + 1} pixels, an edge needs {SMALLEST_SIDE} x {SMALLEST_SIDE}",
            where="the image" if region is None else "region",
        )
    return image.values[v0 : v1 + 1, u0 : u1 + 1], (u0, v0)


def _strip(values: Array, usable: NDArray[np.bool_], line: Line) -> Pixels:
    """Pixels near the edge that see it; ends inside the image are kept clear of what ends there."""
    shape = values.shape
    first, last = line.ends
    clear = line.radius + 3.0
    reach_u = [line.centre[0] - end * math.sin(line.angle) for end in (first, last)]
    reach_v = [line.centre[1] + end * math.cos(line.angle) for end in (first, last)]
    margins = [
        min(u, v, shape[1] - 1 - u, shape[0] - 1 - v) > line.half_width for u, v in zip(reach_u, reach_v, strict=True)
    ]
    first = first + clear if margins[0] else -math.inf
    last = last - clear if margins[1] else math.inf
    bands = []
    for top in range(0, shape[0], _BAND):  # places of all pixels of a large picture take gigabytes
        part = Pixels.of(values[top : top + _BAND], usable[top : top + _BAND], top)
        s = line.along(part.u, part.v)
        bands.append(part.only((np.abs(line.across(part.u, part.v)) <= line.half_width) & (s >= first) & (s <= last)))
    strip = Pixels.joined(bands)
    d, s = line.across(strip.u, strip.v), line.along(strip.u, strip.v)
    length = float(np.ptp(s[strip.usable])) if strip.usable.any() else 0.0
    sides = min((d > line.radius).sum(), (d < -line.radius).sum())
    if length < SMALLEST_SIDE / 2 or sides < LEVEL_PIXELS * length:
        raise InputError(
            "does not show a complete edge: too few pixels on one of its sides",
            where="the image",
            remedy="bring the edge and both of its sides into the image or region",
        )
    return strip


def _fit(
    strip: Pixels,
    line: Line,
    dark: float | None,
    gamma: float | None,
    *,
    aspect: float,
    tolerance: float,
    look: Callable[[], None],
) -> Fitted:
    d, s = line.across(strip.u, strip.v), line.along(strip.u, strip.v)
    saturated = float((~strip.usable).mean())
    if saturated > LARGEST_SATURATED:
        raise InputError(
            f"is saturated: {saturated:.0%} of the pixels along the edge",
            where="the image",
            remedy="shorten the exposure",
        )
    low = float(np.median(strip.gray[d < -line.radius]))
    high = float(np.median(strip.gray[d > line.radius]))
    if high - low <= 0:
        raise InputError("shows no edge above its noise", where="the image", remedy="raise contrast or exposure")
    if dark is not None and dark > low + LARGEST_RESIDUAL * (high - low):
        raise InputError(f"{dark:g} lies above the edge's dark side, gray {low:g}", where="dark")
    if dark is not None and low - dark < UNLIT * (high - low):
        dark = None
    contrast = high - (low if dark is None else dark)
    width, length = line.half_width, max(float(np.ptp(s)), 1.0)
    base = np.column_stack([np.ones_like(d), d / width, s / length, (s / length) ** 2])
    model = Model(strip, line, aspect, dark, contrast, splines_along(s, float(s.min()), float(s.max())), base)
    splines = model.along.count
    start = np.concatenate(
        [[0.0, 0.0, line.radius, gamma or 1.0], [low, 0, 0, 0], np.ones(splines), np.zeros(2 * splines)]
    )
    if dark is not None:
        start[4] = max(low - dark, 0.0) / contrast
        start[8 : 8 + splines] -= start[4]
    free = np.ones(start.size, dtype=bool)
    free[3] = gamma is None
    bounds = np.full((2, start.size), [[-np.inf], [np.inf]])
    bounds[:, 0] = -width / 2, width / 2
    bounds[:, 1] = -0.3, 0.3
    bounds[:, 2] = NARROWEST, max(strip.u.size**0.5, 4 * line.radius)
    bounds[:, 3] = GAMMA_RANGE

    return fitted(model, start, free, bounds, tolerance=tolerance, look=look)


def _check_size(line: Line, pixels: int) -> None:
    """Refuse an edge whose fit would not fit, before its pixels are laid out."""
    length = line.ends[1] - line.ends[0]
    need = min(2 * line.half_width * length, pixels) * _BYTES
    if need > MOST_BYTES:
        raise InputError(
            f"shows an edge of {length:.0f} px, blurred by {2 * line.radius:.0f} px, whose fit takes "
            f"{need / 2**30:.1f} GiB of memory, the limit is {MOST_BYTES / 2**30:g}",
            where="the image",
            remedy=f"name a region, some {length * MOST_BYTES / need / 2:.0f} px long",
        )


def _refined(line: Line, parameters: Array) -> Line:
    angle = line.angle + parameters[1]
    shift = parameters[0]
    centre = line.centre[0] + shift * math.cos(angle), line.centre[1] + shift * math.sin(angle)
    return Line(angle, centre, float(parameters[2]), line.ends)


def _edge(disc: Fitted, anyhow: Fitted) -> Edge:
    """Place, levels and gamma with whatever symmetric blur, the radius as of one disc; refuses what is no edge."""
    model, parameters = anyhow.model, anyhow.parameters
    residual = model.residual(parameters)
    covariance = covariance_of(disc, anyhow)
    (low, high), both = model.levels(parameters)
    rms = _rms(residual)
    disc_rms = _rms(disc.model.residual(disc.parameters))
    if disc_rms > LARGEST_RESIDUAL * abs(high - low) or high <= low:
        raise InputError(
            f"shows no straight edge: the model leaves {disc_rms:.3g} gray of a contrast of {high - low:.3g}",
            where="the image",
            remedy="name a region that holds one edge",
        )
    if anyhow.free[3] and covariance[3, 3] > LARGEST_GAMMA_ERROR**2:
        raise InputError(
            f"shows nothing about gamma ({parameters[3]:.2g} +- {math.sqrt(covariance[3, 3]):.2g})",
            where="the edge",
            remedy="give the camera's, or gamma 1",
        )
    steps = np.where(np.abs(parameters) > 1, np.abs(parameters), 1.0) * 1e-6
    slopes = np.stack([(both(parameters + h) - both(parameters - h)) / (2 * h.max()) for h in np.diag(steps)], axis=1)
    sigma_low, sigma_high = np.sqrt(np.diag(slopes @ covariance @ slopes.T))
    levels = tuple(map(float, (low, high, sigma_low, sigma_high)))
    misfits = (*_misfits(model, parameters, residual, high - low), beyond_disc(disc, anyhow))
    return _named(model, parameters, covariance[:4, :4], levels=levels, rms=rms, misfits=misfits)


def _misfits(model: Model, parameters: Array, residual: Array, contrast: float) -> tuple[float, float]:
    """Within the blur, its tails and a few pixels beside them."""
    line, used = _refined(model.line, parameters), model.strip.usable
    across = line.across(model.strip.u, model.strip.v)[used]
    rounded = bool((model.strip.gray == np.rint(model.strip.gray)).all())
    return misfit_of(across, residual, 2 * line.radius + LEVEL_PIXELS, contrast, rounded=rounded)


def _rms(residual: Array) -> float:
    return math.sqrt(float(residual @ residual) / residual.size)


def _named(
    model: Model,
    parameters: Array,
    covariance: Array,
    *,
    levels: tuple[float, ...],
    rms: float,
    misfits: tuple[float, float, float],
) -> Edge:
    """Angle and offset as truth.json has them: the normal points to the right, or downwards."""
    old, line = model.line, _refined(model.line, parameters)
    angle = normal_angle(line.angle)
    sign = 1.0 if math.cos(angle - line.angle) > 0 else -1.0
    offset = line.centre[0] * math.cos(angle) + line.centre[1] * math.sin(angle)
    # offset = sign (c . n(turn) + shift), c the centre about which the fit turned.
    lever = old.centre[1] * math.cos(line.angle) - old.centre[0] * math.sin(line.angle)
    to = np.array([[sign, sign * lever, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    named = to @ covariance @ to.T
    low, high, sigma_low, sigma_high = levels
    return Edge(
        angle=float(angle),
        offset=float(offset),
        sigma_angle=math.sqrt(named[1, 1]),
        sigma_offset=math.sqrt(named[0, 0]),
        centre=(float(line.centre[0]), float(line.centre[1])),
        sigma_position=math.sqrt(covariance[0, 0]),
        radius=float(parameters[2]),
        sigma_radius=math.sqrt(named[2, 2]),
        gamma=float(parameters[3]),
        sigma_gamma=math.sqrt(named[3, 3]),
        low=low,
        high=high,
        sigma_low=sigma_low,
        sigma_high=sigma_high,
        bright_side="positive" if sign > 0 else "negative",
        covariance=named,
        residual_rms=rms,
        pixels=int(model.strip.usable.sum()),
        saturated=int((~model.strip.usable).sum()),
        half_width=model.line.half_width,
        length=float(np.ptp(old.along(model.strip.u, model.strip.v))),
        level_share=_level_share(model, line),
        misfit=misfits[0],
        even_misfit=misfits[1],
        beyond_disc=misfits[2],
    )


def _level_share(model: Model, line: Line) -> float:
    """Share of the bright side's pixels that have its highest gray level."""
    beyond = model.strip.usable & (line.across(model.strip.u, model.strip.v) > line.radius)
    gray = model.strip.gray[beyond]
    return float((gray == gray.max()).mean()) if gray.size else 0.0


def _moved(edge: Edge, corner: tuple[int, int]) -> Edge:
    """From the region's pixels to the image's."""
    u, v = corner
    cos, sin = math.cos(edge.angle), math.sin(edge.angle)
    by_turn = v * cos - u * sin
    to = np.eye(4)
    to[0, 1] = by_turn
    covariance = to @ edge.covariance @ to.T
    return replace(
        edge,
        offset=edge.offset + u * cos + v * sin,
        centre=(edge.centre[0] + u, edge.centre[1] + v),
        covariance=covariance,
        sigma_offset=math.sqrt(covariance[0, 0]),
    )
