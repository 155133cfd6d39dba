"""``radwrap design``: find the values of a scene that make a measurement best."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.cli.study_run import add_workers, worker_options
from radwrap.errors import CheckFailed, ToleranceNotMet
from radwrap.manifest import json_text

_DESCRIPTION = (
    "Changes keys of a scene between bounds, in steps or by choice, until a measurement is as small or as large as "
    "limits allow: the sharpest edge by the size of the opening, the most even field by the levels of LEDs. "
    "Candidates are rendered coarsely first, those that may be best at the tolerance asked for, and the best one "
    "again by other rays. Writes design.json, trials.csv, best.toml and index.html into DIR. A killed run continues "
    "where it stopped, and the same seed gives the same result, whatever the number of workers. Exit code 1: no "
    "candidate keeps all limits."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("design", description=__doc__)
    kinds: argparse._SubParsersAction[Any] = parser.add_subparsers(title="what", required=True, metavar="WHAT")
    made = kinds.add_parser("run", help="find the best scene of a design", description=_DESCRIPTION)
    made.add_argument(
        "design",
        metavar="DESIGN.toml",
        type=Path,
        help="scene, keys, objectives, constraints, number of renders; see docs/design.md",
    )
    made.add_argument("--out", metavar="DIR", help="folder for design.json, trials.csv, best.toml, index.html")
    add_workers(made)
    made.add_argument("--retry-failed", action="store_true", help="repeat the renders that failed before")
    shared.add_tracer(made)
    shared.add_json(made)
    made.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    from radwrap.designing.document import read_problem
    from radwrap.designing.run import run_design
    from radwrap.study.study import StudyOptions

    out = shared.out_folder(arguments, "results")
    options = StudyOptions(
        **worker_options(arguments),
        retry_failed=arguments.retry_failed,
        **shared.tracer_options(arguments),
        progress=True,
    )
    found = run_design(read_problem(arguments.design, trust=options.trust), out, options)
    print(json_text(found.manifest) if arguments.json else "\n".join(found.lines()) + "\n", end="")
    if found.best is None:
        raise CheckFailed("no trial keeps all limits", where=str(out / "trials.csv"))
    if not found.met:
        raise ToleranceNotMet("the best scene's image misses its tolerance; its error says so", where=str(out))
    return 0
