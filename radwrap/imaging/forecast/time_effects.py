"""What motion and shutter are worth, and how fast what is seen may run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.rays import rays_over
from radwrap.imaging.optics.view import trace_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.time_steps import Light, Steps, lights_of, steps_of
from radwrap.imaging.tolerance.bounds import Bounded
from radwrap.imaging.tolerance.certificate import PixelSample, lacks_in_gray, places_of
from radwrap.imaging.tracing import laid_out
from radwrap.random_streams import Rendering, generator
from radwrap.scene.instants import lit_by, pose_time, windows_of
from radwrap.scene.look.checks import checked_at_time
from radwrap.scene.look.image_speed import image_speeds
from radwrap.scene.scene import Scene
from radwrap.scene.shutter import lit_time, shares_of_times

Array = NDArray[np.float64]
_PIXELS: Final = 256
_RAYS: Final = 8  # of each pixel in each of two sets
_LEVEL: Final = 3  # 2^3 + 1 instants
_HALF_A_PIXEL: Final = 0.5


@dataclass(frozen=True, slots=True)
class TimeChange:
    """What leaving out one of both changes.

    Attributes
    ----------
    name, left_out : str
        As of an `Effect`.
    square : Bounded
        Mean square of the change [gray level^2].
    rays : int
        That it took.
    """

    name: str
    left_out: str
    square: Bounded
    rays: int


def time_changes(scene: Scene, options: RenderOptions) -> Iterator[TimeChange]:
    """What motion and shutter change, of those that the scene has; some rays at a few instants tell.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As `render`.
    """
    shutter = scene.camera.sensor.shutter
    if not scene.motions and shutter is None:
        return
    looks = _Looks.of(scene, options)
    seen = looks.seen(scene)
    if scene.motions:
        yield looks.change("motion", "everything stands where its pose is", seen, looks.standing(scene))
    if shutter is not None:
        at_once = replace(scene, camera=replace(scene.camera, sensor=replace(scene.camera.sensor, shutter=None)))
        yield looks.change("shutter", "all rows are exposed at once, as the first one", seen, looks.seen(at_once))


@dataclass(frozen=True, slots=True, eq=False)
class _Looks:
    """The same paths at some instants, in each light.

    Attributes
    ----------
    scene : Scene
        That changes.
    seed : int
        Of all that is drawn.
    exposure_of_radiance : float
        Of the camera.
    sample : PixelSample
        Pixels.
    steps : tuple of Steps
        The instants of each light.
    values : tuple of ndarray, shape (instants, 2, pixels)
        Of each light, at each instant [W m^-2 sr^-1].
    still : tuple of ndarray, shape (2, pixels)
        Of each light, where the poses hold.
    """

    scene: Scene
    seed: int
    exposure_of_radiance: float
    sample: PixelSample
    steps: tuple[Steps, ...]
    values: tuple[Array, ...]
    still: tuple[Array, ...]

    @classmethod
    def of(cls, scene: Scene, options: RenderOptions) -> _Looks:
        """Trace them."""
        sensor = scene.camera.sensor
        random = generator(options.seed, Rendering.EFFECT_PATHS)
        pixels = random.choice(sensor.pixels, min(sensor.pixels, _PIXELS), replace=False)
        sample = PixelSample(pixels, np.zeros(len(pixels), dtype=np.intp), np.ones(1))
        paths = [rays_over(scene.camera, *places_of(pixels, sensor.columns), _RAYS, random) for _ in range(2)]
        opening, u, v = (np.concatenate(parts) for parts in zip(*paths, strict=True))
        scale = 0.0

        def look(light: Light, time: float) -> Array:
            nonlocal scale
            lit = dict.fromkeys(light.sources, 1.0)
            with laid_out(lit_by(checked_at_time(scene, time), lit), replace(options, truth=False)) as traced:
                view = traced.view()
                scale = view.exposure_of_radiance
                means: Array = trace_rays(view, opening, u, v)[0].reshape(2, -1, _RAYS).mean(axis=2)
            return means

        level = _LEVEL if scene.motions else 0
        steps = tuple(steps_of(scene, light, level, options.seed) for light in lights_of(scene))
        values = tuple(np.stack([look(one.light, float(time)) for time in one.times]) for one in steps)
        still = tuple(value[0] for value in values)
        if scene.motions:
            still = tuple(look(one.light, pose_time(scene)) for one in steps)
        return cls(scene, options.seed, scale, sample, steps, values, still)

    @property
    def rows(self) -> NDArray[np.intp]:
        """Of the pixels."""
        return self.sample.pixels // self.scene.camera.sensor.columns

    def seen(self, scene: Scene) -> Array:
        """Radiance that stands for the exposure of each pixel with some shutter, shape (2, pixels)."""
        start, end = windows_of(scene)
        total = np.zeros((2, len(self.sample.pixels)))
        for one, value in zip(self.steps, self.values, strict=True):
            weights = shares_of_times(one.light.strobe, start, end, one.times) / scene.camera.exposure_time
            total += np.einsum("pk,ksp->sp", weights[self.rows], value)
        return total

    def standing(self, scene: Scene) -> Array:
        """Likewise if nothing moved."""
        start, end = windows_of(scene)
        total = np.zeros((2, len(self.sample.pixels)))
        for one, value in zip(self.steps, self.still, strict=True):
            level = lit_time(one.light.strobe, start, end) / scene.camera.exposure_time
            total += level[self.rows] * value
        return total

    def change(self, name: str, left_out: str, seen: Array, other: Array) -> TimeChange:
        """What it changes to leave something out."""
        sensor = self.scene.camera.sensor
        rays = 2 * len(self.sample.pixels) * _RAYS * sum(len(value) for value in self.values)
        errors = lacks_in_gray(seen.mean(axis=0), other - seen, rays, self.exposure_of_radiance, sensor)
        return TimeChange(
            name, left_out, errors.mean_square(self.sample, (self.seed, Rendering.EFFECT_RESAMPLES)), rays
        )


def light_time(scene: Scene) -> float:
    """Longest time of any row from the first to the last light of its exposure [s]."""
    if not scene.camera.exposure_time:
        return 0.0
    start, end = windows_of(scene)
    first, last = np.full(len(start), np.inf), np.full(len(start), -np.inf)
    for light in lights_of(scene):
        reached = lit_time(light.strobe, start, end) > 0
        np.minimum(first, np.where(reached, np.maximum(light.first, start), np.inf), out=first)
        np.maximum(last, np.where(reached, np.minimum(light.last, end), -np.inf), out=last)
    return max(float((last - first).max()), 0.0)


def speeds(scene: Scene, pixels: dict[str, float]) -> list[dict[str, Any]]:
    """Of each target in sight: how fast it may run, and how far it goes.

    Parameters
    ----------
    scene : Scene
        What is there.
    pixels : dict
        Target in sight -> size of a pixel on it [m].

    Returns
    -------
    list of dict
        ``target``; ``light_time``, from the first to the last light of one row [s]; ``half_pixel_speed`` [m s^-1], at
        which it smears over half a pixel; of what moves ``image_speed`` [px s^-1] and ``smear`` [px], else null.
    """
    time = light_time(scene)
    fast = image_speeds(scene) if scene.motions else {}
    return [
        {
            "target": name,
            "light_time": time,
            "half_pixel_speed": _HALF_A_PIXEL * size / time if time > 0 else None,
            "image_speed": fast.get(name),
            "smear": fast[name] * time if name in fast else None,
        }
        for name, size in pixels.items()
    ]
