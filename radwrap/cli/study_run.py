"""``radwrap study run``: render and measure every run of a design."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from radwrap.cli import options as shared
from radwrap.errors import CheckFailed, ToleranceNotMet
from radwrap.files import check_results
from radwrap.manifest import json_text

if TYPE_CHECKING:
    from radwrap.study.study import Study

_DESCRIPTION = (
    "Changes a scene by a design, predicts every image, and measures it. Writes results.csv, a row for each run as "
    "soon as it is finished, study.json and index.html into DIR. A killed study continues where it stopped; a run "
    "that fails is a row with its error."
)

_MOST_NAMED: Final = 8  # runs, in one line


def add_to(kinds: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = kinds.add_parser("run", help="render and measure every run of a design", description=_DESCRIPTION)
    parser.add_argument(
        "design", metavar="DESIGN.toml", type=Path, help="factors, design, responses; see docs/study.md"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for results.csv, study.json, index.html")
    add_workers(parser)
    parser.add_argument("--retry-failed", action="store_true", help="repeat the runs that failed before")
    parser.add_argument("--no-report", action="store_true", help="leave out index.html")
    shared.add_tracer(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def add_workers(parser: argparse.ArgumentParser) -> None:
    """--workers, --dask and --worker-timeout."""
    parser.add_argument(
        "--workers", metavar="N", type=shared.whole(), help="processes, each with one tracer (default: all cores)"
    )
    parser.add_argument("--dask", metavar="ADDRESS", help='workers of a Dask cluster, such as "tcp://host:8786"')
    parser.add_argument(
        "--worker-timeout",
        metavar="TIME",
        help='how long the cluster may have no worker before the command ends (default "60 s")',
    )


def worker_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the options of `add_workers` say, by the names of `StudyOptions`."""
    timeout = arguments.worker_timeout
    return {
        "workers": arguments.workers,
        "dask": arguments.dask,
        "worker_timeout": None if timeout is None else shared.time_of(timeout, "--worker-timeout"),
    }


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    from radwrap.study.design import read_design
    from radwrap.study.journal import RESULTS
    from radwrap.study.report import REPORT, write_report
    from radwrap.study.study import PLAN, STUDY, StudyOptions, run_study

    out = shared.out_folder(arguments, "results")
    design = read_design(arguments.design)
    options = StudyOptions(
        **worker_options(arguments),
        retry_failed=arguments.retry_failed,
        **shared.tracer_options(arguments),
        progress=True,
    )
    check_results(out, (PLAN, RESULTS, STUDY) if arguments.no_report else (PLAN, RESULTS, STUDY, REPORT))
    study = run_study(design, out, options)
    if not arguments.no_report:
        write_report(study)
    told = study.summary
    if arguments.json:
        print(json_text(told), end="")
    else:
        print(
            f"{study.folder}/results.csv: {told['runs']} runs, {told['failed']} failed, by {told['renders']} renders"
            + (f" ({told['relit']} images from {told['light_bases']} light bases)" if told["relit"] else "")
            + (f"; {told['warned']} with warnings of gauges" if told["warned"] else "")
        )
    _check(study)
    return 0


def _check(study: Study) -> None:
    """What a complete table may still lack."""
    told, where = study.summary, f"{study.folder}/results.csv"
    if told["failed"]:
        first = next(row for row in study.rows if row["error"])
        raise CheckFailed(
            f"{told['failed']} of {told['runs']} runs failed, first run {first['run']}: {first['error']}",
            where=where,
            remedy="--retry-failed repeats them",
        )
    if told["not_met"]:
        raise ToleranceNotMet(f"{_missed(told['missed'])}; their error bars say so", where=where)


def _missed(missed: Mapping[str, float]) -> str:
    """Which runs do not keep the tolerance, and what the first of them keep."""
    named = ", ".join(f"{run} ({bound:.2g})" for run, bound in list(missed.items())[:_MOST_NAMED])
    more = f" and {len(missed) - _MOST_NAMED} more" if len(missed) > _MOST_NAMED else ""
    return f"{len(missed)} images do not keep the tolerance: run {named}{more} [gray rms]"
