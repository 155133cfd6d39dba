"""``radwrap led``: the real ring."""

from __future__ import annotations

import argparse
import select
import sys
import time
from typing import Any, Final

from radwrap.cli import led_calibrate, led_play
from radwrap.cli import options as shared
from radwrap.cli.led_device import (
    add_device,
    add_light,
    device_record,
    ring_of,
    stdin_is_there,
    tell_emulated,
    warn_of_ripple,
)
from radwrap.errors import InputError
from radwrap.led.connect import kind_of
from radwrap.led.drive import decimal
from radwrap.led.from_scene import leds_of
from radwrap.led.ports import found, udev_rules
from radwrap.led.ring import Frame, LedRing
from radwrap.manifest import SCHEMA_VERSION, json_text
from radwrap.reading import shortened, whole_number
from radwrap.scene.file.load import load_scene
from radwrap.units import RADIANT_INTENSITY, parse_quantity

_TICK: Final = 0.1  # s between looks at the ring while it shines
_DARK: Final = "dark"
_LONGEST: Final = 366 * 86_400.0  # s of light


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("led", description=__doc__)
    what: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    one = what.add_parser("list", help="the rings that are there")
    one.add_argument("--udev", action="store_true", help="print the udev rules that give access, and nothing else")
    one.add_argument("--emulator", metavar="SOCKET", action="append", default=[], help="an emulator that runs")
    shared.add_json(one)
    one.set_defaults(run=run_list)
    for name, text, run in (
        ("show", "turn the ring off and show what it can do", run_show),
        ("off", "turn the ring off, and end a program that drives it", run_off),
    ):
        one = what.add_parser(name, help=text)
        add_device(one)
        shared.add_json(one)
        one.set_defaults(run=run)
    one = what.add_parser("set", help="light the ring, until Enter, Ctrl-C, --for or the drive's max_on_time")
    one.add_argument(
        "levels", metavar="LEVEL", nargs="*", help='one level for all LEDs or one for each: 0.25, or "12 mW/sr"'
    )
    one.add_argument("--scene", metavar="SCENE.toml", help="light the ring as this scene's ring shines")
    one.add_argument("--factor", metavar="F", help="factor on the scene's radiant intensities (default 1)")
    _add_light(one)
    one.set_defaults(run=run_set)
    one = what.add_parser("frame", help="only one LED, or none, for a capture")
    one.add_argument("led", metavar="LED", help='number of the LED, from 0, or "dark"')
    one.add_argument("--level", metavar="L", default="0.1", help="its level (default 0.1)")
    _add_light(one)
    one.set_defaults(run=run_frame)
    led_play.add_to(what)
    led_calibrate.add_to(what)


def _add_light(parser: argparse.ArgumentParser) -> None:
    add_device(parser)
    add_light(parser)
    parser.add_argument("--for", metavar="TIME", dest="duration", help='how long, such as "5 s"')
    shared.add_json(parser)


def run_list(arguments: argparse.Namespace) -> int:
    """Tell which rings are there."""
    if arguments.udev:
        print(udev_rules(), end="")
        return 0
    rings = [(device, kind_of(device)) for device in found(arguments.emulator)]
    listed = [
        {
            "path": device.path,
            "kind": kind,
            "serial": device.serial,
            "name": device.name,
            "driver": device.driver,
            "emulated": device.emulated,
        }
        for device, kind in rings
        if kind is not None
    ]
    if arguments.json:
        print(json_text({"schema_version": SCHEMA_VERSION, "rings": listed}), end="")
    else:
        for ring in listed:
            driver = f", held by the kernel's driver {ring['driver']}" if ring["driver"] else ""
            print(f"{ring['path']}: {ring['kind']}, serial {ring['serial'] or 'none'}, {ring['name']}{driver}")
        if not listed:
            print("no ring is there")
    return 0


def run_show(arguments: argparse.Namespace) -> int:
    """Tell what a ring can do, and what it holds."""
    with ring_of(arguments) as ring:
        held = ring.readback()
        device = device_record(ring)
        tell_emulated(ring)
    if arguments.json:
        print(json_text({"schema_version": SCHEMA_VERSION, "device": device, "held": held}), end="")
        return 0
    for key, value in device.items():
        print(f"{key}: {value}")
    print(f"held: {'the device does not report it' if held is None else ' '.join(f'{level:g}' for level in held)}")
    return 0


