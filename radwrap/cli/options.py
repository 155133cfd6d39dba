"""Options that several verbs share."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import check_result
from radwrap.imaging.render_options import TRACERS
from radwrap.reading import parse_toml, shortened
from radwrap.scene.file.load import load_scene
from radwrap.scene.scene import Scene
from radwrap.units import ONE_IN, TIME, parse_quantity

_WORTH_A_WORD: Final = 1 << 30  # byte
_LARGEST: Final = 1e12
_LARGEST_WHOLE: Final = 2**63 - 1
_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,19}", re.ASCII)


def number(low: float = -_LARGEST, high: float = _LARGEST) -> Callable[[str], float]:
    """Reader of an option's number: finite, and in a range in which sums and squares do not overflow."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise ArgumentTypeError(f'must be a number from {low:g} to {high:g}, not "{shortened(text)}"')
        return value

    return read


def tolerance(text: str) -> float | str:
    """Reader of a tolerance: a number of gray levels, or a text with a unit that `RenderOptions` reads."""
    try:
        return float(text)
    except ValueError:
        return text


def add_tolerance(parser: argparse.ArgumentParser, what: str) -> None:
    """--tolerance."""
    parser.add_argument(
        "--tolerance",
        metavar="G",
        type=tolerance,
        help=f'{what}: gray levels, "0.2 %%" of saturation minus dark, or "0.5 noise", of one frame\'s temporal noise, '
        "rms over the lit pixels (default 0.5 gray; for a linear camera half of that noise, and at least 0.5/255 of "
        "full scale)",
    )


def whole(low: int = -_LARGEST_WHOLE, high: int = _LARGEST_WHOLE) -> Callable[[str], int]:
    """Reader of an option's whole number, in a range."""

    def read(text: str) -> int:
        value = int(text) if _WHOLE.fullmatch(text.strip()) else None
        if value is None or not low <= value <= high:
            raise ArgumentTypeError(f'must be a whole number from {low} to {high}, not "{shortened(text)}"')
        return value

    return read


def one_in(text: str) -> str:
    """Reader of an option's 1/N."""
    if re.fullmatch(ONE_IN, text) is None:
        raise ArgumentTypeError(f'must be 1/N with a whole number N, such as 1/4, not "{shortened(text)}"')
    return text


def tell_memory(verb: str, pixels: int, each: int, besides: int = 0) -> None:
    """Say beforehand what a large picture takes, bytes for each pixel and besides; what this machine lacks is refused.

    Raises
    ------
    InputError
        If it takes more than this machine has.
    """
    need = pixels * each + besides
    if need < _WORTH_A_WORD:
        return
    told = f"{pixels / 1e6:.3g} million pixels take up to {need / 2**30:.1f} GiB of memory"
    if need > os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"):
        raise InputError(f"{told}, more than this machine has", where=verb, remedy="cut the picture")
    print(f"radwrap: {verb}: {told}", file=sys.stderr)


GRAY_LEVEL: Final = number(-1e9, 1e9)  # far beyond 16 bits: files of floats hold any


def add_scene(parser: argparse.ArgumentParser) -> None:
    """SCENE and the options of `add_changes`."""
    parser.add_argument("scene", metavar="SCENE.toml", help="scene file")
    add_changes(parser)


def add_changes(parser: argparse.ArgumentParser) -> None:
    """--set, --scale and --roi."""
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help='change one key of the scene, such as --set camera.exposure_time="64 ms"; may be repeated',
    )
    parser.add_argument(
        "--scale",
        metavar="1/N",
        type=one_in,
        help="make one pixel of N x N, with their sum of electrons; gray levels stay the same",
    )
    parser.add_argument(
        "--roi",
        nargs=4,
        metavar=("U0", "V0", "U1", "V1"),
        type=whole(0),
        help="read out a region: first column and row, last column and row [px]",
    )


def add_tracer(parser: argparse.ArgumentParser) -> None:
    """--tracer, and the options of `add_radiance`."""
    parser.add_argument(
        "--tracer",
        choices=TRACERS,
        default="auto",
        help="who traces: Radiance; our own compiled tracer, which must agree with Radiance on a sample of rays, and "
        "of walks between surfaces; or auto, the compiled one where a scene can be shown by it and has work enough "
        "(default)",
    )
    add_radiance(parser)


