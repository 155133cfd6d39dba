"""``radwrap study tolerate``: how far each factor may be off before a response leaves its bounds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from radwrap.cli import options as shared
from radwrap.cli.study_run import add_workers, worker_options
from radwrap.errors import CheckFailed, InputError, ToleranceNotMet
from radwrap.manifest import json_text, write_manifest

_DESCRIPTION = (
    "Runs the study in DIR, as far as it has not been run, and finds for each factor how far it may be off, or how "
    "much of its scatter is allowed, so that a response stays within bounds: by the study's own model, confirmed by "
    "fresh renders. Writes tolerances.json into DIR; exit code 1 where a tolerance was not confirmed, "
    "3 where images miss the tolerance of their render."
)


def add_to(kinds: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = kinds.add_parser(
        "tolerate", help="tolerances that keep a response within bounds", description=_DESCRIPTION
    )
    parser.add_argument("design", metavar="DESIGN.toml", type=Path, help="file of the study; see docs/study.md")
    parser.add_argument("--out", metavar="DIR", help="folder of the study (default: study beside DESIGN.toml)")
    parser.add_argument("--response", metavar="NAME", required=True, help="a response of the design")
    parser.add_argument("--within", metavar="BOUND", required=True, help='"0.1%%" of its nominal value, or "0.05 mm"')
    parser.add_argument(
        "--repeats", metavar="N", type=shared.whole(), default=3, help="fresh seeds for each system (default 3)"
    )
    parser.add_argument(
        "--share",
        metavar="S",
        type=shared.number(),
        default=0.95,
        help="share of random systems that must stay within (default 0.95)",
    )
    parser.add_argument(
        "--systems", metavar="N", type=shared.whole(), default=8, help="number of random systems to look at (default 8)"
    )
    add_workers(parser)
    shared.add_tracer(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    from radwrap.study.design import read_design
    from radwrap.study.study import StudyOptions
    from radwrap.study.tolerance_report import as_json, sentences
    from radwrap.study.tolerate import TOLERANCES, read_bound, tolerate

    design = read_design(arguments.design)
    bound = read_bound(design, arguments.response, arguments.within)
    if arguments.out is not None and not arguments.out:
        raise InputError("is missing", where="--out", remedy="name a folder")
    out = Path(arguments.out) if arguments.out else arguments.design.parent / "study"
    options = StudyOptions(
        **worker_options(arguments),
        **shared.tracer_options(arguments),
        progress=True,
    )
    found = tolerate(
        design,
        out,
        bound,
        options,
        repeats=arguments.repeats,
        share=arguments.share,
        systems=arguments.systems,
    )
    told = as_json(found)
    write_manifest(out / TOLERANCES, told)
    print(json_text(told) if arguments.json else "\n".join(sentences(found)) + "\n", end="")
    if found.images_not_met:
        raise ToleranceNotMet(f"{found.images_not_met} images do not keep the tolerance")
    return 0 if found.met else CheckFailed.exit_code
