"""Knobs that need rays: pose, opening, focus and targets, as the scene file has them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.scene.scene import Scene

# None of them names a file, and none changes which sources there are.
_CAMERA: Final = (
    *("position", "look_at", "rotation", "focal_length"),
    *("lens.focus_distance", "lens.f_number", "aperture.diameter"),
)
_TARGET: Final = ("position", "rotation")
_LONGEST: Final = 200  # letters
Value = str | float | list[str]


def ray_knobs(scene: Scene) -> dict[str, str]:
    """Key of the scene file -> its value as a text, numbers of a vector with commas between them."""
    return {key: ", ".join(value) if isinstance(value, list) else str(value) for key, value in _values(scene)}


def _values(scene: Scene) -> Iterator[tuple[str, Value]]:
    document = json.loads(scene.document)
    tables: list[tuple[str, Any, tuple[str, ...]]] = [("camera", document["camera"], _CAMERA)]
    tables += [(f"targets[{k}]", table, _TARGET) for k, table in enumerate(document.get("targets", []))]
    for place, table, names in tables:
        for name in names:
            value: Any = table
            for step in name.split("."):
                value = value.get(step) if isinstance(value, dict) else None
            texts = isinstance(value, list) and all(isinstance(one, str) for one in value)
            if texts or (isinstance(value, str | int | float) and not isinstance(value, bool)):
                yield f"{place}.{name}", value


def ray_changes(told: Any, scene: Scene) -> dict[str, Value]:
    """Keys that a page turns, with values as a scene file has them; those that stand as they were are left out.

    Raises
    ------
    InputError
        If anything is no such knob, or no text of so many parts.
    """
    known = dict(_values(scene))
    if not isinstance(told, Mapping) or not set(told) <= set(known):
        raise InputError(f"known are {', '.join(known)}", where="rays")
    found: dict[str, Value] = {}
    for key, text in told.items():
        if not isinstance(text, str) or len(text) > _LONGEST:
            raise InputError(f"must be a text of at most {_LONGEST} letters", where=key)
        before = known[key]
        parts = [part.strip() for part in text.split(",")]
        if isinstance(before, list) and len(parts) != len(before):
            raise InputError(f"needs {len(before)} values with commas between them", where=key)
        value = parts if isinstance(before, list) else text.strip() if isinstance(before, str) else _number(text, key)
        if value != before:
            found[key] = value
    return found


def _number(text: str, key: str) -> float:
    """Of a knob without a unit."""
    try:
        found = float(text)
    except ValueError as error:
        raise InputError("must be a number without a unit", where=key) from error
    return int(found) if found.is_integer() else found
