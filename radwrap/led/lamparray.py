"""A ring that is a HID LampArray (usage page 0x59, hutrr84): 8 bit, and it says where its lamps are.

Report ids and the order of fields come from the device's descriptor; a device
whose reports are not as the standard has them is refused. It does not tell
its levels: a frame is commanded, and never verified.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence
from typing import Final

from radwrap.led.backend import Capabilities, DeviceFailure, PortFailure
from radwrap.led.ports import Port
from radwrap.led.report_descriptor import FeatureReport, Field, feature_reports

STEPS: Final = 255
USAGE_PAGE, USAGE = 0x59, 0x01
_PAGE = USAGE_PAGE << 16
_LAMP_ID, _FLAGS = 0x21, 0x55
_CHANNELS = (0x51, 0x52, 0x53, 0x54)
_COMPLETE = 1
_MICRO = 1e-6
_MOST_LAMPS = 4096
_LONGEST_INTERVAL = 1.0  # s; a device that asks for more is none for measurements
_PACE = 1.2  # of the least interval: its clock and ours differ
_AGAIN = 0.05  # s between two attempts


def _fields(*sized: tuple[int, Sequence[int]]) -> list[Field]:
    return [Field(_PAGE | usage, bits) for bits, usages in sized for usage in usages]


# Usage of each report's collection, and its fields; of the update, for one slot.
_ATTRIBUTES, _REQUEST, _RESPONSE, _UPDATE, _CONTROL = 0x02, 0x20, 0x22, 0x50, 0x70
_LAYOUTS: Final = {
    _ATTRIBUTES: _fields((16, (0x03,)), (32, (0x04, 0x05, 0x06, 0x07, 0x08))),
    _REQUEST: _fields((16, (_LAMP_ID,))),
    _RESPONSE: _fields(
        (16, (_LAMP_ID,)),
        (32, (0x23, 0x24, 0x25, 0x27, 0x26)),
        (8, (0x28, 0x29, 0x2A, 0x2B, 0x2C, 0x2D)),
    ),
    _CONTROL: _fields((8, (0x71,))),
}


def is_lamparray(descriptor: bytes) -> bool:
    """Whether a descriptor begins with the usage of a LampArray; the system's own word is missing with libusb."""
    return descriptor[:4] == bytes((0x05, USAGE_PAGE, 0x09, USAGE))


def reports_of(descriptor: bytes) -> dict[int, FeatureReport]:
    """The reports of a LampArray, by the usage of their collections.

    Raises
    ------
    DeviceFailure
        If one is missing or has other fields than the standard's.
    """
    try:
        reports = feature_reports(descriptor)
    except ValueError as error:
        raise DeviceFailure(f"its report descriptor is broken: {error}", where="LampArray") from error
    found = {each.collection & 0xFFFF: each for each in reports if each.collection >> 16 == USAGE_PAGE}
    for usage in (*_LAYOUTS, _UPDATE):
        if usage not in found:
            raise DeviceFailure(f"has no feature report with the usage 0x{usage:02X}", where="LampArray")
        wanted = _LAYOUTS.get(usage) or _update_layout(found[usage])
        if found[usage].fields != wanted:
            raise DeviceFailure(f"its report with the usage 0x{usage:02X} has other fields", where="LampArray")
    return found


def _slots(update: FeatureReport) -> int:
    return sum(each.usage == _PAGE | _LAMP_ID for each in update.fields)


def _update_layout(update: FeatureReport) -> list[Field]:
    slots = _slots(update)
    return _fields((8, (0x03, _FLAGS)), (16, [_LAMP_ID] * slots), (8, _CHANNELS * slots))


