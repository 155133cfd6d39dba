"""Coarse pictures for the time until the asked one is there: fewer and larger pixels, and a wide tolerance."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracer_choice import candidate
from radwrap.scene.file.load import with_value
from radwrap.scene.scene import Scene

TOLERANCE: Final = "2 %"  # of saturation minus dark: what the eye just sees
MOST_PIXELS: Final = 1 << 15  # twelve sources of them are traced in a second of processor time
LEAST_BLOCK: Final = 2  # as many pixels as the asked picture has take nearly as long, however wide the tolerance
WORTH_IT: Final = 1 << 17  # pixels times sources, below which the asked picture takes hardly longer
# A block of so many pixels a side or more leaves the eye waiting for long: a picture of its root comes between. Of two
# bars at 5 megapixels blocks of 16 take 2 s of processor time and blocks of 4 take 26 s.
LARGE_BLOCK: Final = 9


@dataclass(frozen=True, slots=True)
class Coarse:
    """How the coarse picture is traced.

    Attributes
    ----------
    scene : Scene
        With larger pixels.
    options : Mapping
        Of `RenderOptions`.
    block : int
        How many pixels a side become one.
    """

    scene: Scene
    options: Mapping[str, Any]
    block: int


def stages_of(scene: Scene, options: Mapping[str, Any]) -> tuple[Coarse, ...]:
    """How to trace coarse pictures of a scene, the coarsest first; none where the asked one takes hardly longer.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : Mapping
        Of `RenderOptions`, as the picture is asked for.
    """
    sensor = scene.camera.sensor
    if sensor.pixels * len({emitter.source for emitter in scene.emitters}) < WORTH_IT:
        return ()
    least = max(LEAST_BLOCK, math.ceil(math.sqrt(sensor.pixels / MOST_PIXELS)))
    blocks = [_whole(least, sensor.rows, sensor.columns)]
    if blocks[0] >= LARGE_BLOCK:
        blocks.append(_whole(round(math.sqrt(blocks[0])), sensor.rows, sensor.columns))
    before = int((json.loads(scene.document)["camera"]["sensor"].get("scale") or "1/1").removeprefix("1/"))
    asked = replace(RenderOptions(**options), tolerance=TOLERANCE)
    found = []
    for block in blocks:
        try:
            binned = with_value(scene, "camera.sensor.scale", f"1/{before * block}")
        except InputError:
            continue
        found.append(Coarse(binned, {**options, "tolerance": TOLERANCE, "tracer": _tracer(binned, asked)}, block))
    return tuple(found)


def _whole(least: int, rows: int, columns: int) -> int:
    """So many pixels a side of a block, or a few more where these divide both sides of a sensor."""
    whole = (block for block in range(least, least + least // 2 + 1) if rows % block == 0 and columns % block == 0)
    return next(whole, least)


def _tracer(scene: Scene, options: RenderOptions) -> str:
    """The compiled tracer where a choice is left: each source is traced, which it does in a fifth of the time."""
    if options.tracer != "auto":
        return options.tracer
    try:
        return candidate(scene, replace(options, tracer="compiled")).name
    except (InputError, EnvironmentFailure):
        return options.tracer
