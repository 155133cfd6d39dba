"""What pixels tell of the width between two rims whose blurs run into each other.

Light across them is a box of width w blurred by a disc of radius b, at a contrast that is not known either. Its
variance V = w^2/12 + b^2/4 is seen well. Its fourth cumulant is -(w^4/120 + b^4/16), which with x = w^2/12 is
-(1.2 x^2 + (V - x)^2): the same for x and for V/1.1 - x. So a second pair of width and blur looks much alike, where
V/1.1 > x, and where both pairs come close the light hardly depends on x at all: a standard error by the slopes there is
wrong. Hence the width's likelihood is followed, as far as five standard errors, and the second pair is held against the
same pixels: where it is at least a thousandth as likely, the width is not known.

Contrast times width is the same for both pairs. So the narrower one of a dark thing is darker still, and may ask for
less than no light between the rims, which nothing sends. Such a pair is held at the width where light is just none.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.measure.gauges.contour import Contour
from radwrap.measure.gauges.rims import Rim, Shape
from radwrap.measure.gauges.strip import NARROWEST, ROUGH, Blur, State, Strip, any_blur, jacobian_of, solved

Array = NDArray[np.float64]

EXCLUDED: Final = 25.0  # variances: what fits worse by five standard errors is out
# Variances: another fit that is 1000 times less likely leaves no doubt. From there to EXCLUDED the mean odds are 1 in
# 5000, and about one in 20 narrow stripes lies there.
IN_DOUBT: Final = 13.8
_NO_LIGHT: Final = -0.02  # of the contrast; a gray level without light is given to some percent of it
_DARK_SIGMAS: Final = 5.0  # standard errors of the width, by which light between may lie below that
_LIT_STEPS: Final = 4  # towards the width where light is just none
_LIT_CLOSE: Final = 0.002  # of the contrast, how closely it is met
_TRIES: Final = 3  # of a better fit
_BETTER: Final = 0.5  # variances, by which another fit must be better to be followed
_FAR: Final = 2.5  # standard errors by the slopes
_SQUARE: Final = 0.2  # of the squared distance, by which the likelihood's fall may differ: then the slopes are right
_STEPS: Final = 24  # of a walk to one side
_SMALL_RISE: Final = 1.0  # variances a step; the next is twice as long
_LARGE_RISE: Final = 9.0  # the same; the step is made again, half as long
_LONGEST: Final = 0.1  # of the width, of a step
# By how much another kind of blur may change the width without a warning: of the width, and in standard errors.
_SHAPE: Final = 0.05
_SHAPE_SIGMAS: Final = 2.0
_NO_DISC: Final = 5.0  # standard deviations, by which a sum of discs fits better where the blur is no disc
# Blurs, from which width on a slope of light between straight rims is seen: of narrower things it is a kind of blur.
# Where light falls unevenly it changes there as it does outside, by the same share of what comes back.
_PLATEAU: Final = 4.0
_CLOSE: Final = 1e-4  # px; how much worse a fit is hangs on the square of that
_FINE: Final = 2000  # places of the likelihood's integral


@dataclass(frozen=True, slots=True)
class Trial:
    """A width, the radius of blur that suits it, and by how much both fit worse than the best.

    Attributes
    ----------
    width, blur : float
        [px]
    rise : float
        Of the sum of squares, in variances.
    """

    width: float
    blur: float
    rise: float


@dataclass(frozen=True, slots=True, eq=False)
class NarrowFit:
    """A fit of two rims, and what else its pixels may show.

    Attributes
    ----------
    fit : Contour
        Whose last parameter is the width; its covariance holds the whole likelihood of the width.
    other : Trial or None
        That is in doubt: the width is then not known.
    """

    fit: Contour
    other: Trial | None = None

    @property
    def readings(self) -> tuple[tuple[float, float], ...]:
        """Width and blur of both fits that look alike [px]; none where the width is known."""
        if self.other is None:
            return ()
        return (float(self.fit.parameters[-1]), float(self.fit.blur)), (self.other.width, float(self.other.blur))

    @property
    def in_doubt(self) -> str | None:
        """What cannot be told apart; None where the width is known."""
        if self.other is None:
            return None
        return (
            f"{self.fit.parameters[-1]:.3g} px with a blur of {self.fit.blur:.3g} px fits best, but "
            f"{self.other.width:.3g} px with {self.other.blur:.3g} px only {math.sqrt(max(self.other.rise, 0)):.1f} "
            "standard errors worse"
        )


def lookalike(width: float, blur: float) -> tuple[float, float] | None:
    """Width and blur that give light across two rims the same variance and fourth cumulant; None where none do.

    Parameters
    ----------
    width, blur : float
        Distance of the rims and radius of the disc [px].
    """
    share = width**2 / 12
    total = share + blur**2 / 4
    there = total / 1.1 - share
    return (math.sqrt(12 * there), 2 * math.sqrt(total - there)) if there > 0 else None


def width_by_gaussian(width: float, blur: float) -> float:
    """Width that gives light across two rims the same variance and fourth cumulant where the blur is a Gaussian.

    A Gaussian has no fourth cumulant, so that 1.2 x^2 with another x is all of it.

    Parameters
    ----------
    width, blur : float
        Distance of the rims and radius of a disc of blur that were fitted [px].
    """
    share = width**2 / 12
    total = share + blur**2 / 4
    there = min(math.sqrt(share**2 + (total - share) ** 2 / 1.2), total)
    return math.sqrt(12 * there)


def fit_narrow(shape: Shape, blur: float, fitted: Callable[[Shape, float], Contour]) -> NarrowFit:
    """Fit two rims, and hold the fit against all others that the same pixels may show.

    Parameters
    ----------
    shape : Shape
        Of two rims; its last parameter is their distance [px].
    blur : float
        Radius of the disc of blur to begin with [px].
    fitted : callable
        Shape and blur to begin with -> fit.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # as of all such fits
        found = _fit_narrow(shape, blur, fitted)
    return replace(found, fit=_of_one_blur(found.fit))


