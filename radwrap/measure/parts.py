"""Where parts lie on an even background: count, place, orientation, area, each with its standard error.

A part covers the share w = (background - gray)/(background - part) of each pixel on its rim; inside w is 1,
outside 0. Sums of w, w x, w x x over the part are its area and moments. Both levels are local: the background is
a quadratic surface fitted to a ring around the part, the part another fitted to its core, so that light may
vary slowly. Only the rim's gray levels count, within a band as wide as the blur.

Standard errors. Every result is to first order a sum F = sum_i f(x_i) w_i over the band, with f

- 1 for the area, (x - x_c)/A for the place,
- p q/(A (m_pp - m_qq)) for the orientation, p and q along the principal axes, m the central second moments,

and three things move it: noise of each pixel, sigma_w = noise/contrast; errors of the two levels, from the
covariance of their fits; and the pixel grid, since a covered share does not say where in its pixel it lies. A sharp
edge at a random place displaces the first moment of one pixel by 0.0373 px^3 (standard deviation of p (1 - p)/2
for p even in 0 to 1), along the edge's normal; as many neighbours as the edge needs to pass on by a pixel
share it. Blur takes it away by exp(-pi^2 R^2), what the disc's spectrum has at the grid's frequency.

Not in them: light of slope g per pixel moves a rim that is blurred by R by g R^2/4, and light that is no quadratic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure import background as levels
from radwrap.measure.background import QUANTISATION, fitted_surface, noise_level, surface_terms

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMALLEST_SIDE: Final = 8  # px of an image
DEFAULT_MIN_AREA: Final = 20.0  # px^2; less has no core of its own gray level
FAINTEST: Final = 6.0  # times the noise; 10^6 pixels of noise reach 5
LARGEST_SATURATED: Final = 0.5  # share of the image; then the background itself is clipped
GRID_ERROR: Final = math.sqrt(1 / 120 - 1 / 144)  # px^3, see above
BLUR_MEASURE: Final = 0.2882  # int E (1 - E) dS of Eq. 9 over -1 to 1
ROUNDEST: Final = 0.01  # (m_pp - m_qq)/(m_pp + m_qq); below it an axis is the shape's tolerance, not its orientation
LOOSEST: Final = math.radians(7)  # of the orientation's error; then the axes are within 4 sigma of changing places
SMALLEST_RING: Final = 40  # px; fewer do not hold a quadratic surface
SMALLEST_CORE: Final = 12  # px; fewer do not hold a plane


@dataclass(frozen=True, slots=True)
class Part:
    """One part; u is the column, v the row, (0, 0) the centre of the first pixel; angles run from u towards v.

    Attributes
    ----------
    u, v, sigma_u, sigma_v : float
        Centroid of its area and standard errors [px].
    orientation, sigma_orientation : float
        Of the long principal axis, in -pi/2 to pi/2 [rad].
    orientation_ambiguous : bool
        Whether the second moments are too even, as of a disc, a square or a nut, to tell an axis.
    area, sigma_area : float
        Area [px^2], holes not counted.
    major_axis, minor_axis : float
        Axes of the ellipse of the same second moments; blur and pixel are taken out [px].
    rectangle : tuple of float
        Smallest rectangle about the half-level contour: centre u, v, length, width [px].
    rectangle_orientation : float
        Of its longer side, in -pi/2 to pi/2 [rad]; told also where the moments are even, then up to the part's
        own symmetry.
    contrast, noise : float
        Background minus part [gray or linear light], and noise of a pixel.
    blur_radius : float
        Of the disc that would blur its rim as much [px].
    touches_border : bool
        Whether it is cut by the image's border; then nothing is told of the whole part.
    """

    u: float
    v: float
    sigma_u: float
    sigma_v: float
    orientation: float
    sigma_orientation: float
    orientation_ambiguous: bool
    area: float
    sigma_area: float
    major_axis: float
    minor_axis: float
    rectangle: tuple[float, float, float, float]
    rectangle_orientation: float
    contrast: float
    noise: float
    blur_radius: float
    touches_border: bool


@dataclass(frozen=True, slots=True)
class Parts:
    """All parts of an image, from top to bottom.

    Attributes
    ----------
    kind : str
        "dark" parts on a bright background, or "bright" ones on a dark background.
    parts : tuple of Part
        At least one.
    """

    kind: Literal["dark", "bright"]
    parts: tuple[Part, ...]


def find_parts(
    image: GrayImage,
    *,
    threshold: float | None = None,
    min_area: float = DEFAULT_MIN_AREA,
    dark: float | None = None,
    gamma: float = 1.0,
) -> Parts:
    """Parts of one contrast on a background whose light varies slowly.

    Parameters
    ----------
    image : GrayImage
        Gray levels.
    threshold : float, optional
        Gray level that parts the two; default half-way between the local levels.
    min_area : float
        Smaller ones are taken for dirt [px^2].
    dark, gamma : float, optional
        G0 and exponent of Eq. 5. Gray levels are made linear in light with them; else a pixel that is half
        covered is off half-way, and a blurred part of gamma 0.85 loses or wins about 0.05 R along its rim.

    Returns
    -------
    Parts
        Sorted by v, then u.

    Raises
    ------
    InputError
        If the image is too small, blank, saturated, or shows no part.
    """
    gray = image.values
    _check(image, threshold, min_area, dark, gamma)
    whole_numbers = bool((gray == np.rint(gray)).all())
    if gamma == 1.0:
        light = gray
    else:
        assert dark is not None  # noqa: S101  (checked)
        # Odd about dark, so that noise there stays unbiased; scaled to the gray range.
        span = max(float(gray.max()) - dark, 1.0)
        light = span * np.sign(gray - dark) * (np.abs(gray - dark) / span) ** (1 / gamma)
    kind, background = levels.background_surface(light)
    sign = 1.0 if kind == "dark" else -1.0
    seeds = _seeds(sign * (background - light), sign, gray, threshold)
    # From here on parts are dark.
    flat, surface = sign * light, sign * background
    level = None if threshold is None else sign * (light.flat[int(np.argmin(np.abs(gray - threshold)))])
    floor = QUANTISATION if whole_numbers else 0.0
    scene = _Scene(flat, surface, seeds, level, floor)
    found = [_measure(scene, number) for number in range(1, int(seeds.max()) + 1)]
    kept = [part for part in found if part is not None and part.area >= min_area]
    if not kept:
        raise InputError(
            f"shows no part of {min_area:g} px^2 or more above its noise",
            where="the image",
            remedy="raise the contrast, or lower --min-area",
        )
    return Parts(kind, tuple(sorted(kept, key=lambda part: (part.v, part.u))))


def _check(image: GrayImage, threshold: float | None, min_area: float, dark: float | None, gamma: float) -> None:
    rows, columns = image.values.shape
    low, high = float(image.values.min()), float(image.values.max())
    if min(rows, columns) < SMALLEST_SIDE:
        needed = f"{SMALLEST_SIDE} x {SMALLEST_SIDE}"
        raise InputError(f"holds {columns} x {rows} pixels, parts need {needed}", where="the image")
    full = 2**image.bit_depth - 1
    if (share := float((image.values >= full).mean())) > LARGEST_SATURATED:
        raise InputError(f"is saturated: {share:.0%} of its pixels", where="the image", remedy="shorten the exposure")
    if low == high:
        raise InputError(f"is blank: gray {low:g} all over", where="the image", remedy="aim at a part")
    if threshold is not None and not low < threshold < high:
        raise InputError(
            f"{threshold:g} parts nothing", where="threshold", remedy=f"choose between {low:g} and {high:g}"
        )
    if not (math.isfinite(min_area) and min_area > 0):
        raise InputError("must be a number above 0", where="min_area")
    if not 0.1 <= gamma <= 5:
        raise InputError("must lie between 0.1 and 5", where="gamma")
    if gamma != 1 and (dark is None or not math.isfinite(dark)):
        raise InputError("is missing", where="dark", remedy="gamma needs the gray level without light")


def _seeds(depth: Array, sign: float, gray: Array, threshold: float | None) -> NDArray[np.int32]:
    """Labels of what stands out; each is measured on its own afterwards."""
    import cv2

    if threshold is not None:
        mask = sign * (threshold - gray) > 0
    else:
        noise = noise_level(depth)
        split = levels.otsu_level(depth)
        # Half of Otsu's level: parts in dim light are shallower; each finds its own half-level later.
        level = max(split / 2, FAINTEST * noise)
        mask = depth > level
        both = mask.any() and not mask.all()
        # What is left beside the parts is noise and misfit of the surface.
        left = max(FAINTEST * noise, 3 * float(np.median(np.abs(depth[~mask])))) if both else math.inf
        if not both or float(np.median(depth[mask])) <= 1.5 * left:
            raise InputError("shows no part above its noise", where="the image", remedy="raise contrast or exposure")
    labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)[1]
    return np.asarray(labels, dtype=np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class _Cover:
    """Covered share of each pixel near a part, and what is uncertain about it."""

    u: Array
    v: Array
    share: Array
    band: Mask  # where gray levels count
    inside: Mask
    contrast: float
    pixel_variance: Array  # of the share, from noise
    level_terms: Array  # (levels, rows, columns): change of the share with each level coefficient
    level_covariance: Array
    blur: float
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """The image with parts turned dark, its rough background, labels of what stands out."""

    light: Array
    surface: Array
    seeds: NDArray[np.int32]
    level: float | None  # light at which the contour lies; half-way where there is none
    rounding: float  # variance of a pixel's rounding


def _measure(scene: _Scene, number: int) -> Part | None:
    """One part, or None where a speck has no two levels."""
    if (scene.seeds == number).sum() < 4:
        return None
    half = 2.5
    cover = _cover(scene, number, half)
    for _ in range(3):  # the band follows the blur
        if cover is None or cover.blur + 1.5 <= half:
            break
        half = cover.blur + 1.5
        cover = _cover(scene, number, half)
    return None if cover is None else _part(cover, scene.light.shape)


def _cover(scene: _Scene, number: int, half: float) -> _Cover | None:
    import cv2

    seeds, level = scene.seeds, scene.level
    rows, columns = np.nonzero(seeds == number)
    margin = math.ceil(2 * half) + 8
    top, left = max(rows.min() - margin, 0), max(columns.min() - margin, 0)
    window = np.s_[top : rows.max() + margin + 1, left : columns.max() + margin + 1]
    gray, labels = scene.light[window], seeds[window]
    v, u = _indices(gray.shape)
    own = labels == number
    apart = _distance(own) <= _distance((labels > 0) & ~own)
    coarse = scene.surface[window]
    inner = own & (_distance(~own) >= min(half, float(_distance(~own).max()) - 0.5))
    depth = coarse - gray
    # Levels hang on the mask, the mask on the levels: twice is enough.
    for _ in range(2):
        far = _distance(own)
        ring = (far > half + 0.5) & (far <= half + 7.5) & (_distance((labels > 0) & ~own & ~apart) > half + 0.5)
        ring &= labels == 0 if level is not None else (np.abs(depth) < 0.5 * float(np.median(depth[inner])))
        deep = _distance(~own)
        inner = own & (deep >= min(half + 0.5, float(deep.max()) - 0.5))
        if not inner.any():
            return None
        around, spread, errors = _surface(gray, coarse, ring)
        core, core_spread, core_errors = _inside(gray, inner)
        contrast = around - core
        middle = float(contrast[inner].mean())
        if middle <= FAINTEST / 2 * max(spread, core_spread) or (contrast <= 0)[own].any():
            return None
        contrast = np.maximum(contrast, 0.05 * middle)
        share = (around - gray) / contrast
        cut = 0.5 if level is None else np.clip((around - level) / contrast, 0.05, 0.95)
        smooth = cv2.GaussianBlur(share, (3, 3), 0.6)
        mask = ((smooth >= cut) & apart).astype(np.uint8)
        pieces = np.asarray(cv2.connectedComponents(mask, connectivity=8)[1])
        touched = np.bincount(pieces[own & (pieces > 0)]) if (own & (pieces > 0)).any() else np.zeros(0)
        if touched.size == 0:
            return None
        own = pieces == int(np.argmax(touched))
    signed = np.where(own, _distance(~own), _distance(own)) - 0.5
    band = (signed < half) & apart
    share = np.where(band, share, own.astype(np.float64))
    noise_variances = max(spread**2, scene.rounding), max(core_spread**2, scene.rounding)
    variance = np.where(band, np.clip(1 - share, 0, 1) * noise_variances[0], 0.0)
    variance += np.where(band, np.clip(share, 0, 1) * noise_variances[1], 0.0)
    slopes = (np.where(band, part / contrast, 0.0) for part in (1 - share, share))
    terms = np.concatenate([surface_terms(gray.shape) * slope for slope in slopes])
    covariance = np.zeros((len(terms), len(terms)))
    covariance[: len(errors), : len(errors)] = errors
    covariance[len(errors) :, len(errors) :] = core_errors
    if scene.rounding:
        for first, measured in ((0, spread), (len(errors), core_spread)):
            for index in (0, 1, 3):  # 1, y, x of surface_terms()
                covariance[first + index, first + index] += levels.rounding_variance(measured**2)
    noise = math.sqrt(sum(noise_variances) / 2)
    blur = _blur(share, band, own, float((variance / contrast**2)[band].sum()))
    return _Cover(u + left, v + top, share, band, own, middle, variance / contrast**2, terms, covariance, blur, noise)


def _indices(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Row and column of each pixel."""
    v, u = np.indices(shape)
    return v.astype(np.float64), u.astype(np.float64)


