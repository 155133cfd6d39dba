"""From a path or a serial number to a ring's electronics."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.led import lamparray, mcp2221_pca9685
from radwrap.led.backend import Backend, Kind
from radwrap.led.lamparray import LampArray
from radwrap.led.mcp2221_pca9685 import Mcp2221Pca9685
from radwrap.led.ports import Found, open_port
from radwrap.own_modules import start_module

_START: Final = 20.0  # s, on a busy machine ten times what it takes
_LONGEST_SOCKET: Final = 103  # bytes of its name, where a system takes the fewest (macOS)


def kind_of(device: Found) -> Kind | None:
    """Which electronics a device is, None where it is none of ours."""
    if (device.vendor, device.product) == (mcp2221_pca9685.VENDOR, mcp2221_pca9685.PRODUCT):
        return "mcp2221a_pca9685"
    if (device.usage_page, device.usage) == (lamparray.USAGE_PAGE, lamparray.USAGE):
        return "lamparray"
    if device.usage_page == 0 and _begins_as_lamparray(device.path):
        return "lamparray"
    return None


def _begins_as_lamparray(path: str) -> bool:
    try:
        port = open_port(path)
    except EnvironmentFailure:
        return False
    try:
        return lamparray.is_lamparray(port.descriptor())
    except EnvironmentFailure:
        return False
    finally:
        port.close()


def choose(devices: Sequence[Found], which: str | None = None) -> tuple[Found, Kind]:
    """The one ring that is meant.

    Parameters
    ----------
    devices : sequence of Found
        What is there.
    which : str, optional
        Serial number or path; needed where there are several.

    Raises
    ------
    InputError
        If several fit.
    EnvironmentFailure
        If none does.
    """
    rings = [(device, kind) for device in devices if (kind := kind_of(device)) is not None]
    fitting = [ring for ring in rings if which is None or which in (ring[0].serial, ring[0].path)]
    if len(fitting) == 1:
        return fitting[0]
    listed = ", ".join(f"{device.path} (serial {device.serial or 'none'})" for device, _ in rings) or "none"
    if fitting:
        raise InputError(f"several rings fit: {listed}", where="which", remedy="name one by its serial or path")
    raise EnvironmentFailure(
        f"no such ring is there; found: {listed}",
        where=which or "LED ring",
        remedy="is it plugged in, with a cable that carries data? an emulated ring needs none",
    )


def open_backend(device: Found, kind: Kind, count: int) -> Backend:
    """Open a ring's electronics; that turns every LED off.

    Raises
    ------
    PortFailure, DeviceFailure
        If that is not possible.
    """
    port = open_port(device.path)
    make = LampArray if kind == "lamparray" else Mcp2221Pca9685
    try:
        return make(port, count, serial=device.serial, emulated=device.emulated)
    except BaseException:
        port.close()
        raise


class EmulatorProcess:
    """An emulated ring in a process of its own.

    Parameters
    ----------
    kind : str
        Its electronics.
    count : int
        Number of LEDs.
    serial : str
        Its serial number.
    ring : tuple of float
        Diameter [m] and angle of the first LED [rad] that a LampArray tells.
    """

    def __init__(
        self,
        kind: Kind = "mcp2221a_pca9685",
        count: int = 12,
        serial: str = "EMULATED01",
        ring: tuple[float, float] = (25e-3, 0.0),
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="radwrap-led-")
        self.socket = str(Path(self._folder.name) / "ring")
        if len(os.fsencode(self.socket)) > _LONGEST_SOCKET:
            self._folder.cleanup()
            raise EnvironmentFailure(
                f"{self.socket} is too long a name for a socket",
                where="emulator",
                remedy="set TMPDIR to a shorter folder",
            )
        options = ["--kind", kind, "--count", str(count), "--serial", serial]
        options += [f"--diameter={ring[0]!r}", f"--first-angle={ring[1]!r}"]
        self._child = start_module("radwrap.led.emulator", self.socket, *options)
        if self._child.hear(_START) != "ready":
            self.close()
            raise EnvironmentFailure("did not start", where="emulator")

    def close(self) -> None:
        """End it."""
        self._child.close(0.0)
        self._folder.cleanup()

    def __enter__(self) -> EmulatorProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
