"""Benches that need no kernel: a fake of hidapi in this process, and emulators in processes of their own."""

from __future__ import annotations

from collections.abc import Callable

from radwrap.led.backend import Backend, Kind
from radwrap.led.connect import EmulatorProcess
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.emulator.__main__ import maker
from radwrap.led.emulator.device import Unit
from radwrap.led.lamparray import LampArray
from radwrap.led.mcp2221_pca9685 import Mcp2221Pca9685
from radwrap.led.ports import Found, HidPort, Port, found
from tests.led.conformance import COUNT, FIRST, SECOND
from tests.led.controlled import ControlledBench
from tests.led.fake_hid import FakeHid


class FakeBench:
    """hidapi's semantics over devices in this process."""

    shared = True
    refuses = True

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.module = FakeHid()
        for number, serial in enumerate((FIRST, SECOND)):
            self.module.units[f"bus/{number}"] = Unit(maker(kind, COUNT, serial, 25e-3, 0.0))

    def found(self) -> list[Found]:
        return found(module=self.module)

    def open_port(self, device: Found) -> Port:
        return HidPort(self.module, device.path.partition(":")[2])

    def open(self, device: Found) -> Backend:
        port = self.open_port(device)
        make: Callable[..., Backend] = LampArray if self.kind == "lamparray" else Mcp2221Pca9685
        return make(port, COUNT, serial=device.serial)

    def misbehave(self, serial: str, how: str) -> None:
        self._unit(serial).misbehave(how)

    def history(self, serial: str) -> list[tuple[float, tuple[float, ...]]]:
        return list(self._unit(serial).history)

    def close(self) -> None:
        pass

    def _unit(self, serial: str) -> Unit:
        return next(unit for unit in self.module.units.values() if unit.device.identity.serial == serial)


class EmulatorBench(ControlledBench):
    """Emulators as the user has them."""

    def __init__(self, kind: Kind) -> None:
        super().__init__(kind)
        self._emulators = {serial: EmulatorProcess(kind, COUNT, serial) for serial in (FIRST, SECOND)}
        self.control = {serial: EmulatedPort(emulator.socket) for serial, emulator in self._emulators.items()}

    def found(self) -> list[Found]:
        return found([e.socket for serial, e in self._emulators.items() if self.control[serial].told().plugged])

    def close(self) -> None:
        for serial, emulator in self._emulators.items():
            self.control[serial].close()
            emulator.close()
