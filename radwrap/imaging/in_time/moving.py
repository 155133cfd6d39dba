"""A scene in which something moves: renders at instants, each of which counts for its time in each row.

An instant is rendered by a camera of the same optics with gray levels in proportion to light, see `summed_instants`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.imaging.in_time.by_rows import StillRender
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.render_options import RenderOptions, TracerName
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.response.linear_light import allowed_exposure_error, full_exposure
from radwrap.imaging.run_files import BASES, InstantFile, LightFile
from radwrap.imaging.summed_instants import AtInstant, Summed, certificate_of_sum, counted, slack, strip_of, summed
from radwrap.imaging.time_steps import Light, Steps, level_for, lights_of, steps_of
from radwrap.imaging.tolerance.certificate import Certificate
from radwrap.manifest import sha256_of_value
from radwrap.scene.camera import Camera, Diffraction
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
# A pixel that saturates in so much less time than an instant counts may be off as it likes.
_SPARE: Final = 16.0
_LARGEST_CODE: Final = 65535.0
_QUANTILE: Final = 0.995


def planned_instants(scene: Scene, seed: int) -> int:
    """How many instants are rendered at least.

    Raises
    ------
    InputError
        If the scene moves too far, or is dark at all of them.
    """
    lights = lights_of(scene)
    return len(list(counted(_steps(scene, lights, levels_for(scene, lights), seed))))


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
    lights : tuple of LightFile
        The instants of each light.
    folder : Path
        Where their renders lie, in folders of the names that are told there.
    """

    base: Rendered
    exposure: Array
    certificate: Certificate
    instants: int
    rays: int
    runs: tuple[RunManifest, ...]
    lights: tuple[LightFile, ...]
    folder: Path


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
    left : int
        So many renders are known to follow.
    made : dict
        Sources of a light and time -> render, its first row in the image, and its folder.
    """

    scene: Scene
    folder: Path
    options: RenderOptions
    errors: dict[tuple[str, ...], float]
    render: StillRender
    left: int = 0
    made: dict[tuple[tuple[str, ...], float], tuple[Rendered, int, str]] = field(default_factory=dict)

    def expect(self, steps: list[Steps]) -> None:
        """Say which instants will be asked for."""
        asked = {(one.light.sources, float(one.times[number])) for number, one in counted(steps)}
        self.left = len(asked - self.made.keys())

    def at(self, steps: Steps, number: int) -> AtInstant:
        """The image at an instant, of the rows in which it counts."""
        rendered, first, _ = self._rendered(steps, number)
        return AtInstant(rendered.radiant_exposure.values, rendered.error, rendered.scene.camera.sensor.gain, first)

    def kept(self, steps: Steps) -> LightFile:
        """What tells of the instants of a light."""
        light = steps.light
        images = []
        for number, _ in counted([steps]):
            _, first, name = self._rendered(steps, number)
            images.append(InstantFile(number, f"{BASES}/{name}", first))
        return LightFile(
            sources=light.sources,
            strobe=light.strobe,
            first=light.first,
            last=light.last,
            times=steps.times.tolist(),
            weights=steps.weights.tolist(),
            without_every_second=steps.without_every_second.tolist(),
            instants=images,
        )

    def _rendered(self, steps: Steps, number: int) -> tuple[Rendered, int, str]:
        """The render of an instant, its first row in the image, and its folder."""
        light, time = steps.light, float(steps.times[number])
        key = (light.sources, time)
        if key not in self.made:
            rows = steps.rows_of(number)
            if rows is None:
                raise ValueError("counts in no row")
            first, last = strip_of(*rows, self.scene.camera.sensor.rows)
            then = lit_by(at_time(self.scene, time), dict.fromkeys(light.sources, 1.0))
            then = replace(then, camera=self._camera(then.camera, first, last, steps, number))
            seed = int(sha256_of_value([self.options.seed, *map(str, key)])[:12], 16)
            name = f"{len(self.made):04d}"
            tolerance = self.errors[light.sources] * then.camera.sensor.gain
            options = replace(self.options, seed=seed, tolerance=tolerance)
            self.left = max(self.left - 1, 0)
            rendered = self.render(then, self.folder / name, options, instants_left=self.left)
            self.made[key] = rendered, first, name
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
    planned = _steps(scene, lights, levels, options.seed)
    _check_instants(scene, planned)
    still = replace(options, frames=0, basis=False)
    base = render_still(averaged(scene), folder / "base", still, instants_left=len(list(counted(planned))))
    sensor, tolerance = held(scene).camera.sensor, base.run.tolerance
    if tolerance is None:
        raise ValueError("an image at instants is made to a tolerance")
    allowed = allowed_exposure_error(_RENDER_SHARE * tolerance, base.radiant_exposure.values, sensor) / len(lights)
    decided, how = _decided(scene, base.run), _as_decided(options, base.run)
    runs: list[RunManifest] = []
    for looseness in _LOOSENESS:
        steps = _steps(scene, lights, levels, options.seed)
        errors = {one.light.sources: looseness * allowed / slack(one) for one in steps}
        instants = _Instants(decided, folder / f"{looseness:g}", how, errors, render_still)
        levels, made = _refined(scene, levels, instants, _STEP_SHARE * tolerance, check)
        certificate = certificate_of_sum(made, instants.at, sensor)
        runs += [rendered.run for rendered, *_ in instants.made.values()]
        if certificate.rms_gray_upper95 <= tolerance:
            break
    rays = base.run.rays + sum(run.rays for run in runs)
    kept = tuple(instants.kept(one) for one in made.steps)
    return Moving(base, made.exposure, certificate, len(instants.made), rays, tuple(runs), kept, instants.folder)


def _refined(
    scene: Scene, levels: list[int | None], instants: _Instants, allowed: float, check: Callable[[], None]
) -> tuple[list[int | None], Summed]:
    """The image of so many instants that the time between them may add no more than is allowed [gray level]."""
    while True:
        steps = _steps(scene, lights_of(scene), levels, instants.options.seed)
        _check_instants(scene, steps)
        instants.expect(steps)
        made = summed(steps, instants.at, scene.camera.sensor, check)
        highest = max((level for level in levels if level is not None), default=MOST_LEVEL)
        if made.motion <= allowed or highest >= MOST_LEVEL:
            return levels, made
        levels = [None if level is None else level + 1 for level in levels]


def _check_instants(scene: Scene, steps: list[Steps]) -> None:
    """See that nothing is where it cannot be, before a ray is traced."""
    for one in steps:
        for number, time in enumerate(one.times):
            if one.rows_of(number) is not None:
                checked_at_time(scene, float(time))


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
