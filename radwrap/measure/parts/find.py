"""What stands out against an even background, and which of it is a part."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure import background as levels
from radwrap.measure.background import noise_level
from radwrap.measure.parts.cover import FAINTEST, PartScene, covered
from radwrap.measure.parts.light import LinearLight
from radwrap.measure.parts.moments import measured
from radwrap.measure.parts.raster import pieces
from radwrap.measure.parts.result import Ground, Part, Parts
from radwrap.progress import Progress

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMALLEST_SIDE: Final = 8  # px of an image
DEFAULT_MIN_AREA: Final = 20.0  # px^2; less has no core of its own gray level
LARGEST_SATURATED: Final = 0.5  # share of the image; then the background itself is clipped


def find_parts(
    image: GrayImage,
    *,
    threshold: float | None = None,
    min_area: float = DEFAULT_MIN_AREA,
    dark: float | None = None,
    gamma: float = 1.0,
    pixel_aspect: float = 1.0,
    progress: Progress | None = None,
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
    pixel_aspect : float
        Height of a pixel over its width. The blur is round on the sensor; taken for round in pixels it turns the
        axes of a part, by 0.1 degrees for a part of 35 x 16 px, blur of 1.8 px and aspect of 1.16.
    progress : Progress, optional
        Counts parts that are measured.

    Returns
    -------
    Parts
        Sorted by v, then u.

    Raises
    ------
    InputError
        If the image is too small, blank, saturated, or shows no part.

    Examples
    --------
    >>> import numpy as np, radwrap
    >>> v, u = np.indices((60, 80))
    >>> picture = radwrap.GrayImage(np.rint(20 + 150 / (1 + np.exp(2 * (np.hypot(u - 40, v - 30) - 12)))))
    >>> (part,) = radwrap.find_parts(picture).parts
    >>> round(part.u), round(part.v)
    (40, 30)
    """
    from threadpoolctl import threadpool_limits

    gray = image.values
    _check(image, threshold, min_area)
    _check_light(float(gray.max()), dark, gamma, pixel_aspect)
    zero = 0.0 if dark is None else dark
    upright = LinearLight(zero, max(float(gray.max()) - zero, 1.0), gamma)
    kind, background = levels.background_surface(
        upright.light(gray), None if dark is None else float(upright.light(np.array(dark)))
    )
    # From here on parts are dark.
    response = replace(upright, sign=1.0 if kind == "dark" else -1.0)
    light, surface = response.light(gray), response.sign * background
    rounded = bool((gray == np.rint(gray)).all())
    scene = PartScene(
        light,
        surface,
        _seeds(surface - light, response.sign, gray, threshold, rounded=rounded),
        None if threshold is None else float(response.light(np.array(threshold))),
        response,
        rounded=rounded,
        aspect=pixel_aspect,
    )
    with threadpool_limits(1):  # of many small matrices: threads would wait for one another most of the time
        kept = [part for part in _parts(scene, progress) if part.area >= min_area]
    if not kept:
        raise InputError(
            f"shows no part of {min_area:g} px^2 or more above its noise",
            where="the image",
            remedy="raise the contrast, or lower `min_area`",
        )
    return Parts(kind, tuple(sorted(kept, key=lambda part: (part.v, part.u))), _ground(surface - light, gray))


def _ground(depth: Array, gray: Array) -> Ground:
    """What lies on the background's surface, and what lies beyond it where parts are not."""
    tolerance = levels.ground_tolerance(depth)
    on = np.abs(depth) < tolerance
    border = np.concatenate([on[0], on[-1], on[1:-1, 0], on[1:-1, -1]])
    return Ground(
        gray=float(np.median(gray[on])) if on.any() else math.nan,
        share=float(on.mean()),
        border_share=float(border.mean()),
        other_share=float((depth <= -tolerance).mean()),
    )


def _parts(scene: PartScene, progress: Progress | None) -> Iterator[Part]:
    """One part after the other: what a part needs beyond its numbers is large, and is let go."""
    from scipy.ndimage import find_objects

    boxes = find_objects(scene.seeds)
    if progress is not None:
        progress.expect(len(boxes))
    for number, box in enumerate(boxes, 1):
        cover = covered(scene, number, box)
        part = None if cover is None else measured(cover, scene)
        if part is not None:
            yield part
        if progress is not None:
            progress.add(1)


def _check(image: GrayImage, threshold: float | None, min_area: float) -> None:
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


def _check_light(brightest: float, dark: float | None, gamma: float, pixel_aspect: float) -> None:
    if not 0.01 <= pixel_aspect <= 100:
        raise InputError("must lie between 0.01 and 100", where="pixel_aspect", remedy="give height over width")
    if not 0.1 <= gamma <= 5:
        raise InputError("must lie between 0.1 and 5", where="gamma")
    if dark is not None and dark >= brightest:
        raise InputError(f"{dark:g} lies above all of the image, at most {brightest:g}", where="dark")
    if gamma != 1 and (dark is None or not math.isfinite(dark)):
        raise InputError("is missing", where="dark", remedy="gamma needs the gray level without light")


def _seeds(depth: Array, sign: float, gray: Array, threshold: float | None, *, rounded: bool) -> NDArray[np.int32]:
    """Labels of what stands out; each is measured on its own afterwards."""
    if threshold is not None:
        mask = sign * (threshold - gray) > 0
    else:
        # Rounding has no noise where light is even, and is none the less wrong by as much.
        noise = max(noise_level(depth), math.sqrt(levels.QUANTISATION) if rounded else 0.0)
        split = levels.otsu_level(depth)
        # Half of Otsu's level: parts in dim light are shallower; each finds its own half-level later.
        level = max(split / 2, FAINTEST * noise)
        mask = depth > level
        both = mask.any() and not mask.all()
        # What is left beside the parts is noise and misfit of the surface.
        left = max(FAINTEST * noise, 3 * float(np.median(np.abs(depth[~mask])))) if both else math.inf
        if not both or float(np.median(depth[mask])) <= 1.5 * left:
            raise InputError("shows no part above its noise", where="the image", remedy="raise contrast or exposure")
    return pieces(mask)