def _distance(mask: Mask) -> Array:
    """Distance of each pixel from the nearest one of the mask [px]; large where there is none."""
    import cv2

    if not mask.any():
        return np.full(mask.shape, 1e9)
    if mask.all():
        return np.zeros(mask.shape)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), float)


def _surface(gray: Array, coarse: Array, ring: Mask) -> tuple[Array, float, Array]:
    """Background around a part; the image's own surface, moved to fit, where the ring is too small."""
    terms = surface_terms(gray.shape)
    if ring.sum() >= SMALLEST_RING:
        difference, spread, errors = fitted_surface(gray - coarse, terms, ring, len(terms))
        return coarse + difference, spread, errors
    offset = float(np.median((gray - coarse)[ring])) if ring.any() else 0.0
    spread = float(np.std((gray - coarse)[ring])) if ring.sum() > 3 else noise_level(gray)
    errors = np.zeros((len(terms), len(terms)))
    errors[0, 0] = spread**2 / max(int(ring.sum()), 1)
    return coarse + offset, spread, errors


def _inside(gray: Array, core: Mask) -> tuple[Array, float, Array]:
    """Level inside a part: a surface, a plane, or one number, as the core is large enough."""
    terms = surface_terms(gray.shape)
    order = [0, 1, 3, 2, 4, 5]  # 1, y, x first
    used = 6 if core.sum() >= 4 * SMALLEST_CORE else 3 if core.sum() >= SMALLEST_CORE else 1
    surface, spread, errors = fitted_surface(gray, terms[order], core, used)
    back = np.argsort(order)
    return surface, spread, errors[np.ix_(back, back)]


