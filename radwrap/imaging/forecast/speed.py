"""How many rays a tracer traces in a second on this machine, on a small scene: to compare machines by."""

from __future__ import annotations

import time
from collections import deque
from contextlib import closing
from importlib.resources import as_file, files
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.optics.view import RAYS_AT_ONCE, central_rays
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tracing import laid_out
from radwrap.scene.file.load import load_scene
from radwrap.tracers.engine import EngineName
from radwrap.tracers.tracer import Tracer

_LONG_ENOUGH: Final = 0.15  # s, beside which the start of a program is small


def tracer_speed(name: EngineName, radiance: str | None = None) -> float:
    """Rays a second on one core [s^-1]: those through the pixels' centres of the scene that `radwrap init` writes.

    Parameters
    ----------
    name : str
        Which tracer.
    radiance : str, optional
        Folder of another Radiance.

    Raises
    ------
    EnvironmentFailure
        If that tracer is missing.
    """
    with as_file(files("radwrap") / "data" / "init" / "scene.toml") as path:
        scene = load_scene(path)
    with laid_out(scene, RenderOptions(tracer=name, radiance=radiance, workers=1)) as traced:
        sensor = scene.camera.sensor
        v, u = np.indices((sensor.rows, sensor.columns), dtype=np.float64)
        return speed_of(traced.view().tracer, central_rays(scene.camera, u.ravel(), v.ravel()))


def speed_of(tracer: Tracer, rays: NDArray[np.float64]) -> float:
    """Rays that a tracer answers in a second [s^-1]; it gets the same ones until that takes long enough."""
    blocks = [rays[start : start + RAYS_AT_ONCE] for start in range(0, len(rays), RAYS_AT_ONCE)]
    _exhaust(tracer, blocks[:1])  # what a tracer does once
    traced, start = 0, time.monotonic()
    while (elapsed := time.monotonic() - start) < _LONG_ENOUGH:
        _exhaust(tracer, blocks)
        traced += len(rays)
    return traced / elapsed


def _exhaust(tracer: Tracer, blocks: list[NDArray[np.float64]]) -> None:
    with closing(tracer.trace(blocks)) as answers:
        deque(answers, maxlen=0)
