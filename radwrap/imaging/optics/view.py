"""The rays of a view: from a point in the pinhole, or lens, through every pixel.

In camera coordinates (x right, y down, z forward) the ray from the opening's
point q = (u, v) to the pixel whose erect image point is x' = (column - cu)
pitch has the direction (x' + u, y' + v, f): a shifted viewpoint and a sheared
window at once. Moving the viewpoint alone would be a lens focused at infinity.
Behind a lens light has that direction too, with the image's distance in place
of f; before it, all rays of a pixel meet in the plane of focus.
"""

from __future__ import annotations

import itertools
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import TracerError
from radwrap.imaging.optics.falloff import falloff, whole_falloff
from radwrap.imaging.optics.smooth import SmoothField
from radwrap.imaging.response.exposure import exposure_of_radiance
from radwrap.random_streams import generator
from radwrap.scene.camera import Camera
from radwrap.tracers.engine import Prover
from radwrap.tracers.noise import halvings_of, with_noise
from radwrap.tracers.tracer import Tracer

PixelSampling = Literal["centre", "jitter"]
RAYS_AT_ONCE: Final = 1 << 13  # 0.4 MiB of rays: what each of many threads may keep, large beside the cost of a call
_WORTH_A_PROCESS: Final = 512  # rays that take longer than the start of a process, 7 ms


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
        cos^4 of each ray's angle to the camera's axis; of a lens, see `falloff`.
    stretch : ndarray of float64, shape (n,), optional
        Where the lens distorts: the area of the undistorted image that falls on an area of the sensor there, by which
        its light counts too.
    """

    first: int
    pixels: int
    rays: NDArray[np.float64]
    cos4: NDArray[np.float64]
    stretch: NDArray[np.float64] | None = None


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
    step = max(1, RAYS_AT_ONCE // plan.rays)
    total = sensor.pixels if pixels is None else len(pixels)
    blocks = -(-total // step)
    for number in range(blocks * part // parts, blocks * (part + 1) // parts):
        first, last = number * step, min((number + 1) * step, total)
        indices = np.arange(first, last) if pixels is None else pixels[first:last]
        row, column = np.divmod(indices, sensor.columns)
        if plan.sampling == "jitter":
            inside = generator(plan.seed, viewpoint, number).random((len(indices), plan.rays, 2))
        else:
            inside = np.full((1, 1, 2), 0.5)
        shares = (strata + inside) / k
        offsets = shares - 0.5 if sensor.window is None else sensor.window.places(shares)
        u = (column[:, np.newaxis] + offsets[..., 0]).ravel()
        v = (row[:, np.newaxis] + offsets[..., 1]).ravel()
        rays, cos4, stretch = stretched_rays(camera, opening_point, u, v)
        yield RayBlock(first, len(indices), rays, cos4, stretch)


def rays_through(
    camera: Camera,
    opening_point: tuple[float, float] | NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays from points of the opening through positions on the sensor.

    Parameters
    ----------
    camera : Camera
        Pose, focal length, pixels.
    opening_point : tuple or ndarray, shape (2,) or (n, 2)
        One for all rays or one for each, in the pinhole plane [m].
    u, v : ndarray, shape (n,)
        Sensor positions, column and row [px].

    Returns
    -------
    rays : ndarray, shape (n, 6)
        Origin [m] and direction in the world.
    cos4 : ndarray, shape (n,)
        cos^4 of each ray's angle to the camera's axis; of a lens, see `falloff`.
    """
    rays, cos4, _ = stretched_rays(camera, opening_point, u, v)
    return rays, cos4


def stretched_rays(
    camera: Camera,
    opening_point: tuple[float, float] | NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None]:
    """As `rays_through`, and each ray's `stretch`, see `RayBlock`."""
    rotation = np.asarray(camera.pose.rotation)
    opening = np.atleast_2d(opening_point)
    local, stretch = _image_side(camera, opening, u, v)
    cos4 = falloff(camera, local, opening)
    if camera.lens is not None:
        local[:, :2] += (camera.shear - 1) * opening
    rays = np.empty((len(u), 6))
    rays[:, :3] = np.asarray(camera.pose.position) + opening @ rotation[:, :2].T
    np.matmul(local, rotation.T, out=rays[:, 3:])
    return rays, cos4, stretch