def _blur(share: Array, band: Mask, inside: Mask, noise: float) -> float:
    """Radius of the disc whose edge is as wide: sum of w (1 - w) over the rim's length, pixel (1/6) taken out."""
    crossings = int((inside[:, 1:] != inside[:, :-1]).sum() + (inside[1:] != inside[:-1]).sum())
    # Cauchy-Crofton: of all directions the two of the grid stand for the mean.
    length = max(crossings * math.pi / 4, 1.0)
    width = (float((share * (1 - share))[band].sum()) + noise) / length
    return math.sqrt(max(width**2 - 1 / 36, 0.0)) / BLUR_MEASURE


def _part(cover: _Cover, shape: tuple[int, ...]) -> Part | None:
    share = cover.share
    area = float(share.sum())
    if area <= math.pi * cover.blur**2:
        return None  # wider blurred than itself: light that falls off, or nothing with a level of its own
    u, v = float((share * cover.u).sum() / area), float((share * cover.v).sum() / area)
    x, y = cover.u - u, cover.v - v
    xx, yy, xy = (float((share * product).sum() / area) for product in (x * x, y * y, x * y))
    orientation = math.atan2(2 * xy, xx - yy) / 2
    middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    cos, sin = math.cos(orientation), math.sin(orientation)
    p, q = x * cos + y * sin, y * cos - x * sin
    difference = max(2 * apart, 1e-12 * middle)
    ones, zeros = np.ones_like(x), np.zeros_like(x)
    functionals = np.stack([ones, x / area, y / area, p * q / (area * difference)])
    gradients_u = np.stack([zeros, ones / area, zeros, (q * cos - p * sin) / (area * difference)])
    gradients_v = np.stack([zeros, zeros, ones / area, (q * sin + p * cos) / (area * difference)])
    variances = np.diag(_covariance(cover, functionals)) + _grid(cover, gradients_u, gradients_v)
    sigma_area, sigma_u, sigma_v, sigma_orientation = np.sqrt(variances)
    added = 1 / 12 + cover.blur**2 / 4  # second moments of pixel and disc
    axes = [4 * math.sqrt(max(middle + side * apart - added, 0.0)) for side in (1, -1)]
    box = _rectangle(share, cover, u, v)
    if box is None:
        return None
    rectangle, rectangle_orientation = box
    inside_u, inside_v = cover.u[cover.inside], cover.v[cover.inside]
    from_border = (inside_u.min(), inside_v.min(), shape[1] - 1 - inside_u.max(), shape[0] - 1 - inside_v.max())
    return Part(
        u=u,
        v=v,
        sigma_u=float(sigma_u),
        sigma_v=float(sigma_v),
        orientation=orientation,
        # Nothing is known worse than an even spread over half a turn.
        sigma_orientation=min(float(sigma_orientation), math.pi / math.sqrt(12)),
        orientation_ambiguous=bool(sigma_orientation > LOOSEST or apart < ROUNDEST * middle),
        area=area,
        sigma_area=float(sigma_area),
        major_axis=axes[0],
        minor_axis=axes[1],
        rectangle=rectangle,
        rectangle_orientation=rectangle_orientation,
        contrast=cover.contrast,
        noise=cover.noise,
        blur_radius=cover.blur,
        touches_border=bool(min(from_border) < 1),
    )


