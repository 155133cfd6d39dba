"""Benches whose units live in processes of their own: opened as users open them, mistreated through sockets.

Nothing but the standard library and radwrap.led: they also run inside a bare virtual machine.
"""

from __future__ import annotations

from radwrap.led.backend import Backend, Kind
from radwrap.led.connect import open_backend
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.ports import Found, Port, open_port
from tests.led.conformance import COUNT


class ControlledBench:
    """What such benches have in common; each tells what it has `found`.

    Parameters
    ----------
    kind : str
        Electronics of the units.
    """

    shared = True
    refuses = True

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.control: dict[str, EmulatedPort] = {}

    def open_port(self, device: Found) -> Port:
        return open_port(device.path)

    def open(self, device: Found) -> Backend:
        return open_backend(device, self.kind, COUNT)

    def misbehave(self, serial: str, how: str) -> None:
        self.control[serial].misbehave(how)

    def history(self, serial: str) -> list[tuple[float, tuple[float, ...]]]:
        return [(moment, tuple(light)) for moment, light in self.control[serial].history()]
