"""The score card as text, and as one HTML file that needs no other."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Final

from radwrap.figure_png import figure_png
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import json_text, versions
from radwrap.validate.case import Case, Plot
from radwrap.validate.runner import SECTIONS, ScoreCard

REPORT: Final = "index.html"
NUMBERS: Final = "validate.json"


def lines(card: ScoreCard) -> Iterator[str]:
    """One line a case."""
    wide = max((len(case.name) for case in card.cases), default=4)
    yield f"{'case':{wide}} {'reference':>13} {'radwrap':>13} {'error':>9} {'limit':>9}"
    for case in card.cases:
        reference, ours, error, limit, verdict = _cells(case)
        note = f"  {case.note}" if case.note else ""
        yield f"{case.name:{wide}} {reference:>13} {ours:>13} {error:>9} {limit:>9}  {verdict}{note}"
    missed = len(card.misses)
    yield f"{len(card.cases) - missed} of {len(card.cases)} cases keep their limits" + (
        f", {missed} MISS" if missed else ""
    )


def _cells(case: Case) -> tuple[str, str, str, str, str]:
    def shown(value: float | None, digits: int) -> str:
        return "-" if value is None else f"{value:.{digits}g}"

    sign = ">= " if case.measure == "at least" else ""
    limit = "-" if case.reference is None else f"{sign}{case.limit:.2g}"
    return (
        shown(case.reference, 7),
        shown(case.ours, 7),
        shown(case.error, 2),
        limit,
        "ok" if case.passed else "MISS",
    )


def write_card(card: ScoreCard, out: Path) -> tuple[Path, Path]:
    """Write validate.json and index.html, the report last."""
    make_folder(out)
    write_bytes(out / NUMBERS, json_text(card.as_json()).encode())
    write_bytes(out / REPORT, html(card).encode())
    return out / NUMBERS, out / REPORT


def html(card: ScoreCard) -> str:
    """The report, section by section, with its plots inside."""
    from jinja2 import Environment, StrictUndefined

    template = (files("radwrap") / "data" / "validate" / "report.html").read_text("utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    sections = []
    for number, title in SECTIONS.items():
        cases = [case for case in card.cases if case.name.startswith(f"{number}.")]
        plots = [plot for name, plot in card.plots if name.startswith(f"{number}.")]
        if cases:
            sections.append(
                {
                    "title": f"{number}. {title}",
                    "rows": [
                        {"name": case.name, "source": case.source, "cells": _cells(case)[:4], "ok": case.passed}
                        | {"note": case.note, "measure": case.measure}
                        for case in cases
                    ],
                    "plots": [
                        {"title": plot.title, "data": base64.b64encode(picture(plot)).decode()} for plot in plots
                    ],
                }
            )
    text = environment.from_string(template).render(
        passed=len(card.cases) - len(card.misses),
        number=len(card.cases),
        missed=[case.name for case in card.misses],
        sections=sections,
        versions=list(versions().items()),
    )
    return f"{text}\n"


def picture(plot: Plot) -> bytes:
    """PNG of some curves; same input, same bytes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), dpi=100, layout="constrained")
    axes = figure.subplots()
    for label, (x, y) in plot.curves.items():
        line = label.startswith(("reference", "limit"))
        style = {"color": "0.5" if label.startswith("reference") else "C3", "lw": 1.2} if line else {"ms": 4}
        axes.plot(x, y, "-" if line else ".", label=label, **style)
    if "x" in plot.log:
        axes.set_xscale("log")
    if "y" in plot.log:
        axes.set_yscale("log")
    axes.set(title=plot.title, xlabel=plot.x_label, ylabel=plot.y_label)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="small", frameon=False)
    return figure_png(figure)
