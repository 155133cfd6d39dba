"""Ports: how reports reach a HID device. The one door to hidapi.

hidapi's Python package has two modules. On Linux ``hidraw`` is better: it says
what went wrong and leaves the kernel's driver alone; ``hid`` uses libusb, or
the system's own way on Windows and macOS.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Protocol

from radwrap.extras import installing
from radwrap.led.backend import PortFailure
from radwrap.led.emulated_port import EmulatedPort

UDEV_RULES: Final = "70-radwrap-led.rules"
_NO_TEXT: Final = ("", "Success", "hid_error is not implemented yet")


class Port(Protocol):
    """A way to one device; every failure is a `PortFailure`."""

    def write(self, report: bytes) -> None:
        """Send an output report, its id first (0 where reports have no numbers)."""

    def read(self, size: int, patience: float) -> bytes:
        """Wait for an input report for `patience` seconds."""

    def set_feature(self, report: bytes) -> None:
        """Send a feature report, its id first."""

    def get_feature(self, report_id: int, size: int) -> bytes:
        """Ask for a feature report of at most `size` bytes, its id first."""

    def descriptor(self) -> bytes:
        """Report descriptor."""

    def close(self) -> None:
        """Let the device go."""


@dataclass(frozen=True, slots=True)
class Found:
    """A device that is there.

    Attributes
    ----------
    path : str
        How to open it: module and its own path, such as "hidraw:/dev/hidraw0", or "emulator:SOCKET".
    vendor, product : int
        USB ids.
    serial, name : str
        USB strings, empty where there are none.
    usage_page, usage : int
        Of its first collection; 0 where the system does not say.
    driver : str
        The kernel's driver that holds it, empty where that is not known.
    """

    path: str
    vendor: int
    product: int
    serial: str
    name: str
    usage_page: int
    usage: int
    driver: str = ""

    @property
    def emulated(self) -> bool:
        """Whether it is software."""
        return self.path.startswith("emulator:")


def udev_rules() -> str:
    """The rules that give a user access to the devices."""
    return (files("radwrap") / "data" / "udev" / UDEV_RULES).read_text("ascii")


def modules() -> Iterator[ModuleType]:
    """Modules of hidapi that can be used here, the best first."""
    if sys.platform == "linux":
        try:
            import hidraw

            yield hidraw
        except ImportError:
            pass
    try:
        import hid

        yield hid
    except ImportError:
        pass


def found(
    emulators: Iterable[str] = (), *, only_emulators: bool = False, module: ModuleType | None = None
) -> list[Found]:
    """Every HID device that is there.

    Parameters
    ----------
    emulators : iterable of str
        Sockets of emulators.
    only_emulators : bool
        Whether to leave out real devices.
    module : module, optional
        hidapi's; default the best.

    Raises
    ------
    PortFailure
        If hidapi is missing where no emulator is named, or an emulator does not answer.
    """
    there = [_emulated(path) for path in emulators]
    if only_emulators:
        return there
    module = module or next(modules(), None)
    if module is None:
        if there:
            return there
        raise PortFailure("hidapi cannot be loaded", remedy=f"{installing('led')}, or use an emulated ring")
    for entry in module.enumerate():
        own = entry["path"].decode(errors="surrogateescape")
        there.append(
            Found(
                path=f"{module.__name__}:{own}",
                vendor=entry["vendor_id"],
                product=entry["product_id"],
                serial=entry["serial_number"] or "",
                name=entry["product_string"] or "",
                usage_page=entry["usage_page"] or 0,
                usage=entry["usage"] or 0,
                driver=_driver(own),
            )
        )
    return there


def _emulated(path: str) -> Found:
    path = str(Path(path).resolve())  # the guardian opens it too, and works in another folder
    port = EmulatedPort(path)
    try:
        told = port.told()
    finally:
        port.close()
    if not told.plugged:
        raise PortFailure("no such device", where=f"emulator:{path}")
    identity = {key: value for key, value in told.identity.items() if key != "manufacturer"}
    return Found(path=f"emulator:{path}", **identity)


def _driver(path: str) -> str:
    link = Path("/sys/class/hidraw", Path(path).name, "device", "driver")
    return link.resolve().name if link.exists() else ""


def open_port(path: str) -> Port:
    """Open a device by the path that `found` gave.

    Raises
    ------
    PortFailure
        If that is not possible; where permissions are missing it says which udev rules give them.
    """
    kind, _, own = path.partition(":")
    if kind == "emulator":
        return EmulatedPort(own)
    for module in modules():
        if module.__name__ == kind:
            return HidPort(module, own)
    raise PortFailure(f"no way to a device of the kind {kind}", where=path)


class HidPort:
    """A device opened through one of hidapi's modules.

    Parameters
    ----------
    module : module
        hidapi's; anything with its ``device`` class.
    path : str
        As that module enumerates it.
    """

    def __init__(self, module: Any, path: str) -> None:
        self._where = f"{module.__name__}:{path}"
        self._device = module.device()
        try:
            self._device.open_path(path.encode(errors="surrogateescape"))
        except OSError as error:
            raise _not_opened(self._where, path) from error

    def write(self, report: bytes) -> None:
        """Send an output report, its id first (0 where reports have no numbers)."""
        self._sent(self._device.write, report)

    def set_feature(self, report: bytes) -> None:
        """Send a feature report, its id first."""
        self._sent(self._device.send_feature_report, report)

    def read(self, size: int, patience: float) -> bytes:
        """Wait for an input report for `patience` seconds."""
        # A time-out of 0 would mean to wait for ever.
        milliseconds = max(1, math.ceil(1e3 * patience))
        report = self._got(lambda: self._device.read(size, milliseconds))
        if not report:
            raise PortFailure(f"did not answer within {patience:g} s", where=self._where)
        return report

    def get_feature(self, report_id: int, size: int) -> bytes:
        """Ask for a feature report of at most `size` bytes, its id first."""
        return self._got(lambda: self._device.get_feature_report(report_id, size))

    def descriptor(self) -> bytes:
        """Report descriptor."""
        return self._got(self._device.get_report_descriptor)

    def close(self) -> None:
        """Let the device go."""
        self._device.close()

    def _sent(self, send: Callable[[bytes], int], report: bytes) -> None:
        try:
            count = send(report)
        except (OSError, ValueError) as error:
            raise PortFailure(f"writing failed: {error}", where=self._where) from error
        # -1 and no exception is how hidapi tells of a failure; some systems return one byte more.
        if count < len(report):
            raise PortFailure(f"writing failed{self._said()}", where=self._where)

    def _got(self, ask: Callable[[], list[int]]) -> bytes:
        try:
            return bytes(ask())
        except (OSError, ValueError) as error:
            raise PortFailure(f"reading failed{self._said() or f': {error}'}", where=self._where) from error

    def _said(self) -> str:
        try:
            text = str(self._device.error() or "")
        except (OSError, ValueError):
            return ""
        return "" if text in _NO_TEXT else f": {text}"


def _not_opened(where: str, path: str) -> PortFailure:
    if path.startswith("/dev/") and Path(path).exists() and not os.access(path, os.R_OK | os.W_OK):
        rules = " and ".join(line for line in udev_rules().splitlines() if line and not line.startswith("#"))
        return PortFailure(
            "you have no permission to open it",
            where=where,
            remedy=f"write `radwrap led list --udev` to /etc/udev/rules.d/{UDEV_RULES} and plug it in again: {rules}",
        )
    return PortFailure(
        "cannot be opened", where=where, remedy="is it still plugged in, and does no other program hold it?"
    )
