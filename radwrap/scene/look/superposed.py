"""Sources that fill the same place: their light adds up."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from radwrap.scene.sources import Emitter, Patch


def superposed(emitters: Iterable[Emitter]) -> tuple[tuple[Emitter, ...], ...]:
    """Shining emitters in groups that a tracer must hold as one surface, in order of their first members.

    The members of a group differ in name and radiance only. Dark emitters have no disc: they are left out.
    """
    groups: dict[Emitter, list[Emitter]] = {}
    for emitter in emitters:
        if emitter.radiance > 0:
            groups.setdefault(_place(emitter), []).append(emitter)
    return tuple(map(tuple, groups.values()))


def summed(group: Iterable[Emitter]) -> Emitter:
    """One emitter that shines as a group of `superposed` does, under the name of the first."""
    first, *others = group
    return replace(first, radiance=math.fsum((first.radiance, *(emitter.radiance for emitter in others))))


def _place(emitter: Emitter) -> Emitter:
    """The emitter without what may differ inside a group."""
    if isinstance(emitter, Patch):
        return replace(emitter, name="", radiance=1.0, whole="")
    return replace(emitter, name="", radiance=1.0)
