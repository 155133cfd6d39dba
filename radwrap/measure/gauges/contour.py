"""One least-squares fit of a contour in a strip of pixels: its shape, the blur, and the light on either side.

The shape says how far each pixel lies from the contour, and how the contour is bent there; `step` says what the pixel
sees. One disc is fitted for the blur, and then a sum of discs, so that no symmetric blur moves the contour. Light may
differ from place to place along the contour and change across it. Pixels and stretches of the contour that belong to
something else, a neighbour or a burr, are left out and counted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.measure.background import QUANTISATION
from radwrap.measure.edges.blur import DISCS
from radwrap.measure.edges.correlation import variance_factor
from radwrap.measure.edges.misfit import beyond_noise, misfit_of
from radwrap.measure.gauges.response import Light
from radwrap.measure.gauges.rims import Shape
from radwrap.measure.gauges.second_edge import moved_by_second_edge
from radwrap.measure.gauges.sided import FALSE_ALARM, FALSE_ALARM_BESIDE, has_coma, has_sides
from radwrap.measure.gauges.stretches import (
    FEWEST_BLOCKS,
    LEAST_CONTOUR,
    blocks_of,
    kept_of,
    pixels_of,
    spread_of,
    stepping_of,
    with_next,
)
from radwrap.measure.gauges.strip import (
    DONE,
    NARROWEST,
    ROUGH,
    Blur,
    State,
    Strip,
    any_blur,
    carried,
    influence_of,
    lit_anew,
    moved_light,
    solved,
    terms_of,
)
from radwrap.measure.gauges.torn import lies_elsewhere

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

BEYOND: Final = 4.0  # px of level on either side of the blur
_ROUNDS: Final = 8  # of strip, weights and outliers
_RADIUS: Final = 1e-4  # px, to which the disc is known beside which other discs are fitted
_STILL: Final = 1e-3  # px; pixels no longer come and go
_REST_SIGMA: Final = 1.0  # standard errors; a last round that moves it by more has not found the contour
_SHORT_BLOCK: Final = 3.0  # px, that tells a polygon from a circle
_FEWEST_PIXELS: Final = 30  # of a side, for its noise
_MISFIT_SIGMA: Final = 5.0  # so far above what noise makes of the blocks' places the contour is of another shape
_MOVED: Final = 0.01  # px, by which what lies beside a contour may move it without a warning
MISFIT: Final = 0.02  # px; a departure from the shape that is less is no matter
_PROFILE: Final = 0.025  # of the contrast, rms, by which the profile may differ from that of one blurred step
_EVEN: Final = 0.004  # of the contrast, likewise of what is left on both sides alike
_SPREADS_ROUNDING: Final = 0.5  # gray levels of noise, from which on rounding is a noise of each pixel
_BESIDE: Final = 3.0  # px beside the blur and its tails where that is looked for
_BIN: Final = 0.5  # px across the contour
_SMALL: Final = 1 << 16  # pixels of an image that are all looked at
_CELL: Final = 16  # px
_CELL_SLACK: Final = 1.5  # distances from an ellipse are right near it only
_FAINTEST: Final = 0.3  # standard deviations of a pixel; the best contour in noise reaches half of that
_ABOVE: Final = 0.1  # of the contrast, by which a fitted level may lie above the brightest pixel
_UNDETERMINED: Final = (
    "the pixels look the same with another place or size, blur and levels: the standard errors say nothing; "
    "turn the object against the pixels, or blur it"
)
_STEEP: Final = 0.15  # of the contrast, by which light may change across a pixel


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """What came of the fit.

    Attributes
    ----------
    parameters : ndarray, shape (k,)
        Of the shape.
    covariance : ndarray, shape (k, k)
        Of noise.
    blur, blur_sigma : float
        Radius of the disc of blur that fits best [px].
    low, high : float
        Mean light of either side.
    influence : ndarray, shape (k, n)
        What an error of one gray level in each pixel of the strip does to the parameters.
    strip : Strip
        Pixels that were fitted.
    noise : float
        Variance of their weighted residuals, with what neighbours have in common.
    residual_rms : float
        What the fit leaves [light].
    pixels : int
        That were fitted.
    left_out : float
        Share of the contour that shows something else.
    misfit : float
        Departure of the contour from the shape, rms beyond noise [px].
    beyond_disc : float
        By how much a sum of discs fits better than one disc [standard deviations of what noise makes of that].
    warnings : tuple of str
        Where the model does not fit.
    """

    parameters: Array
    covariance: Array
    blur: float
    blur_sigma: float
    low: float
    high: float
    influence: Array = field(repr=False)
    strip: Strip = field(repr=False)
    noise: float
    residual_rms: float
    pixels: int
    left_out: float
    misfit: float
    beyond_disc: float
    warnings: tuple[str, ...]

    def by_rendering(self, weights: Array) -> float:
        """Largest change of a sum of parameters where no pixel is off by more than one gray level."""
        return float(np.abs(weights @ self.influence).sum())


def fit_contour(light: Light, shape: Shape, blur: float, band: float, aspect: float) -> Contour:
    """Fit a shape to the light of an image.

    Parameters
    ----------
    light : Light
        Of the image.
    shape : Shape
        Where to begin, within a pixel or two.
    blur : float
        Radius of the disc of blur to begin with [px].
    band : float
        The contour is not looked for farther away than this [px].
    aspect : float
        Height of a pixel over its width.

    Raises
    ------
    InputError
        If too little of the contour is seen, or the fit does not come to rest in the band.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # of tall narrow matrices: threads would wait for one another most of the time
        return _fitted(light, shape, Blur(max(blur, NARROWEST)), band, aspect)


