"""Raw images of colour cameras on the command line: which mosaic they have, and which colour is measured."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from radwrap.errors import InputError
from radwrap.images import GrayImage, read_gray
from radwrap.imaging.output.run_manifest import MANIFEST
from radwrap.manifest import read_manifest
from radwrap.measure.mosaic import COLOURS, PATTERNS, USUAL_COLOUR, Colour, Pattern, colour_image
from radwrap.scene.scene import Scene


def add_to(parser: argparse.ArgumentParser) -> None:
    """--mosaic and --channel."""
    parser.add_argument(
        "--mosaic",
        choices=PATTERNS,
        help="the image is the raw one of a colour camera with this mosaic (default: what the manifest beside it says)",
    )
    parser.add_argument(
        "--channel",
        choices=COLOURS,
        help="colour of such an image that is looked at; between its pixels the mean of their neighbours (default "
        f"{USUAL_COLOUR})",
    )


def read(path: str | Path, arguments: argparse.Namespace, scene: Scene | None = None) -> GrayImage:
    """Read a gray image, of a scene if that is known; of a raw mosaic one colour, and say so on stderr.

    Raises
    ------
    InputError
        As `read_gray`; if a channel is asked for of an image without mosaic, or the manifest names another mosaic.
    """
    path = Path(path)
    pattern = pattern_of(path, arguments, scene)
    image = read_gray(path)
    if pattern is None:
        return image
    colour: Colour = arguments.channel or USUAL_COLOUR
    try:
        made = colour_image(image, pattern, colour)
    except InputError as error:
        raise InputError(error.what, where=str(path), remedy=error.remedy) from error
    print(
        f"radwrap: {path}: the {colour} of the raw mosaic {pattern}, in raw pixels; between them means of neighbours, "
        "so that edges are wider, standard errors too small, and sharp edges along the grid off by up to a pixel",
        file=sys.stderr,
    )
    return made


def pattern_of(path: Path, arguments: argparse.Namespace, scene: Scene | None = None) -> Pattern | None:
    """The mosaic that an option tells of an image, the manifest beside it, or its scene; None where none does.

    Raises
    ------
    InputError
        If they contradict each other, or a channel is asked for of an image without mosaic.
    """
    told, known, by = arguments.mosaic, known_pattern(path), f"the manifest beside {path}"
    if is_monochrome(path):
        for option in ("mosaic", "channel"):
            if getattr(arguments, option) is not None:
                raise InputError(
                    f"is of a raw mosaic, and {by} says that all pixels have one filter",
                    where=f"--{option}",
                    remedy="leave it out",
                )
        return None
    if known is None and scene is not None and scene.camera.sensor.mosaic is not None:
        known, by = scene.camera.sensor.mosaic.pattern, "the scene"
    if told is not None and known is not None and told != known:
        raise InputError(f"is {told}, but {by} says {known}", where="--mosaic")
    pattern: Pattern | None = told or known
    if pattern is None and arguments.channel is not None:
        raise InputError(
            f"is of a raw mosaic, and nothing says that {path} is one", where="--channel", remedy="give --mosaic"
        )
    return pattern


def known_pattern(path: Path) -> Pattern | None:
    """The mosaic of an image, where the manifest of its render lies beside it."""
    made = (_told_of(path) or {}).get("mosaic")
    if not isinstance(made, dict):
        return None
    return next((pattern for pattern in PATTERNS if pattern == made.get("pattern")), None)


def is_monochrome(path: Path) -> bool:
    """Whether an image is that of a render without a mosaic, whose manifest lies beside it."""
    told = _told_of(path)
    return told is not None and "mosaic" not in told


def _told_of(path: Path) -> dict[str, Any] | None:
    """The manifest beside an image, where it is of the run that made it."""
    manifest = path.parent / MANIFEST
    if not manifest.is_file():
        return None
    told = read_manifest(manifest)
    return told if path.name in told.get("files", {}) else None


def one_colour(path: Path) -> GrayImage:
    """Read an image for what measures single pixels, or knows one colour; errors as `read_gray` and `refuse`."""
    refuse(path)
    return read_gray(path)


def refuse(path: Path) -> None:
    """For what knows one colour.

    Raises
    ------
    InputError
        If the image is known to be a raw mosaic.
    """
    pattern = known_pattern(path)
    if pattern is not None:
        raise InputError(
            f"is the raw mosaic {pattern} of a colour camera, and this knows one colour",
            where=str(path),
            remedy='give the image of one colour: render with camera.sensor.mosaic = "green"',
        )
