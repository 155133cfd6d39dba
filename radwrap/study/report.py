"""The report of a study: one HTML file that needs no other, with plots, tables that sort, and a picture of each run."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.study.design import Design
from radwrap.study.effects import Analysis, Effect, analyse, sentences
from radwrap.study.factors import Factor
from radwrap.study.figures import figures
from radwrap.study.journal import RESULTS, columns_of
from radwrap.study.levels import read_data
from radwrap.study.responses import Response
from radwrap.study.study import Study
from radwrap.study.worker import thumbnail_path

REPORT: Final = "index.html"
_DIGITS: Final = 6
# An effect on so many factors is told in results.csv and by `study analyse`, but no longer fits a page.
_MOST_EFFECTS: Final = 200


def write_report(study: Study) -> Path:
    """Write index.html into the study's folder; returns its path."""
    path = study.folder / REPORT
    write_bytes(path, report(study).encode())
    return path


def report(study: Study) -> str:
    """The report as HTML."""
    from jinja2 import Environment, StrictUndefined

    template = (files("radwrap") / "data" / "study" / "report.html").read_text("utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    design = study.design
    return (
        environment.from_string(template).render(
            title=design.title,
            summary=study.summary,
            responses=[_response(study, response) for response in design.responses],
            columns=[*columns_of(design)],
            rows=[_row(study, row) for row in study.rows],
            factors=[_factor(factor) for factor in design.factors],
            scene_origin=design.scene_origin,
            scene=[(key, value) for key, value in _leaves(design.document, "") if not key.endswith("].index")],
            provenance=list(_provenance(study)),
        )
        + "\n"
    )


def _response(study: Study, response: Response) -> dict[str, Any]:
    what = f"{response.name}: {response.what}" + (f" [{response.unit}]" if response.unit else "")
    empty: dict[str, Any] = {"heading": what, "unit": "", "effects": [], "plots": [], "limits": "", "notes": []}
    try:
        analysis = analyse(read_data(study.folder / RESULTS, response.column))
    except InputError as error:
        return {**empty, "sentences": [f"Nothing can be said of it: {error}"]}
    plots = [
        {"name": name.replace("_", " "), "data": base64.b64encode(content).decode()}
        for name, content in figures(analysis).items()
    ]
    return {
        "heading": what,
        "unit": f" [{response.unit}]" if response.unit else "",
        "sentences": sentences(analysis),
        "notes": analysis.notes,
        "effects": [_effect(effect) for effect in analysis.effects[:_MOST_EFFECTS]],
        "plots": plots,
        "limits": _limits(analysis),
    }


def _effect(effect: Effect) -> dict[str, Any]:
    said = "" if effect.significant is None else "yes" if effect.significant else "no"
    return {
        "name": effect.name,
        "effect": _shown(effect.effect),
        "t": "" if effect.t is None else f"{effect.t:.2f}",
        "significant": effect.significant,
        "said": said,
        "image_error": f"{effect.image_error:.2g}",
        "aliases": " = ".join(effect.aliases),
    }


def _limits(analysis: Analysis) -> str:
    unit = f" {analysis.data.unit}" if analysis.data.unit else ""
    if analysis.lenth is not None:
        found = analysis.lenth
        return (
            f"Lenth's method: PSE {found.pse:.4g}{unit}, ME {found.margin_of_error:.4g}{unit}, "
            f"SME {found.simultaneous_margin_of_error:.4g}{unit}; limit of |t| {found.t_limit:.3f}, by simulation "
            f"{found.simulated_limit:.2f} for one effect and {found.simulated_limit_simultaneous:.2f} for all."
        )
    if analysis.margin is None:
        return ""
    how = "replicates" if analysis.method == "replicates" else "a fit's residuals"
    return (
        f"By the scatter of {how}: an effect beyond {analysis.margin:.4g}{unit} is significant at {analysis.alpha:g}."
    )


def _row(study: Study, row: Mapping[str, str]) -> dict[str, Any]:
    path = thumbnail_path(study.folder, int(row["run"]))
    thumbnail = base64.b64encode(path.read_bytes()).decode() if path.is_file() else ""
    return {"run": row["run"], "cells": [cell(name, row[name]) for name in row], "thumbnail": thumbnail}


def cell(column: str, text: str) -> dict[str, str]:
    """A cell of the table of runs: its kind, what it sorts by, and what is shown."""
    if column == "error":
        return {"kind": "error", "value": text, "shown": text}
    try:
        number = float(text)
    except ValueError:
        return {"kind": "", "value": text, "shown": text}
    # Whole numbers, such as seeds, are names as much as numbers.
    whole = text.removeprefix("-").isdigit()
    return {"kind": "number", "value": text, "shown": text if whole else _shown(number)}


def _shown(number: float) -> str:
    return f"{number:.{_DIGITS}g}"


def _factor(factor: Factor) -> dict[str, str]:
    levels = [f"{level.name}: {', '.join(map(str, level.values))}" for level in factor.levels]
    if factor.span is not None:
        levels = [f"{factor.span[0]:g} to {factor.span[1]:g} {factor.unit}".strip()]
    return {"name": factor.name, "label": factor.label, "sets": ", ".join(factor.keys), "levels": "; ".join(levels)}


def _leaves(value: Any, key: str) -> Iterator[tuple[str, str]]:
    """Key path and value of everything in the base scene; lists of plain values stay together."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        for number, item in enumerate(value):
            yield from _leaves(item, f"{key}[{number}]")
    else:
        yield key, ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _provenance(study: Study) -> Iterator[tuple[str, str]]:
    design: Design = study.design
    yield "study", str(study.summary["study_sha256"])
    yield "design", f"{design.origin}: {design.kind}, {design.replicates} replicates, seed {design.seed}"
    yield "render", ", ".join(f"{key} = {value}" for key, value in design.render.items()) or "tolerance 0.5 (default)"
    for response in design.responses:
        options = ", ".join(f"{key} = {value}" for key, value in response.options.items())
        yield f"response {response.name}", f"{response.kind} {options}".strip()
    yield from study.summary["versions"].items()
