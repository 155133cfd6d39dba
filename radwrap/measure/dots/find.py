"""All dots of a grid, or an error that says how many there are."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.dots.centres import METHODS, Centre, Method, Window, centre
from radwrap.measure.dots.detect import noise_of
from radwrap.measure.dots.plane import disc_centre_shift, fit_homography, project
from radwrap.measure.dots.result import Dot, Dots, DotsNotFound, missing, named_dots
from radwrap.measure.dots.settle import grid_in, grid_near, present
from radwrap.measure.dots.survey import Grid, Survey, windows
from radwrap.measure.dots.unlike import Likeness, likeness_of
from radwrap.progress import Progress

Field = NDArray[np.float64]

LARGEST_GRID: Final = 10_000  # dots
# A dot with a larger share of saturated pixels is worth a warning.
SATURATED: Final = 0.02
ROUNDS: Final = 4


def find_dots(
    image: GrayImage,
    rows: int,
    columns: int,
    *,
    method: Method = "gray",
    dark: float | None = None,
    pitch: float | None = None,
    dot_diameter: float | None = None,
    saturation: float | None = None,
    progress: Progress | None = None,
) -> Dots:
    """Measure the centres of all dots of a calibration board.

    Bright dots on a dark board and dark dots on a bright one are told apart
    by themselves. The rotation that decides which row is the top is that in
    the polar decomposition of d(u, v)/d(column, row) at the grid's centre.
    A grid of as many rows as columns looks the same after a quarter turn: up
    to 45 degrees rows and columns are the board's own, beyond that they are
    those of the board turned by multiples of 90 degrees; other grids keep
    theirs up to 90 degrees.

    Parameters
    ----------
    image : GrayImage
        One board, wholly in view.
    rows, columns : int
        Dots of the board, at least 2 each.
    method : str
        ``gray``: mean position weighted by gray level above the background.
        ``gray_threshold``: by what exceeds a quarter of the dot's level.
        ``binary``: of the pixels above half the level. ``ellipse``: centre of
        the ellipse through the half-level contour, the light's fall-off over
        the board taken out. ``conic``: that, less the distance between the
        centre of a disc's image and the image of its centre (heikkila2000).
    dark : float, optional
        Gray level without light, taken away in place of the background
        around each dot, for ``gray``, ``gray_threshold`` and ``binary`` of
        bright dots.
    pitch, dot_diameter : float, optional
        Of the board [m]; ``conic`` needs both.
    saturation : float, optional
        Gray level at which the sensor saturates; default the largest that
        `image` can hold.
    progress : Progress, optional
        Counts scales at which the grid is sought, and rounds in which it settles.

    Returns
    -------
    Dots

    Raises
    ------
    DotsNotFound
        If not every dot is found, or dots go on beyond the grid.
    InputError
        If a parameter or the image is not usable.

    Examples
    --------
    >>> import numpy as np, radwrap
    >>> v, u = np.indices((90, 90))
    >>> away = np.hypot((u - 5) % 20 - 10, (v - 5) % 20 - 10)
    >>> inside = (abs(u - 45) < 40) & (abs(v - 45) < 40)
    >>> picture = radwrap.GrayImage(np.rint(20 + 150 * inside / (1 + np.exp(3 * (away - 6)))))
    >>> radwrap.find_dots(picture, 4, 4).centres[0].round(1).tolist()
    [15.0, 15.0]
    """
    return find_dots_by(
        image,
        rows,
        columns,
        methods=(method,),
        dark=dark,
        pitch=pitch,
        dot_diameter=dot_diameter,
        saturation=saturation,
        progress=progress,
    )[method]


def find_dots_by(
    image: GrayImage,
    rows: int,
    columns: int,
    *,
    methods: Sequence[Method] = METHODS,
    dark: float | None = None,
    pitch: float | None = None,
    dot_diameter: float | None = None,
    saturation: float | None = None,
    least_noise: float = 0.0,
    progress: Progress | None = None,
) -> dict[Method, Dots]:
    """Measure by several methods; the dots are sought only once.

    Parameters, result of each method and errors are those of `find_dots`. `least_noise` is the noise that the image
    has at least [gray level]: a predicted image that is not rounded shows none.
    """
    for method in methods:
        _check_method(method, pitch, dot_diameter)
    sought = seek_dots(
        image,
        rows,
        columns,
        dark=dark,
        pitch=pitch,
        dot_diameter=dot_diameter,
        saturation=saturation,
        least_noise=least_noise,
        progress=progress,
    )
    return {method: measured_dots(sought, method) for method in methods}


@dataclass(frozen=True, slots=True, eq=False)
class SoughtDots:
    """Dots that are known to be there, before their centres.

    Attributes
    ----------
    image : GrayImage
    grid : Grid
    survey : Survey
    noise : float
        [gray level].
    likeness : Likeness
        Of the dots to one another.
    dark : float or None
    pitch, dot_diameter : float or None
        As for `find_dots`.
    """

    image: GrayImage
    grid: Grid
    survey: Survey
    noise: float
    likeness: Likeness
    dark: float | None
    pitch: float | None
    dot_diameter: float | None


def seek_dots(
    image: GrayImage,
    rows: int,
    columns: int,
    *,
    dark: float | None = None,
    pitch: float | None = None,
    dot_diameter: float | None = None,
    saturation: float | None = None,
    least_noise: float = 0.0,
    near: SoughtDots | None = None,
    progress: Progress | None = None,
) -> SoughtDots:
    """Find the grid, which takes ten times as long as the centres by one method do; parameters as for `find_dots_by`.

    Where the dots of an image `near` are known, which differs by its noise only, they are looked for there first; not
    where they run together, as the model that parts them hangs on where it starts.

    Raises
    ------
    DotsNotFound, InputError
        As for `find_dots`.
    """
    _checked(image, (rows, columns), (pitch, dot_diameter))
    radius = dot_diameter / 2 / pitch if pitch is not None and dot_diameter is not None else None
    saturation = float(2**image.bit_depth - 1) if saturation is None else saturation
    noise = max(noise_of(image.values), least_noise)
    progress = progress or Progress("", 1, shown=False)
    grid: Grid | None = None
    if near is not None and not near.survey.touching.any():
        with suppress(DotsNotFound):
            grid, found = grid_near(image, near.grid, noise, progress)
    if grid is None:
        grid, found = grid_in(image, (rows, columns), noise, radius, saturation=saturation, progress=progress)
    views = [_flattened(view, slope) for view, slope in zip(windows(grid, found), _slopes(found), strict=True)]
    likeness = likeness_of(views, found.touching, noise)
    return SoughtDots(image, grid, found, noise, likeness, dark, pitch, dot_diameter)


def measured_dots(sought: SoughtDots, method: Method) -> Dots:
    """Centres by one of the methods of `find_dots`.

    Raises
    ------
    DotsNotFound
        If the method finds no centre in some dot.
    InputError
        If it does not know what it needs.
    """
    _check_method(method, sought.pitch, sought.dot_diameter)
    image, grid, found, noise, dark = sought.image, sought.grid, sought.survey, sought.noise, sought.dark
    rows, columns = grid.shape
    contour = method in ("ellipse", "conic")
    warnings = []
    if dark is not None and grid.sign > 0 and not contour:
        grid = replace(grid, dark=dark)
    elif dark is not None:
        warnings.append("the dark level is not used: contours and dark dots are measured against their surroundings")
    views = windows(grid, found)
    saturated = np.array([_saturated(image, view, grid.saturation) for view in views])
    shift = np.zeros((len(views), 2))
    if contour and found.slopes is not None:
        views = [_flattened(view, slope) for view, slope in zip(views, _slopes(found), strict=True)]
        if found.model is not None:
            # Blur mixes the light's fall-off in before it can be divided out: a kernel of variance s^2 along each
            # axis, r^2/4 for a disc, then seems displaced by -s^2 times the relative gradient.
            shift = found.model.blur**2 / 4 * found.slopes
    elif contour:
        warnings.append("fall-off of light over each dot is not taken out: the levels follow no smooth law")
    centres = [None if view is None else centre(view, method, noise) for view in views]
    whole = _whole(grid, found, centres, noise, method)
    measured = np.array([one.place for one in whole]) + shift
    places, homography = measured, fit_homography(grid.board, measured)
    if method == "conic":
        for _ in range(ROUNDS):
            places = measured - disc_centre_shift(homography, grid.board, found.radius)
            homography = fit_homography(grid.board, places)
    if (saturated > SATURATED).any():
        warnings.append(f"{int((saturated > SATURATED).sum())} of {len(whole)} dots are saturated: their centres shift")
    if found.touching.any():
        how = "by a model of the board's light" if found.model is not None else "by windows only"
        warnings.append(f"{int(found.touching.sum())} of {len(whole)} dots ran together and were separated {how}")
    warnings += _told_unlike(sought.likeness, columns)
    dots = tuple(
        Dot(
            row=index // columns,
            column=index % columns,
            u=float(places[index, 0]),
            v=float(places[index, 1]),
            covariance=one.covariance,
            area=one.area,
            saturated_fraction=float(saturated[index]),
            split=bool(found.touching[index]),
            unlike=float(sought.likeness.unlike[index]),
        )
        for index, one in enumerate(whole)
    )
    contrast = "bright" if grid.sign > 0 else "dark"
    return Dots(rows, columns, method, contrast, dots, homography, noise, tuple(warnings))


def _told_unlike(likeness: Likeness, columns: int) -> Iterator[str]:
    """Warnings that name the dots which do not look like the others, and that none looks like a disc."""
    if likeness.hollow:
        yield (
            f"the dots are weaker in their middle, by {likeness.hollow:.0%} of their level, which is taken there: only "
            "`gray` does not hang on it"
        )
    unlike = likeness.unlike
    if not unlike.any():
        return
    which = np.flatnonzero(unlike)
    yield (
        f"{len(which)} of {len(unlike)} dots do not look like the others, by up to {unlike.max():.0%} of their level: "
        f"{named_dots(which, columns)}; a scratch, dirt, a highlight or a shadow on a dot moves its centre by more "
        "than is stated"
    )


def _slopes(found: Survey) -> Field:
    """Of the light at each dot; 0 where no smooth law is known."""
    return np.zeros((len(found.levels), 2)) if found.slopes is None else found.slopes


def _check_method(method: str, pitch: float | None, dot_diameter: float | None) -> None:
    if method not in METHODS:
        raise InputError(f'"{method}" is not a method', remedy=f"use one of: {', '.join(METHODS)}")
    if method == "conic" and (pitch is None or dot_diameter is None):
        raise InputError("the method conic needs the pitch and the dots' diameter")


def _checked(image: GrayImage, grid: tuple[int, int], lengths: tuple[float | None, float | None]) -> None:
    """Refuse what cannot work."""
    rows, columns = grid
    if rows < 2 or columns < 2 or rows * columns > LARGEST_GRID:
        raise InputError(
            f"a grid of {rows} x {columns} dots", remedy=f"2 rows and 2 columns at least, {LARGEST_GRID} dots at most"
        )
    for name, length in zip(("pitch", "dot diameter"), lengths, strict=True):
        if length is not None and not (math.isfinite(length) and length > 0):
            raise InputError(f"the {name} must be positive, not {length:g} m")
    pitch, diameter = lengths
    if pitch is not None and diameter is not None and diameter >= pitch:
        raise InputError(f"dots of {diameter:g} m on a pitch of {pitch:g} m overlap")
    lowest, highest = float(image.values.min()), float(image.values.max())
    if lowest == highest:
        raise InputError(f"has the gray level {lowest:g} everywhere", remedy="there are no dots to see")


def _whole(grid: Grid, found: Survey, centres: list[Centre | None], noise: float, method: Method) -> list[Centre]:
    good = present(grid, found, centres, noise)
    if not good.all():
        raise missing(
            project(grid.homography, grid.board),
            grid.shape,
            good,
            f" (by the method {method})" if method not in ("gray", "gray_threshold") else "",
        )
    return [one for one in centres if one is not None]


def _saturated(image: GrayImage, view: Window | None, saturation: float) -> float:
    if view is None:
        return 0.0
    left, top = (int(edge) for edge in view.origin)
    rows, columns = view.signal.shape
    gray = image.values[top : top + rows, left : left + columns]
    body = view.inside & (view.signal > 0.5 * view.level)
    return float((gray[body] >= saturation).mean()) if body.any() else 0.0


def _flattened(view: Window | None, slope: Field) -> Window | None:
    """Divide out how the light falls off across a dot."""
    if view is None:
        return None
    u = view.origin[0] + np.arange(view.signal.shape[1]) - view.place[0]
    v = view.origin[1] + np.arange(view.signal.shape[0]) - view.place[1]
    light = np.exp(np.clip(slope[0] * u[None, :] + slope[1] * v[:, None], -1.0, 1.0))
    return replace(view, signal=view.signal / light)
