"""hidapi's Python module over emulated devices in this process: -1, OSError and ValueError where it has them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from radwrap.led.emulator.device import Frozen, Handles, Stall, Unit, Unplugged

FREEZE = 0.05  # s; the real ones take 1 s (libusb) or 5 s (hidraw) to give up


class FakeHid:
    """A module with ``enumerate`` and ``device``, for some units by path."""

    __name__ = "fake"

    def __init__(self) -> None:
        self.units: dict[str, Unit] = {}
        self.handles: dict[int, Handles] = {}

    def handles_of(self, unit: Unit) -> Handles:
        return self.handles.setdefault(id(unit), Handles(unit))

    def enumerate(self, vendor: int = 0, product: int = 0) -> list[dict[str, Any]]:
        wanted = [
            {
                "path": path.encode(),
                "vendor_id": unit.device.identity.vendor,
                "product_id": unit.device.identity.product,
                "serial_number": unit.device.identity.serial,
                "manufacturer_string": unit.device.identity.manufacturer,
                "product_string": unit.device.identity.name,
                "usage_page": unit.device.identity.usage_page,
                "usage": unit.device.identity.usage,
            }
            for path, unit in self.units.items()
            if unit.plugged
        ]
        asked = (vendor, product)
        return [one for one in wanted if asked in ((0, 0), (one["vendor_id"], one["product_id"]))]

    def device(self) -> FakeDevice:
        return FakeDevice(self)


class FakeDevice:
    """``hidraw.device``."""

    def __init__(self, module: FakeHid) -> None:
        self._module = module
        self._unit: Unit | None = None
        self._plug_count = 0
        self._said = "Success"

    def open_path(self, path: bytes) -> None:
        unit = self._module.units.get(path.decode())
        if unit is None or not unit.plugged:
            raise OSError("open failed")
        self._unit, self._plug_count = unit, unit.plug_count
        self._module.handles_of(unit).open(id(self))

    def close(self) -> None:
        if self._unit is not None:
            self._module.handles_of(self._unit).close(id(self))
        self._unit = None

    def error(self) -> str:
        return self._said

    def write(self, data: Sequence[int]) -> int:
        unit, report = self._open(), bytes(data)
        return self._sent(lambda: unit.output(report[1:] if report[0] == 0 else report), len(report))

    def send_feature_report(self, report: bytes) -> int:
        unit = self._open()
        return self._sent(lambda: unit.set_feature(report), len(report))

    def read(self, size: int, timeout_ms: int = 0) -> list[int]:
        unit = self._open()
        assert timeout_ms > 0, "0 means to wait for ever"
        end = time.monotonic() + timeout_ms / 1e3
        while True:
            if not self._is_there(unit):
                raise OSError("read error")
            report = self._module.handles_of(unit).input(id(self))
            if report is not None:
                return list(report[:size])
            if time.monotonic() > end:
                return []
            time.sleep(1e-4)

    def get_feature_report(self, report_id: int, size: int) -> list[int]:
        unit = self._open()
        try:
            if not self._is_there(unit):
                raise OSError("read error")
            return list(unit.get_feature(report_id)[:size])
        except (Stall, Unplugged, Frozen) as error:
            raise OSError("read error") from error

    def get_report_descriptor(self) -> list[int]:
        return list(self._open().device.descriptor)

    def _open(self) -> Unit:
        if self._unit is None:
            raise ValueError("not open")
        return self._unit

    def _is_there(self, unit: Unit) -> bool:
        return unit.plugged and unit.plug_count == self._plug_count

    def _sent(self, send: Any, length: int) -> int:
        unit = self._open()
        try:
            if not self._is_there(unit):
                raise Unplugged
            send()
        except Unplugged:
            self._said = "No such device"
        except Stall:
            self._said = "Broken pipe"
        except Frozen:
            time.sleep(FREEZE)
            self._said = "Connection timed out"
        else:
            return length
        return -1
