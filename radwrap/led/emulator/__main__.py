"""An emulated ring as a program: ``python -m radwrap.led.emulator SOCKET``."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from radwrap.led.emulator.device import Device, Unit
from radwrap.led.emulator.lamparray import LampRing
from radwrap.led.emulator.mcp2221a import Mcp2221Ring
from radwrap.led.emulator.server import Server

KINDS = ("mcp2221a_pca9685", "lamparray")


def maker(kind: str, count: int, serial: str, diameter: float, first_angle: float) -> Callable[[], Device]:
    """What makes such a device as it is after power-up."""
    if kind == "lamparray":
        return lambda: LampRing(count, serial, diameter, first_angle)
    return lambda: Mcp2221Ring(count, serial)


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one device until stdin is closed."""
    parser = argparse.ArgumentParser(prog="python -m radwrap.led.emulator")
    parser.add_argument("socket")
    parser.add_argument("--kind", choices=KINDS, default=KINDS[0])
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--serial", default="EMULATED01")
    parser.add_argument("--diameter", type=float, default=25e-3, help="of a lamparray [m]")
    parser.add_argument("--first-angle", type=float, default=0.0, help="of a lamparray [rad]")
    given = parser.parse_args(arguments)
    # Ctrl-C is for the command that drives the ring; it closes our stdin when it ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    unit = Unit(maker(given.kind, given.count, given.serial, given.diameter, given.first_angle))
    server = Server(unit, Path(given.socket))
    print("ready", flush=True)
    server.serve()
    with suppress(OSError):  # where who started it is gone, nobody else removes them
        Path(given.socket).unlink()
        Path(given.socket).parent.rmdir()
    return 0


if __name__ == "__main__":
    sys.exit(main())
