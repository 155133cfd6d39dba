"""A ring on a PWM chip PCA9685 behind the USB-to-I2C bridge MCP2221A.

All LEDs change together, at the end of one write of 49 bytes, which fits into
one HID report. GP0 of the bridge enables the outputs: low, or without USB
power, the ring is dark. Sources: mcp2221a, pca9685.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from radwrap.led.backend import Capabilities, DeviceFailure, PortFailure
from radwrap.led.ports import Port

VENDOR, PRODUCT = 0x04D8, 0x00DD
CHANNELS: Final = 16
STEPS: Final = 4096
ADDRESS: Final = 0x40

_REPORT = 64
_STATUS, _SET_GPIO, _GET_GPIO, _SET_SRAM, _GET_SRAM, _GET_DATA = 0x10, 0x50, 0x51, 0x60, 0x61, 0x40
_WRITE, _WRITE_NO_STOP, _READ_RESTART = 0x90, 0x94, 0x93
_CANCEL, _SET_SPEED = 0x10, 0x20
_IDLE, _NO_STOP, _NACK, _DATA_READY = 0x00, 0x45, 0x25, 0x55
_TIMEOUTS = (0x12, 0x17, 0x23, 0x33, 0x44, 0x52, 0x62)
_BUS_FREQUENCY = 100e3  # Hz: safe on any wiring; a frame takes 5 ms
_OUTPUT_HIGH, _OUTPUT_LOW = 0x10, 0x00

_MODE1, _MODE2, _FIRST_LED, _ALL_LED_OFF_HIGH, _PRESCALE = 0x00, 0x01, 0x06, 0xFD, 0xFE
_ASLEEP, _AWAKE, _FULL = 0x10, 0x20, 0x10  # awake: with auto-increment
_TOTEM_POLE = 0x04  # change at STOP, drive both ways, low while OE is high
_FASTEST = 3
_FREQUENCY = 25e6 / (STEPS * (_FASTEST + 1))  # Hz, of the internal oscillator, which may be some per cent off
_WAKING = 1e-3  # s

_ANSWER = 2.0  # s; the bridge answers within a millisecond or two, a starved virtual machine in a second
_TRANSFER = 0.2  # s; the longest one lasts 6 ms
_AGAIN = 0.05  # s between two attempts


def frame(steps: Sequence[int]) -> bytes:
    """The write that sets LEDs 0, 1, ...: register, then ON and OFF of each, phases staggered to spread the current.

    Parameters
    ----------
    steps : sequence of int
        Of each LED, 0 to 4096.
    """
    data = bytearray((_FIRST_LED,))
    for number, level in enumerate(steps):
        if not 0 <= level <= STEPS:
            raise ValueError(f"LED {number}: {level} steps")
        on = number * STEPS // len(steps)
        off = (on + level) % STEPS
        if level == 0:
            data += bytes((0, 0, 0, _FULL))
        elif level == STEPS:
            data += bytes((0, _FULL, 0, 0))
        else:
            data += on.to_bytes(2, "little") + off.to_bytes(2, "little")
    return bytes(data)


def steps_of(registers: bytes) -> tuple[int, ...]:
    """Steps of each LED that its four registers mean."""
    steps = []
    for place in range(0, len(registers), 4):
        on, off = (int.from_bytes(registers[place + k : place + k + 2], "little") for k in (0, 2))
        full = _FULL << 8
        steps.append(0 if off & full else STEPS if on & full else (off - on) % STEPS)
    return tuple(steps)


class _Deadline:
    """A time limit of which a process that was not given the processor for a while gets one look more."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds
        self._passed = False

    def passed_before(self) -> bool:
        """Whether it had passed already when this was asked the last time."""
        before, self._passed = self._passed, time.monotonic() > self._end
        return before


