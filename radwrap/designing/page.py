"""A design as one HTML file that asks for nothing from outside."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import Final

from radwrap.designing.told import Designed
from radwrap.designing.trials import Trial
from radwrap.files import write_bytes

PAGE: Final = "index.html"

_HTML: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body{{font:15px system-ui,sans-serif;margin:2rem auto;max-width:70rem;padding:0 1rem}}
table{{border-collapse:collapse}}td,th{{padding:.2rem .7rem;text-align:right;border-bottom:1px solid #8886}}
td:first-child,th:first-child{{text-align:left}}tr.best{{font-weight:bold}}tr.tie{{font-style:italic}}
tr.out{{opacity:.55}}</style></head><body>
<h1>{title}</h1><p>{asked}</p>
<ul>{answer}</ul>
<h2>Trials</h2>
<p>Bold: the best one. Italic: a tie with it within errors. Faint: breaks a limit, or was not made. Behind +- stands the
standard error by the image's own error.</p>
<table><tr>{heads}</tr>{rows}</table></body></html>
"""


def write_page(path: Path, found: Designed) -> None:
    """Write index.html."""
    problem = found.problem
    asked = [f"{'maximise' if one.is_maximised else 'minimise'} {one.quantity.name}" for one in problem.objectives] + [
        one.told() for one in problem.constraints
    ]
    quantities = problem.quantities
    heads = ["trial", "stage", *(key.name for key in problem.keys)]
    heads += [f"{one.name} [{one.unit}]" if one.unit else one.name for one in quantities]
    heads += ["image error", "what is wrong"]
    text = _HTML.format(
        title=escape(problem.study.title),
        asked=escape("; ".join(asked)),
        answer="".join(f"<li>{escape(line)}</li>" for line in found.lines()),
        heads="".join(f"<th>{escape(head)}</th>" for head in heads),
        rows="".join(_row(found, trial) for trial in found.trials),
    )
    write_bytes(path, text.encode())


def _row(found: Designed, trial: Trial) -> str:
    problem = found.problem
    cells = [str(trial.number), trial.stage]
    cells += [key.label(code) for key, code in zip(problem.keys, trial.codes, strict=True)]
    for one in problem.quantities:
        answer = trial.answers.get(one.name)
        error = "" if answer is None or not answer.error else f" +- {answer.error / one.scale:.2g}"
        cells.append("" if answer is None else f"{answer.value / one.scale:.6g}{error}")
    error = "" if trial.image_error is None else f"{trial.image_error:.2g}"
    missed = "misses its tolerance" if trial.is_rendered else "not rendered: it breaks a limit"
    cells += [error, trial.error or trial.warnings or ("" if trial.met else missed)]
    return f'<tr class="{_kind(found, trial)}">{_cells(cells)}</tr>'


def _cells(cells: Iterable[str]) -> str:
    return "".join(f"<td>{escape(cell)}</td>" for cell in cells)


def _kind(found: Designed, trial: Trial) -> str:
    if found.best is not None and trial.number == found.best.number:
        return "best"
    if any(trial.number == tie.number for tie in found.ties):
        return "tie"
    return "" if trial.is_feasible(found.problem) else "out"
