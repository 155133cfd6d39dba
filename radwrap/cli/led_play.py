"""``radwrap led play``: a study's rows on the ring, for a camera."""

from __future__ import annotations

import argparse
import os
import select
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.cli.led_device import add_device, add_light, ring_of, stdin_is_there, tell_emulated, warn_of_ripple
from radwrap.errors import InputError
from radwrap.files import make_folder, sole_owner
from radwrap.imaging.relight.levels import Levels, read_levels
from radwrap.led.from_scene import leds_of
from radwrap.led.play import PLAYED, RECORD, Planned, plan, play
from radwrap.led.ring import LedRing
from radwrap.manifest import json_text
from radwrap.process import Programs
from radwrap.scene.file.load import load_scene
from radwrap.scene.scene import Scene

_TICK: Final = 0.1  # s between looks at the ring while it shines
_DESCRIPTION = (
    "Shows a dark frame, with --alone each LED by itself, then each row of the table or run of the study, and waits "
    "each time: for Enter, or for the command of --camera, in which {name} and {number} stand for the frame's. The "
    "command works in DIR. Writes play.json, and played.csv with what the ring showed, which radwrap relight reads. "
    "An interrupted play continues where it stopped."
)


def add_to(what: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = what.add_parser("play", help="show a study's rows, frame by frame", description=_DESCRIPTION)
    parser.add_argument("scene", metavar="SCENE.toml", help="scene whose ring the factors belong to")
    what_is_shown = parser.add_mutually_exclusive_group()
    what_is_shown.add_argument(
        "--rows",
        metavar="LEVELS.csv",
        help='table with the columns "name" and one for each LED, as radwrap relight reads it',
    )
    what_is_shown.add_argument(
        "--design", metavar="DESIGN.toml", help="the runs of this study, which changes nothing but the LEDs' light"
    )
    parser.add_argument("--alone", action="store_true", help="show each LED by itself too, for led calibrate")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the record, and for the camera's files")
    parser.add_argument(
        "--settle", metavar="TIME", default="20 ms", help='time from frame to trigger (default "20 ms")'
    )
    add_device(parser)
    add_light(parser)
    shared.add_json(parser)
    parser.add_argument(
        "--camera-timeout",
        metavar="TIME",
        default="60 s",
        help='longest time of the camera\'s command (default "60 s")',
    )
    parser.add_argument(
        "--camera",
        metavar="COMMAND ...",
        nargs=argparse.REMAINDER,
        help="program that captures, and its arguments: everything after this option",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = load_scene(arguments.scene)
    leds = leds_of(scene)
    nominal = {led.name: led.radiant_intensity for led in leds}
    lit = [name for name, intensity in nominal.items() if intensity > 0]
    rows = None
    if arguments.rows:
        rows = read_levels(Path(arguments.rows), lit, [name for name in nominal if name not in lit])
        rows = rows.over(lit, tuple(nominal))
    elif arguments.design:
        rows = _runs(Path(arguments.design), scene)
    elif not arguments.alone:
        raise InputError("there is nothing to play", remedy="give --rows LEVELS.csv, --design or --alone")
    settle = shared.time_of(arguments.settle, "--settle")
    longest = shared.time_of(arguments.camera_timeout, "--camera-timeout")
    if not arguments.camera and not stdin_is_there():
        raise InputError("is closed, so that nobody can press Enter", where="stdin", remedy="give --camera COMMAND")
    out = Path(arguments.out)
    make_folder(out)
    with sole_owner(out), Programs() as programs, ring_of(arguments, scene) as ring:
        frames = plan(ring, tuple(nominal.values()), rows, alone=arguments.alone)
        for frame in frames:
            warn_of_ripple(ring, frame.levels, scene)
        trigger = _enter(ring, len(frames))
        if arguments.camera:
            trigger = _command(arguments.camera, out, programs, ring, longest)
        tell_emulated(ring)
        record = play(ring, frames, out, nominal=nominal, trigger=trigger, settle=settle)
    if arguments.json:
        print(json_text(record), end="")
    else:
        verified = "all verified" if all(f["verified"] for f in record["frames"].values()) else "commanded"
        print(f"{out}: {len(record['frames'])} frames, {verified}; {RECORD}, {PLAYED}")
    return 0


def _runs(path: Path, scene: Scene) -> Levels:
    from radwrap.led.from_study import rows_of
    from radwrap.study.design import read_design

    return rows_of(read_design(path), scene)


def _command(
    argv: Sequence[str], out: Path, programs: Programs, ring: LedRing, longest: float
) -> Callable[[int, Planned], None]:
    """Runs the camera's program, without a shell, in the folder of the records; looks after the ring meanwhile."""

    def trigger(number: int, frame: Planned) -> None:
        words = [word.replace("{name}", frame.name).replace("{number}", str(number)) for word in argv]
        remedy = "raise --camera-timeout if it needs longer"
        programs.attend(words, folder=out, environment=os.environ, look=ring.check, longest=longest, remedy=remedy)

    return trigger


def _enter(ring: LedRing, count: int) -> Callable[[int, Planned], None]:
    """Waits for a line on stdin, and looks after the ring meanwhile."""

    def trigger(number: int, frame: Planned) -> None:
        print(f'frame {number + 1} of {count}, "{frame.name}": capture it, then press Enter', file=sys.stderr)
        while not select.select([sys.stdin], [], [], _TICK)[0]:
            ring.check()
        if not sys.stdin.readline():
            raise InputError("ended before the last frame", where="stdin", remedy="give --camera COMMAND")

    return trigger
