"""An emulated device on a USB bus of this kernel, through vhci_hcd; faults come through a socket.

The kernel speaks the protocol of USB/IP over a socket that we give it: requests with numbers, answers with the same
numbers, in any order.
"""

from __future__ import annotations

import select
import socket
import struct
import sys
from pathlib import Path

from radwrap.led.emulator.__main__ import KINDS, maker
from radwrap.led.emulator.device import Frozen, Stall, Unit, Unplugged
from radwrap.led.emulator.server import Server

_ATTACH = Path("/sys/devices/platform/vhci_hcd.0/attach")
_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4
_FULL_SPEED = 2
_OK, _STALLED, _CUT_OFF = 0, -32, -104
_REPORT = 64
_TICK = 1e-3  # s
_HEADER = 48


def _strings(unit: Unit) -> list[str]:
    identity = unit.device.identity
    return [identity.manufacturer, identity.name, identity.serial]


def descriptor_of(unit: Unit, kind: int, index: int) -> bytes:
    """Answer to GET_DESCRIPTOR; `Stall` where there is none."""
    identity, report = unit.device.identity, unit.device.descriptor
    hid = struct.pack("<BBHBBBH", 9, 0x21, 0x0111, 0, 1, 0x22, len(report))
    match kind:
        case 1:
            return struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0, 0, 0, 64, identity.vendor, identity.product, 0x0100,
                               1, 2, 3, 1)  # fmt: skip
        case 2:
            interface = struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 2, 3, 0, 0, 0)
            endpoints = b"".join(struct.pack("<BBBBHB", 7, 5, address, 3, _REPORT, 1) for address in (0x81, 0x02))
            inner = interface + hid + endpoints
            return struct.pack("<BBHBBBBB", 9, 2, 9 + len(inner), 1, 1, 0, 0x80, 50) + inner
        case 3:
            text = struct.pack("<H", 0x0409) if index == 0 else _strings(unit)[index - 1].encode("utf-16-le")
            return bytes((2 + len(text), 3)) + text
        case 0x21:
            return hid
        case 0x22:
            return report
    raise Stall


class VhciDevice:
    """Plugs and unplugs a unit as its own state says, and carries its transfers."""

    def __init__(self, unit: Unit, port: int) -> None:
        self._unit = unit
        self._port = port
        self._bus: socket.socket | None = None
        self._plug_count = 0
        self._waiting: list[int] = []  # requests for input reports
        self._frozen: list[int] = []

    def run(self) -> None:
        while True:
            if self._bus is not None and (not self._unit.plugged or self._plug_count != self._unit.plug_count):
                self._bus.close()
                self._bus, self._waiting, self._frozen = None, [], []
            if self._bus is None and self._unit.plugged:
                self._plug()
            self._carry()

    def _plug(self) -> None:
        ours, kernels = socket.socketpair()
        self._plug_count = self._unit.plug_count
        # The port may need a moment to become free.
        for _ in range(500):
            try:
                _ATTACH.write_text(f"{self._port} {kernels.fileno()} {self._port + 1} {_FULL_SPEED}")
                break
            except OSError:
                select.select([], [], [], 0.01)
        kernels.close()
        self._bus = ours

    def _carry(self) -> None:
        bus = self._bus
        if bus is None:
            select.select([], [], [], _TICK)
            return
        if select.select([bus], [], [], _TICK)[0]:
            header = _exactly(bus, _HEADER)
            if header is None:
                self._bus = None
                return
            command, number, _, inward, endpoint = struct.unpack_from(">5I", header)
            if command == _SUBMIT:
                size = struct.unpack_from(">i", header, 24)[0]
                data = b"" if inward else _exactly(bus, size) or b""
                self._submit(number, endpoint, header[40:48], size, data)
            elif command == _UNLINK:
                self._unlink(number, struct.unpack_from(">I", header, 20)[0])
        self._give_input()

    def _submit(self, number: int, endpoint: int, setup: bytes, size: int, data: bytes) -> None:
        if endpoint == 1:
            self._waiting.append(number)
            return
        try:
            if endpoint == 2:
                self._unit.output(data)
                answer = b""
            else:
                answer = self._control(setup, data)
        except Stall:
            self._answer(number, _STALLED)
        except (Frozen, Unplugged):
            self._frozen.append(number)
        else:
            incoming = bool(setup[0] & 0x80) and endpoint == 0
            self._answer(number, _OK, answer[:size] if incoming else b"", len(data))

    def _control(self, setup: bytes, data: bytes) -> bytes:
        kind, request, value, _, length = struct.unpack("<BBHHH", setup)
        match kind, request:
            case (0x80 | 0x81, 0x06):
                return descriptor_of(self._unit, value >> 8, value & 0xFF)[:length]
            case (0x80 | 0x81 | 0x82, 0x00):
                return b"\0\0"
            case (0xA1, 0x01):
                return self._unit.get_feature(value & 0xFF)
            case (0x21, 0x09):
                self._unit.set_feature(data)
            case (0x21, 0x0A | 0x0B) | (0x00, 0x09) | (0x01, 0x0B) | (0x02, 0x01) | (0x00, 0x05):
                pass  # idle, protocol, configuration, interface, halt, address
            case _:
                raise Stall
        return b""

    def _give_input(self) -> None:
        while self._waiting:
            try:
                report = self._unit.input()
            except Unplugged:
                return
            if report is None:
                return
            self._answer(self._waiting.pop(0), _OK, report)

    def _unlink(self, number: int, which: int) -> None:
        status = 0
        for pending in (self._waiting, self._frozen):
            if which in pending:
                pending.remove(which)
                status = _CUT_OFF
        self._send(struct.pack(">5Ii24x", _UNLINKED, number, 0, 0, 0, status))

    def _answer(self, number: int, status: int, data: bytes = b"", taken: int = 0) -> None:
        length = len(data) or (taken if status == _OK else 0)
        self._send(struct.pack(">5IiiiiI8x", _SUBMITTED, number, 0, 0, 0, status, length, 0, 0, 0) + data)

    def _send(self, message: bytes) -> None:
        if self._bus is not None:
            try:
                self._bus.sendall(message)
            except OSError:
                self._bus = None


def _exactly(bus: socket.socket, size: int) -> bytes | None:
    parts = b""
    while len(parts) < size:
        part = bus.recv(size - len(parts))
        if not part:
            return None
        parts += part
    return parts


def main() -> None:
    path, kind, count, serial, port = sys.argv[1:]
    assert kind in KINDS
    unit = Unit(maker(kind, int(count), serial, 25e-3, 0.0))
    Server(unit, Path(path))
    print("ready", flush=True)
    VhciDevice(unit, int(port)).run()


if __name__ == "__main__":
    main()
