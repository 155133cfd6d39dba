"""The trade as a table, as JSON, as a picture, and in one sentence."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any, Final

from radwrap.figure_png import figure_png
from radwrap.files import write_bytes
from radwrap.imaging.forecast.cost import duration
from radwrap.manifest import SCHEMA_VERSION, json_text
from radwrap.study.trade_rows import Row, Trade

TABLE: Final = "trade.csv"
NUMBERS: Final = "trade.json"
PICTURE: Final = "trade.png"
FILES: Final = (TABLE, NUMBERS, PICTURE)

_SMALLEST_SHOWN: Final = 1e-3  # gray levels; a logarithmic axis has no zero
_MARKERS: Final = {"pinhole": "s", "viewpoints": "o", "kernel": "D", "hybrid": "v", "rays": "^"}


def pareto_front(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Settings than which no other is both as fast and more exact, or as exact and faster; the fastest first.

    Exact is what has a low bound of its error: an error that vanishes in the reference's noise may be luck.
    """
    front: list[Row] = []
    for row in sorted(rows, key=lambda row: (row.wall_s, row.error.rms_gray_upper)):
        if not front or row.error.rms_gray_upper < front[-1].error.rms_gray_upper:
            front.append(row)
    return tuple(front)


def recommendation(rows: Sequence[Row], tolerance: float) -> str:
    """What to use on this scene for an rms error below a tolerance [gray level], in one sentence."""
    if not rows:
        return "Nothing was measured: every setting was expected to take longer than --longest."
    # A setting that ended without its own certificate ends so on another seed too.
    good = [row for row in rows if row.error.rms_gray_upper <= tolerance and row.met is not False]
    if not good:
        best = min(rows, key=lambda row: row.error.rms_gray_upper)
        return (
            f"No setting that was tried was certain to come below {tolerance:g} gray rms; the most exact is "
            f"`{best.setting.options}` with {_told(best)}."
        )
    best = min(good, key=lambda row: row.wall_s)
    paper = [row for row in good if row.setting.method == "viewpoints"]
    text = f"For an rms error below {tolerance:g} gray use `{best.setting.options}`: {_told(best)}"
    if best.setting.method == "viewpoints":
        return f"{text}; no other method that was tried is as fast."
    if not any(row.setting.method == "viewpoints" for row in rows):
        return f"{text}."
    if not paper:
        return f"{text}; the sub-viewpoints that were tried did not reach it."
    other = min(paper, key=lambda row: row.wall_s)
    return (
        f"{text}; the cheapest sub-viewpoints that come below it, `{other.setting.options}`, took "
        f"{other.wall_s / best.wall_s:.3g} times as long ({_told(other)})."
    )


def _told(row: Row) -> str:
    error = row.error
    return f"{error.rms_gray:.2g} gray (below {error.rms_gray_upper:.2g} by 97.5 %) in {duration(row.wall_s)}"


def as_json(trade: Trade) -> dict[str, Any]:
    """All that was measured; what depends on a clock stands under ``timing``."""
    options = trade.options
    return {
        "schema_version": SCHEMA_VERSION,
        "scene": trade.title,
        "run_sha256": trade.run_sha256,
        "seed": options.render.seed,
        "tolerance": trade.tolerance,
        "reference": {
            "pixels": len(trade.reference.sample.pixels),
            "rays_per_value": options.reference_rays,
            "rays": trade.reference.rays,
            "rms_gray": trade.reference.rms_gray,
            "note": "two independent means a, b of scrambled Sobol rays at each pixel; the squared error of an image k "
            "is (a - k)(b - k), which leaves their noise out; rms_gray is that of (a + b)/2",
        },
        "settings": [_row_as_json(row) for row in trade.rows],
        "left_out": [{"name": out.setting.name, **asdict(out.setting), "why": out.why} for out in trade.left_out],
        "timing": {
            "workers": options.workers,
            "longest_s": options.longest,
            "settings": {row.setting.name: {"wall_s": row.wall_s, "cpu_s": row.cpu_s} for row in trade.rows},
            "pareto_front": [row.setting.name for row in pareto_front(trade.rows)],
            "recommendation": recommendation(trade.rows, trade.tolerance),
        },
    }


def _row_as_json(row: Row) -> dict[str, Any]:
    return {
        "name": row.setting.name,
        "options": row.setting.options,
        **asdict(row.setting),
        "rays": row.rays,
        "met": row.met,
        "certified_rms_gray_upper95": row.certified_rms_gray_upper95,
        **asdict(row.error),
    }


def table(trade: Trade) -> str:
    """All settings as CSV, one a row; times in seconds, errors in gray levels."""
    front = {row.setting.name for row in pareto_front(trade.rows)}
    text = StringIO()
    columns = list(_row_as_json(trade.rows[0])) if trade.rows else ["name"]
    writer = csv.DictWriter(text, [*columns, "wall_s", "cpu_s", "pareto"], lineterminator="\n")
    writer.writeheader()
    for row in trade.rows:
        clock = {"wall_s": row.wall_s, "cpu_s": row.cpu_s, "pareto": int(row.setting.name in front)}
        writer.writerow({**_row_as_json(row), **clock})
    return text.getvalue()


def picture(trade: Trade) -> bytes:
    """Time against error as PNG, both axes logarithmic."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots()
    for method, marker in _MARKERS.items():
        rows = [row for row in trade.rows if row.setting.method == method]
        if rows:
            axes.plot([_shown(row) for row in rows], [row.wall_s for row in rows], marker, label=method, alpha=0.8)
    front = pareto_front(trade.rows)
    axes.plot([_shown(row) for row in front], [row.wall_s for row in front], "-", color="0.3", label="Pareto front")
    for row in front:
        label = row.setting.options.removeprefix("--method ").removeprefix("viewpoints ").replace("--", "")
        axes.annotate(label, (_shown(row), row.wall_s), fontsize="xx-small", xytext=(4, 4), textcoords="offset points")
    noise = max(trade.reference.rms_gray, _SMALLEST_SHOWN)
    axes.axvline(noise, color="0.7", linestyle="--", label=f"noise of the reference, {noise:.2g} gray (taken out)")
    if trade.rows:  # a logarithmic axis refuses to be empty
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.set_xlabel(f"rms error [gray level]; below {_SMALLEST_SHOWN:g} shown there")
    axes.set_ylabel(f"wall time with {trade.options.workers} tracers at a time [s]")
    axes.set_title(f"{trade.title}: time against error")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(fontsize="small")
    return figure_png(figure, dpi=110)


def _shown(row: Row) -> float:
    return max(row.error.rms_gray, _SMALLEST_SHOWN)


def write_trade(trade: Trade, out: Path) -> tuple[Path, Path, Path]:
    """Write table, numbers and picture; returns the three files."""
    contents = {TABLE: table(trade).encode(), NUMBERS: json_text(as_json(trade)).encode(), PICTURE: picture(trade)}
    for name, content in contents.items():
        write_bytes(out / name, content)
    return out / TABLE, out / NUMBERS, out / PICTURE
