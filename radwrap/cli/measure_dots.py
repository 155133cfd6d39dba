"""``radwrap measure dots``: centres of all dots of a calibration board."""

from __future__ import annotations

import argparse
import math
import re
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.cli import raw_mosaic
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.images import GrayImage
from radwrap.manifest import json_text
from radwrap.measure.dots import METHODS, Dots, DotsNotFound, find_dots
from radwrap.measure.dots.overlay import overlay_png
from radwrap.progress import Progress
from radwrap.units import LENGTH, parse_quantity

_BYTES: Final = 50  # a pixel, as measured

SCHEMA_VERSION = 1


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("dots", help="centres of all dots of a calibration board", description=__doc__)
    parser.add_argument("image", metavar="IMAGE", help="gray image: PNG, TIFF, PGM or EXR")
    parser.add_argument("--grid", metavar="RxC", required=True, help="rows and columns of dots, such as 5x5")
    parser.add_argument("--method", choices=METHODS, default="gray", help="definition of the centre (default gray)")
    parser.add_argument(
        "--dark", metavar="G", type=shared.GRAY_LEVEL, help="gray level without light, subtracted from bright dots"
    )
    parser.add_argument(
        "--saturation", metavar="G", type=shared.GRAY_LEVEL, help="gray level at which the sensor saturates"
    )
    parser.add_argument("--pitch", metavar="LENGTH", help='distance of neighbouring dots, such as "19.05 mm"')
    parser.add_argument("--dot-diameter", metavar="LENGTH", help='such as "15.875 mm"')
    parser.add_argument("--overlay", metavar="PNG", help="picture of what was found, also where dots are missing")
    parser.add_argument("--csv", metavar="FILE", help="table of the dots")
    raw_mosaic.add_to(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    rows, columns = _grid(arguments.grid)
    pitch = _length(arguments.pitch, "--pitch")
    diameter = _length(arguments.dot_diameter, "--dot-diameter")
    for name, gray in (("--dark", arguments.dark), ("--saturation", arguments.saturation)):
        if gray is not None and not (math.isfinite(gray) and (gray > 0 or name == "--dark")):
            raise InputError(f"{gray} is not a gray level", where=name)
    overlay = shared.file_to_write(arguments.overlay, "--overlay", ".png", others=[arguments.image])
    table = shared.file_to_write(arguments.csv, "--csv", others=[arguments.image, overlay])
    path = Path(arguments.image)
    image = raw_mosaic.read(path, arguments)
    shared.tell_memory("measure dots", image.values.size, _BYTES)
    progress = Progress("measuring dots", 1)
    try:
        dots = find_dots(
            image,
            rows,
            columns,
            method=arguments.method,
            dark=arguments.dark,
            pitch=pitch,
            dot_diameter=diameter,
            saturation=arguments.saturation,
            progress=progress,
        )
    except DotsNotFound as error:
        raise _with_overlay(error, image, path, overlay) from error
    except InputError as error:
        raise InputError(error.what, where=error.where or str(path), remedy=error.remedy) from error
    finally:
        progress.close()
    if overlay is not None:
        write_bytes(overlay, overlay_png(image, dots))
    if table is not None:
        write_bytes(table, _csv(dots).encode())
    print(json_text(_document(dots, path)) if arguments.json else _table(dots), end="")
    return 0


def _with_overlay(error: DotsNotFound, image: GrayImage, path: Path, overlay: Path | None) -> InputError:
    """Write the picture of what was found; without --overlay it lies in the working folder."""
    place = overlay or Path(f"{path.stem}.dots.png")
    write_bytes(place, overlay_png(image, error.found, error.missing))
    return InputError(error.what, where=str(path), remedy=f"{error.remedy}; see {place}")


def _grid(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,5})[xX]([0-9]{1,5})", text.strip())
    if match is None:
        raise InputError(f'"{text}" is not a grid', where="--grid", remedy="write rows x columns, such as 5x5")
    return int(match[1]), int(match[2])


def _length(text: str | None, option: str) -> float | None:
    try:
        return None if text is None else parse_quantity(text, LENGTH)
    except InputError as error:
        raise InputError(error.what, where=option, remedy=error.remedy) from error


def _document(dots: Dots, path: Path) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "image": str(path),
        "grid": [dots.rows, dots.columns],
        "method": dots.method,
        "contrast": dots.contrast,
        "noise_gray": dots.noise,
        "dots": [
            {
                "row": dot.row,
                "column": dot.column,
                "u": dot.u,
                "v": dot.v,
                "covariance": dot.covariance.tolist(),
                "area": dot.area,
                "saturated_fraction": dot.saturated_fraction,
                "split": dot.split,
                "unlike": dot.unlike,
            }
            for dot in dots.dots
        ],
        "warnings": list(dots.warnings),
    }


def _csv(dots: Dots) -> str:
    lines = ["row,column,u,v,var_u,cov_uv,var_v,area,saturated_fraction,split,unlike"]
    for dot in dots.dots:
        (uu, uv), (_, vv) = dot.covariance.tolist()
        lines.append(
            f"{dot.row},{dot.column},{dot.u!r},{dot.v!r},{uu!r},{uv!r},{vv!r},{dot.area!r},"
            f"{dot.saturated_fraction!r},{int(dot.split)},{dot.unlike!r}"
        )
    return "\n".join(lines) + "\n"


def _table(dots: Dots) -> str:
    lines = [
        f"{dots.rows} x {dots.columns} {dots.contrast} dots, method {dots.method}, noise {dots.noise:.2f} gray levels",
        " row column         u         v  sigma_u  sigma_v      area  saturated  split",
    ]
    for dot in dots.dots:
        sigma_u, sigma_v = math.sqrt(dot.covariance[0, 0]), math.sqrt(dot.covariance[1, 1])
        lines.append(
            f"{dot.row:4d} {dot.column:6d} {dot.u:9.3f} {dot.v:9.3f}  {sigma_u:7.4f}  {sigma_v:7.4f} {dot.area:9.1f}"
            f"  {dot.saturated_fraction:9.0%}  {'yes' if dot.split else 'no'}"
        )
    return "\n".join([*lines, *(f"warning: {warning}" for warning in dots.warnings)]) + "\n"
