"""Parts and spots of light so small in the image that rays may miss them, and what tells its error with them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.look.geometry import project
from radwrap.scene.patterns.marks import narrowest_of
from radwrap.scene.scene import Scene
from radwrap.scene.sources import half_width
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    MeshPart,
    PatternTarget,
    Polygon,
    RadFile,
    Sheet,
    Sphere,
    Target,
)

# Where the blur spans pixels a ray is spent on each half of a pixel at least.
_SMALL: Final = 0.5  # px
_MISSED: Final = (
    "rays may miss them, and the stated error with them; hold the image against --viewpoints with many --pixel-samples"
)


def small_parts(scene: Scene) -> Iterator[str]:
    """A line for each target that has a part narrower than half a pixel in the image.

    What is so small and far brighter than its surroundings may be met by no ray at all; replicates and certificate
    then agree on an image without it.
    """
    for target, pixel in zip(scene.targets, _pixels(scene), strict=True):
        width = narrowest(target)
        if width is not None and width < _SMALL * pixel:
            yield f'parts of "{target.name}" are {width / pixel:.2g} pixels wide in the image: {_MISSED}'


def small_spots(scene: Scene) -> Iterator[str]:
    """A line for each source whose beam lights less than half a pixel's width of a target."""
    pixels, centres = _pixels(scene), _centres(scene)
    told = set()
    for emitter in scene.emitters:
        name = emitter.source.split(".")[0]  # all LEDs of a ring are told as one
        if name in told:
            continue
        spots = 2 * math.tan(half_width(emitter.beam)) * np.linalg.norm(centres - emitter.position, axis=1)
        for first in np.flatnonzero(spots < _SMALL * pixels)[:1]:
            told.add(name)
            share, target = spots[first] / pixels[first], scene.targets[first]
            yield f'a beam of "{name}" lights {share:.2g} pixels of "{target.name}" in the image: {_MISSED}'


def _centres(scene: Scene) -> NDArray[np.float64]:
    return np.array([target.pose.position for target in scene.targets]).reshape(-1, 3)


def _pixels(scene: Scene) -> NDArray[np.float64]:
    """Width that a pixel sees where each target is [m], shape (targets,); 0 behind the camera, where none is small."""
    camera = scene.camera
    _, depths = project(camera, _centres(scene))
    pitch = max(camera.sensor.pixel_width, camera.sensor.pixel_height)
    widths: NDArray[np.float64] = np.maximum(depths, 0.0) * pitch / camera.image_distance
    return widths


def narrowest(target: Target) -> float | None:
    """Width of a target's narrowest part [m], seen face on; None where it is not known here."""
    match target:
        case DotBoard():
            return target.dot_diameter
        case PatternTarget():
            return min(map(narrowest_of, target.layout.marks()))
        case Sheet() | EdgeTarget():
            return min(target.width, target.height)
        case Disc() | Sphere():
            return target.diameter
        case Cylinder():
            return min(target.diameter, target.length)
        case Box():
            return min(target.size)
        case Polygon():
            return float(np.ptp(np.asarray(target.vertices), axis=0).min())
        case MeshPart() | RadFile():
            return None
