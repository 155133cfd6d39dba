"""Gauges as responses of a study: calipers are placed by each run's own scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.imaging.response.noise import noise_variance, without_pattern
from radwrap.imaging.response.sensor import radiant_exposure_of
from radwrap.measure.gauges import (
    WAYS,
    Box,
    Circle,
    Region,
    Width,
    contrast_of,
    measure_circle,
    measure_region,
    measure_uniformity,
    measure_width,
)
from radwrap.scene.scene import Scene
from radwrap.study.placed_calipers import (
    AXES,
    RIMS,
    RimName,
    RimPlace,
    aspect_of,
    named_face,
    plane_of,
    region_of,
    response_of,
    rim_caliper,
    rim_places,
    side_warnings,
    width_caliper,
)
from radwrap.study.response_kind import BOX, Kind, Options
from radwrap.study.seen import Answer, Seen, again, again_with_warnings, spread, tried
from radwrap.units import LENGTH

Array = NDArray[np.float64]


def _diameter(seen: Seen, options: Options, true: float = 0.0) -> Answer:
    camera = seen.scene.camera
    face = named_face(seen.scene, options["target"])
    places = rim_places(camera, face, aspect_of(camera))
    name = _rim(places, options)
    caliper, plane, response = rim_caliper(places, name), plane_of(camera, face), response_of(camera)
    beside = next((rim_caliper(places, other) for other in places if other != name), None)

    def circle(image: GrayImage) -> Circle:
        found = measure_circle(
            image,
            caliper,
            response=response,
            plane=plane,
            beside=beside,
            way=options.get("edge", "model"),
            pixel_aspect=aspect_of(camera),
        )
        side = side_warnings(places[name], found.diameter, found.diameter_sigma)
        return replace(found, warnings=(*found.warnings, *side))

    return again_with_warnings(seen, circle, lambda found: float(found.diameter) - true)


def _rim(places: Mapping[RimName, RimPlace], options: Options) -> RimName:
    name: RimName = options.get("rim", "outer")
    if name not in places:
        raise InputError("has no inner rim on the face that it shows")
    return name


def _diameter_error(seen: Seen, options: Options) -> Answer:
    camera = seen.scene.camera
    places = rim_places(camera, named_face(seen.scene, options["target"]), aspect_of(camera))
    return _diameter(seen, options, places[_rim(places, options)].true_diameter or 0.0)


def _has_rim(scene: Scene, options: Options) -> None:
    _rim(rim_places(scene.camera, named_face(scene, options["target"]), aspect_of(scene.camera)), options)


def _width(seen: Seen, options: Options, *, less_true: bool = False) -> Answer:
    camera = seen.scene.camera
    face = named_face(seen.scene, options["target"])
    caliper, true = width_caliper(camera, face, options.get("across", "x"), aspect_of(camera))
    plane, response = plane_of(camera, face), response_of(camera)

    def width(image: GrayImage) -> Width:
        return measure_width(
            image,
            caliper,
            response=response,
            plane=plane,
            way=options.get("edge", "model"),
            pixel_aspect=aspect_of(camera),
        )

    return again_with_warnings(seen, width, lambda found: _known(found) - (true if less_true else 0.0))


def _known(found: Width) -> float:
    """The width, or an error that says why it is not known."""
    if found.width is None:
        raise InputError(found.warnings[-1], where="the image")
    return found.width


def _width_error(seen: Seen, options: Options) -> Answer:
    return _width(seen, options, less_true=True)


def _has_width(scene: Scene, options: Options) -> None:
    camera = scene.camera
    width_caliper(camera, named_face(scene, options["target"]), options.get("across", "x"), aspect_of(camera))


def _box(seen: Seen, options: Options, name: str = "region") -> Box:
    rows, columns = seen.image.values.shape
    asked = options.get(name, (0, 0, columns - 1, rows - 1))
    return region_of(seen.scene, asked) if isinstance(asked, str) else Box(*asked)


def _has_regions(scene: Scene, options: Options) -> None:
    for name in ("region", "against"):
        if isinstance(options.get(name), str):
            region_of(scene, options[name])


@dataclass(frozen=True, slots=True)
class _Regions:
    """Regions of an image by the names of their options."""

    by_name: Mapping[str, Region]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of which of them the mean is too low."""
        return tuple(
            f"{region.saturated} of {region.pixels} pixels of `{name}` are saturated, so its mean is too low"
            for name, region in self.by_name.items()
            if region.saturated
        )


