"""What a study reads from each image: a number with its error bar.

The error bar carries the image's error (see image_error.py): by measuring
the image again with errors as its replicates show them. Where an image has no
replicates, and measuring takes long (dots), by the measurement's own
covariance, scaled to the certified error.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.tsai import SOLVERS, CameraCalibration, calibrate_camera
from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.response.noise import linear_of
from radwrap.imaging.truth import dot_places, edge_line
from radwrap.measure.dots import METHODS, Dots, measured_dots, seek_dots
from radwrap.measure.edges import Edge, measure_edge
from radwrap.measure.parts import find_parts
from radwrap.nearest import did_you_mean
from radwrap.random_streams import Studying, generator
from radwrap.scene.scene import Scene
from radwrap.scene.targets import DotBoard, EdgeTarget
from radwrap.study.calibration_responses import CALIBRATIONS
from radwrap.study.gauge_responses import GAUGES
from radwrap.study.image_error import Cause, ImageError
from radwrap.study.repeatability import repeatability
from radwrap.study.response_kind import BOX, Kind, Options
from radwrap.study.seen import Answer, Seen, again, again_by_number, spread, tried
from radwrap.study.user_function import UserFunction
from radwrap.study.user_response import user_answer
from radwrap.units import ANGLE, LENGTH, PIXEL, Dimension

Array = NDArray[np.float64]
_T = TypeVar("_T", DotBoard, EdgeTarget)

_DRAWS: Final = 24  # of dot centres; the scatter of so many is known to 15 %
_FEWEST_DRAWS: Final = 4
_DOT_REACH: Final = 1.3  # of a dot's radius: where the errors lie that move its centre
_CORNERS: Final = 4  # numbers of a box
REPEATABILITY: Final = "_repeatability"  # behind the name of what scatters
SENSOR: Final = "sensor"  # as an option: what the scene's sensor has


@dataclass(frozen=True, slots=True)
class Response:
    """A number that is read from each image.

    Attributes
    ----------
    name : str
        Column of the table.
    kind : str
        One of `KINDS`.
    unit : str
        In which it is told; empty for a bare number.
    options : Mapping
        Of the measurement.
    table : str
        Name of its table in the design, where that is another.
    frames : int
        How many frames with noise are measured too; 0 for none.
    repeatability : bool
        Whether it is the scatter over these frames, not the value itself.
    user : UserFunction, optional
        The user's own, in place of one of `KINDS`; the response is that of its answers which has its name.
    """

    name: str
    kind: str
    unit: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    table: str = ""
    frames: int = 0
    repeatability: bool = False
    user: UserFunction | None = None

    @property
    def column(self) -> str:
        """Heading of its column."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def error_column(self) -> str:
        """Heading of its error's column."""
        return f"{self.name}_error [{self.unit}]" if self.unit else f"{self.name}_error"

    @property
    def scale(self) -> float:
        """Size of its unit in SI."""
        return 1.0 if self.dimension is None or not self.unit else self.dimension.units[self.unit]

    @property
    def dimension(self) -> Dimension | None:
        """Of its value; None of a bare number, and of what the user's own code gives."""
        return None if self.user is not None else KINDS[self.kind].dimension

    @property
    def what(self) -> str:
        """For people."""
        own = self.kind if self.user is not None else KINDS[self.kind].what
        return f"standard deviation over {self.frames} frames: {own}" if self.repeatability else own

    @property
    def told_in(self) -> str:
        """Name of its table in the design."""
        return self.table or self.name

    @property
    def copies(self) -> bool:
        """Whether its error is found on copies of the image."""
        return self.user is not None or KINDS[self.kind].copies


def check_options(kind: str, options: Options, where: str) -> None:
    """Refuse options that the measurement does not have.

    Raises
    ------
    InputError
        Naming the option.
    """
    known = KINDS[kind].options
    for name, value in options.items():
        if name not in known:
            near = did_you_mean(name, known) or f"known are {', '.join(known) or 'none'}"
            raise InputError(f"unknown option of {kind}", where=f"{where}.{name}", remedy=near)
        allowed = known[name]
        if isinstance(allowed, tuple):
            if value not in allowed:
                raise InputError(f"{value!r} is not one of {', '.join(allowed)}", where=f"{where}.{name}")
        elif allowed is str:
            if not isinstance(value, str):
                raise InputError("must be a name", where=f"{where}.{name}")
        elif allowed == BOX:
            if not isinstance(value, str) and not (
                isinstance(value, list | tuple) and len(value) == _CORNERS and all(type(one) is int for one in value)
            ):
                raise InputError(
                    "must be four whole numbers, first column and row, last column and row, or a target's name",
                    where=f"{where}.{name}",
                )
        elif (allowed is float or value != SENSOR) and not _is_number(value):
            also = "" if allowed is float else f' or "{SENSOR}"'
            raise InputError(f"must be a number{also}, not {value!r}", where=f"{where}.{name}")
        if name == "draws" and not (isinstance(value, int) and value >= _FEWEST_DRAWS):
            raise InputError(f"must be a whole number, {_FEWEST_DRAWS} at least", where=f"{where}.{name}")


