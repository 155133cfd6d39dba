"""A data sheet: a TOML file whose keys are those of [camera.sensor]; what the scene says beside it counts more."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from radwrap.errors import InputError
from radwrap.scene.beside import named_file

KEY = "data_sheet"


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
    try:
        sheet = tomllib.loads(path.read_bytes().decode("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f'"{name}" is no TOML file: {error}', where=where) from error
    if KEY in sheet or "preset" in sheet:
        raise InputError(f'"{name}" names another sheet', where=where, remedy="spell its values out")
    return {**document, "camera": {**camera, "sensor": {**sheet, **sensor}}}
