"""Inside the virtual machine: the conformance cases on real HID devices of this kernel.

Called as ``inside.py uhid`` or ``inside.py vhci``; prints a line for each case and a last one that counts.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from radwrap.led.backend import Kind
from radwrap.led.claim import end_drivers
from radwrap.led.drive import Drive
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.ports import Found, found
from radwrap.led.ring import open_ring
from radwrap.process import Child, start_child
from tests.led.conformance import COUNT, DARK, FIRST, SECOND, cases_for, light, there
from tests.led.controlled import ControlledBench

_START = 60.0  # s, in software emulation of the processor
_OFF_WITHIN = 20.0  # s; the time is told
# libusb learns of devices when it is loaded, and of changes through udev alone, which no bare machine has.
_NEED_REPLUG = ("unplugged_is_dark_and_an_error", "unplugged_within_a_frame_shows_no_part_of_it")


class MachineBench(ControlledBench):
    """Two units on a bus of this kernel, each in a process of its own."""

    def __init__(self, kind: Kind, bus: str, module: ModuleType | None = None) -> None:
        super().__init__(kind)
        # Of an output report that a uhid device refuses, the kernel says nothing.
        self.refuses = bus == "vhci" or kind == "lamparray"
        self._module = module
        self._folder = tempfile.TemporaryDirectory()
        self._servers: list[Child] = []
        for number, serial in enumerate((FIRST, SECOND)):
            socket = str(Path(self._folder.name) / serial)
            more = [str(number)] if bus == "vhci" else []
            argv = [sys.executable, "-m", f"tests.led.machine.{bus}", socket, kind, str(COUNT), serial, *more]
            server = start_child(argv, folder=Path(self._folder.name), environment=os.environ)
            assert server.hear(_START) == "ready"
            self._servers.append(server)
            self.control[serial] = EmulatedPort(socket)

    def found(self) -> list[Found]:
        return found(module=self._module)

    def close(self) -> None:
        for serial, server in zip((FIRST, SECOND), self._servers, strict=True):
            self.control[serial].close()
            server.close(0.0)
        end = time.monotonic() + 10
        while [device for device in self.found() if device.serial in (FIRST, SECOND)] and time.monotonic() < end:
            time.sleep(0.05)


def a_killed_driver_leaves_no_light(bench: MachineBench) -> None:
    """SIGKILL of the process that drives; the guardian opens the real device and turns it off."""
    child = os.fork()
    if child == 0:
        drive = Drive(COUNT, 850e-9, 0.1, 0.05, 1.0, 12.0, 60.0)
        ring = open_ring(there(bench), bench.kind, count=COUNT, drive=drive)
        ring.set_levels([0.5] * COUNT)
        signal.pause()
    end = time.monotonic() + _START
    while not any(light(bench)) or set(light(bench)) == {0.1}:  # the effect of a LampArray before it is driven
        assert time.monotonic() < end
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    killed = time.monotonic()
    os.waitpid(child, 0)
    while light(bench) != DARK:
        assert time.monotonic() < killed + _OFF_WITHIN, "the guardian was too slow"
        time.sleep(0.01)
    print(f"      off {time.monotonic() - killed:.2f} s after SIGKILL")
    time.sleep(0.5)  # its guardian ends


def off_ends_who_drives(bench: MachineBench) -> None:
    """By the claim alone, whatever the device is to the kernel."""
    device = there(bench)
    child = os.fork()
    if child == 0:
        drive = Drive(COUNT, 850e-9, 0.1, 0.05, 1.0, 12.0, 60.0)
        with open_ring(device, bench.kind, count=COUNT, drive=drive) as ring:
            ring.set_levels([0.5] * COUNT)
            signal.pause()
    end = time.monotonic() + _START
    while set(light(bench)) != {light(bench)[0]} or not 0.4 < light(bench)[0] < 0.6:
        assert time.monotonic() < end
        time.sleep(0.01)
    ended = end_drivers(device.path)
    os.waitpid(child, 0)
    assert ended == [child]
    with open_ring(device, bench.kind, count=COUNT):
        assert light(bench) == DARK


def an_independent_host_agrees(bench: MachineBench) -> None:
    """EasyMCP2221, which knows nothing of us, drives the emulated chips."""
    import hidraw

    from tests.led.independent_host import drive_by_easymcp2221

    sys.modules["hid"] = hidraw  # it asks for the module by libusb, which sees no uhid
    device = there(bench)
    drive_by_easymcp2221(device.serial, lambda: light(bench))


def run(bench: MachineBench, cases: list[Callable[[MachineBench], None]], name: str) -> int:
    failures = 0
    for case in cases:
        begin = time.monotonic()
        try:
            case(bench)
            verdict = "ok"
        except Exception:  # noqa: BLE001  (every case is told of)
            traceback.print_exc()
            verdict, failures = "FAILED", failures + 1
        print(f"CASE {verdict} {time.monotonic() - begin:6.2f} s  {name}: {case.__name__}", flush=True)
    return failures


def by_libusb(kind: Kind) -> int:
    """The cases by libusb, whose process must begin after the devices are there."""
    bench = MachineBench(kind, "vhci")
    end = time.monotonic() + _START
    while len([device for device in bench.found() if device.serial in (FIRST, SECOND)]) < 2:
        assert time.monotonic() < end
        time.sleep(0.05)
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        bench.close()
        return os.waitstatus_to_exitcode(status)
    sys.modules.pop("hid", None)
    import hid

    bench._module = hid
    bench.shared = False
    cases = [case for case in cases_for(bench) if case.__name__ not in _NEED_REPLUG]
    os._exit(run(bench, cases, f"libusb, {kind}"))


def main() -> None:
    bus = sys.argv[1]
    failures = 0
    begin = time.monotonic()
    for kind in ("mcp2221a_pca9685", "lamparray"):
        bench = MachineBench(kind, bus)
        cases = [*cases_for(bench), a_killed_driver_leaves_no_light, off_ends_who_drives]
        if kind == "mcp2221a_pca9685":
            cases.append(an_independent_host_agrees)
        failures += run(bench, cases, f"{bus}, hidraw, {kind}")
        bench.close()
        if bus == "vhci":
            failures += by_libusb(kind)
    print(f"VERDICT {bus}: {failures} failures in {time.monotonic() - begin:.1f} s", flush=True)


if __name__ == "__main__":
    main()