def _is_number(value: Any) -> bool:
    # In this order, as an integer may be too large to be asked whether it is finite.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def check_response(response: Response, scene: Scene, where: str) -> None:
    """Refuse a measurement of something that the scene does not hold.

    Raises
    ------
    InputError
        If there is no board or no edge, or frames are asked for of a camera without noise.
    """
    if response.frames:
        try:
            linear_of(scene.camera.sensor)
        except InputError as error:
            raise InputError(error.what, where=f"{where}.frames", remedy=error.remedy) from error
    if response.user is None:
        _check_target(response.kind, scene, response.options, where)


def _check_target(kind: str, scene: Scene, options: Options, where: str) -> None:
    try:
        for name in KINDS[kind].needed:
            if name not in options:
                raise InputError(f"needs the option {name}", remedy=f'write {name} = ... below `measure = "{kind}"`')
        check = KINDS[kind].check
        if check is not None:
            check(scene, options)
        if "board" in KINDS[kind].options:
            _target(scene, DotBoard, options.get("board"))
        elif kind == "edge_error":
            _target(scene, EdgeTarget, None)
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy) from error


def answer(response: Response, seen: Seen) -> Answer:
    """Measure.

    Raises
    ------
    InputError
        If the image does not show it.
    """
    if response.user is not None:
        key = response.name.removesuffix(REPEATABILITY) if response.repeatability else response.name
        found = user_answer(seen, response.user, key, response.frames, repeatability=response.repeatability)
    elif response.repeatability:
        found = repeatability(seen, KINDS[response.kind], response.options, response.frames)
    else:
        found = KINDS[response.kind].answer(seen, response.options)
    if not (math.isfinite(found.value) and math.isfinite(found.error)):
        raise InputError("is not finite", where=response.name)
    return found


# ------------------------------------------------------------------------------------------------------------- options


def _level(seen: Seen, options: Options, name: str) -> float | None:
    value = options.get(name)
    if value != SENSOR:
        return None if value is None else float(value)
    sensor = seen.scene.camera.sensor
    return {"dark": sensor.dark_gray, "gamma": sensor.gamma, "saturation": sensor.saturation_gray}[name]


def _aspect(seen: Seen) -> float:
    sensor = seen.scene.camera.sensor
    return sensor.pixel_height / sensor.pixel_width


def _target(scene: Scene, kind: type[_T], name: str | None) -> _T:
    found = [target for target in scene.targets if isinstance(target, kind) and name in (None, target.name)]
    if not found:
        what = "board of dots" if issubclass(kind, DotBoard) else "edge"
        raise InputError(f"the scene has no {what}" + (f' "{name}"' if name else ""), remedy="add it to [[targets]]")
    return found[0]


# ---------------------------------------------------------------------------------------------------------------- dots


def _dots(seen: Seen, options: Options, copy: int = 0, image: GrayImage | None = None) -> tuple[DotBoard, Dots]:
    """Dots of the image, or of a copy of it, which is known by its number from 1."""
    board = _target(seen.scene, DotBoard, options.get("board"))
    method, dark = options.get("method", "gray"), _level(seen, options, "dark")
    place = (copy, board.name, dark)
    if place not in seen.sought:
        seen.sought[place] = seek_dots(
            seen.image if image is None else image,
            board.rows,
            board.columns,
            dark=dark,
            pitch=board.pitch,
            dot_diameter=board.dot_diameter,
            saturation=seen.scene.camera.sensor.saturation_gray,
            least_noise=0.0 if seen.scene.camera.sensor.rounding else seen.error.rms,
            near=seen.sought.get((0, board.name, dark)),
        )
    return board, measured_dots(seen.sought[place], method)


