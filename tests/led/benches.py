"""Benches that need no kernel: a fake of hidapi in this process, and emulators in processes of their own."""

from __future__ import annotations

from collections.abc import Callable

from radwrap.led.backend import Backend, Kind
from radwrap.led.connect import EmulatorProcess, open_backend
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.emulator.__main__ import maker
from radwrap.led.emulator.device import Unit
from radwrap.led.lamparray import LampArray
from radwrap.led.mcp2221_pca9685 import Mcp2221Pca9685
from radwrap.led.ports import Found, HidPort, Port, found, open_port
from tests.led.conformance import COUNT, FIRST, SECOND
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


class EmulatorBench:
    """Emulators as the user has them."""

    shared = True
    refuses = True

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self._emulators = {serial: EmulatorProcess(kind, COUNT, serial) for serial in (FIRST, SECOND)}
        self._control = {serial: EmulatedPort(emulator.socket) for serial, emulator in self._emulators.items()}
        self._unplugged: set[str] = set()

    def found(self) -> list[Found]:
        plugged = [e.socket for serial, e in self._emulators.items() if self._control[serial].told().plugged]
        return found(plugged)

    def open_port(self, device: Found) -> Port:
        return open_port(device.path)

    def open(self, device: Found) -> Backend:
        return open_backend(device, self.kind, COUNT)

    def misbehave(self, serial: str, how: str) -> None:
        self._control[serial].misbehave(how)

    def history(self, serial: str) -> list[tuple[float, tuple[float, ...]]]:
        return [(moment, tuple(light)) for moment, light in self._control[serial].history()]

    def close(self) -> None:
        for serial, emulator in self._emulators.items():
            self._control[serial].close()
            emulator.close()
