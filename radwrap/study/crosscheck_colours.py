"""A colour camera by both tracers: each colour as a monochrome camera behind its filter sees the scene.

Colours whose light is that of another but for a factor differ by the same share, and are compared once.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from radwrap.files import make_folder
from radwrap.imaging.mosaicked import plane_of, rendered_colours
from radwrap.imaging.output.folder import PLANES
from radwrap.manifest import SCHEMA_VERSION, write_manifest
from radwrap.scene.colour_planes import mosaic_of
from radwrap.scene.mosaic import Colour
from radwrap.scene.scene import Scene
from radwrap.study.crosscheck import Crosscheck, CrosscheckOptions, crosscheck
from radwrap.study.crosscheck_report import RESULT, as_json, write_crosscheck


def crosscheck_colours(scene: Scene, out: Path, options: CrosscheckOptions) -> dict[Colour, Crosscheck]:
    """Trace the colours of a mosaic by both and compare; each has its files in a folder of its own.

    Parameters
    ----------
    scene : Scene
        With a mosaic.
    out : Path
        A folder.
    options : CrosscheckOptions
        How.

    Raises
    ------
    InputError, EnvironmentFailure
        As `crosscheck`.
    """
    found = {}
    for colour in rendered_colours(scene, options.render):
        folder = out / PLANES / colour
        found[colour] = crosscheck(plane_of(scene, colour), folder, options)
        write_crosscheck(found[colour], folder)
    return found


def colours_as_json(scene: Scene, found: Mapping[Colour, Crosscheck]) -> dict[str, Any]:
    """Numbers of all colours, and whether all agree."""
    colours = {colour: as_json(one) for colour, one in found.items()}
    return {
        "schema_version": SCHEMA_VERSION,
        "scene": scene.origin,
        "mosaic": mosaic_of(scene).pattern,
        "agrees": all(one["agrees"] for one in colours.values()),
        "colours": colours,
    }


def write_colours(told: Mapping[str, Any], out: Path) -> None:
    """Write the numbers of all colours."""
    make_folder(out)
    write_manifest(out / RESULT, told)
