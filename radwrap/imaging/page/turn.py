"""Knobs as a person turns them, and what they are in words of the scene file and of the command line.

A turn of the sensor keeps what is physical about it. Another gamma keeps the radiant exposure of saturation, as K's
unit goes with gamma; other bits scale gain, dark level and saturation, as a converter with finer steps would.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import shortened
from radwrap.scene.camera import Camera

_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_LARGEST_FACTOR: Final = 1e6
MOST_BITS: Final = 16
_LONGEST: Final = 64  # characters of a knob's text: no number that is meant needs more


@dataclass(frozen=True, slots=True)
class Turn:
    """Where the knobs stand.

    Attributes
    ----------
    factors : tuple of float
        On the radiance of each source as it is in the scene.
    exposure_time : str or None
        As the scene file would hold it; None as it is in the scene.
    gain : float
        Factor on the gain.
    gamma : float or None
        Exponent; None as it is in the scene.
    dark_gray : float or None
        Gray level without light, of a linear camera its offset, in gray levels of the scene's own bits; likewise.
    bit_depth : int or None
        Bits of the output; likewise.
    """

    factors: tuple[float, ...]
    exposure_time: str | None = None
    gain: float = 1.0
    gamma: float | None = None
    dark_gray: float | None = None
    bit_depth: int | None = None


def turn_of(told: Any, sources: Sequence[str]) -> Turn:
    """A turn as a page tells it: ``{"levels": [...], "knobs": {"gain": "1.2", ...}}``.

    Raises
    ------
    InputError
        If anything is not as it must be; its `where` is the knob's name.
    """
    if not isinstance(told, Mapping) or not set(told) <= {"levels", "knobs"}:
        raise InputError("is not a turn of knobs", where="turn")
    levels, knobs = told.get("levels", [1.0] * len(sources)), told.get("knobs", {})
    if not isinstance(levels, list) or len(levels) != len(sources):
        raise InputError(f"there must be {len(sources)} numbers", where="levels")
    factors = tuple(_level(value, name) for value, name in zip(levels, sources, strict=True))
    known = ("exposure_time", "gain", "gamma", "dark_gray", "bit_depth")
    if not isinstance(knobs, Mapping) or not set(knobs) <= set(known):
        raise InputError(f"known are {', '.join(known)}", where="knobs")
    for name, value in knobs.items():
        if not isinstance(value, str):
            raise InputError("must be a text", where=name)
        if len(value.strip()) > _LONGEST:
            what = f'must be at most {_LONGEST} characters long, not "{shortened(value)}"'
            raise InputError(what, where=name)
    bits = _knob(knobs, "bit_depth", 1, MOST_BITS)
    if bits is not None and bits != int(bits):
        raise InputError(f'must be a whole number, not "{shortened(knobs["bit_depth"])}"', where="bit_depth")
    gain = _knob(knobs, "gain", 1e-6, _LARGEST_FACTOR)
    return Turn(
        factors,
        exposure_time=knobs.get("exposure_time"),
        gain=1.0 if gain is None else gain,
        gamma=_knob(knobs, "gamma", 0.01, 10.0),
        dark_gray=_knob(knobs, "dark_gray", 0.0, 65535.0),
        bit_depth=None if bits is None else int(bits),
    )


def _level(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= _LARGEST_FACTOR:
        raise InputError(f"must be a number from 0 to {_LARGEST_FACTOR:g}", where=f"level {name}")
    return float(value)


def _knob(knobs: Mapping[str, str], name: str, low: float, high: float) -> float | None:
    if name not in knobs:
        return None
    text = knobs[name].strip()
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not low <= value <= high:
        raise InputError(f'must be a number from {low:g} to {high:g}, not "{shortened(text)}"', where=name)
    return value


def changes_of(turn: Turn, camera: Camera) -> dict[str, Any]:
    """Keys of the scene file that a turn changes, in terms of the scene's own camera; empty where nothing is turned."""
    sensor = camera.sensor
    found: dict[str, Any] = {}
    if turn.exposure_time is not None:
        found["camera.exposure_time"] = turn.exposure_time.strip()
    gamma = sensor.gamma if turn.gamma is None else turn.gamma
    bits = sensor.bit_depth if turn.bit_depth is None else turn.bit_depth
    scale = 1.0 if bits == sensor.bit_depth else (2.0**bits - 1) / (2.0**sensor.bit_depth - 1)
    linear = sensor.linear
    dark_now = sensor.dark_gray if linear is None else linear.offset
    dark = dark_now if turn.dark_gray is None else turn.dark_gray
    if bits != sensor.bit_depth:
        found["camera.sensor.bit_depth"] = bits
    if gamma != sensor.gamma:
        found["camera.sensor.gamma"] = gamma
    if linear is not None:
        if turn.gain * scale != 1.0:
            found["camera.sensor.system_gain"] = f"{linear.system_gain * turn.gain * scale!r} DN/e"
        if dark * scale != dark_now:
            found["camera.sensor.offset"] = dark * scale
        return found
    if (turn.gain * scale, gamma) != (1.0, sensor.gamma):
        full = ((sensor.saturation_gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma)
        gain = turn.gain * scale * sensor.gain * full ** (sensor.gamma - gamma)
        found["camera.sensor.gain"] = f"{gain!r} (J/m^2)^-{gamma!r}"
    if dark * scale != dark_now:
        found["camera.sensor.dark_gray"] = dark * scale
    if scale != 1.0:
        found["camera.sensor.saturation_gray"] = sensor.saturation_gray * scale
    return found


def relight_words(basis: str, out: str, sources: Sequence[str], turn: Turn, changes: Mapping[str, Any]) -> list[str]:
    """The words of the command that makes the same gray.png from a basis' folder."""
    words = ["radwrap", "relight", basis]
    for name, factor in levels_in_short(sources, turn).items():
        words += ["--level", f"{name}={factor!r}"]
    for key, value in changes.items():
        words += ["--set", f"{key}={value if isinstance(value, str) else repr(value)}"]
    return [*words, "--out", out]


def relight_python(
    basis: str,
    out: str,
    sources: Sequence[str],
    turn: Turn,
    changes: Mapping[str, Any],
    *,
    scene_folder: str | None = None,
) -> str:
    """The Python expression that writes the same gray.png from a basis' folder."""
    more = [repr(one) for one in (levels_in_short(sources, turn), dict(changes)) if one or changes]
    more += [] if scene_folder is None else [f"scene_folder={scene_folder!r}"]
    return f"radwrap.relight({', '.join([repr(basis), *more])}).gray.save({out!r})"


def levels_in_short(sources: Sequence[str], turn: Turn) -> dict[str, float]:
    """Levels that are turned, that of a ring by its own name where all its LEDs have one."""
    rest = dict(zip(sources, turn.factors, strict=True))
    found: dict[str, float] = {}
    for ring, names in rings_of(sources).items():
        if len({rest[name] for name in names}) == 1 and rest[names[0]] != 1.0:
            found[ring] = rest[names[0]]
            rest.update(dict.fromkeys(names, 1.0))
    return found | {name: factor for name, factor in rest.items() if factor != 1.0}


def rings_of(sources: Sequence[str]) -> dict[str, list[str]]:
    """Name of each ring -> its sources."""
    found: dict[str, list[str]] = {}
    for name in sources:
        ring, dot, _ = name.rpartition(".")
        if dot:
            found.setdefault(ring, []).append(name)
    return found


def spelled(*commands: Sequence[str]) -> str:
    """Commands as a shell takes them, each only if the one before succeeded."""
    return " && ".join(shlex.join(words) for words in commands if words)
