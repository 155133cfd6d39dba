"""Covered share of each pixel near a part: w = (background - light)/(background - part), 1 inside, 0 outside.

Both levels are local: the background is a surface of degree 4 fitted to a ring around the part, the part a quadratic
one fitted to its core, so that light may vary slowly.

Light of slope g = grad ln(background - part) moves a rim that is blurred: with s^2 the blur's variance across it, by
s^2 g towards less light. It is moved back, w - s^2 g . grad w; pixel and blur are both in s^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.background import QUANTISATION
from radwrap.measure.parts.level import HIGHEST, Level, fitted_level, monomials
from radwrap.measure.parts.light import LinearLight
from radwrap.measure.parts.raster import distance, indices, pieces, rim_length, smoothed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FAINTEST: Final = 6.0  # times the noise; 10^6 pixels of noise reach 5
BLUR_MEASURE: Final = 0.2882  # int E (1 - E) dS of Eq. 9 over -1 to 1
PIXEL_MEASURE: Final = 1 / 6  # the same of a pixel's own width
SHELL: Final = 3.0  # px, of the ring, next to the part
# Of the contrast, as a step in the light itself; where light falls off to nothing, the background's surface runs on
# into the dark corner and would make a part of it.
LEAST_STEP: Final = 0.2
RING: Final = 7.0  # px, width of the background around a part that is looked at


@dataclass(frozen=True, slots=True, eq=False)
class PartScene:
    """The image with parts turned dark, and labels of what stands out.

    Attributes
    ----------
    light, surface : ndarray, shape (rows, columns)
        Light, and a rough surface of the background.
    seeds : ndarray of int, shape (rows, columns)
        Number of each part; 0 elsewhere.
    level : float, optional
        Light at which the contour lies; half-way where there is none.
    response : LinearLight
        How gray levels became light.
    rounded : bool
        Whether gray levels are whole numbers.
    aspect : float
        Height of a pixel over its width.
    """

    light: Array
    surface: Array
    seeds: NDArray[np.int32]
    level: float | None
    response: LinearLight
    rounded: bool
    aspect: float


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """Covered share of each pixel near a part, and what is uncertain about it.

    Attributes
    ----------
    u, v, share : ndarray, shape (rows, columns)
        Place [px] and covered share.
    band, inside : ndarray of bool, shape (rows, columns)
        Where gray levels count; the part.
    contrast : ndarray, shape (rows, columns)
        Background minus part [light].
    around, core : Level
        Background and part.
    pixel_variance : ndarray, shape (rows, columns)
        Of the pixel's own light, from noise and rounding [light^2].
    blur : float
        Radius of the disc that would blur the rim as much [pixel widths].
    """

    u: Array
    v: Array
    share: Array
    band: Mask
    inside: Mask
    contrast: Array
    around: Level
    core: Level
    pixel_variance: Array
    blur: float

    @property
    def depth(self) -> float:
        """Mean contrast of the part [light]."""
        return float(self.contrast[self.inside].mean())

    @property
    def noise(self) -> float:
        """Standard deviation of a pixel, of both levels [light]."""
        return math.sqrt((self.around.spread**2 + self.core.spread**2) / 2)


def spread_by_blur(blur: float, aspect: float) -> tuple[float, float]:
    """Variance that blur and pixel add along columns and along rows [px^2]."""
    return blur**2 / 4 + 1 / 12, (blur / aspect) ** 2 / 4 + 1 / 12


Box = tuple[slice, slice]  # rows and columns


def covered(scene: PartScene, number: int, box: Box) -> Cover | None:
    """Cover of one part, or None where a speck has no two levels; the box is the smallest that holds its seeds."""
    if (scene.seeds[box] == number).sum() < 4:
        return None
    half = 2.5
    cover = _cover(scene, number, box, half)
    for _ in range(3):  # the band follows the blur
        if cover is None or (reach := cover.blur / min(scene.aspect, 1.0) + 1.5) <= half:
            break
        half = reach
        cover = _cover(scene, number, box, half)
    return cover


def _cover(scene: PartScene, number: int, box: Box, half: float) -> Cover | None:
    rows, columns = box
    margin = math.ceil(2 * half) + 8
    top, left = max(rows.start - margin, 0), max(columns.start - margin, 0)
    window = np.s_[top : rows.stop + margin, left : columns.stop + margin]
    light = scene.light[window]
    found = _levels(scene, window, number, half)
    if found is None:
        return None
    own, apart, around, core = found
    contrast = np.maximum(around.surface - core.surface, _shallowest(around, core, own))
    signed = np.where(own, distance(~own), distance(own)) - 0.5
    band = (signed < half) & apart
    share = np.where(band, (around.surface - light) / contrast, own.astype(np.float64))
    variance = np.where(band, _pixel_variance(scene, light, share, around, core), 0.0)
    blur = _blur(share, band, own, float((variance / contrast**2)[band].sum()), scene.aspect)
    share = np.where(band, _moved_back(share, contrast, blur, scene.aspect), share)
    v, u = indices(light.shape)
    return Cover(u + left, v + top, share, band, own, contrast, around, core, variance, blur)


def _levels(
    scene: PartScene, window: tuple[slice, slice], number: int, half: float
) -> tuple[Mask, Mask, Level, Level] | None:
    """The part's pixels, those nearer to it than to others, background and core."""
    light, labels, coarse = scene.light[window], scene.seeds[window], scene.surface[window]
    own = labels == number
    others = (labels > 0) & ~own
    far, deep = distance(own), distance(~own)
    apart = far <= distance(others)
    clear = distance(others & ~apart) > half + 0.5
    inner = own & (deep >= min(half, float(deep.max()) - 0.5))
    depth, base = coarse - light, np.zeros_like(light)
    terms = monomials(light.shape)
    # Levels hang on the mask, the mask on the levels: twice is enough.
    for turn in range(2):
        if turn:
            far, deep = distance(own), distance(~own)
        ring = (far > half + 0.5) & (far <= half + 0.5 + RING) & clear
        ring &= labels == 0 if scene.level is not None else np.abs(depth) < 0.5 * float(np.median(depth[inner]))
        inner = own & (deep >= min(half + 0.5, float(deep.max()) - 0.5))
        if not inner.any():
            return None
        around = fitted_level(light, coarse, ring, scene.response, terms, highest=HIGHEST, rounded=scene.rounded)
        core = fitted_level(light, base, inner, scene.response, terms, highest=2, rounded=scene.rounded)
        contrast = around.surface - core.surface
        middle = float(contrast[inner].mean())
        if middle <= FAINTEST / 2 * max(around.spread, core.spread) or (contrast <= 0)[inner].any():
            return None
        shell = ring & (far <= half + 0.5 + SHELL)
        if shell.any() and float(light[shell].mean() - light[inner].mean()) < LEAST_STEP * middle:
            return None
        contrast = np.maximum(contrast, _shallowest(around, core, inner))
        share = (around.surface - light) / contrast
        cut = 0.5 if scene.level is None else np.clip((around.surface - scene.level) / contrast, 0.05, 0.95)
        parts = pieces((smoothed(share, 0.6) >= cut) & apart)
        touched = np.bincount(parts[own & (parts > 0)])
        if touched.size == 0:
            return None
        own = parts == int(np.argmax(touched))
    return own, apart, around, core


