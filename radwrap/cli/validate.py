"""``radwrap validate``: the score card."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.errors import CheckFailed
from radwrap.files import check_results
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text
from radwrap.validate.report import NUMBERS, REPORT, lines, write_card
from radwrap.validate.runner import validate

_DESCRIPTION = (
    "Runs radwrap against closed forms, printed tables and quadrature: lamps, interiors, furnace, aperture, sheeting, "
    "ring, sensor, calibration. One line a case; exit code 1 where one misses its limit."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("validate", description=_DESCRIPTION)
    parser.add_argument(
        "--only",
        dest="names",
        metavar="NAME",
        action="append",
        default=[],
        help='a section, "4", a check, "4.merging", or a case by its full name; may be repeated',
    )
    parser.add_argument("--out", metavar="DIR", help="folder for index.html, with plots, and validate.json")
    parser.add_argument(
        "--seed", metavar="S", type=shared.whole(), default=0, help="seed of all random draws (default 0)"
    )
    parser.add_argument(
        "--workers", metavar="W", type=shared.whole(), help="number of tracer processes (default: all cores)"
    )
    shared.add_radiance(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb; exit code 1 where a case misses its limit."""
    options = RenderOptions(
        tracer="radiance",
        seed=arguments.seed,
        workers=arguments.workers,
        **shared.tracer_options(arguments),
        progress=True,
    )
    if arguments.out:
        check_results(Path(arguments.out), (NUMBERS, REPORT))
    card = validate(options, arguments.names)
    if arguments.out:
        write_card(card, Path(arguments.out))
    print(json_text(card.as_json()) if arguments.json else "\n".join(lines(card)) + "\n", end="")
    return CheckFailed.exit_code if card.misses else 0