def _fitted(light: Light, shape: Shape, start: Blur, band: float, aspect: float) -> Contour:
    """Rounds of strip, weights and outliers, until pixels no longer come and go."""
    parameters, blur, noise = shape.start, start, (0.0, 0.0)
    sound = np.ones(0, dtype=np.bool_)
    for _ in range(_ROUNDS):
        before, radius = (parameters, blur), blur.radius
        strip = _strip(light, shape, parameters, min(radius + BEYOND, band), aspect)
        steps, stepping = stepping_of(shape, strip, before)
        _check_seen(stepping)
        strip = strip.only(steps)
        state = _rough(shape, _weighted(strip, shape, before, noise), before, sound)
        keep, kept, sound = kept_of(shape, state)
        left_out = 1 - stepping * kept
        _check_seen(1 - left_out, LEAST_CONTOUR / 2)  # the first fit is that of all, and the next finds more of it
        first, noise = min(noise) == 0, _side_noise(strip, state, keep)
        strip = _weighted(strip, shape, (state.parameters, state.blur), noise).only(keep)
        disc, state = _both(shape, strip, (state.parameters, state.blur))
        parameters, blur = state.parameters, state.blur
        moved = float(np.abs((parameters - shape.start) / shape.units).max())
        if not moved <= band + 1:
            raise InputError(
                "the fit leaves the band", where="the image", remedy="place the caliper nearer to the contour"
            )
        # What is seen of a blur far narrower than a pixel is its square, which may settle long before the radius does.
        blurred = abs(blur.radius - radius) * min(1.0, blur.radius + radius)
        still = max(float(np.abs((parameters - before[0]) / shape.units).max()), blurred)
        if not first and still < _STILL:
            break
    _check_seen(1 - left_out)
    farther = _strip(light, shape, parameters, min(blur.radius + 2 * BEYOND, band), aspect, checked=False)
    wide = _weighted(farther, shape, (parameters, blur), noise)
    told = _told(shape, light, strip, disc, state, left_out=left_out, sound=sound, wide=wide)
    restless = np.maximum(_REST_SIGMA * np.sqrt(np.diag(told.covariance)), MISFIT * shape.units)
    if (np.abs(parameters - before[0]) > restless).any():
        raise InputError(
            "the fit does not come to rest: what lies beside the contour is taken for it by turns",
            where="the image",
            remedy="narrow the band, or leave out by arc what lies beside the contour",
        )
    return told


