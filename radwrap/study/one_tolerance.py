"""The one tolerance of all runs of a study, in gray levels."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.tolerance.lit_noise import ToleranceAsked, lit_noise
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.instants import averaged
from radwrap.scene.scene import Scene
from radwrap.study.design import Design, render_options
from radwrap.study.runs import Run


def with_one_tolerance(
    design: Design, runs: Sequence[Run], options: Mapping[str, Any]
) -> tuple[Design, ToleranceAsked | None]:
    """The design with its tolerance in gray levels, and how that was asked for, where it was not so.

    It is that of the scene of the design, and of several cameras the least, so that all runs are sampled alike.

    Parameters
    ----------
    design : Design
        The study.
    runs : sequence of Run
        All of it.
    options : Mapping
        Of `RenderOptions`, besides those of the design.

    Raises
    ------
    InputError, TracerError, EnvironmentFailure
        As a render of the scene.
    """
    how = render_options(design.render, f"{design.origin}: render", **options)
    asked = how.asked_tolerance
    if asked.unit == "gray" or how.fixed_method is not None:
        return design, None
    scenes = _one_of_each_camera(design, runs)
    if asked.unit == "default" and not any(scene.camera.sensor.linear for scene in scenes):
        return design, None  # the default of Eq. 5 needs no look at a scene
    found = [_in_gray(scene, how) for scene in scenes]
    tolerance, noise, _ = min(found, key=lambda one: one[0])
    rays = sum(rays for _, _, rays in found)
    resolved = replace(design, render={**design.render, "tolerance": tolerance})
    return resolved, ToleranceAsked(str(asked), noise, rays)


def _in_gray(scene: Scene, how: RenderOptions) -> tuple[float, float | None, int]:
    """Tolerance and noise [gray level], and the rays that these took."""
    asked, sensor = how.asked_tolerance, scene.camera.sensor
    if not asked.needs_noise(sensor):
        return asked.in_gray(sensor), None, 0
    with traced_scene(averaged(scene), how) as view:
        noise, rays = lit_noise(view)
    return asked.in_gray(sensor, noise), noise, rays


def _one_of_each_camera(design: Design, runs: Iterable[Run]) -> list[Scene]:
    """The scene of the design, seen by each of the sensors that its runs have."""
    sensors = {json.dumps(sensor, sort_keys=True): sensor for run in runs if (sensor := _sensor(run.document))}
    documents = [
        {**design.document, "camera": {**design.document["camera"], "sensor": sensor}} for sensor in sensors.values()
    ]
    return [
        scene_from_document(document, origin=design.scene_origin, folder=design.folder)
        for document in documents or [dict(design.document)]
    ]


def _sensor(document: Mapping[str, Any]) -> Any:
    camera = document.get("camera")
    return camera.get("sensor") if isinstance(camera, Mapping) else None