def add_radiance(parser: argparse.ArgumentParser) -> None:
    """--radiance, --trust and --tracer-timeout."""
    parser.add_argument("--radiance", metavar="DIR", help="folder with another Radiance's bin and lib")
    parser.add_argument(
        "--trust", action="store_true", help="let included Radiance files run commands and name any file"
    )
    parser.add_argument(
        "--tracer-timeout",
        metavar="TIME",
        default="600 s",
        help='longest silence of a tracer, and longest time of other programs (default "600 s")',
    )


def tracer_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the options of `add_radiance` say, by the names of `RenderOptions` and `StudyOptions`."""
    return {
        **({"tracer": arguments.tracer} if "tracer" in arguments else {}),
        "radiance": arguments.radiance,
        "trust": arguments.trust,
        "tracer_timeout": time_of(arguments.tracer_timeout, "--tracer-timeout"),
    }


def out_folder(arguments: argparse.Namespace, what: str) -> Path:
    """Folder that --out names; `what` goes there."""
    if not arguments.out:
        raise InputError("is missing", where="--out", remedy=f"name a folder for the {what}")
    return Path(arguments.out)


def file_to_write(
    name: str | Path | None, where: str, suffix: str = "", *, others: Sequence[str | Path | None] = ()
) -> Path | None:
    """File that an option names, if any; its folder is there, its name ends as it must, and it is none of the others.

    The others are what the command reads, and its other results.
    """
    if name is None:
        return None
    path = Path(name)
    if not path.name or path.is_dir() or (suffix and path.suffix.lower() != suffix):
        kind = f"{suffix[1:].upper()} file" if suffix else "file"
        raise InputError(
            f'"{name}" is not the name of a {kind}', where=where, remedy=f"end it in {suffix}" if suffix else ""
        )
    if not path.parent.is_dir():
        raise InputError(f'there is no folder "{path.parent}"', where=where, remedy="make it first")
    check_result(path)
    if any(other is not None and os.path.realpath(path) == os.path.realpath(other) for other in others):
        raise InputError(
            f'"{path}" is read by this command, or is another of its results', where=where, remedy="choose another name"
        )
    return path


class Once(argparse.Action):
    """An option that is refused where it is given twice, as the first of two values would be lost without a word."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Keep the value."""
        if getattr(namespace, self.dest) is not None:
            raise argparse.ArgumentError(self, "is given twice")
        setattr(namespace, self.dest, values)


def add_scene_folder(parser: argparse.ArgumentParser, help: str) -> None:
    """--scene-folder, a folder that is there."""
    parser.add_argument("--scene-folder", metavar="DIR", type=_folder, help=help)


def _folder(text: str) -> Path:
    if not Path(text).is_dir():
        raise ArgumentTypeError(f'no such folder "{text}"')
    return Path(text)


def add_json(parser: argparse.ArgumentParser) -> None:
    """--json."""
    parser.add_argument("--json", action="store_true", help="machine-readable result on stdout")


def load(arguments: argparse.Namespace) -> Scene:
    """Read the scene, with what --set, --scale and --roi change."""
    scene = load_scene(arguments.scene, overrides_of(arguments))
    note_crop(scene)
    return scene


def note_crop(scene: Scene) -> None:
    """Say on stderr which region is left where the scale does not fit all of the sensor."""
    region = scene.assumed.get("camera.sensor.roi")
    if region is not None:
        print(f"radwrap: the scale leaves pixels over: read out is {region} [px]", file=sys.stderr)


def overrides_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Key -> value of what --set, --scale and --roi change."""
    changes = changes_of(arguments.overrides)
    for name in ("scale", "roi"):
        value = getattr(arguments, name)
        if value is not None:
            changes[f"camera.sensor.{name}"] = value
    return changes


def changes_of(overrides: Sequence[str]) -> dict[str, Any]:
    """Key -> value of KEY=VALUE texts."""
    return dict(map(_override, overrides))


def time_of(text: str, where: str) -> float:
    """Time that an option gives [s]; none is negative."""
    try:
        value = parse_quantity(text, TIME)
    except InputError as error:
        raise InputError(str(error), where=where) from error
    if value < 0:
        raise InputError(f'"{text}" is negative', where=where)
    return value


def _override(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f'"{text}" is not KEY=VALUE', where="--set")
    try:
        return key.strip(), parse_toml(f"value = {value}", "--set")["value"]
    except InputError:
        if value.strip().lstrip("+-").isdecimal():
            raise  # not a word without quotes, but a number that nobody can hold
        return key.strip(), value.strip()