def run_off(arguments: argparse.Namespace) -> int:
    """Turn a ring off, whoever drives it: opening it does."""
    with ring_of(arguments, wrest=True) as ring:
        held = ring.readback()
        told = {"schema_version": SCHEMA_VERSION, "device": device_record(ring), "verified": held is not None}
        tell_emulated(ring)
    if arguments.json:
        print(json_text(told), end="")
    else:
        print("off" if held is not None else "off, as commanded: the device does not report it")
    return 0


def run_set(arguments: argparse.Namespace) -> int:
    """Light a ring as levels, radiant intensities or a scene say."""
    if bool(arguments.levels) == (arguments.scene is not None):
        raise InputError("give levels, or --scene")
    if arguments.factor is not None and arguments.scene is None:
        raise InputError("is on the radiant intensities of a scene", where="--factor", remedy="give --scene")
    factor = 1.0 if arguments.factor is None else decimal(arguments.factor, "--factor")
    duration = _duration(arguments)
    scene = load_scene(arguments.scene) if arguments.scene else None
    with ring_of(arguments, scene) as ring:
        if scene is not None:
            wanted = [factor * led.radiant_intensity for led in leds_of(scene)]
            levels = ring.levels_of(wanted)
            warn_of_ripple(ring, levels, scene)
        else:
            levels = _levels(ring, arguments.levels)
        _hold(ring, ring.set_levels(levels), duration, as_json=arguments.json)
    return 0


def run_frame(arguments: argparse.Namespace) -> int:
    """Light one LED alone."""
    level, duration = decimal(arguments.level, "--level"), _duration(arguments)
    with ring_of(arguments) as ring:
        levels = [0.0] * ring.capabilities.count
        if arguments.led != _DARK:
            led = whole_number(arguments.led)
            if led is None or led >= len(levels):
                raise InputError(f'"{shortened(arguments.led)}" is neither an LED, 0 to {len(levels) - 1}, nor "dark"')
            levels[led] = level
        _hold(ring, ring.set_levels(levels), duration, as_json=arguments.json)
    return 0


def _levels(ring: LedRing, texts: list[str]) -> tuple[float, ...]:
    count = ring.capabilities.count
    if len(texts) not in (1, count):
        raise InputError(f"{len(texts)} levels for {count} LEDs", remedy="give one for all, or one each")
    texts = texts * count if len(texts) == 1 else texts
    if any("/" in text for text in texts):
        return ring.levels_of([parse_quantity(text, RADIANT_INTENSITY) for text in texts])
    try:
        return tuple(map(decimal, texts))
    except InputError as error:
        raise InputError(f'{error.what}, or "12 mW/sr"') from error


def _duration(arguments: argparse.Namespace) -> float | None:
    """How long there is to be light [s]; None is until Enter, which somebody must be able to press."""
    if arguments.duration is not None:
        duration = shared.time_of(arguments.duration, "--for")
        if duration > _LONGEST:
            raise InputError(f'"{shortened(arguments.duration)}" is more than a year', where="--for")
        return duration
    if not stdin_is_there():
        raise InputError("is closed, so that no Enter can end the light", where="stdin", remedy="give --for TIME")
    return None


def _hold(ring: LedRing, frame: Frame, duration: float | None, *, as_json: bool) -> None:
    """Tell what shines, and wait."""
    tell_emulated(ring)
    told = {
        "schema_version": SCHEMA_VERSION,
        "device": device_record(ring),
        "levels": frame.levels,
        "steps": frame.steps,
        "held": frame.held,
        "verified": frame.verified,
    }
    if as_json:
        print(json_text(told), end="")
    else:
        state = "verified" if frame.verified else "commanded; the device does not report it"
        print(f"{' '.join(f'{level:.4f}' for level in frame.held)} ({state})")
    sys.stdout.flush()
    end = None if duration is None else time.monotonic() + duration
    if end is None:
        print("radwrap: Enter turns the ring off", file=sys.stderr)
    while end is None or time.monotonic() < end:
        ring.check()
        if end is not None:
            time.sleep(min(_TICK, max(end - time.monotonic(), 0)))
        elif select.select([sys.stdin], [], [], _TICK)[0]:
            return