def _rough(shape: Shape, strip: Strip, at: tuple[Array, Blur], sound: Flags) -> State:
    """Good enough to see which pixels show the contour; by stretches that did, with the blur of the round before."""
    if not sound.size:
        return _both(shape, strip, at, done=ROUGH)[1]
    some = pixels_of(shape, shape.rims(at[0], strip.places), sound)
    return carried(shape, strip, solved(shape, strip.only(some), *at, done=ROUGH))


def _both(shape: Shape, strip: Strip, at: tuple[Array, Blur], *, done: float = DONE) -> tuple[State, State]:
    """The fits with one disc for the blur, and with whatever blur there is."""
    disc = solved(shape, strip, at[0], Blur(at[1].radius), done=max(done, _RADIUS))
    return disc, any_blur(shape, strip, disc, at[1], done=done)


def _strip(
    light: Light, shape: Shape, parameters: Array, reach: float, aspect: float, *, checked: bool = True
) -> Strip:
    """Usable pixels so near to the contour; that there are enough of them is checked."""
    number = _perhaps_near(light.values.shape, shape, parameters, reach, aspect)
    v, u = np.divmod(number, light.values.shape[1])
    places = np.column_stack([u.astype(np.float64), v * aspect])
    rims = shape.rims(parameters, places)
    near = np.min([np.abs(rim.distance) for rim in rims], axis=0) <= reach
    near &= (rims[0].along >= 0) & (rims[0].along <= shape.length)
    some = near & light.usable.ravel()[number]
    inside = np.min([rim.distance for rim in rims], axis=0) > 0
    for side in (near & inside, near & ~inside):
        if checked and (some & side).sum() < max(2 * (len(shape.start) + 1), LEAST_CONTOUR * side.sum()):
            raise InputError(
                "has too few usable pixels on one side of the contour",
                where="the image",
                remedy="see whether it is saturated there, or ends",
            )
    weight = np.ones(int(some.sum()))
    some_number = number[some]
    return Strip(places[some], light.values.ravel()[some_number], light.slope.ravel()[some_number], weight, aspect)


def _perhaps_near(
    size: tuple[int, ...], shape: Shape, parameters: Array, reach: float, aspect: float
) -> NDArray[np.intp]:
    """Numbers of pixels, in order, among which are all so near to a contour; of a large image by its cells' middles."""
    rows, columns = size
    if rows * columns <= _SMALL:
        return np.arange(rows * columns)
    v, u = (np.arange(0, count, _CELL) for count in size)
    middles = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2) + (_CELL - 1) / 2
    rims = shape.rims(parameters, middles * np.array([1.0, aspect]))
    # A contour so near to a pixel is nearer to its cell's middle than half of the diagonal more.
    slack = _CELL_SLACK * _CELL / 2 * math.hypot(1.0, aspect)
    cells = (np.min([np.abs(rim.distance) for rim in rims], axis=0) <= reach + slack).reshape(len(v), len(u))
    wide = cells.repeat(_CELL, axis=0)[:rows].repeat(_CELL, axis=1)[:, :columns]
    return np.flatnonzero(wide)


def _weighted(strip: Strip, shape: Shape, at: tuple[Array, Blur], noise: tuple[float, float]) -> Strip:
    """The same pixels with their noise: that of the dark side, of the bright side, and between."""
    if min(noise) <= 0:
        return strip
    bright = terms_of(shape, shape.rims(at[0], strip.places), at[1], strip.aspect).brightness
    variance = noise[0] ** 2 + bright * (noise[1] ** 2 - noise[0] ** 2)
    return replace(strip, weight=1 / np.sqrt(variance))


