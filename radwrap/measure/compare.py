"""How a captured image differs from the predicted one, and whether exposure, dark level or geometry explains it.

Everything is told on the predicted image's pixels: a registered captured image
is resampled onto them, and pixels that it does not cover are left out. Differences are
captured - predicted, in gray levels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.compare_statistics import (
    Array,
    Flags,
    LevelFit,
    Region,
    Statistics,
    by_region,
    level_fit,
    rms,
    rms_after_levels,
    statistics,
)
from radwrap.progress import Progress

Registration = Literal["none", "translation", "homography"]
REGISTRATIONS: Final[tuple[Registration, ...]] = ("none", "translation", "homography")

LEAST_CORRELATION: Final = 0.3  # below it the two images hardly show the same thing
LEAST_COVERED: Final = 0.1  # share of the predicted pixels that must be compared
COARSEST: Final = 48  # pixels along the shorter side of the first registration: a 10 % shift is then 5 px
ITERATIONS: Final = 200  # of ECC on each level; 10 to 50 are usual
ECC_STEP: Final = 1e-8  # change of the correlation at which ECC stops: about 0.001 px on a dot board
ECC_BLUR: Final = 5  # px, its default; noise of single pixels then does not lead the gradient
CAUSE_GAIN: Final = 0.8  # a cause is named if it alone leaves less than this share of the rms difference
BINS: Final = 256
# Larger images are registered on means over 2 x 2 pixels, or more; a test holds what that costs on a small image.
MOST_REGISTERED: Final = 1 << 24
_BAND: Final = 64  # rows
_RIM: Final = 12  # px that go on beyond an image, so that its splines end in them as in SciPy's own


@dataclass(frozen=True, slots=True)
class Causes:
    """Rms difference [gray] that stays if one thing alone is put right, over unsaturated pixels.

    Attributes
    ----------
    as_is : float
        Nothing put right.
    dark_level : float
        After an offset.
    exposure : float
        After a factor on the gray level above dark.
    exposure_factor : float or None
        That factor; the exposure's own is its power 1/gamma.
    dark_gray : float
        Above which: as it was given, or the prediction's smallest gray level.
    geometry : float or None
        After a shift; None where none was found.
    shift : tuple of float or None
        That shift (u, v) of the captured image [px].
    all_together : float
        After shift, factor and offset.
    mainly : str or None
        "dark level", "exposure" or "geometry", whichever alone leaves least; None if none does much.
    """

    as_is: float
    dark_level: float
    exposure: float
    exposure_factor: float | None
    dark_gray: float
    geometry: float | None
    shift: tuple[float, float] | None
    all_together: float
    mainly: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two images side by side, on the predicted image's pixels.

    Attributes
    ----------
    captured : ndarray, shape (rows, columns)
        Gray levels, registered; NaN where the photograph does not reach.
    predicted : ndarray, shape (rows, columns)
        Gray levels.
    overall : Statistics
        Over all compared pixels.
    regions : Mapping[str, Statistics]
        The same for each region.
    levels : LevelFit
        Gain and offset.
    causes : Causes
        What would explain the difference.
    warp : ndarray, shape (3, 3)
        captured_from_predicted in pixels: where each predicted pixel was looked up.
    worst : tuple of int
        (u, v) of the largest difference.
    """

    captured: Array
    predicted: Array
    overall: Statistics
    regions: Mapping[str, Statistics]
    levels: LevelFit
    causes: Causes
    warp: Array
    worst: tuple[int, int]

    @property
    def difference(self) -> Array:
        """Captured - predicted [gray]; NaN where nothing was compared."""
        return self.captured - self.predicted

    def histograms(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Edges [gray], and pixels between them in the captured and the predicted image."""
        valid = np.isfinite(self.captured)
        both = self.captured[valid], self.predicted[valid]
        high = max(float(part.max()) for part in both)
        # Whole gray levels in the middle of their bins, so that none falls on an edge.
        width = float(max(1, math.ceil((high + 1) / BINS)))
        edges = np.arange(BINS + 1) * width - 0.5 * min(width, 1.0)
        captured, predicted = (np.histogram(part, edges)[0].astype(np.int64) for part in both)
        return np.asarray(edges, np.float64), captured, predicted


def compare(
    captured: GrayImage,
    predicted: GrayImage,
    *,
    register: Registration = "none",
    regions: Sequence[Region] = (),
    tolerance: float | None = None,
    dark: float | None = None,
    saturation: float | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compare a captured image with the predicted one.

    Parameters
    ----------
    captured, predicted : GrayImage
        The photograph and the prediction.
    register : str
        "none"; "translation" or "homography": move the captured image onto the
        predicted one first (ECC, blind to gain and offset).
    regions : sequence of Region
        Parts of the predicted image to tell apart.
    tolerance : float, optional
        Absolute difference [gray] for `Statistics.beyond`.
    dark : float, optional
        Gray level without light; default the prediction's smallest. An exposure acts on what lies above it.
    saturation : float, optional
        Highest gray level; default full scale. Saturated pixels say nothing of gain and causes.
    progress : Progress, optional
        Counts pixels that are registered.

    Returns
    -------
    Comparison
        Images on common pixels, statistics, fits.

    Raises
    ------
    InputError
        If sizes differ without a homography, the images cannot be registered,
        or a region has no pixel to compare.

    Examples
    --------
    >>> import numpy as np, radwrap
    >>> predicted = radwrap.GrayImage(np.outer(np.arange(40.0), np.ones(50)) + 20)
    >>> captured = radwrap.GrayImage(predicted.values + 2)
    >>> radwrap.compare(captured, predicted).overall.mean
    2.0
    """
    if register != "homography" and captured.values.shape != predicted.values.shape:
        sizes = [f"{image.values.shape[1]} x {image.values.shape[0]}" for image in (captured, predicted)]
        raise InputError(
            f"the captured image has {sizes[0]} pixels, the predicted one {sizes[1]}",
            remedy='cut one, or use `register="homography"`',
        )
    progress = progress or Progress("", 1, shown=False)
    progress.expect((1 if register == "none" else 2) * _work(captured.values, predicted.values))
    warp = registration(captured.values, predicted.values, register, progress)
    moved = warped(captured.values, warp, predicted.values.shape)
    valid = np.isfinite(moved)
    if valid.mean() < LEAST_COVERED:
        raise InputError(
            f"the registered image covers {valid.mean():.0%} of the predicted one", remedy="compare images of one scene"
        )
    levels = predicted.values
    difference = moved - levels  # NaN where nothing is compared
    worst = np.unravel_index(int(np.nanargmax(np.abs(difference, out=difference))), difference.shape)
    del difference
    limits = [
        2**image.bit_depth - 1 if saturation is None else min(saturation, 2**image.bit_depth - 1)
        for image in (captured, predicted)
    ]
    usable = valid & (np.nan_to_num(moved) < limits[0]) & (levels < limits[1])
    return Comparison(
        captured=moved,
        predicted=levels,
        overall=statistics(moved, levels, valid, tolerance),
        regions=dict(by_region(moved, levels, valid, regions, tolerance)),
        levels=level_fit(moved[usable], levels[usable]),
        causes=_causes(moved, levels, usable, float(levels.min()) if dark is None else dark, progress),
        warp=warp,
        worst=(int(worst[1]), int(worst[0])),
    )


def _causes(captured: Array, predicted: Array, usable: Flags, dark: float, progress: Progress) -> Causes:
    """Put one thing right at a time, then all."""
    if not usable.any():
        usable = np.isfinite(captured)
    x, y = predicted[usable], captured[usable]
    as_is = rms(y - x)
    dark_level = float(np.std(y - x))
    above = x - dark
    power = float(above @ above)
    factor = float(above @ (y - dark)) / power if power > 0 else None
    exposure = as_is if factor is None else rms(y - dark - factor * above)
    shift, geometry, together = None, None, rms_after_levels(y, x)
    del x, y, above
    try:
        # Where nothing was compared the prediction itself stands in: it pulls towards no shift.
        filled = np.where(np.isfinite(captured), captured, predicted)
        warp = registration(filled, predicted, "translation", progress)
    except InputError:
        pass
    else:
        shift = float(warp[0, 2]), float(warp[1, 2])
        # The prediction is moved: to move what was captured would smooth its noise, as if that came from the place.
        moved = warped(predicted, np.asarray(np.linalg.inv(warp), dtype=np.float64), predicted.shape)
        both = usable & np.isfinite(moved)
        if both.mean() >= LEAST_COVERED * usable.mean():
            y, x = captured[both], moved[both]
            geometry, together = rms(y - x), rms_after_levels(y, x)
    found = {"dark level": dark_level, "exposure": exposure, "geometry": math.inf if geometry is None else geometry}
    best = min(found, key=lambda name: found[name])
    return Causes(
        as_is=as_is,
        dark_level=dark_level,
        exposure=exposure,
        exposure_factor=factor,
        dark_gray=dark,
        geometry=geometry,
        shift=shift,
        all_together=together,
        mainly=best if found[best] < CAUSE_GAIN * as_is else None,
    )


def _work(captured: Array, predicted: Array) -> int:
    """Pixels that a registration goes through."""
    factors, each = _scales(captured, predicted), 2 * predicted.size
    return round(sum(each / factor**2 for factor in factors))


def _scales(captured: Array, predicted: Array) -> list[float]:
    """Factors by which images are made smaller, one after the other; the last is 1 unless they are large."""
    halvings = max(0, int(math.log2(max(1.0, min(*captured.shape, *predicted.shape) / COARSEST))))
    largest = max(captured.size, predicted.size)
    least = max(0, math.ceil(math.log2(largest / MOST_REGISTERED) / 2))
    return [2.0**step for step in range(max(halvings, least), least - 1, -1)]


def registration(captured: Array, predicted: Array, kind: Registration, progress: Progress | None = None) -> Array:
    """The map captured_from_predicted, 3 x 3 in pixels, by enhanced correlation (ECC), coarse to fine.

    Raises
    ------
    InputError
        If an image is even, or the two hardly correlate.
    """
    warp = np.diag([captured.shape[1] / predicted.shape[1], captured.shape[0] / predicted.shape[0], 1.0])
    if kind == "none":
        return np.eye(3)

    # Pixel centres, not corners, are whole numbers: scaling keeps the corner (-0.5, -0.5).
    warp[:2, 2] = 0.5 * (np.diag(warp)[:2] - 1)
    if np.ptp(captured) == 0 or np.ptp(predicted) == 0:
        raise InputError("an even image cannot be registered", remedy='use `register="none"`')
    u, v = _far_shift(captured, predicted, warp)
    starts = [warp @ np.array([[1, 0, u], [0, 1, v], [0, 0, 1.0]]), warp]
    results = [_refined(captured, predicted, start, kind, progress or Progress("", 1, shown=False)) for start in starts]
    correlation, best = max(results, key=lambda result: result[0])
    if correlation < LEAST_CORRELATION:
        raise InputError(
            f"the images cannot be registered: their correlation is {correlation:.2f}",
            remedy='compare images of one scene, nearly from one place, or use `register="none"`',
        )
    return best


def _far_shift(captured: Array, predicted: Array, warp: Array) -> tuple[float, float]:
    """By how much the captured image lies aside [px], from all of it at once."""
    import cv2

    rough = warped(captured, warp, predicted.shape)
    filled = np.where(np.isfinite(rough), rough, float(np.nanmean(rough)))
    del rough
    factor = _scales(captured, predicted)[-1]
    pair = [image if factor == 1 else _smaller(image, factor) for image in (predicted, filled)]
    window = cv2.createHanningWindow((pair[0].shape[1], pair[0].shape[0]), cv2.CV_64F)
    (u, v), _ = cv2.phaseCorrelate(pair[0] - pair[0].mean(), pair[1] - pair[1].mean(), window)
    return factor * u, factor * v


def _refined(
    captured: Array, predicted: Array, warp: Array, kind: Registration, progress: Progress
) -> tuple[float, Array]:
    """Correlation and map after ECC on halved, then whole images; -infinity where it does not converge."""
    import cv2

    motion = cv2.MOTION_TRANSLATION if kind == "translation" else cv2.MOTION_HOMOGRAPHY
    rule = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ITERATIONS, ECC_STEP)
    correlation = -math.inf
    for factor in _scales(captured, predicted):
        # Corners stay together: x_small = (x + 0.5)/factor - 0.5.
        shrink = np.diag([1 / factor, 1 / factor, 1.0])
        shrink[:2, 2] = 0.5 / factor - 0.5
        small = shrink @ warp @ np.linalg.inv(shrink)
        small = small / small[2, 2]
        pair = [_shrunk(image, factor) for image in (predicted, captured)]
        everywhere = np.full(pair[1].shape, 255, np.uint8)
        given = small[:2] if kind == "translation" else small
        try:
            correlation, found = cv2.findTransformECC(
                pair[0], pair[1], given.astype(np.float32), motion, rule, everywhere, ECC_BLUR
            )
        except cv2.error:
            return -math.inf, warp
        progress.add(pair[0].size)
        small[: len(found)] = found
        warp = np.linalg.inv(shrink) @ small @ shrink
        warp = warp / warp[2, 2]
    return float(correlation), warp


