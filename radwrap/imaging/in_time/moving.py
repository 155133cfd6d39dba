"""A scene in which something moves: renders at instants, each of which counts for its time in each row.

An instant is rendered by a camera of the same optics whose gray levels are proportional to light: its error is then one
of radiant exposure, and errors of light add up as light does. Of the errors of all instants it is not known how much
they have in common, so that only the noise of their rays is taken to be independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.in_time.by_rows import StillRender
from radwrap.imaging.in_time.linear_light import allowed_exposure_error, full_exposure, gray_bound
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.render_options import RenderOptions, TracerName
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.time_steps import Light, Steps, level_for, lights_of, steps_of
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.manifest import sha256_of_value
from radwrap.scene.camera import Camera, Diffraction, Sensor
from radwrap.scene.instants import at_time, averaged, held, keys_of_time, lit_by
from radwrap.scene.look.checks import checked_at_time
from radwrap.scene.look.image_speed import image_speeds
from radwrap.scene.scene import Scene
from radwrap.scene.sensor_part import cropped
from radwrap.tracers.expressible import compiler_lacks, inexpressible

Array = NDArray[np.float64]

# Of the tolerance: what the instants' own errors may take, and what the time between them may. Their squares add up.
_RENDER_SHARE: Final = 0.85
_STEP_SHARE: Final = 0.5
# Noise of rays averages over the instants, and what they have in common does not: they are rendered to larger errors at
# first, which costs little beside the finer renders that follow where these do not do.
_LOOSENESS: Final = (4.0, 2.0, 1.0)
# The fewest and the most instants of a light: 2^level + 1.
_LEAST_LEVEL: Final = 3
MOST_LEVEL: Final = 10
# Rows that are rendered together at least: a narrower strip costs as much.
_FEWEST_ROWS: Final = 8
# A pixel that saturates in so much less time than an instant counts may be off as it likes.
_SPARE: Final = 16.0
_LARGEST_CODE: Final = 65535.0
_QUANTILE: Final = 0.995


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """The image of a scene in which something moves.

    Attributes
    ----------
    base : Rendered
        The scene as it is at the middle of the first exposure, all rows with the mean level of each source.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    certificate : Certificate
        How far the gray levels may be off.
    instants : int
        Renders that it is made of.
    rays : int
        Of all of them.
    runs : tuple of RunManifest
        Theirs.
    """

    base: Rendered
    exposure: Array
    certificate: Certificate
    instants: int
    rays: int
    runs: tuple[RunManifest, ...]


@dataclass(slots=True, eq=False)
class _Instants:
    """Renders at instants: made once, read back where they count.

    Attributes
    ----------
    scene : Scene
        That moves.
    folder : Path
        Theirs.
    options : RenderOptions
        Of each, but for its tolerance.
    errors : dict
        Sources of a light -> allowed error of radiant exposure of its instants [J m^-2].
    render : callable
        Renders a scene at one instant.
    """

    scene: Scene
    folder: Path
    options: RenderOptions
    errors: dict[tuple[str, ...], float]
    render: StillRender
    made: dict[tuple[tuple[str, ...], float], tuple[Rendered, int]] = field(default_factory=dict)

    def at(self, steps: Steps, number: int) -> tuple[Rendered, int]:
        """The render of an instant, and its first row in the image; of the rows in which it counts."""
        light, time = steps.light, float(steps.times[number])
        key = (light.sources, time)
        if key not in self.made:
            rows = steps.rows_of(number)
            if rows is None:
                raise ValueError("counts in no row")
            first, last = _strip(*rows, self.scene.camera.sensor.rows)
            then = lit_by(at_time(self.scene, time), dict.fromkeys(light.sources, 1.0))
            then = replace(then, camera=self._camera(then.camera, first, last, steps, number))
            seed = int(sha256_of_value([self.options.seed, *map(str, key)])[:12], 16)
            name = f"{len(self.made):04d}"
            tolerance = self.errors[light.sources] * then.camera.sensor.gain
            options = replace(self.options, seed=seed, tolerance=tolerance)
            self.made[key] = self.render(then, self.folder / name, options), first
        return self.made[key]

    def _camera(self, camera: Camera, first: int, last: int, steps: Steps, number: int) -> Camera:
        """Of some rows, with a sensor whose levels are proportional to light and fit into its file."""
        part = cropped(camera, (0, first, camera.sensor.columns - 1, last - 1))
        weight = float(steps.weights[:, number].max())
        enough = _SPARE * full_exposure(self.scene.camera.sensor) / max(weight, 1 / _SPARE)
        gain = _LARGEST_CODE / enough
        linear = replace(
            part.sensor,
            gain=gain,
            gamma=1.0,
            dark_gray=0.0,
            saturation_gray=_LARGEST_CODE,
            bit_depth=16,
            rounding=False,
        )
        return replace(part, sensor=linear)


def moving(
    scene: Scene, folder: Path, options: RenderOptions, render_still: StillRender, check: Callable[[], None]
) -> Moving:
    """Render a scene at as many instants as its tolerance asks for."""
    lights = lights_of(scene)
    options = replace(options, tracer=tracer_of_many(scene, options.tracer))
    levels = levels_for(scene, lights)
    _check_instants(scene, _steps(scene, lights, levels, options.seed))
    base = render_still(averaged(scene), folder / "base", replace(options, frames=0))
    sensor, tolerance = held(scene).camera.sensor, base.run.tolerance
    if tolerance is None:
        raise ValueError("an image at instants is made to a tolerance")
    allowed = allowed_exposure_error(_RENDER_SHARE * tolerance, base.radiant_exposure.values, sensor) / len(lights)
    decided, how = _decided(scene, base.run), _as_decided(options, base.run)
    runs: list[RunManifest] = []
    for looseness in _LOOSENESS:
        steps = _steps(scene, lights, levels, options.seed)
        errors = {one.light.sources: looseness * allowed / _slack(one) for one in steps}
        instants = _Instants(decided, folder / f"{looseness:g}", how, errors, render_still)
        made = _refined(scene, levels, instants, _STEP_SHARE * tolerance, check)
        certificate = _certificate(made, instants, sensor)
        levels = made.levels
        runs += [rendered.run for rendered, _ in instants.made.values()]
        if certificate.rms_gray_upper95 <= tolerance:
            break
    rays = base.run.rays + sum(run.rays for run in runs)
    return Moving(base, made.exposure, certificate, len(instants.made), rays, tuple(runs))


@dataclass(frozen=True, slots=True, eq=False)
class _Composed:
    """An image of instants.

    Attributes
    ----------
    levels : list
        How finely each light's time is parted.
    steps : list of Steps
        The instants.
    exposure : ndarray, shape (rows, columns)
        Radiant exposure [J m^-2].
    motion : float
        What the time between the instants may add, rms [gray level].
    """

    levels: list[int | None]
    steps: list[Steps]
    exposure: Array
    motion: float


def _refined(
    scene: Scene, levels: list[int | None], instants: _Instants, allowed: float, check: Callable[[], None]
) -> _Composed:
    """The image of so many instants that the time between them may add no more than is allowed [gray level]."""
    sensor = scene.camera.sensor
    while True:
        steps = _steps(scene, lights_of(scene), levels, instants.options.seed)
        _check_instants(scene, steps)
        fine, coarse = _composed(steps, instants, check)
        square = float(np.mean((gray_levels(fine, sensor) - gray_levels(coarse, sensor)) ** 2))
        if sensor.gamma == 1:  # else it is not known what the noise makes of gray levels; it is counted elsewhere
            square -= (sensor.gain * _noise_of_difference(steps, instants)) ** 2
        motion = math.sqrt(max(square, 0.0))
        highest = max((level for level in levels if level is not None), default=MOST_LEVEL)
        if motion <= allowed or highest >= MOST_LEVEL:
            return _Composed(levels, steps, fine, motion)
        levels = [None if level is None else level + 1 for level in levels]


def _check_instants(scene: Scene, steps: list[Steps]) -> None:
    """See that nothing is where it cannot be, before a ray is traced."""
    for one in steps:
        for number, time in enumerate(one.times):
            if one.rows_of(number) is not None:
                checked_at_time(scene, float(time))


def _noise_of_difference(steps: list[Steps], instants: _Instants) -> float:
    """What noise of rays makes of the difference between all instants and every second one, rms [J m^-2]."""
    squares = []
    for number, one in _counted(steps):
        rendered, _ = instants.at(one, number)
        weights = one.weights[:, number] - one.without_every_second[:, number]
        noise = rendered.error.discretisation_rms_gray / rendered.scene.camera.sensor.gain
        squares.append(float(np.mean(weights**2)) * noise**2)
    return math.sqrt(math.fsum(squares))


def _decided(scene: Scene, base: RunManifest) -> Scene:
    """The scene with diffraction, or without it, at all instants alike."""
    taken: Diffraction | None = None if base.diffraction is None else "on"
    return replace(scene, camera=replace(scene.camera, diffraction=taken))


def _as_decided(options: RenderOptions, base: RunManifest) -> RenderOptions:
    """The options of an instant: who traces, and whether light goes between surfaces, is the same at all of them."""
    orders = 0 if base.bounces is None else base.bounces.orders
    tracer = options.tracer if base.tracer is None else base.tracer.name
    return replace(options, truth=False, frames=0, bounces=orders, tracer=tracer)


def tracer_of_many(scene: Scene, asked: TracerName) -> TracerName:
    """The compiled tracer, unless another one is asked for or it cannot show the scene: renders are many and small."""
    return "compiled" if asked == "auto" and not inexpressible(scene) and not compiler_lacks() else asked


def levels_for(scene: Scene, lights: tuple[Light, ...]) -> list[int | None]:
    """How finely each light's time is parted, as `steps_of` has it; None where nothing moves.

    Raises
    ------
    InputError
        If it moves too far.
    """
    if not scene.motions:
        return [None for _ in lights]
    speed = max(image_speeds(scene).values(), default=0.0)
    paths = [speed * (light.last - light.first) for light in lights]
    if max(paths) > 2**MOST_LEVEL:
        raise InputError(
            f"moves it over {max(paths):.3g} pixels while the frame is exposed; {2**MOST_LEVEL} are the most",
            where=f"{scene.origin}: {_key_of_motion(scene)}",
            remedy="expose for a shorter time, strobe the sources, or check the unit",
        )
    return [level_for(path, _LEAST_LEVEL, MOST_LEVEL) for path in paths]


def _key_of_motion(scene: Scene) -> str:
    return next(key for key in keys_of_time(scene) if key.startswith("targets"))


def _steps(scene: Scene, lights: tuple[Light, ...], levels: list[int | None], seed: int) -> list[Steps]:
    return [steps_of(scene, light, level or 0, seed) for light, level in zip(lights, levels, strict=True)]


def _strip(first: int, last: int, rows: int) -> tuple[int, int]:
    """Some more rows where there are few."""
    spare = max(_FEWEST_ROWS - (last - first), 0)
    first = max(0, first - spare // 2)
    return first, min(rows, max(last, first + _FEWEST_ROWS))


def _counted(steps: list[Steps]) -> Iterator[tuple[int, Steps]]:
    """Instants that count in any row."""
    for one in steps:
        yield from ((number, one) for number in range(len(one.times)) if one.rows_of(number) is not None)


def _composed(steps: list[Steps], instants: _Instants, check: Callable[[], None]) -> tuple[Array, Array]:
    """Radiant exposure of all instants, and of every second one [J m^-2]."""
    sensor = instants.scene.camera.sensor
    fine, coarse = np.zeros((2, sensor.rows, sensor.columns))
    for number, one in _counted(steps):
        check()
        rendered, first = instants.at(one, number)
        light = rendered.radiant_exposure.values
        rows = slice(first, first + len(light))
        fine[rows] += one.weights[rows, number, np.newaxis] * light
        coarse[rows] += one.without_every_second[rows, number, np.newaxis] * light
    return fine, coarse


def _slack(steps: Steps) -> float:
    """By how much the error of a light is larger than that of its instants, if they have all of it in common."""
    squares = math.fsum(math.prod(_share(steps, number)) for number, _ in _counted([steps]))
    return math.sqrt(_total(steps) * squares)


def _total(steps: Steps) -> float:
    """Largest sum of weights of any row."""
    return float(steps.weights.sum(axis=1).max())


def _share(steps: Steps, number: int) -> tuple[float, float]:
    """Largest weight of an instant, and the share of the image's rows in which it is rendered."""
    rows = len(steps.weights)
    first, last = _strip(*(steps.rows_of(number) or (0, 0)), rows)
    return float(steps.weights[:, number].max()), (last - first) / rows


