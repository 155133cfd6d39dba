"""A HID LampArray: a ring of lamps that says where each of them is.

Its semantics are the worst that the standard allows: report ids are not the
usual ones, it plays an effect of its own until the host takes over and
completes an update, and an update that comes too soon is lost.
"""

from __future__ import annotations

import math
import struct
import time

from radwrap.led.emulator.device import Identity, Stall

ATTRIBUTES, REQUEST, RESPONSE, MULTI_UPDATE, RANGE_UPDATE, CONTROL = 0x21, 0x22, 0x25, 0x33, 0x34, 0x40
_SLOTS = 8
_EFFECT = 0.1  # of full light, before the host takes over
_ILLUMINATION = 0x10


def _usages(*usages: int) -> bytes:
    return b"".join(bytes((0x09, usage)) for usage in usages)


def _field(bits: int, count: int) -> bytes:
    """Data, variable, absolute feature field; logical range 0 to all ones, of a u32 0 to 2^31 - 1."""
    largest = {8: b"\x26\xff\x00", 16: b"\x27\xff\xff\x00\x00", 32: b"\x27\xff\xff\xff\x7f"}[bits]
    return b"\x15\x00" + largest + bytes((0x75, bits, 0x95, count, 0xB1, 0x02))


def _report(number: int, usage: int, content: bytes) -> bytes:
    return bytes((0x85, number, 0x09, usage, 0xA1, 0x02)) + content + b"\xc0"


def descriptor() -> bytes:
    """Report descriptor, of the fields of HUTRR84 (usage page 0x59)."""
    attributes = _usages(0x03) + _field(16, 1) + _usages(0x04, 0x05, 0x06, 0x07, 0x08) + _field(32, 5)
    response = (
        _usages(0x21) + _field(16, 1) + _usages(0x23, 0x24, 0x25, 0x27, 0x26) + _field(32, 5)
        + _usages(0x28, 0x29, 0x2A, 0x2B, 0x2C, 0x2D) + _field(8, 6)
    )  # fmt: skip
    channels = _usages(0x51, 0x52, 0x53, 0x54)
    multi = _usages(0x03, 0x55) + _field(8, 2) + _usages(0x21) + _field(16, _SLOTS)
    multi += channels * _SLOTS + _field(8, 4 * _SLOTS)
    span = _usages(0x55) + _field(8, 1) + _usages(0x61, 0x62) + _field(16, 2) + channels + _field(8, 4)
    return (
        bytes((0x05, 0x59, 0x09, 0x01, 0xA1, 0x01))
        + _report(ATTRIBUTES, 0x02, attributes)
        + _report(REQUEST, 0x20, _usages(0x21) + _field(16, 1))
        + _report(RESPONSE, 0x22, response)
        + _report(MULTI_UPDATE, 0x50, multi)
        + _report(RANGE_UPDATE, 0x60, span)
        + _report(CONTROL, 0x70, _usages(0x71) + _field(8, 1))
        + b"\xc0"
    )


class LampRing:
    """Lamps evenly on a circle in the plane z = 0.

    Parameters
    ----------
    count : int
        Number of lamps.
    serial : str
        USB serial number.
    diameter : float
        Of the circle through the lamps [m].
    first_angle : float
        Angle of lamp 0 [rad].
    interval : float
        Least time between updates [s].
    """

    def __init__(
        self,
        count: int = 12,
        serial: str = "LA0001",
        diameter: float = 25e-3,
        first_angle: float = 0.0,
        interval: float = 5e-3,
    ) -> None:
        self.identity = Identity(0xCAFE, 0x4059, serial, "radwrap", "LampArray ring (emulated)", 0x59, 1)
        self.descriptor = descriptor()
        self._places = [
            tuple(
                round(1e6 * diameter / 2 * (1 + turn(first_angle + 2 * math.pi * n / count)))
                for turn in (math.cos, math.sin)
            )
            for n in range(count)
        ]
        self._box = round(1e6 * diameter)
        self._interval = interval
        self._asked = 0
        self._autonomous = True
        self._pending = [(0, 0, 0, 0)] * count
        self._shown = [_EFFECT] * count
        self._last_update = -math.inf

    def misbehave(self, how: str) -> None:
        """Of "shift": lamp 3 says that it is elsewhere."""
        if how != "shift":
            raise ValueError(how)
        self._places[3] = (self._places[3][0] + 2000, self._places[3][1])

    def light(self) -> tuple[float, ...]:
        """Mean light of each lamp."""
        return tuple(self._shown)

    def output(self, report: bytes) -> None:
        """There are none."""
        raise Stall

    def input(self) -> bytes | None:
        """There are none."""
        return None

    def get_feature(self, report_id: int) -> bytes:
        """Attributes of the array, or of the lamp that was asked for, and again of that one: some devices go on."""
        if report_id == ATTRIBUTES:
            interval = round(1e6 * self._interval)
            return struct.pack("<BH5I", ATTRIBUTES, len(self._shown), self._box, self._box, 0, 7, interval)
        if report_id == RESPONSE:
            lamp = self._asked
            x, y = self._places[lamp]
            head = struct.pack("<BH5I", RESPONSE, lamp, x, y, 0, 1000, _ILLUMINATION)
            return head + bytes((1, 1, 1, 255, 1, 0))
        raise Stall

    def set_feature(self, report: bytes) -> None:
        """Take a request, an update or the mode."""
        number, body = report[0], report[1:]
        sizes = {REQUEST: 2, MULTI_UPDATE: 50, RANGE_UPDATE: 9, CONTROL: 1}
        if len(body) != sizes.get(number):
            raise Stall
        if number == REQUEST:
            lamp = int.from_bytes(body, "little")
            self._asked = lamp if lamp < len(self._shown) else 0
        elif number == CONTROL:
            self._autonomous = bool(body[0])
            if self._autonomous:
                self._shown = [_EFFECT] * len(self._shown)
        elif not self._autonomous:
            self._update(number, body)

    def _update(self, number: int, body: bytes) -> None:
        if number == RANGE_UPDATE:
            flags, first, last = struct.unpack_from("<BHH", body)
            lamps, colours = tuple(range(first, last + 1)), [body[5:9]] * (last + 1 - first)
        else:
            used, flags = body[0], body[1]
            lamps = struct.unpack_from(f"<{_SLOTS}H", body, 2)[:used]
            colours = [body[18 + 4 * n : 22 + 4 * n] for n in range(used)]
        if any(lamp >= len(self._shown) for lamp in lamps):
            return
        for lamp, colour in zip(lamps, colours, strict=True):
            self._pending[lamp] = (colour[0], colour[1], colour[2], colour[3])
        now = time.monotonic()
        if flags & 1 and now - self._last_update >= self._interval:
            self._last_update = now
            self._shown = [max(r, g, b) / 255 * i / 255 for r, g, b, i in self._pending]
