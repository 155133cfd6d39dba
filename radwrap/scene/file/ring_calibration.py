"""What each LED of a real ring shines at each level, as it was measured; a scene can take it for its ring."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_json
from radwrap.written import read_back

_CALIBRATION: Final = FileKind("ring calibration", 16 << 20, "see `radwrap led calibrate`")
SCHEMA_VERSION: Final = 1
IS: Final = "ring_calibration"


@dataclass(frozen=True, slots=True)
class LedTable:
    """One LED: radiant intensity along its axis against level.

    Attributes
    ----------
    levels : tuple of float
        Increasing, within 0 to 1.
    radiant_intensity : tuple of float
        Strictly increasing, not negative [W sr^-1].
    standard_error : tuple of float
        Of each radiant intensity [W sr^-1].
    """

    levels: tuple[float, ...]
    radiant_intensity: tuple[float, ...]
    standard_error: tuple[float, ...]

    def __post_init__(self) -> None:
        if not 2 <= len(self.levels) == len(self.radiant_intensity) == len(self.standard_error):
            raise InputError("needs two or more levels, and as many radiant intensities and standard errors")
        if not all(map(math.isfinite, (*self.levels, *self.radiant_intensity, *self.standard_error))):
            raise InputError("holds a number that is not finite")
        for name, values in (("levels", self.levels), ("radiant intensities", self.radiant_intensity)):
            if values[0] < 0 or any(a >= b for a, b in pairwise(values)):
                raise InputError(f"its {name} must start at 0 or above and increase")
        if self.levels[0] == 0 and self.radiant_intensity[0] > 0:
            raise InputError(
                f"its radiant intensity is {self.radiant_intensity[0]:g} W/sr at level 0, where it is dark",
                remedy="subtract from all what was measured at level 0",
            )
        if self.levels[-1] > 1 or min(self.standard_error) < 0:
            raise InputError("levels must not exceed 1, and standard errors not be negative")

    def intensity(self, level: float) -> float:
        """Radiant intensity at a level, linear between the measured ones [W sr^-1]; 0 at 0, which is dark.

        Raises
        ------
        InputError
            If the level lies outside the table.
        """
        return 0.0 if level == 0 else _between(self.levels, self.radiant_intensity, level, "level", "")

    def level(self, radiant_intensity: float) -> float:
        """Level that gives a radiant intensity [W sr^-1]; 0 for 0.

        Raises
        ------
        InputError
            If the radiant intensity lies outside the table.
        """
        if radiant_intensity == 0:
            return 0.0
        return _between(self.radiant_intensity, self.levels, radiant_intensity, "radiant intensity", " W/sr")


# A value this much beyond the table's end is the end: sums were rounded.
_ROUNDING: Final = 1e-9


def _between(xs: Sequence[float], ys: Sequence[float], x: float, what: str, unit: str) -> float:
    slack = _ROUNDING * xs[-1]
    if not xs[0] - slack <= x <= xs[-1] + slack:
        raise InputError(
            f"the {what} {x:.6g}{unit} lies outside what was measured, {xs[0]:.6g} to {xs[-1]:.6g}{unit}",
            remedy="a calibration does not reach beyond its table",
        )
    x = min(max(x, xs[0]), xs[-1])
    right = min(max(bisect_right(xs, x), 1), len(xs) - 1)
    share = (x - xs[right - 1]) / (xs[right] - xs[right - 1])
    return ys[right - 1] + share * (ys[right] - ys[right - 1])


@dataclass(frozen=True, slots=True)
class RingCalibration:
    """A ring as it was measured.

    Attributes
    ----------
    leds : tuple of LedTable
        In the order of the ring's LEDs.
    serial : str
        Of the device that drove them.
    date : str
        When, as ISO 8601.
    temperature : float or None
        Of the ring's surroundings [K].
    current : float
        That flowed while an LED was on [A].
    emulated : bool
        Whether the device was software.
    source : str
        How it was made, in a sentence.
    """

    leds: tuple[LedTable, ...]
    serial: str
    date: str
    temperature: float | None
    current: float
    emulated: bool
    source: str

    def intensities(self, levels: Sequence[float]) -> tuple[float, ...]:
        """Radiant intensity of each LED at its level [W sr^-1].

        Raises
        ------
        InputError
            If there are too few or too many levels, or one lies outside its table.
        """
        if len(levels) != len(self.leds):
            raise InputError(f"{len(levels)} levels for {len(self.leds)} LEDs")
        found = []
        for number, (table, level) in enumerate(zip(self.leds, levels, strict=True)):
            try:
                found.append(table.intensity(level))
            except InputError as error:
                raise InputError(error.what, where=f"LED {number}", remedy=error.remedy) from error
        return tuple(found)


@dataclass(frozen=True, slots=True)
class _LedFile:
    levels: list[float]
    radiant_intensity: list[float]
    standard_error: list[float]


@dataclass(frozen=True, slots=True)
class _RingFile:
    leds: list[_LedFile]
    serial: str
    date: str
    temperature: float | None
    current: float
    emulated: bool
    source: str


def read_calibration(path: Path) -> RingCalibration:
    """Read a calibration that ``radwrap led calibrate`` wrote.

    Raises
    ------
    InputError
        If the file is not there, or not whole.
    """
    told = read_json(path, _CALIBRATION)
    if not isinstance(told, dict) or told.get("is") != IS or told.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"is not a ring calibration of schema version {SCHEMA_VERSION}", where=str(path))
    read_back(told, _RingFile, str(path))
    try:
        return _calibration(told)
    except InputError as error:
        where = f"{path}: {error.where}" if error.where else str(path)
        raise InputError(error.what, where=where, remedy=error.remedy) from error
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"is not a complete calibration: {error!r}", where=str(path)) from error


def _calibration(told: dict[str, Any]) -> RingCalibration:
    tables = []
    for number, led in enumerate(told["leds"]):
        columns = (tuple(map(float, led[key])) for key in ("levels", "radiant_intensity", "standard_error"))
        try:
            tables.append(LedTable(*columns))
        except InputError as error:
            raise InputError(error.what, where=f"leds[{number}]", remedy=error.remedy) from error
    temperature = told["temperature"]
    current = float(told["current"])
    if not tables or not (math.isfinite(current) and current > 0):
        raise InputError("needs LEDs, and a current above zero")
    if temperature is not None and not (math.isfinite(float(temperature)) and float(temperature) > 0):
        raise InputError("must be above zero", where="temperature")
    return RingCalibration(
        leds=tuple(tables),
        serial=str(told["serial"]),
        date=str(told["date"]),
        temperature=None if temperature is None else float(temperature),
        current=current,
        emulated=bool(told["emulated"]),
        source=str(told["source"]),
    )
