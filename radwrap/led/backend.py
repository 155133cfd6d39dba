"""What a ring's electronics can do, whatever they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from radwrap.errors import EnvironmentFailure

Kind = Literal["mcp2221a_pca9685", "lamparray"]


class PortFailure(EnvironmentFailure):
    """A device cannot be reached, was lost, or does not answer."""


class DeviceFailure(EnvironmentFailure):
    """The device answers, but not as it must."""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a device can do.

    Attributes
    ----------
    kind : str
        Its electronics.
    serial : str
        USB serial number, empty where it has none.
    count : int
        Number of LEDs.
    steps : int
        A level is a whole number of steps, from 0 to this.
    atomic : bool
        Whether all LEDs change together.
    readback : bool
        Whether it tells what it was set to; else a frame is commanded, and never verified.
    update_interval : float
        Least time between frames [s].
    pwm_frequency : float or None
        Nominal; None where it is not known [Hz].
    positions : tuple of tuple of float, or None
        Where each LED says it is [m]; None where it does not say.
    emulated : bool
        Whether it is software.
    """

    kind: Kind
    serial: str
    count: int
    steps: int
    atomic: bool
    readback: bool
    update_interval: float
    pwm_frequency: float | None
    positions: tuple[tuple[float, float, float], ...] | None
    emulated: bool


class Backend(Protocol):
    """The electronics of a ring; opening it turned every LED off."""

    capabilities: Capabilities

    def show(self, steps: Sequence[int]) -> tuple[int, ...]:
        """Set every LED, all together where the device can; returns what it now holds, as far as it tells.

        Raises
        ------
        PortFailure, DeviceFailure
            If the device is lost, refuses, or holds something else.
        """

    def readback(self) -> tuple[int, ...] | None:
        """Steps of each LED as the device holds them; None where it does not tell."""

    def off(self) -> None:
        """Every LED off, whatever state the device is in; verified where it can be."""

    def close(self) -> None:
        """Let the device go, as it is."""
