"""Why A moves f in the paper: the effect of the ring's misalignment alone against the width of the beam.

Looked at after Table 3's sensitivity table was seen, which points here; no verdict hangs on it. Rows LLLL and HLLL
of the design, no LED differs, equal rays.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from replication.figure import PAPER, Made, Task, figure, main
from replication.images import focal_lengths, predicted
from replication.studies import NOMINAL_METHOD, draws_of, folder_of, is_finished, run
from table4_lenth import printed_table

WIDTHS = {
    "gaussian": (2.5, 3.0, 3.5, 4.5, 6.0, 7.6, 10.0),
    "cone": (6.0, 7.6, 9.0, 11.0),
}
MISALIGNED = {"sources[0].misalignment": {"about_y": "1.2 deg", "about_z": "-85 deg"}}
# The whole design once where the light's rim lies on the board.
RIM: dict[str, Any] = {
    "name": "rim_gaussian",
    "opens": "beam",
    "what": "Gaussian of 3.5 degrees: its rim lies on the board (looked at afterwards)",
    "set": {"sources[0].beam.width": "3.5 deg"},
}


def make(task: Task) -> Made:
    """Render both rows at each width, calibrate, draw."""
    widths = {"gaussian": (7.6,)} if task.quick else WIDTHS
    rows = [_row(task, profile, width) for profile, some in widths.items() for width in some]
    whole = [] if task.quick else _whole_design(task)
    return Made(
        title="Why A moves f (looked at afterwards)",
        picture=_picture(rows),
        ours={},
        assumed=(
            "lobe",
            "pinhole",
            "exposure",
            "threshold",
            "axes",
            "tilt_sign",
            "ring_turn",
            "solver",
            "dots",
            "black",
        ),
        more={"rows": rows, "rim_design": whole, "printed_pairs_mm": printed_pairs()},
    )


def _whole_design(task: Task) -> list[dict[str, Any]]:
    """Effects of all factors with such light, one seed, each centre method."""
    out = task.out / "studies"
    if task.finished_only and not is_finished(RIM, 1, out):
        return []
    if not task.finished_only:
        run(RIM, 1, out)
    study = folder_of(RIM, 1, out) / "study"
    return [
        {
            "method": draw.method,
            "pse_mm": draw.pse,
            "effects": {name: {key: draw.effects[name][key] for key in ("effect", "t")} for name in draw.effects},
        }
        for draw in draws_of(RIM["name"], 1, study)
    ]


def printed_pairs() -> list[float]:
    """F of H--L less f of L--L in Table 3, for the four levels of B and C [mm]."""
    printed = {"".join(str(row[name]) for name in "ABCD"): float(str(row["f [mm]"])) for row in printed_table()}
    return [printed[f"H{pair}L"] - printed[f"L{pair}L"] for pair in ("LL", "LH", "HL", "HH")]


def _row(task: Task, profile: str, width: float) -> dict[str, Any]:
    beam = {"sources[0].beam": {"profile": profile, "width": f"{width} deg", "width_definition": "fwhm"}}
    name = f"reason_{profile}_{width:g}"
    straight, turned = (
        predicted("fig13_oriented_board", f"{name}_{level}", task.out, quick=task.quick, changes=beam | more)
        for level, more in (("L", {}), ("H", MISALIGNED))
    )
    before, after = focal_lengths(straight, quick=task.quick), focal_lengths(turned, quick=task.quick)
    return {
        "profile": profile,
        "width_deg": width,
        "peak_gray": [float(image.gray.max()) for image in (straight, turned)],
        "change_mm": {name: (after[name].value - before[name].value) * 1e3 for name in after if name in before},
        "error_mm": {name: math.hypot(after[name].error, before[name].error) * 1e3 for name in after if name in before},
        "lost": sorted(set(before) ^ set(after)),
    }


def _picture(rows: list[dict[str, Any]]) -> Any:
    picture, panels = figure(7.2, 3.2, 1, 2, sharey=True)
    for axes, profile in zip(panels[0], WIDTHS, strict=True):
        shown = [row for row in rows if row["profile"] == profile]
        for method, marker in zip(("gray", "gray_threshold", "binary", "ellipse"), "osv^", strict=True):
            seen = [row for row in shown if method in row["change_mm"]]
            strong = method == NOMINAL_METHOD
            axes.errorbar(
                [row["width_deg"] for row in seen],
                [row["change_mm"][method] for row in seen],
                yerr=[row["error_mm"][method] for row in seen],
                fmt=f"{marker}-",
                ms=4 if strong else 3,
                lw=1.2 if strong else 0.6,
                alpha=1.0 if strong else 0.5,
                label=method,
            )
        low, high = min(printed_pairs()), max(printed_pairs())
        axes.axhspan(low, high, color=PAPER, alpha=0.25, lw=0, label="printed, four pairs of rows")
        axes.axhline(0, color="0.6", lw=0.6)
        axes.axvline(7.6, color="0.6", lw=0.6, ls=":")
        axes.set(xlabel="full width [deg]", title=f"{profile} beam")
        axes.set_yscale("symlog", linthresh=0.3)
    panels[0, 0].set_ylabel("f of HLLL less f of LLLL [mm]")
    panels[0, 1].legend()
    changes = [abs(change) for row in rows for change in row["change_mm"].values()]
    picture.suptitle(f"misaligned ring, untilted LEDs; largest change {np.max(changes):.2g} mm")
    return picture


if __name__ == "__main__":
    sys.exit(main("table3_reason", make, __doc__))
