"""Key paths of a scene's tables, such as ``targets[0].pitch`` or ``sources[0].leds[*].radiance_factor``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import shortened, whole_number

_LEDS: Final = re.compile(r"sources\[(\d{1,9}|\*)\]\.leds\[(?:\d+|\*)\]\.")
_STEP: Final = re.compile(r"[^.\[\]]+")  # of a key path


def set_all(document: dict[str, Any], key: str, value: Any, origin: str) -> dict[str, Any]:
    """Tables in which a key is set, or each of those that it stands for by ``[*]``; LEDs of a ring need not be listed.

    Raises
    ------
    InputError
        If there is no such place.
    """
    document = with_all_leds(document, [key])
    try:
        keys = expanded(key, document)
    except InputError as error:
        raise InputError(error.what, where=f"{origin}: {shortened(key, 200)}") from error
    for one in keys:
        set_key(document, one, value, origin)
    return document


def set_key(document: Any, key: str, value: Any, origin: str) -> None:
    """Set one key path in a scene's tables; tables on the way are made, list entries must exist.

    Raises
    ------
    InputError
        If there is no such place.
    """
    where = f"{origin}: {shortened(key, 200)}"
    steps: list[str | int] = []
    for part in key.split("."):
        name, *indices = part.replace("]", "").split("[")
        numbers = [number for index in indices if (number := whole_number(index)) is not None]
        if not name or len(numbers) < len(indices):
            raise InputError(
                "is not a key path",
                where=where,
                remedy='write it as "camera.exposure_time" or "targets[0].pitch"',
            )
        steps += [name, *numbers]
    place = document
    for step in steps[:-1]:
        if isinstance(step, str) and isinstance(place, dict):
            place = place.setdefault(step, {})
        elif isinstance(step, int) and isinstance(place, list) and step < len(place):
            place = place[step]
        else:
            raise InputError("the scene has no such place", where=where)
    last = steps[-1]
    if isinstance(last, str) and isinstance(place, dict):  # noqa: SIM114  (a type checker needs them apart)
        place[last] = value
    elif isinstance(last, int) and isinstance(place, list) and last < len(place):
        place[last] = value
    else:
        raise InputError("the scene has no such place", where=where)


def with_all_leds(document: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """A scene's tables in which rings list every LED in order, where a key names LEDs: entry i then is LED i."""
    filled: dict[str, Any] = deepcopy(dict(document))
    sources = filled.get("sources", [])
    for key in keys:
        match = _LEDS.match(key)
        if match is None:
            continue
        chosen = range(len(sources)) if match[1] == "*" else [int(match[1])]
        for number in chosen:
            if number < len(sources) and isinstance(sources[number].get("count"), int):
                sources[number]["leds"] = _all_leds(sources[number])
    return filled


def _all_leds(ring: Mapping[str, Any]) -> list[dict[str, Any]]:
    given = {led.get("index"): led for led in ring.get("leds", []) if isinstance(led, dict)}
    return [dict(given.get(index, {"index": index})) for index in range(ring["count"])]


def expanded(key: str, document: Mapping[str, Any]) -> list[str]:
    """The keys that a key with ``[*]`` stands for; itself where it holds none.

    Raises
    ------
    InputError
        If there is no such list, or it is empty.
    """
    before, star, after = key.partition("[*]")
    if not star:
        return [key]
    entries = found(document, before)
    if not isinstance(entries, list) or not entries:
        raise InputError("names no entry of a list of the scene", where=key)
    return [full for number in range(len(entries)) for full in expanded(f"{before}[{number}]{after}", document)]


def found(document: Any, key: str) -> Any:
    """What stands at a key path; None where nothing does."""
    place = document
    for step in _STEP.findall(key):
        try:
            place = place[int(step)] if isinstance(place, list) else place[step]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return place


def steps_of(key: str) -> tuple[str | int, ...]:
    """A key path as names and numbers of entries."""
    return tuple(step if (number := whole_number(step)) is None else number for step in _STEP.findall(key))
