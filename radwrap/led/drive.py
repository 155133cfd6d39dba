"""What a ring may do: its LEDs' data, the limits on light, and what PWM does to an exposure.

A drive file is TOML, flat::

    count = 12
    wavelength = "850 nm"
    rated_current = "100 mA"   # the LED's data sheet: continuous, at the temperature it will have
    drive_current = "50 mA"    # what flows while an LED is on, set by resistors or current sources
    max_level = 0.5            # of each LED; 1 is on all the time
    max_sum = 6.0              # of all levels together: the supply's limit
    max_on_time = "20 s"       # then the ring is turned off
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from radwrap.errors import InputError
from radwrap.reading import FileKind, read_toml
from radwrap.scene.file.border import Current, Duration, Model, Number, Size, Whole
from radwrap.scene.file.faults import validated

_DRIVE_FILE: Final = FileKind(
    "drive file", 1 << 20, "without the LEDs' rated current there is no light: docs/led.md shows a drive file"
)
_REMEDY: Final = "docs/led.md shows a drive file"
_DECIMAL: Final = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
# From the shortest ultraviolet to the longest infrared of LEDs: beyond, a unit is wrong.
_SHORTEST, _LONGEST_WAVE = 200e-9, 20e-6  # m
# A ripple below one is not seen beside quantisation to 8 bit; above the other a capture says nothing of the light.
_RIPPLE_TOLD: Final = 0.01
_RIPPLE_REFUSED: Final = 0.1
# Sums of levels that were rounded to steps may exceed a limit by as much.
_ROUNDING: Final = 1e-9


class _DriveModel(Model):
    """A drive file: kinds of values, whose ranges `Drive` knows."""

    count: Whole
    wavelength: Size
    rated_current: Current
    drive_current: Current
    max_level: Number
    max_sum: Number
    max_on_time: Duration


@dataclass(frozen=True, slots=True)
class Drive:
    """The LEDs and what they may do.

    Attributes
    ----------
    count : int
        Number of LEDs.
    wavelength : float
        Of their peak [m]; for records and eye safety.
    rated_current : float
        Largest continuous current of an LED, by its data sheet [A].
    drive_current : float
        What flows while an LED is on, as the hardware sets it [A].
    max_level : float
        Largest level of an LED; 1 is on all the time.
    max_sum : float
        Largest sum of levels.
    max_on_time : float
        Longest time for which any LED is on without an order [s].
    """

    count: int
    wavelength: float
    rated_current: float
    drive_current: float
    max_level: float
    max_sum: float
    max_on_time: float

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 4096:
            raise InputError(f"must lie between 1 and 4096, not {self.count}", where="count")
        for name in ("wavelength", "rated_current", "drive_current", "max_sum", "max_on_time"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError("must be above zero", where=name)
        if not _SHORTEST <= self.wavelength <= _LONGEST_WAVE:
            raise InputError(
                f"{self.wavelength:g} m is not a wavelength of an LED", where="wavelength", remedy='such as "850 nm"'
            )
        if not 0 < self.max_level <= 1:
            raise InputError(f"must lie above 0 and not above 1, not {self.max_level}", where="max_level")
        if self.drive_current > self.rated_current:
            raise InputError(
                f"is {self.drive_current:g} A, the LEDs are rated for {self.rated_current:g} A",
                where="drive_current",
                remedy="lower the current in the hardware; a smaller level does not protect an LED from its peak",
            )

    def check(self, levels: Sequence[float]) -> None:
        """Refuse levels beyond the limits.

        Parameters
        ----------
        levels : sequence of float
            Of each LED, 0 to 1.

        Raises
        ------
        InputError
            If there are too few or too many, one is no share, or a limit is exceeded.
        """
        if len(levels) != self.count:
            raise InputError(f"{len(levels)} levels for {self.count} LEDs")
        for number, level in enumerate(levels):
            if not (math.isfinite(level) and 0 <= level <= 1):
                raise InputError(f"{level:g} is not a level: they go from 0 to 1", where=f"LED {number}")
            if level > self.max_level + _ROUNDING:
                raise InputError(f"level {level:.4g} is above max_level, {self.max_level:g}", where=f"LED {number}")
        total = math.fsum(levels)
        if total > self.max_sum + _ROUNDING:
            raise InputError(f"the levels' sum, {total:.4g}, is above max_sum, {self.max_sum:g}")

    def to_steps(self, levels: Sequence[float], full: int) -> tuple[int, ...]:
        """Whole steps for levels: the nearest, and lower ones where those would exceed a limit.

        Parameters
        ----------
        levels : sequence of float
            Of each LED, 0 to 1.
        full : int
            Steps of the device at level 1.

        Raises
        ------
        InputError
            As `check`, or if an LED that is to shine would be dark.
        """
        self.check(levels)
        most = math.floor(full * (self.max_level + _ROUNDING))
        steps = [min(round(full * level), most) for level in levels]
        excess = sum(steps) - math.floor(full * (self.max_sum + _ROUNDING))
        # Those first that were rounded up most; all of them rounded down are no more than what was asked for.
        rounded_up = sorted(range(len(steps)), key=lambda led: full * levels[led] - steps[led])
        for led in rounded_up[: max(excess, 0)]:
            steps[led] -= 1
        for led, level in enumerate(levels):
            if level > 0 and not steps[led]:
                raise InputError(
                    f"level {level:.4g} is not a whole step of this device, 1/{full}: it would be dark",
                    where=f"LED {led}",
                    remedy=f"give 0, or {1 / full:.2g} or more within the limits",
                )
        return tuple(steps)


def decimal(text: str, where: str = "") -> float:
    """A level or a factor as one writes it: a decimal number from 0 on, in digits that everybody reads alike.

    Raises
    ------
    InputError
        If it is another text, such as "1_0" or "nan".
    """
    value = float(text) if _DECIMAL.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise InputError(f'"{text}" is not a number of 0 or more: write 0.25', where=where)
    return value


def read_drive(path: str | Path) -> Drive:
    """Read a drive file.

    Raises
    ------
    InputError
        What is wrong, with file and key.
    """
    path = Path(path)
    told = validated(_DriveModel, read_toml(path, _DRIVE_FILE), str(path), _REMEDY)
    try:
        return Drive(**dict(told))
    except InputError as error:
        raise InputError(error.what, where=f"{path}: {error.where}", remedy=error.remedy) from error


def ripple(levels: Sequence[float], pwm_frequency: float, exposure_time: float) -> float:
    """Largest relative error that PWM can make in an exposure, of the worst LED: (1 - d) P/T.

    Parameters
    ----------
    levels : sequence of float
        Duty cycles d of the LEDs; those off or always on make none.
    pwm_frequency : float
        1/P [Hz].
    exposure_time : float
        T [s].

    Notes
    -----
    An exposure holds a whole number of periods and a rest r < P; in the rest an LED is on for at most
    min(r, d P) instead of d r, so that the error is at most d (1 - d) P of d T.
    """
    pulsed = [level for level in levels if 0 < level < 1]
    return max((1 - level for level in pulsed), default=0.0) / (pwm_frequency * exposure_time)


def check_ripple(levels: Sequence[float], pwm_frequency: float | None, exposure_time: float) -> str | None:
    """What is to be told of PWM against an exposure time; None where it does not matter.

    Raises
    ------
    InputError
        If the ripple makes captures worthless.
    """
    if pwm_frequency is None:
        if any(0 < level < 1 for level in levels):
            return "the device does not report its PWM frequency, so it is not known how even an exposure is"
        return None
    error = ripple(levels, pwm_frequency, exposure_time)
    if error > _RIPPLE_REFUSED:
        enough = _shortest_exposure(levels, pwm_frequency)
        raise InputError(
            f"PWM of {pwm_frequency:.0f} Hz makes an exposure of {exposure_time:g} s uncertain by {100 * error:.2g} %",
            remedy=f"expose for {enough:.2g} s or longer, or gate the LEDs by the camera",
        )
    if error > _RIPPLE_TOLD:
        return f"PWM of {pwm_frequency:.0f} Hz makes the exposure uncertain by up to {100 * error:.2g} %"
    return None


def _shortest_exposure(levels: Sequence[float], pwm_frequency: float) -> float:
    """Exposure time of which the ripple's share need not be reported [s]; the share falls as 1/time."""
    return ripple(levels, pwm_frequency, 1.0) / _RIPPLE_TOLD
