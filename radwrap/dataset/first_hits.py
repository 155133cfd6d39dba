"""What each pixel's centre sees first: depth, and the silhouette of each object, whole and visible.

Rays go through the centres of the pixels and the middle of the opening. A
finite opening, or a lens out of focus, blurs the image across these borders;
the masks do not know of that, as labels are of things and not of light.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.extras import installing
from radwrap.imaging.optics.view import rays_through
from radwrap.scene.camera import Camera
from radwrap.scene.look.geometry import project
from radwrap.scene.scene import Scene
from radwrap.scene.targets import MeshPart
from radwrap.tracers.expressible import compiler_lacks, inexpressible
from radwrap.tracers.text_frame import TextFrame, traced_frame

if TYPE_CHECKING:
    from radwrap.tracers.compiled.engine import NumberedTracer

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RAYS_AT_ONCE: Final = 1 << 18
# The same triangle is hit at the same distance with and without other things; rounding alone may differ. Relative.
_SAME: Final = 1e-9
# A silhouette is followed beyond the image by so many widths and heights of it, as BOP's tools do.
BEYOND: Final = 1
_MARGIN: Final = 1  # px around the projected corners


@dataclass(frozen=True, slots=True)
class Box:
    """Pixels from a first column and row on; empty where width and height are 0."""

    column: int
    row: int
    width: int
    height: int

    @property
    def values(self) -> list[int]:
        """As COCO and BOP write it: x, y, width, height [px]."""
        return [self.column, self.row, self.width, self.height]


@dataclass(frozen=True, slots=True, eq=False)
class ObjectTruth:
    """What is true of one object in an image.

    Attributes
    ----------
    part : MeshPart
        With its name and pose.
    whole : ndarray of bool, shape (rows, columns)
        Pixels that would see it if nothing else were there.
    visible : ndarray of bool, shape (rows, columns)
        Pixels that see it.
    whole_pixels : int
        Of the whole silhouette, also beyond the image: by one width or height of it on each side.
    whole_box : Box
        Of the same.
    """

    part: MeshPart
    whole: Mask
    visible: Mask
    whole_pixels: int
    whole_box: Box

    @property
    def visible_pixels(self) -> int:
        """Number of pixels that see it."""
        return int(self.visible.sum())

    @property
    def visible_box(self) -> Box:
        """The smallest box around what is seen of it."""
        return box_of(self.visible)

    @property
    def visible_share(self) -> float:
        """Pixels that see it, as a share of its whole silhouette; 0 where that is empty."""
        return self.visible_pixels / self.whole_pixels if self.whole_pixels else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ImageTruth:
    """What is true of an image.

    Attributes
    ----------
    depth : ndarray of float64, shape (rows, columns)
        Of the first surface along the camera's axis [m]; 0 where there is none.
    objects : tuple of ObjectTruth
    """

    depth: Floats
    objects: tuple[ObjectTruth, ...]


def box_of(mask: Mask, column: int = 0, row: int = 0) -> Box:
    """The smallest box around the pixels of a mask whose first pixel has that column and row."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return Box(0, 0, 0, 0)
    width, height = columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1
    return Box(int(column + columns[0]), int(row + rows[0]), int(width), int(height))