def _covariance(cover: _Cover, functionals: Array) -> Array:
    """Of sums of f w: noise of each pixel, and errors of the two levels."""
    f = functionals[:, cover.band]
    by_level = f @ cover.level_terms[:, cover.band].T
    total: Array = (f * cover.pixel_variance[cover.band]) @ f.T + by_level @ cover.level_covariance @ by_level.T
    return total


def _grid(cover: _Cover, gradients_u: Array, gradients_v: Array) -> Array:
    """Variance from not knowing where in its pixel a covered share lies."""
    slope_v, slope_u = (np.asarray(slope, dtype=np.float64) for slope in np.gradient(cover.share))
    length = np.hypot(slope_u, slope_v)
    rim = cover.band & (length > 0.1)
    normal_u, normal_v, length = slope_u[rim] / length[rim], slope_v[rim] / length[rim], length[rim]
    larger = np.maximum(np.abs(normal_u), np.abs(normal_v))
    smaller = np.minimum(np.abs(normal_u), np.abs(normal_v))
    side = math.sqrt(float(cover.share.sum()))
    alike = np.minimum(larger / np.maximum(smaller, 1e-6), side)
    across = gradients_u[:, rim] * normal_u + gradients_v[:, rim] * normal_v
    left = GRID_ERROR**2 * math.exp(-((math.pi * cover.blur) ** 2))
    variances: Array = left * (across**2 * length * alike).sum(axis=1)
    return variances


