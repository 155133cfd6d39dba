"""An emulated device as a HID device of this kernel, through /dev/uhid; faults come through a socket."""

from __future__ import annotations

import os
import select
import struct
import sys
from pathlib import Path

from radwrap.led.emulator.__main__ import KINDS, maker
from radwrap.led.emulator.device import Frozen, Stall, Unit, Unplugged
from radwrap.led.emulator.server import Server

_DESTROY, _OUTPUT, _GET_REPORT, _GET_REPORT_REPLY = 1, 6, 9, 10
_CREATE2, _INPUT2, _SET_REPORT, _SET_REPORT_REPLY = 11, 12, 13, 14
_EVENT = 4380  # byte
_BUS_USB = 3
_REFUSED = 5  # EIO
_TICK = 1e-3  # s


class UhidDevice:
    """Plugs and unplugs a unit as its own state says, and carries its reports."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._file = -1
        self._plug_count = 0

    def run(self) -> None:
        while True:
            if self._file >= 0 and (not self._unit.plugged or self._plug_count != self._unit.plug_count):
                self._unplug()
            if self._file < 0 and self._unit.plugged:
                self._plug()
            self._carry()

    def _plug(self) -> None:
        self._file = os.open("/dev/uhid", os.O_RDWR)
        self._plug_count = self._unit.plug_count
        identity, descriptor = self._unit.device.identity, self._unit.device.descriptor
        self._write(
            _CREATE2,
            struct.pack("128s64s64sHHIIII", identity.name.encode(), b"", identity.serial.encode(), len(descriptor),
                        _BUS_USB, identity.vendor, identity.product, 0, 0) + descriptor,
        )  # fmt: skip

    def _unplug(self) -> None:
        self._write(_DESTROY, b"")
        os.close(self._file)
        self._file = -1

    def _carry(self) -> None:
        if not select.select([self._file] if self._file >= 0 else [], [], [], _TICK)[0]:
            try:
                report = self._unit.input()
            except Unplugged:
                return
            if report is not None and self._file >= 0:
                self._write(_INPUT2, struct.pack("H", len(report)) + report)
            return
        event = os.read(self._file, _EVENT)
        kind, body = struct.unpack_from("I", event)[0], event[4:]
        try:
            if kind == _OUTPUT:
                report = body[: struct.unpack_from("H", body, 4096)[0]]
                self._unit.output(report[1:] if report[:1] == b"\0" else report)
            elif kind == _GET_REPORT:
                number, report_id = struct.unpack_from("IB", body)
                self._reply(number, _GET_REPORT_REPLY, lambda: self._unit.get_feature(report_id))
            elif kind == _SET_REPORT:
                number, _, _, size = struct.unpack_from("IBBH", body)
                self._reply(number, _SET_REPORT_REPLY, lambda: self._unit.set_feature(body[8 : 8 + size]))
        except (Stall, Frozen, Unplugged):
            pass  # an output report has no answer

    def _reply(self, number: int, kind: int, ask: object) -> None:
        try:
            answer = ask() or b""  # type: ignore[operator]
        except Frozen:
            return  # the kernel waits for 5 s
        except (Stall, Unplugged):
            content = struct.pack("IH", number, _REFUSED)
        else:
            content = struct.pack("IH", number, 0)
            if kind == _GET_REPORT_REPLY:
                content += struct.pack("H", len(answer)) + answer
        self._write(kind, content)

    def _write(self, kind: int, content: bytes) -> None:
        os.write(self._file, (struct.pack("I", kind) + content).ljust(_EVENT, b"\0"))


def main() -> None:
    socket, kind, count, serial = sys.argv[1:]
    assert kind in KINDS
    unit = Unit(maker(kind, int(count), serial, 25e-3, 0.0))
    Server(unit, Path(socket))
    print("ready", flush=True)
    UhidDevice(unit).run()


if __name__ == "__main__":
    main()