def _of_one_blur(fit: Contour) -> Contour:
    """With a warning where the width hangs on what kind of blur it is, and that is no disc."""
    width = float(fit.parameters[-1])
    other, sigma = width_by_gaussian(width, fit.blur), math.sqrt(fit.covariance[-1, -1])
    if fit.beyond_disc < _NO_DISC or abs(other - width) < max(_SHAPE * width, _SHAPE_SIGMAS * sigma):
        return fit
    told = (
        f"the width hangs on the shape of the blur, which no standard error holds: {width:.3g} px if it is a disc, "
        f"about {other:.3g} px if it is a Gaussian"
    )
    return replace(fit, warnings=(*fit.warnings, told))


def _fit_narrow(shape: Shape, blur: float, fitted: Callable[[Shape, float], Contour]) -> NarrowFit:
    for number in range(_TRIES):
        fit = fitted(shape, blur)
        if shape.slopes.size == 0:
            shape = replace(shape, start=fit.parameters, slopes=_slopes(shape, fit))
            fit = fitted(shape, fit.blur)
        width = float(fit.parameters[-1])
        alike = lookalike(width, fit.blur)
        if alike is None:
            return NarrowFit(fit)
        best = _best(shape, fit.strip, fit.parameters, fit.blur)
        second = _best(shape, fit.strip, np.append(fit.parameters[:-1], alike[0]), alike[1])
        # Of a thing that sends none, noise makes a little less.
        here, noise = _light_between(best), _DARK_SIGMAS * math.sqrt(fit.covariance[-1, -1]) / width
        out = second.cost - best.cost > EXCLUDED * fit.noise
        if here < _NO_LIGHT - noise and _light_between(second) >= _NO_LIGHT and not out and number < _TRIES - 1:
            shape, blur = replace(shape, start=second.parameters), second.blur.radius
            continue
        least = min(_NO_LIGHT, here - noise)
        nodes = _nodes(shape, fit, best, least)
        there = Trial(float(second.parameters[-1]), second.blur.radius, (second.cost - best.cost) / fit.noise)
        there = _lit(shape, fit, best, (there, second), least)
        better = min([*nodes, there], key=lambda node: node.rise)
        # Beside another radius the shares of discs differ a little: what is better within the error is no other one.
        close = abs(better.width - width) < max(ROUGH, math.sqrt(fit.covariance[-1, -1]))
        if better.rise > -_BETTER or (close and number == _TRIES - 1):
            seen = nodes[0].width - ROUGH <= there.width <= nodes[-1].width + ROUGH
            # Of two that are one within its error neither is in doubt.
            same = abs(there.width - width) < math.sqrt(fit.covariance[-1, -1])
            other = None if seen or same or there.rise > IN_DOUBT else there
            return NarrowFit(_spread_out(shape, fit, best, nodes), other)
        shape, blur = replace(shape, start=np.append(fit.parameters[:-1], better.width)), better.blur
    # Of other pixels another one is better, again and again.
    return NarrowFit(fit, better)


