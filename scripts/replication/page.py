"""All figures and tables on one page that needs no other file, and the picture of all verdicts."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.imaging.output.run_manifest import read_run_manifest
from radwrap.manifest import read_manifest
from radwrap.study.table import read_table
from replication.figure import figure, png, style
from replication.published import published

NAMES: Final = ("fig05", "fig08_09", "fig10", "fig11", "fig12", "fig13", "table1", "table3", "table3_reason", "table4")
COLOURS: Final = {"reproduced": "#7cc47f", "in_kind": "#f4d35e", "not_reproduced": "#e57368"}
_ACROSS: Final = 3  # columns of the summary
_TEMPLATE: Final = Path(__file__).with_name("page.html")


def write_page(figures: Path, out: Path) -> tuple[Path, Path]:
    """Write index.html and summary.png.

    Raises
    ------
    InputError
        If a figure's files are missing.
    """
    from jinja2 import Environment, StrictUndefined

    parts = [_part(figures, name) for name in NAMES]
    table3 = next(part for part in parts if part["name"] == "table3")
    with style():
        summary = png(summary_picture(parts))
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters["told"] = told
    text = environment.from_string(_TEMPLATE.read_text("utf-8")).render(
        title=published()["title"],
        quick=any(part["quick"] for part in parts),
        counts=verdict_counts(parts),
        summary=base64.b64encode(summary).decode(),
        parts=parts,
        sensitivity=table3["sensitivity"],
        not_run=table3.get("not_run", []),
        failed=table3["failed"],
        doubts={one["name"]: one["doubt"] for one in published()["variants"] if "doubt" in one},
        changed=published()["changed"],
        spent=spent(figures),
        same_versions=all(part["versions"] == parts[0]["versions"] for part in parts),
        untested=published()["untested"],
        assumptions=published()["assumptions"],
        versions=parts[0]["versions"],
    )
    make_folder(out)
    write_bytes(out / "index.html", text.encode())
    write_bytes(out / "summary.png", summary)
    return out / "index.html", out / "summary.png"


def _part(figures: Path, name: str) -> dict[str, Any]:
    picture, numbers = figures / f"{name}.png", figures / f"{name}.json"
    if not (picture.is_file() and numbers.is_file()):
        raise InputError("is missing", where=str(numbers), remedy="run make figures")
    return {**read_manifest(numbers), "picture": base64.b64encode(picture.read_bytes()).decode()}


def spent(figures: Path) -> dict[str, float]:
    """What the images and studies that lie there took when they were made [s]."""
    images = [read_run_manifest(path.parent).timing.wall_s for path in sorted(figures.glob("renders/*/manifest.json"))]
    tables = [read_table(path) for path in sorted(figures.glob("studies*/*/*/study/timings.csv"))]
    return {"images": sum(images), "studies": sum(float(row["wall_s"]) for table in tables for row in table.rows)}


def verdict_counts(parts: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many claims have which verdict."""
    found = Counter(claim["verdict"] for part in parts for claim in part["claims"])
    return {verdict: found[verdict] for verdict in COLOURS}


def told(value: Any) -> str:
    """A number, or a list of them, as a table shows it."""
    match value:
        case None:
            return ""
        case list():
            return " ".join(f"{number:g}" for number in value)
        case float():
            return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.3g}"
    return str(value)


def summary_picture(parts: Sequence[Mapping[str, Any]]) -> Any:
    """A coloured line for each claim."""
    lines: list[tuple[str, str]] = []
    for part in parts:
        if part["claims"]:
            lines.append((f"{part['name']}: {part['title']}", ""))
            lines += [(claim["id"].partition(".")[2].replace("_", " "), claim["verdict"]) for claim in part["claims"]]
    height = -(-len(lines) // _ACROSS)
    picture, panels = figure(7.6, 0.17 * height + 0.45)
    axes = panels[0, 0]
    for number, (text, verdict) in enumerate(lines):
        column, row = divmod(number, height)
        if verdict:
            axes.plot(column + 0.03, row, "s", color=COLOURS[verdict], ms=7)
            axes.text(column + 0.07, row, f"{text}: {verdict.replace('_', ' ')}", va="center")
        else:
            axes.text(column, row, text, va="center", weight="bold")
    axes.set(xlim=(-0.02, _ACROSS), ylim=(height - 0.5, -0.6))
    axes.axis("off")
    counts = verdict_counts(parts)
    what = ", ".join(f"{count} {verdict.replace('_', ' ')}" for verdict, count in counts.items())
    quick = "quick run, no verdict counts: " if any(part["quick"] for part in parts) else ""
    picture.suptitle(f"{quick}{sum(counts.values())} claims of the paper: {what}")
    return picture
