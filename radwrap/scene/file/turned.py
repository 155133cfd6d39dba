"""A scene whose sources have other levels, as a document that a scene file can hold."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.catalog.places import find
from radwrap.scene.catalog.presets import LEVELS, class_of_source
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene
from radwrap.scene.sources import Ring, WideSource, emitters

_SAME: Final = 1e-9  # of a radiance: products of a few numbers, rounded


def with_levels(scene: Scene, factors: Mapping[str, float], changes: Mapping[str, Any]) -> Scene:
    """The scene with a factor on each source, and other values of keys.

    Parameters
    ----------
    scene : Scene
        What is turned.
    factors : Mapping[str, float]
        Name of a source, an LED of a ring as ``ring.led03`` -> factor on its radiance.
    changes : Mapping[str, Any]
        As of `load_scene`.

    Raises
    ------
    InputError
        If a source's level cannot be told by the scene file otherwise; and as `load_scene`.
    """
    document = json.loads(scene.document)
    for table, source in zip(document["sources"], scene.sources, strict=True):
        if isinstance(source, Ring):
            _turn_ring(table, [factors.get(emitter.source, 1.0) for emitter in emitters(source)], scene.folder)
        elif factors.get(source.name, 1.0) != 1.0:
            _turn(table, factors[source.name], scene.folder)
    made = scene_from_document(document, changes, origin=scene.origin, folder=scene.folder)
    for (name, before), (_, after) in zip(_radiances(scene), _radiances(made), strict=True):
        wanted = before * factors.get(name, 1.0)
        if abs(after - wanted) > _SAME * max(wanted, before):
            raise InputError(
                "its level cannot be given by another number", where=f'source "{name}"', remedy="relight the basis"
            )
    return made


def _radiances(scene: Scene) -> Iterator[tuple[str, float]]:
    for source in scene.sources:
        if isinstance(source, WideSource):
            yield source.name, source.radiance
        else:
            yield from ((emitter.source, emitter.radiance) for emitter in emitters(source))


def _turn_ring(table: dict[str, Any], factors: list[float], folder: Path) -> None:
    if len(set(factors)) == 1 and "calibration" not in table:
        if factors[0] != 1.0:
            _turn(table, factors[0], folder)
        return
    leds = {led["index"]: led for led in table.get("leds", [])}
    for index, factor in enumerate(factors):
        if factor != 1.0:
            led = leds.setdefault(index, {"index": index})
            led["radiance_factor"] = led.get("radiance_factor", 1.0) * factor
    table["leds"] = [leds[index] for index in sorted(leds)]


def _turn(table: dict[str, Any], factor: float, folder: Path) -> None:
    """Turn the level that a table tells; where it tells none, that of its preset."""
    told = table
    if not any(key in table for key in LEVELS) and "preset" in table:
        told = dict(find(class_of_source(table), table["preset"], folder, f"{table['name']}.preset").values)
    for key in LEVELS:
        if key in told:
            number, unit = told[key].split(" ", 1)
            table[key] = f"{float(number) * factor!r} {unit}"
            return
    if table.get("type") == "ies" and factor > 0:  # the file's candelas stay; watts go the other way
        number, unit = table.get("luminous_efficacy", "179 lm/W").split(" ", 1)
        table["luminous_efficacy"] = f"{float(number) / factor!r} {unit}"
