"""Where a tracer's text has its origin, and its units.

The scene is traced in the camera's neighbourhood, wherever its user put the
origin of the world: a frozen octree keeps 31 bits of a coordinate, so 13 m
from the origin the places of surfaces would be off by 6 nm, and in a unit of
1 um by more than the 1e-6 units that Radiance takes for nothing.

Lengths are in mm and radiances in W m^-2 sr^-1 unless a scene needs another
unit. Not in m: Radiance takes a point for inside a polygon where the product
of a side's length and the point's distance from it is below 1e-6 square units,
which makes a turned sheet of 5 mm 0.2 mm wider on each side, if written in m.
It also loses radii below 1e-6 units, and light below 1e-6.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.frames import Vector
from radwrap.scene.scene import Scene
from radwrap.scene.targets import DiscShape, MeshShape, PolygonShape, SphereShape, TubeShape

_MILLIMETRE: Final = 1e-3
# Polygon sides of at least 1 unit keep a polygon's border within 1e-6 units, and radii stay far from 1e-6 units.
_SHORTEST_SIDE: Final = 1.0
_SMALLEST_RADIUS: Final = 1e-3
# Radiances outside this range are scaled by a power of ten for the tracer.
_RADIANCE_RANGE: Final = (1.0, 1e6)
# In the text's unit: below, Radiance takes a source for dark (its limit is 1e-6), above, it overflows (1e39).
_DARKEST: Final = 1e-5
_BRIGHTEST: Final = 1e30


@dataclass(frozen=True, slots=True)
class TextFrame:
    """What the text's numbers mean in the world.

    Attributes
    ----------
    length : float
        One unit of length in the text [m].
    radiance : float
        One unit of radiance in the text [W m^-2 sr^-1].
    origin : tuple of float
        Place of the text's origin in the world [m]; its axes are the world's.
    """

    length: float = _MILLIMETRE
    radiance: float = 1.0
    origin: Vector = (0.0, 0.0, 0.0)

    @property
    def units(self) -> int:
        """Units of length in a metre: a whole number, so that 12.5 mm stays 12.5."""
        return round(1 / self.length)

    def point(self, place: Vector) -> Vector:
        """A point of the world [m] in the text."""
        x, y, z = (value - start for value, start in zip(place, self.origin, strict=True))
        return x * self.units, y * self.units, z * self.units

    def points(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the world, shape (n, 3) [m], in the text."""
        placed: NDArray[np.float64] = (places - np.asarray(self.origin)) * self.units
        return placed

    @property
    def in_millimetres(self) -> bool:
        """Whether the unit of length is the usual one."""
        return self.length == _MILLIMETRE


def traced_frame(scene: Scene) -> TextFrame:
    """The frame in which a scene is traced: its origin is the camera's place.

    Raises
    ------
    InputError
        If the sources differ by more than Radiance can hold.
    """
    return replace(users_frame(scene), origin=scene.camera.pose.position)


def users_frame(scene: Scene) -> TextFrame:
    """The frame of files for other programs, which keeps the user's origin; errors as `traced_frame`."""
    length = _MILLIMETRE
    for size, least in _sizes(scene):
        while size < least * length:
            length /= 1000
    return TextFrame(length, _radiance_unit(scene))


def _radiance_unit(scene: Scene) -> float:
    radiances = [emitter.radiance for emitter in scene.emitters if emitter.radiance > 0]
    if not radiances:
        return 1.0
    brightest, darkest = max(radiances), min(radiances)
    low, high = _RADIANCE_RANGE
    unit = 1.0
    if not scene.included and not low <= brightest <= high:
        unit = 10.0 ** (math.floor(math.log10(brightest)) - 3)
    if darkest / unit < _DARKEST or brightest / unit > _BRIGHTEST:
        if darkest == brightest:
            raise InputError(
                f"sources of {darkest:g} W/m^2/sr cannot be traced beside an included Radiance file, whose light "
                "has no other unit",
                where=f"{scene.origin}: sources",
                remedy=f"bring them between {_DARKEST:g} and {_BRIGHTEST:g} W/m^2/sr, or leave the file out",
            )
        raise InputError(
            f"sources from {darkest:g} to {brightest:g} W/m^2/sr cannot be traced together",
            where=f"{scene.origin}: sources",
            remedy="render them one by one",
        )
    return unit


def _sizes(scene: Scene) -> Iterator[tuple[float, float]]:
    """Sizes in the scene [m], and how many units of length each must have."""
    for emitter in scene.emitters:
        # A patch's border may be off by more than a target's: its area does not come from where rays end.
        yield emitter.radius, _SMALLEST_RADIUS
    for surface in scene.surfaces:
        if surface.is_decal:
            continue  # no surface of its own in the text
        match surface.shape:
            case PolygonShape(vertices):
                following = vertices[1:] + vertices[:1]
                yield min(math.dist(a, b) for a, b in zip(vertices, following, strict=True)), _SHORTEST_SIDE
            case TubeShape(start, end, radius):
                yield min(radius, math.dist(start, end)), _SMALLEST_RADIUS
            case MeshShape(corners, _):
                # A mesh knows no shortest side: its corners lie on a grid of 2^-32 of its size.
                yield float((corners.max(axis=0) - corners.min(axis=0)).max()), _SHORTEST_SIDE
            case DiscShape() | SphereShape():
                yield surface.shape.radius, _SMALLEST_RADIUS
            case _:
                assert_never(surface.shape)