def _side_noise(strip: Strip, state: State, keep: Flags) -> tuple[float, float]:
    """Standard deviation of the pixels of the dark and of the bright side; of all where a side has few."""
    left = strip.light - state.fitted
    # Of a picture without noise what is left is rounding of the arithmetic.
    everywhere = max(spread_of(left[keep]), 1e-9 * float(np.ptp(strip.light)), 1e-300)
    signed = np.stack([rim.distance for rim in state.rims])
    shared = _shared_noise(np.clip(left[keep] / everywhere, -4, 4) ** 2, state.terms.brightness[keep]) * everywhere
    found = []
    reach = state.blur.radius + 1
    for number, far in enumerate(((signed < -reach).any(axis=0), (signed > reach).all(axis=0))):
        some = keep & far
        here = spread_of(left[some]) if some.sum() >= _FEWEST_PIXELS else float(shared[number])
        found.append(max(here, 0.3 * everywhere))
    return found[0], found[1]


def _shared_noise(square: Array, bright: Array) -> Array:
    """Standard deviations of both sides, of pixels that see something of both: their variances add up."""
    columns = np.stack([1 - bright, bright], axis=1)
    variance = np.ones(2)
    for _ in range(3):  # the square of noise is spread in proportion to its mean
        weight = 1 / np.maximum(columns @ variance, 0.1)
        variance = np.linalg.lstsq(columns * weight[:, None], square * weight, rcond=None)[0].clip(0.01)
    return np.asarray(np.sqrt(variance))


def _check_seen(share: float, least: float = LEAST_CONTOUR) -> None:
    """Of less of the contour a shape is as good as a guess."""
    if share < least:
        raise InputError(
            f"only {share:.0%} of the contour looks like one",
            where="the image",
            remedy="place the caliper on it, with a narrower band, or give an arc",
        )


def _told(
    shape: Shape, light: Light, strip: Strip, disc: State, state: State, *, left_out: float, sound: Flags, wide: Strip
) -> Contour:
    """Covariance, influence of each pixel, and what speaks against the model; levels and radius are of one disc."""
    count = len(state.parameters)
    inverse, undetermined = influence_of(shape, strip, state)
    variance = float(state.residual @ state.residual) / max(strip.light.size - len(inverse), 1)
    across = np.choose(state.nearest, [rim.distance for rim in state.rims])
    # Rounding is noise of its own, also where a still image shows none.
    rounding = (QUANTISATION if is_whole(light) else 0.0) * (strip.slope * strip.weight) ** 2
    factor = variance_factor(across, state.rims[0].along, state.residual)
    noise = np.maximum(variance, rounding) * factor
    # What holds the shares counts as a measurement of each.
    covariance = (inverse * np.append(noise, np.full(len(DISCS), noise.mean()))) @ inverse.T
    blur_sigma = math.sqrt(float(influence_of(shape, strip, disc)[0][count] ** 2 @ noise))
    low, high = _levels(strip, disc)  # large discs leave levels in doubt, though not the place
    if abs(high - low) < _FAINTEST / float(np.median(strip.weight)):
        raise InputError("shows no contour above its noise", where="the image", remedy="raise contrast or exposure")
    misfit, significant = _misfit(shape, strip, state, variance)
    # What neighbours have in common is here what is looked for, but for rounding that no noise has spread.
    quiet = is_whole(light) and variance < (_SPREADS_ROUNDING * float(np.median(strip.slope * strip.weight))) ** 2
    tested = float(noise.mean()) if quiet else variance
    alone = ~with_next(~sound, shape, len(state.rims))
    some = pixels_of(shape, state.rims, alone)
    sided = has_sides(shape, strip, state, some, noise=tested, contrast=abs(high - low))
    second = 0.0
    if len(state.rims) == 1:
        reach = float(np.abs(across).max())
        farther, apart = _asked(shape, wide, state, sound)
        second = moved_by_second_edge(shape, *apart, reach=reach, noise=tested)
        chance = FALSE_ALARM if shape.closed or sound.all() else FALSE_ALARM_BESIDE
        if not sided and second <= _MOVED:  # a second edge has a side too, and its own warning says more
            sided = has_coma(shape, *farther, noise=tested, contrast=abs(high - low), false_alarm=chance)
    return Contour(
        parameters=state.parameters,
        covariance=covariance[:count, :count],
        blur=state.blur.radius,
        blur_sigma=blur_sigma,
        low=low,
        high=high,
        influence=inverse[:count, : strip.light.size] * (strip.weight * strip.slope),
        strip=strip,
        noise=float(noise.mean()),
        residual_rms=float(np.sqrt(np.mean((state.residual / strip.weight) ** 2))),
        pixels=strip.light.size,
        left_out=left_out,
        misfit=misfit,
        beyond_disc=_beyond_disc(disc, state, float(noise.mean())),
        warnings=(
            *_warnings(
                strip, disc, state, misfit if significant else 0.0, sided=sided, second=second, rounded=is_whole(light)
            ),
            *((_UNDETERMINED,) if undetermined else ()),
            *_torn(shape, wide, state, sound),
        ),
    )


