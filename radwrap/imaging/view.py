"""The rays of a view: from a point in the pinhole through every pixel.

In camera coordinates (x right, y down, z forward) the ray from the opening's
point q = (u, v) to the pixel whose erect image point is x' = (column - cu)
pitch has the direction (x' + u, y' + v, f): a shifted viewpoint and a sheared
window at once. Moving the viewpoint alone would be a lens focused at infinity.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.camera import Camera

PixelSampling = Literal["centre", "jitter"]
_RAYS_AT_ONCE: Final = 1 << 13  # 0.4 MiB of rays: what each of many threads may keep, large beside the cost of a call


@dataclass(frozen=True, slots=True)
class PixelPlan:
    """Where the rays of a pixel go.

    Attributes
    ----------
    samples : int
        k; a pixel has k x k strata of equal area, each with a ray.
    sampling : str
        "centre" of each stratum, or "jitter" inside it.
    seed : int
        Seed of the jitter.
    """

    samples: int = 1
    sampling: PixelSampling = "centre"
    seed: int = 0

    @property
    def rays(self) -> int:
        """Rays a pixel."""
        return self.samples**2


@dataclass(frozen=True, slots=True, eq=False)
class RayBlock:
    """Rays of some pixels, all rays of a pixel together.

    Attributes
    ----------
    first : int
        Place of the first pixel in the list of pixels that was asked for.
    pixels : int
        Number of pixels.
    rays : ndarray of float64, shape (n, 6)
        Origin [m] and direction in the world.
    cos4 : ndarray of float64, shape (n,)
        cos^4 of each ray's angle to the camera's axis.
    """

    first: int
    pixels: int
    rays: NDArray[np.float64]
    cos4: NDArray[np.float64]


def ray_blocks(
    camera: Camera,
    opening_point: tuple[float, float],
    plan: PixelPlan,
    viewpoint: int = 0,
    pixels: NDArray[np.intp] | None = None,
    *,
    part: int = 0,
    parts: int = 1,
) -> Iterator[RayBlock]:
    """Rays of one sub-viewpoint, in blocks.

    Parameters
    ----------
    camera : Camera
        Pose, focal length, pixels.
    opening_point : tuple of float
        (u, v) in the pinhole plane, camera's x and y [m].
    plan : PixelPlan
        Rays of each pixel.
    viewpoint : int
        Number of the sub-viewpoint, which the jitter depends on.
    pixels : ndarray of int, shape (n,), optional
        Numbers of the pixels, row by row; default all.
    part, parts : int
        Only this part of so many, of about equal size; a ray is the same, whatever the number of parts.
    """
    sensor, k = camera.sensor, plan.samples
    strata = np.stack(np.meshgrid(np.arange(k), np.arange(k)), axis=-1).reshape(-1, 2)  # (column, row) inside a pixel
    step = max(1, _RAYS_AT_ONCE // plan.rays)
    total = sensor.pixels if pixels is None else len(pixels)
    blocks = -(-total // step)
    for number in range(blocks * part // parts, blocks * (part + 1) // parts):
        first, last = number * step, min((number + 1) * step, total)
        indices = np.arange(first, last) if pixels is None else pixels[first:last]
        row, column = np.divmod(indices, sensor.columns)
        if plan.sampling == "jitter":
            inside = np.random.default_rng([plan.seed, viewpoint, number]).random((len(indices), plan.rays, 2))
        else:
            inside = np.full((1, 1, 2), 0.5)
        offsets = (strata + inside) / k - 0.5
        u = (column[:, np.newaxis] + offsets[..., 0]).ravel()
        v = (row[:, np.newaxis] + offsets[..., 1]).ravel()
        rays, cos4 = _rays(camera, opening_point, u, v)
        yield RayBlock(first, len(indices), rays, cos4)


def _rays(
    camera: Camera, opening_point: tuple[float, float], u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays through the sensor positions u (column) and v (row) [px]."""
    rotation = np.asarray(camera.pose.rotation)
    f = camera.focal_length
    local = np.empty((len(u), 3))
    local[:, 0] = (u - camera.principal_point[0]) * camera.sensor.pixel_width + opening_point[0]
    local[:, 1] = (v - camera.principal_point[1]) * camera.sensor.pixel_height + opening_point[1]
    local[:, 2] = f
    rays = np.empty((len(u), 6))
    rays[:, :3] = np.asarray(camera.pose.position) + rotation @ np.array([*opening_point, 0.0])
    np.matmul(local, rotation.T, out=rays[:, 3:])
    cos4: NDArray[np.float64] = (f**2 / np.einsum("ij,ij->i", local, local)) ** 2
    return rays, cos4


def pixel_means(block: RayBlock, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of L cos^4(theta) over each pixel's rays, shape (pixels,)."""
    means: NDArray[np.float64] = (radiance * block.cos4).reshape(block.pixels, -1).mean(axis=1)
    return means


def traced(
    trace: Callable[[Iterable[NDArray[np.float64]]], Generator[NDArray[np.float64]]], blocks: Iterable[RayBlock]
) -> Iterator[tuple[RayBlock, NDArray[np.float64]]]:
    """Each block of rays with what `Tracer.trace`, or its like, answers to it."""
    pending: deque[RayBlock] = deque()

    def rays() -> Iterator[NDArray[np.float64]]:
        for block in blocks:
            pending.append(block)
            yield block.rays

    with closing(trace(rays())) as answers:
        for radiance in answers:
            yield pending.popleft(), radiance