def _image_side(
    camera: Camera, opening: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Directions (x' + q, image distance) between opening and sensor, erect, shape (n, 3) [m], and their stretch."""
    local = np.empty((len(u), 3))
    x = (u - camera.principal_point[0]) * camera.sensor.pixel_width
    y = (v - camera.principal_point[1]) * camera.sensor.pixel_height
    distance, stretch = camera.image_distance, None
    if camera.distortion is not None:
        bent_x, bent_y, stretch = camera.distortion.undistorted(x / distance, y / distance)
        if camera.lens is not None and camera.lens.relative_illumination is not None:
            stretch = None  # in what was measured
        x, y = bent_x * distance, bent_y * distance
    local[:, 0] = x + opening[:, 0]
    local[:, 1] = y + opening[:, 1]
    local[:, 2] = distance
    return local, stretch


def pixel_means(block: RayBlock, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of L cos^4(theta) over each pixel's rays, shape (pixels,)."""
    weights = block.cos4 if block.stretch is None else block.cos4 * block.stretch
    means: NDArray[np.float64] = (radiance * weights).reshape(block.pixels, -1).mean(axis=1)
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


@dataclass(frozen=True, slots=True)
class View:
    """A camera, and who traces its rays.

    Attributes
    ----------
    camera : Camera
        Pose, focal length, pixels, opening.
    tracer : Tracer
        Who traces.
    workers : int
        Tracer processes at a time, where there are rays enough.
    prover : callable, optional
        Which blocks of an image can only change smoothly; see `Engine.smooth_blocks`.
    smooth : SmoothField, optional
        Blocks of which the central image is known without more rays.
    walks : bool
        Whether rays go on as compiled walks, the noise of which falls with their number as that of chance.
    """

    camera: Camera
    tracer: Tracer
    workers: int = 1
    prover: Prover | None = None
    smooth: SmoothField | None = None
    walks: bool = False

    @property
    def exposure_of_radiance(self) -> float:
        """As `exposure.exposure_of_radiance` of its camera [s sr]."""
        return exposure_of_radiance(self.camera)

    def with_noise(self, halvings: int) -> View:
        """The same view by other points of wide lights; see `noise.NoisyTracer`."""
        tracer = with_noise(self.tracer, halvings)
        return self if tracer is self.tracer else replace(self, tracer=tracer)

    def together(self, rays: float, halvings: int = 0, *, alike: bool = False) -> View:
        """The same view with the noise that suits so many rays a pixel where one has those halvings.

        With `alike` see `noise.NoisyTracer`.
        """
        tracer = with_noise(self.tracer, halvings + halvings_of(rays), alike=alike)
        return self if tracer is self.tracer else replace(self, tracer=tracer)


@dataclass(frozen=True, slots=True)
class LitView:
    """A view in the light of some sources, each of which is told apart.

    Attributes
    ----------
    names : tuple of str
        The sources.
    view : View
        Its radiances have the shape (names, n); (n,) where there is but one.
    """

    names: tuple[str, ...]
    view: View

    def each(self, values: NDArray[np.float64], axes: int) -> NDArray[np.float64]:
        """Values with the axis of sources before so many others, which those of one source may lack."""
        return values[np.newaxis] if values.ndim == axes else values


def trace_rays(
    view: View,
    opening: NDArray[np.float64] | None,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    *,
    with_depth: bool = False,
    alone: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """L cos^4(theta) along any rays, and m of what they meet, see `Camera.magnification`.

    Where the view's tracer tells sources apart, L has an axis of theirs before that of the rays.

    Parameters
    ----------
    view : View
        Whose rays.
    opening : ndarray, shape (1, 2) or (n, 2), optional
        Points of the opening [m]; default its centre, which stands for all of it: with `whole_falloff`.
    u, v : ndarray, shape (n,)
        Sensor positions [px].
    with_depth : bool
        Whether m is needed, which central rays alone tell; else it is 1.
    alone : bool
        Whether nothing else is traced meanwhile: then fewer rays are shared among the workers too.
    """
    parts = min(view.workers, -(-len(u) // (_WORTH_A_PROCESS if alone else RAYS_AT_ONCE)))
    if parts <= 1:
        return _trace_part(view, opening, u, v, with_depth=with_depth)
    cuts = [slice(*pair) for pair in itertools.pairwise(np.linspace(0, len(u), parts + 1).astype(int))]
    ended = threading.Event()
    with ThreadPoolExecutor(parts) as pool:
        jobs = [
            pool.submit(
                _trace_part,
                view,
                opening if opening is None or len(opening) == 1 else opening[cut],
                u[cut],
                v[cut],
                with_depth=with_depth,
                ended=ended,
            )
            for cut in cuts
        ]
        try:
            answers = [job.result() for job in jobs]
        except BaseException:
            ended.set()  # of one part's failure, or an interrupt: the pool waits for the others
            raise
    return np.concatenate([value for value, _ in answers], axis=-1), np.concatenate([m for _, m in answers])


def known_or_traced(
    view: View,
    known: SmoothField | None,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    *,
    traced: Callable[[int], object],
    with_depth: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """As `trace_rays` of central rays, but what is known of smooth blocks is not traced.

    Parameters
    ----------
    view, u, v, with_depth
        As there.
    known : SmoothField, optional
        Of the view's light.
    traced : callable
        Is told how many rays were traced.
    """
    if known is None:
        answer = trace_rays(view, None, u, v, with_depth=with_depth)
        traced(len(u))
        return answer
    smooth = known.holds(u, v)
    rest = ~smooth
    found, depth = known.at(u[smooth], v[smooth])
    values, magnification = np.empty((*found.shape[:-1], len(u))), np.empty(len(u))
    values[..., smooth], magnification[smooth] = found, depth
    if rest.any():
        values[..., rest], magnification[rest] = trace_rays(view, None, u[rest], v[rest], with_depth=with_depth)
        traced(int(rest.sum()))
    return values, magnification


def _trace_part(
    view: View,
    opening: NDArray[np.float64] | None,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    *,
    with_depth: bool,
    ended: threading.Event | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    values: list[NDArray[np.float64]] = []
    magnification = np.ones(len(u))
    weights: deque[tuple[NDArray[np.float64], NDArray[np.float64]]] = deque()

    def blocks() -> Iterator[NDArray[np.float64]]:
        for start in range(0, len(u), RAYS_AT_ONCE):
            if ended is not None and ended.is_set():
                raise TracerError("cancelled", where="rays")
            part = slice(start, start + RAYS_AT_ONCE)
            if opening is None:
                rays, weight, cos4 = _central(view.camera, u[part], v[part])
            else:
                some = opening if len(opening) == 1 else opening[part]
                rays, cos4, stretch = stretched_rays(view.camera, some, u[part], v[part])
                weight = cos4 if stretch is None else cos4 * stretch
            weights.append((weight, cos4))
            yield rays

    start = 0
    for radiance, distance in _asked(view.tracer, blocks(), with_depth=with_depth):
        weight, cos4 = weights.popleft()
        part, start = slice(start, start + len(weight)), start + len(weight)
        values.append(radiance * weight)
        if distance is not None:
            magnification[part] = view.camera.magnification(distance * cos4**0.25)
    return np.concatenate(values, axis=-1) if values else np.empty(0), magnification


def central_rays(camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rays through the opening's centre, and places of any shape (u, v) on the sensor [px]; shape (..., 6)."""
    return rays_through(camera.without_lens, (0.0, 0.0), u.ravel(), v.ravel())[0].reshape(*u.shape, 6)


def central_weights(camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """What counts of the radiance of central rays for the whole opening: falloff and stretch, shape (n,)."""
    return _central(camera, u, v)[1]


def _central(
    camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rays through the opening's centre, what counts of their radiance for the whole opening, and their own cos^4."""
    rays, cos4, stretch = stretched_rays(camera.without_lens, (0.0, 0.0), u, v)
    weight = cos4
    if camera.lens is not None:
        local, stretch = _image_side(camera, np.zeros((1, 2)), u, v)
        weight = whole_falloff(camera, local)
    return rays, weight if stretch is None else weight * stretch, cos4


def look_at_depths(view: View, side: int, random: np.random.Generator) -> tuple[NDArray[np.float64], int]:
    """Magnifications of what is in view, by a central ray drawn in each of `side` x `side` parts, and how many rays.

    Fewer where the sensor has fewer pixels; what lies at no depth is left out.
    """
    camera, sensor = view.camera, view.camera.sensor
    rows, columns = (min(size, side) for size in (sensor.rows, sensor.columns))
    row, column = np.indices((rows, columns))
    inside = random.random((2, rows, columns))
    v, u = (row + inside[0]) * sensor.rows / rows - 0.5, (column + inside[1]) * sensor.columns / columns - 0.5
    _, met = trace_rays(view, None, u.ravel(), v.ravel(), with_depth=True)
    return met[met > camera.shear], rows * columns


def _asked(
    tracer: Tracer, rays: Iterator[NDArray[np.float64]], *, with_depth: bool
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64] | None]]:
    if with_depth:
        with closing(tracer.trace_with_distances(rays)) as answers:
            yield from answers
    else:
        with closing(tracer.trace(rays)) as values:
            yield from ((radiance, None) for radiance in values)


def magnifications_at(view: View, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """M of what central rays through sensor positions (u, v) [px] meet; `Camera.shear` where nothing."""
    if not len(u):
        return np.empty(0)
    rays, cos4 = rays_through(view.camera.without_lens, (0.0, 0.0), u, v)
    with closing(view.tracer.distances(np.array_split(rays, -(-len(u) // RAYS_AT_ONCE)))) as answers:
        distance = np.concatenate(list(answers))
    magnification: NDArray[np.float64] = view.camera.magnification(distance * cos4**0.25)
    return magnification