def _shallowest(around: Level, core: Level, where: Mask) -> float:
    """Least contrast that is divided by: surfaces run wild far from what they were fitted to."""
    return 0.05 * float((around.surface - core.surface)[where].mean())


def _pixel_variance(scene: PartScene, light: Array, share: Array, around: Level, core: Level) -> Array:
    """Of a pixel's own light; rounding on the rim, where neighbours round differently, is noise."""
    covered = np.clip(share, 0, 1)
    variance: Array = (1 - covered) * around.noise**2 + covered * core.noise**2
    if scene.rounded:
        on_level = lies_on(around, light, scene) | lies_on(core, light, scene)
        variance = variance + np.where(on_level, 0.0, QUANTISATION * scene.response.slope(light) ** 2)
    return variance


def lies_on(level: Level, light: Array, scene: PartScene) -> Mask:
    """Whether a pixel lies on a level within noise and rounding."""
    within: Mask = np.abs(light - level.surface) <= 0.5 * scene.response.slope(level.surface) + 3 * level.noise
    return within


def _blur(share: Array, band: Mask, inside: Mask, noise: float, aspect: float) -> float:
    """Radius of the disc whose edge is as wide: sum of w (1 - w) over the rim's length, pixel taken out."""
    length = max(rim_length(share, inside, aspect), 1.0)
    width = aspect * (float((share * (1 - share))[band].sum()) + noise) / length
    pixel = PIXEL_MEASURE**2 * (1 + aspect**2) / 2
    return math.sqrt(max(width**2 - pixel, 0.0)) / BLUR_MEASURE


def _moved_back(share: Array, contrast: Array, blur: float, aspect: float) -> Array:
    """The share without what light that varies under the blur did to it."""
    along_u, along_v = spread_by_blur(blur, aspect)
    contrast_v, contrast_u = np.gradient(contrast)
    share_v, share_u = np.gradient(share)
    moved: Array = share - (along_u * contrast_u * share_u + along_v * contrast_v * share_v) / contrast
    return moved