class FirstHits:
    """First hits of rays through pixel centres, by the compiled tracer.

    Parameters
    ----------
    scene : Scene
        What is there.

    Raises
    ------
    InputError
        If the compiled tracer cannot show the scene.
    EnvironmentFailure
        If its compiler is not installed.
    """

    def __init__(self, scene: Scene) -> None:
        if lack := compiler_lacks():
            raise EnvironmentFailure(
                f"truth of datasets needs the compiled tracer, and {lack}", remedy=installing("fast")
            )
        if shown := inexpressible(scene):
            raise InputError(f"truth of datasets needs the compiled tracer, and {shown}", where=scene.origin)
        self._scene = scene
        self._frame: TextFrame = traced_frame(scene)
        self._all = self._tracer(scene)
        self.camera: Camera = scene.camera.without_lens  # the same rays through the middle, with their own cosines

    def _tracer(self, scene: Scene) -> NumberedTracer:
        from radwrap.tracers.compiled.engine import CompiledEngine

        return CompiledEngine.of(scene, self._frame, lambda: False).numbered()

    def truth(self, categories: Mapping[str, str]) -> ImageTruth:
        """Depth, and silhouettes of the named parts."""
        sensor = self.camera.sensor
        every = Box(0, 0, sensor.columns, sensor.rows)
        distance, cosine = self._seen(self._all, every)
        depth = np.where(np.isfinite(distance), distance * cosine, 0.0)
        parts = [target for target in self._scene.targets if isinstance(target, MeshPart) and target.name in categories]
        return ImageTruth(depth, tuple(self._object(part, distance) for part in parts))

    def reaches(self, points: Floats) -> Mask:
        """Which points of surfaces, shape (n, 3) in the world [m], the middle of the opening sees."""
        origin = np.asarray(self.camera.pose.position)
        rays = np.column_stack([np.broadcast_to(origin, points.shape), points - origin])
        found: Mask = self._distances(self._all, rays) >= np.linalg.norm(points - origin, axis=1) * (1 - _CREASE)
        return found

    def _object(self, part: MeshPart, distance: Floats) -> ObjectTruth:
        sensor = self.camera.sensor
        window = self._window(part)
        alone = np.full((window.height, window.width), np.inf)
        if alone.size:
            alone, _ = self._seen(self._tracer(replace(self._scene, targets=(part,), sources=())), window)
        whole = np.full((sensor.rows, sensor.columns), np.inf)
        inside = _overlap(window, sensor.columns, sensor.rows)
        if inside is not None:
            (rows, columns), (window_rows, window_columns) = inside
            whole[rows, columns] = alone[window_rows, window_columns]
        hit = np.isfinite(whole)
        visible = hit & (np.where(hit, whole, 0.0) <= distance * (1 + _SAME))
        silhouette = np.isfinite(alone)
        box = box_of(silhouette, window.column, window.row)
        return ObjectTruth(part, hit, visible, int(silhouette.sum()), box)

    def _window(self, part: MeshPart) -> Box:
        """Pixels that may see a part, in the image and beside it."""
        sensor = self.camera.sensor
        beyond = 0 if self.camera.distortion is not None else BEYOND  # a polynomial ends where it was fitted
        low = np.array([-beyond * sensor.columns, -beyond * sensor.rows])
        high = np.array([(1 + beyond) * sensor.columns, (1 + beyond) * sensor.rows])
        rotation, position = np.asarray(part.pose.rotation), np.asarray(part.pose.position)
        uv, depth = project(self.camera, part.mesh.vertices @ rotation.T + position)
        if self.camera.distortion is None and (depth > 0).all():
            low = np.maximum(low, np.floor(uv.min(axis=0)).astype(int) - _MARGIN)
            high = np.minimum(high, np.ceil(uv.max(axis=0)).astype(int) + 1 + _MARGIN)
        elif (depth <= 0).all():
            return Box(0, 0, 0, 0)
        width, height = np.maximum(high - low, 0)
        return Box(int(low[0]), int(low[1]), int(width), int(height))

    def _seen(self, tracer: NumberedTracer, window: Box) -> tuple[Floats, Floats]:
        """Distance to what each pixel of a window sees [m], infinite where nothing is, and the ray's cosine."""
        distance, cosine = np.empty(window.width * window.height), np.empty(window.width * window.height)
        for first, u, v in _centres(window):
            rays, _ = rays_through(self.camera, (0.0, 0.0), u, v)
            here = slice(first, first + len(u))
            distance[here] = self._distances(tracer, rays)
            axis = np.asarray(self.camera.pose.z_axis)
            cosine[here] = rays[:, 3:] @ axis / np.linalg.norm(rays[:, 3:], axis=1)
        shape = (window.height, window.width)
        return distance.reshape(shape), cosine.reshape(shape)

    @staticmethod
    def _distances(tracer: NumberedTracer, rays: Floats) -> Floats:
        return next(tracer.distances([rays])) if len(rays) else np.empty(0)


# A crease lies on the surface itself: its own ray may end there by rounding. Relative to its distance.
_CREASE: Final = 1e-6


def _centres(window: Box) -> Iterator[tuple[int, Floats, Floats]]:
    total = window.width * window.height
    for first in range(0, total, _RAYS_AT_ONCE):
        rows, columns = np.divmod(np.arange(first, min(first + _RAYS_AT_ONCE, total)), window.width)
        yield first, (window.column + columns).astype(np.float64), (window.row + rows).astype(np.float64)


def _overlap(window: Box, columns: int, rows: int) -> tuple[tuple[slice, slice], tuple[slice, slice]] | None:
    """Rows and columns that a window shares with the image: in the image, and in the window."""
    left, right = max(window.column, 0), min(window.column + window.width, columns)
    top, bottom = max(window.row, 0), min(window.row + window.height, rows)
    if left >= right or top >= bottom:
        return None
    there = slice(top - window.row, bottom - window.row), slice(left - window.column, right - window.column)
    return (slice(top, bottom), slice(left, right)), there
