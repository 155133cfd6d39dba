"""The PWM chip PCA9685 as its registers behave: 16 channels of 12 bit on an I2C bus."""

from __future__ import annotations

from typing import Final

CHANNELS: Final = 16
STEPS: Final = 4096
_MODE1, _MODE2, _FIRST_LED, _LAST_LED, _ALL_LED, _PRESCALE = 0x00, 0x01, 0x06, 0x45, 0xFA, 0xFE
_RESTART, _AUTO_INCREMENT, _SLEEP, _ALL_CALL = 0x80, 0x20, 0x10, 0x01
_CHANGE_ON_ACK = 0x08
_FULL = 0x10
_ALL_CALL_ADDRESS: Final = 0x70
_SLOWEST_PRESCALE, _FASTEST_PRESCALE = 255, 3
_OSCILLATOR = 25e6  # Hz


class Pca9685:
    """One chip; powers up asleep, every channel full off.

    Parameters
    ----------
    address : int
        Seven-bit address on the bus.
    """

    def __init__(self, address: int = 0x40) -> None:
        self.address = address
        self._registers = bytearray(256)
        self._registers[_MODE1] = _SLEEP | _ALL_CALL
        self._registers[_MODE2] = 0x04
        for channel in range(CHANNELS):
            self._registers[_FIRST_LED + 4 * channel + 3] = _FULL
        self._registers[_PRESCALE] = 0x1E
        self._shown = bytes(self._registers[_FIRST_LED : _LAST_LED + 1])
        self._stopped_by_sleep = False
        self._pointer = 0
        self._pointer_is_set = False

    def addressed(self, address: int, *, reading: bool) -> bool:
        """Whether the chip acknowledges its address; a transfer begins."""
        if not reading:
            self._pointer_is_set = False
        all_call = bool(self._registers[_MODE1] & _ALL_CALL) and address == _ALL_CALL_ADDRESS and not reading
        return address == self.address or all_call

    def write(self, value: int) -> None:
        """Take a byte: the first one of a transfer is the register's number."""
        if not self._pointer_is_set:
            self._pointer, self._pointer_is_set = value, True
            return
        self._store(self._pointer, value)
        self._advance()
        if self._registers[_MODE2] & _CHANGE_ON_ACK:
            self._show()

    def read(self) -> int:
        """Give the byte of the register that the pointer names; those of all LEDs at once can only be written."""
        value = 0 if _ALL_LED <= self._pointer < _PRESCALE else self._registers[self._pointer]
        self._advance()
        return value

    def stop(self) -> None:
        """End of a transfer: now the outputs change, all at once."""
        if not self._registers[_MODE2] & _CHANGE_ON_ACK:
            self._show()

    @property
    def frequency(self) -> float:
        """PWM frequency [Hz]."""
        return _OSCILLATOR / (STEPS * (self._registers[_PRESCALE] + 1))

    def duty(self, channel: int) -> float:
        """Share of the time for which a channel's output is on."""
        if self._registers[_MODE1] & _SLEEP or self._stopped_by_sleep:
            return 0.0
        on_low, on_high, off_low, off_high = self._shown[4 * channel : 4 * channel + 4]
        if off_high & _FULL:
            return 0.0
        if on_high & _FULL:
            return 1.0
        on, off = on_low | (on_high & 0x0F) << 8, off_low | (off_high & 0x0F) << 8
        return ((off - on) % STEPS) / STEPS

    def _store(self, register: int, value: int) -> None:
        if register == _MODE1:
            self._store_mode1(value)
        elif _ALL_LED <= register < _PRESCALE:
            for channel in range(CHANNELS):
                self._registers[_FIRST_LED + 4 * channel + register - _ALL_LED] = value
        elif register == _PRESCALE:
            if self._registers[_MODE1] & _SLEEP:  # its clock is locked while the oscillator runs
                self._registers[_PRESCALE] = min(max(value, _FASTEST_PRESCALE), _SLOWEST_PRESCALE)
        else:
            self._registers[register] = value
        if _FIRST_LED <= register <= _LAST_LED or _ALL_LED <= register < _PRESCALE:
            self._stopped_by_sleep = False
            self._registers[_MODE1] &= ~_RESTART & 0xFF

    def _store_mode1(self, value: int) -> None:
        was = self._registers[_MODE1]
        if value & _SLEEP and not was & _SLEEP and any(self.duty(channel) for channel in range(CHANNELS)):
            self._stopped_by_sleep = True
        if value & _RESTART and not value & _SLEEP:
            self._stopped_by_sleep = False
        restart = _RESTART if self._stopped_by_sleep else 0
        self._registers[_MODE1] = (value & ~_RESTART & 0xFF) | restart

    def _advance(self) -> None:
        if self._registers[_MODE1] & _AUTO_INCREMENT:
            self._pointer = _MODE1 if self._pointer == _LAST_LED else (self._pointer + 1) & 0xFF

    def _show(self) -> None:
        self._shown = bytes(self._registers[_FIRST_LED : _LAST_LED + 1])
