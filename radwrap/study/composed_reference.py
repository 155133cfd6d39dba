"""The truth of an image that is composed, of colours or of instants, at some pixels, by rays of its own.

As `reference` has it: two independent values of each pixel. Each has instants of its own, closer together than those of
a render, so that what lies between them is no error that both have in common.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.files import make_folder
from radwrap.imaging.in_time.moving import MOST_LEVEL, levels_for
from radwrap.imaging.methods.rays import sampled_radiance
from radwrap.imaging.mosaicked import plane_of, relative_exposure
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.time_steps import lights_of, steps_of
from radwrap.imaging.tolerance.certificate import PixelSample, places_of
from radwrap.imaging.tracing import LaidOutScene
from radwrap.manifest import sha256_of_value
from radwrap.process import Programs
from radwrap.random_streams import Trading, generator
from radwrap.scene.instants import at_time, keys_of_time, lit_by
from radwrap.scene.look.checks import checked_at_time
from radwrap.scene.mosaic import COLOURS, Colour
from radwrap.scene.mosaic import places_of as places_of_colour
from radwrap.scene.scene import Scene
from radwrap.study.reference import Reference

Array = NDArray[np.float64]
# So many times as many instants as two to a pixel of motion: a quarter of a pixel from one to the next.
_FINER: Final = 2
_FEWEST_RAYS: Final = 8  # of a pixel at one instant


def take_composed_reference(
    scene: Scene,
    sample: PixelSample,
    spent: int,
    folder: Path,
    *,
    rays: int,
    options: RenderOptions,
    programs: Programs,
    progress: Callable[[int], None],
) -> Reference:
    """Trace the reference of a raw image, or of a scene that changes in the course of its exposure.

    Parameters
    ----------
    scene : Scene
        What is there.
    sample : PixelSample
        Pixels.
    spent : int
        Rays that it took to draw them.
    folder : Path
        For what is laid out.
    rays : int
        Of each of the two values of a pixel; where that is fewer than 8 an instant, 8 an instant.
    options : RenderOptions
        By whom; the seed of all that is drawn.
    programs : Programs
        Owner of the processes.
    progress : callable
        Is told how many rays were traced.
    """
    seed = options.seed
    values = np.zeros((2, len(sample.pixels)))
    traced = spent
    rays_at = partial(_exposure, folder=folder, options=options, programs=programs)
    for which in range(2):
        jitter = int(sha256_of_value([seed, "reference", which])[:12], 16)
        random = generator(seed, Trading.RAYS, which)
        for colour, mine in _pixels_by_colour(scene, sample).items():
            plane = scene if colour is None else plane_of(scene, colour)
            relative = 1.0 if colour is None else relative_exposure(scene, colour)
            instants = list(_instants(plane, jitter))
            number = max(_FEWEST_RAYS, rays // len(instants))
            for then, weights in instants:
                weight = weights[sample.pixels[mine] // scene.camera.sensor.columns]
                lit = mine[weight > 0]
                if lit.size:
                    light = rays_at(then, sample.pixels[lit], number, random)
                    values[which, lit] += relative * weight[weight > 0] * light
                traced += number * lit.size
                progress(number * lit.size)
    first, second = gray_levels(values, scene.camera.sensor)
    return Reference(sample, first, second, traced, seed)


def _pixels_by_colour(scene: Scene, sample: PixelSample) -> Mapping[Colour | None, NDArray[np.intp]]:
    """Which of the sample's pixels have the filter of each colour; without a mosaic all are one."""
    sensor = scene.camera.sensor
    if sensor.mosaic is None:
        return {None: np.arange(len(sample.pixels))}
    numbers = np.full((sensor.rows, sensor.columns), -1)
    for number, colour in enumerate(COLOURS):
        for place in places_of_colour(sensor.mosaic.pattern, colour):
            numbers[place] = number
    of_sample = numbers.ravel()[sample.pixels]
    return {colour: np.flatnonzero(of_sample == number) for number, colour in enumerate(COLOURS)}


def _instants(scene: Scene, seed: int) -> Iterator[tuple[Scene, Array]]:
    """The scene at its instants, and how long each counts in each row, as a share of the exposure time."""
    if not keys_of_time(scene):
        yield scene, np.ones(scene.camera.sensor.rows)
        return
    lights = lights_of(scene)
    for light, level in zip(lights, levels_for(scene, lights), strict=True):
        steps = steps_of(scene, light, 0 if level is None else min(level + _FINER, MOST_LEVEL), seed)
        for number, time in enumerate(steps.times):
            checked_at_time(scene, float(time))
            then = lit_by(at_time(scene, float(time)), dict.fromkeys(light.sources, 1.0))
            yield then, steps.weights[:, number]


def _exposure(
    scene: Scene,
    pixels: NDArray[np.intp],
    number: int,
    random: np.random.Generator,
    *,
    folder: Path,
    options: RenderOptions,
    programs: Programs,
) -> Array:
    """Radiant exposure of some pixels of a scene of one instant [J m^-2]."""
    make_folder(folder)
    try:
        view = LaidOutScene(scene, options, programs, folder, exact_bands=True).view()
        radiance = sampled_radiance(view, *places_of(pixels, scene.camera.sensor.columns), number, random)
        exposure: Array = radiance.mean(axis=1) * view.exposure_of_radiance
        return exposure
    finally:
        shutil.rmtree(folder, ignore_errors=True)
