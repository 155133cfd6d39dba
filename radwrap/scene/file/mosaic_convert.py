"""From the validated table of a sensor's colour filters to their values in SI."""

from __future__ import annotations

import math
from pathlib import Path

from radwrap.scene.file.curve_files import curve_beside
from radwrap.scene.file.mosaic_tables import FilterModel
from radwrap.scene.file.sensor_tables import LinearSensorModel, SensorModel
from radwrap.scene.mosaic import COLOURS, Filter, Mosaic
from radwrap.scene.spectrum import Curve


def mosaic_from_table(table: SensorModel | LinearSensorModel, where: str, folder: Path) -> Mosaic | None:
    """The mosaic of a sensor whose pixels have several filters; None where they are all alike.

    Raises
    ------
    InputError
        If the file of a filter is no table.
    """
    if table.filters is None or table.pattern is None:
        return None
    relative = None
    wavelength = math.nan
    if isinstance(table, LinearSensorModel):
        wavelength = table.wavelength
        shares = table.filters.efficiencies(wavelength)
        red, green, blue = (share / max(shares) for share in shares)
        relative = red, green, blue
    filters = {
        colour: _nodes(getattr(table.filters, colour), wavelength, f"{where}.filters.{colour}", folder)
        for colour in COLOURS
    }
    return Mosaic(table.pattern, **filters, relative=relative)


def filter_curve(table: FilterModel, where: str, folder: Path) -> Curve | None:
    """What a filter lets through over wavelength; None where that is told of one wavelength.

    Raises
    ------
    InputError
        If its file is no table.
    """
    if table.spectral_response is not None:
        return curve_beside(table.spectral_response.file, folder, f"{where}.spectral_response")
    if table.quantum_efficiencies is None:
        return None
    nodes, values = zip(*table.quantum_efficiencies, strict=True)
    return Curve(nodes, values)


def _nodes(table: FilterModel, wavelength: float, where: str, folder: Path) -> Filter:
    curve = filter_curve(table, where, folder)
    if curve is None:
        return ((wavelength, table.efficiency_at(wavelength)),)
    return tuple(zip(curve.wavelengths, curve.values, strict=True))