def centre_covariances(dots: Dots, error: ImageError) -> Array:
    """Covariance of each centre by the image's error, shape (n, 2, 2) [px^2].

    That of the measurement, which white noise of `dots.noise` in every pixel would cause, times the variance of the
    image's error around the dot over that noise, times the number of pixels whose errors are as one.
    """
    if not error.rms:
        return np.zeros((len(dots.dots), 2, 2))
    covariances = []
    for dot in dots.dots:
        reach = _DOT_REACH * math.sqrt(dot.area / math.pi)
        share = error.near(dot.u, dot.v, reach) / dots.noise**2 * min(error.block, dot.area)
        covariances.append(dot.covariance * share)
    return np.array(covariances)


def _drawn_centres(dots: Dots, error: ImageError, draws: int) -> Array:
    """Centres as they may be, shape (draws, n, 2) [px]."""
    random = generator(Studying.DOT_CENTRES, len(dots.dots))
    roots = np.linalg.cholesky(centre_covariances(dots, error) + 1e-30 * np.eye(2))
    drawn: Array = dots.centres + np.einsum("nij,dnj->dni", roots, random.standard_normal((draws, len(roots), 2)))
    return drawn


def _focal_length(seen: Seen, options: Options) -> Answer:
    board, dots = _dots(seen, options)
    camera = seen.scene.camera
    places = {(row, column): centre for row, column, centre in board.dot_centres()}
    points = np.array([places[dot.row, dot.column] for dot in dots.dots])

    def calibrated(centres: Array, near: CameraCalibration | None = None) -> CameraCalibration:
        return calibrate_camera(
            points,
            centres,
            pixel_width=camera.sensor.pixel_width,
            pixel_height=camera.sensor.pixel_height,
            centre=camera.principal_point,
            solver=options.get("solver", "tsai"),
            near=near,
        )

    found = calibrated(dots.centres)
    return _dots_again(seen, options, found.focal_length, lambda centres: calibrated(centres, found).focal_length)


def _dots_again(seen: Seen, options: Options, value: float, measure: Callable[[Array], float]) -> Answer:
    """The value, with the error of what is measured on the image's dots: of copies, or drawn where there are none."""
    number = options.get("draws", _DRAWS)
    if seen.replicates is None:
        drawn = _drawn_centres(_dots(seen, options)[1], seen.error, number)
        return spread(value, [("model", tried(measure, centres)) for centres in drawn])
    found: list[tuple[Cause, float]] = []
    for k, copy in enumerate(seen.changed(), 1):
        if sum(cause == copy.cause for cause, _ in found) < number:
            found.append((copy.cause, tried(partial(_of_copy, seen, options, k, measure), copy.image)))
    return spread(value, found)


def _of_copy(seen: Seen, options: Options, copy: int, measure: Callable[[Array], float], image: GrayImage) -> float:
    centres = _dots(seen, options, copy, image)[1].centres
    if len(centres) != len(_dots(seen, options)[1].centres):
        raise InputError("shows other dots")
    return measure(centres)


def _dot_error(seen: Seen, options: Options) -> Answer:
    board, dots = _dots(seen, options)
    places = {(dot.row, dot.column): (dot.u, dot.v) for dot in dot_places(seen.scene.camera, board)}
    true = np.array([places[dot.row, dot.column] for dot in dots.dots])

    def rms(centres: Array) -> float:
        return math.sqrt(float(((centres - true) ** 2).sum(axis=1).mean()))

    return _dots_again(seen, options, rms(dots.centres), rms)


# ------------------------------------------------------------------------------------------------------ edges and parts


def _edge(seen: Seen, options: Options, copy: int, image: GrayImage) -> Edge:
    """The edge of the image, or of a copy of it: several responses measure the same."""
    place = (copy, _level(seen, options, "dark"), _level(seen, options, "gamma"))
    if place not in seen.edges:
        seen.edges[place] = measure_edge(
            image,
            dark=place[1],
            gamma=place[2],
            pixel_aspect=_aspect(seen),
            saturation=seen.scene.camera.sensor.saturation_gray,
        )
    return seen.edges[place]


def _edge_position(seen: Seen, options: Options) -> Answer:
    return again_by_number(seen, lambda copy, image: _edge(seen, options, copy, image).offset)


def _edge_blur(seen: Seen, options: Options) -> Answer:
    return again_by_number(seen, lambda copy, image: _edge(seen, options, copy, image).radius)


def _edge_error(seen: Seen, options: Options) -> Answer:
    target = _target(seen.scene, EdgeTarget, None)
    line = edge_line(seen.scene.camera, target)
    if line is None:
        raise InputError("the edge lies behind the camera")

    def off(copy: int, image: GrayImage) -> float:
        return float(line.normal @ np.asarray(_edge(seen, options, copy, image).centre)) - line.offset

    return again_by_number(seen, off)


