"""The runs of a study as rows for the ring."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from radwrap.errors import InputError
from radwrap.imaging.relight.levels import Levels
from radwrap.led.from_scene import leds_of
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.study.design import Design
from radwrap.study.runs import runs_of


def rows_of(design: Design, scene: Scene) -> Levels:
    """What the ring shows in each run of a study, as factors on the scene's radiant intensities.

    Parameters
    ----------
    design : Design
        It may change the light of the ring's LEDs and nothing else, since the bench stays as it is.
    scene : Scene
        What stands on the bench.

    Returns
    -------
    Levels
        A row for each run, "run0001" and so on, with a factor for each LED of the ring.

    Raises
    ------
    InputError
        If a run differs from the scene in more than that, or lights an LED that is dark in the scene.
    """
    nominal = [led.radiant_intensity for led in leds_of(scene)]
    bench = _without_light(scene)
    names, factors = [], []
    for run in runs_of(design):
        where = f"{design.origin}: run {run.index}"
        shown = scene_from_document(run.document, origin=where, folder=design.folder)
        if _without_light(shown) != bench:
            raise InputError(
                f"differs from {scene.origin} in more than the light of the ring's LEDs",
                where=where,
                remedy="a bench is played with the parts that are on it: one play for each scene",
            )
        intensities = [led.radiant_intensity for led in leds_of(shown)]
        for led, (wanted, given) in enumerate(zip(intensities, nominal, strict=True)):
            if wanted > 0 and not given:
                raise InputError(f"lights LED {led}, which is dark in {scene.origin}", where=where)
        names.append(f"run{run.index:04d}")
        factors.append([wanted / given if given else 0.0 for wanted, given in zip(intensities, nominal, strict=True)])
    return Levels(tuple(names), np.array(factors))


def _without_light(scene: Scene) -> tuple[dict[str, Any], list[tuple[Any, ...]]]:
    """A scene's tables but for its sources, and where its LEDs are and point."""
    tables = {key: value for key, value in json.loads(scene.document).items() if key != "sources"}
    return tables, [(led.name, led.position, led.axis, led.beam) for led in leds_of(scene)]