def _rectangle(
    share: Array, cover: _Cover, u: float, v: float
) -> tuple[tuple[float, float, float, float], float] | None:
    """Smallest rectangle about the half-level contour, and the direction of its longer side."""
    import cv2

    high = np.where(cover.band | cover.inside, share, 0.0) - 0.5
    points = []
    for axis in (0, 1):
        first, second = (high[:-1], high[1:]) if axis == 0 else (high[:, :-1], high[:, 1:])
        rows, columns = np.nonzero((first > 0) != (second > 0))
        part = first[rows, columns] / (first[rows, columns] - second[rows, columns])
        place = np.stack([columns + part * axis, rows + part * (1 - axis)], axis=1)
        points.append(place + np.array([cover.u[0, 0] - u, cover.v[0, 0] - v]))
    contour = np.concatenate(points)
    if len(contour) < 3:
        return None
    hull = cv2.convexHull(contour.astype(np.float32))
    (x, y), (width, height), angle = cv2.minAreaRect(hull)
    turn = math.radians(angle) + (math.pi / 2 if height > width else 0.0)
    turn = math.pi / 2 - (math.pi / 2 - turn) % math.pi
    return (u + x, v + y, max(width, height), min(width, height)), turn


def overlay_png(image: GrayImage, parts: Parts) -> bytes:
    """The image as PNG with each part's rectangle, axis and number drawn in colour; twice its size below 800 px."""
    import cv2

    gray = image.values
    low, high = float(gray.min()), float(gray.max())
    scale = 1 if max(gray.shape) >= 800 else 2
    eight = np.rint((gray - low) * (255 / max(high - low, 1e-12))).astype(np.uint8)
    canvas = cv2.cvtColor(np.kron(eight, np.ones((scale, scale), np.uint8)), cv2.COLOR_GRAY2BGR)

    def at(u: float, v: float) -> tuple[int, int]:
        return round((u + 0.5) * scale - 0.5), round((v + 0.5) * scale - 0.5)

    for number, part in enumerate(parts.parts, start=1):
        colour = (0, 0, 255) if part.touches_border else (0, 200, 0)
        cu, cv, length, width = part.rectangle
        cos, sin = math.cos(part.rectangle_orientation), math.sin(part.rectangle_orientation)
        halves = ((length, width), (length, -width), (-length, -width), (-length, width))
        corners = [at(cu + (a * cos - b * sin) / 2, cv + (a * sin + b * cos) / 2) for a, b in halves]
        cv2.polylines(canvas, [np.array(corners, np.int32)], isClosed=True, color=colour, thickness=1)
        if not part.orientation_ambiguous:
            reach = part.major_axis / 2
            end = at(part.u + reach * math.cos(part.orientation), part.v + reach * math.sin(part.orientation))
            cv2.line(canvas, at(part.u, part.v), end, (255, 120, 0), 1)
        cv2.drawMarker(canvas, at(part.u, part.v), (0, 120, 255), cv2.MARKER_CROSS, 9, 1)
        cv2.putText(canvas, str(number), at(part.u + 3, part.v - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 160, 255), 1)
    written, encoded = cv2.imencode(".png", canvas)
    if not written:
        raise InputError("cannot be drawn", where="the overlay")
    return bytes(encoded)