class Mcp2221Pca9685:
    """The electronics; made, they are set up and every LED is off.

    Parameters
    ----------
    port : Port
        To the bridge; closed with this object.
    count : int
        Number of LEDs, at most 16, on the chip's first outputs.
    serial : str
        For the capabilities.
    emulated : bool
        Likewise.

    Raises
    ------
    PortFailure, DeviceFailure
        If the bridge or the chip does not answer as it must.
    """

    def __init__(self, port: Port, count: int, *, serial: str = "", emulated: bool = False) -> None:
        if not 1 <= count <= CHANNELS:
            raise DeviceFailure(f"has {CHANNELS} outputs, not {count}", where="PCA9685")
        self.capabilities = Capabilities(
            kind="mcp2221a_pca9685",
            serial=serial,
            count=count,
            steps=STEPS,
            atomic=True,
            readback=True,
            update_interval=0.0,
            pwm_frequency=_FREQUENCY,
            positions=None,
            emulated=emulated,
        )
        self._port = port
        self._count = count
        self._blank()
        self._release()
        self._set_up_chip()
        self._expect(self._levels(), (0,) * count)

    def show(self, steps: Sequence[int]) -> tuple[int, ...]:
        """Set all LEDs in one write, read them back, then enable the outputs."""
        wanted = tuple(steps)
        self._write_registers(frame(wanted))
        held = self._levels()
        self._expect(held, wanted)
        self._enable(any(wanted))
        return held

    def readback(self) -> tuple[int, ...]:
        """Steps as the chip holds them; all 0 where it sleeps or its outputs are not enabled."""
        levels = self._levels()
        asleep = self._read_registers(_MODE1, 1)[0] & _ASLEEP
        enabled = self._command(_GET_GPIO)[2] == 1
        return levels if enabled and not asleep else (0,) * self._count

    def off(self) -> None:
        """Disable the outputs, which needs no I2C, and turn every channel off, which needs no GP0."""
        blind: DeviceFailure | None = None
        try:
            self._blank()
        except DeviceFailure as error:
            blind = error
        self._release()
        self._write_registers(bytes((_ALL_LED_OFF_HIGH, _FULL)))
        self._expect(self._levels(), (0,) * self._count)
        if blind is not None:
            raise blind

    def close(self) -> None:
        """Let the bridge go."""
        self._port.close()

    def _blank(self) -> None:
        pins = list(self._command(_GET_SRAM)[22:26])
        # All four are set at once: the other three keep what they are.
        self._command(_SET_SRAM, 0, 0, 0, 0, 0, 0, 0xFF, _OUTPUT_LOW, *pins[1:])
        self._enable(False)

    def _enable(self, on: bool) -> None:
        reply = self._command(_SET_GPIO, 0, 1, int(on), 1, 0)
        if reply[3] != int(on) or self._command(_GET_GPIO)[2] != int(on):
            raise DeviceFailure("GP0, which enables the LEDs, does not follow", where="MCP2221A")

    def _set_up_chip(self) -> None:
        divider = round(12e6 / _BUS_FREQUENCY) - 3
        if self._command(_STATUS, 0, 0, _SET_SPEED, divider)[3] != _SET_SPEED:
            raise DeviceFailure("does not take the speed of the bus", where="MCP2221A")
        self._write_registers(bytes((_MODE1, _ASLEEP)))  # only then the prescaler can be set
        self._write_registers(bytes((_ALL_LED_OFF_HIGH, _FULL)))
        self._write_registers(bytes((_PRESCALE, _FASTEST)))
        self._write_registers(bytes((_MODE2, _TOTEM_POLE)))
        self._write_registers(bytes((_MODE1, _AWAKE)))
        time.sleep(_WAKING)
        mode, output = self._read_registers(_MODE1, 2)
        if (mode, output) != (_AWAKE, _TOTEM_POLE) or self._read_registers(_PRESCALE, 1)[0] != _FASTEST:
            raise DeviceFailure("does not hold what was written", where="PCA9685")

    def _levels(self) -> tuple[int, ...]:
        return steps_of(self._read_registers(_FIRST_LED, 4 * self._count))

    def _expect(self, held: tuple[int, ...], wanted: tuple[int, ...]) -> None:
        for number, (is_, should) in enumerate(zip(held, wanted, strict=True)):
            if is_ != should:
                raise DeviceFailure(f"LED {number} holds {is_} steps, not {should}", where="PCA9685")

    def _write_registers(self, data: bytes) -> None:
        self._transfer(_WRITE, data)

    def _read_registers(self, first: int, count: int) -> bytes:
        self._transfer(_WRITE_NO_STOP, bytes((first,)), ends_in=_NO_STOP)
        self._accepted(_READ_RESTART, count, 0, ADDRESS << 1 | 1)
        deadline = _Deadline(_TRANSFER)
        while True:
            reply = self._command(_GET_DATA)
            if reply[1] == 0 and reply[2] == _DATA_READY and reply[3] == count:
                return reply[4 : 4 + count]
            self._judge(reply[2], deadline)

    def _transfer(self, kind: int, data: bytes, ends_in: int = _IDLE) -> None:
        self._accepted(kind, len(data), 0, ADDRESS << 1, *data)
        deadline = _Deadline(_TRANSFER)
        # The bridge only accepted it so far.
        while (state := self._command(_STATUS)[8]) != ends_in:
            self._judge(state, deadline)

    def _accepted(self, *command: int) -> None:
        deadline = _Deadline(_TRANSFER)
        while (reply := self._command(*command))[1] != 0:
            self._judge(reply[2], deadline)

    def _judge(self, state: int, deadline: _Deadline) -> None:
        """Nothing while the engine is at work; an error where it failed or takes too long."""
        if state == _NACK:
            problem = f"nothing answers at the I2C address 0x{ADDRESS:02X}"
        elif state in _TIMEOUTS or deadline.passed_before():
            problem = f"the I2C bus hangs in state 0x{state:02X}"
        else:
            return
        self._release()
        raise DeviceFailure(problem, where="MCP2221A", remedy="check the wiring and the chip's supply")

    def _release(self) -> None:
        """Cancel what the engine does. An idle one is left alone: where it was never used, cancelling crashes it."""
        for _ in range(3):
            if self._command(_STATUS)[8] == _IDLE:
                return
            self._command(_STATUS, 0, _CANCEL)
            time.sleep(1e-3)
        if self._command(_STATUS)[8] != _IDLE:
            raise DeviceFailure("its I2C engine is stuck", where="MCP2221A", remedy="plug it in again")

    def _command(self, *command: int) -> bytes:
        """Send a command and return its reply; a refused one is sent once more."""
        report = bytes((0, *command)).ljust(1 + _REPORT, b"\0")
        try:
            self._port.write(report)
        except PortFailure:
            time.sleep(_AGAIN)
            self._port.write(report)
        end = time.monotonic() + _ANSWER
        while True:
            # A reply to an older command, which nobody waited for, may come first.
            reply = self._port.read(_REPORT, max(end - time.monotonic(), 1e-3))
            if len(reply) == _REPORT and reply[0] == command[0]:
                return reply
