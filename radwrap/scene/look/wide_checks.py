"""What a wide source cannot stand beside, since its light would be off there and nobody would know."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.scene.materials import Mirror
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Source, WideSource, emitters
from radwrap.scene.targets import DiscShape, MeshShape, PolygonShape, SphereShape, Surface, Target, TubeShape, surfaces
from radwrap.scene.wide_shapes import Annulus, first_cells, halves, nodes

Array = NDArray[np.float64]

# Cells of a wide source at least, and places along each side of a cell.
_CELLS: Final = 64
_NODES: Final = 4
_BESIDE: Final = 1e-9  # m; what is nearer to a plane lies in it


def check_beside(scene: Scene) -> None:
    """Refuse wide sources whose error is not held everywhere.

    Raises
    ------
    InputError
        Beside an included file, whose surfaces are not known here, and beside a mirror that throws light on something.
    """
    for index, source in enumerate(scene.sources):
        if not isinstance(source, WideSource):
            continue
        where = f"{scene.origin}: sources[{index}]"
        if scene.included:
            raise InputError(
                f'nobody knows how far "{source.name}" is from the surfaces of "{scene.included[0].name}", an included '
                "file: its error could not be held",
                where=where,
                remedy="describe the file's surfaces by targets, or the light by small sources",
            )
        kinds = {isinstance(scene.materials[surface.material], Mirror) for surface in scene.surfaces}
        if kinds == {True, False}:
            raise InputError(
                f'the light of "{source.name}" that mirrors throw on other targets is held to no error',
                where=where,
                remedy="describe it by small sources, or leave out the mirror or all other targets",
            )


def check_coaxial(scene: Scene) -> None:
    """Refuse light that the disc of a coaxial source may keep from a target: where it lies is nothing but air.

    Raises
    ------
    InputError
        Naming the source whose light may be lost.
    """
    disc = next((source for source in scene.sources if getattr(source, "kind", "") == "coaxial"), None)
    if not isinstance(disc, WideSource) or not isinstance(disc.shape, Annulus):
        return
    rotation, middle = np.asarray(disc.pose.rotation), np.asarray(disc.pose.position)
    targets = [_hull((_points(target) - middle) @ rotation) for target in scene.targets]
    for index, source in enumerate(scene.sources):
        places, widths = _places(source)
        if source is disc or not len(places):
            continue
        lights = (places - middle) @ rotation
        if any(_may_cross(lights, widths, corners, disc.shape.radius).any() for corners in targets):
            raise InputError(
                f'light of "{source.name}" may cross the place behind the camera where "{disc.name}" is drawn, and '
                "would end there",
                where=f"{scene.origin}: sources[{index}]",
                remedy="move it in front of that place or aside, or render the two apart and add their exposures",
            )


def _places(source: Source) -> tuple[Array, Array]:
    """Places all over what shines, shape (n, 3), and radii about them that hold the same area, shape (n,) [m]."""
    if isinstance(source, WideSource) and source.radiance > 0:
        cells = first_cells(source.shape)
        while len(cells) < _CELLS:
            cells = [half for cell in cells for half in halves(source.shape, cell)]
        points, _, areas = nodes(source.shape, np.array(cells), _NODES)
        placed = points.reshape(-1, 3) @ np.asarray(source.pose.rotation).T + source.pose.position
        return placed, np.sqrt(areas.ravel() / np.pi)
    lit = [] if isinstance(source, WideSource) else [emitter for emitter in emitters(source) if emitter.radiance > 0]
    return np.array([emitter.position for emitter in lit]), np.array([emitter.radius for emitter in lit])


def _may_cross(lights: Array, widths: Array, corners: Array, radius: float) -> NDArray[np.bool_]:
    """Whether ways from lights, shape (n, 3), of such radii into a hull, shape (m, 3), may meet a disc at z = 0."""
    height, depth = lights[:, 2, np.newaxis], corners[:, 2]
    across = (height * depth < 0) & (np.abs(height) > _BESIDE)
    # Where the ways to the corners go through the plane; what a hull spans lies between its extremes.
    share = np.where(across, height / np.where(across, height - depth, 1.0), 0.0)[..., np.newaxis]
    places = (lights[:, np.newaxis] + share * (corners - lights[:, np.newaxis]))[..., :2]
    nearest = np.clip(0.0, places.min(axis=1), places.max(axis=1))
    near = np.hypot(nearest[:, 0], nearest[:, 1]) <= radius + widths * (1 - share[..., 0]).max(axis=1)
    whole, some = across.all(axis=1), across.any(axis=1)
    # A hull on both sides of the plane is not looked at more closely.
    crossing: NDArray[np.bool_] = (whole & near) | (some & ~whole)
    return crossing


def _hull(points: Array) -> Array:
    """The same few points, or the corners of a box that holds many."""
    if len(points) <= len(_AROUND):
        return points
    low, high = points.min(axis=0), points.max(axis=0)
    box: Array = (low + high) / 2 + (high - low) / 2 * _AROUND
    return box


def _points(target: Target) -> Array:
    """Points in the world whose hull holds a target, shape (n, 3) [m]."""
    return np.vstack([_corners(surface) for surface in surfaces(target)])


def _corners(surface: Surface) -> Array:
    match surface.shape:
        case PolygonShape(vertices):
            return np.array(vertices)
        case DiscShape(centre, _, radius) | SphereShape(centre, radius):
            return np.asarray(centre) + radius * _AROUND
        case TubeShape(start, end, radius):
            return np.vstack([np.asarray(start) + radius * _AROUND, np.asarray(end) + radius * _AROUND])
        case MeshShape(vertices, _):
            return vertices


# Corners of a cube: its hull holds the unit sphere.
_AROUND: Final = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