def _torn(shape: Shape, wide: Strip, state: State, sound: Flags) -> Iterator[str]:
    elsewhere = lies_elsewhere(shape, wide, state, sound)
    if elsewhere is not None:
        yield (
            f"{elsewhere[0]:.0%} of the contour lies elsewhere, by {elsewhere[1]:.2g} px: it is torn, and only the "
            "other part was measured"
        )


def _asked(shape: Shape, wide: Strip, state: State, sound: Flags) -> list[tuple[Strip, State]]:
    """Pixels also farther away, of stretches that show the contour there too: of all, and of those beside no others."""
    keep, _, there = kept_of(shape, lit_anew(shape, wide, state))
    shows = sound & there
    block, _ = blocks_of(shape, shape.rims(state.parameters, wide.places))
    found = [wide.only(keep & some[block]) for some in (shows, ~with_next(~shows, shape, len(state.rims)))]
    return [(some, lit_anew(shape, some, state)) for some in found]


def _beyond_disc(disc: State, state: State, noise: float) -> float:
    gain = float(disc.residual @ disc.residual - state.residual @ state.residual) / max(noise, 1e-300)
    return (gain - len(DISCS)) / math.sqrt(2 * len(DISCS))


def is_whole(light: Light) -> bool:
    """Whether gray levels were rounded, as far as light of a gamma of 1 shows it."""
    some = light.values[:64]
    return bool(np.ptp(some) > 0 and (np.abs(np.mod(some - some.flat[0] + 0.5, 1.0) - 0.5) < 1e-6).all())


def _levels(strip: Strip, state: State) -> tuple[float, float]:
    """Mean light of the dark and of the bright side, as fitted."""
    low = state.terms.wide @ state.terms.parts(state.levels)[0]
    contrast = state.terms.at_rims(state.levels)[0][0]
    return float(low.mean()), float((low + contrast).mean())


def _misfit(shape: Shape, strip: Strip, state: State, variance: float) -> tuple[float, bool]:
    """By how much stretches of the contour lie off the shape, rms beyond noise [px]; whether that is significant."""
    block, count = blocks_of(shape, state.rims, _SHORT_BLOCK)
    used = np.unique(block)
    if len(used) < FEWEST_BLOCKS:
        return 0.0, False
    slope = _by_shift(shape, strip, state) * strip.weight
    power = np.maximum(np.bincount(block, slope**2, minlength=count)[used], 1e-300)
    shift = np.bincount(block, slope * state.residual, minlength=count)[used] / power
    sigma = np.sqrt(variance / power)
    known = sigma < 10 * np.median(sigma)
    shift, sigma = shift[known], sigma[known]
    free = max(len(shift) - len(state.parameters), 1)
    chi = float(((shift / sigma) ** 2).sum())
    beyond = float(np.mean(shift**2) - np.mean(sigma**2) * free / len(shift))
    return math.sqrt(max(beyond, 0.0)), chi > free + _MISFIT_SIGMA * math.sqrt(2 * free)


