"""``radwrap trade``: what accuracy costs on a scene."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from radwrap.cli import options as shared
from radwrap.files import check_results
from radwrap.imaging.forecast.cost import duration
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text
from radwrap.study.trade import measure_trade
from radwrap.study.trade_report import FILES, as_json, pareto_front, recommendation, write_trade
from radwrap.study.trade_rows import Trade, TradeOptions

_DESCRIPTION = (
    "Runs every method with several settings on a scene, and measures time, rays and error in gray levels against rays "
    "of its own. Writes trade.csv, trade.json and trade.png into DIR; a killed run continues where it stopped."
)


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("trade", description=_DESCRIPTION)
    shared.add_scene(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for trade.csv, trade.json and trade.png")
    shared.add_tolerance(parser, "rms error that is wanted, which the settings lie around")
    parser.add_argument(
        "--longest",
        metavar="TIME",
        default="60 s",
        help='leave out settings that are expected to take longer (default "60 s")',
    )
    parser.add_argument(
        "--reference-pixels",
        metavar="N",
        type=shared.whole(),
        default=2000,
        help="pixels of the reference (default 2000)",
    )
    parser.add_argument(
        "--reference-rays",
        metavar="N",
        type=shared.whole(),
        default=1024,
        help="rays of each of its two values (default 1024)",
    )
    parser.add_argument(
        "--seed", metavar="S", type=shared.whole(), default=0, help="seed of all random draws (default 0)"
    )
    parser.add_argument(
        "--workers", metavar="W", type=shared.whole(), help="number of tracer processes (default: all cores)"
    )
    shared.add_tracer(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = shared.load(arguments)
    out = shared.out_folder(arguments, "results")
    options = TradeOptions(
        longest=shared.time_of(arguments.longest, "--longest"),
        reference_pixels=arguments.reference_pixels,
        reference_rays=arguments.reference_rays,
        render=RenderOptions(
            tolerance=arguments.tolerance,
            seed=arguments.seed,
            workers=arguments.workers,
            **shared.tracer_options(arguments),
            progress=True,
        ),
    )
    check_results(out, FILES)
    trade = measure_trade(scene, out, options)
    write_trade(trade, out)
    print(json_text(as_json(trade)) if arguments.json else "\n".join(_lines(trade)) + "\n", end="")
    return 0


def _lines(trade: Trade) -> Iterator[str]:
    front = {row.setting.name for row in pareto_front(trade.rows)}
    settings = [row.setting for row in trade.rows] + [left.setting for left in trade.left_out]
    wide = max((len(setting.options) for setting in settings), default=0)
    yield f"  {'setting':{wide}} {'rays':>9} {'time':>8} {'rms':>7} {'99 %':>7} {'max':>7}   (errors in gray levels)"
    for row in trade.rows:
        error = row.error
        yield (
            f"{'*' if row.setting.name in front else ' '} {row.setting.options:{wide}} {row.rays:9.3g} "
            f"{duration(row.wall_s):>8} {error.rms_gray:7.2g} {error.p99_gray:7.2g} {error.max_gray:7.2g}"
        )
    yield "Errors are against rays, which know no waves: what diffraction and aberrations change is in none of them."
    for left in trade.left_out:
        yield f"  {left.setting.options:{wide}} left out: {left.why}"
    yield (
        f"* none is faster and more exact; the reference, {len(trade.reference.sample.pixels)} pixels with "
        f"{trade.reference.rays:.3g} rays, is itself off by {trade.reference.rms_gray:.2g} gray rms, which is taken out"
    )
    yield recommendation(trade.rows, trade.tolerance)
