"""A host that knows nothing of radwrap, EasyMCP2221, drives the emulated chips: both must mean the same bytes."""

from __future__ import annotations

import time
from collections.abc import Callable

COUNT = 12
CHIP = 0x40


def drive_by_easymcp2221(serial: str, light: Callable[[], tuple[float, ...]]) -> None:
    """Set up the PWM chip, light twelve LEDs, read back, meet a missing chip; `hid` must be importable."""
    import EasyMCP2221
    from EasyMCP2221.exceptions import NotAckError

    bridge = EasyMCP2221.Device(usbserial=serial, read_timeout=2000)
    try:
        assert bridge.usbserial == serial

        def write(*data: int) -> None:
            bridge.I2C_write(CHIP, bytes(data), timeout_ms=500)

        def read(register: int, count: int) -> bytes:
            bridge.I2C_write(CHIP, bytes((register,)), kind="nonstop", timeout_ms=500)
            return bytes(bridge.I2C_read(CHIP, count, kind="restart", timeout_ms=500))

        bridge.set_pin_function(gp0="GPIO_OUT", out0=False)
        write(0xFE, 3)  # awake or asleep, as it was left
        write(0x00, 0x10)
        write(0xFE, 3)
        assert read(0xFE, 1) == b"\x03"
        write(0x00, 0x20)
        time.sleep(1e-3)
        write(0xFE, 99)  # the prescaler is locked while the chip is awake
        assert read(0xFE, 1) == b"\x03"
        levels = [341 * (n + 1) for n in range(COUNT)]
        data = b"".join(bytes((0, 0, level & 0xFF, level >> 8)) for level in levels)
        write(0x06, *data)
        assert read(0x06, len(data)) == data
        assert light() == (0.0,) * COUNT, "GP0 still keeps it dark"
        bridge.GPIO_write(gp0=True)
        assert light() == tuple(level / 4096 for level in levels)
        try:
            bridge.I2C_write(0x55, b"\0", timeout_ms=500)
        except NotAckError:
            pass
        else:
            raise AssertionError("nobody answers at 0x55")
        assert read(0x06, 4) == data[:4], "it goes on after a missing chip"
        bridge.GPIO_write(gp0=False)
        assert light() == (0.0,) * COUNT
    finally:
        type(bridge)._catalog.clear()
        bridge.hidhandler.close()
