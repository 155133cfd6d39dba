"""What a tolerance means in gray levels: a number of them, a share of the sensor's range, or of a frame's own noise.

Half a gray level is much of eight bits and nothing of twelve: where a camera's
noise is known, what a frame cannot show need not be traced.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import ROUND_DOWN, Decimal
from typing import Any, Final, Literal

from radwrap.errors import InputError
from radwrap.imaging.option_values import number_of
from radwrap.scene.camera import Sensor

# Gray levels rms of a camera of Eq. 5, of which no noise is known.
USUAL: Final = 0.5
FINEST: Final = 1e-3  # gray levels; the float32 of the tracer ends near there
COARSEST: Final = 1e6
# Of a linear camera the larger of: a share of one frame's temporal noise, and of the converter's range what USUAL is of
# eight bits.
_OF_NOISE: Final = 0.5
_OF_SCALE: Final = USUAL / 255
_DIGITS: Final = 2  # that are kept: a survey of the noise is not more exact
_LARGEST: Final = 100.0  # %, or times the noise
_SMALLEST: Final = 1e-6
_SPELLED: Final = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE]([+-]?[0-9]{1,3}))?\s*(%|noise)\s*", re.ASCII)
_LONGEST: Final = 60  # characters of a text that are repeated in a message
_REMEDY: Final = 'give gray levels (0.5), a share of the range ("0.2 %") or of the noise ("0.5 noise")'


@dataclass(frozen=True, slots=True)
class AskedTolerance:
    """A tolerance as it was asked for.

    Attributes
    ----------
    amount : float
        How much of it.
    unit : str
        "gray"; "%" of saturation minus dark; "noise", one frame's temporal noise, rms over the lit pixels; or
        "default", what is meant where nothing is asked for, with an amount of 1.
    """

    amount: float
    unit: Literal["gray", "%", "noise", "default"]

    def __str__(self) -> str:
        return "default" if self.unit == "default" else f"{self.amount:g} {self.unit}"

    def needs_noise(self, sensor: Sensor) -> bool:
        """Whether gray levels hang on the noise, which hangs on the light.

        Raises
        ------
        InputError
            If they do, and nothing is known of the camera's noise.
        """
        if self.unit == "noise" and sensor.linear is None:
            raise InputError(
                "the power law has no noise to be a share of",
                where="tolerance",
                remedy='give gray levels (0.5) or a share of the range ("0.2 %"), or describe the camera with '
                'model = "linear"',
            )
        return sensor.linear is not None and self.unit in {"noise", "default"}

    def in_gray(self, sensor: Sensor, noise: float = 0.0) -> float:
        """The tolerance in gray levels, rounded down to two digits where it was not given so.

        Parameters
        ----------
        sensor : Sensor
            Whose range counts.
        noise : float
            Temporal noise of one frame, rms over the lit pixels [gray level]; without it the tolerance is the least
            that it can be.
        """
        match self.unit:
            case "gray":
                return self.amount
            case "%":
                found = self.amount / 100 * (sensor.saturation_gray - sensor.dark_gray)
            case "noise":
                found = self.amount * noise
            case "default":
                if sensor.linear is None:
                    return USUAL
                found = max(_OF_NOISE * noise, _OF_SCALE * (2.0**sensor.bit_depth - 1))
        return min(max(_rounded_down(found), FINEST), COARSEST)


def asked_tolerance(value: Any, where: str = "tolerance") -> AskedTolerance:
    """Read a tolerance: None for the default, a number of gray levels, or a text with a unit.

    Raises
    ------
    InputError
        If it is none of these, or out of range.
    """
    if value is None:
        return AskedTolerance(1.0, "default")
    if not isinstance(value, str):
        return AskedTolerance(float(number_of(value, where, FINEST, COARSEST, whole=False)), "gray")
    found = _SPELLED.fullmatch(value)
    if found is None:
        raise InputError(f'"{value[:_LONGEST]}" is not a tolerance', where=where, remedy=_REMEDY)
    amount = float(f"{found[1]}e{found[2] or 0}")
    unit: Literal["%", "noise"] = "%" if found[3] == "%" else "noise"
    if not _SMALLEST <= amount <= _LARGEST:
        raise InputError(f"must lie between {_SMALLEST:g} and {_LARGEST:g} {unit}, not {amount:g}", where=where)
    return AskedTolerance(amount, unit)


def _rounded_down(value: float) -> float:
    if value <= 0 or not math.isfinite(value):
        return value
    # Of what differs in the last place of a float only, both come out alike; .29 stays .29.
    exact = Decimal(repr(float(f"{value:.12g}")))
    step = Decimal(1).scaleb(exact.adjusted() - _DIGITS + 1)
    return float(exact.quantize(step, rounding=ROUND_DOWN))