def _regions(seen: Seen, options: Options, *names: str) -> Callable[[GrayImage], _Regions]:
    """Finds regions, whose pixels are full where the scene's camera is."""
    saturation = seen.scene.camera.sensor.saturation_gray
    boxes = {name: _box(seen, options, name) for name in names}
    return lambda image: _Regions(
        {name: measure_region(image, box, saturation=saturation) for name, box in boxes.items()}
    )


def _region_mean(seen: Seen, options: Options) -> Answer:
    return again_with_warnings(seen, _regions(seen, options, "region"), lambda found: found.by_name["region"].mean)


def _region_contrast(seen: Seen, options: Options) -> Answer:
    def michelson(found: _Regions) -> float:
        return contrast_of(*found.by_name.values(), dark=seen.scene.camera.sensor.dark_gray).michelson

    return again_with_warnings(seen, _regions(seen, options, "region", "against"), michelson)


def _contrast_to_noise(seen: Seen, options: Options) -> Answer:
    """Of one frame: the predicted image has no noise, the sensor's model has.

    Levels are those before rounding: in a frame its noise comes before the converter, and a region's mean is then no
    whole level.
    """
    sensor = seen.scene.camera.sensor
    regions_of = _regions(seen, options, "region", "against")

    def ratio(gray: Array) -> float:
        regions = regions_of(GrayImage(gray, seen.image.bit_depth)).by_name.values()
        if any(region.saturated for region in regions):
            raise InputError("is saturated in part, where there is no noise to compare with")
        means = np.array([region.mean for region in regions])
        # Noise may take the mean of a dark region below the dark level, where it is the noise of no light.
        lit = radiant_exposure_of(np.maximum(means, sensor.dark_gray), sensor)
        variance = float(noise_variance(lit, without_pattern(sensor)).sum())
        return abs(float(means[0] - means[1])) / math.sqrt(variance)

    return spread(ratio(seen.gray), [(copy.cause, tried(ratio, copy.gray)) for copy in seen.changed()])


def _is_linear(scene: Scene, options: Options) -> None:
    _has_regions(scene, options)
    if scene.camera.sensor.linear is None:
        raise InputError("needs the noise of a linear camera", remedy='give the sensor `model = "linear"`')


def _uniformity(name: str) -> Callable[[Seen, Options], Answer]:
    def answer(seen: Seen, options: Options) -> Answer:
        response, box = response_of(seen.scene.camera), _box(seen, options)
        return again(seen, lambda image: float(getattr(measure_uniformity(image, response=response, box=box), name)))

    return answer


_CIRCLE: Final = {"target": str, "rim": RIMS, "edge": WAYS}
_SIDES: Final = {"target": str, "across": AXES, "edge": WAYS}
_BOTH: Final = {"region": BOX, "against": BOX}
GAUGES: Final[Mapping[str, Kind]] = {
    "diameter": Kind(
        "diameter of a target's rim, in the plane of its face",
        LENGTH,
        "mm",
        _CIRCLE,
        _diameter,
        needed=("target",),
        check=_has_rim,
    ),
    "diameter_error": Kind(
        "measured less true diameter of a target's rim",
        LENGTH,
        "mm",
        _CIRCLE,
        _diameter_error,
        needed=("target",),
        check=_has_rim,
    ),
    "width": Kind(
        "width of a target's rectangle, in its plane",
        LENGTH,
        "mm",
        _SIDES,
        _width,
        needed=("target",),
        check=_has_width,
    ),
    "width_error": Kind(
        "measured less true width of a target's rectangle",
        LENGTH,
        "mm",
        _SIDES,
        _width_error,
        needed=("target",),
        check=_has_width,
    ),
    "region_mean": Kind("mean gray level of a region", None, "", {"region": BOX}, _region_mean, check=_has_regions),
    "region_contrast": Kind(
        "Michelson contrast of two regions, above dark",
        None,
        "",
        _BOTH,
        _region_contrast,
        needed=("region", "against"),
        check=_has_regions,
    ),
    "contrast_to_noise": Kind(
        "contrast of two regions over one frame's temporal noise",
        None,
        "",
        _BOTH,
        _contrast_to_noise,
        needed=("region", "against"),
        check=_is_linear,
    ),
    "uniformity": Kind(
        "1 - sd/mean of light over a region", None, "", {"region": BOX}, _uniformity("by_deviation"), check=_has_regions
    ),
    "unevenness": Kind(
        "(max - min)/(max + min) of light over a region",
        None,
        "",
        {"region": BOX},
        _uniformity("by_extremes"),
        check=_has_regions,
    ),
}
