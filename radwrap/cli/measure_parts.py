"""``radwrap measure parts``: count, place, orientation and area of parts on an even background."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.cli import options as shared
from radwrap.cli import raw_mosaic
from radwrap.cli.gauging import with_sigma
from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.manifest import SCHEMA_VERSION, finite, json_text
from radwrap.measure.parts import DEFAULT_MIN_AREA, Part, Parts, find_parts, overlay_png
from radwrap.progress import Progress

_BYTES: Final = 80  # a pixel, as measured

OTHER: Final = 0.01  # share of the image on the other side of the ground; highlights of small parts take less


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("parts", help="count, place, orientation and area of parts", description=__doc__)
    parser.add_argument("image", metavar="IMAGE", type=Path, help="PNG, TIFF, PGM of 8 or 16 bits, or EXR")
    parser.add_argument(
        "--threshold",
        metavar="G",
        type=shared.GRAY_LEVEL,
        help="gray level of the contour (default: half-way, part by part)",
    )
    parser.add_argument(
        "--min-area",
        metavar="A",
        type=shared.number(),
        default=DEFAULT_MIN_AREA,
        help=f"smaller parts are left out [px^2] (default {DEFAULT_MIN_AREA:g})",
    )
    parser.add_argument(
        "--dark", metavar="G", type=shared.GRAY_LEVEL, help="gray level without light; needed with --gamma"
    )
    parser.add_argument(
        "--gamma", metavar="G", type=shared.number(), default=1.0, help="exponent of the sensor's response (default 1)"
    )
    parser.add_argument(
        "--pixel-aspect",
        metavar="A",
        type=shared.number(),
        default=1.0,
        help="height of a pixel over its width (default 1)",
    )
    parser.add_argument("--contours", action="store_true", help="with --json: the lines about each part and its holes")
    parser.add_argument("--overlay", metavar="PNG", type=Path, help="picture of what was found")
    raw_mosaic.add_to(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    overlay = shared.file_to_write(arguments.overlay, "--overlay", ".png", others=[arguments.image])
    image = raw_mosaic.read(arguments.image, arguments)
    shared.tell_memory("measure parts", image.values.size, _BYTES)
    progress = Progress("measuring parts", 1)
    try:
        found = find_parts(
            image,
            progress=progress,
            threshold=arguments.threshold,
            min_area=arguments.min_area,
            dark=arguments.dark,
            gamma=arguments.gamma,
            pixel_aspect=arguments.pixel_aspect,
        )
    except InputError as error:
        raise _located(error, arguments.image) from error
    finally:
        progress.close()
    if overlay is not None:
        write_bytes(overlay, overlay_png(image, found))
    print(json_text(_json(found, arguments)) if arguments.json else "\n".join(_lines(found)) + "\n", end="")
    return 0


def _located(error: InputError, path: Path) -> InputError:
    """The file's name, or the option's, where the function speaks of its arguments."""
    options = ("threshold", "min_area", "gamma", "dark", "pixel_aspect")
    return InputError(error.what, where=error.where if error.where in options else str(path), remedy=error.remedy)


def _json(found: Parts, arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "image": str(arguments.image),
        "pixel_convention": "u is the column, v the row; the centre of the first pixel is (0, 0)",
        "angles": "rad, from u towards v, in -pi/2 to pi/2",
        "axes": "of the ellipse with equal second moments; they are not diameters",
        "pixel_aspect": arguments.pixel_aspect,
        "contrast": found.kind,
        "ground": {
            "gray": finite(found.ground.gray),
            "share": found.ground.share,
            "border_share": found.ground.border_share,
            "other_share": found.ground.other_share,
        },
        "warnings": list(_warnings(found)),
        "count": len(found.parts),
        "parts": [_entry(part) | (_lines_of(part) if arguments.contours else {}) for part in found.parts],
    }


def _lines_of(part: Part) -> dict[str, Any]:
    """Corners to a thousandth of a pixel, which is less than noise leaves of them."""
    return {"contours": [np.round(line, 3).tolist() for line in part.contours]}


def _entry(part: Part) -> dict[str, Any]:
    u, v, length, width = part.rectangle
    return {
        "u": part.u,
        "sigma_u": part.sigma_u,
        "v": part.v,
        "sigma_v": part.sigma_v,
        "orientation": part.orientation,
        "orientation_deg": math.degrees(part.orientation),
        "sigma_orientation": part.sigma_orientation,
        "orientation_ambiguous": part.orientation_ambiguous,
        "area": part.area,
        "sigma_area": part.sigma_area,
        "major_axis": part.major_axis,
        "minor_axis": part.minor_axis,
        "rectangle": {
            "u": u,
            "v": v,
            "length": length,
            "width": width,
            "orientation": part.rectangle_orientation,
            "orientation_deg": math.degrees(part.rectangle_orientation),
        },
        "contrast_gray": part.contrast,
        "noise_gray": part.noise,
        "blur_radius": part.blur_radius,
        "touches_border": part.touches_border,
    }


def _warnings(found: Parts) -> Iterator[str]:
    if found.ground.other_share > OTHER:
        side = "brighter" if found.kind == "dark" else "darker"
        yield (
            f"{found.ground.other_share:.0%} of the image is {side} than the ground of gray {found.ground.gray:.4g}: "
            f"only {found.kind} parts were looked for; give a picture that holds one kind"
        )


def _lines(found: Parts) -> Iterator[str]:
    ground = found.ground
    yield f"{len(found.parts)} {found.kind} part{'s' if len(found.parts) > 1 else ''}"
    yield f"ground: gray {ground.gray:.4g}, {ground.share:.0%} of the image and {ground.border_share:.0%} of its border"
    yield from (f"warning: {text}" for text in _warnings(found))
    for number, part in enumerate(found.parts, start=1):
        turn = (
            f"no axis by moments, rectangle at {math.degrees(part.rectangle_orientation):.2f} deg"
            if part.orientation_ambiguous
            else f"{with_sigma(math.degrees(part.orientation), math.degrees(part.sigma_orientation), 3)} deg"
        )
        border = "; cut by the image's border" if part.touches_border else ""
        yield (
            f"{number}: u {with_sigma(part.u, part.sigma_u)}, v {with_sigma(part.v, part.sigma_v)} px; {turn}; "
            f"area {with_sigma(part.area, part.sigma_area, 2)} px^2; ellipse of equal moments {part.major_axis:.2f} x "
            f"{part.minor_axis:.2f} px{border}"
        )
