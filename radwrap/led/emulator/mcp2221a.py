"""The USB-to-I2C bridge MCP2221A with PCA9685 chips on its bus and a ring of LEDs behind them.

The LEDs are wired fail-safe: the chips' OE input has a pull-up, and GP0 of the
bridge, driven high by the host, lets them shine. A command that the bridge
accepts is not done yet: the bus takes its time, and only status tells the end.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from radwrap.led.emulator.device import Identity, Stall
from radwrap.led.emulator.pca9685 import Pca9685

_REPORT = 64
_WRITE_RESTART, _READ_RESTART, _WRITE_NO_STOP = 0x92, 0x93, 0x94
_IDLE, _BUSY_WRITING, _WAITS_FOR_DATA, _NO_STOP, _READING, _DATA_READY = 0x00, 0x21, 0x41, 0x45, 0x50, 0x55
_NACK, _CRASHED = 0x25, 0x62
_LARGEST_CHUNK = 60
_NOT_GPIO = 0xEE

# Vendor-defined usage; one input and one output report of 64 bytes, both without a number.
DESCRIPTOR: Final = bytes.fromhex("0600ff0901a1010902150026ff007508954081020903150026ff00750895409102c0")


@dataclass(slots=True)
class _Transfer:
    """A transfer on the bus, which lasts until a moment and then is carried out."""

    ends: float
    carry_out: Callable[[], int]


class Mcp2221Ring:
    """The bridge, one chip for every 16 LEDs, the LEDs.

    Parameters
    ----------
    count : int
        Number of LEDs, at most 16.
    serial : str
        USB serial number.
    address : int
        Of the chip on the bus.
    """

    def __init__(self, count: int = 12, serial: str = "0000000000", address: int = 0x40) -> None:
        self.identity = Identity(
            0x04D8, 0x00DD, serial, "Microchip Technology Inc.", "MCP2221 USB-I2C/UART Combo", 0xFF00, 1
        )
        self.descriptor = DESCRIPTOR
        self.chip = Pca9685(address)
        self._count = count
        self._deaf = False
        self._stuck = False
        self._power_up()

    def _power_up(self) -> None:
        self._replies: deque[bytes] = deque()
        self._pins = [0x02, 0x03, 0x02, 0x03]  # none of them GPIO
        self._divider = 0x76
        self._state = _IDLE
        self._used = False
        self._transfer: _Transfer | None = None
        self._advancing = threading.Lock()  # its light may be looked at while a heartbeat writes
        self._pending = bytearray()
        self._pending_length = 0
        self._data = b""

    def misbehave(self, how: str) -> None:
        """Make "nack", the chip no longer acknowledges, "ack", it does again, or "stick", GP0 stays as it is."""
        if how not in ("nack", "ack", "stick"):
            raise ValueError(how)
        self._deaf = how == "nack"
        self._stuck = how == "stick"

    def light(self) -> tuple[float, ...]:
        """Mean light of each LED; dark while GP0 is not driven high."""
        self._advance()
        gp0 = self._pins[0]
        enabled = gp0 & 0x07 == 0 and not gp0 & 0x08 and bool(gp0 & 0x10)
        return tuple(self.chip.duty(n) if enabled else 0.0 for n in range(self._count))

    def set_feature(self, report: bytes) -> None:
        """There are none."""
        raise Stall

    def get_feature(self, report_id: int) -> bytes:
        """There are none."""
        raise Stall

    def input(self) -> bytes | None:
        """The oldest reply that was not read yet."""
        return self._replies.popleft() if self._replies else None

    def output(self, report: bytes) -> None:
        """Take a command and reply at once, whatever the bus does."""
        self._advance()
        gp0 = self._pins[0]
        self._obey(report)
        if self._stuck:
            self._pins[0] = gp0

    def _obey(self, report: bytes) -> None:
        command = report.ljust(_REPORT, b"\0")
        match command[0]:
            case 0x10:
                reply = self._status(command)
            case 0x50:
                reply = self._set_gpio(command)
            case 0x51:
                reply = self._get_gpio()
            case 0x60:
                if command[7] & 0x80:
                    self._pins = [pin & 0x1F for pin in command[8:12]]
                reply = {}
            case 0x61:
                reply = {2: 18, 3: 4, 5: 0x12, 6: 0x88, **{22 + i: pin for i, pin in enumerate(self._pins)}}
            case 0x90 | 0x92 | 0x94:
                reply = self._write(command)
            case 0x91 | 0x93:
                reply = self._read(command)
            case 0x40:
                reply = self._get_data()
            case 0xB0:
                reply = self._flash(command[1])
            case 0x70:
                if bytes(command[1:4]) == b"\xab\xcd\xef":
                    self._power_up()
                return
            case _:
                reply = {1: 1}
        answer = bytearray(_REPORT)
        answer[0] = command[0]
        for place, value in reply.items():
            answer[place] = value
        self._replies.append(bytes(answer))

    def _status(self, command: bytes) -> dict[int, int]:
        reply: dict[int, int] = {}
        if command[2] == 0x10:
            reply[2] = self._cancel()
        if command[3] == 0x20:
            if self._state == _IDLE:
                self._divider, reply[3] = command[4], 0x20
            else:
                reply[3] = 0x21
        return {
            **reply,
            8: self._state,
            14: self._divider,
            18: 0x10,
            20: 0x40 if self._state == _NACK else 0,
            21: 0x60 if self._used else 0,
            22: 1,
            23: 1,
            25: 1 if self._state == _DATA_READY else 0,
            **dict(zip(range(46, 50), b"A612", strict=True)),
        }

    def _cancel(self) -> int:
        if not self._used:
            self._state = _CRASHED  # as the real one does when its engine was not used since power-up
            return 0x10
        if self._state == _CRASHED:
            return 0x10
        idle = self._state == _IDLE
        self._transfer, self._state, self._pending_length = None, _IDLE, 0
        return 0x11 if idle else 0x10

    def _set_gpio(self, command: bytes) -> dict[int, int]:
        reply: dict[int, int] = {}
        for pin in range(4):
            alter_out, out, alter_direction, direction = command[2 + 4 * pin : 6 + 4 * pin]
            gpio = self._pins[pin] & 0x07 == 0
            if alter_out:
                reply[2 + 4 * pin], reply[3 + 4 * pin] = (1, out) if gpio else (_NOT_GPIO, _NOT_GPIO)
                if gpio:
                    self._pins[pin] = (self._pins[pin] & ~0x10) | (0x10 if out else 0)
            if alter_direction:
                reply[4 + 4 * pin], reply[5 + 4 * pin] = (1, direction) if gpio else (_NOT_GPIO, _NOT_GPIO)
                if gpio:
                    self._pins[pin] = (self._pins[pin] & ~0x08) | (0x08 if direction else 0)
        return reply

    def _get_gpio(self) -> dict[int, int]:
        reply = {}
        for pin, setting in enumerate(self._pins):
            gpio = setting & 0x07 == 0
            reply[2 + 2 * pin] = setting >> 4 & 1 if gpio else _NOT_GPIO
            reply[3 + 2 * pin] = setting >> 3 & 1 if gpio else 0xEF
        return reply

    def _write(self, command: bytes) -> dict[int, int]:
        kind, length, address = command[0], command[1] | command[2] << 8, command[3] >> 1
        goes_on = self._state == _WAITS_FOR_DATA
        allowed = (_NO_STOP,) if kind == _WRITE_RESTART else (_IDLE, _WAITS_FOR_DATA)
        if self._state not in allowed:
            return {1: 1, 2: self._state}
        self._used = True
        if not goes_on:
            self._pending, self._pending_length = bytearray(), length
        missing = self._pending_length - len(self._pending)
        self._pending += command[4 : 4 + min(missing, _LARGEST_CHUNK)]
        if len(self._pending) < self._pending_length:
            self._state = _WAITS_FOR_DATA
            return {2: self._state}
        data, stops = bytes(self._pending), kind != _WRITE_NO_STOP
        self._begin(_BUSY_WRITING, len(data), lambda: self._carry_out_write(address, data, stops=stops))
        return {2: self._state}

    def _carry_out_write(self, address: int, data: bytes, *, stops: bool) -> int:
        if self._deaf or not self.chip.addressed(address, reading=False):
            return _NACK
        for value in data:
            self.chip.write(value)
        if not stops:
            return _NO_STOP
        self.chip.stop()
        return _IDLE

    def _read(self, command: bytes) -> dict[int, int]:
        kind, length, address = command[0], command[1] | command[2] << 8, command[3] >> 1
        if self._state != (_NO_STOP if kind == _READ_RESTART else _IDLE):
            return {1: 1, 2: self._state}
        self._used = True
        self._begin(_READING, length, lambda: self._carry_out_read(address, length))
        return {2: self._state}

    def _carry_out_read(self, address: int, length: int) -> int:
        if self._deaf or not self.chip.addressed(address, reading=True):
            return _NACK
        self._data = bytes(self.chip.read() for _ in range(min(length, _LARGEST_CHUNK)))
        self.chip.stop()
        return _DATA_READY

    def _get_data(self) -> dict[int, int]:
        if self._state != _DATA_READY:
            return {1: 0x41, 2: self._state, 3: 0x7F}
        data, self._data, self._state = self._data, b"", _IDLE
        return {2: _DATA_READY, 3: len(data), **dict(enumerate(data, 4))}

    def _flash(self, section: int) -> dict[int, int]:
        """USB strings in UTF-16, and the factory's serial; the rest is empty."""
        texts = {2: self.identity.manufacturer, 3: self.identity.name, 4: self.identity.serial}
        if section in texts:
            data = texts[section].encode("utf-16-le")
            return {2: len(data) + 2, 3: 3, **dict(enumerate(data, 4))}
        if section == 5:
            return {2: 8, 3: 3, **dict(enumerate(b"01234567", 4))}
        return {2: 4, 3: 0} if section in (0, 1) else {1: 1}

    def _begin(self, state: int, length: int, carry_out: Callable[[], int]) -> None:
        bits = 9 * (length + 1)
        self._state = state
        self._transfer = _Transfer(time.monotonic() + bits * (self._divider + 3) / 12e6, carry_out)

    def _advance(self) -> None:
        with self._advancing:
            if self._transfer is not None and time.monotonic() >= self._transfer.ends:
                transfer, self._transfer = self._transfer, None
                self._state = transfer.carry_out()
