"""The emulated chips behave as the data sheets say, and the frames have the bytes that they need."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from radwrap.led.backend import DeviceFailure
from radwrap.led.emulator import mcp2221a
from radwrap.led.emulator.device import Stall
from radwrap.led.emulator.lamparray import LampRing, descriptor
from radwrap.led.emulator.mcp2221a import Mcp2221Ring
from radwrap.led.emulator.pca9685 import Pca9685
from radwrap.led.lamparray import is_lamparray, reports_of
from radwrap.led.mcp2221_pca9685 import frame, steps_of
from radwrap.led.report_descriptor import Field, feature_reports
from tests.led.benches import FakeBench
from tests.led.conformance import FIRST, there


def write(chip: Pca9685, *data: int, stop: bool = True) -> None:
    assert chip.addressed(chip.address, reading=False)
    for value in data:
        chip.write(value)
    if stop:
        chip.stop()


def read(chip: Pca9685, register: int) -> int:
    write(chip, register, stop=False)
    assert chip.addressed(chip.address, reading=True)
    return chip.read()


def awake() -> Pca9685:
    chip = Pca9685()
    write(chip, 0x00, 0x20)
    return chip


def test_the_prescaler_can_only_be_set_asleep() -> None:
    chip = Pca9685()
    assert read(chip, 0xFE) == 0x1E
    write(chip, 0xFE, 3)
    assert chip.frequency == pytest.approx(25e6 / 4096 / 4)
    write(chip, 0x00, 0x20)
    write(chip, 0xFE, 121)
    assert read(chip, 0xFE) == 3
    write(chip, 0x00, 0x10)
    write(chip, 0xFE, 1)
    assert read(chip, 0xFE) == 3, "3 is the least"


def test_outputs_change_at_the_end_of_a_transfer() -> None:
    chip = awake()
    write(chip, 0x06, 0, 0, 0, 8, stop=False)
    assert chip.duty(0) == 0.0
    chip.stop()
    assert chip.duty(0) == 0.5


def test_outputs_change_at_once_where_that_is_chosen() -> None:
    chip = awake()
    write(chip, 0x01, 0x0C)
    write(chip, 0x06, 0, 0, 0, 8, stop=False)
    assert chip.duty(0) == 0.5


def test_full_off_wins_over_full_on_and_a_phase_wraps() -> None:
    chip = awake()
    write(chip, 0x06, 0, 0x10, 0, 0x10)
    assert chip.duty(0) == 0.0
    write(chip, 0x06, 0, 0x10, 0, 0)
    assert chip.duty(0) == 1.0
    write(chip, 0x06, 0xFF, 0x0F, 0x01, 0x00)  # on at 4095, off at 1
    assert chip.duty(0) == 2 / 4096


def test_sleep_is_dark_and_needs_a_restart() -> None:
    chip = awake()
    write(chip, 0x06, 0, 0, 0, 8)
    write(chip, 0x00, 0x30)
    assert chip.duty(0) == 0.0
    assert read(chip, 0x00) == 0xB0
    write(chip, 0x00, 0x20)
    assert chip.duty(0) == 0.0
    write(chip, 0x00, 0xA0)
    assert chip.duty(0) == 0.5


def test_registers_roll_over_after_the_last_led() -> None:
    chip = awake()
    write(chip, 0x45, 7, 0x10)  # LED 15's last register, then MODE1: asleep
    assert read(chip, 0x00) & 0x10
    write(chip, 0xFD, 0x10)
    assert read(chip, 0x09) == 0x10, "all LEDs at once"
    assert read(chip, 0xFD) == 0, "that can only be written"


def command(ring: Mcp2221Ring, *data: int) -> bytes:
    ring.output(bytes(data).ljust(64, b"\0"))
    reply = ring.input()
    assert reply is not None
    return reply


def test_accepted_is_not_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock of its own: on a busy machine the bus was done before it was asked again."""
    now = 0.0
    monkeypatch.setattr(mcp2221a, "time", SimpleNamespace(monotonic=lambda: now))
    ring = Mcp2221Ring()
    assert command(ring, 0x90, 2, 0, 0x80, 0x00, 0x20)[1] == 0
    assert command(ring, 0x10)[8] != 0
    assert command(ring, 0x90, 2, 0, 0x80, 0x00, 0x20)[1] == 1, "busy"
    now = 0.01
    assert command(ring, 0x10)[8] == 0
    assert read(ring.chip, 0x00) == 0x20


