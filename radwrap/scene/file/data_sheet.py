"""A data sheet: a TOML file whose keys are those of [camera.sensor]; what the scene says beside it counts more."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_toml
from radwrap.scene.catalog.component import CATALOG
from radwrap.scene.file.beside import named_file
from radwrap.units import LENGTH, parse_quantity

KEY = "data_sheet"
_DATA_SHEET: Final = FileKind("data sheet", 1 << 20)
_ONE: Final = "quantum_efficiency"
_TABLE: Final = "quantum_efficiencies"
_FILTERS: Final = "filters"
_ROUNDING: Final = 1e-9  # "650 nm" and "0.65 um" are one


def with_data_sheet(document: Mapping[str, Any], origin: str, folder: Path) -> Mapping[str, Any]:
    """The tables of a scene with the values of the data sheet that its sensor names, if it names one.

    Raises
    ------
    InputError
        If the file cannot be read, or names another one.
    """
    camera = document.get("camera")
    sensor = camera.get("sensor") if isinstance(camera, dict) else None
    name = sensor.get(KEY) if isinstance(sensor, dict) else None
    if not isinstance(camera, dict) or not isinstance(sensor, dict) or not isinstance(name, str):
        return document
    where = f"{origin}: camera.sensor.{KEY}"
    path = named_file(folder, name, where)
    sheet = read_toml(path, _DATA_SHEET, f'{where}: "{name}"')
    sheet.pop(CATALOG, None)  # where its values come from
    if KEY in sheet or "preset" in sheet:
        raise InputError(f'"{name}" names another sheet', where=where, remedy="spell its values out")
    return {**document, "camera": {**camera, "sensor": {**_without_replaced(sheet, sensor, where), **sensor}}}


def in_sheet(error: InputError, document: Mapping[str, Any], whole: Mapping[str, Any], origin: str) -> InputError:
    """An error of a sensor's key with the data sheet for its place, where the key stands there and not in the scene.

    Parameters
    ----------
    error : InputError
        About some key of the scene.
    document, whole : Mapping
        The scene's tables as written, and with the sheet's values.
    origin : str
        Name of the scene.
    """
    camera = document.get("camera")
    sensor = camera.get("sensor") if isinstance(camera, dict) else None
    if not isinstance(sensor, dict) or KEY not in sensor:
        return error
    place, told = f"{origin}: camera.sensor", f"{error.where}: {error.what}"
    for key in whole["camera"]["sensor"]:
        if key not in sensor and re.match(rf"{re.escape(place)}(\.|: ){re.escape(key)}\b", told):
            where = f'{place}.{KEY}: "{sensor[KEY]}": {error.where.removeprefix(place).lstrip(".") or key}'
            return InputError(error.what.removeprefix(f"{key}: "), where=where, remedy=error.remedy)
    return error


def _without_replaced(sheet: Mapping[str, Any], sensor: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The sheet without the efficiency that the scene tells its own way; one number holds at its wavelength alone."""
    if _ONE in sensor or _TABLE in sensor or _FILTERS in sensor:
        return {key: value for key, value in sheet.items() if key not in {_ONE, _TABLE}}
    if _ONE in sheet and "wavelength" in sheet and "wavelength" in sensor:
        try:
            told, asked = (parse_quantity(table["wavelength"], LENGTH) for table in (sheet, sensor))
        except InputError as error:
            raise InputError(f"wavelength: {error}", where=where) from error
        if not math.isclose(told, asked, rel_tol=_ROUNDING):
            raise InputError(
                f"its {_ONE} is that of {sheet['wavelength']}, the scene's wavelength is {sensor['wavelength']}",
                where=where,
                remedy=f"give {_ONE} beside the wavelength, or {_TABLE} in the sheet",
            )
    return dict(sheet)
