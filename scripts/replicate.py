"""The paper, figure by figure and table by table: runs every script, then writes out/replication/index.html.

What is finished is taken as it is: killed at any moment, the same command goes on.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import fig05_response
import fig08_09_field
import fig10_board
import fig11_edge
import fig12_transition
import fig13_oriented
import table1_ambient
import table3_focal_length
import table3_reason
import table4_lenth
from replication.figure import Task, carry_out, default_folder, told_exit
from replication.page import NAMES, write_page

SCRIPTS = (
    fig05_response,
    fig08_09_field,
    fig10_board,
    fig11_edge,
    fig12_transition,
    fig13_oriented,
    table1_ambient,
    table3_focal_length,
    table3_reason,
    table4_lenth,
)


def main() -> int:
    """Run all, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", type=Path, help="folder of the figures (default out/figures)")
    parser.add_argument("--out", type=Path, help="folder of the page (default out/replication)")
    parser.add_argument("--quick", action="store_true", help="coarse, one seed, into out/quick; no verdict counts")
    part = parser.add_mutually_exclusive_group()
    part.add_argument("--page-only", action="store_true", help="from the figures that lie there")
    part.add_argument("--figures-only", action="store_true", help="no page")
    parser.add_argument("--seeds", type=int, default=20, help="of Table 3 (default 20)")
    parser.add_argument("--variant-seeds", type=int, default=3, help="of each variant of Table 3 (default 3)")
    parser.add_argument("--finished", action="store_true", help="show the seeds that are finished, start none")
    given = parser.parse_args()
    start = time.monotonic()
    figures = given.figures or default_folder(given.quick, "figures")
    out = given.out or default_folder(given.quick, "replication")

    def work() -> None:
        task = Task(figures, given.quick, given.seeds, given.variant_seeds, given.finished)
        for name, script in zip(NAMES, SCRIPTS, strict=True):
            for line in () if given.page_only else carry_out(name, script.make, task):
                print(line, flush=True)
        for path in () if given.figures_only else write_page(figures, out):
            print(path)
        print(f"{time.monotonic() - start:.0f} s")

    return told_exit(work)


if __name__ == "__main__":
    sys.exit(main())
