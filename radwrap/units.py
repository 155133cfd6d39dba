"""Quantities as users write them: one finite number, one blank, one unit.

Inside radwrap every number is in SI units and radians. This module is the
border: ``"12.5 mm"`` comes in, ``0.0125`` goes on. The grammar is our own and
strict, because general parsers guess: they take "12,5 mm" for 125 mm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType
from typing import Final

from radwrap.errors import InputError

_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
ONE_IN: Final = r"1/[1-9][0-9]{0,3}"  # a scale
_QUANTITY: Final = re.compile(rf"({_NUMBER}) (\S+)")


@dataclass(frozen=True, slots=True)
class Dimension:
    """The units that one kind of quantity accepts.

    Attributes
    ----------
    name : str
        What the quantity is, for messages.
    units : Mapping[str, float]
        Unit symbol -> size of that unit in SI.
    """

    name: str
    units: Mapping[str, float]

    @property
    def pattern(self) -> str:
        """Regular expression of the whole string, for JSON schemas."""
        symbols = "|".join(re.escape(unit) for unit in self.units)
        return f"^{_NUMBER} (?:{symbols})$"


def _dimension(name: str, units: dict[str, float]) -> Dimension:
    return Dimension(name, MappingProxyType(units))


LENGTH: Final = _dimension(
    "length",
    {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "km": 1e3, "in": 0.0254, "ft": 0.3048},
)
ANGLE: Final = _dimension(
    "angle",
    {"deg": math.pi / 180, "rad": 1.0, "mrad": 1e-3, "arcmin": math.pi / 10800, "arcsec": math.pi / 648000},
)
SPEED: Final = _dimension(
    "speed",
    {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "um/s": 1e-6, "m/min": 1 / 60, "in/s": 0.0254, "ft/min": 0.3048 / 60},
)
ANGULAR_VELOCITY: Final = _dimension("angular velocity", {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30})
TIME: Final = _dimension("time", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9})
RADIANCE: Final = _dimension(
    "radiance", {"W/m^2/sr": 1.0, "mW/m^2/sr": 1e-3, "kW/m^2/sr": 1e3, "W/cm^2/sr": 1e4, "mW/mm^2/sr": 1e3}
)
RADIANT_INTENSITY: Final = _dimension("radiant intensity", {"W/sr": 1.0, "mW/sr": 1e-3, "uW/sr": 1e-6})
RADIANT_FLUX: Final = _dimension("radiant flux", {"W": 1.0, "mW": 1e-3, "uW": 1e-6})
LUMINANCE: Final = _dimension("luminance", {"cd/m^2": 1.0, "kcd/m^2": 1e3, "cd/cm^2": 1e4})
LUMINOUS_INTENSITY: Final = _dimension("luminous intensity", {"cd": 1.0, "mcd": 1e-3, "kcd": 1e3})
LUMINOUS_FLUX: Final = _dimension("luminous flux", {"lm": 1.0, "mlm": 1e-3, "klm": 1e3})
EFFICACY: Final = _dimension("luminous efficacy", {"lm/W": 1.0})
COEFFICIENT_OF_RETROREFLECTION: Final = _dimension(
    "coefficient of retroreflection", {"cd/lx/m^2": 1.0, "1/sr": 1.0, "mcd/lx/m^2": 1e-3}
)
CURRENT: Final = _dimension("electric current", {"A": 1.0, "mA": 1e-3, "uA": 1e-6})
PIXEL: Final = _dimension("position on the sensor", {"px": 1.0})
ELECTRONS: Final = _dimension("number of electrons", {"e": 1.0, "ke": 1e3})
ELECTRON_RATE: Final = _dimension("dark current", {"e/s": 1.0, "e/ms": 1e3, "ke/s": 1e3})
SYSTEM_GAIN: Final = _dimension("system gain", {"DN/e": 1.0, "DN/ke": 1e-3})
# Only differences matter, so the zero of the scale does not.
TEMPERATURE: Final = _dimension("temperature", {"degC": 1.0})
TEMPERATURE_DIFFERENCE: Final = _dimension("temperature difference", {"K": 1.0})
CURVATURE: Final = _dimension("radial distortion", {"1/m^2": 1.0, "1/cm^2": 1e4, "1/mm^2": 1e6})
DIMENSIONS: Final = (
    LENGTH,
    ANGLE,
    TIME,
    RADIANCE,
    RADIANT_INTENSITY,
    RADIANT_FLUX,
    LUMINANCE,
    LUMINOUS_INTENSITY,
    LUMINOUS_FLUX,
    COEFFICIENT_OF_RETROREFLECTION,
    PIXEL,
    ELECTRONS,
    ELECTRON_RATE,
    SYSTEM_GAIN,
    TEMPERATURE,
    TEMPERATURE_DIFFERENCE,
    CURVATURE,
    SPEED,
    ANGULAR_VELOCITY,
)


def _finite(number: str) -> float:
    """Read a decimal number that neither overflows nor vanishes."""
    value = float(number)
    mantissa = re.split("[eE]", number)[0]
    if math.isinf(value) or (value == 0.0 and re.search("[1-9]", mantissa)):
        raise InputError(f'"{number}" lies outside the range of numbers a computer holds')
    return value


def parse_quantity(text: object, dimension: Dimension) -> float:
    """Convert a quantity as the user wrote it to SI.

    Parameters
    ----------
    text : object
        What stands in the file; only a string can be right.
    dimension : Dimension
        The kind of quantity that is due.

    Returns
    -------
    float
        The value in SI units (radians for angles).

    Raises
    ------
    InputError
        If it is not one finite number, one blank and one unit of `dimension`.
    """
    units = ", ".join(dimension.units)
    if not isinstance(text, str) or re.fullmatch(_NUMBER, text):
        raise InputError(
            f"{_quoted(text)} has no unit", remedy=f'write it as "NUMBER UNIT"; units of {dimension.name}: {units}'
        )
    match = _QUANTITY.fullmatch(text)
    if match is None:
        usual = "mm" if "mm" in dimension.units else next(iter(dimension.units))
        raise InputError(
            f'"{text}" is not a {dimension.name}',
            remedy=f'write "NUMBER UNIT" with one blank, such as "12.5 {usual}"; units: {units}',
        )
    number, unit = match.groups()
    if unit not in dimension.units:
        raise InputError(f'"{unit}" is not a unit of {dimension.name}', remedy=f"use one of: {units}")
    value = _finite(number)
    # In decimal, so that "13.75 um" becomes the double nearest to 13.75e-6.
    converted = float(Decimal(number) * Decimal(repr(dimension.units[unit])))
    if math.isinf(converted) or (converted == 0.0 and value != 0.0):
        raise InputError(f'"{text}" lies outside the range of numbers a computer holds')
    return converted


_GAIN: Final = re.compile(rf"({_NUMBER}) \(J/m\^2\)\^-({_NUMBER})")


def dimension_of(value: object) -> Dimension | None:
    """The dimension of a quantity, None where it is none."""
    unit = value.partition(" ")[2] if isinstance(value, str) else ""
    return next((dimension for dimension in DIMENSIONS if unit in dimension.units), None)


def parse_gain(text: object) -> tuple[float, float]:
    """Read the sensor gain K of Eq. 5, whose unit carries gamma.

    Parameters
    ----------
    text : object
        Such as ``"3.38e4 (J/m^2)^-0.85"``.

    Returns
    -------
    tuple of float
        K [gray (J m^-2)^-gamma], and the gamma that its unit names.

    Raises
    ------
    InputError
        If the string is not of that form.
    """
    match = _GAIN.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        raise InputError(
            f"{_quoted(text)} is not a sensor gain K",
            remedy='write K with its unit, which holds gamma: "3.38e4 (J/m^2)^-0.85"',
        )
    return _finite(match[1]), _finite(match[2])


def _quoted(value: object) -> str:
    """A value for a message; of a text between such quotes only the beginning is shown where it is long."""
    return f'"{value}"' if isinstance(value, str) else repr(value)
