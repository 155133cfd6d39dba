"""The tables [responses.NAME] of a design: each is a column or more of the study's table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.nearest import did_you_mean
from radwrap.study.repeatability import FEWEST_FRAMES, MOST_FRAMES
from radwrap.study.responses import KINDS, REPEATABILITY, Response, check_options, unit_of
from radwrap.study.user_function import PREFIX, read_user_function

_LONGEST_UNIT: Final = 20


def read_responses(tables: Mapping[str, Mapping[str, Any]], home: Path, where: str) -> tuple[Response, ...]:
    """What a study reads from each image.

    Parameters
    ----------
    tables : Mapping
        Name -> what and how.
    home : Path
        Folder of the design.
    where : str
        Place for messages.

    Raises
    ------
    InputError
        Naming the table and the key.
    """
    if not tables:
        raise InputError("there is none", where=where)
    found: list[Response] = []
    for name, given in tables.items():
        place = f"{where}.{name}"
        table = dict(given)
        frames = _frames(table.pop("frames", 0), f"{place}.frames") if "frames" in table else 0
        measure = table.pop("measure", None)
        if isinstance(measure, str) and measure.startswith(PREFIX):
            own = _of_user(name, measure, table, home, place)
        else:
            own = [_known(name, measure, table, place)]
        found += [replace(response, frames=frames) for response in own]
        if frames:
            scattered = (replace(one, name=one.name + REPEATABILITY, repeatability=True) for one in own)
            found += [replace(response, frames=frames) for response in scattered]
    return tuple(found)


def _known(name: str, kind: Any, table: dict[str, Any], place: str) -> Response:
    if not isinstance(kind, str) or kind not in KINDS:
        known = ", ".join((*KINDS, f"{PREFIX}FILE.py:FUNCTION"))
        near = did_you_mean(kind, KINDS)
        raise InputError(f"must be one of {known}", where=f"{place}.measure", remedy=near)
    unit = table.pop("unit", None)
    check_options(kind, table, place)
    return Response(name, kind, unit_of(kind, unit, f"{place}.unit"), table)


def _of_user(name: str, measure: str, table: dict[str, Any], home: Path, place: str) -> list[Response]:
    unit = table.pop("unit", "")
    if not isinstance(unit, str) or not unit.isprintable() or len(unit) > _LONGEST_UNIT or set(unit) & set("[],"):
        raise InputError(f"{unit!r} cannot be used in a column's heading", where=f"{place}.unit")
    function = read_user_function(measure, table, home, place)
    return [Response(key, function.name, unit, table=name, user=function) for key in function.keys]


def _frames(given: Any, where: str) -> int:
    if isinstance(given, bool) or not isinstance(given, int) or not FEWEST_FRAMES <= given <= MOST_FRAMES:
        raise InputError(f"must be a whole number from {FEWEST_FRAMES} to {MOST_FRAMES}", where=where)
    return given
