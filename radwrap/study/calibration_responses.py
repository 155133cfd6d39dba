"""How well a camera would be calibrated: what a detector misses in this image, and what that leaves of many views."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from radwrap.calibrate.projection_uncertainty import uncertainty_over_image
from radwrap.calibrate.several_views import ViewsCalibration, calibrate_views
from radwrap.calibrate.views import MODELS
from radwrap.errors import InputError
from radwrap.frames import points_to_local
from radwrap.images import GrayImage
from radwrap.imaging.pattern_truth import true_points
from radwrap.scene.scene import Scene
from radwrap.scene.targets import PatternTarget
from radwrap.study.planned_views import planned_views
from radwrap.study.response_kind import Kind, Options
from radwrap.study.seen import Answer, Seen, again_by_number
from radwrap.study.target_points import DETECTORS, detector_of, finder_of
from radwrap.units import ANGLE, LENGTH, PIXEL, parse_quantity

_FEWEST_VIEWS, _MOST_VIEWS = 3, 500
_MOST_TILT: Final = math.radians(80)
_TRIED: Final = 8  # views, before the first ray
TARGET, INFINITY = "target", "infinity"
_VIEWS: Final = 20
_TILT: Final = math.radians(30)


def _target(scene: Scene, options: Options) -> PatternTarget:
    name = options.get("target")
    found = [one for one in scene.targets if isinstance(one, PatternTarget) and name in (None, one.name)]
    if not found:
        what = f'"{name}" that calibrates' if name else "chessboard, charuco or circles"
        raise InputError(f"the scene has no {what}", remedy="add it to [[targets]]")
    detector_of(found[0].layout, options.get("detector"), target=found[0].name, where="detector")
    return found[0]


def _point_error(seen: Seen, options: Options) -> Answer:
    return again_by_number(seen, lambda copy, image: _rms(seen, options, copy, image))


def _rms(seen: Seen, options: Options, copy: int, image: GrayImage) -> float:
    """Rms distance of found points from the images of the points themselves, which a calibration takes them for."""
    target = _target(seen.scene, options)
    detector = detector_of(target.layout, options.get("detector"), target=target.name, where="detector")
    place = (copy, target.name, detector)
    if place not in seen.points:
        places, shown = finder_of(target.layout, detector)(image)
        true = true_points(seen.scene.camera, target, places).image
        seen.points[place] = math.sqrt(float(((shown - true) ** 2).sum(axis=1).mean()))
    return seen.points[place]


def _calibrated(seen: Seen, options: Options) -> ViewsCalibration:
    """A calibration by views with exact points whose noise is given as 1 px: how much of it is left."""
    place = (_target(seen.scene, options).name, _views(options), _tilt(options), options.get("model", "brown"))
    if place not in seen.planned:
        seen.planned[place] = _planned(seen.scene, options, _views(options))
    return seen.planned[place]


def _planned(scene: Scene, options: Options, count: int) -> ViewsCalibration:
    sensor = scene.camera.sensor
    views = planned_views(scene.camera, _target(scene, options), count, _tilt(options))
    return calibrate_views(views, (sensor.columns, sensor.rows), model=options.get("model", "brown"), noise=1.0)


def _projection_sigma(seen: Seen, options: Options) -> Answer:
    sigma = uncertainty_over_image(_calibrated(seen, options), _distance(seen.scene, options)).sigma
    return _times_noise(seen, options, float(np.max(sigma)))


def _focal_length_sigma(seen: Seen, options: Options) -> Answer:
    """Of fx, as a length: what a data sheet is held against."""
    return _times_noise(seen, options, _calibrated(seen, options).sigma["fx"] * seen.scene.camera.sensor.pixel_width)


def _times_noise(seen: Seen, options: Options, of_one: float) -> Answer:
    """Errors of the first order grow with the noise of the points, which is given or what the detector shows here."""
    if "noise" in options:
        return Answer(of_one * _noise(options), 0.0)
    # A distance has two coordinates, each with its own error.
    return again_by_number(seen, lambda copy, image: of_one * _rms(seen, options, copy, image) / math.sqrt(2))


def _views(options: Options) -> int:
    count = options.get("views", _VIEWS)
    if count != int(count) or not _FEWEST_VIEWS <= count <= _MOST_VIEWS:
        raise InputError(f"views must be a whole number from {_FEWEST_VIEWS} to {_MOST_VIEWS}, not {count!r}")
    return int(count)


def _tilt(options: Options) -> float:
    tilt = parse_quantity(options["tilt"], ANGLE) if "tilt" in options else _TILT
    if not 0 <= tilt <= _MOST_TILT:
        raise InputError(f"tilt must be from 0 to {math.degrees(_MOST_TILT):.0f} deg, not {options['tilt']}")
    return tilt


def _noise(options: Options) -> float:
    noise = parse_quantity(options["noise"], PIXEL)
    if not noise > 0:
        raise InputError(f"noise must be above 0 px, not {options['noise']}")
    return noise


def _distance(scene: Scene, options: Options) -> float:
    at = options.get("at", TARGET)
    if at == INFINITY:
        return math.inf
    if at != TARGET:
        distance = parse_quantity(at, LENGTH)
        if not distance > 0:
            raise InputError(f"at must be above 0 m, not {at}")
        return distance
    place = points_to_local(scene.camera.pose, np.array([_target(scene, options).pose.position]))
    return float(np.linalg.norm(place))


def _check_point(scene: Scene, options: Options) -> None:
    _target(scene, options)


def _check_views(scene: Scene, options: Options) -> None:
    if "noise" in options:
        _noise(options)
        if "detector" in options:
            raise InputError("detector and noise exclude each other", remedy="leave out one of them")
    _distance(scene, options)
    # What cannot be told from few views so tilted cannot be told from many.
    _planned(scene, options, min(_views(options), _TRIED))


_POINT: Final = {"target": str, "detector": DETECTORS}
_PLANNED: Final = {**_POINT, "views": float, "tilt": str, "noise": str, "model": tuple(MODELS)}
CALIBRATIONS: Final = {
    "point_error": Kind(
        "rms distance of a calibration target's points, as a detector finds them, from the truth",
        PIXEL,
        "px",
        _POINT,
        _point_error,
        check=_check_point,
    ),
    "projection_sigma": Kind(
        "standard error of the projection, at its worst in the image, of a calibration from several views",
        PIXEL,
        "px",
        {**_PLANNED, "at": str},
        _projection_sigma,
        check=_check_views,
    ),
    "focal_length_sigma": Kind(
        "standard error of the focal length of a calibration from several views",
        LENGTH,
        "mm",
        _PLANNED,
        _focal_length_sigma,
        check=_check_views,
    ),
}