def _slopes(shape: Shape, fit: Contour) -> Array:
    """How light may change across a thing, see `Shape`: the middle is off by blur^2 times a slope left out."""
    if not shape.closed and fit.parameters[-1] > _PLATEAU * fit.blur:
        return np.eye(2)
    state = _best(shape, fit.strip, fit.parameters, fit.blur)
    outside, between = _levels(state)
    beyond = between - float((state.terms.slow @ state.terms.parts(state.levels)[2]).mean())
    outside = (outside + beyond) / 2
    shares = np.array([[outside], [between - outside]])
    return np.asarray(shares / np.abs(shares).max())


def _levels(state: State) -> tuple[float, float]:
    """Mean light outside of two rims, and between them."""
    outside = state.terms.wide @ state.terms.parts(state.levels)[0]
    between = outside + state.terms.slow @ state.terms.parts(state.levels)[1]
    return float(outside.mean()), float(between.mean())


def _light_between(state: State) -> float:
    """Over the contrast."""
    outside, between = _levels(state)
    return between / max(abs(between - outside), 1e-300)


def _lit(shape: Shape, fit: Contour, best: State, found: tuple[Trial, State], least: float) -> Trial:
    """A reading; of one that has less light between its rims the nearest that has the least, over the contrast."""
    trial, state = found
    for _ in range(_LIT_STEPS):
        outside, between = _levels(state)
        if trial.rise > EXCLUDED or _light_between(state) >= least - _LIT_CLOSE or outside <= 0:
            break
        # What is missing between the rims stays as it is: contrast times width.
        width = trial.width * (outside - between) * (1 + least) / outside
        trial, state = _at(shape, fit, best, width, state.parameters[: len(fit.parameters) - 1])
    return trial


def _nodes(shape: Shape, fit: Contour, best: State, least: float) -> list[Trial]:
    """Widths in order, of which the first and the last are out, or the best one and one far off on either side."""
    middle = Trial(float(fit.parameters[-1]), fit.blur, 0.0)
    far = _FAR * math.sqrt(fit.covariance[-1, -1])
    if far < _LONGEST * middle.width:
        ends = [_at(shape, fit, best, middle.width + side * far, fit.parameters[:-1])[0] for side in (-1, 1)]
        if all(abs(end.rise / _FAR**2 - 1) < _SQUARE for end in ends):
            return [ends[0], middle, ends[1]]
    walks = [_walk(shape, fit, best, side, least) for side in (-1.0, 1.0)]
    return [*reversed(walks[0]), middle, *walks[1]]


