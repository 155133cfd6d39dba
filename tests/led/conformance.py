"""What every ring must do, over whatever bus: the same cases run on fakes, on emulators, on uhid and on a USB bus.

Nothing but the standard library and radwrap.led: they also run inside a bare virtual machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

from radwrap.errors import EnvironmentFailure
from radwrap.led.backend import Backend, DeviceFailure, Kind, PortFailure
from radwrap.led.connect import choose, kind_of
from radwrap.led.ports import Found, Port

COUNT = 12
FIRST, SECOND = "UNIT0001", "UNIT0002"
DARK = (0.0,) * COUNT
# hidraw gives up after 5 s, and the one retry takes as long.
PATIENCE = 12.0
_PLUGGING = 5.0  # s


class Bench(Protocol):
    """Units on some bus, to be driven and mistreated."""

    kind: Kind
    shared: bool  # whether two programs may open a device at once
    refuses: bool  # whether the bus can tell that a device refused a report

    def found(self) -> list[Found]:
        """What is there."""

    def open(self, device: Found) -> Backend:
        """Open one."""

    def open_port(self, device: Found) -> Port:
        """Only its port."""

    def misbehave(self, serial: str, how: str) -> None:
        """See `Unit.misbehave`."""

    def history(self, serial: str) -> list[tuple[float, tuple[float, ...]]]:
        """Light of a unit since it is there."""


def there(bench: Bench, serial: str = FIRST) -> Found:
    """The unit with a serial; plugging takes a moment."""
    end = time.monotonic() + _PLUGGING
    while True:
        with suppress(EnvironmentFailure):
            return choose(bench.found(), serial)[0]
        assert time.monotonic() < end, f"{serial} did not appear"
        time.sleep(0.02)


@contextmanager
def opened(bench: Bench, serial: str = FIRST) -> Iterator[Backend]:
    """A backend on a unit."""
    backend = bench.open(there(bench, serial))
    try:
        yield backend
    finally:
        backend.close()


def light(bench: Bench, serial: str = FIRST) -> tuple[float, ...]:
    """What shines now."""
    return tuple(bench.history(serial)[-1][1])


def shares(backend: Backend, steps: tuple[int, ...]) -> tuple[float, ...]:
    """Steps as shares of full."""
    return tuple(step / backend.capabilities.steps for step in steps)


def ramp(backend: Backend, *, reverse: bool = False) -> tuple[int, ...]:
    """Levels that all differ, from off to full."""
    most = backend.capabilities.steps
    steps = tuple(round(most * n / (COUNT - 1)) for n in range(COUNT))
    return steps[::-1] if reverse else steps


def fails(work: Callable[[], object], kind: type[Exception] = EnvironmentFailure) -> Exception:
    """The error that something must raise, within patience."""
    begin = time.monotonic()
    try:
        work()
    except kind as error:
        assert time.monotonic() - begin < PATIENCE
        return error
    raise AssertionError(f"no {kind.__name__}")


def opening_turns_off(bench: Bench) -> None:
    with opened(bench) as backend:
        backend.show(ramp(backend))
        assert any(light(bench))
    if bench.kind == "mcp2221a_pca9685":
        assert any(light(bench)), "the chips latch: only a guardian helps"
    with opened(bench) as backend:
        assert light(bench) == DARK
        assert backend.readback() in (None, (0,) * COUNT)


def says_what_it_can(bench: Bench) -> None:
    with opened(bench) as backend:
        told = backend.capabilities
        assert (told.kind, told.serial, told.count) == (bench.kind, FIRST, COUNT)
        assert (told.steps, told.readback) == {"mcp2221a_pca9685": (4096, True), "lamparray": (255, False)}[bench.kind]
        assert told.atomic


def levels_are_exact(bench: Bench) -> None:
    with opened(bench) as backend:
        for steps in (ramp(backend), ramp(backend, reverse=True), (1,) * COUNT, (backend.capabilities.steps - 1,) * 12):
            assert backend.show(steps) == steps
            assert light(bench) == shares(backend, steps)
            assert backend.readback() in (None, steps)


def frames_change_all_at_once(bench: Bench) -> None:
    with opened(bench) as backend:
        before = len(bench.history(FIRST))
        frames = [ramp(backend), ramp(backend, reverse=True), (7,) * COUNT, (0,) * COUNT]
        for steps in frames:
            backend.show(steps)
        seen = [tuple(shine) for _, shine in bench.history(FIRST)[before:]]
        assert seen == [shares(backend, steps) for steps in frames]


def off_is_dark(bench: Bench) -> None:
    with opened(bench) as backend:
        backend.show(ramp(backend))
        backend.off()
        assert light(bench) == DARK
        backend.off()
        backend.show(ramp(backend))
        assert any(light(bench)), "it must shine again after off"
        backend.off()


def many_frames(bench: Bench) -> None:
    with opened(bench) as backend:
        for number in range(60):
            steps = tuple((37 * number + 11 * n) % (backend.capabilities.steps + 1) for n in range(COUNT))
            assert backend.show(steps) == steps
            assert light(bench) == shares(backend, steps)
        backend.off()


def refused_once_is_tried_again(bench: Bench) -> None:
    with opened(bench) as backend:
        bench.misbehave(FIRST, "stall 1")
        backend.show(ramp(backend))
        assert light(bench) == shares(backend, ramp(backend))


def refused_again_and_again_is_an_error(bench: Bench) -> None:
    with opened(bench) as backend:
        bench.misbehave(FIRST, "stall 1000")
        fails(lambda: backend.show(ramp(backend)))
        bench.misbehave(FIRST, "stall 0")
        assert light(bench) == DARK
        backend.off()


def frozen_is_an_error(bench: Bench) -> None:
    with opened(bench) as backend:
        bench.misbehave(FIRST, "freeze")
        fails(lambda: backend.show(ramp(backend)), PortFailure)
        bench.misbehave(FIRST, "thaw")
    with opened(bench) as backend:
        assert light(bench) == DARK
        backend.show(ramp(backend))
        assert light(bench) == shares(backend, ramp(backend))
        backend.off()


def unplugged_is_dark_and_an_error(bench: Bench) -> None:
    with opened(bench) as backend:
        backend.show(ramp(backend))
        bench.misbehave(FIRST, "unplug")
        assert light(bench) == DARK
        fails(lambda: backend.show(ramp(backend)), PortFailure)
        fails(backend.off, PortFailure)
    _gone(bench)
    bench.misbehave(FIRST, "plug")
    there(bench)


def unplugged_within_a_frame_shows_no_part_of_it(bench: Bench) -> None:
    """After each number of reports that a frame may take; an old handle stays dead, a new one starts dark."""
    for reports in range(4):
        with opened(bench) as backend:
            backend.off()
            seen = len(bench.history(FIRST))
            bench.misbehave(FIRST, f"unplug after {reports}")
            with suppress(PortFailure):
                backend.show(ramp(backend))
                backend.off()
                backend.off()
            shown = {tuple(shine) for _, shine in bench.history(FIRST)[seen:]}
            assert shown <= {shares(backend, ramp(backend)), _at_first(bench), DARK}
            bench.misbehave(FIRST, "plug")
            fails(lambda: backend.show(ramp(backend)), PortFailure)
        with opened(bench) as backend:
            assert light(bench) == DARK
            backend.show(ramp(backend))
            backend.off()


def two_units_are_told_apart(bench: Bench) -> None:
    rings = [device.serial for device in bench.found() if kind_of(device) == bench.kind]
    assert sorted(rings) == [FIRST, SECOND]
    with opened(bench, FIRST) as first, opened(bench, SECOND) as second:
        first.show(ramp(first))
        assert light(bench, SECOND) == DARK
        second.show(ramp(second, reverse=True))
        first.off()
        assert (light(bench, FIRST), light(bench, SECOND)) == (DARK, shares(second, ramp(second, reverse=True)))
        second.off()


def another_program_can_turn_off(bench: Bench) -> None:
    """What the guardian of a hanging process does."""
    with opened(bench) as hanging:
        hanging.show(ramp(hanging))
        with opened(bench) as guardian:
            guardian.off()
            assert light(bench) == DARK


def a_closed_device_is_an_error(bench: Bench) -> None:
    with opened(bench) as backend:
        pass
    fails(lambda: backend.show(ramp(backend)), PortFailure)


def a_chip_that_does_not_answer(bench: Bench) -> None:
    with opened(bench) as backend:
        backend.show(ramp(backend))
        bench.misbehave(FIRST, "nack")
        assert "0x40" in str(fails(lambda: backend.show(ramp(backend)), DeviceFailure))
        fails(backend.off, DeviceFailure)
        assert light(bench) == DARK, "GP0 turns off without the chip"
        bench.misbehave(FIRST, "ack")
        backend.off()
        backend.show(ramp(backend))
        assert light(bench) == shares(backend, ramp(backend))
        backend.off()
    bench.misbehave(FIRST, "nack")
    fails(lambda: bench.open(there(bench)), DeviceFailure)
    bench.misbehave(FIRST, "ack")


def an_enable_pin_that_sticks(bench: Bench) -> None:
    with opened(bench) as backend:
        backend.show(ramp(backend))
        bench.misbehave(FIRST, "stick")
        assert "GP0" in str(fails(backend.off, DeviceFailure))
        assert light(bench) == DARK, "the chip turns off without GP0"
        bench.misbehave(FIRST, "ack")
        backend.off()


def a_transfer_that_another_left(bench: Bench) -> None:
    """A killed driver leaves the engine in the middle of a write, and a reply that nobody read."""
    port = bench.open_port(there(bench))
    port.write(bytes((0, 0x94, 1, 0, 0x80, 0x06)).ljust(65, b"\0"))
    port.close()
    with opened(bench) as backend:
        port = bench.open_port(there(bench)) if bench.shared else None
        if port is not None:
            port.write(bytes((0, 0x61)).ljust(65, b"\0"))
        backend.show(ramp(backend))
        assert light(bench) == shares(backend, ramp(backend))
        backend.off()
        if port is not None:
            port.close()


def _gone(bench: Bench) -> None:
    end = time.monotonic() + _PLUGGING
    while any(device.serial == FIRST for device in bench.found()):
        assert time.monotonic() < end
        time.sleep(0.02)


def _at_first(bench: Bench) -> tuple[float, ...]:
    """Light after power-up: a LampArray may play an effect of its own."""
    return tuple(bench.history(FIRST)[0][1])


CASES: tuple[Callable[[Bench], None], ...] = (
    opening_turns_off,
    says_what_it_can,
    levels_are_exact,
    frames_change_all_at_once,
    off_is_dark,
    many_frames,
    refused_once_is_tried_again,
    refused_again_and_again_is_an_error,
    frozen_is_an_error,
    unplugged_is_dark_and_an_error,
    unplugged_within_a_frame_shows_no_part_of_it,
    two_units_are_told_apart,
    another_program_can_turn_off,
    a_closed_device_is_an_error,
    a_chip_that_does_not_answer,
    an_enable_pin_that_sticks,
    a_transfer_that_another_left,
)
_OF_THE_CHIPS = (a_chip_that_does_not_answer, an_enable_pin_that_sticks, a_transfer_that_another_left)


def cases_for(bench: Bench) -> list[Callable[[Bench], None]]:
    """The cases that a bench can have: a LampArray has no chips, some buses tell nothing or let in one program."""
    left_out: list[Callable[[Bench], None]] = []
    if bench.kind != "mcp2221a_pca9685":
        left_out += _OF_THE_CHIPS
    if not bench.refuses:
        left_out.append(refused_once_is_tried_again)
    if not bench.shared:
        left_out.append(another_program_can_turn_off)
    return [case for case in CASES if case not in left_out]