def _profile(strip: Strip, state: State) -> float:
    """Mean of what the fit leaves at each distance from the contour, rms beyond noise [light]; 0 by chance."""
    across = np.choose(state.nearest, [rim.distance for rim in state.rims])
    here = np.abs(across) <= state.blur.radius + 1.5
    number = np.floor((across[here] - across[here].min()) / _BIN).astype(np.intp)
    left, weight = state.residual[here] / strip.weight[here], strip.weight[here]
    count = np.bincount(number)
    some = count > 3
    if some.sum() < 3:
        return 0.0
    mean = np.bincount(number, left)[some] / count[some]
    variance = np.bincount(number, 1 / weight**2)[some] / count[some] ** 2
    return beyond_noise(mean, variance)


def _even_misfit(strip: Strip, state: State, contrast: float, *, rounded: bool) -> float:
    """What the fit leaves alike on both sides of a rim, rms beyond noise over the contrast; the largest of the rims.

    No symmetric blur does, whatever it is; a second edge beside the rim, a fringe and a clipped side do, and move it.
    """
    slope = float(np.median(strip.slope))
    left = state.residual / strip.weight * strip.slope  # gray, as rounding is
    found = []
    for number, rim in enumerate(state.rims):
        here = state.nearest == number
        reach = 2 * state.blur.radius + _BESIDE
        found.append(misfit_of(rim.distance[here], left[here], reach, contrast * slope, rounded=rounded)[1])
    return max(found)


def _by_shift(shape: Shape, strip: Strip, state: State) -> Array:
    """Derivative of the model by a shift of the nearest rim to its dark side."""
    step = 1e-3
    found = []
    for k, rim in enumerate(state.rims):
        moved = [*state.rims[:k], replace(rim, distance=rim.distance + step), *state.rims[k + 1 :]]
        found.append((moved_light(shape, state, moved) - state.fitted) / step)
    return np.choose(state.nearest, found)


def _warnings(
    strip: Strip, disc: State, state: State, misfit: float, *, sided: bool, second: float, rounded: bool
) -> Iterator[str]:
    low, high = _levels(strip, disc)
    contrast = max(abs(high - low), 1e-300)
    off = _profile(strip, disc) / contrast
    if off > _PROFILE:
        yield (
            f"across the contour light differs by {off:.1%} of the contrast from one blurred step: a chamfer, a "
            "shadow or the side of a thick part may lie there"
        )
    elif (even := _even_misfit(strip, state, contrast, rounded=rounded)) > _EVEN:
        yield (
            f"on both sides of the contour light differs alike, by {even:.1%} of the contrast, from one step with any "
            "symmetric blur: a second edge, a fringe or a clipped side moves the contour by more than is stated"
        )
    elif sided:
        yield (
            "the blur differs from one side of the contour to the other, by more than chance: coma, a second edge, a "
            "fringe or a clipped side moves the contour by more than is stated"
        )
    elif second > _MOVED:
        yield (
            f"beside the contour light changes by a step and not by a slope, which moves the contour by about "
            f"{second:.2g} px: a second edge lies there; narrow the band to one of them"
        )
    if misfit > MISFIT:
        yield f"the contour departs from the shape by {misfit:.2g} px rms beyond noise: it is of another one"
    if high > float(strip.light.max()) + _ABOVE * contrast:
        yield "the fitted level lies above the brightest pixel: the object is smaller than its blur"
    if len(disc.rims) == 1:
        dark, across = (disc.terms.parts(disc.levels)[number] for number in (1, 3))
        slopes = disc.terms.slow @ np.stack([dark, dark + across], axis=1)
        steep = float(np.median(np.abs(slopes), axis=0).max()) / contrast
        if steep > _STEEP:
            yield f"light beside the contour changes by {steep:.0%} of the contrast a pixel: see what lies there"