def _walk(shape: Shape, fit: Contour, best: State, side: float, least: float) -> list[Trial]:
    """Widths to one side, until one is out, or has the least light between the rims, over the contrast."""
    middle = float(fit.parameters[-1])
    longest = _LONGEST * middle
    step = min(math.sqrt(fit.covariance[-1, -1]), longest)
    most = math.sqrt(middle**2 + 3 * fit.blur**2)
    found: list[Trial] = []
    width, before, parameters = middle, 0.0, fit.parameters[:-1]
    for _ in range(_STEPS):
        there = width + side * step
        if not NARROWEST < there < most:
            break
        node, state = _at(shape, fit, best, there, parameters)
        if node.rise - before > _LARGE_RISE and step > 1e-3 * longest:
            step /= 2
            continue
        dark = _light_between(state) < least
        found.append(_lit(shape, fit, best, (node, state), least) if dark else node)
        if dark or node.rise > EXCLUDED:
            break
        if node.rise - before < _SMALL_RISE:
            step = min(2 * step, longest)
        width, before, parameters = there, node.rise, state.parameters
    return found


def _at(shape: Shape, fit: Contour, best: State, width: float, parameters: Array) -> tuple[Trial, State]:
    """The best fit of a width."""
    # Of the same variance across the rims.
    blur = math.sqrt(max(fit.blur**2 + (fit.parameters[-1] ** 2 - width**2) / 3, NARROWEST**2))
    state = _best(_of_width(shape, width), fit.strip, parameters, blur)
    return Trial(width, state.blur.radius, (state.cost - best.cost) / fit.noise), state


def _best(shape: Shape, strip: Strip, parameters: Array, blur: float) -> State:
    """With whatever blur there is, from a disc of this radius on."""
    disc = solved(shape, strip, parameters, Blur(blur), done=_CLOSE)
    return any_blur(shape, strip, disc, done=_CLOSE)


def _of_width(shape: Shape, width: float) -> Shape:
    """The same at a width that is given."""

    def rims(parameters: Array, places: Array) -> list[Rim]:
        return list(shape.rims(np.append(parameters, width), places))

    return replace(shape, rims=rims, start=shape.start[:-1], units=shape.units[:-1])


def _spread_out(shape: Shape, fit: Contour, best: State, nodes: list[Trial]) -> Contour:
    """The fit with the mean square about it, over the likelihood, as the variance of width and of blur."""
    from scipy.interpolate import PchipInterpolator

    if len(nodes) <= 3:
        return fit
    widths, blurs, rises = np.array([(node.width, node.blur, node.rise) for node in nodes]).T
    places = np.linspace(widths[0], widths[-1], _FINE)
    curve = PchipInterpolator(widths, rises)(places)
    # From its least: of pictures without noise variances are so small that exp would overflow.
    likelihood = np.exp(-(curve - curve.min()) / 2)
    likelihood /= likelihood.sum()
    square = float(likelihood @ (places - fit.parameters[-1]) ** 2)
    # What is left of the blur's variance where the width is given is as the slopes have it.
    given = _blur_variance(_of_width(shape, float(fit.parameters[-1])), fit.strip, best) * fit.noise
    blurred = float(likelihood @ (PchipInterpolator(widths, blurs)(places) - fit.blur) ** 2) + given
    scale = np.ones(len(fit.parameters))
    scale[-1] = math.sqrt(square / fit.covariance[-1, -1])
    return replace(fit, covariance=fit.covariance * np.outer(scale, scale), blur_sigma=math.sqrt(blurred))


def _blur_variance(shape: Shape, strip: Strip, state: State) -> float:
    """Of blur in units of the noise, by the slopes."""
    count = len(state.parameters) - 1
    jacobian = jacobian_of(shape, strip, replace(state, parameters=state.parameters[:count]))
    return float((np.linalg.pinv(jacobian, rcond=1e-9)[count] ** 2).sum())
