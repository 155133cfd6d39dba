"""Options that say which ring is driven, and how it is opened."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from radwrap.cli import options
from radwrap.errors import EnvironmentFailure, InputError
from radwrap.led.backend import Kind
from radwrap.led.calibration import scaled
from radwrap.led.claim import end_drivers
from radwrap.led.connect import EmulatorProcess, choose, open_backend
from radwrap.led.drive import Drive, check_ripple, read_drive
from radwrap.led.from_scene import check_positions, leds_of, the_ring
from radwrap.led.ports import Found, found
from radwrap.led.ring import LedRing, open_ring
from radwrap.scene.file.ring_calibration import RingCalibration, read_calibration
from radwrap.scene.scene import Scene
from radwrap.units import RADIANT_INTENSITY, parse_quantity

_LEDS = 12
_KINDS: dict[str, Kind] = {"mcp2221a_pca9685": "mcp2221a_pca9685", "lamparray": "lamparray"}


def add_device(parser: argparse.ArgumentParser) -> None:
    """--device, --emulate, --emulator and --count."""
    parser.add_argument(
        "--device",
        dest="which",
        metavar="WHICH",
        help="serial number or path of the ring, where there are several",
    )
    parser.add_argument(
        "--emulate",
        metavar="KIND",
        nargs="?",
        const="mcp2221a_pca9685",
        choices=tuple(_KINDS),
        help="drive a ring in software: mcp2221a_pca9685 (default) or lamparray",
    )
    parser.add_argument(
        "--emulator", metavar="SOCKET", action="append", default=[], help="drive an emulator that is already running"
    )
    parser.add_argument(
        "--count",
        metavar="N",
        type=options.whole(1, 4096),
        help=f"number of LEDs (default {_LEDS}, or the drive file's)",
    )


def add_light(parser: argparse.ArgumentParser, drive: str = "--drive") -> None:
    """--drive, or as that is called, --calibration and --full-scale."""
    parser.add_argument(
        drive,
        dest="drive",
        metavar="DRIVE.toml",
        help="the LEDs' rated current and limits, without which there is no light",
    )
    light = parser.add_mutually_exclusive_group()
    light.add_argument("--calibration", metavar="FILE", help="calibration that radwrap led calibrate wrote")
    light.add_argument(
        "--full-scale", metavar="I", help='radiant intensity of every LED at level 1, such as "47.1 mW/sr"'
    )


@contextmanager
def ring_of(arguments: argparse.Namespace, scene: Scene | None = None, *, wrest: bool = False) -> Iterator[LedRing]:
    """The ring that is meant, dark at first and dark afterwards; `wrest` ends a program that drives it."""
    drive = read_drive(Path(arguments.drive)) if getattr(arguments, "drive", None) else None
    count = _count(arguments, drive, scene)
    with ExitStack() as stack:
        device, kind = _device(arguments, count, scene, stack)
        calibration = _calibration(arguments, count, device, drive)
        if wrest:
            _wrest(device, kind, count)
        with open_ring(device, kind, count=count, drive=drive, calibration=calibration) as ring:
            positions = ring.capabilities.positions
            if scene is not None and positions is not None:
                check_positions(positions, the_ring(scene))
            yield ring


def tell_emulated(ring: LedRing) -> None:
    """Say of an emulated ring that it is one: where the command is accepted, so that an error is one line."""
    if ring.capabilities.emulated:
        print("radwrap: this ring is emulated, no light shines", file=sys.stderr)


def _wrest(device: Found, kind: Kind, count: int) -> None:
    """End who drives the ring; where that is not ours to end, at least turn it off."""
    try:
        ended = end_drivers(device.path)
    except EnvironmentFailure as error:
        open_backend(device, kind, count).close()  # opening turns off
        raise EnvironmentFailure(
            "was turned off, but another user's program drives it, and may light it again",
            where=device.path,
            remedy="end that program",
        ) from error
    for process in ended:
        print(f"radwrap: process {process} drove the ring, and was ended", file=sys.stderr)


def _count(arguments: argparse.Namespace, drive: Drive | None, scene: Scene | None) -> int:
    told = {
        "--count": arguments.count,
        "--drive": None if drive is None else drive.count,
        "the scene": None if scene is None else len(leds_of(scene)),
    }
    known = {name: count for name, count in told.items() if count is not None}
    if len(set(known.values())) > 1:
        raise InputError("; ".join(f"{name} has {count} LEDs" for name, count in known.items()))
    return next(iter(known.values()), _LEDS)


def _device(arguments: argparse.Namespace, count: int, scene: Scene | None, stack: ExitStack) -> tuple[Found, Kind]:
    if arguments.emulate:
        shape = (25e-3, 0.0)
        if scene is not None:
            ring = the_ring(scene)
            shape = (ring.diameter, ring.first_angle)
        emulator = stack.enter_context(EmulatorProcess(_KINDS[arguments.emulate], count, ring=shape))
        return choose(found([emulator.socket], only_emulators=True))
    return choose(found(arguments.emulator, only_emulators=bool(arguments.emulator)), arguments.which)


def _calibration(
    arguments: argparse.Namespace, count: int, device: Found, drive: Drive | None
) -> RingCalibration | None:
    if getattr(arguments, "calibration", None):
        return read_calibration(Path(arguments.calibration))
    if not getattr(arguments, "full_scale", None):
        return None
    try:
        full = parse_quantity(arguments.full_scale, RADIANT_INTENSITY)
    except InputError as error:
        raise InputError(str(error), where="--full-scale") from error
    if full <= 0:
        raise InputError("must be above zero", where="--full-scale")
    if drive is None:
        raise InputError("needs the current at which it holds", where="--full-scale", remedy="give --drive DRIVE.toml")
    return RingCalibration(
        leds=scaled([full] * count, [0.0] * count, [1.0] * count),
        serial=device.serial,
        date="",
        temperature=None,
        current=drive.drive_current,
        emulated=device.emulated,
        source="nominal, the same for every LED: --full-scale",
    )


def warn_of_ripple(ring: LedRing, levels: tuple[float, ...], scene: Scene) -> None:
    """Refuse or tell what PWM does to the scene's exposure."""
    told = check_ripple(levels, ring.capabilities.pwm_frequency, scene.camera.exposure_time)
    if told:
        print(f"radwrap: {told}", file=sys.stderr)


def stdin_is_there() -> bool:
    """Whether somebody can press Enter: not where stdin was closed before the start."""
    return sys.stdin is not None and not sys.stdin.closed


def device_record(ring: LedRing) -> dict[str, Any]:
    """What every record says of the device."""
    told = ring.capabilities
    return {
        "emulated": told.emulated,
        "kind": told.kind,
        "serial": told.serial,
        "count": told.count,
        "steps": told.steps,
        "readback": told.readback,
        "pwm_frequency": told.pwm_frequency,
        "update_interval": told.update_interval,
        "wavelength": None if ring.drive is None else ring.drive.wavelength,
    }
