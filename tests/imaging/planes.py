"""A tracer whose scene is a stack of textured planes across the axis: radiance in closed form, no program."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass

import numpy as np

from radwrap.frames import Pose
from radwrap.imaging.optics.view import View
from radwrap.scene.camera import Aperture, Camera, Sensor

Array = np.ndarray
Texture = Callable[[Array, Array], Array]  # radiance at (x, y) [m] of a plane; NaN where it has a hole


@dataclass(frozen=True)
class Planes:
    """Planes z = depth in the camera's frame, which is the world's here; nearer ones first."""

    planes: tuple[tuple[float, Texture], ...]

    def _meet(self, rays: Array) -> tuple[Array, Array]:
        radiance, distance = np.full(len(rays), np.nan), np.full(len(rays), np.inf)
        for depth, texture in self.planes:
            along = depth / rays[:, 5]
            point = rays[:, :3] + along[:, np.newaxis] * rays[:, 3:]
            value = texture(point[:, 0], point[:, 1])
            new = np.isnan(radiance) & ~np.isnan(value)
            radiance[new] = value[new]
            distance[new] = along[new] * np.sqrt(np.einsum("ij,ij->i", rays[new, 3:], rays[new, 3:]))
        return np.nan_to_num(radiance, nan=0.0), distance

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        yield from (self._meet(block)[0] for block in rays)

    def trace_with_distances(self, rays: Iterable[Array]) -> Generator[tuple[Array, Array]]:
        yield from (self._meet(block) for block in rays)

    def distances(self, rays: Iterable[Array]) -> Generator[Array]:
        yield from (self._meet(block)[1] for block in rays)


def camera(
    aperture: Aperture, rows: int = 24, columns: int = 32, pixel: tuple[float, float] = (1e-5, 1.2e-5), f: float = 0.01
) -> Camera:
    """A camera in the origin that looks along z; an even field of radiance 1 gives gray level 100, linear."""
    exposure = 1.0 * aperture.area / f**2
    sensor = Sensor(rows, columns, *pixel, 100 / exposure, 1.0, 0.0, 1e9, 16, False)
    pose = Pose((0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return Camera(pose, f, ((columns - 1) / 2, (rows - 1) / 2), 1.0, aperture, sensor)


def pixel_axes(seen: Camera) -> tuple[Array, Array, tuple[float, float]]:
    """x of the columns and y of the rows, from the principal point, and the pixels' sides [m]."""
    pitch = (seen.sensor.pixel_width, seen.sensor.pixel_height)
    places = (np.arange(seen.sensor.columns), np.arange(seen.sensor.rows))
    columns, rows = ((n - c) * p for n, c, p in zip(places, seen.principal_point, pitch, strict=True))
    return columns, rows, pitch


def view(aperture: Aperture, *planes: tuple[float, Texture], **more: object) -> View:
    """The planes through an opening."""
    return View(camera(aperture, **more), Planes(planes))  # type: ignore[arg-type]


def gray(seen: View, radiance: Array) -> Array:
    """Gray levels without the sensor's limits."""
    return radiance * seen.exposure_of_radiance * seen.camera.sensor.gain
