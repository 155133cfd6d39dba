"""Parts so small in the image that rays may miss them, and what tells the image's error with them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from radwrap.scene.look.geometry import project
from radwrap.scene.scene import Scene
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    MeshPart,
    Polygon,
    RadFile,
    Sheet,
    Sphere,
    Target,
)

# Where the blur spans pixels a ray is spent on each half of a pixel at least.
_SMALL: Final = 0.5  # px


def small_parts(scene: Scene) -> Iterator[str]:
    """A line for each target that has a part narrower than half a pixel in the image.

    What is so small and far brighter than its surroundings may be met by no ray at all; replicates and certificate
    then agree on an image without it.
    """
    camera = scene.camera
    for target in scene.targets:
        width = narrowest(target)
        _, depths = project(camera, np.array([target.pose.position]))
        depth = float(depths[0])
        if width is None or depth <= 0:
            continue
        pitch = max(camera.sensor.pixel_width, camera.sensor.pixel_height)
        pixels = width * camera.image_distance / depth / pitch
        if pixels < _SMALL:
            yield (
                f'parts of "{target.name}" are {pixels:.2g} pixels wide in the image: rays may miss them, and the '
                "stated error with them; hold the image against --viewpoints with many --pixel-samples"
            )


def narrowest(target: Target) -> float | None:
    """Width of a target's narrowest part [m], seen face on; None where it is not known here."""
    match target:
        case DotBoard():
            return target.dot_diameter
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