def _shrunk(image: Array, factor: float) -> NDArray[np.float32]:
    """Mean over squares of `factor` pixels, scaled to unit scatter for the sake of single precision."""
    centred = image - image.mean()
    centred /= image.std()
    return _smaller(centred, factor).astype(np.float32)


def _smaller(image: Array, factor: float) -> Array:
    """Mean over squares of `factor` pixels."""
    import cv2

    size = (round(image.shape[1] / factor), round(image.shape[0] / factor))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float64)


def warped(image: Array, warp: Array, shape: tuple[int, int]) -> Array:
    """Look an image up at warp (u, v, 1) for each pixel (u, v) of `shape`.

    Cubic splines, held within the image's range; as it stands where nothing
    moves. NaN outside the image.
    """
    if image.shape == shape and np.array_equal(warp, np.eye(3)):
        return image.copy()
    from scipy.ndimage import map_coordinates, spline_filter

    low, high = float(image.min()), float(image.max())
    splines = spline_filter(np.pad(image, _RIM, mode="edge"), 3, mode="nearest")
    result = np.empty(shape)
    u = np.arange(shape[1], dtype=np.float64)
    for first in range(0, shape[0], _BAND):  # places of all pixels of a large picture take gigabytes
        v = np.arange(first, min(first + _BAND, shape[0]), dtype=np.float64)[:, None]
        x, y, w = (row[0] * u + row[1] * v + row[2] for row in warp)
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = x / w, y / w
        # Half a pixel beyond the outermost centres still belongs to the image.
        inside = (w > 0) & (x >= -0.5) & (x <= image.shape[1] - 0.5) & (y >= -0.5) & (y <= image.shape[0] - 0.5)
        places = [np.where(inside, place, 0.0) + _RIM for place in (y, x)]
        found = map_coordinates(splines, places, order=3, mode="nearest", prefilter=False)
        result[first : first + _BAND] = np.where(inside, np.clip(found, low, high), np.nan)
    return result