def test_a_missing_chip_blocks_until_it_is_cancelled() -> None:
    ring = Mcp2221Ring()
    command(ring, 0x90, 1, 0, 0x55 << 1, 0)
    time.sleep(0.01)
    status = command(ring, 0x10)
    assert status[8] == 0x25 and status[20] & 0x40
    assert command(ring, 0x90, 2, 0, 0x80, 0, 0x20)[1:3] == b"\x01\x25"
    assert command(ring, 0x10, 0, 0x10)[2] == 0x10
    assert command(ring, 0x10)[8] == 0


def test_cancelling_an_engine_that_was_never_used_crashes_it() -> None:
    ring = Mcp2221Ring()
    command(ring, 0x10, 0, 0x10)
    assert command(ring, 0x10)[8] == 0x62
    ring.output(bytes((0x70, 0xAB, 0xCD, 0xEF)).ljust(64, b"\0"))
    assert ring.input() is None, "a reset has no reply"
    assert command(ring, 0x10)[8] == 0


def test_pins_that_are_not_gpio_refuse() -> None:
    ring = Mcp2221Ring()
    assert command(ring, 0x50, 0, 1, 1)[3] == 0xEE
    assert command(ring, 0x51)[2] == 0xEE
    command(ring, 0x60, 0, 0, 0, 0, 0, 0, 0xFF, 0x10, 2, 3, 2)
    assert command(ring, 0x51)[2] == 1


def test_a_frame_is_one_write_that_fits_a_report() -> None:
    data = frame([0, 4096, 2048, 1] + [4095] * 8)
    assert len(data) == 49
    assert data[:17] == bytes((0x06, 0, 0, 0, 0x10, 0, 0x10, 0, 0, 0xAA, 0x02, 0xAA, 0x0A, 0x00, 0x04, 0x01, 0x04))
    assert steps_of(data[1:]) == (0, 4096, 2048, 1, *[4095] * 8)
    with pytest.raises(ValueError):
        frame([4097])


def test_every_level_of_every_led_reads_back() -> None:
    for level in range(4097):
        assert steps_of(frame([level] * 12)[1:]) == (level,) * 12


def test_a_chip_that_holds_something_else_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = FakeBench("mcp2221a_pca9685")
    backend = bench.open(there(bench))
    store = Pca9685._store
    monkeypatch.setattr(Pca9685, "_store", lambda chip, register, value: store(chip, register, value & 0xFE))
    with pytest.raises(DeviceFailure, match="LED 1 holds 2 steps, not 1"):
        backend.show([0] + [1] * 11)


def test_the_descriptor_is_read_as_the_device_means_it() -> None:
    reports = {each.collection & 0xFFFF: each for each in feature_reports(descriptor())}
    assert {usage: (each.number, each.size) for usage, each in reports.items()} == {
        0x02: (0x21, 23),
        0x20: (0x22, 3),
        0x22: (0x25, 29),
        0x50: (0x33, 51),
        0x60: (0x34, 10),
        0x70: (0x40, 2),
    }
    assert reports[0x70].fields == [Field(0x590071, 8)]
    assert is_lamparray(descriptor())


def test_other_descriptors_are_refused() -> None:
    good = descriptor()
    interleaved = good.replace(bytes((0x09, 0x03, 0x09, 0x55)), bytes((0x09, 0x55, 0x09, 0x03)))
    with pytest.raises(DeviceFailure, match="0x50 has other fields"):
        reports_of(interleaved)
    as_input = good.replace(bytes((0x09, 0x71, 0x15, 0, 0x26, 255, 0, 0x75, 8, 0x95, 1, 0xB1)),
                            bytes((0x09, 0x71, 0x15, 0, 0x26, 255, 0, 0x75, 8, 0x95, 1, 0x81)))  # fmt: skip
    assert as_input != good
    with pytest.raises(DeviceFailure, match="no feature report with the usage 0x70"):
        reports_of(as_input)
    for end in range(len(good)):
        with pytest.raises(DeviceFailure):
            reports_of(good[:end])


def test_a_lamparray_plays_its_own_effect_until_an_update_is_complete() -> None:
    ring = LampRing(count=2)
    assert ring.light() == (0.1, 0.1)
    ring.set_feature(bytes((0x40, 0)))
    assert ring.light() == (0.1, 0.1)
    ring.set_feature(bytes((0x34, 0, 0, 0, 1, 0, 0, 0, 0, 0)))
    assert ring.light() == (0.1, 0.1), "not complete"
    ring.set_feature(bytes((0x34, 1, 0, 0, 1, 0, 0, 0, 0, 0)))
    assert ring.light() == (0.0, 0.0)
    with pytest.raises(Stall):
        ring.set_feature(b"\x34")


def test_two_units_with_one_serial_cannot_be_told_apart() -> None:
    bench = FakeBench("lamparray")
    for unit in bench.module.units.values():
        unit.device = LampRing(serial=FIRST)
    with pytest.raises(Exception, match="several rings fit"):
        there(bench)
