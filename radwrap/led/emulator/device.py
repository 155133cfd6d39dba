"""What every emulated device has in common: identity, faults on demand, and the light it gave."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

_REPORTS_KEPT: Final = 64  # for each handle, as hidraw keeps them


class Stall(Exception):
    """The device refuses the request; the bus goes on."""


class Unplugged(Exception):
    """There is no device any more."""


class Frozen(Exception):
    """The device does not answer at all."""


@dataclass(frozen=True, slots=True)
class Identity:
    """How a device names itself.

    Attributes
    ----------
    vendor, product : int
        USB ids.
    serial, manufacturer, name : str
        USB strings.
    usage_page, usage : int
        Of the first collection of its report descriptor.
    """

    vendor: int
    product: int
    serial: str
    manufacturer: str
    name: str
    usage_page: int
    usage: int


class Device(Protocol):
    """A HID device as its firmware sees the bus; reports carry their id first where they are numbered."""

    identity: Identity
    descriptor: bytes

    def output(self, report: bytes) -> None:
        """Take an output report."""

    def input(self) -> bytes | None:
        """Give the next input report, None where there is none yet."""

    def set_feature(self, report: bytes) -> None:
        """Take a feature report; `Stall` where there is no such."""

    def get_feature(self, report_id: int) -> bytes:
        """Give a feature report; `Stall` where there is no such."""

    def light(self) -> tuple[float, ...]:
        """Mean light of each LED, as a share of full."""

    def misbehave(self, how: str) -> None:
        """Make a fault that only this kind of device has."""


class Unit:
    """One device that can be unplugged, plugged in again, frozen and stalled.

    Parameters
    ----------
    make : callable
        Makes the device as it is after power-up.
    """

    def __init__(self, make: Callable[[], Device]) -> None:
        self._make = make
        self.device = make()
        self.plugged = True
        self.plug_count = 1
        self.frozen = False
        self._stalls = 0
        self._reports_left: int | None = None
        self._history = [(time.monotonic(), self.device.light())]

    def misbehave(self, how: str) -> None:
        """Make or end a fault.

        "unplug", "plug", "freeze", "thaw", "stall N" (the next N requests are refused), "unplug after N" (reports
        that the host sends), or what the device itself knows.
        """
        words = how.split()
        match words:
            case ["unplug"]:
                self.plugged = False
            case ["plug"]:
                # Without power its registers forget.
                self.device, self.plugged, self.frozen = self._make(), True, False
                self._stalls, self._reports_left = 0, None
                self.plug_count += 1
            case ["freeze"]:
                self.frozen = True
            case ["thaw"]:
                self.frozen = False
            case ["stall", number]:
                self._stalls = int(number)
            case ["unplug", "after", number]:
                self._reports_left = int(number)
            case _:
                self.device.misbehave(how)
        self.light()

    def light(self) -> tuple[float, ...]:
        """Light of each LED now; an unplugged one is dark."""
        now = self.device.light()
        if not self.plugged:
            now = (0.0,) * len(now)
        if now != self._history[-1][1]:
            self._history.append((time.monotonic(), now))
        return now

    @property
    def history(self) -> tuple[tuple[float, tuple[float, ...]], ...]:
        """Time of the monotonic clock [s], and the light from then on."""
        self.light()
        return tuple(self._history)

    def output(self, report: bytes) -> None:
        """Pass an output report on."""
        self._check(sent=True)
        self.device.output(report)
        self.light()

    def input(self) -> bytes | None:
        """The next input report; None while there is none, or the device is frozen."""
        if not self.plugged:
            raise Unplugged
        return None if self.frozen else self.device.input()

    def set_feature(self, report: bytes) -> None:
        """Pass a feature report on."""
        self._check(sent=True)
        self.device.set_feature(report)
        self.light()

    def get_feature(self, report_id: int) -> bytes:
        """Ask for a feature report."""
        self._check(sent=False)
        return self.device.get_feature(report_id)

    def _check(self, *, sent: bool) -> None:
        if self._reports_left is not None and sent:
            if self._reports_left == 0:
                self.plugged, self._reports_left = False, None
            else:
                self._reports_left -= 1
        if not self.plugged:
            self.light()
            raise Unplugged
        if self.frozen:
            raise Frozen
        if self._stalls:
            self._stalls -= 1
            raise Stall


class Handles:
    """Every handle of a device gets every input report, whoever asked for it, as with hidraw.

    Parameters
    ----------
    unit : Unit
        The device.
    """

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._kept: dict[int, deque[bytes]] = {}

    def open(self, handle: int) -> None:
        """A handle gets reports from now on."""
        self._kept[handle] = deque(maxlen=_REPORTS_KEPT)

    def close(self, handle: int) -> None:
        """It gets no more."""
        self._kept.pop(handle, None)

    def input(self, handle: int) -> bytes | None:
        """The oldest report that this handle has not read; None where there is none."""
        while (report := self._unit.input()) is not None:
            for kept in self._kept.values():
                kept.append(report)
        own = self._kept[handle]
        return own.popleft() if own else None
