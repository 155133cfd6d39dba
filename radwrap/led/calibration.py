"""Calibrations: from measured tables, inverted for a wanted light, written and read back."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.led.drive import decimal
from radwrap.manifest import json_text
from radwrap.reading import CSV, csv_rows, read_text, shortened
from radwrap.scene.file.ring_calibration import IS, SCHEMA_VERSION, LedTable, RingCalibration, read_calibration
from radwrap.units import RADIANT_INTENSITY, parse_quantity

_COLUMNS: Final = ("led", "level", "radiant_intensity")
_ERROR: Final = "standard_error"
_LED_NUMBER: Final = re.compile(r"0*[0-9]{1,4}", re.ASCII)


def levels_for(calibration: RingCalibration, radiant_intensity: Sequence[float]) -> tuple[float, ...]:
    """Level of each LED that gives a radiant intensity.

    Parameters
    ----------
    calibration : RingCalibration
        Of the ring.
    radiant_intensity : sequence of float
        Of each LED along its axis; 0 is off [W sr^-1].

    Raises
    ------
    InputError
        If there are too few or too many, or one lies outside what was measured.
    """
    if len(radiant_intensity) != len(calibration.leds):
        raise InputError(f"{len(radiant_intensity)} radiant intensities for {len(calibration.leds)} LEDs")
    levels = []
    for number, (table, wanted) in enumerate(zip(calibration.leds, radiant_intensity, strict=True)):
        try:
            levels.append(table.level(wanted))
        except InputError as error:
            raise InputError(error.what, where=f"LED {number}", remedy=error.remedy) from error
    return tuple(levels)


def read_table(path: Path) -> tuple[LedTable, ...]:
    """Read measured radiant intensities, of a photodiode for instance.

    Parameters
    ----------
    path : Path
        CSV file with the columns led (0, 1, ...), level (0 to 1), radiant_intensity (with unit) and, where known,
        standard_error (with unit).

    Raises
    ------
    InputError
        With line and column, or which LED's table is not monotone.
    """
    table = csv_rows(read_text(path, CSV), str(path), initial_space=True)
    _, header = next(table, (1, []))
    unknown = [name for name in header if name not in (*_COLUMNS, _ERROR)]
    if unknown or any(name not in header for name in _COLUMNS) or len(set(header)) < len(header):
        raise InputError(
            f"has the columns {', '.join(map(shortened, header))}",
            where=f"{path}: line 1",
            remedy=f"write {', '.join(_COLUMNS)} and, where known, {_ERROR}",
        )
    rows = [_row(header, cells, f"{path}: line {line}") for line, cells in table]
    count = max((led for led, *_ in rows), default=-1) + 1
    if not count:
        raise InputError("holds no row", where=str(path))
    return tuple(_table(led, rows, f"{path}: LED {led}") for led in range(count))


def _table(led: int, rows: Sequence[tuple[int, float, float, float]], where: str) -> LedTable:
    own = sorted(row[1:] for row in rows if row[0] == led)
    try:
        return LedTable(*(tuple(column) for column in zip(*own, strict=True)) if own else ((), (), ()))
    except InputError as error:
        raise InputError(error.what, where=where, remedy=error.remedy or "measure it again") from error


def _row(header: Sequence[str], row: Sequence[str], where: str) -> tuple[int, float, float, float]:
    if len(row) != len(header):
        raise InputError("has a different number of cells from the first line", where=where)
    cells = dict(zip(header, (cell.strip() for cell in row), strict=True))
    if not _LED_NUMBER.fullmatch(cells["led"]) or int(cells["led"]) >= 4096:
        raise InputError(f'"{shortened(cells["led"])}" is not the number of an LED', where=f'{where}, column "led"')
    level = decimal(cells["level"], f'{where}, column "level"')
    try:
        intensity = parse_quantity(cells["radiant_intensity"], RADIANT_INTENSITY)
        error = parse_quantity(cells[_ERROR], RADIANT_INTENSITY) if cells.get(_ERROR) else 0.0
    except InputError as wrong:
        raise InputError(wrong.what, where=where, remedy=wrong.remedy) from wrong
    return int(cells["led"]), level, intensity, error


def scaled(
    radiant_intensity: Sequence[float], standard_error: Sequence[float], levels: Sequence[float]
) -> tuple[LedTable, ...]:
    """Tables of LEDs measured at one level each: proportional to it, which PWM at a constant current is nearly.

    Parameters
    ----------
    radiant_intensity : sequence of float
        Of each LED at its level [W sr^-1].
    standard_error : sequence of float
        Of each [W sr^-1].
    levels : sequence of float
        Level of each measurement, above 0 to 1; the tables end there.
    """
    return tuple(
        LedTable((0.0, level), (0.0, intensity), (0.0, error))
        for level, intensity, error in zip(levels, radiant_intensity, standard_error, strict=True)
    )


def write_calibration(path: Path, calibration: RingCalibration) -> None:
    """Write a calibration, whole or not at all, and make sure that it reads back the same."""
    told = {"is": IS, "schema_version": SCHEMA_VERSION, **asdict(calibration)}
    write_bytes(path, json_text(told).encode())
    if read_calibration(path) != calibration:
        raise InputError("does not read back as it was written", where=str(path))
