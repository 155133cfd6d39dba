"""``radwrap study analyse``: which factors matter, by how much, and how sure that is."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radwrap.cli import options as shared
from radwrap.errors import InputError
from radwrap.manifest import json_text

if TYPE_CHECKING:
    from radwrap.study.effects import Analysis


def add_to(kinds: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = kinds.add_parser("analyse", help="effects of the factors on a response", description=__doc__)
    parser.add_argument("results", metavar="RESULTS.csv", type=Path, help="table with a header, a row for each run")
    parser.add_argument("--response", metavar="COLUMN", required=True, help="with or without its unit")
    parser.add_argument("--factors", metavar="A,B,C", default="", help="columns of the factors (default: the study's)")
    parser.add_argument(
        "--label",
        dest="labels",
        metavar="A=TEXT",
        action="append",
        default=[],
        help="what a factor is; may be repeated",
    )
    parser.add_argument(
        "--alpha", metavar="A", type=shared.number(), default=0.05, help="share of false alarms (default 0.05)"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for analysis.json and plots")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    from radwrap.study.effects import analyse, as_json
    from radwrap.study.levels import read_data

    names = [name.strip() for name in arguments.factors.split(",") if name.strip()]
    data = read_data(arguments.results, arguments.response, names, dict(map(_label, arguments.labels)))
    analysis = analyse(data, arguments.alpha)
    if arguments.out:
        from radwrap.study.figures import write_figures

        write_figures(analysis, Path(arguments.out))
    print(json_text(as_json(analysis)) if arguments.json else "\n".join(_lines(analysis)) + "\n", end="")
    return 0


def _label(text: str) -> tuple[str, str]:
    name, equals, label = text.partition("=")
    if not equals or not label:
        raise InputError(f'"{text}" is not FACTOR=TEXT', where="--label")
    return name.strip(), label.strip()


def _lines(analysis: Analysis) -> Iterator[str]:
    from radwrap.study.effects import sentences

    data, unit = analysis.data, analysis.data.unit or "response"
    yield f"{len(data.values)} runs, response {data.response}, judged by {_method(analysis)}"
    wide = max((len(effect.name) for effect in analysis.effects), default=6)
    yield f"{'effect':{max(wide, 6)}} {f'[{unit}]':>14} {'t':>8}   image error"
    for effect in analysis.effects:
        t = "" if effect.t is None else f"{effect.t:8.2f}"
        mark = "*" if effect.significant else " "
        more = f"  {effect.start} to {effect.end}" if effect.start is not None else ""
        more += f"  = {' = '.join(effect.aliases)}" if effect.aliases else ""
        yield f"{effect.name:{max(wide, 6)}} {effect.effect:14.6g} {t:>8} {mark} {effect.image_error:.2g}{more}"
    if analysis.lenth is not None:
        found = analysis.lenth
        yield (
            f"PSE {found.pse:.6g}, ME {found.margin_of_error:.4g}, SME {found.simultaneous_margin_of_error:.4g} "
            f"{unit}; |t| beyond {found.t_limit:.3f} is significant (*) at {found.alpha:g} for one effect"
        )
        yield (
            f"by simulation beyond {found.simulated_limit:.2f} for one effect, "
            f"{found.simulated_limit_simultaneous:.2f} for all {len(found.t)} at a time"
        )
    for row in analysis.anova:
        tested = "" if row.f is None or row.p is None else f"  F {row.f:.4g}  p {row.p:.3g}"
        yield f"anova {row.term}: sum of squares {row.sum_of_squares:.5g}, df {row.degrees_of_freedom:g}{tested}"
    for note in analysis.notes:
        yield f"note: {note}"
    yield from sentences(analysis)


def _method(analysis: Analysis) -> str:
    return {
        "lenth": "Lenth's method",
        "replicates": "the scatter of replicates",
        "regression": "the residuals of a fit",
        "none": "nothing",
    }[analysis.method]
