"""Invariance: random scenes, rewritten in ways that must not change the image, or change it in a known way.

The relations, their domains and what must hold stand in
invariance_relations/relations.py; all relations share the image of each
scene. Without --relation all are run. Exit code 1 if one is broken: a scene
that differs where it must agree to the byte, more scenes outside their bounds
than chance allows, one by more than twice its bounds, or one that is refused
once it is rewritten. Pairs that differ are kept beside the JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

from invariance_relations.documents import Table
from invariance_relations.judging import CHANCE, FALSE_ALARM, PLANTS, case_of, run, verdict
from invariance_relations.relations import RELATIONS

OUT = Path(__file__).resolve().parent.parent / "out" / "invariance.json"
MOST_DRAWN = 20  # scenes to draw for each that is asked for, where a relation's domain is narrow


def _write(file: Path, names: list[str], rows: list[Table], refused: list[str]) -> list[Table]:
    """What is known so far; a run that is stopped leaves it."""
    verdicts = [verdict(name, [row for row in rows if row["relation"] == name]) for name in names]
    report = {"chance": CHANCE, "false_alarm": FALSE_ALARM, "verdicts": verdicts, "undrawable": refused, "rows": rows}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(report, indent=1))
    return verdicts


def main() -> int:
    """Draw, rewrite, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--relation", action="append", choices=RELATIONS, help="one of them; default all")
    parser.add_argument("--scenes", type=int, default=60, help="of each relation's domain (default 60)")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene, its seed")
    parser.add_argument("--numbers", type=int, nargs="+", help="these scenes only")
    parser.add_argument("--plant", choices=PLANTS, help="an error to put into each rewritten scene, to see it found")
    parser.add_argument("--json", type=Path, default=OUT, help="results; pairs that differ are kept beside it")
    parser.add_argument("--most-patches", type=int, default=4096, help="pass over scenes whose light costs more")
    parser.add_argument("--list", action="store_true", help="print the table of relations, and end")
    arguments = parser.parse_args()
    if arguments.list:
        for name, relation in RELATIONS.items():
            print(f"{name}: {relation.holds}; {relation.domain}")
        return 0
    names = arguments.relation or list(RELATIONS)
    rows: list[Table] = []
    refused: list[str] = []
    keep = arguments.json.with_suffix("")
    for number in arguments.numbers or range(arguments.first, arguments.first + MOST_DRAWN * arguments.scenes):
        counts = Counter(row["relation"] for row in rows)
        open_names = [name for name in names if counts[name] < arguments.scenes]
        if not open_names:
            break
        case = case_of(number, arguments.most_patches)
        if isinstance(case, str):
            refused.append(case)
            continue
        start = time.monotonic()
        found = [row for name in open_names if (row := run(case, name, arguments.plant, keep)) is not None]
        rows += found
        broken = [f"{row['relation']} {row.get('rms_gray', 0):.3g}" for row in found if not row["holds"]]
        _write(arguments.json, names, rows, refused)
        print(f"scene {case.number}: {len(found)} relations, {time.monotonic() - start:.1f} s", *broken, flush=True)
    verdicts = _write(arguments.json, names, rows, refused)
    for told in verdicts:
        print(
            f"{told['relation']:16} {told['holds']:13} {'kept' if told['kept'] else 'BROKEN':6} "
            f"failed {told['failed']} of {told['scenes']} ({told['allowed_by_chance']} by chance), "
            f"gross {told['gross']}, refused {told['refused']}, difference / bounds {told['median_share']:.3f}"
        )
    return 0 if all(told["kept"] for told in verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