def _part_orientation(seen: Seen, options: Options) -> Answer:
    given = {name: options[name] for name in ("threshold", "min_area") if name in options}
    dark, gamma = _level(seen, options, "dark"), _level(seen, options, "gamma")

    def orientation(image: GrayImage) -> float:
        found = find_parts(image, dark=dark, gamma=1.0 if gamma is None else gamma, pixel_aspect=_aspect(seen), **given)
        largest = max(found.parts, key=lambda part: part.area)
        if largest.orientation_ambiguous:
            raise InputError("the largest part has no axis")
        return largest.orientation

    value = orientation(seen.image)
    # An axis has no direction: of two answers half a turn apart the nearer one counts.
    return again(seen, lambda image: value + (orientation(image) - value + math.pi / 2) % math.pi - math.pi / 2)


# ---------------------------------------------------------------------------------------------------------------- gray


def _mean_gray(seen: Seen, _: Options) -> Answer:
    """Without replicates: the mean of an error is at most its rms, whatever it looks like."""
    if seen.replicates is not None:
        return again(seen, lambda image: float(image.values.mean()))
    return Answer(float(seen.image.values.mean()), seen.error.rms)


def _peak_gray(seen: Seen, _: Options) -> Answer:
    return again(seen, lambda image: float(image.values.max()))


def contrast(image: GrayImage) -> float:
    """(bright - dark)/(bright + dark) of the 99th and 1st percentile of the gray levels."""
    dark, bright = np.percentile(image.values, (1, 99))
    return float((bright - dark) / (bright + dark)) if bright + dark > 0 else 0.0


def _contrast(seen: Seen, _: Options) -> Answer:
    return again(seen, contrast)


def _saturated_share(seen: Seen, _: Options) -> Answer:
    saturation = seen.scene.camera.sensor.saturation_gray
    # Not of rounded gray levels: rounding may reach a saturation that the pixel does not.
    value = float((seen.gray >= saturation).mean())
    return spread(value, [(copy.cause, float((copy.gray >= saturation).mean())) for copy in seen.changed()])


_DOTS: Final = {"method": METHODS, "dark": "gray", "board": str, "draws": float}
_EDGE: Final = {"dark": "gray", "gamma": "gray"}
KINDS: Final[Mapping[str, Kind]] = {
    "focal_length": Kind(
        "focal length by calibration on a board of dots",
        LENGTH,
        "mm",
        {**_DOTS, "solver": SOLVERS},
        _focal_length,
        copies=False,
    ),
    "dot_error": Kind("rms distance of dot centres from the truth", PIXEL, "px", _DOTS, _dot_error, copies=False),
    "edge_position": Kind("distance of the edge from the first pixel's centre", PIXEL, "px", _EDGE, _edge_position),
    "edge_error": Kind("distance of the measured from the true edge", PIXEL, "px", _EDGE, _edge_error),
    "edge_blur": Kind("radius of the edge's blur", PIXEL, "px", _EDGE, _edge_blur),
    "part_orientation": Kind(
        "orientation of the largest part",
        ANGLE,
        "deg",
        {"dark": "gray", "gamma": "gray", "threshold": float, "min_area": float},
        _part_orientation,
        period=math.pi,
    ),
    "mean_gray": Kind("mean gray level", None, "", {}, _mean_gray, copies=False),
    "peak_gray": Kind("gray level of the brightest pixel", None, "", {}, _peak_gray),
    "contrast": Kind("Michelson contrast of 99th and 1st percentile", None, "", {}, _contrast),
    "saturated_share": Kind("share of saturated pixels", None, "", {}, _saturated_share),
    **GAUGES,
    **CALIBRATIONS,
}


def unit_of(kind: str, unit: str | None, where: str) -> str:
    """The unit in which a response is told.

    Raises
    ------
    InputError
        If it is none of that quantity.
    """
    dimension = KINDS[kind].dimension
    if unit is None:
        return KINDS[kind].unit
    if dimension is None:
        raise InputError(f"{kind} has no unit", where=where, remedy="leave it out")
    if not isinstance(unit, str) or unit not in dimension.units:
        raise InputError(
            f'"{unit}" is not a unit of {dimension.name}',
            where=where,
            remedy=f"use one of: {', '.join(dimension.units)}",
        )
    return unit