@dataclass(frozen=True, slots=True)
class _LightError:
    """Errors of radiant exposure that the instants of one light leave, rms over the image [J m^-2].

    Attributes
    ----------
    common, upper : float
        Estimate and bound of what they may have in common.
    noise : float
        Of their own rays.
    pixels, rays : int
        What their certificates took.
    """

    common: float
    upper: float
    noise: float
    pixels: int
    rays: int


def _error_of(steps: Steps, instants: _Instants) -> _LightError:
    """Errors of one light.

    Of weights w_k and errors e_k of the instants: (sum w_k e_k)^2 <= (sum w_k) sum w_k e_k^2 for what they have in
    common, and sum w_k^2 n_k^2 for the noise n_k of rays of their own.
    """
    common, upper, noise = [], [], []
    pixels = rays = 0
    for number, (rendered, _) in ((number, instants.at(steps, number)) for number, _ in _counted([steps])):
        weight = float(steps.weights[:, number].max())
        found, gain = rendered.error, rendered.scene.camera.sensor.gain
        pixels, rays = pixels + found.certificate_pixels, rays + found.certificate_rays
        # Of a strip that was rendered with more rows than count, all of its error may lie in those that do.
        share = len(rendered.radiant_exposure.values) / len(steps.weights)
        square = (found.discretisation_rms_gray / gain) ** 2
        noise.append(weight**2 * share * square)
        common.append(weight * share * max((found.rms_gray / gain) ** 2 - square, 0.0))
        upper.append(weight * share * max((found.rms_gray_upper95 / gain) ** 2 - square, 0.0))
    total = _total(steps)
    middle, bound = (math.sqrt(total * math.fsum(squares)) for squares in (common, upper))
    return _LightError(middle, bound, math.sqrt(math.fsum(noise)), pixels, rays)


def _certificate(made: _Composed, instants: _Instants, sensor: Sensor) -> Certificate:
    """How far gray levels may be off: what lights have in common adds up, their noise is independent."""
    exposure, error = made.exposure, made.motion
    lights = [_error_of(one, instants) for one in made.steps]
    noise = math.hypot(*(light.noise for light in lights))
    common, upper = (math.fsum(getattr(light, name) for light in lights) for name in ("common", "upper"))
    middle, bound = (gray_bound(math.hypot(part, noise), exposure, sensor) for part in (common, upper))
    return Certificate(
        rms_gray=math.hypot(middle, error),
        rms_gray_upper95=math.hypot(bound, error),
        p99_gray_upper95=None,
        model_rms_gray=gray_bound(common, exposure, sensor),
        discretisation_rms_gray=gray_bound(noise, exposure, sensor),
        certificate_pixels=sum(light.pixels for light in lights),
        certificate_rays=sum(light.rays for light in lights),
        method="instants",
        motion_gray=error if any(len(one.times) > 1 for one in made.steps) else None,
    )
