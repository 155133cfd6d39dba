"""The user's scene file with other values: comments, order and layout stay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

from radwrap.scene.file.keys import expanded, steps_of

_NOTHING: Final[Mapping[str, Any]] = {}


def with_values(
    text: str, values: Mapping[str, Any], removed: Sequence[str] = (), whole: Mapping[str, Any] = _NOTHING
) -> str:
    """Replace values in the text of a scene file; what it does not have yet is added to its table.

    Parameters
    ----------
    text : str
        A scene file that was read.
    values : Mapping[str, Any]
        Key path -> value as the file would hold it.
    removed : sequence of str
        Key paths that it has no more.
    whole : Mapping[str, Any]
        Tables of the scene, from which a list comes that the text leaves at its default.
    """
    import tomlkit

    document = tomlkit.parse(text)
    for key, value in values.items():
        # An LED that the file does not list is none of the entries that [*] names.
        for one in expanded(key, document.unwrap()) if ".leds[*]" not in key else [key]:
            _set(document, steps_of(one), value, whole)
    for key in removed:
        place: Any = document
        steps = steps_of(key)
        for step in steps[:-1]:
            place = place[step]
        place.pop(steps[-1], None)
    return tomlkit.dumps(document)


def text_of(document: Mapping[str, Any]) -> str:
    """A scene file of tables that have no text yet."""
    import tomlkit

    return tomlkit.dumps(dict(document))


def _set(document: Any, steps: tuple[str | int, ...], value: Any, whole: Mapping[str, Any]) -> None:
    import tomlkit

    place = document
    for number, (step, following) in enumerate(pairwise(steps), start=1):
        if isinstance(step, int):
            place = place[step]
        elif step == "leds" and isinstance(following, int):
            place = _Leds(place)
        else:
            if step not in place:
                place[step] = _at(whole, steps[:number]) if isinstance(following, int) else tomlkit.table()
            place = place[step]
    place[steps[-1]] = value


def _at(tables: Any, steps: tuple[str | int, ...]) -> Any:
    for step in steps:
        tables = tables[step]
    return tables


class _Leds:
    """LEDs of a ring by their index, listed or not."""

    def __init__(self, ring: Any) -> None:
        self._ring = ring

    def __getitem__(self, index: int) -> Any:
        import tomlkit

        if "leds" not in self._ring:
            self._ring["leds"] = tomlkit.array()
        leds = self._ring["leds"]
        for led in leds:
            if led.get("index") == index:
                return led
        made: Any = tomlkit.inline_table() if isinstance(leds, tomlkit.items.Array) else tomlkit.table()
        made["index"] = index
        leds.append(made)
        return leds[-1]
