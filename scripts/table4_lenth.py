"""Table 4: Lenth's t of the printed Table 3, and the critical value."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from radwrap.study.effects import analyse, as_json
from radwrap.study.lenth import t_limit
from radwrap.study.levels import read_data
from radwrap.study.table import csv_text, read_table
from replication.figure import OURS, PAPER, Made, Task, figure, main
from replication.published import ROOT, claims

TABLE3 = ROOT / "rad_scenes" / "study_table2" / "table3.csv"
TRUE = 12.5  # mm, Sec. 5
FACTORS = ["A", "B", "C", "D"]
COLUMNS = (*FACTORS, "f [mm]", "error_percent")


def printed_table() -> list[dict[str, object]]:
    """Rows of Table 3 with |% error| of the printed f, not rounded."""
    return [{**row, "error_percent": abs(float(row["f [mm]"]) - TRUE) / TRUE * 100} for row in read_table(TABLE3).rows]


def _agreed(significant: list[bool]) -> float:
    """1 where an effect is significant in all responses, 0 in none; -1, which nobody prints, where they differ."""
    return float(significant[0]) if len(set(significant)) == 1 else -1.0


def make(task: Task) -> Made:
    """Analyse both responses of the printed table, draw."""
    del task  # nothing here is rendered
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table3.csv"
        path.write_text(csv_text(COLUMNS, printed_table()), "utf-8")
        found = {name: as_json(analyse(read_data(path, name, FACTORS))) for name in ("f", "error_percent")}
    effects = {name: list(result["effects"]) for name, result in found.items()}
    t = {name: [effect["t"] for effect in result["effects"].values()] for name, result in found.items()}
    alike = [_agreed([result["effects"][name]["significant"] for result in found.values()]) for name in effects["f"]]
    printed = claims("table4")
    picture, panels = figure(7.2, 3.6, 2, 1, sharex=True)
    for axes, name, key, title in zip(
        panels[:, 0], ("f", "error_percent"), ("f", "error"), ("t of f", "t of |% error|"), strict=True
    ):
        axes.bar(range(15), t[name], color=OURS, alpha=0.5, label="radwrap study analyse")
        axes.plot(range(15), printed[key].printed, "_", color=PAPER, ms=14, mew=1.5, label="printed")
        axes.axhline(0, color="0.3", lw=0.6)
        for limit in (-t_limit(15, 0.05), t_limit(15, 0.05)):
            axes.axhline(limit, color="0.6", lw=0.8, ls=":")
        axes.set_ylabel(title)
    panels[0, 0].legend()
    panels[1, 0].set_xticks(range(15), effects["f"])
    picture.suptitle("Table 4: printed and recomputed; dotted: t(0.975; 5)")
    return Made(
        title="Lenth's t of Table 3",
        picture=picture,
        ours={
            "f": t["f"],
            "error": t["error_percent"],
            "t_limit": t_limit(15, 0.05),
            "significant": alike,
        },
        assumed=(),
        more={"effects": effects["f"], "pse": {name: result["pse"] for name, result in found.items()}},
    )


if __name__ == "__main__":
    sys.exit(main("table4", make, __doc__))
