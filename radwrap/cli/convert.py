"""``radwrap convert``: a scene as files that other programs read."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.convert.radiance_files import write_scene, write_view
from radwrap.errors import InputError
from radwrap.manifest import json_text
from radwrap.process import Limits
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser(
        "convert",
        help="write a scene as a Radiance scene (.rad) or its central view (.vf)",
        description="Writes OUT.rad with its function and data files beside it, named OUT.*, or OUT.vf. "
        "oconv OUT.rad works in that folder.",
    )
    shared.add_scene(parser)
    parser.add_argument("out", metavar="OUT", help="file to write, ending in .rad or .vf")
    shared.add_radiance(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = shared.load(arguments)
    out = Path(arguments.out)
    match out.suffix:
        case ".rad":
            limits = Limits(silence=shared.time_of(arguments.tracer_timeout, "--tracer-timeout"))
            radiance = RadianceOptions(find_radiance(arguments.radiance), arguments.trust, limits)
            written = write_scene(scene, out, radiance)
        case ".vf":
            written = write_view(scene, out)
        case suffix:
            raise InputError(
                f'cannot write "{suffix or out.name}"', where=str(out), remedy="end the name in .rad or .vf"
            )
    if arguments.json:
        print(json_text({"files": [str(path) for path in written]}), end="")
    else:
        print("\n".join(map(str, written)))
    return 0