class LampArray:
    """The device; made, its lamps are ours and dark.

    Parameters
    ----------
    port : Port
        To the device; closed with this object.
    count : int
        Number of lamps that it must have.
    serial : str
        For the capabilities.
    emulated : bool
        Likewise.

    Raises
    ------
    PortFailure, DeviceFailure
        If the device does not answer as it must.
    """

    def __init__(self, port: Port, count: int, *, serial: str = "", emulated: bool = False) -> None:
        self._port = port
        self._reports = reports_of(port.descriptor())
        self._last = time.monotonic()
        lamps, _, _, _, _, interval = struct.unpack("<H5I", self._get(_ATTRIBUTES))
        self._interval = interval * _MICRO
        if lamps != count or not 1 <= lamps <= _MOST_LAMPS:
            raise DeviceFailure(f"has {lamps} lamps, not {count}", where="LampArray", remedy=f"give `count={lamps}`")
        if self._interval > _LONGEST_INTERVAL:
            raise DeviceFailure(f"takes {self._interval:g} s from frame to frame", where="LampArray")
        self._count = count
        self.off()
        positions, by_intensity = self._attributes()
        self._by_intensity = by_intensity
        self.capabilities = Capabilities(
            kind="lamparray",
            serial=serial,
            count=count,
            steps=STEPS,
            atomic=True,
            readback=False,
            update_interval=self._interval,
            pwm_frequency=None,
            positions=positions,
            emulated=emulated,
        )

    def show(self, steps: Sequence[int]) -> tuple[int, ...]:
        """Send the lamps in groups; the last one completes the frame, and all change."""
        wanted = tuple(steps)
        if any(not 0 <= level <= STEPS for level in wanted):
            raise ValueError(f"steps {wanted}")
        self._update([self._colour(level) for level in wanted])
        return wanted

    def readback(self) -> None:
        """The device does not tell."""

    def off(self) -> None:
        """Every lamp dark, the device's own effects too."""
        self._set(_CONTROL, b"\0")
        self._update([bytes(4)] * self._count)

    def close(self) -> None:
        """Let the device go; its own effects stay off, since they could light the ring."""
        self._port.close()

    def _colour(self, level: int) -> bytes:
        if level == 0:
            return bytes(4)
        return bytes((255, 255, 255, level)) if self._by_intensity else bytes((level, level, level, 255))

    def _update(self, colours: Sequence[bytes]) -> None:
        report = self._reports[_UPDATE]
        slots = _slots(report)
        # One that comes too soon may be lost, after another program's too.
        time.sleep(max(0.0, self._last + _PACE * self._interval - time.monotonic()))
        for first in range(0, self._count, slots):
            lamps = list(range(first, min(first + slots, self._count)))
            complete = _COMPLETE if lamps[-1] == self._count - 1 else 0
            unused = slots - len(lamps)
            numbers = struct.pack(f"<{slots}H", *lamps, *[0] * unused)
            levels = b"".join(colours[lamp] for lamp in lamps) + bytes(4 * unused)
            self._set(_UPDATE, bytes((len(lamps), complete)) + numbers + levels)
        self._last = time.monotonic()

    def _attributes(self) -> tuple[tuple[tuple[float, float, float], ...], bool]:
        positions, by_intensity = [], True
        for lamp in range(self._count):
            # Some devices go on to the next lamp by themselves, some do not.
            self._set(_REQUEST, lamp.to_bytes(2, "little"))
            values = struct.unpack("<H5I6B", self._get(_RESPONSE))
            if values[0] != lamp:
                raise DeviceFailure(f"was asked for lamp {lamp} and reported lamp {values[0]}", where="LampArray")
            positions.append((values[1] * _MICRO, values[2] * _MICRO, values[3] * _MICRO))
            by_intensity = by_intensity and values[9] > 1
            if not values[10]:
                raise DeviceFailure(f"lamp {lamp} cannot be set", where="LampArray")
        return tuple(positions), by_intensity

    def _get(self, usage: int) -> bytes:
        report = self._reports[usage]
        answer = self._port.get_feature(report.number, report.size)
        if len(answer) < report.size or answer[0] != report.number:
            raise DeviceFailure(f"answered {len(answer)} bytes to report {report.number}", where="LampArray")
        return answer[1 : report.size]

    def _set(self, usage: int, body: bytes) -> None:
        """Send a report; a refused one is sent once more."""
        report = bytes((self._reports[usage].number,)) + body
        try:
            self._port.set_feature(report)
        except PortFailure:
            time.sleep(_AGAIN)
            self._port.set_feature(report)
