"""Which runs differ only in the levels of their sources, and what a light basis for them is rendered with."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.units import RADIANCE, RADIANT_INTENSITY, Dimension, parse_quantity

_KEYS: Final[Mapping[str, Dimension]] = {"radiance": RADIANCE, "radiant_intensity": RADIANT_INTENSITY}
_SI: Final = {"radiance": "W/m^2/sr", "radiant_intensity": "W/sr"}

Levels = Mapping[str, float]


def split_light(document: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, float]]:
    """A scene without the levels of its sources, and these.

    Returns
    -------
    dict
        The scene's tables; equal for scenes that differ in nothing but levels.
    dict
        Emitter -> its radiance or radiant intensity [SI].

    Raises
    ------
    InputError
        If a level is none.
    """
    bare: dict[str, Any] = deepcopy(dict(document))
    levels: dict[str, float] = {}
    for index, source in enumerate(bare.get("sources", [])):
        key = next((key for key in _KEYS if key in source), None)
        if key is None:
            raise InputError("is missing", where=f"sources[{index}].radiance")
        level = parse_quantity(source[key], _KEYS[key])
        source[key] = "any"
        if "count" not in source:
            levels[source["name"]] = _checked(level, source["name"])
            continue
        factors = {led["index"]: led.pop("radiance_factor", 1.0) for led in source.get("leds", [])}
        source["leds"] = [led for led in source.get("leds", []) if set(led) > {"index"}]
        for number in range(source["count"]):
            name = f"{source['name']}.led{number:02d}"
            levels[name] = _checked(level * factors.get(number, 1.0), name)
    return bare, levels


def _checked(level: float, name: str) -> float:
    if not level >= 0:
        raise InputError(f"its level is {level:g}, below zero", where=name)
    return level


def reference_levels(all_levels: Iterable[Levels]) -> dict[str, float]:
    """Light of a basis: every source at its share of the highest level, all as bright as the brightest run."""
    runs = list(all_levels)
    highest = {name: max(levels[name] for levels in runs) for name in runs[0]}
    total = sum(highest.values())
    brightest = max(sum(levels.values()) for levels in runs)
    share = brightest / total if total > 0 else 1.0
    return {name: level * share for name, level in highest.items()}


def with_levels(bare: Mapping[str, Any], levels: Levels) -> dict[str, Any]:
    """A scene without levels, lit by these; the inverse of `split_light`."""
    document: dict[str, Any] = json.loads(json.dumps(bare))
    for source in document["sources"]:
        key = next(key for key in _KEYS if key in source)
        if "count" not in source:
            source[key] = f"{levels[source['name']]!r} {_SI[key]}"
            continue
        own = [levels[f"{source['name']}.led{number:02d}"] for number in range(source["count"])]
        highest = max(own)
        source[key] = f"{highest!r} {_SI[key]}"
        given = {led["index"]: led for led in source["leds"]}
        source["leds"] = [
            {**given.get(number, {"index": number}), "radiance_factor": level / highest if highest > 0 else 1.0}
            for number, level in enumerate(own)
        ]
    return document


def factors(levels: Levels, reference: Levels, sources: Iterable[str]) -> list[float]:
    """Factor on each source of a basis that was rendered in the light of the reference."""
    return [levels[name] / reference[name] for name in sources]
